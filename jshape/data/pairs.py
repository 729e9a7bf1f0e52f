"""Pairs of depth frames before and after an action: what predictors are fitted to."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from jshape import actions, metric
from jshape.camera import Camera
from jshape.data.depth import outside_range
from jshape.data.missing import LIMIT, fill_nan, only_readings
from jshape.errors import BadDataset, UnknownName


class Examples(NamedTuple):
    """The ROIs of one action's n pairs: what a predictor is fitted to.  NaN = no reading."""

    prior: np.ndarray
    """(n, h, w) float32 of I before."""
    posterior: np.ndarray
    """(n, h, w) float32 of I after."""
    corner: np.ndarray
    """(n, 2) int32, first pixel (u, v) of each ROI in the image."""
    strength: np.ndarray | float = 1.0
    """(n,) float32, how many times as deep as the trained action; one number is that of all."""
    path_mm: float = 0.0
    """Length of the action's path, mm; 0: it has none."""

    @property
    def strengths(self) -> np.ndarray:
        """(n,) float32 strengths, also if one number stands for all."""
        return np.broadcast_to(np.float32(self.strength), (len(self.prior),))

    @property
    def roi(self) -> tuple[int, int]:
        """ROI size (w, h), pixels."""
        return self.prior.shape[2], self.prior.shape[1]

    @property
    def seen(self) -> np.ndarray:
        """(n, h, w) bool: pixels with a reading before and after."""
        return np.isfinite(self.prior) & np.isfinite(self.posterior)

    def without_blind(self) -> "Examples":
        """The same, with pixels that no pair has seen filled where they are at most `LIMIT` of all.

        A camera at an angle never sees the wall of a hole that faces away from it.
        """
        blind = ~self.seen.any(0)
        if (
            not 0 < blind.mean() <= LIMIT
            or np.isnan([self.prior, self.posterior]).all((2, 3)).any()
        ):
            return self
        prior, posterior = (
            np.where(blind, [fill_nan(roi) for roi in rois], rois) for rois in self[:2]
        )
        return self._replace(prior=prior, posterior=posterior)

    def select(self, keep: np.ndarray) -> "Examples":
        """The examples where `keep` (a mask or indices) says so."""
        kept = (part[keep] for part in self[:3])
        return Examples(*kept, self.strengths[keep], self.path_mm)  # pyright: ignore


MOST_BEYOND = 0.5
"""Largest share of readings beyond the camera's range: they are clipped, so that an action that
nobody sees would be predicted without an error."""


SAME_PATH = 0.05
"""Paths that differ by less than this share count as one: 4 mm of 80."""


class Frames:
    """N frames (H, W) that are read when they are asked for, as of an (N, H, W) array."""

    dtype = np.dtype(np.uint16)

    def __init__(self, read: Callable[[int], np.ndarray], which: np.ndarray, size: tuple[int, int]):
        """Of N frames, number k is `read(which[k])`, of `size` (H, W)."""
        self._read, self._which = read, which
        self.shape = (len(which), *size)

    def __len__(self) -> int:
        return len(self._which)

    def __iter__(self) -> Iterator[np.ndarray]:
        return (self._read(int(k)) for k in self._which)

    def __getitem__(self, key: Any) -> Any:
        """A frame; of a mask or indices, the frames."""
        which = self._which[key]
        if which.ndim == 0:
            return self._read(int(which))
        return Frames(self._read, which, self.shape[1:])

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.array(list(self), dtype or self.dtype).reshape(self.shape)

    def __reduce__(self) -> tuple[Any, ...]:
        return np.asarray, (np.asarray(self),)  # another process may not have the files


@dataclass(frozen=True, eq=False)
class Pairs:
    """N pairs of depth frames, kept as the raw counts of the files (2 bytes a pixel)."""

    camera: Camera
    depth_unit: float
    """Metres per count."""
    prior: np.ndarray | Frames
    """(N, H, W) uint16 counts before the action; 0 = no reading."""
    posterior: np.ndarray | Frames
    """(N, H, W) uint16 counts after the action."""
    action: np.ndarray
    """(N,) names."""
    agent: np.ndarray
    """(N,) names."""
    material: np.ndarray
    """(N,) names."""
    centre: np.ndarray
    """(N, 2) ROI centres (u, v), pixels."""
    size: np.ndarray
    """(N, 2) ROI sizes (w, h), pixels."""
    id: np.ndarray
    """(N,) names of the pairs."""
    strength: np.ndarray = field(default_factory=lambda: np.ones(0, np.float32))
    """(N,) float32, how many times as deep as the trained action; empty: 1 for all."""
    path_mm: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))
    """(N,) float32, length of the action's path along the hand's x, mm; 0 or empty: none."""

    extra: Mapping[str, np.ndarray] = field(default_factory=dict)
    """A user's own columns of the table, by name: (N,) texts."""

    def __post_init__(self):
        if self.strength.size == 0:
            object.__setattr__(self, "strength", np.ones(len(self.action), np.float32))
        if self.path_mm.size == 0:
            object.__setattr__(self, "path_mm", np.zeros(len(self.action), np.float32))

    def __len__(self) -> int:
        return len(self.action)

    @property
    def actions(self) -> tuple[str, ...]:
        """Names of the actions, in order of first appearance."""
        return tuple(dict.fromkeys(self.action.tolist()))

    def select(self, keep: np.ndarray) -> "Pairs":
        """The pairs where `keep` (a mask or indices) says so."""
        whole = ("camera", "depth_unit", "extra")
        kept = {name: part[keep] for name, part in vars(self).items() if name not in whole}
        return replace(self, **kept, extra={n: cells[keep] for n, cells in self.extra.items()})

    def of(self, action: str | None = None, agent: str | None = None) -> "Pairs":
        """The pairs of one action and/or agent.

        Raises:
          UnknownName: no pair has that action or agent.
        """
        keep = np.ones(len(self), bool)
        for what, name in (("action", action), ("agent", agent)):
            if name is not None:
                names = getattr(self, what)
                if name not in names:
                    raise UnknownName(what, name, dict.fromkeys(names.tolist()))
                keep &= names == name
        return self.select(keep)

    def by_action(self) -> Iterator[tuple[str, "Pairs"]]:
        """(name, its pairs) for every action."""
        for name in self.actions:
            yield name, self.of(action=name)

    def of_usual_paths(self) -> "Pairs":
        """The pairs without those whose path is more than `SAME_PATH` off the action's commonest.

        A predictor is that of one length, and stretched to the others.
        """
        keep = np.ones(len(self), bool)
        for name in self.actions:
            mine = self.action == name
            lengths, counts = np.unique(self.path_mm[mine], return_counts=True)
            near = [counts[np.abs(lengths - one) <= SAME_PATH * one].sum() for one in lengths]
            usual = lengths[np.argmax(near)]
            keep[mine] = np.abs(self.path_mm[mine] - usual) <= SAME_PATH * usual
        return self if keep.all() else self.select(keep)

    def roi_size(self, action: str) -> tuple[int, int]:
        """ROI size (w, h) of an action: the mean over its pairs, as the paper does."""
        w, h = np.rint(self.of(action=action).size.mean(0)).astype(int)
        return int(w), int(h)

    def rois(
        self, action: str, size: tuple[int, int] | None = None, *, padded: bool = False
    ) -> Examples:
        """The ROIs of one action, of size (w, h); None is the mean size.

        Args:
          action: its name.
          size: (w, h), pixels.
          padded: a ROI that leaves the image has no readings there, instead of being refused: for
            the size of a bank, which the pairs were not recorded for.

        Raises:
          BadDataset: a ROI leaves the image; most readings lie beyond the camera's range.
        """
        mine = self.of(action=action)
        w, h = size or self.roi_size(action)
        inside = actions.fits(self.camera, mine.centre, (w, h))
        if not (padded or inside.all()):
            pair = int(np.argmin(inside))
            centre = tuple(mine.centre[pair].tolist())
            raise BadDataset(
                f"pair {mine.id[pair]}: the {w}x{h} ROI of {action} at {centre} leaves the "
                f"{self.camera.width}x{self.camera.height} image"
            )
        weight = np.asarray(metric.r_matrix(self.camera) * self.camera.top, np.float32)
        found, beyond = ([], []), []
        first = actions.first_pixels(mine.centre, (w, h))
        for k, (left, top) in enumerate(first):
            window = np.s_[max(top, 0) : max(top + h, 0), max(left, 0) : max(left + w, 0)]
            for counts, out in zip((mine.prior, mine.posterior), found, strict=True):
                seen = only_readings(counts[k][window])  # pairs need not come from a file
                depth = seen.astype(np.float32) * np.float32(self.depth_unit)
                beyond.append(outside_range(depth[depth > 0], self.camera))
                level = self.camera.luminance(depth, quantize=False)
                seen = np.asarray(level) / self.camera.top * weight[window]
                roi = np.full((h, w), np.nan, np.float32)
                v, u = max(-top, 0), max(-left, 0)
                roi[v : v + seen.shape[0], u : u + seen.shape[1]] = seen
                out.append(roi)
        share = float(np.concatenate(beyond).mean()) if sum(x.size for x in beyond) else 0.0
        if share > MOST_BEYOND:
            raise BadDataset(
                f"pairs of {action}: {share:.0%} of their readings lie beyond the camera's "
                f"{float(self.camera.z_min):g} to {float(self.camera.z_max):g} m, where no action "
                "shows: camera.json must say the range that the bed lies in"
            )
        corner = first.astype(np.int32)
        prior, posterior = (np.stack(part) for part in found)
        return Examples(prior, posterior, corner, mine.strength, float(mine.path_mm.mean()))
