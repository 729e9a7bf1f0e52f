"""A story as a Rerun recording (`.rrd`): everything on one timeline, arranged when it opens."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from jshape.app.pictures import DIFFERENCES, Scale, colour_of, differing
from jshape.app.view.story import Moment, Story
from jshape.errors import BadFile, JShapeError
from jshape.io.files import write_atomic
from jshape.io.images import to_counts

SUFFIX = ".rrd"
TIMELINE = "step"
DEPTH_UNIT = 0.0001
"""Metres per count of the depth frames, as a run keeps them: 0.1 mm."""
SEEN, PREDICTED, GOAL = "seen", "predicted", "goal"
"""Entities of the three beds; each is a pinhole camera with its depth, in one frame."""
QUALITY = 90
"""Of pictures that are for eyes only, JPEG."""
LINES = {"obtained": (214, 39, 40), "predicted": (31, 119, 180), "effort": (44, 160, 44)}


def write_recording(path: str | os.PathLike, story: Story, *, overwrite: bool = False) -> Path:
    """Write a story as a Rerun recording, whole or not at all.

    Raises:
      BadFile: another ending than .rrd, a file that is there and not to be replaced, or a place
        that cannot be written.
      JShapeError: rerun is not installed.
    """
    path = check_target(path, overwrite)
    return write_atomic(path, _recorded(_rerun(), story))


def check_target(path: str | os.PathLike, overwrite: bool) -> Path:
    """The file as a path, if `write_recording` may write it: call it before long work.

    Raises:
      BadFile: as for `write_recording`.
    """
    path = Path(path)
    if path.suffix.lower() != SUFFIX:
        raise BadFile(f"{path}: a Rerun recording ends in {SUFFIX}")
    if os.path.lexists(path) and not overwrite:
        raise BadFile(
            f"{path}: the file exists; choose another name, or replace it with --overwrite"
        )
    return path


def _recorded(rr: Any, story: Story) -> bytes:
    """The bytes of the recording."""
    recording = rr.RecordingStream("jshape", send_properties=False)
    recording.set_log_time_enabled(False)
    recording.set_log_tick_enabled(False)
    stream = recording.binary_stream()
    recording.send_blueprint(_arranged(rr, story))
    _always(rr, recording, story)
    for step, moment in enumerate(story.moments):
        recording.set_time(TIMELINE, sequence=step)
        _at(rr, recording, story, step, moment)
    content = stream.read()
    recording.disconnect()
    if not content:
        raise JShapeError("rerun gave no recording")
    return content


def _beds(story: Story) -> tuple[str, ...]:
    """The beds that the story knows."""
    known = {
        SEEN: any(moment.seen is not None for moment in story.moments),
        PREDICTED: any(moment.predicted is not None for moment in story.moments),
        GOAL: story.goal is not None,
    }
    return tuple(name for name, is_there in known.items() if is_there)


def _always(rr: Any, recording: Any, story: Story) -> None:
    """What does not change: cameras, the goal, how curves look."""
    camera = story.camera
    # X right, Y towards who looks, Z down: the camera looks straight down.
    recording.log("world", rr.ViewCoordinates.RBD, static=True)
    for name in _beds(story):
        pinhole = rr.Pinhole(
            resolution=[camera.width, camera.height],
            focal_length=[float(camera.fx), float(camera.fy)],
            principal_point=[float(camera.u0), float(camera.v0)],
            image_plane_distance=0.1 * story.level,
        )
        recording.log(f"world/{name}", pinhole, static=True)
    if story.goal is not None:
        recording.log(f"world/{GOAL}/depth", _depth(rr, story, story.goal), static=True)
    for name, colour in LINES.items():
        where = f"effort/{name}" if name == "effort" else f"distance/{name}"
        recording.log(where, rr.SeriesLines(colors=[colour], names=[name], widths=[2]), static=True)
        points = rr.SeriesPoints(colors=[colour], names=[name], marker_sizes=[4])
        recording.log(where, points, static=True)
    told = "\n\n".join([story.title, *story.notes])  # plain: Markdown fetches pictures
    recording.log("words", rr.TextDocument(told), static=True)


def _at(rr: Any, recording: Any, story: Story, step: int, moment: Moment) -> None:
    """What a step has to say."""
    for name, depth in ((SEEN, moment.seen), (PREDICTED, moment.predicted)):
        if depth is None:
            continue
        recording.log(f"world/{name}/depth", _depth(rr, story, depth))
        gap = story.too_high_mm(depth, story.goal)
        if gap is not None:
            recording.log(f"difference/{name}", _picture(rr, story, gap))
    error = story.too_high_mm(moment.seen, moment.predicted)
    if error is not None:
        recording.log("difference/error", _picture(rr, story, error))
    _log_boxes(rr, recording, story, step)
    numbers = {
        "distance/obtained": moment.seen_mm,
        "distance/predicted": moment.predicted_mm,
        "effort/effort": moment.effort_nm,
    }
    for where, value in numbers.items():
        if value is not None:
            recording.log(where, rr.Scalars(value))
    recording.log("log", rr.TextLog(moment.words, level="INFO"))


def _depth(rr: Any, story: Story, depth: np.ndarray) -> Any:
    near, far = story.range_m
    counts = to_counts(depth, DEPTH_UNIT)
    scale = 1 / DEPTH_UNIT
    return rr.DepthImage(
        counts, meter=scale, colormap="viridis", depth_range=[near * scale, far * scale]
    )


def _picture(rr: Any, story: Story, gap_mm: np.ndarray) -> Any:
    reach = story.reach_mm
    return rr.Image(differing(gap_mm, Scale(-reach, reach, DIFFERENCES))).compress(QUALITY)


def _log_boxes(rr: Any, recording: Any, story: Story, step: int) -> None:
    """Numbered boxes of the actions so far, the last one thick; at the start, of all of them."""
    rows = []
    for k in range(1, (step or len(story)) + 1):
        act, box = story.moments[k].act, story.box(k)
        corners = None if act is None else story.outline(act)
        if act is not None and box is not None and corners is not None:
            rows.append((k, act, box, corners))
    if not rows:
        return
    colours = [[*bytes.fromhex(colour_of(act.name)[1:])] for _, act, _, _ in rows]
    names = [f"{k} {act.name}" for k, act, _, _ in rows]
    thick = [k == step for k, *_ in rows]
    recording.log(
        "world/actions",
        rr.Boxes3D(
            centers=[box.centre for _, _, box, _ in rows],
            half_sizes=[box.half for _, _, box, _ in rows],
            quaternions=[[0.0, 0.0, np.sin(b.yaw / 2), np.cos(b.yaw / 2)] for _, _, b, _ in rows],
            colors=colours, labels=names, radii=[0.0012 if t else 0.0005 for t in thick],
            show_labels=True, fill_mode="majorwireframe",
        ),
    )  # fmt: skip
    flat = rr.Boxes2D(
        mins=[corners.min(0) for *_, corners in rows],
        sizes=[np.ptp(corners, axis=0) for *_, corners in rows],
        colors=colours, labels=names, radii=[1.6 if t else 0.8 for t in thick], show_labels=True,
    )  # fmt: skip
    for name in (name for name in _beds(story) if name != GOAL):
        recording.log(f"world/{name}/actions", flat)


def _arranged(rr: Any, story: Story) -> Any:
    """3-D on the left, images on the right, curves and words below."""
    import rerun.blueprint as rrb
    from rerun.blueprint import encodings

    beds = _beds(story)
    level, camera = story.level, story.camera
    x, y = (np.asarray(ray).reshape(-1)[[0, -1]] * level for ray in camera.rays())
    middle, size = np.array([x.mean(), y.mean(), level]), float(np.ptp(x) + np.ptp(y)) / 2
    eye = rrb.EyeControls3D(
        position=middle + size * np.array([0.0, 0.8, -0.85]), look_target=middle,
        eye_up=[0.0, 0.0, -1.0],
    )  # fmt: skip
    titles = {SEEN: "bed", PREDICTED: "predicted", GOAL: "goal"}
    solids = [
        rrb.Spatial3DView(
            origin="world", name=f"{titles[name]} in 3-D", eye_controls=eye, line_grid=False,
            contents=[f"world/{name}", f"world/{name}/depth", "world/actions"],
        )
        for name in beds
    ]  # fmt: skip
    flats = [rrb.Spatial2DView(origin=f"world/{name}", name=titles[name]) for name in beds]
    if story.goal is not None:
        flats += [
            rrb.Spatial2DView(origin=f"difference/{name}", name=f"{titles[name]} - goal")
            for name in beds
            if name != GOAL
        ]
    if PREDICTED in beds and story.is_run:
        flats.append(rrb.Spatial2DView(origin="difference/error", name="bed - predicted"))
    efforts = [m.effort_nm for m in story.moments if m.effort_nm is not None]
    curves = [_curves(rrb, "distance", "distance to the goal (mm)", _distances(story))]
    if efforts:
        curves.append(_curves(rrb, "effort", "effort (Nm)", efforts))
    body = encodings.TextLogColumn(encodings.TextLogColumnKind.Body)
    words = rrb.Tabs(
        rrb.TextLogView(
            origin="log", name="actions", columns=rrb.TextLogColumns(text_log_columns=[body])
        ),
        rrb.TextDocumentView(origin="words", name="how it ended"),
    )
    columns = 2 if len(flats) > 1 else 1
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(
                rrb.Tabs(*solids, active_tab=0), rrb.Grid(*flats, grid_columns=columns),
                column_shares=[3, 2],
            ),
            rrb.Horizontal(*curves, words),
            row_shares=[3, 1],
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, fps=1.0),
    )  # fmt: skip


def _curves(rrb: Any, origin: str, name: str, values: list[float]) -> Any:
    """A view of curves from 0 to a little above the largest value."""
    top = 1.1 * max(values, default=0.0) or 1.0
    axis = rrb.ScalarAxis(range=(0.0, top), zoom_lock=True)
    return rrb.TimeSeriesView(origin=origin, name=name, axis_y=axis)


def _distances(story: Story) -> list[float]:
    known = [d for m in story.moments for d in (m.seen_mm, m.predicted_mm)]
    return [d for d in known if d is not None]


def _rerun() -> Any:
    try:
        import rerun
    except ImportError as problem:
        raise JShapeError(
            f"Rerun recordings need rerun-sdk, which does not import ({problem}): "
            "pip install 'jshape[rerun]'"
        ) from None
    return rerun
