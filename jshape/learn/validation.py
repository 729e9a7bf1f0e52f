"""How wrong a bank that was fitted here usually is, on pairs that are held out for it.

`fit` is `learn.fit.fit` with that question asked: beside the mean difference f_D and beside doing
nothing, and f_D is kept for an action that the bank's own kind predicts worse.
"""

import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh

from jshape.data.pairs import Pairs
from jshape.errors import BadDataset
from jshape.learn import fit as fitting
from jshape.learn.imprint import mean_imprint
from jshape.learn.intervals import fit_spread, with_more_pairs
from jshape.learn.scores import Errors, Trial, errors_of
from jshape.learn.settings import settings_from
from jshape.learn.study import Candidate, Study
from jshape.learn.training import split
from jshape.models.bank import Bank
from jshape.models.base import Predictor
from jshape.models.difference import fit_difference

LEAST_PAIRS = 4
"""With fewer pairs of an action its error is not known: one is tested, and three are fitted to."""
LEAST_COMPARED = 2
"""Pairs that a kind is compared with f_D on: both are then fitted to one and tested on the other,
which tells a fit that went wrong, though not how good the bank is."""
ENOUGH = 24
"""Pairs tested that are enough: errors vary by a third from pair to pair, their mean by 7 %."""
TEST_SHARE = 0.25
"""Of an action's pairs, as the paper does."""
MOST = {"D": 4, "P": 2}
"""Most partitions, for the kinds that are fitted in seconds.  Networks take hours and know their
error from training."""
WORSE = 0.1
"""A kind is worse than another if it is by this share and by twice the standard error of their
difference: f_P and f_D differ by less on a level bed, where nothing is to be won."""


class Validation(NamedTuple):
    """What pairs that were held out say of one action's predictor; mean errors in mm."""

    action: str
    tested: int
    """Pairs tested, over all partitions."""
    mm: float
    """Of the bank's kind."""
    difference_mm: float
    """Of f_D, fitted to the same pairs."""
    nothing_mm: float
    """Of predicting no change."""
    worse: bool
    """f_D is clearly better, so that it is kept for this action."""
    useless: bool
    """Even the better of the two is not clearly better than predicting no change."""
    spread: tuple[float, float]
    """(mm, share) of the 80 % interval of what the bank holds, as `Bank.intervals`."""

    @property
    def kept_mm(self) -> float:
        """Of what the bank holds for this action."""
        return self.difference_mm if self.worse else self.mm

    def warning(self, kind: str) -> str:
        """What is wrong with it, in one sentence; "" is nothing."""
        if not (self.worse or self.useless):
            return ""
        off = f"the mean difference {self.difference_mm:.2f}, doing nothing {self.nothing_mm:.2f}"
        if kind != "D":
            off = f"f_{kind} {self.mm:.2f}, {off}"
        said = []
        if self.worse:
            said.append("the mean difference is kept for it")
        if self.useless:
            said.append("its pairs do not show what it does: look at their boxes, or bring more")
        return f"{self.action}: on {self.tested} held-out pairs, mm off: {off}; {'; '.join(said)}"


def fit(
    pairs: Pairs,
    kind: str = "D",
    *,
    start: Bank | None = None,
    report: Callable[[Any], None] | None = None,
    keep: Callable[[str], Any] | None = None,
    mesh: Mesh | None = None,
    **options: Any,
) -> Bank:
    """A bank of one kind, fitted to pairs: one predictor per action in them.

    Every action is compared with the mean difference f_D on pairs that were held out (networks: on
    those of their validation).  Where the kind is worse, by a tenth and by twice the standard
    error, the mean difference is kept for that action and a warning says so with the numbers;
    another says where even that is no better than predicting no change.  With one pair of an
    action, or without validation, nothing is compared.

    Args:
      pairs: of any actions; each action's ROI size is the mean over its pairs.
      kind: "D" is f_D, the mean difference (Eq. DiffImage), which needs no training; "P" a tool
        pressed into the bed; "C" a U-Net (Eq. Coutput), "DC" one applied to I + ΔI (Eq. lossD);
        "CR" and "DCR" the same two, refined (Eq. RCoutput, Eq. DRCoutput).
      start: a bank of the same kind with all the actions, whose predictors training starts from:
        few pairs are then enough.  Their ROI sizes are used.
      report: told of every epoch of every action's training.
      keep: name of an action -> where its training is saved and resumed from, or None.
      mesh: devices that share every batch, as `planning.devices.mesh_of` makes it; None is one.
      options: fields of `Training`: epochs, batch, learning_rate, validation, patience, seed, ...

    Returns:
      The bank, with the errors on held-out pairs of actions with at least 4 pairs as `errors_mm`,
      and the 80 % intervals that cover them as `spread`.

    Raises:
      UnknownName: no such kind.
      BadDataset: no pairs, a ROI outside the image, pixels that no pair has seen, too few pairs, or
        strengths other than 1 for a network.
      BadBank: `start` is of another kind, or lacks an action.
      BadCamera: `start` is for another camera.
      JShapeError: an unknown option, or one out of its range.
    """
    left_out = len(pairs) - len(pairs := pairs.of_usual_paths())
    if left_out:
        warnings.warn(
            f"{left_out} pair(s) are left out, whose path is longer or shorter than the usual one "
            "of their action: a bank holds one length, which plans stretch",
            stacklevel=2,
        )
    bank = fitting.fit(pairs, kind, start=start, report=report, keep=keep, mesh=mesh, **options)
    rows = validate(bank, pairs, start=start, **options)
    for row in rows:
        if warning := row.warning(kind):
            warnings.warn(warning, stacklevel=2)
    known = {
        row.action: (row.kept_mm, *row.spread)
        for row in rows
        if int((pairs.action == row.action).sum()) >= LEAST_PAIRS
    }
    table = jnp.array([known.get(name, (np.nan,) * 3) for name in bank.actions], jnp.float32)
    who = ", ".join(dict.fromkeys([*pairs.agent.tolist(), *pairs.material.tolist()]))
    return replace(
        without_worse(bank, pairs, rows),
        errors_mm=table[:, 0] if known else None,
        intervals=table[:, 1:] if known else None,
        fitted_to=f"{len(pairs)} pairs ({who})",
    )


def validate(
    bank: Bank,
    pairs: Pairs,
    *,
    start: Bank | None = None,
    report: Callable[[str, int, int], None] | None = None,
    **options: Any,
) -> list[Validation]:
    """Mean errors of a bank's kind on pairs of each action that it was not fitted to.

    Kinds that are fitted in seconds are fitted again, to random partitions of 75/25, over the
    bank's own ROIs and all agents together: the bank, fitted to a third more, is a little better,
    which only intervals allow for.
    Networks are tested on the pairs that chose their best epoch: they are a little worse.  An
    action with too few pairs, or too few readings to do without some, has no row.

    `pairs`, `start` and the options are what the bank was fitted to, from and with; `report` is
    told (action, fits made, fits in all) after every fit.
    """
    if bank.kind not in MOST:
        return _on_validation(bank, pairs, options)
    partitions = {
        name: min(-(-ENOUGH // max(1, round(TEST_SHARE * count))), MOST[bank.kind])
        for name in bank.actions
        if (count := int((pairs.action == name).sum())) >= LEAST_COMPARED
    }
    candidates = [Candidate(bank.kind, start, name="mine")]
    if bank.kind != "D":
        candidates.append(Candidate("D"))
    total = len(candidates) * sum(partitions.values())
    found, made = [], 0
    for name, many in partitions.items():
        mine = pairs.of(action=name)  # one action at a time: its frames are copied
        one_agent, size = np.full(len(mine), "all"), np.full_like(mine.size, bank.roi(name))
        mine = replace(mine, agent=one_agent, size=size)
        study = Study(mine, candidates, many, TEST_SHARE, options=options)
        tested: dict[str, list[Trial]] = {}
        try:
            for trials in study:
                for trial in trials:
                    tested.setdefault(trial.predictor, []).append(trial)
                made += 1
                if report is not None:
                    report(name, made, total)
        except BadDataset:  # pixels that only the pairs left out have seen
            continue
        own = _together(tested["mine"])
        scale = with_more_pairs(tested["mine"][0].pairs, len(mine))
        found.append(_row(name, own, _together(tested["D"]) if "D" in tested else own, scale))
    return found


def _together(trials: list[Trial]) -> Errors:
    """Those of all partitions."""
    fields = zip(*(trial[-3:] for trial in trials), strict=True)
    return Errors(*map(np.concatenate, fields))


def _on_validation(bank: Bank, pairs: Pairs, options: Mapping[str, Any]) -> list[Validation]:
    """The rows of networks: what they cost is one prediction of each pair."""
    settings, found = settings_from(dict(options)), []
    for name in bank.actions:
        examples = pairs.rois(name, bank.roi(name), padded=True)
        training, kept_out = split(examples, settings)
        if len(kept_out.prior) == 0:
            continue
        try:
            plain = fit_difference(*training.without_blind()[:2])
        except BadDataset:  # pixels that only the pairs kept out have seen
            continue
        own = errors_of(bank.predictor(name), kept_out, bank.camera)
        found.append(_row(name, own, errors_of(plain, kept_out, bank.camera)))
    return found


def _row(name: str, own: Errors, difference: Errors, scale: float = 1.0) -> Validation:
    worse, nothing = _worse(own.error_mm, difference.error_mm), own.change_mm
    kept = difference if worse else own
    useless = len(nothing) > 1 and not _worse(nothing, kept.error_mm)
    return Validation(
        action=name,
        tested=len(nothing),
        mm=float(own.error_mm.mean()),
        difference_mm=float(difference.error_mm.mean()),
        nothing_mm=float(nothing.mean()),
        worse=worse,
        useless=useless,
        spread=fit_spread(kept.pixels_mm, scale),
    )


def _worse(errors: np.ndarray, others: np.ndarray) -> bool:
    """Whether errors (n,) of the same pairs are clearly larger; one pair says nothing."""
    gap = errors - others
    if len(gap) < 2:
        return False
    spread = float(gap.std(ddof=1)) / len(gap) ** 0.5
    return bool(gap.mean() > max(WORSE * float(others.mean()), 2.0 * spread))


def without_worse(bank: Bank, pairs: Pairs, rows: list[Validation]) -> Bank:
    """The bank with the mean difference of all pairs for the actions it is better for.

    In a bank of f_P it is the mean change of the bed, so that the hand can still be turned and
    the camera be another one.
    """
    worse = {row.action for row in rows if row.worse}

    def kept(name: str, predictor: Predictor) -> Predictor:
        if name not in worse:
            return predictor
        examples = pairs.rois(name, bank.roi(name), padded=True).without_blind()
        if bank.kind == "P":
            return mean_imprint(examples, bank.camera)
        return fit_difference(examples.prior, examples.posterior, examples.strengths)

    predictors = zip(bank.actions, bank.predictors, strict=True)
    return replace(bank, predictors=tuple(kept(name, one) for name, one in predictors))
