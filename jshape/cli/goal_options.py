"""The options of `jshape goal`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from cyclopts import Parameter

from jshape import sim
from jshape.cli.names import Bank, Material, Preset
from jshape.cli.options import CameraFile, File, Part, Positive, Share, Writes, reads
from jshape.goals.goal import BALANCES
from jshape.planning.options import Constraints


def _place(text: str) -> tuple[float, float]:
    u, v = (float(part) for part in text.split(","))
    return u, v


Place = Annotated[Any, reads(_place, "U,V", "a place like 240,197", lambda p: np.isfinite(p).all())]
Degrees = Annotated[
    float, reads(float, "DEG", "a turn from -360 to 360 degrees", lambda x: abs(x) <= 360)
]
Slope = Annotated[float, reads(float, "DEG", "a slope from 0 to 85 degrees", lambda x: 0 < x <= 85)]
Millimetres = Annotated[Positive, Parameter(metavar="MM")]


@dataclass(frozen=True, kw_only=True)
class GoalOptions(Part, Writes):
    """Of `jshape goal`."""

    text: Annotated[str | None, Parameter(metavar="WORD")] = None
    """Letters to sink or raise."""
    mask: Annotated[str | None, File] = None
    """Drawing to sink or raise, bright on dark."""
    height_map: Annotated[str | None, File] = None
    """Height map: grey levels between --depth-mm and --raise-mm, or metres (NPY)."""
    mesh: Annotated[str | None, File] = None
    """Mesh (STL, OBJ, PLY) or point cloud (PLY, PCD), seen from above."""
    frame: Annotated[str | None, File] = None
    """Another depth image of the same camera."""
    actions: Annotated[str | None, Parameter(metavar="LIST")] = None
    """Actions whose predicted result is the goal: 'knock 240,197; grasp 312,91x1.5@30; sweep
    240,197@90 length 1.2' (u,v x strength @ degrees length times the trained), or a plan.json."""
    out: Path | None = None
    """Folder for goal, bed, camera.json and picture."""
    depth_mm: Millimetres | None = None
    """Depth below the bed, mm (default for text and mask: 8)."""
    raise_mm: Millimetres | None = None
    """Height above the bed, mm."""
    at: Place = None
    """Pixel of the relief's middle (default: the middle of the view)."""
    size_mm: Millimetres | None = None
    """Longer side of the relief, mm (default: six tenths of what fits; a mesh: its own)."""
    turn: Degrees = 0.0
    """Turn of the relief in degrees, clockwise as the camera sees it."""
    invert: bool = False
    """Take the drawing as dark on bright."""
    mesh_unit: Literal["m", "cm", "mm", "inch"] | None = None
    """Unit of the mesh (default: guessed)."""
    mesh_up: Literal["x", "y", "z"] = "z"
    """Axis of the mesh that points up."""
    material: Material = "flour"
    """Material of the bed, a name or FILE.toml: it limits slopes to its angle of repose, those of
    frames and actions to what it holds when pressed."""
    slope: Slope | None = None
    """Steepest slope in degrees (default: the material's)."""
    floor_mm: Millimetres = 1e3 * sim.DEPTH
    """Depth of the material, mm."""
    balance: Annotated[
        list[Literal["around", "level"]] | None, Parameter(consume_multiple=(0, 1))
    ] = None
    """Keep the volume: spread the rest around the relief (the default of --balance alone), or move
    the bed's level."""
    reachable: Annotated[Path | None, Parameter(metavar="MASK")] = None
    """Mask image, not 0 where the bed may change, or JSON: an area in metres of the arm's base or
    the map (default: everywhere)."""
    camera_file: Annotated[Preset | None, CameraFile] = None
    """camera.json, or a preset's name (default: camera.json beside BED, else the bank's)."""
    depth_unit: Positive | None = None
    """Metres per count of 16-bit images."""
    bank: Bank | None = None
    """Bank that predicts --actions: a bundled name or a folder (default: pressed-flour-robot)."""
    max_missing: Share = Constraints.max_missing
    """Largest share, 0 to 1, of pixels without a reading that may be filled."""

    @property
    def balanced(self) -> str | None:
        """One of `BALANCES`, or None."""
        return None if self.balance is None else (*self.balance, BALANCES[0])[0]
