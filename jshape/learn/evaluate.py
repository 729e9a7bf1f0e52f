"""How many millimetres a bank's predictions are from what really came out."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from jshape import metric
from jshape.camera import check_same_camera
from jshape.data.pairs import Pairs
from jshape.errors import BadDataset
from jshape.learn.fit import fit
from jshape.predict.bank import Bank


class Score(NamedTuple):
    """One line of an evaluation."""

    action: str
    agent: str
    count: int
    """Pairs tested (with partitions: over all of them)."""
    mean_mm: float
    """Mean error over the ROI."""
    std_mm: float
    """Standard deviation over the pairs, or over the partitions' means where there are several."""
    change_mm: float
    """Mean change that the action makes over the ROI: the error of predicting nothing."""


def roi_errors_mm(bank: Bank, pairs: Pairs, action: str) -> tuple[np.ndarray, np.ndarray]:
    """Errors of the bank on the pairs of one action, and the changes themselves: (n,) mm each.

    The error is d between the predicted and the true ROI (Eq. distNewImg) as the mean distance of
    matched points.  Pixels without a reading are left out.

    Raises:
      BadCamera: bank and pairs have different cameras.
      BadDataset: a pair without a single pixel seen before and after.
    """
    check_same_camera(bank.camera, pairs.camera, "the data set's")
    prior, posterior, _ = pairs.rois(action, bank.roi(action))
    blind = ~(np.isfinite(prior) & np.isfinite(posterior)).any((1, 2))
    if blind.any():
        name = pairs.of(action=action).id[blind][0]
        raise BadDataset(f"pair {name}: no pixel of its ROI has a reading before and after")
    to_mm = float(metric.to_mm(1.0, bank.camera))
    predicted = bank.predict(action, prior, position=pairs.of(action=action).centre)
    error = np.abs(np.asarray(predicted) - posterior)
    change = np.abs(posterior - prior)
    return np.nanmean(error, (1, 2)) * to_mm, np.nanmean(change, (1, 2)) * to_mm


def evaluate(bank: Bank, pairs: Pairs) -> list[Score]:
    """Errors of a finished bank on pairs that it was not fitted to, per action and agent."""
    return [_score(action, agent, [errors]) for action, agent, errors in _cells(bank, pairs)]


def cross_validate(
    pairs: Pairs, kind: str = "D", *, partitions: int = 4, test_share: float = 0.25, seed: int = 0
) -> list[Score]:
    """Errors over random partitions: fit on the larger part, test on the other, as the paper does.

    Agents are fitted apart: each is predicted by a bank of its own pairs.

    Raises:
      BadDataset: an action of an agent with too few pairs to split.
    """
    rng = np.random.default_rng(seed)
    found: dict[tuple[str, str], list] = {}
    for agent in dict.fromkeys(pairs.agent.tolist()):
        mine = pairs.of(agent=agent)
        for _ in range(partitions):
            test = np.zeros(len(mine), bool)
            for action in mine.actions:
                index = np.flatnonzero(mine.action == action)
                tested = max(1, round(test_share * len(index)))
                if tested >= len(index):
                    raise BadDataset(
                        f"{action} of {agent}: {len(index)} pair(s) cannot be split for testing"
                    )
                test[rng.permutation(index)[:tested]] = True
            bank = fit(mine.select(~test), kind)
            for action, agent_name, errors in _cells(bank, mine.select(test)):
                found.setdefault((action, agent_name), []).append(errors)
    return [_score(action, agent, errors) for (action, agent), errors in found.items()]


def _cells(bank: Bank, pairs: Pairs) -> Iterator[tuple[str, str, tuple[np.ndarray, np.ndarray]]]:
    for action, of_action in pairs.by_action():
        for agent in dict.fromkeys(of_action.agent.tolist()):
            yield action, agent, roi_errors_mm(bank, of_action.of(agent=agent), action)


def _score(action: str, agent: str, parts: list[tuple[np.ndarray, np.ndarray]]) -> Score:
    errors = np.concatenate([error for error, _ in parts])
    changes = np.concatenate([change for _, change in parts])
    spread = errors if len(parts) == 1 else np.array([error.mean() for error, _ in parts])
    return Score(
        action, agent, len(errors), float(errors.mean()), float(spread.std()), float(changes.mean())
    )
