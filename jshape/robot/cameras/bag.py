"""A camera over a ROS bag."""

import os

from jshape.camera import Camera
from jshape.data.intrinsics import Z_RANGE
from jshape.errors import one_line
from jshape.io.bags import open_bag
from jshape.robot.cameras.played import Played


def bag_camera(
    path: str | os.PathLike,
    *,
    topic: str | None = None,
    camera: tuple[Camera, float] | None = None,
    z_range: tuple[float, float] = Z_RANGE,
    depth_unit: float | None = None,
) -> Played:
    """The depth frames of a ROS 1, ROS 2 or MCAP bag, as fast as they are asked for.

    Args:
      path: a file, or the folder of a ROS 2 bag.
      topic: of the frames; None if there is only one depth topic.
      camera: intrinsics and metres per count instead of the bag's own.
      z_range: depths between which the bed lies, metres, where `camera` does not say.
      depth_unit: metres that 1 in the frames stands for, whatever else says it.

    Raises:
      JShapeError: as for `store.bags.open_bag`.
    """
    bag = open_bag(path, topic=topic, camera=camera, z_range=z_range, depth_unit=depth_unit)
    name = one_line(f"{bag.path.name} {bag.topic}", 120)
    count = bag.count or None
    return Played(name, bag.camera, bag.depth_unit, bag.frames(), count=count, close=bag.close)
