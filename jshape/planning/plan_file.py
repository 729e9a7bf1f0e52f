"""Plans on disk: one JSON file, readable by people, complete for the program.

The images ride along as one line of compressed bytes (`images`), so that a plan read back has the
same predicted images to the last bit.
"""

import base64
import io
import os
from typing import Any

import numpy as np

from jshape.camera import Camera
from jshape.data.view import View
from jshape.errors import BadCamera, BadFile, is_name, one_line, quoted
from jshape.io.arrays import read_arrays
from jshape.io.cameras import camera_fields, camera_from
from jshape.io.files import read_json, write_json
from jshape.planning.search.base import Status

FORMAT = "jshape-plan"
VERSION = 1
IMAGES_LIMIT = 1024 * 2**20
"""Most bytes that the images of a plan may unpack to, whatever sizes it says."""

_WORDS = {dict: "an object", list: "a list", str: "text", int: "a whole number"}
_LARGEST = float(np.finfo(np.float32).max)
_SMALLEST = float(np.finfo(np.float32).smallest_subnormal)
_HALF_TURN = float(np.float32(np.pi))


def plan_fields(plan: Any) -> dict[str, Any]:
    """What a plan says, as plain values that JSON can hold (without its images)."""
    own, distances_mm = plan.camera_positions, plan.distances_mm
    return {
        "format": FORMAT,
        "version": VERSION,
        "status": plan.status.name,
        "steps": [
            {
                "action": name,
                "position": [int(x) for x in plan.positions[k]],
                "camera_position": [int(x) for x in own[k]],
                "offset": [float(x) for x in plan.offsets[k]],
                "roi": [int(x) for x in plan.rois[k]],
                "strength": float(plan.strengths[k]),
                "yaw": float(plan.yaws[k]),
                "clipped": float(plan.clipped[k]),
                "distance_mm": float(distances_mm[k + 1]),
            }
            for k, name in enumerate(plan.actions)
        ],
        "distances": [float(x) for x in plan.distances],
        "distances_mm": [float(x) for x in distances_mm],
        "evaluations": int(plan.evaluations),
        "seconds": float(plan.seconds),
        "filled": [int(x) for x in plan.filled],
        "clamped": [int(x) for x in plan.clamped],
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
        arrays |= {f"patch_{k}": patch for k, patch in enumerate(plan.patches)}
        stream = io.BytesIO()
        packed = {name: np.asarray(array, np.float32) for name, array in arrays.items()}
        np.savez_compressed(stream, allow_pickle=False, **packed)
        fields["images"] = base64.b64encode(stream.getvalue()).decode()
    write_json(path, fields)


def read_plan(path: str | os.PathLike) -> dict[str, Any]:
    """The fields of a `Plan` that `write_plan` wrote.

    What follows from the rest (`distances_mm`, `camera_position`) is not read but made again.

    Raises:
      BadFile: not a plan, from a newer version, or damaged.
    """
    where = str(path)
    fields = read_json(path)
    if fields.get("format") != FORMAT:
        raise BadFile(f"{where}: format is {quoted(fields.get('format'))}; expected {FORMAT!r}")
    version = fields.get("version")
    if type(version) is not int or not 1 <= version <= VERSION:
        raise BadFile(f"{where}: version is {quoted(version)}; this program reads up to {VERSION}")
    camera = _camera(fields, "camera", where)
    steps = [
        _step(step, camera, f"{where}: step {k + 1}")
        for k, step in enumerate(_take(fields, "steps", list, where))
    ]
    distances = _take(fields, "distances", list, where)
    if len(distances) != len(steps) + 1:
        raise BadFile(
            f"{where}: has {len(distances)} distances; {len(steps)} steps need {len(steps) + 1}"
        )
    status = _take(fields, "status", str, where)
    if status not in Status.__members__:
        allowed = ", ".join(Status.__members__)
        raise BadFile(f"{where}: status is {quoted(status)}; allowed: {allowed}")
    evaluations = _take(fields, "evaluations", int, where)
    if evaluations < 0:
        raise BadFile(f"{where}: evaluations is {quoted(evaluations)}; expected a count from 0")
    rois = [step["roi"] for step in steps]
    return dict(
        camera=camera,
        actions=tuple(step["action"] for step in steps),
        positions=np.array([step["position"] for step in steps], np.int32).reshape(-1, 2),
        rois=np.array(rois, np.int32).reshape(-1, 2),
        distances=np.array(
            [
                _number(x, (0.0, _LARGEST), f"{where}: distance {k}")
                for k, x in enumerate(distances)
            ],
            np.float32,
        ),
        status=Status[status],
        evaluations=evaluations,
        # Older plans lack this, their steps a strength, a yaw and an offset.
        seconds=_number(fields.get("seconds", 0.0), (0.0, _LARGEST), f"{where}: seconds"),
        strengths=np.array([step["strength"] for step in steps], np.float32),
        yaws=np.array([step["yaw"] for step in steps], np.float32),
        offsets=np.array([step["offset"] for step in steps], np.float32).reshape(-1, 2),
        clipped=np.array([step["clipped"] for step in steps], np.float32),
        filled=_pair(fields.get("filled"), f"{where}: filled"),
        # Older plans have neither this nor a view.
        clamped=_pair(fields.get("clamped", [0, 0]), f"{where}: clamped"),
        view=_view(fields, camera, where),
        **_images(fields, camera, rois, where),
    )


def _step(step: Any, camera: Camera, where: str) -> dict[str, Any]:
    """A step's fields, in types that fit their arrays; its ROI lies inside the image."""
    if type(step) is not dict:
        raise BadFile(f"{where}: is {quoted(step)}; expected an object")
    action = _take(step, "action", str, where)
    if not is_name(action):
        raise BadFile(f"{where}: action is {quoted(action)}; expected a line of text")
    u, v = _pair(step.get("position"), f"{where}: position")
    w, h = _pair(step.get("roi"), f"{where}: roi", least=1)
    left, top = u - w // 2, v - h // 2
    if min(left, top) < 0 or left + w > camera.width or top + h > camera.height:
        raise BadFile(f"{where}: its ROI leaves the {camera.width}x{camera.height} image")
    if "camera_position" in step:
        _pair(step["camera_position"], f"{where}: camera_position", least=None)
    offset = step.get("offset", [0.0, 0.0])
    if type(offset) is not list or len(offset) != 2:
        raise BadFile(f"{where}: offset is {quoted(offset)}; expected two numbers")
    numbers = {
        "strength": (step.get("strength", 1.0), (_SMALLEST, _LARGEST)),
        "yaw": (step.get("yaw", 0.0), (-_HALF_TURN, _HALF_TURN)),
        "clipped": (step.get("clipped"), (0.0, 1.0)),
    }
    return {
        "action": action,
        "position": (u, v),
        "roi": (w, h),  # of a turned hand a square
        "offset": [_number(x, (-1.0, 1.0), f"{where}: offset") for x in offset],
        **{name: _number(x, span, f"{where}: {name}") for name, (x, span) in numbers.items()},
    }


def _view_fields(view: View) -> dict[str, Any]:
    return {
        "source": camera_fields(view.source),
        "window": None if view.window is None else [int(x) for x in view.window],
        "rise": float(view.rise),
    }


def _view(fields: dict[str, Any], target: Camera, where: str) -> View | None:
    """How the frames became the plan's images.  The target is the plan's camera."""
    if fields.get("view") is None:
        return None
    view, where = _take(fields, "view", dict, where), f"{where}: view"
    source = _camera(view, "source", where)
    window = view.get("window")
    if window is not None:
        left, top = window = _pair(window, f"{where}: window")
        if left + target.width > source.width or top + target.height > source.height:
            raise BadFile(
                f"{where}: its window leaves the {source.width}x{source.height} image of its source"
            )
    rise = view.get("rise")
    # The bed, in the middle of the target's range, must be before the source as well.
    most = (float(target.z_min) + float(target.z_max)) / 2
    if type(rise) not in (int, float) or not -_LARGEST <= rise < most:
        raise BadFile(f"{where}: rise is {quoted(rise)}; expected metres, less than {most:g}")
    return View(source, target, window, float(rise))


def _images(
    fields: dict[str, Any], camera: Camera, rois: list[tuple[int, int]], where: str
) -> dict[str, Any]:
    """The plan's images, all of the sizes that the plan says; nothing if it has none."""
    if fields.get("images") is None:
        return {}
    text, where = _take(fields, "images", str, where), f"{where}: images"
    try:
        data = base64.b64decode(text, validate=True)
    except ValueError as problem:
        raise BadFile(f"{where}: not base64: {one_line(problem)}") from None
    shapes = {"initial": camera.shape} | {f"patch_{k}": (h, w) for k, (w, h) in enumerate(rois)}
    # Four bytes a pixel and a header each, the goal included: a bomb is not unpacked.
    pixels = 2 * camera.width * camera.height + sum(w * h for w, h in rois)
    most = min(4 * pixels + 4096 * (len(shapes) + 1), IMAGES_LIMIT)
    arrays = read_arrays(data, where, most)
    if "goal" in arrays:
        shapes["goal"] = camera.shape
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
        "patches": tuple(arrays[f"patch_{k}"] for k in range(len(rois))),
    }


def _camera(fields: dict[str, Any], name: str, where: str) -> Camera:
    try:
        return camera_from(_take(fields, name, dict, where), f"{where}: {name}")
    except BadCamera as problem:
        raise BadFile(str(problem)) from None


def _take(fields: dict[str, Any], name: str, kind: type, where: str) -> Any:
    """A field of that very type: a bool is no int."""
    if name not in fields:
        raise BadFile(f"{where}: missing {name}")
    if type(fields[name]) is not kind:
        raise BadFile(f"{where}: {name} is {quoted(fields[name])}; expected {_WORDS[kind]}")
    return fields[name]


def _pair(value: Any, where: str, least: int | None = 0) -> tuple[int, int]:
    """Two whole numbers; the limits above are checked where they are known."""
    whole = type(value) is list and [type(x) for x in value] == [int, int]
    if not whole or (least is not None and min(value) < least):
        limit = "" if least is None else f" from {least}"
        raise BadFile(f"{where} is {quoted(value)}; expected two whole numbers{limit}")
    return value[0], value[1]


def _number(value: Any, span: tuple[float, float], where: str) -> float:
    least, most = span
    if type(value) not in (int, float) or not least <= value <= most:
        low = "above 0" if least == _SMALLEST else f"from {least:g}"
        raise BadFile(f"{where} is {quoted(value)}; expected a number {low} to {most:g}")
    return float(value)
