"""Goals made from texts, drawings, meshes and frames: what they promise of bed and material."""

import math

import jax
import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from jshape import PAPER_BOX, Camera, sim
from jshape.errors import BadImage, BadPosition, JShapeError, MissingDepth, UnknownName
from jshape.goals import (
    Limits,
    bed_map,
    drawn_on_image,
    largest_size,
    make_goal,
    placed,
    relief_of_heights,
    relief_of_mask,
    relief_of_solid,
    relief_of_text,
    report,
    slopes,
    transport,
)
from jshape.goals.goal import RIM
from jshape.goals.picture import goal_figure
from jshape.goals.reliefs import Relief
from jshape.height_map import HeightMap
from tests.reference import slopes as reference

WIDE = Camera(320, 240, 300.0, 310.0, 171.0, 109.0, 0.3, 1.0)
"""A camera whose axis is not in the middle of its image."""


@pytest.fixture(scope="module")
def flat():
    return bed_map(np.full(WIDE.shape, 0.5, np.float32), WIDE)


@pytest.fixture(scope="module")
def hills():
    depth = np.asarray(sim.render(sim.irregular_bed(jax.random.key(1), 0.004), PAPER_BOX))
    return bed_map(depth, PAPER_BOX)


def tan(degrees):
    return math.tan(math.radians(degrees))


def block(bed, height, half=0.03, middle=0.0):
    """A cuboid in the middle of a bed, or at an x of it."""
    x, y = bed.axes()
    inside = (np.abs(x - middle) <= half)[None, :] & (np.abs(y) <= half)[:, None]
    return np.where(inside, np.float32(height), np.float32(0))


def disc(height, size=0.08, n=201):
    y, x = np.mgrid[-1 : 1 : n * 1j, -1 : 1 : n * 1j]
    return Relief(
        "disc", np.where(x**2 + y**2 < 1, np.float32(height), 0.0).astype("f"), (size,) * 2
    )


# Slopes


@pytest.mark.parametrize("steepest", [0.3, 1.0, 4.0])
def test_slopes_are_those_of_the_slow_search(rng, steepest):
    bed = rng.normal(0, 0.002, (13, 17)).astype(np.float32)
    bed[:, 5] += 0.02  # a wall that stands already
    wanted = bed.copy()
    wanted[3:9, 2:12] -= 0.015
    wanted[6:11, 9:15] += 0.012
    fast = slopes.held(bed, wanted, steepest, 0.003)
    np.testing.assert_allclose(fast, reference.held(bed, wanted, steepest, 0.003), atol=1e-6)
    assert not np.allclose(fast, wanted, atol=1e-4)


def test_what_stands_lies_between_the_bed_and_what_is_wanted(rng, hills):
    bed, cell = hills.height, hills.cell
    wanted = bed + block(hills, -0.012) + np.roll(block(hills, 0.02), 45, 1)
    stands = slopes.held(bed, wanted, 0.7, cell)
    assert (stands >= np.minimum(bed, wanted) - 1e-7).all()
    assert (stands <= np.maximum(bed, wanted) + 1e-7).all()
    for step, limit in zip(slopes.STEPS, slopes.drops(bed, 0.7, cell), strict=True):
        assert (np.abs(np.subtract(*slopes._pair(stands, step))) <= limit + 1e-6).all()
    again = slopes.held(bed, stands, 0.7, cell)
    np.testing.assert_allclose(again, stands, atol=1e-6)


def test_a_cone_is_round(flat):
    """No direction is steeper than the material holds by more than the 2.8 % of 16 neighbours."""
    bed, cell = np.zeros((201, 201), np.float32), 0.001
    wanted = np.full_like(bed, 0.05)
    wanted[:3] = wanted[-3:] = wanted[:, :3] = wanted[:, -3:] = 0
    wanted[100, 100] = 0
    cone = slopes.lower_envelope(wanted, slopes.drops(bed, 0.8, cell))
    away = np.hypot(*(np.mgrid[-60:61, -60:61])) * cell * 0.8
    inner = cone[40:161, 40:161]
    near = (away > 0.004) & (away < 0.03)
    ratio = inner[near] / away[near]
    assert ratio.min() > 1 - 1e-4 and ratio.max() < 1.028


def test_nothing_wanted_changes_nothing(hills):
    stands = slopes.held(hills.height, hills.height.copy(), 0.01, hills.cell)
    np.testing.assert_array_equal(stands, hills.height)


# The bed from above


def test_a_level_bed_is_level_and_places_are_where_they_are(flat):
    assert flat.level == pytest.approx(0.5)
    np.testing.assert_allclose(flat.height, 0, atol=1e-6)
    x, y = flat.point((171, 109))
    assert abs(x) < 1e-9 and abs(y) < 1e-9
    u, v = flat.pixels()
    row, column = (np.abs(axis).argmin() for axis in reversed(flat.axes()))
    assert abs(u[row, column] - 171) < 1 and abs(v[row, column] - 109) < 1
    low, high = flat.view()
    np.testing.assert_allclose(high - low, [320 * 0.5 / 300, 240 * 0.5 / 310], rtol=1e-5)
    area = flat.cm3(flat.seen.astype(float)) / 100  # 1 m high: cm³ per 100 cm is cm²
    assert area == pytest.approx(1e4 * np.prod(high - low), rel=0.01)


def test_what_is_unchanged_keeps_every_bit_and_what_changes_is_seen_right(hills):
    np.testing.assert_array_equal(hills.frame_with(hills.height), hills.frame)
    # A real bed with a real hole: the map of the one and of the other explain both frames.
    bed = sim.irregular_bed(jax.random.key(1), 0.004)
    after = sim.apply_action(jax.random.key(2), bed, "flour", ("knock", "robot"), (0.06, -0.04))
    frame = np.asarray(sim.render(after, PAPER_BOX))
    seen = hills.frame_with(hills.heights_of(frame))
    assert np.abs(frame - hills.frame).max() > 0.01
    # Planes 3 mm apart blur the hole's walls, nothing else.
    assert np.abs(seen - frame).mean() < 2e-5
    assert np.percentile(np.abs(seen - frame), 99) < 5e-4


@pytest.mark.full
def test_a_window_of_a_frame_is_what_is_looked_at():
    depth = np.full((300, 400), 2.0, np.float32)
    depth[50:250, 60:360] = 0.5
    camera = Camera(400, 300, 300.0, 300.0, 200.0, 150.0, 0.3, 1.0)
    bed = bed_map(depth, camera, window=(60, 50, 300, 200))
    assert bed.level == pytest.approx(0.5)
    goal = make_goal(bed, placed(disc(-0.01), bed, (100, 90)), Limits(1.0))
    changed = np.argwhere(np.abs(goal.depth - depth) > 1e-3)
    np.testing.assert_allclose(changed.mean(0), [90, 100], atol=1)
    np.testing.assert_array_equal(goal.depth[depth == 2.0], 2.0)


def test_gaps_are_filled_and_counted_or_refused(rng):
    depth = np.full(WIDE.shape, 0.5, np.float32)
    depth[rng.random(WIDE.shape) < 0.05] = 0
    bed = bed_map(depth, WIDE)
    assert bed.filled == (depth == 0).sum() and np.abs(bed.height).max() < 1e-6
    with pytest.raises(MissingDepth, match="bed: 4.9 %"):
        bed_map(depth, WIDE, max_missing=0.01)
    with pytest.raises(BadImage, match="320x240"):
        bed_map(depth[:, :9], WIDE)


# Reliefs and where they are laid


def test_a_text_has_its_size_place_turn_and_open_eyes(flat):
    relief = relief_of_text("O", -0.008).sized(0.1)
    assert max(relief.size) == pytest.approx(0.1)
    wanted = placed(relief, flat, (150, 120))
    u, v = (k[wanted < -0.004] for k in flat.pixels())
    assert (np.ptp(v) + 1) * 0.5 / 310 == pytest.approx(0.1, abs=0.004)
    assert (u.min() + u.max()) / 2 == pytest.approx(150, abs=1)
    assert (v.min() + v.max()) / 2 == pytest.approx(120, abs=1)
    u, v = flat.pixels()
    assert not wanted[np.hypot(u - 150, v - 120) < 5].any()
    assert wanted.min() == pytest.approx(-0.008, rel=1e-3)


def test_a_text_reads_from_left_to_right_and_turns_clockwise(flat):
    bar = np.zeros((40, 160), np.float32)
    bar[:, 120:] = 0.01  # heavy at the right end
    relief = Relief("bar", bar, (0.16, 0.04))
    for turn, expected in ((0.0, (1, 0)), (math.pi / 2, (0, 1)), (math.pi, (-1, 0))):
        wanted = placed(relief, flat, turn=turn)
        u, v = (k[wanted > 0.005].mean() for k in flat.pixels())
        middle = flat.middle()
        away = np.array([u - middle[0], v - middle[1]]) * [0.5 / 300, 0.5 / 310]
        np.testing.assert_allclose(away, 0.06 * np.array(expected), atol=0.002)


def test_letters_are_not_mirrored():
    heights = relief_of_text("L", 1.0).heights
    rows, columns = heights.shape
    assert heights[: rows // 2, : columns // 4].mean() > 0.5  # the stem is at the left
    assert heights[-rows // 8 :, -columns // 3 :].mean() > 0.5  # the foot goes right, below
    assert heights[: rows // 2, -columns // 3 :].mean() < 0.01


def test_a_dollar_is_a_dollar_and_no_formula():
    width, height = relief_of_text("$x$", 1.0).size
    assert width > 1.8 * height


@pytest.mark.parametrize(
    "text, said", [("", "empty"), (" \t", "empty"), ("a\nb", "no sign"), ("字", "no sign for '字'")]
)
def test_texts_without_signs_are_refused(text, said):
    with pytest.raises(BadImage, match=said):
        relief_of_text(text, 0.01)


def test_a_relief_that_leaves_the_view_says_what_would_fit(flat):
    relief = relief_of_text("WIDE", -0.01).sized(0.4)
    largest = largest_size(relief, flat, (100, 120))
    with pytest.raises(
        BadPosition, match=rf"400 x \d+ mm and leaves the view.*size-mm {int(largest * 1e3)} "
    ):
        placed(relief, flat, (100, 120))
    placed(relief.sized(0.999 * largest), flat, (100, 120))
    for outside in ((-5, 100), (100, 400)):
        with pytest.raises(BadPosition, match="outside the view: u 0 to 319, v 0 to 239"):
            placed(relief, flat, outside)


def test_a_mask_is_what_is_bright_in_it(flat):
    mask = np.zeros((240, 320), np.uint8)
    mask[100:150, 50:120] = 255
    drawn = drawn_on_image(relief_of_mask(mask, -0.01).heights, flat)
    u, v = flat.pixels()
    inside = (u > 51) & (u < 118) & (v > 101) & (v < 148)
    outside = (u < 48) | (u > 121) | (v < 98) | (v > 151)
    np.testing.assert_allclose(drawn[inside], -0.01, rtol=1e-5)
    assert not drawn[outside].any()
    with pytest.raises(BadImage, match="has 99x240 pixels and the bed 320x240.*--size-mm"):
        drawn_on_image(np.zeros((240, 99), np.float32), flat)
    for same in (np.zeros((9, 9)), np.ones((9, 9)), np.full((9, 9), np.nan)):
        with pytest.raises(BadImage, match="all of it is the same"):
            relief_of_mask(same, 0.01)


def test_grey_levels_go_from_low_to_high_and_floats_are_metres():
    grey = np.arange(200, dtype=np.uint8).reshape(10, 20)
    heights = relief_of_heights(grey, -0.005, 0.01).heights
    assert heights[0, 0] == pytest.approx(-0.005) and heights[-1, -1] == pytest.approx(0.01)
    metres = np.linspace(-0.01, 0.02, 12, dtype=np.float32).reshape(3, 4)
    metres[1, 1] = np.nan
    np.testing.assert_array_equal(relief_of_heights(metres).heights, metres)
    with pytest.raises(BadImage, match="need a height"):
        relief_of_heights(grey)
    with pytest.raises(BadImage, match="millimetres"):
        relief_of_heights(metres * 1e3)
    with pytest.raises(BadImage, match="at least 2 x 2"):
        relief_of_heights(metres[0])


def test_places_that_a_height_map_does_not_know_stay(flat):
    heights = np.full((50, 50), np.float32(0.01))
    heights[:, 25:] = np.nan
    heights[0, 0] = 0.009
    wanted = placed(relief_of_heights(heights).sized(0.1), flat)
    u, _ = flat.pixels()
    middle = flat.middle()[0]
    assert not wanted[u > middle + 2].any()
    assert wanted[wanted != 0].min() > 0.0085 and (wanted != 0).any()


def test_a_ball_is_seen_from_above_as_mesh_and_as_cloud(flat):
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=4, radius=40.0)
    mesh = relief_of_solid(np.asarray(ball.vertices), np.asarray(ball.faces), unit=1e-3)
    cloud = relief_of_solid(ball.sample(60_000, seed=1), None, unit=1e-3)
    for relief, near in ((mesh, 3e-4), (cloud, 2e-3)):
        np.testing.assert_allclose(relief.size, 0.08, rtol=0.03)
        wanted = placed(relief, flat)
        x, y = (axis - at for axis, at in zip(flat.axes(), flat.point(flat.middle()), strict=True))
        out2 = x[None, :] ** 2 + y[:, None] ** 2
        inside = out2 < 0.033**2
        exact = 0.04 + np.sqrt(0.04**2 - out2[inside])
        assert np.abs(wanted[inside] - exact).mean() < near
        assert not wanted[out2 > 0.044**2].any()


def test_a_mesh_lies_as_its_axes_say():
    """A wedge that rises along its own x and is longest along y."""
    corners = np.array([[0, 0, 0], [2, 0, 0], [2, 0, 1], [0, 3, 0], [2, 3, 0], [2, 3, 1.0]])
    ends, sides = [[0, 1, 2], [3, 5, 4]], [[0, 2, 5, 3], [0, 3, 4, 1], [1, 4, 5, 2]]
    faces = np.array([*ends, *(q[:3] for q in sides), *([q[0], *q[2:]] for q in sides)])
    up_z = relief_of_solid(corners, faces)
    np.testing.assert_allclose(up_z.size, [2, 3], rtol=0.01)
    assert up_z.heights[100, -50] > 0.9 and up_z.heights[100, 50] < 0.2
    up_x = relief_of_solid(corners, faces, up="x")
    np.testing.assert_allclose(up_x.size, [3, 1], rtol=0.01)
    np.testing.assert_allclose(np.nanmax(up_x.heights), 2, rtol=1e-3)
    with pytest.raises(UnknownName, match="axis 'w'"):
        relief_of_solid(corners, faces, up="w")
    with pytest.raises(BadImage, match="flat"):
        relief_of_solid(corners * (1, 1, 0), faces)


# What the bed can give


def test_a_hole_has_its_floor_its_outline_and_slopes_that_stand(flat):
    goal = make_goal(flat, block(flat, -0.01), Limits(tan(40)))
    assert goal.change.min() == pytest.approx(-0.01, rel=1e-4)
    assert not goal.change[goal.wanted == 0].any()
    assert slopes.steepness(goal.height, flat.cell).max() <= tan(40) * 1.001
    said = report(goal)
    w = flat.cell * (np.sqrt((goal.wanted != 0).sum()) + 1)  # between the nodes that stay
    inner = w - 2 * 0.01 / tan(40)
    volume = 1e6 * 0.01 / 3 * (w**2 + inner**2 + w * inner)
    assert said["sunk_cm3"] == pytest.approx(volume, rel=0.05)
    assert said["raised_cm3"] == 0 and said["net_cm3"] == -said["sunk_cm3"]
    lost = said["left"]["too steep"]
    assert lost["volume_cm3"] == pytest.approx(said["wanted_sunk_cm3"] - said["sunk_cm3"], rel=1e-3)
    assert lost["most_mm"] == pytest.approx(10, abs=1.6) and said["steepest_deg"] < 40.1
    assert any("steeper than the material holds (40°)" in line for line in said["says"])
    # And the camera sees it: the middle is 10 mm farther.
    x, y = flat.axes()
    assert goal.depth[109, 171] == pytest.approx(0.51, abs=1e-4)


def test_depth_is_held_to_the_floor_and_heights_to_the_range(flat):
    goal = make_goal(flat, block(flat, -0.03), Limits(4.0, floor=0.02))
    assert goal.change.min() == pytest.approx(-0.02, rel=1e-4)
    said = report(goal)
    assert said["left"]["deeper than the material"]["most_mm"] == pytest.approx(10, rel=1e-3)
    assert any("deeper than the material (20 mm)" in line for line in said["says"])
    near = Camera(320, 240, 300.0, 310.0, 171.0, 109.0, 0.49, 0.505)
    bed = bed_map(np.full(near.shape, 0.5, np.float32), near)
    for wanted, left in ((-0.03, -0.005), (0.03, 0.01)):
        goal = make_goal(bed, block(bed, wanted), Limits(4.0))
        most = goal.change[np.abs(goal.change).argmax() // goal.change.shape[1]]
        assert most[np.abs(most).argmax()] == pytest.approx(left, rel=1e-3)
        assert goal.left["beyond the camera's range"].any()


def test_what_the_bed_is_already_it_may_remain(hills):
    """Deeper than the floor and steeper than the slope, where nothing is wanted."""
    goal = make_goal(hills, block(hills, -0.005), Limits(0.05, floor=0.003))
    here = block(hills, 1.0) == 0
    np.testing.assert_array_equal(goal.change[here], 0)
    assert goal.height.min() < -0.003


def test_out_of_reach_nothing_changes(flat):
    reach = np.zeros(WIDE.shape, bool)
    reach[:, :171] = True
    goal = make_goal(flat, block(flat, -0.01), Limits(1.0, reach=reach))
    u, _ = flat.pixels()
    assert goal.change.any() and not goal.change[u > 172].any()
    lost = report(goal)["left"]["out of reach"]
    assert lost["volume_cm3"] == pytest.approx(18, rel=0.1) and lost["place"][0] > 170


def test_where_nobody_saw_a_map_nothing_changes_and_the_picture_shows_it(rng):
    known = HeightMap(rng.normal(0, 1e-3, (90, 120)).astype(np.float32), 2e-3, (0.02, -0.1))
    known.heights[-5:] += 0.02
    known.heights[:, :40] = np.nan  # 0.02 to 0.1 m along x
    bed = bed_map(known.depth(known.camera()), known.camera(), where="map")
    wanted = block(bed, -0.006, middle=0.1)
    made = make_goal(bed, wanted, Limits(4.0))
    assert not made.change[~bed.seen].any() and made.change[bed.seen].any()
    lost = report(made)["left"]["not seen"]["volume_cm3"]
    assert lost == pytest.approx(bed.cm3(-wanted[~bed.seen]), rel=1e-3) and lost > 1
    assert any("no camera saw" in line for line in report(made)["says"])
    with pytest.raises(BadImage, match="where no camera saw the bed"):
        make_goal(bed, np.where(bed.seen, 0, wanted), Limits(4.0))
    axes = goal_figure(made).axes
    for ax in axes[:3]:
        shown, (low, high) = ax.images[0], ax.images[0].get_extent()[2:]
        assert ax.patch.get_hatch() and ax.get_ylim() == pytest.approx((-101, 79), abs=0.1)
        middle = shown.get_array()[45]
        assert low < high and middle.mask[:35].all() and not middle.mask[50:110].any()
    # As in a map's own picture y is up: the ridge at its end is at the top.
    assert np.argmax(axes[0].images[0].get_array().mean(1)) < 15


@pytest.mark.parametrize("how", ["around", "level"])
@pytest.mark.parametrize("height", [-0.008, 0.006])
def test_a_balanced_goal_moves_as_much_in_as_out(hills, how, height):
    wanted = block(hills, height)
    goal = make_goal(hills, wanted, Limits(tan(50)), balance=how)
    said = report(goal)
    moved = said["raised_cm3"] + said["sunk_cm3"]
    assert abs(said["net_cm3"]) < 0.005 * moved
    assert said["balance"]["how"] == how and abs(said["balance"]["net_before_cm3"]) > 10
    x, y = hills.axes()
    far = np.maximum(np.abs(x)[None, :], np.abs(y)[:, None]) > 0.03 + RIM + 0.002
    assert goal.change[far & hills.seen].any() == (how == "level")
    assert np.sign(goal.balance.most) == -np.sign(height)
    with pytest.raises(UnknownName, match="balance 'up'"):
        make_goal(hills, wanted, Limits(1.0), balance="up")


def test_warnings_say_what_no_action_can_do(flat):
    def warned(wanted, material=sim.FLOUR, **options):
        return " ".join(
            report(make_goal(flat, wanted, Limits(1.0), **options), material)["warnings"]
        )

    up = warned(block(flat, 0.01))
    assert "more material than there is" in up and "only a pour from a stock" in up
    assert "hills keep most" in warned(block(flat, 0.01), balance="around")
    assert "flour can pack" in warned(block(flat, -0.01))
    assert "dough cannot pack" in warned(block(flat, -0.01), sim.DOUGH)
    assert "pack" not in warned(block(flat, -0.01), None)
    edge = drawn_on_image(
        np.where(np.arange(320)[None, :] < 9, -0.01, 0.0) * np.ones((240, 1)), flat
    )
    assert "20 mm of the view's edge" in warned(edge)
    assert "edge" not in warned(block(flat, -0.01))


def test_material_comes_from_where_it_is_too_much(flat):
    """12 cm³ are missing between 16 on the left and 8 on the right, which are nearer."""
    wanted = sum(
        block(flat, height, half=0.02, middle=x)
        for x, height in ((-0.15, -0.01), (0.0, 0.0075), (0.06, -0.005))
    )
    goal = make_goal(flat, wanted, Limits(4.0))
    found = report(goal)["transport"]
    assert found["take_cm3"] == pytest.approx(24, rel=0.06)  # walls lean, and half squares
    assert found["bring_cm3"] == pytest.approx(12, rel=0.06)
    assert found["stock_cm3"] == found["bring_cm3"] - found["take_cm3"] < -10
    volumes = [one["volume_cm3"] for one in found["take"]]
    assert volumes == pytest.approx([16, 8], rel=0.06) and len(found["bring"]) == 1
    assert [one["most_mm"] for one in found["take"]] == pytest.approx([10, 5], rel=0.01)
    at = [171 + 600 * x for x in (-0.15, 0.06)]  # 600 pixels a metre, of an axis at (171, 109)
    for one, u in zip(found["take"], at, strict=True):
        assert one["place"] == pytest.approx([u, 109], abs=4)
    assert [one["to"] for one in found["carries"]] == 2 * [found["bring"][0]["place"]]
    near, far = found["carries"]
    assert near["from"] == found["take"][1]["place"]
    assert near["volume_cm3"] == pytest.approx(volumes[1])  # all of it, the rest comes from afar
    assert near["volume_cm3"] + far["volume_cm3"] == pytest.approx(found["bring_cm3"])
    # From the right to the right two thirds of the hollow, and from the near side of the left.
    assert near["way_mm"] == pytest.approx(53, abs=5)
    assert far["way_mm"] == pytest.approx(135 - 13, abs=10)  # its blocks are of 30 mm
    says = " ".join(found["says"])
    for words in ("too much: 1", "to carry: 1", "a stock would have to take 1"):
        assert words in says


def test_carries_go_the_least_way(hills, rng):
    """As parcels of the same volume do that are assigned one by one."""
    x, y = hills.axes()
    shape = sum(
        a * np.exp(-(((x[None] - b) / 0.04) ** 2) - (((y[:, None] - c) / 0.05) ** 2))
        for a, (b, c) in zip((9, -7, 5, -6, 8), rng.uniform(-0.12, 0.12, (5, 2)), strict=True)
    )
    change = (1e-3 * shape * hills.seen).astype(np.float32)
    found = transport(hills, change)
    sides = []
    for sign, total in ((-1, found.take_cm3), (1, found.bring_cm3)):
        row, column = np.nonzero(sign * change > 5e-4)
        volume = np.cumsum(np.abs(change[row, column].astype(float)))
        parcels = np.arange(0.5, round(5 * total)) / round(5 * total) * volume[-1]
        picked = np.searchsorted(volume, parcels)
        sides.append(np.stack([x[column[picked]], y[row[picked]]], 1))
    ways = np.linalg.norm(sides[0][:, None] - sides[1][None], axis=-1)
    assert 1e3 * ways[linear_sum_assignment(ways)].mean() == pytest.approx(found.way_mm, rel=0.04)


def test_noise_is_no_region_and_a_press_needs_no_carry(flat, rng):
    noise = rng.normal(0, 6.4e-4, flat.height.shape).astype(np.float32)
    found = transport(flat, block(flat, -0.008) + noise)
    assert len(found.take) == 1 and not found.bring and not found.carries
    assert found.take_cm3 == pytest.approx(28.8, rel=0.05) and found.way_mm is None
    said = report(make_goal(flat, block(flat, -0.008), Limits(4.0)))["transport"]
    assert said["carries"] == [] and not any("to carry" in line for line in said["says"])


def test_a_picture_says_the_volumes(flat):
    wanted = block(flat, -0.01, middle=-0.08) + block(flat, 0.01, middle=0.08)
    (label,), (other,) = [
        [one for one in goal_figure(make_goal(flat, wanted, Limits(4.0))).axes[2].texts
         if one.get_text().startswith(sign)]
        for sign in "-+"
    ]  # fmt: skip
    assert float(label.get_text()) == pytest.approx(-36, abs=3)
    assert float(other.get_text()) == pytest.approx(36, abs=3)
    assert label.get_position() == pytest.approx((-80, 0), abs=6)
    assert other.get_position() == pytest.approx((80, 0), abs=6)


def test_a_frame_is_its_own_goal(hills):
    bed = sim.irregular_bed(jax.random.key(1), 0.004)
    after = sim.apply_action(jax.random.key(2), bed, "flour", ("knock", "robot"), (0.06, -0.04))
    frame = np.asarray(sim.render(after, PAPER_BOX))
    wanted = hills.heights_of(frame) - hills.height
    goal = make_goal(hills, wanted, Limits(float(sim.FLOUR.steepest)), like=frame)
    assert np.abs(goal.depth - frame).mean() < 1e-6


def test_odd_changes_are_refused(flat):
    with pytest.raises(BadImage, match="the bed as it is"):
        make_goal(flat, np.zeros_like(flat.height), Limits(1.0))
    with pytest.raises(BadImage, match="finite"):
        make_goal(flat, np.full_like(flat.height, np.nan), Limits(1.0))
    with pytest.raises(BadImage, match="shape"):
        make_goal(flat, np.zeros((3, 3), np.float32), Limits(1.0))
    for options in ({"steepest": 0.0}, {"steepest": 1.0, "floor": -1.0}):
        with pytest.raises(JShapeError, match="a number above 0"):
            Limits(**options)


def test_no_data_of_a_height_map_is_no_plateau():
    heights = np.linspace(0, 30, 200, dtype=np.float32).reshape(10, 20)
    marked = heights.copy()
    marked[:3] = -9999
    left_out = relief_of_heights(np.ma.masked_equal(marked, -9999), 0.0, 0.012).heights
    assert np.isnan(left_out[:3]).all()
    np.testing.assert_allclose(
        left_out[3:], 0.012 * (heights[3:] - heights[3, 0]) / np.ptp(heights[3:]), atol=1e-8
    )
    with pytest.raises(
        BadImage, match="60 pixels hold -9999, the others 9.045.* to 30: .*GDAL_NODATA"
    ):
        relief_of_heights(marked, 0.0, 0.012)
