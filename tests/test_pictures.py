"""Pictures of plans: what is written on them can be read."""

import base64
import re
from dataclasses import replace

import matplotlib
import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.text import Annotation, Text

from jshape import PAPER_BOX, HeightMap, Plan, Status
from jshape.app import pictures as app_pictures
from jshape.cli import plan as table
from jshape.data.view import View
from jshape.height_map import ABOVE, as_frame, looking_down
from jshape.viz import pictures, style
from jshape.viz.maps import span

SMALL = PAPER_BOX.crop(100, 100, 60, 40)
ROIS = {"press": (76, 132), "poke": (40, 45)}


@pytest.fixture
def plan(rng):
    """Sixteen actions close together, of all strengths and directions, to the image's corner."""
    names = tuple(("press", "poke")[k % 2] for k in range(16))
    yaws = np.array([(0.0, 0.5, -0.8, np.pi / 2)[k // 2 % 4] for k in range(16)], np.float32)
    rois = np.array([
        (max(ROIS[name]),) * 2 if yaw else ROIS[name] for name, yaw in zip(names, yaws, strict=True)
    ])  # fmt: skip
    image = np.full(PAPER_BOX.shape, 0.5, np.float32)
    return Plan(
        camera=PAPER_BOX,
        actions=names,
        positions=np.array([68, 68]) + rng.integers(0, 50, (16, 2)),
        rois=rois,
        distances=np.linspace(0.2, 0.1, 17, dtype=np.float32),
        status=Status.MAX_STEPS,
        strengths=np.array([1.0, 0.25, 1.6, 0.7] * 4, np.float32),
        yaws=yaws,
        clipped=np.zeros(16, np.float32),
        initial=image,
        goal=image,
        patches=tuple(np.full((h, w), 0.5, np.float32) for w, h in rois),
    )


def labels(figure):
    """The bold texts of the first axes, and the boxes around them in dots."""
    figure.draw_without_rendering()
    ax = figure.axes[0]
    texts = [text for text in ax.texts if text.get_fontweight() == "bold"]
    return ax, texts, [text.get_bbox_patch().get_window_extent() for text in texts]


@pytest.mark.parametrize("draw", [pictures.overlay_figure, pictures.plan_figure])
def test_labels_hide_neither_each_other_nor_leave_the_image(plan, draw):
    ax, texts, boxes = labels(draw(plan, rois=ROIS))
    assert len(texts) == 16
    for k, box in enumerate(boxes):
        assert ax.bbox.x0 <= box.x0 and box.x1 <= ax.bbox.x1
        assert ax.bbox.y0 <= box.y0 and box.y1 <= ax.bbox.y1
        assert not any(box.overlaps(other) for other in boxes[:k])


def test_strengths_and_directions_are_said_and_drawn(plan):
    figure = pictures.overlay_figure(plan, rois=ROIS)
    ax, texts, _ = labels(figure)
    said = [text.get_text() for text in texts]
    assert said[:5] == ["1", "2 x0.25", "3 x1.6", "4 x0.7", "5"]
    title = ax.get_title(loc="left")
    (u, v), (x, y) = plan.positions[0], plan.positions[2]
    assert f" 1 press ({u}, {v})  " in title
    assert f" 3 press x1.6 ({x}, {y}), yaw 29°" in title
    drawn = [box for box in ax.patches if isinstance(box, Rectangle)]
    sizes = [(box.get_width(), box.get_height(), round(box.get_angle())) for box in drawn]
    assert sizes[:3] == [(76, 132, 0), (40, 45, 0), (76, 132, 29)]
    np.testing.assert_allclose(drawn[2].get_center(), plan.positions[2])
    without = pictures.overlay_figure(plan).axes[0].patches
    assert [box.get_width() for box in without if isinstance(box, Rectangle)][2] == 132


@pytest.fixture
def moving(plan):
    """A sweep of twice the trained length, a scoop that the pour after it brings, and a press."""
    few = replace(plan.rest(12), actions=("sweep", "scoop", "pour", "press"), offsets=np.zeros(0))
    few.positions[:] = (200, 150), (100, 300), (240, 220), (340, 300)
    few.rois[:], few.yaws[:] = 80, (0.5, 0.0, 0.0, 0.0)
    strokes = np.array([[98.0, 53.5], [140.0, -80.0], [0, 0], [0, 0]], np.float32)
    patches = (np.full((80, 80), 0.5, np.float32),) * 4
    lengths = np.array([2.0, 1, 1, 1], np.float32)
    return replace(few, strokes=strokes, lengths=lengths, patches=patches, goal=plan.goal)


def test_strokes_are_arrows_through_the_place_or_to_where_material_goes(moving):
    figure = pictures.overlay_figure(moving, rois={"sweep": (60, 40)})
    arrows = [text for text in figure.axes[0].texts if isinstance(text, Annotation)]
    ends = [(arrow.xyann, arrow.xy) for arrow in arrows]
    np.testing.assert_allclose(ends[0], [(151, 123.25), (249, 176.75)])
    np.testing.assert_allclose(ends[1], [(100, 300), (240, 220)])
    assert len(ends) == 2
    assert [arrow.arrow_patch.get_linestyle() for arrow in arrows] == ["-", "--"]
    sweep = next(box for box in figure.axes[0].patches if isinstance(box, Rectangle))
    # Half of the path of 112 pixels is more than the trained one.
    np.testing.assert_allclose(sweep.get_width(), 60 + np.hypot(98, 53.5) / 2, rtol=1e-5)
    mm = 1e3 * np.hypot(98, 53.5) / 433.0 * (float(PAPER_BOX.z_min) + float(PAPER_BOX.z_max)) / 2
    title = figure.axes[0].get_title(loc="left").split("\n")
    assert title[1].endswith(f" (200, 150), yaw 29°, {mm:.0f} mm long")
    assert title[2].endswith("taken 166 mm to the next") and title[3].endswith("(240, 220)")


def test_long_words_stay_inside_the_picture(plan):
    """In one column where two do not fit, and in smaller letters where one does not."""
    far = {"strokes": np.full((16, 2), 60.0, np.float32), "actions": 16 * ("press hard aslant",)}
    narrow = PAPER_BOX.crop(68, 0, 150, 200)
    small = {"camera": narrow, "initial": plan.initial[:200, :150], "patches": plan.patches[:0]}
    for one, size in ((plan, 9), (replace(plan, **far), 9), (replace(plan, **far, **small), 0)):
        one.__dict__["images"] = one.initial[None]  # the first is all that is drawn
        figure = pictures.overlay_figure(one)
        figure.draw_without_rendering()
        texts = figure.axes[0].findobj(Text)
        (title,) = (text for text in texts if text.get_text().startswith("16 actions"))
        extent = title.get_window_extent()
        assert figure.bbox.x0 < extent.x0 and extent.x1 < figure.bbox.x1
        assert title.get_fontsize() == size or not size and 4 < title.get_fontsize() < 9
        assert len(title.get_text().split("\n")) == (9 if one is plan else 17)


def test_a_notebook_says_lengths_and_strokes_only_where_there_are_any(plan, moving):
    page = moving._repr_html_()
    assert "<th>length</th><th>by (u, v) (mm)</th>" in page
    assert "<td>2.00</td><td>(+101, +55)</td>" in page and "<td>1.00</td><td></td>" in page
    assert "length" not in plan._repr_html_()


def test_the_studio_draws_the_same_arrows(moving):
    drawn = app_pictures.boxes(moving, 0)
    assert drawn.count("<polyline") == 2 and drawn.count("<polygon") == 4 + 2
    assert 'points="151.0,123.2 ' in drawn and '<polygon points="249.0,176.8 ' in drawn
    assert (
        'points="100.0,300.0 ' in drawn and '<polygon points="232.2,224.5 ' in drawn
    )  # the disc of 3


def test_tables_have_columns_for_what_a_plan_has(plan, moving, capsys):
    table._print(moving, "greedy")
    rows = capsys.readouterr().out.splitlines()
    assert "yaw (°)  length  by (u, v) (mm)  to the goal (mm)" in rows[0]
    assert "29       2.00    (+101, +55)" in rows[2] and "(+144, -82)" in rows[3]
    table._print(plan, "greedy")
    assert "length" not in (out := capsys.readouterr().out) and "by (" not in out
    bed = HeightMap(np.zeros((395, 480), np.float32), 1e-3, (-0.1, -0.12))
    on_map = replace(moving, camera=bed.camera(), view=None)
    table._print(on_map, "greedy")
    rows = capsys.readouterr().out.splitlines()
    assert "by (x, y) (mm)" in rows[0] and "(+98, -54)" in rows[2] and "(+140, +80)" in rows[3]


def test_the_scale_of_a_map_is_that_of_its_bed_and_not_of_walls_at_its_rim(rng):
    heights = rng.normal(0, 3, (120, 160)).astype(np.float32)
    level = span([heights])
    heights[:, :20] = np.nan
    heights[:, 20:22] = 150  # a wall, 2 % of the bed
    np.testing.assert_allclose(span([heights]), level, atol=3)
    heights[60:63, 90:93] = -30  # a hole in the midst
    assert span([heights])[0] == pytest.approx(-30, abs=1)


def test_places_of_a_map_are_where_its_axes_say(plan):
    bed = HeightMap(np.zeros((190, 200), np.float32), 2e-3, (-0.1, -0.12))
    above, eye = bed.camera(), replace(PAPER_BOX, pose=as_frame(looking_down(ABOVE)))
    seen = replace(plan, camera=above, view=View(eye, above), seen=np.ones((190, 200), bool),
                   initial=np.full((190, 200), 0.5, np.float32), goal=None)  # fmt: skip
    figure = pictures.overlay_figure(seen, rois=ROIS)
    (u, v), (a, b) = seen.exact_positions[0], seen.camera_positions[0]
    x, y = -100 + 2 * u, -120 + 2 * (189 - v)
    title = figure.axes[0].get_title(loc="left")
    assert f" 1 press ({x:.0f}, {y:.0f}), pixel ({a}, {b})" in title and "pixels:" in title


def test_names_in_the_strip(plan):
    figure = pictures.steps_figure(plan)
    assert isinstance(figure, Figure)
    assert [ax.get_title() for ax in figure.axes[:3]] == ["now", "1 press", "2 poke x0.25"]


@pytest.mark.parametrize(
    "theirs", [{"image.origin": "lower"}, {"text.usetex": True}, {"figure.facecolor": "black"}]
)
def test_a_users_settings_do_not_reach_pictures(rng, theirs):
    images, camera = [rng.uniform(0.2, 0.8, (40, 60)).astype(np.float32)], SMALL
    expected = style.png(lambda: pictures.strip_figure(images, ["one"], camera))
    with matplotlib.rc_context(theirs):
        before = dict(matplotlib.rcParams)
        assert style.png(lambda: pictures.strip_figure(images, ["one"], camera)) == expected
        assert style.png(pictures.strip_figure(images, ["one"], camera)) == expected
        assert dict(matplotlib.rcParams) == before


def test_a_picture_that_cannot_be_drawn_costs_a_warning(capsys):
    def broken():
        raise RuntimeError("latex could\nnot be found")

    made = style.drawn({"a.png": broken, "b.png": lambda: Figure(figsize=(1, 1))})
    assert list(made) == ["b.png"] and made["b.png"].startswith(b"\x89PNG")
    out, err = capsys.readouterr()
    said = "could not be drawn: RuntimeError: latex could not be found\n"
    assert (out, err) == ("", f"warning: a.png {said}")


def test_a_plan_in_a_notebook(plan):
    assert repr(plan) == f"Plan(16 actions, {plan.distances_mm[0]:.3f} -> "\
        f"{plan.distances_mm[-1]:.3f} mm, MAX_STEPS)"  # fmt: skip
    page = plan._repr_html_()
    (picture,) = re.findall(r'<img alt="plan" src="data:image/png;base64,([A-Za-z0-9+/=]+)">', page)
    assert base64.b64decode(picture).startswith(b"\x89PNG")
    assert page.count("<tr>") == 17 and "press" in page
    long = replace(plan, **{
        name: np.tile(getattr(plan, name), (2, 1)[: getattr(plan, name).ndim])
        for name in ("positions", "rois", "strengths", "yaws")
    }, actions=2 * plan.actions, distances=np.ones(33, np.float32), goal=None)  # fmt: skip
    page = long._repr_html_()
    assert page.count("<tr>") == 21 and "and 12 more" in page and "<img" not in page


def test_names_put_no_markup_into_a_notebook(plan):
    hostile = "<script>alert(1)</script>"
    page = replace(plan, actions=(hostile, *plan.actions[1:]))._repr_html_()
    assert "<script" not in page and "&lt;script&gt;" in page


def test_show_returns_the_figure_where_nothing_can_show_it(plan, monkeypatch):
    with matplotlib.rc_context():
        pyplot.switch_backend("agg")
        assert isinstance(plan.show(), Figure) and not pyplot.get_fignums()
        monkeypatch.setattr(pyplot, "get_backend", lambda: "tkagg")

        def no_display(**_):
            raise ImportError("Cannot load backend 'TkAgg'")

        monkeypatch.setattr(pyplot, "figure", no_display)
        assert isinstance(plan.show(), Figure)


def test_show_draws_in_the_notebook(plan, monkeypatch):
    shown = []
    inline = "matplotlib_inline.backend_inline"
    monkeypatch.setattr(f"{inline}.display", lambda figure, **_: shown.append(figure))
    with matplotlib.rc_context():
        pyplot.switch_backend(f"module://{inline}")
        try:
            assert plan.show() is None
        finally:
            pyplot.switch_backend("agg")
    assert len(shown) == 1 and len(shown[0].axes) > 5
