"""The frame that `jshape goal` makes a goal for: as a camera saw it, or from straight above."""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from jshape import sim
from jshape.camera import Camera
from jshape.cli.goal_options import GoalOptions
from jshape.data.intrinsics import within
from jshape.data.missing import fill_missing
from jshape.data.set_up import TILT_MOST_DEG
from jshape.data.simulate import DEPTH_UNIT
from jshape.data.view import View, tilt_deg
from jshape.errors import BadCamera
from jshape.io import formats, images
from jshape.io.frames import Source, frame_of, source_of
from jshape.io.maps import SUFFIX, read_map
from jshape.models.bank import Bank
from jshape.planning.maps import over_bed

FLAT = "flat"
"""The word for a simulated level bed, instead of a file."""


@dataclass(frozen=True, eq=False)
class GoalFrame:
    """A frame of the bed."""

    raw: np.ndarray
    """As it is stored."""
    depth: np.ndarray
    """(H, W) metres, NaN: no reading."""
    camera: Camera
    """Of `depth`, which may be a part of the frame, or the camera above a tilted bed."""
    source: Source
    """Of the whole frame."""
    left_out: Counter[str] = field(default_factory=Counter)
    """Why pixels are no readings."""
    taken: np.ndarray | None = None
    """(H, W) metres that the camera took, where `depth` is what is seen from above."""
    view: View | None = None
    """How that became `depth`."""

    def places(self, pixels: np.ndarray) -> np.ndarray:
        """Where pixels (N, 2) of (u, v) that the camera took are in `depth`, not rounded."""
        if self.view is None or self.taken is None:
            return pixels
        whole, _ = fill_missing(self.taken, limit=1.0, where="the bed")
        u, v = np.rint(np.asarray(pixels, float)).astype(int).T
        rows, columns = whole.shape
        return self.view.positions(
            pixels, whole[np.clip(v, 0, rows - 1), np.clip(u, 0, columns - 1)]
        )

    def drawing(self, drawn: np.ndarray) -> np.ndarray:
        """A drawing on the frame that the camera took (H, W) as it lies in `depth`; NaN: beside."""
        if self.view is None or drawn.shape != self.view.source.shape:
            return drawn
        whole, _ = fill_missing(self.depth, limit=1.0, where="the bed")
        return self.view.drawing(drawn, whole)


def frame_to_change(bed: str, options: GoalOptions, bank: Bank) -> GoalFrame:
    """The frame of the bed: a file's, a height map, or a simulated level one."""
    path = Path(bed)
    if bed == FLAT and not path.exists():
        if options.camera_file is not None:
            raise BadCamera("a simulated bed (flat) is the bundled camera's; leave --camera out")
        depth = np.asarray(sim.render(sim.flat_bed(), bank.camera))
        raw = images.to_counts(depth, DEPTH_UNIT)
        said = "the bundled bank's, above a simulated level bed"
        source = Source(bank.camera, DEPTH_UNIT, said, True)
        return GoalFrame(raw, raw * np.float32(DEPTH_UNIT), bank.camera, source)
    left_out: Counter[str] = Counter()
    if path.suffix.lower() == SUFFIX:
        seen = read_map(path)
        source = Source(seen.camera(), 1.0, "a height map", True)
        raw = depth = seen.depth(source.camera)
    else:
        raw = formats.read_array(path)
        source = source_of(path, raw.shape, options.camera_file, bank, options.depth_unit)
        # A goal may lie at any height.
        depth = frame_of(path, source._replace(stated=False), raw=raw, left_out=left_out)
    camera = within(source.camera, options.depth_range)
    if options.window:
        left, top, width, height = options.window
        camera = camera.crop(left, top, width, height)
        raw, depth = (x[top : top + height, left : left + width] for x in (raw, depth))
    if camera.orthographic or (camera.lens is None and tilt_deg(depth, camera) <= TILT_MOST_DEG):
        return GoalFrame(raw, depth, camera, source, left_out)
    view, _ = over_bed(bank, camera, depth, bed)
    if not view.above:
        return GoalFrame(raw, depth, camera, source, left_out)
    seen = view.depth(depth, bed).astype(np.float32)
    return GoalFrame(seen, seen, view.target, source, left_out, depth, view)
