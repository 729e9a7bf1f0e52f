"""`jshape limit NOW WANTED`: how near any plan can come, where it cannot, and why."""

from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from jshape.cli.names import Preset, Uses
from jshape.cli.options import CameraFile, File, Part, Positive, Writes
from jshape.cli.plan import are_maps, beds_of, maps_of
from jshape.cli.search_options import Tries, tries_of
from jshape.cli.tables import print_table, write_pictures
from jshape.errors import BadFile
from jshape.planning import limit as limits
from jshape.planning.options import DEFAULT_BANK
from jshape.planning.options import options as keywords
from jshape.robot.learning import bank_of


@dataclass(frozen=True, kw_only=True)
class LimitOptions(Uses, Tries, Part, Writes):
    """Of `jshape limit`."""

    at_once = True

    out: Annotated[Path | None, File] = None
    """Picture (PNG) of what is wanted, what remains at best and why."""
    camera_file: Annotated[Preset | None, CameraFile] = None
    """camera.json, or a preset's name (default: camera.json beside NOW, else the bank's); of
    WANTED too, unless its own folder has one."""
    depth_unit: Positive | None = None
    """Metres per count of 16-bit images."""


def limit(now: Path, wanted: Path, /, options: LimitOptions = LimitOptions()) -> dict[str, Any]:
    """Read two images, find what every plan must leave, print and draw it.

    Args:
      now: Depth image now: 16-bit PNG, TIFF, NPY; or a height map (NPZ).
      wanted: The same wanted, or a point cloud (PLY, PCD).
    """
    if options.out is not None:
        if options.out.suffix.lower() != ".png":
            raise BadFile(f"{options.out}: a picture's file ends in .png")
        options.check_new(options.out)
    bank_name = str(options.bank or DEFAULT_BANK)
    bank, tried = bank_of(bank_name), tries_of(options)
    if are_maps(now, wanted, options):
        *maps, mask = maps_of(now, wanted, options)
        found = limits.limit(*maps, bank=bank, **keywords(None, **tried, reachable=mask))
    else:
        beds = beds_of(now, wanted, options, bank)
        how = keywords(None, **tried, reachable=beds.mask)
        found = limits.limit_views(beds.bank, beds.frames, beds.views, beds.names, **how)
    result = {
        "bank": bank_name,
        "max_steps": found.max_steps,
        "distance_mm": found.distance_mm,
        "left": found.left,
        "left_mm": found.left_mm,
        "by": found.by,
        "bounds": [asdict(one) for one in found.bounds],
        "fractions": found.fractions,
        "remains": found.shares,
    }
    _print(found, bank_name)
    if options.out is not None:
        picture = {options.out.name: partial(_draw, found)}
        if write_pictures(options.out.parent, picture):
            result["out"] = str(options.out)
            print(f"picture: {options.out}")
    return result


def _draw(found: limits.Limit) -> Any:
    from jshape.viz.limits import limit_figure  # not above: where it is broken, there is a limit

    return limit_figure(found)


def _print(found: limits.Limit, bank: str) -> None:
    print(f"bank: {bank}; at most {found.max_steps} actions; {found.distance_mm:.3f} mm to cover")
    rows = [(one.name, f"{one.left:.1%}", one.holds) for one in found.bounds]
    print_table(("bound", "left at least", "holds"), rows)
    print(found.words)
    print(f"fractions of actions would leave {found.fractions:.1%}", end="")
    causes = ", ".join(f"{share:.0%} {cause}" for cause, share in found.shares.items())
    print(f"; where that is more than {limits.LEAST_MM:g} mm: {causes}" if causes else "")
