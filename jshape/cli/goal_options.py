"""The options of `jshape goal`."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from jshape import sim
from jshape.cli.names import Bank, Material, Preset
from jshape.cli.options import CameraFile, File, Part, Positive, Share, Writes, number, reads
from jshape.errors import quoted
from jshape.goals.goal import BALANCES
from jshape.planning.options import Constraints


def place(text: str) -> tuple[float, float]:
    """A pixel "U,V"."""
    try:
        u, v = (float(part) for part in text.split(","))
    except ValueError:
        u = v = math.nan
    if not (math.isfinite(u) and math.isfinite(v)):
        raise ValueError(f"{quoted(text)} is not a place like 240,197")
    return u, v


_degrees = number(float, lambda x: abs(x) <= 360, "a turn from -360 to 360 degrees")
_slope = number(float, lambda x: 0 < x <= 85, "a slope from 0 to 85 degrees")
Millimetres = Annotated[Positive, Parameter(metavar="MM")]


@dataclass(frozen=True, kw_only=True)
class GoalOptions(Part, Writes):
    """Of `jshape goal`."""

    text: Annotated[str | None, Parameter(metavar="WORD")] = None
    """Letters, sunk or raised."""
    mask: Annotated[str | None, File] = None
    """A drawing, bright on dark: what to sink or raise."""
    height_map: Annotated[str | None, File] = None
    """Grey levels between --depth-mm and --raise-mm, or metres (NPY)."""
    mesh: Annotated[str | None, File] = None
    """STL, OBJ or PLY, or a point cloud (PLY, PCD), seen from above."""
    frame: Annotated[str | None, File] = None
    """Another depth image of the same camera."""
    actions: Annotated[str | None, Parameter(metavar="LIST")] = None
    """What the bank predicts of 'knock 240,197; grasp 312,91x1.5@30' (u,v x strength @ degrees), of
    a JSON file or of a plan.json."""
    out: Path | None = None
    """Folder for goal, bed, camera.json and picture."""
    depth_mm: Millimetres | None = None
    """Sunk so deep (text, mask: 8)."""
    raise_mm: Millimetres | None = None
    """Raised so high."""
    at: Annotated[Any, reads(place, "U,V")] = None
    """Pixel of its middle (default: of the view)."""
    size_mm: Millimetres | None = None
    """Its longer side (default: six tenths of what fits; a mesh: its own)."""
    turn: Annotated[float, reads(_degrees, "DEG")] = 0.0
    """Clockwise as the camera sees it."""
    invert: bool = False
    """A drawing that is dark on bright."""
    mesh_unit: Literal["m", "cm", "mm", "inch"] | None = None
    """Of the mesh (default: guessed)."""
    mesh_up: Literal["x", "y", "z"] = "z"
    """Its axis that points up."""
    material: Material = "flour"
    """A name or FILE.toml: slopes are at most its angle of repose, and of frames and actions what
    it holds when pressed."""
    slope: Annotated[float | None, reads(_slope, "DEG")] = None
    """Steepest slope instead."""
    floor_mm: Millimetres = 1e3 * sim.DEPTH
    """How deep the material is."""
    balance: Annotated[
        list[Literal["around", "level"]] | None, Parameter(consume_multiple=(0, 1))
    ] = None
    """As much in as out: spread the rest around it (if nothing else is said), or move the level."""
    reachable: Annotated[Path | None, Parameter(metavar="MASK")] = None
    """Image that is not 0 where the bed may change."""
    camera_file: Annotated[Preset | None, CameraFile] = None
    """camera.json, or a preset's name (default: camera.json beside BED, else the bank's)."""
    depth_unit: Positive | None = None
    """Metres per count of 16-bit images."""
    bank: Bank | None = None
    """Name or folder, for --actions."""
    max_missing: Share = Constraints.max_missing
    """Largest share of pixels without depth to fill."""

    @property
    def balanced(self) -> str | None:
        """One of `BALANCES`, or None."""
        return None if self.balance is None else (*self.balance, BALANCES[0])[0]
