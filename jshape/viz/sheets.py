"""Pictures to check data by eye: how a recording was cut, and the box of every pair."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from jshape._typing import ArrayLike
from jshape.viz.overlay import COLOURS
from jshape.viz.style import own_style

PER_PAGE = 24
"""Pairs on a page of the contact sheet."""
_ROW = 4
_STATES = {"open": "tab:green", "occluded": "tab:red", "short": "0.75"}


class Tile(NamedTuple):
    """One pair on the contact sheet."""

    title: str
    action: str
    """Its box has the action's colour, as in pictures of plans."""
    prior_mm: np.ndarray
    """(H, W) depth, mm; NaN = no reading."""
    change_mm: np.ndarray
    """(H, W) posterior minus prior, mm; NaN = not known."""
    box: tuple[int, int, int, int]
    """(left, top, width, height) in pixels."""
    by_hand: bool
    """A person drew the box."""


@own_style()
def timeline_figure(
    motion: ArrayLike,
    occluded: ArrayLike,
    segments: Sequence[tuple[int, int, str]],
    changes: Sequence[tuple[float, str, str]],
    *,
    title: str = "",
) -> Figure:
    """How a recording was cut: motion and occlusion over the frames, and the still segments.

    Args:
      motion: (T,) share of the image that differs from the frame before.
      occluded: (T,) share of the image with something before the bed.
      segments: (start, stop, state) with the state open, occluded or short.
      changes: (frame, text, colour) between two open segments.
      title: above all.
    """
    motion, occluded = np.asarray(motion), np.asarray(occluded)
    count = len(motion)
    figure = Figure(figsize=(float(np.clip(count / 40, 9, 40)), 4.2), layout="constrained")
    above, ax = figure.subplots(2, sharex=True, height_ratios=(1, 2.4))
    for start, stop, state in segments:
        above.add_patch(Rectangle((start - 0.5, 0), stop - start, 1, color=_STATES[state], lw=0))
        if state == "open":
            ax.axvspan(start - 0.5, stop - 0.5, color=_STATES[state], alpha=0.15, lw=0)
    for frame, text, colour in changes:
        above.text(
            frame, 1.12, text, ha="center", va="bottom", fontsize=8, rotation=90, color=colour
        )
    above.set(ylim=(0, 2.6), yticks=[])
    for side in ("top", "right", "left"):
        above.spines[side].set_visible(False)
    above.legend(
        handles=[
            Patch(color=_STATES["open"], label="open bed, still: averaged"),
            Patch(color=_STATES["occluded"], label="still, but hidden"),
            Patch(color=_STATES["short"], label="too short"),
        ],
        fontsize=8, ncols=3, loc="upper right", bbox_to_anchor=(1, 1.35), frameon=False,
    )  # fmt: skip
    ax.fill_between(range(count), 100 * occluded, step="mid", color="tab:red", alpha=0.4, lw=0,
                    label="hidden by a hand or arm")  # fmt: skip
    ax.plot(100 * motion, color="tab:blue", lw=1, label="differs from the frame before")
    ax.set(xlabel="frame", ylabel="share of the image (%)", xlim=(-0.5, count - 0.5))
    ax.set_ylim(bottom=0)
    ax.legend(fontsize=8, loc="upper right")
    ax.grid(alpha=0.3)
    if title:
        figure.suptitle(title, fontsize=10)
    return figure


@own_style()
def contact_sheet(tiles: Sequence[Tile]) -> Figure:
    """Prior, difference and box of up to `PER_PAGE` pairs, side by side."""
    rows = -(-len(tiles) // _ROW)
    columns = min(len(tiles), _ROW)
    shape = tiles[0].prior_mm.shape
    tall = 1.9 * shape[0] / shape[1] + 0.34
    figure = Figure(
        figsize=(3.9 * columns + 0.9, max(tall * rows + 0.1, 2.2)), layout="constrained"
    )
    axes = figure.subplots(rows, 2 * columns, squeeze=False)
    # Rims of a millimetre decide where a box ends; deep craters are seen anyway.
    reach = float(np.clip(max(_reach(tile.change_mm) for tile in tiles), 1.0, 6.0))
    step = max(1, shape[1] // 240)
    extent = (-0.5, shape[1] - 0.5, shape[0] - 0.5, -0.5)
    drawn = None
    for ax in axes.reshape(-1):
        ax.set_axis_off()
    for k, tile in enumerate(tiles):
        left, right = axes[k // columns, 2 * (k % columns) : 2 * (k % columns) + 2]
        depth = tile.prior_mm[::step, ::step]
        seen = depth[np.isfinite(depth)]
        low, high = np.percentile(seen, (1, 99)) if seen.size else (0.0, 1.0)
        left.imshow(depth, cmap="gray_r", vmin=low - 2, vmax=high + 2, extent=extent)
        drawn = right.imshow(
            tile.change_mm[::step, ::step], cmap="RdBu_r", vmin=-reach, vmax=reach, extent=extent
        )
        colour = COLOURS.get(tile.action, "black")
        x, y, w, h = tile.box
        for ax in (left, right):
            ax.add_patch(Rectangle((x - 0.5, y - 0.5), w, h, fill=False, edgecolor=colour, lw=1.4,
                                   linestyle="--" if tile.by_hand else "-"))  # fmt: skip
            ax.plot(x + w // 2, y + h // 2, "+", color=colour, markersize=5)
        left.set_title(tile.title, fontsize=7, loc="left", pad=2)
    if drawn is not None:
        label = "sunk: red, + (mm)"  # one row of pairs is 2.2 inches high
        figure.colorbar(drawn, ax=axes, label=label, shrink=0.6, pad=0.01, extend="both")
    return figure


def _reach(change: np.ndarray) -> float:
    known = np.abs(change[np.isfinite(change)])
    return float(np.percentile(known, 99.8)) if known.size else 0.0
