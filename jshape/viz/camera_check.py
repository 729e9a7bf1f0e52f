"""The picture of a camera's check: what it sees, how it varies, how far the bed is from flat."""

import numpy as np
from matplotlib.figure import Figure

from jshape.viz.style import own_style


@own_style()
def check_figure(depth: np.ndarray, noise: np.ndarray, off: np.ndarray, title: str) -> Figure:
    """Depth, noise and deviation from the plane, beside each other.

    Args:
      depth: (H, W) metres, NaN = no reading.
      noise: (H, W) standard deviation over time, mm; may be all NaN.
      off: (H, W) distance from the plane, mm.
      title: above all.
    """
    figure = Figure(figsize=(15, 4.2), layout="constrained")
    reach = max(3.0, float(np.nanpercentile(np.abs(off), 90)))
    most = float(np.nanpercentile(noise, 98)) if np.isfinite(noise).any() else 1.0
    for ax, image, name, scale in zip(
        figure.subplots(1, 3),
        (1e3 * depth, noise, off),
        ("depth (mm)", "noise over time (mm)", "above the plane (mm)"),
        (
            {"cmap": "viridis", **_span(1e3 * depth)},
            {"cmap": "magma", "vmin": 0.0, "vmax": max(most, 1e-3)},
            {"cmap": "RdBu_r", "vmin": -reach, "vmax": reach},
        ),
        strict=True,
    ):
        ax.set_facecolor("black")  # what has no reading
        figure.colorbar(ax.imshow(image, **scale), ax=ax, shrink=0.85)
        ax.set_title(name)
        ax.set_xticks([])
        ax.set_yticks([])
    figure.suptitle(title)
    return figure


def _span(image: np.ndarray) -> dict[str, float]:
    low, high = np.nanpercentile(image, [2, 98])
    return {"vmin": float(low), "vmax": float(max(high, low + 1.0))}
