"""Folders of frames before and after each action, as people keep them.

`camera.json`, and `NAME_before.png` beside `NAME_after.png` or `before/NAME.png` and
`after/NAME.png`: 16-bit counts, 0 = no reading (TIFF, NPY and 8-bit luminance are read as well).
"""

import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jshape.camera import Camera
from jshape.data.annotate import Box, find_effect, provisional_box
from jshape.data.depth import to_metres
from jshape.data.missing import only_readings
from jshape.data.moved import TURNED_DEG, moved
from jshape.data.pair_view import PairView, pair_view
from jshape.data.segment import BLOCK, thumbnail
from jshape.errors import BadDataset
from jshape.io.cameras import CAMERA, read_camera
from jshape.io.files import as_error
from jshape.io.folders import folder_of
from jshape.io.formats import SUFFIXES, read_array
from jshape.io.images import read_depth, to_counts
from jshape.io.recordings import by_number

STATES = ("before", "after")


class BeforeAfter(NamedTuple):
    """Two frames of one name."""

    name: str
    prior: np.ndarray
    posterior: np.ndarray
    box: Box
    """Around all that changed, to start from; the whole image where nothing did."""


def before_after_files(source: str | os.PathLike) -> dict[str, tuple[Path, Path]]:
    """The two files of every name, in order of their names and the numbers in them.

    Raises BadDataset: no such folder, no frames, a name with one frame only or with two of a kind.
    """
    with as_error(BadDataset):
        source = folder_of(source, "a source of frames")
    found: dict[str, dict[str, Path]] = {}
    for state in STATES:
        within = source / state
        if within.is_dir():
            files = [(p.stem, p) for p in sorted(within.iterdir())]
        else:
            end = f"_{state}"
            files = [(p.stem.removesuffix(end), p) for p in sorted(source.iterdir())]
            files = [(name, path) for name, path in files if name != path.stem]
        for name, path in files:
            if path.suffix.lower() not in SUFFIXES or not path.is_file() or name.startswith("."):
                continue
            other = found.setdefault(name, {}).setdefault(state, path)
            if other != path:
                raise BadDataset(f"{path}: {other.name} is there as well; keep one of them")
    for paths in found.values():
        if len(paths) == 1:
            ((state, path),) = paths.items()
            lacking = STATES[1 - STATES.index(state)]
            raise BadDataset(f"{path}: has no frame {lacking} the action")
    if not found:
        raise BadDataset(
            f"{source}: holds no frames; expected NAME_before.png and NAME_after.png, or "
            "before/NAME.png and after/NAME.png"
        )
    names = sorted(found, key=by_number)
    return {name: (found[name]["before"], found[name]["after"]) for name in names}


def before_after_view(
    source: str | os.PathLike,
    files: dict[str, tuple[Path, Path]],
    camera: str | os.PathLike | None = None,
    like: tuple[Camera, float] | None = None,
) -> PairView:
    """How the frames of such a folder are seen: the bed is found in the first one.

    `files` are those of `before_after_files`; `camera` is the camera.json, if it is not the
    folder's own; `like` is that of `pair_view`.

    Raises:
      BadDataset: no camera.json, or as `before_after_pairs` of the first frame.
      BadCamera: it makes no sense.
      BadImage: no bed is found.
    """
    path = Path(source) / CAMERA if camera is None else Path(camera)
    if not path.is_file():
        raise BadDataset(f"{path}: no such file; it (or --camera FILE) says what the frames mean")
    with as_error(BadDataset):
        found, unit = read_camera(path)
    first = next(iter(files.values()))[0]
    return pair_view([(found, unit)], [_counts(first, found, unit, None)], str(first), like)


def before_after_pairs(
    files: dict[str, tuple[Path, Path]],
    seen: PairView,
    left_out: Counter[str] | None = None,
) -> Iterator[BeforeAfter]:
    """The frames of every name, one pair at a time; why pixels are no readings adds to `left_out`.

    Raises BadDataset: a frame that cannot be read, has another size than the camera, or no reading;
    of a camera that moved, unless it looks straight down.
    """
    camera, first = seen.camera, None
    ((source, unit),) = seen.sources
    for name, paths in files.items():
        own = [_counts(path, source, unit, left_out) for path in paths]
        if seen.view is not None:
            for path, counts in zip(paths, own, strict=True):
                depth = to_metres(thumbnail(counts), unit, str(path))
                first = depth if first is None else first
                how = moved(first, depth, source, BLOCK)
                if how and how.turned_deg > TURNED_DEG:
                    raise BadDataset(f"{path}: {how.said('the first frame')}: the camera moved")
        prior, posterior = (
            seen.counts([counts], str(path)) for counts, path in zip(own, paths, strict=True)
        )
        effect = find_effect(prior, posterior, seen.depth_unit, hidden=seen.camera.orthographic)
        box = provisional_box(effect, camera.shape) if effect.box else None
        yield BeforeAfter(name, prior, posterior, box or (0, 0, camera.width, camera.height))


def _counts(
    path: Path, camera: Camera, depth_unit: float, left_out: Counter[str] | None
) -> np.ndarray:
    with as_error(BadDataset):
        raw = read_array(path)
        how = {"depth_unit": depth_unit, "camera": camera, "left_out": left_out}
        depth = read_depth(path, raw=raw, check_range=False, **how)
        if raw.dtype == np.uint16:
            return only_readings(raw)
        return to_counts(depth, depth_unit, str(path))
