"""Plans on disk: one JSON file, readable by people, complete for the program.

The images ride along as one line of compressed bytes (`images`), so that a plan read back has the
same predicted images to the last bit.
"""

import base64
import io
import os
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jshape.errors import BadFile, JShapeError
from jshape.planners.base import Status
from jshape.store.cameras import camera_fields, camera_from
from jshape.store.files import one_line, read_json, write_json

if TYPE_CHECKING:
    from jshape.planning import Plan

FORMAT = "jshape-plan"
VERSION = 1


def plan_fields(plan: "Plan") -> dict[str, Any]:
    """What a plan says, as plain values that JSON can hold (without its images)."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "status": plan.status.name,
        "steps": [
            {
                "action": name,
                "position": [int(x) for x in plan.positions[k]],
                "roi": [int(x) for x in plan.rois[k]],
                "clipped": float(plan.clipped[k]),
                "distance_mm": float(plan.distances_mm[k + 1]),
            }
            for k, name in enumerate(plan.actions)
        ],
        "distances": [float(x) for x in plan.distances],
        "distances_mm": [float(x) for x in plan.distances_mm],
        "evaluations": plan.evaluations,
        "filled": list(plan.filled),
        "camera": camera_fields(plan.camera),
    }


def write_plan(path: str | os.PathLike, plan: "Plan", *, images: bool = True) -> None:
    """Write a plan as JSON, whole or not at all.

    Raises:
      BadFile: it cannot be written.
    """
    fields = plan_fields(plan)
    if images and plan.initial is not None:
        stream = io.BytesIO()
        patches = {f"patch_{k}": patch for k, patch in enumerate(plan.patches)}
        np.savez_compressed(stream, allow_pickle=False, initial=plan.initial, **patches)
        fields["images"] = base64.b64encode(stream.getvalue()).decode()
    write_json(path, fields)


def read_plan(path: str | os.PathLike) -> "Plan":
    """Read a plan that `write_plan` wrote.

    Raises:
      BadFile: not a plan, from a newer version, or damaged.
    """
    from jshape.planning import Plan

    path = Path(path)
    fields = read_json(path)
    if fields.get("format") != FORMAT:
        raise BadFile(f"{path}: format is {fields.get('format')!r}; expected {FORMAT!r}")
    if type(fields.get("version")) is not int or not 1 <= fields["version"] <= VERSION:
        raise BadFile(
            f"{path}: version is {fields.get('version')!r}; this program reads up to {VERSION}"
        )
    try:
        steps = fields["steps"]
        plan = Plan(
            camera=camera_from(fields["camera"], str(path)),
            actions=tuple(str(step["action"]) for step in steps),
            positions=np.array([step["position"] for step in steps], np.int32).reshape(-1, 2),
            rois=np.array([step["roi"] for step in steps], np.int32).reshape(-1, 2),
            distances=np.array(fields["distances"], np.float32),
            status=Status[fields["status"]],
            evaluations=int(fields["evaluations"]),
            clipped=np.array([step["clipped"] for step in steps], np.float32),
            filled=(int(fields["filled"][0]), int(fields["filled"][1])),
            **_images(fields.get("images"), len(steps)),
        )
    except JShapeError:
        raise
    except (
        KeyError, TypeError, ValueError, IndexError, OSError, zipfile.BadZipFile
    ) as problem:  # fmt: skip
        raise BadFile(f"{path}: not a complete plan ({one_line(repr(problem))})") from None
    _check(plan, path)
    return plan


def _images(text: str | None, count: int) -> dict[str, Any]:
    if text is None:
        return {}
    with np.load(io.BytesIO(base64.b64decode(text, validate=True)), allow_pickle=False) as file:
        return {
            "initial": file["initial"],
            "patches": tuple(file[f"patch_{k}"] for k in range(count)),
        }


def _check(plan: "Plan", path: Path) -> None:
    """Sizes that must agree before anything indexes with them."""
    if plan.distances.shape != (len(plan) + 1,) or not np.isfinite(plan.distances).all():
        raise BadFile(f"{path}: {len(plan)} steps need {len(plan) + 1} finite distances")
    first = plan.positions - plan.rois // 2
    size = (plan.camera.width, plan.camera.height)
    if (plan.rois < 1).any() or (first < 0).any() or (first + plan.rois > size).any():
        raise BadFile(f"{path}: a step's ROI leaves the {size[0]}x{size[1]} image")
    if plan.initial is not None:
        shapes = [patch.shape[::-1] for patch in plan.patches]
        if plan.initial.shape != plan.camera.shape or shapes != [tuple(r) for r in plan.rois]:
            raise BadFile(f"{path}: its images do not have the sizes that its steps say")
