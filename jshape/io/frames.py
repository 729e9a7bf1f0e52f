"""Depth images that commands read: of which camera they are, and as frames in metres."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jshape._typing import Float
from jshape.camera import PRESETS, Camera, check_camera, window_of
from jshape.data.depth import check_depth
from jshape.data.intrinsics import within
from jshape.errors import BadCamera, BadImage
from jshape.io import cameras, formats, images, points
from jshape.io.cameras import CAMERA, Source, described, described_beside
from jshape.io.folders import folder_of
from jshape.io.recordings import open_recording
from jshape.models.bank import Bank


def source_of(
    initial: Path,
    shape: tuple[int, ...],
    given: str | None,
    bank: Bank,
    depth_unit: float | None = None,
) -> Source:
    """The camera of the images: named, found beside them, or guessed from their size.

    Its unit is `depth_unit`, else what its camera.json says; only a guess or a preset needs none.

    Raises:
      BadCamera: neither a preset nor a camera.json.
      BadImage: nothing says whose size this is.
    """
    assumed = "" if depth_unit else f", {cameras.DEPTH_UNIT:g} m per count (--depth-unit)"
    found = described_beside(initial, depth_unit) if given is None else described(given, depth_unit)
    if found is not None:
        return found if found.stated else found._replace(said=found.said + assumed)
    for name, camera in {"the bank's own": bank.camera, **PRESETS}.items():
        if shape == camera.shape and window_of(bank.camera, camera) is not None:
            said = f"{name}, guessed from the size {shape[1]}x{shape[0]}; --camera says otherwise"
            return Source(camera, depth_unit or cameras.DEPTH_UNIT, said + assumed, False)
    raise BadImage(
        f"{initial}: has {shape} (rows, columns); the bank's camera makes {bank.camera.shape}; "
        "describe your camera in a camera.json beside the image, or name one with --camera"
    )


def goal_source(path: Path, now: Source, folder: Path | None) -> Source:
    """The camera of a frame that is wanted: what its own folder says, else that of the frame `now`.

    A point cloud is seen by the latter.  `folder` is the one that `now` speaks for; None: of no
    file.  Raises BadCamera, BadFile: a camera.json that is none.
    """
    here = folder is not None and path.parent.resolve() == folder.resolve()
    if path.suffix.lower() in points.SUFFIXES or here:
        return now
    return described_beside(path) or now


def frame_of(
    path: Path,
    source: Source,
    *,
    raw: np.ndarray | None = None,
    left_out: Counter[str] | None = None,
) -> np.ndarray:
    """A depth image or point cloud as a frame (H, W) of its camera, metres; NaN: no reading.

    A guessed camera's range says nothing of a bed at another height; a stated one's does, and it
    is what tells a wrong unit.  `raw` is what is in the file, where it was read already; `left_out`
    adds up why pixels are no readings.

    Raises BadFile, BadImage, BadCamera: it cannot be read, or is no depth image of this camera.
    """
    camera = check_camera(source.camera)
    if path.suffix.lower() in points.SUFFIXES:
        return points.read_cloud(path, camera, check_range=source.stated)
    raw, unit = formats.read_array(path) if raw is None else raw, source.depth_unit
    depth = images.read_depth(
        path, raw=raw, camera=camera, depth_unit=unit, check_range=False, left_out=left_out
    )
    if source.stated:
        hint = f"; if the bed is there, z_min and z_max of {source.said} must say so"
        counts = unit if raw.dtype == np.uint16 else None
        check_depth(depth, camera, str(path), counts, hint=hint)
    return depth


class CameraFrames(NamedTuple):
    """What one camera took of a resting bed."""

    camera: Camera
    depths: Float[np.ndarray, "T H W"]
    """Metres, NaN: no reading."""
    name: str
    """Of the first file."""
    said: str
    """How the camera is known, for people."""

    @property
    def named(self) -> str:
        """All frames, for people."""
        return self.name + (f" and {len(self.depths) - 1} more" if len(self.depths) > 1 else "")


def read_looks(
    paths: Sequence[Path], camera_files: Sequence[str] = (), depth_unit: float | None = None
) -> list[CameraFrames]:
    """The frames of one camera, or of several one each.

    Args:
      paths: depth images, or folders of recordings, all frames of which are taken.
      camera_files: camera.json or presets: one for all paths, or one for each.  None: the
        camera.json beside each; those that say the same are one camera.
      depth_unit: metres per count, instead of theirs.

    Raises:
      BadCamera: no camera is described, or not as many as there are paths.
      BadFile, BadImage, BadDataset: frames that cannot be read, or are not of their camera.
    """
    if len(camera_files) > 1 and len(camera_files) != len(paths):
        raise BadCamera(
            f"{len(paths)} frames and {len(camera_files)} camera files; give one camera file for "
            "all frames, or one for each"
        )
    given = [described(one, depth_unit) for one in camera_files]
    for path in () if camera_files else paths:
        if path.is_dir():
            folder_of(path, "a recording", CAMERA)
        if (found := described_beside(path, depth_unit)) is None:
            raise BadCamera(
                f"{path}: no {CAMERA} beside it says which camera took it; write one, or name one "
                "with --camera-file"
            )
        given.append(found)
    if all(one[:2] == given[0][:2] for one in given):
        return [_frames_of(given[0], paths)]
    return [_frames_of(one, [path]) for one, path in zip(given, paths, strict=True)]


def _frames_of(one: Source, paths: Sequence[Path]) -> CameraFrames:
    folders = [open_recording(p, allow_gaps=True).files if p.is_dir() else (p,) for p in paths]
    how = {"camera": one.camera, "depth_unit": one.depth_unit, "check_range": False}
    depths = [images.read_depth(file, **how) for files in folders for file in files]
    return CameraFrames(one.camera, np.stack(depths), str(paths[0]), one.said)


def part_of(
    frame: np.ndarray,
    window: tuple[int, int, int, int] | None,
    depth_range: tuple[float, float] | None,
    camera: Camera,
) -> np.ndarray:
    """A frame (H, W) in metres of which only a part is the bed; the rest becomes no reading.

    Raises:
      BadCamera: the window leaves the image, or the range does not rise.
      BadImage: nothing is left.
    """
    kept = np.array(frame, np.float32)
    if window is not None:
        left, top, width, height = window
        camera.crop(left, top, width, height)
        outside = np.ones(kept.shape, bool)
        outside[top : top + height, left : left + width] = False
        kept[outside] = np.nan
    if depth_range is not None:
        within(camera, depth_range)
        with np.errstate(invalid="ignore"):
            kept[(kept < depth_range[0]) | (kept > depth_range[1])] = np.nan
    if not np.isfinite(kept).any():
        raise BadImage("no reading lies within the --window and --depth-range that were given")
    return kept
