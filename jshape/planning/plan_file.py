"""Plans on disk: one JSON file, readable by people, complete for the program.

The images ride along as one line of compressed bytes (`images`), so that a plan read back has the
same predicted images to the last bit.
"""

import base64
import os
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar

import numpy as np

from jshape._typing import ArrayLike
from jshape.camera import Camera
from jshape.data.view import View
from jshape.errors import BadCamera, BadFile, one_line
from jshape.height_map import places_on
from jshape.io.arrays import npz_bytes, read_arrays
from jshape.io.cameras import camera_fields, camera_from
from jshape.io.files import as_error, read_json, write_json
from jshape.io.records import OneLine, Range, check_format, read_record
from jshape.planning.search.base import Status

FORMAT = "jshape-plan"
VERSION = 1
IMAGES_LIMIT = 1024 * 2**20
"""Most bytes that the images of a plan may unpack to, whatever sizes it says."""
STROKE_LIMIT = 1e5
"""Longest stroke of a plan, pixels."""

_SMALLEST = float(np.finfo(np.float32).smallest_subnormal)
_HALF_TURN = float(np.float32(np.pi))


def plan_fields(plan: Any) -> dict[str, Any]:
    """What a plan says, as plain values that JSON can hold (without its images)."""
    own, distances_mm = plan.camera_positions, plan.distances_mm
    halves = plan.distance_half_widths_mm
    on_map = places_on(plan.camera, plan.exact_positions).tolist()
    return {
        "format": FORMAT,
        "version": VERSION,
        "status": plan.status.name,
        "steps": [
            {
                "action": act.action,
                "position": [int(x) for x in plan.positions[k]],
                "camera_position": [int(x) for x in own[k]],
                "offset": [float(x) for x in plan.offsets[k]],
                "roi": list(act.roi),
                "strength": act.strength,
                "yaw": act.yaw,
                "length": act.length,
                "stroke": list(act.stroke),
                "clipped": float(plan.clipped[k]),
                "distance_mm": float(distances_mm[k + 1]),
                "spread": _known(plan.spreads[k]),
                "half_width_mm": None if halves is None else _known(halves[k + 1]),
            }
            | ({"map_m": on_map[k]} if plan.camera.orthographic else {})
            for k, act in enumerate(plan)
        ],
        "distances": [float(x) for x in plan.distances],
        "distances_mm": [float(x) for x in distances_mm],
        "evaluations": int(plan.evaluations),
        "seconds": float(plan.seconds),
        "filled": [int(x) for x in plan.filled],
        "clamped": [int(x) for x in plan.clamped],
        "notes": list(plan.notes),
        "camera": camera_fields(plan.camera),
        "view": None if plan.view is None else _view_fields(plan.view),
    }


def write_plan(path: str | os.PathLike, plan: Any, *, images: bool = True) -> None:
    """Write a plan as JSON, whole or not at all.

    Raises:
      BadFile: it cannot be written.
    """
    fields = plan_fields(plan)
    if images and plan.initial is not None:
        arrays = {"initial": plan.initial} | ({} if plan.goal is None else {"goal": plan.goal})
        arrays |= {} if plan.seen is None else {"seen": plan.seen}
        arrays |= {f"patch_{k}": patch for k, patch in enumerate(plan.patches)}
        packed = npz_bytes({name: np.asarray(array, np.float32) for name, array in arrays.items()})
        fields["images"] = base64.b64encode(packed).decode()
    write_json(path, fields)


@dataclass(frozen=True)
class StepFile:
    """An action of a plan.  In older plans they have the first four fields only."""

    allow_unknown: ClassVar[bool] = True

    action: Annotated[str, OneLine()]
    position: Annotated[tuple[int, int], Range(0)]
    roi: Annotated[tuple[int, int], Range(1)]
    """Of a turned hand a square."""
    clipped: Annotated[float, Range(0, 1)]
    strength: Annotated[float, Range(_SMALLEST)] = 1.0
    yaw: Annotated[float, Range(-_HALF_TURN, _HALF_TURN)] = 0.0
    offset: Annotated[tuple[float, float], Range(-1, 1)] = (0.0, 0.0)
    length: Annotated[float, Range(_SMALLEST)] = 1.0
    stroke: Annotated[tuple[float, float], Range(-STROKE_LIMIT, STROKE_LIMIT)] = (0.0, 0.0)
    spread: Annotated[tuple[float, float], Range(0, 1e6)] | None = None
    """(mm, share) of the interval of its prediction; None: not known."""
    camera_position: tuple[int, int] = (0, 0)


@dataclass(frozen=True)
class ViewFile:
    """How the frames became a plan's images."""

    source: dict
    window: Annotated[tuple[int, int], Range(0)] | None = None


@dataclass(frozen=True)
class PlanFile:
    """A plan.  Older ones have no seconds, clamped pixels and view."""

    allow_unknown: ClassVar[bool] = True

    camera: dict
    steps: list[StepFile]
    distances: list[Annotated[float, Range(0)]]
    status: Status
    evaluations: Annotated[int, Range(0)]
    filled: Annotated[tuple[int, int], Range(0)]
    clamped: Annotated[tuple[int, int], Range(0)] = (0, 0)
    seconds: Annotated[float, Range(0)] = 0.0
    notes: list[Annotated[str, OneLine(strict=False)]] = field(default_factory=list)
    view: ViewFile | None = None
    images: str | None = None

    def problem(self) -> str | None:
        """What no single field tells."""
        count, steps = len(self.distances), len(self.steps)
        if count == steps + 1:
            return None
        return f"has {count} distances; {steps} steps need {steps + 1}"


def read_plan(path: str | os.PathLike) -> dict[str, Any]:
    """The fields of a `Plan` that `write_plan` wrote.

    What follows from the rest (`distances_mm`, `half_width_mm`, `camera_position`, `map_m`) is not
    read.

    Raises:
      BadFile: not a plan, from a newer version, or damaged.
    """
    where, content = str(path), read_json(path)
    check_format(content, FORMAT, VERSION, where)
    found = read_record(PlanFile, content, where)
    camera, steps = _camera(found.camera, f"{where}: camera"), found.steps
    for k, step in enumerate(steps, 1):
        (u, v), (w, h) = step.position, step.roi
        left, top = u - w // 2, v - h // 2
        if min(left, top) < 0 or left + w > camera.width or top + h > camera.height:
            size = f"{camera.width}x{camera.height}"
            raise BadFile(f"{where}: step {k}: its ROI leaves the {size} image")

    def each(name: str, dtype: type, *shape: int) -> np.ndarray:
        return np.array([getattr(step, name) for step in steps], dtype).reshape(-1, *shape)

    return dict(
        camera=camera,
        actions=tuple(step.action for step in steps),
        positions=each("position", np.int32, 2),
        rois=each("roi", np.int32, 2),
        distances=np.array(found.distances, np.float32),
        status=found.status,
        evaluations=found.evaluations,
        seconds=found.seconds,
        strengths=each("strength", np.float32),
        yaws=each("yaw", np.float32),
        offsets=each("offset", np.float32, 2),
        lengths=each("length", np.float32),
        strokes=each("stroke", np.float32, 2),
        clipped=each("clipped", np.float32),
        spreads=np.array([step.spread or (np.nan, np.nan) for step in steps], np.float32).reshape(
            -1, 2
        ),
        filled=found.filled,
        clamped=found.clamped,
        notes=tuple(found.notes),
        view=None if found.view is None else _view(found.view, camera, f"{where}: view"),
        **_images(found.images, camera, [step.roi for step in steps], f"{where}: images"),
    )


def _known(numbers: ArrayLike) -> Any:
    """Numbers as JSON has them, which knows no NaN."""
    return np.asarray(numbers).tolist() if np.isfinite(numbers).all() else None


def _view_fields(view: View) -> dict[str, Any]:
    return {
        "source": camera_fields(view.source),
        "window": None if view.window is None else [int(x) for x in view.window],
    }


def _view(view: ViewFile, target: Camera, where: str) -> View:
    """How the frames became the plan's images.  The target is the plan's camera."""
    source = _camera(view.source, f"{where}: source")
    if view.window is not None:
        left, top = view.window
        if left + target.width > source.width or top + target.height > source.height:
            size = f"{source.width}x{source.height}"
            raise BadFile(f"{where}: its window leaves the {size} image of its source")
    return View(source, target, view.window)


def _images(
    text: str | None, camera: Camera, rois: list[tuple[int, int]], where: str
) -> dict[str, Any]:
    """The plan's images, all of the sizes that the plan says; nothing if it has none."""
    if text is None:
        return {}
    try:
        data = base64.b64decode(text, validate=True)
    except ValueError as problem:
        raise BadFile(f"{where}: not base64: {one_line(problem)}") from None
    shapes = {"initial": camera.shape} | {f"patch_{k}": (h, w) for k, (w, h) in enumerate(rois)}
    # Four bytes a pixel and a header each, goal and what was seen included: a bomb is not unpacked.
    pixels = 3 * camera.width * camera.height + sum(w * h for w, h in rois)
    most = min(4 * pixels + 4096 * (len(shapes) + 2), IMAGES_LIMIT)
    arrays = read_arrays(data, where, most)
    shapes |= {name: camera.shape for name in ("goal", "seen") if name in arrays}
    for name, shape in shapes.items():
        if name not in arrays:
            raise BadFile(f"{where}: has no {name}")
        array = arrays[name]
        if array.dtype != np.float32 or array.shape != shape:
            raise BadFile(
                f"{where}: {name} is {array.dtype} of shape {array.shape}; "
                f"expected float32 of {shape} (rows, columns)"
            )
        if not np.isfinite(array).all():
            raise BadFile(f"{where}: {name} holds NaN or infinity")
    return {
        "initial": arrays["initial"],
        "goal": arrays.get("goal"),
        "seen": None if "seen" not in arrays else arrays["seen"] > 0.5,
        "patches": tuple(arrays[f"patch_{k}"] for k in range(len(rois))),
    }


def _camera(content: dict[str, Any], where: str) -> Camera:
    with as_error(BadFile, BadCamera):
        return camera_from(content, where)
