"""Whether a bed lies elsewhere, as a whole, than it did before: the camera, or the bed, was moved.

Molding lowers some of a bed and raises some, and a hand hides some.  A camera that moves up, down
or tilts changes all of it by a plane; one that moves sideways shifts all of its relief.
"""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter

from jshape._typing import Float
from jshape.camera import Camera
from jshape.data.fusion import APART

TURNED_DEG = 1.0
"""A camera that turned by more sees the bed aslant from there on: 7 mm across 400 mm."""
LEAST = 50
"""Readings of both frames that tell whether a camera moved."""
GRAIN = 5e-3
"""Metres over which looks at one bed are averaged, against their noise."""
RELIEF = 4e-4
"""Metres by which the relief must differ where it was, in the median: less is noise."""
EXPLAINED = 0.5
"""Most of a difference, in the median, that is left of it by what explains it.  Of 8 simulated beds
seen at 0 and 30 degrees, 20 actions of molding never left as little."""
ASIDE = 2
"""Pixels of two frames: a bed that lies aside by less has not moved."""
_SMOOTH = 8.0
"""Pixels over which relief is taken against its surroundings."""


class Displaced(NamedTuple):
    """How a bed lies elsewhere as a whole than before."""

    off_mm: float
    """In the median, along the camera's axis."""
    turned_deg: float
    aside_mm: float
    """Along the bed; 0 where the relief does not tell."""

    def said(self, before: str) -> str:
        """In words, for people."""
        if self.aside_mm:
            return f"the bed lies {self.aside_mm:.0f} mm aside of where it lay in {before}"
        return (
            f"the bed lies {self.off_mm:.1f} mm from where it lay in {before}, turned by "
            f"{self.turned_deg:.1f} degrees"
        )


def moved(first: np.ndarray, later: np.ndarray, camera: Camera, step: int = 1) -> Displaced | None:
    """How all of a bed lies elsewhere in a later frame (h, w; metres, NaN: none) than before.

    A pixel of both is `step` of the camera's each way.

    None: by neither `APART` nor `TURNED_DEG`, and not aside, as far as the relief tells; or it
    changed otherwise.
    """
    both = np.isfinite(first) & np.isfinite(later)
    if both.sum() < LEAST:
        return None
    v, u = (step * at + (step - 1) / 2 for at in np.nonzero(both))
    x, y = camera.at(u, v, 1.0)
    terms = np.stack([x, y, np.ones_like(x)], 1).astype(float)
    z, now = first[both].astype(float), later[both].astype(float)
    # A plane is linear in z of parallel rays, in 1/z of others.
    one, other, per = (z, now, 1.0) if camera.orthographic else (1.0 / z, 1.0 / now, z**2)
    change, before = _linear(terms, other - one), _linear(terms, one)
    off = float(np.median(np.abs(now - z)))
    if np.median(np.abs(other - one - terms @ change) * per) <= EXPLAINED * off:
        normals = [_normal(plane, camera) for plane in (before, before + change)]
        turned = float(np.degrees(np.arccos(np.clip(normals[0] @ normals[1], -1.0, 1.0))))
        if off > APART or turned > TURNED_DEG:
            return Displaced(1e3 * off, turned, 0.0)
    reliefs = np.full((2, *first.shape), np.nan)
    reliefs[:, both] = (one - terms @ before) * per, (other - terms @ (before + change)) * per
    aside = _aside(*reliefs) * step / float(camera.scale(float(np.median(z)))[0])
    return Displaced(1e3 * off, 0.0, 1e3 * aside) if aside else None


def averaged(image: Float[np.ndarray, "H W"], step: int) -> Float[np.ndarray, "h w"]:
    """Means of blocks of `step` x `step` pixels; NaN where over half of them are."""
    h, w = (side // step for side in image.shape)
    blocks = image[: h * step, : w * step].reshape(h, step, w, step).swapaxes(1, 2)
    blocks = blocks.reshape(h, w, step**2)
    known = np.isfinite(blocks)
    mean = np.where(known, blocks, 0).sum(-1) / np.maximum(known.sum(-1), 1)
    return np.where(known.mean(-1) >= 0.5, mean, np.nan)


def _aside(before: np.ndarray, later: np.ndarray) -> float:
    """By how many pixels a relief was shifted; 0 if another shift than none does not explain it.

    The likeliest shift is that of the largest correlation.  It must leave less than `EXPLAINED` of
    the difference: what molding changes of a bed is as far off at any place.
    """
    known = np.isfinite(before)
    one, other = (_against_surroundings(relief, known) for relief in (before, later))
    in_place = float(np.median(np.abs(other - one)[known]))
    if in_place < RELIEF:
        return 0.0
    size = [2 * side for side in known.shape]
    # What was molded deep does not pull.
    most = 3 * max(float(np.median(np.abs(relief[known]))) for relief in (one, other))
    a, b = (np.clip(relief, -most, most) for relief in (one, other))
    there, *spectra = (np.fft.rfft2(each, size) for each in (known, a, b, a**2, b**2))

    def along(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.fft.irfft2(np.conj(a) * b, size)

    count = along(there, there)
    power = along(spectra[2], there) * along(there, spectra[3])
    alike = along(spectra[0], spectra[1]) / np.sqrt(np.maximum(power, 1e-30))
    alike[count < known.sum() / 2] = -1.0
    best = np.unravel_index(int(np.argmax(alike)), alike.shape)
    down, right = (int(k) - side * (2 * int(k) > side) for k, side in zip(best, size, strict=True))
    if np.hypot(down, right) < ASIDE:
        return 0.0
    shifted, kept = (np.roll(a, (down, right), (0, 1)) for a in (one, known))
    rows, columns = (np.arange(side) for side in known.shape)
    inside = ((rows - down) // len(rows) == 0)[:, None] & ((columns - right) // len(columns) == 0)
    left = float(np.median(np.abs(other - shifted)[known & kept & inside]))
    return float(np.hypot(down, right)) if left < EXPLAINED * in_place else 0.0


def _against_surroundings(relief: np.ndarray, known: np.ndarray) -> np.ndarray:
    """A relief less its mean around each pixel; 0 where it is not known."""
    whole = np.where(known, relief, 0.0)
    share = np.maximum(gaussian_filter(known.astype(float), _SMOOTH), 1e-6)
    return np.where(known, whole - gaussian_filter(whole, _SMOOTH) / share, 0.0)


def _normal(plane: np.ndarray, camera: Camera) -> np.ndarray:
    """Of a plane that `_linear` found: z = a x + b y + c, or a x + b y + c = 1 / z along rays."""
    found = np.append(plane[:2], -1.0) if camera.orthographic else plane
    return found / np.linalg.norm(found)


def _linear(terms: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Factors (3,) of terms (n, 3) from which values (n,) are least off, summed.

    Not in the sum of squares: a hand does not pull.
    """
    weight = np.ones(len(values))
    for _ in range(20):
        weighed = weight[:, None] * terms
        found = np.linalg.solve(weighed.T @ terms, weighed.T @ values)
        off = np.abs(values - terms @ found)
        weight = 1.0 / np.maximum(off, 0.1 * np.median(off) + 1e-12)
    return found
