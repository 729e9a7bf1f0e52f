"""`jshape train DATASET --out BANK`."""

import sys
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from jshape.cli.names import Bank
from jshape.cli.options import Common, Count, Devices, Positive, PositiveCount, Seed, Share, Writes
from jshape.cli.tables import bar, print_table
from jshape.errors import JShapeError
from jshape.io import banks, checkpoints, datasets, folders
from jshape.learn.fit import FITTERS
from jshape.learn.settings import Training
from jshape.planning import devices
from jshape.viz.style import drawn

if TYPE_CHECKING:
    Kind = str
else:
    Kind = Literal[tuple(FITTERS)] | str


@dataclass(frozen=True, kw_only=True)
class Trains(Common, Training):
    """The fields of `learn.settings.Training`, as the command line reads them."""

    epochs: PositiveCount = Training.epochs
    batch: PositiveCount = Training.batch
    learning_rate: Positive = Training.learning_rate
    validation: Share = Training.validation
    patience: Count = Training.patience
    seed: Seed = Training.seed
    save_every: PositiveCount = Training.save_every
    width: PositiveCount = Training.width
    morphology: Literal["erode", "dilate"] = "erode"


WITHOUT_CHECKPOINTS = ("D", "P")
"""Kinds that are fitted in seconds: there is nothing to go on from."""
OF_NETWORKS = tuple(one.name for one in fields(Training) if one.name != "seed")
"""TrainOptions that those kinds do not use."""


@dataclass(frozen=True, kw_only=True)
class TrainOptions(Trains, Writes):
    """Of `jshape train`."""

    out: Path
    """Folder for the new bank."""
    kind: Kind = "P"
    """Kind of predictor. P: a tool pressed into the bed, the best; D: the mean difference; C, DC: a
    U-Net, alone or after D; CR, DCR: the same, refined as in the paper."""
    licence: str = ""
    """Licence of the bank, for its manifest."""
    start: Bank | None = None
    """Bank to start the training from."""
    restart: bool = False
    """Forget an interrupted training in OUT.training instead of resuming it."""
    devices: Devices | None = None
    """CPU devices that share a network's batches (default: 1)."""


def train(dataset: Path, /, options: TrainOptions) -> dict[str, Any]:
    """Train a bank, judge it on pairs that were held out, write it.

    Args:
      dataset: Folder with pairs.csv.
    """
    keeps = options.kind not in WITHOUT_CHECKPOINTS
    if not keeps:
        why = f": kind {options.kind} trains no network and does not use it"
        options.refuse((*OF_NETWORKS, "devices"), why)
    # First of all: what loads a bank starts JAX.
    mesh = None if options.devices is None else devices.mesh_of(options.devices, "batch")
    from jshape import metric
    from jshape.learn import curves as drawings
    from jshape.learn.fit import fit
    from jshape.learn.validation import LEAST_PAIRS, without_worse

    folders.check_target(options.out, options.overwrite, contents=banks.CONTENTS)
    kept = folders.beside(options.out, ".training")
    if options.restart:
        checkpoints.discard(kept)
    resumed = (keeps or kept.is_dir()) and checkpoints.check_folder(kept)
    if resumed and not keeps:
        raise JShapeError(
            f"{kept}: holds an interrupted training of another kind; --restart removes it"
        )
    start = banks.load_bank(options.start) if options.start is not None else None
    pairs = datasets.load_pairs(dataset)
    learning = [one.name for one in fields(Training) if one.name in options.given]
    settings = {name: getattr(options, name) for name in learning}
    to_mm = float(metric.to_mm(1.0, pairs.camera))
    watch = _Watch(to_mm, f"going on from {kept} (--restart starts again)" if resumed else "")
    try:
        keep = (lambda action: checkpoints.Checkpoints(kept, action)) if keeps else None
        bank = fit(pairs, options.kind, start=start, report=watch, keep=keep, mesh=mesh, **settings)
        watch.close()
        rows = _validated(bank, pairs, start, settings)
        bank = without_worse(bank, pairs, rows)
    except KeyboardInterrupt:
        watch.close()
        if keeps and kept.is_dir():
            raise JShapeError(
                f"interrupted; the same command goes on from its last checkpoint in {kept}"
            ) from None
        raise
    finally:
        watch.close()
    count = {name: len(mine) for name, mine in pairs.by_action()}
    agents, materials = (list(dict.fromkeys(x.tolist())) for x in (pairs.agent, pairs.material))
    errors = {name: best.validation * to_mm for name, best in watch.best.items()}
    errors |= {row.action: row.kept_mm for row in rows if row.worse or not keeps}
    spreads = {row.action: {"spread": list(row.spread)} for row in rows}
    known = {name: mm for name, mm in errors.items() if count[name] >= LEAST_PAIRS and mm == mm}
    info: dict[str, Any] = {
        "data": {"pairs": count, "agents": agents, "materials": materials},
        "errors": [{"action": n, "mm": mm} | spreads.get(n, {}) for n, mm in known.items()],
        "licence": options.licence,
        "held_out": [
            {k: v for k, v in row._asdict().items() if k not in ("worse", "useless", "spread")}
            | {"kept": "D" if row.worse else bank.kind}
            for row in rows
        ],
    }
    curves: dict[str, str | bytes] = {}
    if watch.curves:
        info["training"] = watch.summary()
        curves["curve.csv"] = drawings.curves_csv(watch.curves, to_mm)
        curves |= drawn({"curve.png": partial(drawings.curves_figure, watch.curves, to_mm)})
    banks.save_bank(bank, options.out, info=info, extras=curves, overwrite=options.overwrite)
    if keeps:
        checkpoints.discard(kept)
    for row in rows:
        if warning := row.warning(bank.kind):
            print(f"warning: {warning}", file=sys.stderr)
    print(f"bank of kind {bank.kind}: {options.out}")
    beside = {r.action: (f"{r.nothing_mm:.2f}", f"{r.difference_mm:.2f}") for r in rows}
    mine = {name: f"{mm:.2f}" for name, mm in known.items()}
    print_table(
        ("action", "pairs", "ROI (w x h)", "doing nothing (mm)", "f_D (mm)", "error (mm)"),
        [
            (name, count[name], "{}x{}".format(*roi), *beside.get(name, ("—", "—")))
            + (mine.get(name, "—"),)
            for name, roi in bank.rois.items()
        ],
    )
    for name, found in info.get("training", {}).items():
        print(
            f"{name}: {found['epochs']} epochs, {found['seconds']:.0f} s; best is epoch "
            f"{found['best_epoch']} with {found['best_mm']:.3f} mm"
        )
    return {"training": {}} | info | {"out": str(options.out), "kind": bank.kind, "rois": bank.rois}


def _validated(bank: Any, pairs: Any, start: Any, settings: dict[str, Any]) -> list[Any]:
    """How the bank does on pairs that were held out, beside f_D and doing nothing."""
    from jshape.learn.validation import validate

    with bar("errors on held-out pairs") as tell:

        def report(action: str, made: int, total: int) -> None:
            tell(completed=made, total=total, said=action)

        return validate(bank, pairs, start=start, report=report, **settings)


class _Watch:
    """Progress bars, one per action, and what the curves were; quiet where nobody looks."""

    def __init__(self, to_mm: float, going_on: str = ""):
        self.to_mm = to_mm
        self.going_on = going_on
        """What to say once a checkpoint was accepted."""
        self.curves: dict[str, tuple] = {}
        self.best: dict[str, Any] = {}
        self.bars = ExitStack()
        self.tell: Callable[..., None] = lambda **_: None
        self.shown = ""

    def __call__(self, progress: Any) -> None:
        made = len(progress.curve)
        if self.going_on and made > 1:
            print(self.going_on, file=sys.stderr)
        self.going_on = ""
        if progress.action != self.shown:
            self.close()
            self.shown = progress.action
            one = bar(progress.action, progress.epochs, made - 1)
            self.tell = self.bars.enter_context(one)
        self.curves[progress.action], self.best[progress.action] = progress.curve, progress.best
        last, best = (one.score * self.to_mm for one in (progress.curve[-1], progress.best))
        self.tell(completed=made, said=f"{last:.3f} mm, best {best:.3f}")

    def close(self) -> None:
        """End the last bar."""
        self.bars.close()

    def summary(self) -> dict[str, dict[str, int | float]]:
        """What training came to, per action, for the manifest."""
        return {
            name: {
                "epochs": len(rows),
                "best_epoch": self.best[name].epoch,
                "best_mm": self.best[name].score * self.to_mm,
                "seconds": sum(row.seconds for row in rows),
            }
            for name, rows in self.curves.items()
        }
