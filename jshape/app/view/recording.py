"""An episode as a Rerun recording (`.rrd`): everything on one timeline, arranged when it opens."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from jshape.app.pictures import colour_of, differing
from jshape.app.view.episode import Episode, EpisodeStep
from jshape.errors import BadFile, JShapeError, needs
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
AROUND = [0, 1, 3, 2, 0, 4, 5, 1, 5, 7, 3, 7, 6, 2, 6, 4]
"""Corners of a box in an order that draws each of its edges."""
LINES = {"obtained": (214, 39, 40), "predicted": (31, 119, 180), "effort": (44, 160, 44)}


def write_recording(path: str | os.PathLike, episode: Episode, *, overwrite: bool = False) -> Path:
    """Write an episode as a Rerun recording, whole or not at all.

    Raises:
      JShapeError: the file cannot be written there, or rerun is not installed.
    """
    path = check_target(path, overwrite)
    with needs("rerun", "a Rerun recording"):
        import rerun as rr
    recording = rr.RecordingStream("jshape", send_properties=False)
    recording.set_log_time_enabled(False)
    recording.set_log_tick_enabled(False)
    stream = recording.binary_stream()
    recording.send_blueprint(_arranged(rr, episode))
    _always(rr, recording, episode)
    for step, one in enumerate(episode.steps):
        recording.set_time(TIMELINE, sequence=step)
        _at(rr, recording, episode, step, one)
    content = stream.read()
    recording.disconnect()
    if not content:
        raise JShapeError("rerun gave no recording")
    return write_atomic(path, content)


def check_target(path: str | os.PathLike, overwrite: bool) -> Path:
    """The file as a path, if `write_recording` may write it: call it before long work."""
    path = Path(path)
    if path.suffix.lower() != SUFFIX:
        raise BadFile(f"{path}: a Rerun recording ends in {SUFFIX}")
    if os.path.lexists(path) and not overwrite:
        raise BadFile(
            f"{path}: the file exists; choose another name, or replace it with --overwrite"
        )
    return path


def _beds(episode: Episode) -> tuple[str, ...]:
    known = {
        SEEN: any(one.seen is not None for one in episode.steps),
        PREDICTED: any(one.predicted is not None for one in episode.steps),
        GOAL: episode.goal is not None,
    }
    return tuple(name for name, is_there in known.items() if is_there)


def _always(rr: Any, recording: Any, episode: Episode) -> None:
    """What does not change: cameras, the goal, how curves look."""
    camera, level = episode.camera, episode.level
    # X right, Y towards who looks, Z down: the camera looks straight down.
    recording.log("world", rr.ViewCoordinates.RBD, static=True)
    for name in _beds(episode):
        pinhole = rr.Pinhole(
            resolution=[camera.width, camera.height],
            # Of parallel rays, which there are none of here: right at the bed's level.
            focal_length=[float(n) * level for n in camera.scale(level)],
            principal_point=[float(camera.u0), float(camera.v0)],
            image_plane_distance=0.1 * level,
        )
        recording.log(f"world/{name}", pinhole, static=True)
    if episode.goal is not None:
        recording.log(f"world/{GOAL}/depth", _depth(rr, episode, episode.goal), static=True)
    for name, colour in LINES.items():
        where = f"effort/{name}" if name == "effort" else f"distance/{name}"
        recording.log(where, rr.SeriesLines(colors=[colour], names=[name], widths=[2]), static=True)
        points = rr.SeriesPoints(colors=[colour], names=[name], marker_sizes=[4])
        recording.log(where, points, static=True)
    told = "\n\n".join([episode.title, *episode.notes])  # plain: Markdown fetches pictures
    recording.log("words", rr.TextDocument(told), static=True)


def _at(rr: Any, recording: Any, episode: Episode, step: int, one: EpisodeStep) -> None:
    for name, depth in ((SEEN, one.seen), (PREDICTED, one.predicted)):
        if depth is None:
            continue
        recording.log(f"world/{name}/depth", _depth(rr, episode, depth))
        gap = episode.too_high_mm(depth, episode.goal)
        if gap is not None:
            recording.log(f"difference/{name}", _picture(rr, episode, gap))
    error = episode.too_high_mm(one.seen, one.predicted)
    if error is not None:
        recording.log("difference/error", _picture(rr, episode, error))
    _log_boxes(rr, recording, episode, step)
    numbers = {
        "distance/obtained": one.seen_mm,
        "distance/predicted": one.predicted_mm,
        "effort/effort": one.effort_nm,
    }
    for where, value in numbers.items():
        if value is not None:
            recording.log(where, rr.Scalars(value))
    recording.log("log", rr.TextLog(episode.words(step), level="INFO"))


def _depth(rr: Any, episode: Episode, depth: np.ndarray) -> Any:
    heights, scale = episode.heights, 1 / DEPTH_UNIT
    near, far = (episode.level - mm / 1e3 for mm in (heights.high, heights.low))
    counts = to_counts(depth, DEPTH_UNIT)
    ends = [near * scale, far * scale]
    return rr.DepthImage(counts, meter=scale, colormap="viridis", depth_range=ends)


def _picture(rr: Any, episode: Episode, gap_mm: np.ndarray) -> Any:
    return rr.Image(differing(gap_mm, episode.differences)).compress(QUALITY)


def _log_boxes(rr: Any, recording: Any, episode: Episode, step: int) -> None:
    """Numbered boxes of the actions so far, the last one thick; at the start, of all of them."""
    known = [(k, action, episode.box(k)) for k, action in enumerate(episode.actions(step), 1)]
    rows = [(k, action, box) for k, action, box in known if box is not None]
    if not rows:
        return
    boxes, thick = [box for *_, box in rows], np.array([k == step for k, *_ in rows])
    colours = [int(colour_of(action.action)[1:] + "ff", 16) for _, action, _ in rows]
    names = [f"{k} {action.action}" for k, action, _ in rows]
    look = {"colors": np.array(colours, np.uint32), "labels": names, "show_labels": True}
    radii = np.where(thick, 0.0012, 0.0005)
    solid = rr.LineStrips3D([box[AROUND] for box in boxes], radii=radii, **look)
    recording.log("world/actions", solid)
    corners = np.array([action.outline for _, action, _ in rows])
    low, size = corners.min(1), np.ptp(corners, axis=1)
    flat = rr.Boxes2D(mins=low, sizes=size, radii=np.where(thick, 1.6, 0.8), **look)
    ends = np.array([action.ends for _, action, _ in rows])
    arrows = rr.Arrows2D(
        origins=ends[:, 0], vectors=ends[:, 1] - ends[:, 0], radii=2.0, colors=look["colors"]
    )
    for name in (name for name in _beds(episode) if name != GOAL):
        recording.log(f"world/{name}/actions", flat)
        if np.ptp(ends, axis=1).any():
            recording.log(f"world/{name}/strokes", arrows)


def _arranged(rr: Any, episode: Episode) -> Any:
    """3-D on the left, images on the right, curves and words below."""
    import rerun.blueprint as rrb
    from rerun.blueprint import encodings

    beds = _beds(episode)
    titles = {SEEN: "bed", PREDICTED: "predicted", GOAL: "goal"}
    solids = [_solid(rrb, episode, name, titles[name]) for name in beds]
    flats = [rrb.Spatial2DView(origin=f"world/{name}", name=titles[name]) for name in beds]
    if episode.goal is not None:
        flats += [
            rrb.Spatial2DView(origin=f"difference/{name}", name=f"{titles[name]} - goal")
            for name in beds
            if name != GOAL
        ]
    if PREDICTED in beds and episode.is_run:
        flats.append(rrb.Spatial2DView(origin="difference/error", name="bed - predicted"))
    distances = [d for one in episode.steps for d in (one.seen_mm, one.predicted_mm)]
    curves = [_curves(rrb, "distance", "distance to the goal (mm)", distances)]
    efforts = [one.effort_nm for one in episode.steps]
    if any(effort is not None for effort in efforts):
        curves.append(_curves(rrb, "effort", "effort (Nm)", efforts))
    body = encodings.TextLogColumn(encodings.TextLogColumnKind.Body)
    column = rrb.TextLogColumns(text_log_columns=[body])
    words = rrb.Tabs(
        rrb.TextLogView(origin="log", name="actions", columns=column),
        rrb.TextDocumentView(origin="words", name="how it ended"),
    )
    grid = rrb.Grid(*flats, grid_columns=2 if len(flats) > 1 else 1)
    above = rrb.Horizontal(rrb.Tabs(*solids, active_tab=0), grid, column_shares=[3, 2])
    return rrb.Blueprint(
        rrb.Vertical(above, rrb.Horizontal(*curves, words), row_shares=[3, 1]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, fps=1.0),
    )


def _solid(rrb: Any, episode: Episode, name: str, title: str) -> Any:
    """A view of a bed in 3-D with the boxes of the actions, from above its lower edge."""
    level = episode.level
    x, y = (np.asarray(ray).reshape(-1)[[0, -1]] for ray in episode.camera.rays(level))
    middle, size = np.array([x.mean(), y.mean(), level]), float(np.ptp(x) + np.ptp(y)) / 2
    eye = rrb.EyeControls3D(
        position=middle + size * np.array([0.0, 0.8, -0.85]),
        look_target=middle,
        eye_up=[0.0, 0.0, -1.0],
    )
    shown = [f"world/{name}", f"world/{name}/depth", "world/actions"]
    look = {"origin": "world", "contents": shown, "line_grid": False}
    return rrb.Spatial3DView(name=f"{title} in 3-D", eye_controls=eye, **look)


def _curves(rrb: Any, origin: str, name: str, values: list[float | None]) -> Any:
    """A view of curves from 0 to a little above the largest value."""
    top = 1.1 * max((x for x in values if x is not None), default=0.0) or 1.0
    axis = rrb.ScalarAxis(range=(0.0, top), zoom_lock=True)
    return rrb.TimeSeriesView(origin=origin, name=name, axis_y=axis)
