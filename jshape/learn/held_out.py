"""How wrong a bank that was fitted here usually is, on pairs that are held out for it."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from jshape._typing import Float
from jshape.data.pairs import Pairs
from jshape.errors import BadDataset
from jshape.learn.partitions import Candidate, Study
from jshape.predict.bank import Bank

LEAST_PAIRS = 4
"""With fewer pairs of an action its error is not known: one is tested, and three are fitted to."""
ENOUGH = 24
"""Pairs tested that are enough: errors vary by a third from pair to pair, their mean by 7 %."""
TEST_SHARE = 0.25
"""Of an action's pairs, as the paper does."""
MOST = {"D": 4, "P": 2}
"""Most partitions, for the kinds that are fitted in seconds.  Networks take hours and know their
error from training."""


def held_out_errors(
    bank: Bank,
    pairs: Pairs,
    *,
    start: Bank | None = None,
    report: Callable[[str, int, int], None] | None = None,
    **options: Any,
) -> Float[np.ndarray, "A"]:
    """Mean errors of a bank's kind on pairs of each action that it was not fitted to, mm.

    Random partitions of 75/25, as `learn.evaluate.cross_validate` makes, but over the bank's own
    ROIs and, as in the bank, with the pairs of all agents together.  What is tested was fitted to
    a quarter less than the bank, so the bank is a little better.

    Args:
      bank: that was fitted to all the pairs.
      pairs: what it was fitted to.
      start: what it was fitted from.
      report: told (action, fits made, fits in all) after every fit.
      options: of training, as for `fit`.

    Returns:
      Per action of the bank; NaN where it has too few pairs, or too few readings to do without
      some of them, or the kind takes too long to fit again.
    """
    counts = {name: int((pairs.action == name).sum()) for name in bank.actions}
    partitions = {
        name: min(-(-ENOUGH // round(TEST_SHARE * count)), MOST[bank.kind])
        for name, count in counts.items()
        if count >= LEAST_PAIRS and bank.kind in MOST
    }
    found, made = {}, 0
    for name, many in partitions.items():
        mine = pairs.of(action=name)  # one action at a time: its frames are copied
        one_agent, size = np.full(len(mine), "all"), np.full_like(mine.size, bank.roi(name))
        mine = replace(mine, agent=one_agent, size=size)
        study = Study(mine, [Candidate(bank.kind, start)], many, TEST_SHARE, options=options)
        errors = []
        try:
            for trials in study:
                errors += [trial.error_mm for trial in trials]
                made += 1
                if report is not None:
                    report(name, made, sum(partitions.values()))
        except BadDataset:  # pixels that only the pairs left out have seen
            continue
        found[name] = float(np.concatenate(errors).mean())
    return np.array([found.get(name, np.nan) for name in bank.actions], np.float32)
