"""How well a depth camera stands over its bed, and what would make it better."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from jshape._typing import Bool, Num
from jshape.camera import Camera, matrix
from jshape.data.depth import outside_range
from jshape.data.fusion import NOISE, Look, map_report
from jshape.data.looks import taken, together
from jshape.data.missing import LIMIT, median_of, spread
from jshape.data.planes import NEAR
from jshape.errors import BadImage
from jshape.height_map import ABOVE, HeightMap

VALID_LEAST = 1.0 - LIMIT
"""Least share of readings: plans fill up to a tenth of the pixels and refuse more."""
NOISE_MOST_MM = 0.9
"""Most noise of one frame to record pairs: twice a D435's at 0.45 m, and the most that cutting
recordings and finding boxes were measured with (docs/recordings.md)."""
NOISIER, NOISIEST_MM = 2.0, 3.0
"""Times a D435's noise: more is neither the distance nor the rounding of counts to millimetres; and
the most at any distance: it hides the hills of a bed (a D435's is that at 1.2 m)."""
TILT_MOST_DEG, STEEPEST_DEG = 2.0, 45.0
"""Most tilt that is none (across the 190 mm of a grasp's ROI it is 6.6 mm); and the most that
height maps were measured with."""
LEAN_MOST_DEG = 5.0
"""Most angle between a bed and the level of an arm's base: more is a wrong pose of the camera."""
RESIDUAL_MOST_MM = 3.0
"""Most deviation from a plane: twice the unevenness of a bed levelled by hand (1.5 mm)."""
FLAT_LEAST, INSIDE_LEAST, SEEN_LEAST, FILLS_LEAST = 0.5, 0.99, 0.8, 0.1
"""Least share: of the readings within 10 mm of the plane; of those within the depth range, since
what lies beyond is clipped; of the bed that is seen; of the frame that is the bed's."""
FILLS, NEAREST = 0.7, 0.3
"""Share of the frame that the bed should fill; and metres, since a D435 of 848x480 pixels measures
nothing nearer than 0.28."""
HEAP, PIT = 0.1, 0.06
"""Metres that a depth range leaves above and below the level bed."""
ALONE = 0.1
"""Share of the readings beside the bed up to which nothing surrounds it."""
MOVED_MM = 1.0
"""Most by which the bed may lie elsewhere in the last third of the frames than in the first."""
HEIGHT_OFF = 0.015
"""Metres from `ABOVE` at which effects of banks of images are 3 % larger or smaller."""
_SOME = 20_000
"""Pixels that noise is measured on."""


class SetUp(NamedTuple):
    """What was measured, what was seen, and the bed in it."""

    look: Look
    """Its camera has the depth range that is to be written."""
    map: HeightMap
    bed: Bool[np.ndarray, "H W"]
    """Pixels that show the rectangle of the map."""
    frames: int
    valid: float
    """Share of the bed's pixels with a reading, over all frames."""
    missing_at: str
    """The side of the bed where most of the others are; empty: anywhere."""
    frozen: bool
    """All frames are the same to the bit."""
    noise_mm: float
    """Standard deviation of a reading from frame to frame, the bed's median; NaN of one frame."""
    expected_mm: float
    """The same of a D435 at that distance."""
    tilt_deg: float
    """Angle of the camera's axis against the plane's normal."""
    tilt_towards: tuple[float, float]
    """Degrees of it along u and v: positive where the right, the lower side is farther away."""
    distance: float
    """To the plane along the axis, metres."""
    residual_mm: float
    """Robust standard deviation (1.48 times the median) of the distances from the plane."""
    flat: float
    """Share of the bed's readings within 10 mm of it."""
    inside: float
    """Share of those within the depth range."""


def measure(
    stack: Num[np.ndarray, "T H W"],
    camera: Camera,
    depth_unit: float,
    *,
    window: tuple[int, int, int, int] | None = None,
    still: bool = False,
    keep_range: bool = False,
    where: str = "the frames",
) -> SetUp:
    """What frames of a resting bed (counts, 0 = no reading) say of the set-up.

    Args:
      stack: the frames.
      camera: that took them.
      depth_unit: metres per count.
      window: (left, top, width, height) that holds the bed, pixels; None: it is looked for.
      still: the same frame over and over is what this camera should send.
      keep_range: the camera's depth range is as somebody asked; else it is replaced by one that
        holds the bed, if it does not.
      where: what to call the frames in errors.

    Raises:
      BadImage: frames of another size or unit, no plane in them, or a camera or bed that moved.
    """
    (look,) = taken(stack, camera, depth_unit, window, where)
    found, target, each = together([look], where=where)
    (stand,) = map_report([look], [len(stack)], found, target, each).cameras
    to_map = np.linalg.inv(matrix(found.frame)) @ look.to_common
    begin, along = camera.lines(to_map)
    plane = np.broadcast_to(-begin[2] / along[2], camera.shape)
    bed = plane > 0
    for k, nodes in enumerate((found.x, found.y)):
        at = begin[k] + plane * along[k]
        bed = bed & (at >= nodes[0]) & (at <= nodes[-1])
    there = np.isfinite(look.depth)
    # A bed that nothing surrounds and that reaches the frame's edge may fill it, unseen.
    rows, columns = (1 + n // 50 for n in bed.shape)
    edges = bed[rows], bed[-1 - rows], bed[:, columns], bed[:, -1 - columns]
    alone = window is None and (there & ~bed).sum() < ALONE * there.sum()
    alone = alone and max(float(edge.mean()) for edge in edges) > 0.5
    asked = np.ones_like(bed) if alone else bed
    depth = look.depth[there & bed]
    off = 1e3 * (begin[2] + look.depth * along[2])[there & bed]
    near = np.abs(off) < 1e3 * NEAR
    u, v = (float(np.degrees(np.arctan2(n, -to_map[2, 2]))) for n in to_map[2, :2])
    inside = 1.0 - outside_range(depth[near], camera).mean()
    if inside < INSIDE_LEAST and not keep_range:
        low, high = np.percentile(depth, (0.5, 99.5))
        low, high = (round(float(z), 3) for z in (max(low - HEAP, 0.05), high + PIT))
        look, inside = look._replace(camera=replace(camera, z_min=low, z_max=high)), 1.0
    return SetUp(
        *(look, found, bed, len(stack)),
        valid=float((stack[:, asked] > 0).mean()),
        missing_at=_side(asked & ~there, asked),
        frozen=len(stack) > 2 and not still and bool((stack == stack[0]).all()),
        noise_mm=_over_time(stack, bed, 1e3 * depth_unit, where),
        expected_mm=1e3 * NOISE * float(np.median(depth)) ** 2,
        tilt_deg=stand.tilt_deg,
        tilt_towards=(u, v),
        distance=stand.distance,
        residual_mm=spread(off[near]),
        flat=float(near.mean()),
        inside=float(inside),
    )


def _over_time(stack: np.ndarray, bed: np.ndarray, unit_mm: float, where: str) -> float:
    """The median noise of some of the bed's pixels, mm.

    Raises BadImage: they lie elsewhere at the end than at the beginning.
    """
    if len(stack) == 1:
        return float("nan")
    pixels = np.flatnonzero(bed)[:: 1 + int(bed.sum()) // _SOME]
    some = stack.reshape(len(stack), -1)[:, pixels].astype(float) * unit_mm
    some, part = np.ma.masked_equal(some, 0.0), max(len(stack) // 3, 1)
    # Of the differences from frame to frame: what drifts is no noise.
    noise = median_of(np.ma.sqrt((np.diff(some, axis=0) ** 2).mean(0) / 2).filled(np.nan))
    off = median_of(np.ma.abs(some[-part:].mean(0) - some[:part].mean(0)).filled(np.nan))
    if off > max(MOVED_MM, 2 * noise):
        raise BadImage(
            f"{where}: the bed lies {off:.1f} mm elsewhere in the last frames than in the first "
            "(median): the camera or the bed moved; let both rest"
        )
    return noise


def _side(some: np.ndarray, whole: np.ndarray) -> str:
    """At which side of a region most of some of its pixels are; empty: at none."""
    if not some.any():
        return ""
    at, within = np.argwhere(some), np.argwhere(whole)
    # All of a half lie a quarter of the whole beside its middle.
    off = (at.mean(0) - within.mean(0)) / np.maximum(np.ptp(within, axis=0), 1)
    axis = int(np.argmax(np.abs(off)))
    side = (("upper", "lower"), ("left", "right"))[axis][int(off[axis] > 0)]
    return side if abs(off[axis]) > 0.15 else ""


def verdict(setup: SetUp, *, in_base: bool = False) -> list[tuple[bool, str]]:
    """In words whether a set-up is good enough: (good, sentence) of each thing that matters.

    `in_base`: the camera's pose is in the base frame of an arm, whose z is up.
    """
    said = []

    def judge(good: bool, what: str, mend: str) -> None:
        said.append((bool(good), what if good else f"{what}; {mend}"))

    side = setup.missing_at and f"; most are missing at the {setup.missing_at} side: shade it"
    judge(
        setup.valid >= VALID_LEAST,
        f"{setup.valid:.1%} of the bed's pixels have a reading",
        f"at least {VALID_LEAST:.0%} are needed: look for glare, things too near, dark material"
        f"{side}",
    )
    if setup.frozen:
        judge(False, "all frames are the same to the bit", "the stream is frozen")
    elif np.isfinite(setup.noise_mm):
        judge(
            setup.noise_mm <= min(NOISIER * setup.expected_mm, NOISIEST_MM),
            f"a reading varies by {setup.noise_mm:.2f} mm from frame to frame (at that distance a "
            f"D435's does by {setup.expected_mm:.2f} mm)",
            "turn the camera away from the window, give more even light or texture"
            if setup.noise_mm > NOISIER * setup.expected_mm
            else f"at most {NOISIEST_MM:g} mm: move it nearer",
        )
    judge(
        setup.flat >= FLAT_LEAST,
        f"{setup.flat:.0%} of the bed's readings lie in one plane",
        f"less than {FLAT_LEAST:.0%} is no level bed: level it, or cut it out with --window",
    )
    if setup.flat >= FLAT_LEAST:
        judge(
            setup.residual_mm <= RESIDUAL_MOST_MM,
            f"the bed deviates from that plane by {setup.residual_mm:.2f} mm",
            f"at most {RESIDUAL_MOST_MM:g} mm: level it; if it is level, the camera errs so",
        )
    u, v = setup.tilt_towards
    farther = ("left", "right")[u > 0] if abs(u) >= abs(v) else ("upper", "lower")[v > 0]
    away = f": the {farther} side is farther away" if setup.tilt_deg > TILT_MOST_DEG else ""
    judge(
        setup.tilt_deg <= STEEPEST_DEG,
        f"the camera is tilted by {setup.tilt_deg:.1f} degrees against straight above{away}",
        f"at most {STEEPEST_DEG:g}: raise it by {setup.tilt_deg - STEEPEST_DEG:.0f} degrees",
    )
    if in_base:
        lean = float(np.degrees(np.arccos(np.clip(matrix(setup.map.frame)[2, 2], -1.0, 1.0))))
        judge(
            lean <= LEAN_MOST_DEG,
            f"by the camera's pose the bed is {lean:.1f} degrees from the base's level",
            f"at most {LEAN_MOST_DEG:g}: is the pose wrong, or did the camera move?",
        )
    seen, fills, found = float(setup.map.mask.mean()), float(setup.bed.mean()), setup.map
    what = f"the bed, {1e3 * np.ptp(found.x):.0f}x{1e3 * np.ptp(found.y):.0f} mm, is seen to "
    what += f"{seen:.1%} and fills {fills:.0%} of the frame"
    judge(
        seen >= SEEN_LEAST,
        what,
        "is something before it, or is it no rectangle? look from higher up, or with two cameras",
    )
    nearer = setup.distance - max(setup.distance * (fills / FILLS) ** 0.5, NEAREST)
    if nearer > 0.02:
        judge(
            fills >= FILLS_LEAST, f"{_mm(nearer)} nearer it would fill the frame", "move it there"
        )
    low, high = float(setup.look.camera.z_min), float(setup.look.camera.z_max)
    judge(
        setup.inside >= INSIDE_LEAST,
        f"{setup.inside:.1%} of the bed is {low:g} to {high:g} m away, {setup.distance:.3f} m in "
        "the middle",
        f"at least {INSIDE_LEAST:.0%}: move the camera, or state another --depth-range",
    )
    why = []
    if setup.tilt_deg > TILT_MOST_DEG:
        why.append(f"tilted by more than {TILT_MOST_DEG:g} degrees")
    if setup.noise_mm > NOISE_MOST_MM:
        less = setup.distance * (1 - (NOISE_MOST_MM / setup.noise_mm) ** 0.5)
        why.append(f"noise above {NOISE_MOST_MM:g} mm ({_mm(less)} nearer it is less)")
    if abs(setup.distance - ABOVE) > HEIGHT_OFF:
        why.append(f"not {ABOVE:g} m away, where the bundled banks look from")
    pairs = f", not for pairs and banks of images: {', '.join(why)}" if why else ", pairs and banks"
    said.append((True, f"for height maps{pairs}{' of images' * (not why)}"))
    return said


def _mm(metres: float) -> str:
    return f"{10 * round(100 * metres)} mm"
