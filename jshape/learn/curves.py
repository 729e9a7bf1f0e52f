"""Training curves: a table as CSV and a picture."""

import csv
import io
from collections.abc import Mapping, Sequence

from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from jshape.learn.training import Row
from jshape.viz.style import own_style


def curves_csv(curves: Mapping[str, Sequence[Row]], to_mm: float) -> str:
    """The epochs of all actions as one CSV; losses are mean distances over the ROI, mm.

    `to_mm` is mm per unit of d.
    """
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(("action", "epoch", "train_mm", "validation_mm", "seconds"))
    for action, rows in curves.items():
        for row in rows:
            losses = (f"{loss * to_mm:.6g}" for loss in (row.train, row.validation))
            writer.writerow((action, row.epoch, *losses, f"{row.seconds:.4g}"))
    return stream.getvalue()


@own_style()
def curves_figure(curves: Mapping[str, Sequence[Row]], to_mm: float) -> Figure:
    """One panel per action: training and validation loss (mm) over epochs, and the best epoch."""
    figure = Figure(figsize=(4.2 * len(curves), 3.4), layout="constrained")
    for ax, (action, rows) in zip(
        figure.subplots(1, len(curves), squeeze=False)[0], curves.items(), strict=True
    ):
        epochs = [row.epoch for row in rows]
        best = min(rows, key=lambda row: row.score)
        ax.plot(epochs, [row.train * to_mm for row in rows], label="training")
        if best.validation == best.validation:
            ax.plot(epochs, [row.validation * to_mm for row in rows], label="validation")
        ax.plot(best.epoch, best.score * to_mm, "ko", label=f"kept: {best.score * to_mm:.3g} mm")
        ax.set_yscale("log")
        ax.set_xlabel("epoch")
        ax.set_ylabel("mean distance over the ROI (mm)")
        ax.set_title(action, fontsize=10)
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
        ax.grid(alpha=0.3, which="both")
        ax.legend()
    return figure
