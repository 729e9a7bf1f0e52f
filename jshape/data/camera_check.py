"""Is the set-up of a depth camera good enough?  Measured on frames of a levelled, resting bed."""

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from jshape._typing import Float, Num
from jshape.camera import Camera
from jshape.data.depth import check_unit, outside_range
from jshape.data.missing import LIMIT, spread
from jshape.errors import BadImage, JShapeError

VALID_LEAST = 1.0 - LIMIT
"""Least share of readings: plans fill up to a tenth of the pixels and refuse more."""
NOISE_MOST_MM = 0.9
"""Most noise of one frame: twice a D435's at 0.45 m, and the most that cutting recordings and
finding boxes were measured with (docs/recordings.md)."""
RESIDUAL_MOST_MM = 3.0
"""Most deviation from a plane: twice the unevenness of a bed levelled by hand (1.5 mm)."""
TILT_MOST_DEG = 2.0
"""Most tilt: across the 190 mm of a grasp's ROI, 2 degrees are 6.6 mm, a quarter of the 25 mm that
it digs; across a box of 0.5 m, 17 mm, a third of the depth range.  The paper's is perpendicular."""
INSIDE_LEAST = 0.99
"""Least share of the bed's readings within the depth range: what lies beyond is clipped."""
FLAT_LEAST = 0.5
"""Least share of the readings that belong to one plane; else it is not the bed that fills the
view, and what is said of the plane is not said of the bed."""
FILLS = 0.95
"""Share of its rectangle that a bed fills; if that is as much of the view, nothing surrounds it."""
MOSTLY = 0.85
"""Share of what is level with the middle that lies in that rectangle: less of a round heap."""
INSET, MIN_SIDE = 2, 16
"""Pixels: left out at the bed's edge, where readings mix; and the smallest bed."""
HEIGHT = 0.45
"""Distance of the paper's camera from the bed, metres."""
HEIGHT_OFF = 0.015
"""Banks are trained at `HEIGHT`; so far from it, effects are 3 % larger or smaller in pixels."""

ROOM = 0.01, 0.03
"""What a depth range leaves nearer and farther than the bed is, metres: for heaps, for strokes."""

_NEAR = 0.010
_TRIES = 200
_SAMPLE = 2000


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
    plane = _plane(depth, camera)
    off, bed = _off(depth, camera, plane)
    near = np.abs(off) < 1e3 * _NEAR  # NaN is not
    a, b, c = plane
    setup = SetUp(
        frames=len(stack),
        valid=float(seen.mean()),
        frozen=len(stack) > 2 and not still and bool((stack == stack[0]).all()),
        noise_mm=_nanmedian(noise),
        distance=float(bed.mean()),
        tilt_deg=_tilt_deg(plane),
        # 1/z falls where the bed is farther away.
        tilt_towards=(float(np.degrees(np.arctan2(-a, c))), float(np.degrees(np.arctan2(-b, c)))),
        residual_mm=spread(off[near]),
        flat=float(near.sum() / np.isfinite(depth).sum()),
        inside=float(1.0 - outside_range(depth[near], camera).mean()),
    )
    return Measured(setup, depth, noise, off)


class BedView(NamedTuple):
    """Where in a frame the bed is, and how it lies."""

    window: tuple[int, int, int, int] | None
    """(left, top, width, height) that holds only the bed, pixels; None: it fills the view."""
    near: float
    """Depth that a hundredth of its readings is nearer than, metres."""
    far: float
    around: float
    """Median depth of what is beside it, metres; NaN without."""
    tilt_deg: float
    """Of its plane against the image plane."""
    relief: float
    """What is left of its depths without that tilt, metres."""


def bed_of(depth: Float[np.ndarray, "H W"], camera: Camera) -> BedView:
    """The bed of a frame (metres, NaN: no reading): what is level with the middle of the view.

    A table under it, or the floor around a table, lies higher or lower by a step; if what is level
    with the middle fills a rectangle, that is the bed.

    Raises:
      BadImage: fewer than 100 readings.
    """
    off, _ = _off(depth, camera, _plane(depth, camera))
    with np.errstate(invalid="ignore"):
        level = np.where(np.isnan(off), 0, np.where(np.abs(off) < 1e3 * _NEAR, 1, 2 + (off > 0)))
    height, width = depth.shape
    v, u = height * 2 // 5, width * 2 // 5
    middle = np.s_[v : height - v, u : width - u]
    usual = np.bincount(level[middle].ravel(), minlength=4)[1:].argmax() + 1
    parts = np.zeros(depth.shape, np.int32)
    ndimage.label(level == usual, output=parts)
    found = parts[middle][level[middle] == usual]
    window = _filled(parts == np.bincount(found).argmax()) if found.size else None
    left, top, w, h = window or (0, 0, width, height)
    inside, around = depth[top : top + h, left : left + w], depth.copy()
    around[top : top + h, left : left + w] = np.nan
    part = camera.crop(left, top, w, h)
    plane, seen = _plane(inside, part), np.isfinite(inside)
    level = 1e-3 * _off(inside, part, plane)[0]
    (near, far), (low, high) = (np.percentile(of[seen], (1, 99)) for of in (inside, level))
    return BedView(
        window, float(near), float(far), _nanmedian(around), _tilt_deg(plane), float(high - low)
    )


def _filled(part: np.ndarray) -> tuple[int, int, int, int] | None:
    """The rectangle (left, top, width, height) that a part fills; None: all, or no rectangle."""
    found = []
    for axis in (0, 1):
        count = part.sum(axis)
        most = np.flatnonzero(count >= 0.8 * np.percentile(count[count > 0], 90))
        found.append((int(most[0]) + INSET, int(most[-1]) + 1 - INSET))
    (left, right), (top, bottom) = found
    if right - left < MIN_SIDE or bottom - top < MIN_SIDE:
        return None
    height, width = part.shape
    share = (right - left) * (bottom - top) / (width * height)
    inside = part[top:bottom, left:right]
    whole = inside.mean() > FILLS and inside.sum() > MOSTLY * part.sum()
    return (left, top, right - left, bottom - top) if whole and share < FILLS else None


def way_out(
    depth: Float[np.ndarray, "H W"],
    camera: Camera,
    target: Camera,
    corner: tuple[int, int] = (0, 0),
    *,
    moved: bool = True,
) -> str | None:
    """Why a frame is not a bed within another camera's range, and what to do, for an error's end.

    Args:
      depth: the frame, metres; NaN: no reading.
      camera: that took it.
      target: of the bank; a bed is moved to the middle of its range, unless not `moved`.
      corner: (left, top) of what is given here in the whole frame, pixels.
      moved: see `target`; None is returned where the view only lies at another distance.
    """
    span = float(target.z_max) - float(target.z_min)
    seen = depth[np.isfinite(depth)]
    if not moved and seen.size and np.ptp(np.percentile(seen, (1, 99))) <= span:
        return None
    try:
        bed = bed_of(depth, camera)
    except JShapeError:  # too few readings, or all in a row
        return "; is all of the picture the bed?"
    if bed.window is not None:
        left, top, width, height = bed.window
        share = width * height / depth.size
        return (
            f"; surroundings: the bed fills {share:.0%} of the view, {bed.near:.3f} to "
            f"{bed.far:.3f} m away, and what is around it is {bed.around:.3f} m away; "
            f"--window {left + corner[0]},{top + corner[1]},{width}x{height} holds only the bed"
        )
    if bed.tilt_deg > TILT_MOST_DEG and bed.relief < bed.far - bed.near:
        return (
            f"; tilt: the bed is tilted by {bed.tilt_deg:.1f} degrees against the image, "
            f"{bed.near:.3f} to {bed.far:.3f} m away; level the camera (at most "
            f"{TILT_MOST_DEG:g} degrees)"
        )
    low, high = bed.near - ROOM[0], bed.far + ROOM[1]
    high_mm = 1e3 * (bed.far - bed.near)
    return (
        f"; range: the bed is {bed.near:.3f} to {bed.far:.3f} m away, {high_mm:.0f} mm of relief, "
        f"and the bank's camera sees {1e3 * span:.0f} mm; --depth-range "
        f"{low:.3f},{high:.3f} plans within that range of your own camera"
    )


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
            f"at most {TILT_MOST_DEG:g}: the {farther} side is farther away",
        )
    low, high = float(camera.z_min), float(camera.z_max)
    near = abs(setup.distance - HEIGHT) <= HEIGHT_OFF
    judge(
        setup.inside >= INSIDE_LEAST,
        f"{setup.inside:.1%} of the bed is {low:g} to {high:g} m away, {setup.distance:.3f} m on "
        "average" + ("" if near else f" (not {HEIGHT:g}: plan with --reproject)"),
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


def _rays(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    x = (np.arange(camera.width) - float(camera.u0)) / float(camera.fx)
    y = (np.arange(camera.height) - float(camera.v0)) / float(camera.fy)
    return np.broadcast_to(x, camera.shape), np.broadcast_to(y[:, None], camera.shape)


def _nanmedian(values: np.ndarray) -> float:
    return float(np.nanmedian(values)) if np.isfinite(values).any() else float("nan")


def _tilt_deg(plane: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip(plane[2] / np.linalg.norm(plane), -1.0, 1.0))))


def _plane(depth: np.ndarray, camera: Camera) -> np.ndarray:
    """(a, b, c) of the plane a x + b y + c = 1/z that most readings lie in.

    A plane in space is a plane in inverse depth.  Of many planes through three readings the one
    with most others near it is taken (walls and table do not pull), then fitted to those.
    """
    there = np.isfinite(depth)
    if there.sum() < 100:
        raise BadImage(f"{int(there.sum())} pixels have a reading; a plane needs 100")
    x, y = (ray[there] for ray in _rays(camera))
    z = depth[there].astype(np.float64)
    terms = np.stack([x, y, np.ones_like(x)], 1)
    rng = np.random.default_rng(0)
    some = rng.choice(len(z), min(len(z), _SAMPLE), replace=False)
    three = np.array([rng.choice(some, 3, replace=False) for _ in range(_TRIES)])
    three = three[np.abs(np.linalg.det(terms[three])) > 1e-15]  # not in a row
    if not len(three):
        raise JShapeError("no plane fits these readings")
    planes = np.linalg.solve(terms[three], 1.0 / z[three][..., None])[..., 0]
    most = [(_gap(terms[some], z[some], plane) < _NEAR).sum() for plane in planes]
    best = planes[int(np.argmax(most))]
    for _ in range(3):
        near = _gap(terms, z, best) < _NEAR
        # An error of 1/z counts z^2 times as much in z.
        weight = z[near] ** 2
        best = np.linalg.lstsq(weight[:, None] * terms[near], weight / z[near], rcond=None)[0]
    return best


def _gap(terms: np.ndarray, z: np.ndarray, plane: np.ndarray) -> np.ndarray:
    """Distances of readings from a plane, metres."""
    return np.abs(z * (terms @ plane) - 1.0) / np.linalg.norm(plane)


def _off(depth: np.ndarray, camera: Camera, plane: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) signed distances in mm from a plane; and (H, W) the plane's own depth, metres."""
    x, y = _rays(camera)
    inverse = plane[0] * x + plane[1] * y + plane[2]
    off = 1e3 * (1.0 - depth * inverse) / np.linalg.norm(plane)
    return off.astype(np.float32), 1.0 / inverse
