"""Goals that are easy to make: a change of the bed's height, held to what the bed can give.

`bed_map(depth, camera)` is the bed seen from straight above.  A text, a mask, a height map, a
mesh (`reliefs`, then `placed`), another frame or the outcome of actions say what is wanted of it,
as metres up; `make_goal` clamps that to the material, the camera's range and the slopes that
stand, and `Goal.depth` is the depth image to plan for.  `report` says what is left out, and why;
`transport` how much material has to come from where.
"""

from jshape.goals.bedmap import BedMap, bed_map
from jshape.goals.goal import Goal, Limits, make_goal
from jshape.goals.placing import drawn_on_image, largest_size, placed
from jshape.goals.reliefs import (
    Relief,
    relief_of_heights,
    relief_of_mask,
    relief_of_solid,
    relief_of_text,
)
from jshape.goals.report import report
from jshape.goals.transport import Transport, transport

__all__ = [
    "BedMap",
    "Goal",
    "Limits",
    "Relief",
    "Transport",
    "bed_map",
    "drawn_on_image",
    "largest_size",
    "make_goal",
    "placed",
    "relief_of_heights",
    "relief_of_mask",
    "relief_of_solid",
    "relief_of_text",
    "report",
    "transport",
]
