"""The frames of `jshape heightmap`: which camera took each, and what they show in metres."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jshape._typing import Float
from jshape.camera import Camera
from jshape.errors import BadCamera
from jshape.io.cameras import CAMERA, Source, described, described_beside
from jshape.io.images import read_depth
from jshape.io.recordings import open_recording


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
    given = [described(one, depth_unit) for one in camera_files]
    if len(given) > 1 and len(given) != len(paths):
        raise BadCamera(
            f"{len(paths)} frames and {len(given)} camera files; give one camera file for all "
            "frames, or one for each"
        )
    if not given:
        given = [_beside(path, depth_unit) for path in paths]
    if len(given) == 1 or all(one[:2] == given[0][:2] for one in given):
        groups = [(given[0], list(paths))]
    else:
        groups = [(one, [path]) for one, path in zip(given, paths, strict=True)]
    return [_read(one, group) for one, group in groups]


def _read(one: Source, paths: Sequence[Path]) -> CameraFrames:
    files = [file for path in paths for file in _files(path)]
    depths = [
        read_depth(file, camera=one.camera, depth_unit=one.depth_unit, check_range=False)
        for file in files
    ]
    return CameraFrames(one.camera, np.stack(depths), str(paths[0]), one.said)


def _files(path: Path) -> Sequence[Path]:
    return open_recording(path, allow_gaps=True).files if path.is_dir() else (path,)


def _beside(path: Path, depth_unit: float | None) -> Source:
    found = described_beside(path, depth_unit)
    if found is None:
        raise BadCamera(
            f"{path}: no {CAMERA} beside it says which camera took it; write one, or name one "
            "with --camera-file"
        )
    return found
