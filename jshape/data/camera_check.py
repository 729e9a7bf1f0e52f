"""Is the set-up of a depth camera good enough?  Measured on frames of a levelled, resting bed."""

from typing import NamedTuple

import numpy as np

from jshape._typing import Float, Num
from jshape.camera import Camera
from jshape.data.depth import check_unit, outside_range
from jshape.data.missing import LIMIT, median_of, spread
from jshape.data.planes import NEAR, fit_plane, off_plane, tilt_deg_of
from jshape.errors import BadImage

VALID_LEAST = 1.0 - LIMIT
"""Least share of readings: plans fill up to a tenth of the pixels and refuse more."""
NOISE_MOST_MM = 0.9
"""Most noise of one frame: twice a D435's at 0.45 m, and the most that cutting recordings and
finding boxes were measured with (docs/recordings.md)."""
TILT_MOST_DEG = 2.0
"""Most tilt that is none: across the 190 mm of a grasp's ROI, 2 degrees are 6.6 mm."""
RESIDUAL_MOST_MM = 3.0
"""Most deviation from a plane: twice the unevenness of a bed levelled by hand (1.5 mm)."""
INSIDE_LEAST = 0.99
"""Least share of the bed's readings within the depth range: what lies beyond is clipped."""
FLAT_LEAST = 0.5
"""Least share of the readings that belong to one plane; else it is not the bed that fills the
view, and what is said of the plane is not said of the bed."""
HEIGHT = 0.45
"""Distance of the paper's camera from the bed, metres."""
HEIGHT_OFF = 0.015
"""Banks are trained at `HEIGHT`; so far from it, effects are 3 % larger or smaller in pixels."""


class SetUp(NamedTuple):
    """What was measured."""

    frames: int
    valid: float
    """Share of pixels with a reading, over all frames."""
    frozen: bool
    """All frames are the same to the bit."""
    noise_mm: float
    """Median over the pixels of a reading's standard deviation over time; NaN of one frame."""
    distance: float
    """Mean depth of the bed's plane over the image, metres."""
    tilt_deg: float
    """Angle of the bed's plane against the image plane."""
    tilt_towards: tuple[float, float]
    """Degrees of it along u and v: positive where the right, the lower side is farther away."""
    residual_mm: float
    """Robust standard deviation (1.48 times the median) of the distances from that plane."""
    flat: float
    """Share of the readings within 10 mm of it."""
    inside: float
    """Share of those within the camera's depth range."""


class Measured(NamedTuple):
    """A set-up with its images."""

    setup: SetUp
    depth: Float[np.ndarray, "H W"]
    """Mean depth in metres, NaN where there was never a reading."""
    noise: Float[np.ndarray, "H W"]
    """Standard deviation over time, mm; NaN where there were fewer than two readings."""
    off: Float[np.ndarray, "H W"]
    """Distance from the plane in mm, positive towards the camera; NaN without a reading."""


def measure(
    stack: Num[np.ndarray, "T H W"], camera: Camera, depth_unit: float, *, still: bool = False
) -> Measured:
    """What frames of a resting bed (counts, 0 = no reading) say of the set-up.

    `still`: the same frame over and over is what this camera should send.

    Raises:
      BadImage: frames of another size, of another unit, or without enough readings to fit a plane
        to.
    """
    if stack.shape[1:] != camera.shape:
        raise BadImage(f"frames have {stack.shape[1:]} (rows, columns); expected {camera.shape}")
    seen = stack > 0
    depth, noise = _over_time(stack, seen.sum(0), depth_unit)
    check_unit(depth, camera, "the frames", depth_unit)
    plane = fit_plane(depth, camera)
    off, bed = off_plane(depth, camera, plane)
    near = np.abs(off) < 1e3 * NEAR  # NaN is not
    a, b, c = plane
    setup = SetUp(
        frames=len(stack),
        valid=float(seen.mean()),
        frozen=len(stack) > 2 and not still and bool((stack == stack[0]).all()),
        noise_mm=median_of(noise),
        distance=float(bed.mean()),
        tilt_deg=tilt_deg_of(plane),
        # 1/z falls where the bed is farther away.
        tilt_towards=(float(np.degrees(np.arctan2(-a, c))), float(np.degrees(np.arctan2(-b, c)))),
        residual_mm=spread(off[near]),
        flat=float(near.sum() / np.isfinite(depth).sum()),
        inside=float(1.0 - outside_range(depth[near], camera).mean()),
    )
    return Measured(setup, depth, noise, off)


def verdict(setup: SetUp, camera: Camera) -> list[tuple[bool, str]]:
    """In words whether a set-up is good enough: (good, sentence) of each thing that matters."""
    said = []

    def judge(good: bool, what: str, mend: str) -> None:
        said.append((bool(good), what if good else f"{what}; {mend}"))

    judge(
        setup.valid >= VALID_LEAST,
        f"{setup.valid:.1%} of the pixels have a reading",
        f"at least {VALID_LEAST:.0%} are needed: look for glare, things too near, dark material",
    )
    if setup.frozen:
        judge(False, "all frames are the same to the bit", "the stream is frozen")
    elif np.isfinite(setup.noise_mm):
        judge(
            setup.noise_mm <= NOISE_MOST_MM,
            f"a reading varies by {setup.noise_mm:.2f} mm from frame to frame",
            f"at most {NOISE_MOST_MM:g} mm: come nearer, give more light or texture",
        )
    judge(
        setup.flat >= FLAT_LEAST,
        f"{setup.flat:.0%} of the readings lie in one plane",
        f"less than {FLAT_LEAST:.0%} is no bed that fills the view: level it, and cut the box out "
        "with --window",
    )
    if setup.flat >= FLAT_LEAST:
        judge(
            setup.residual_mm <= RESIDUAL_MOST_MM,
            f"the bed deviates from that plane by {setup.residual_mm:.2f} mm",
            f"at most {RESIDUAL_MOST_MM:g} mm: level the bed for this check",
        )
        u, v = setup.tilt_towards
        farther = ("left", "right")[u > 0] if abs(u) >= abs(v) else ("upper", "lower")[v > 0]
        judge(
            setup.tilt_deg <= TILT_MOST_DEG,
            f"the bed is tilted by {setup.tilt_deg:.1f} degrees against the image",
            f"at most {TILT_MOST_DEG:g} to record pairs (plans look from straight above): the "
            f"{farther} side is farther away",
        )
    low, high = float(camera.z_min), float(camera.z_max)
    near = abs(setup.distance - HEIGHT) <= HEIGHT_OFF
    judge(
        setup.inside >= INSIDE_LEAST,
        f"{setup.inside:.1%} of the bed is {low:g} to {high:g} m away, {setup.distance:.3f} m on "
        "average" + ("" if near else f" (not {HEIGHT:g}: plans look from there)"),
        f"at least {INSIDE_LEAST:.0%}: move the camera, or state another --depth-range",
    )
    return said


def _over_time(stack, count, depth_unit) -> tuple[np.ndarray, np.ndarray]:
    """Mean depth in metres, and standard deviation in mm, over each pixel's readings."""
    base = stack.max(0).astype(np.float32)  # differences to it keep float32's digits
    total, squares = np.zeros(base.shape, np.float32), np.zeros(base.shape, np.float32)
    for frame in stack:
        gap = np.where(frame > 0, frame - base, np.float32(0.0))
        total += gap
        squares += gap * gap
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = total / count
        spread = np.sqrt(np.maximum(squares - total * mean, 0.0) / (count - 1))
    depth = np.where(count > 0, (base + mean) * depth_unit, np.nan)
    noise = np.where(count > 1, 1e3 * depth_unit * spread, np.nan)
    return depth.astype(np.float32), noise.astype(np.float32)
