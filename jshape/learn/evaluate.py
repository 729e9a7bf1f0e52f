"""How many millimetres predictions are from what really came out: the studies, ready to call.

Each runs a `Study` to its end; iterate over the study itself to watch it.
"""

from collections.abc import Sequence
from itertools import chain
from typing import Any

import numpy as np

from jshape.data.pairs import Pairs
from jshape.errors import BadBank
from jshape.learn.noise_floor import noise_floor
from jshape.learn.scores import Score, roi_errors_mm, score, summarise, with_floor
from jshape.learn.study import Candidate, Study, check_start
from jshape.models.bank import Bank

FEW = (5, 10, 25)
"""Pairs of another agent or material that a bank is adapted with."""


def evaluate(bank: Bank, pairs: Pairs) -> list[Score]:
    """Errors of a finished bank on pairs that it was not fitted to, per action and agent.

    Raises:
      BadCamera: bank and pairs have different cameras.
      BadDataset: a pair without a single pixel seen before and after.
      UnknownName: pairs of an action that the bank does not have.
    """
    floors, found = noise_floor(pairs), []
    for action, of_action in pairs.by_action():
        for agent in dict.fromkeys(of_action.agent.tolist()):
            errors = roi_errors_mm(bank, of_action.of(agent=agent), action)
            line = score(action, agent, [errors], predictor=bank.kind)
            found.append(with_floor(line, floors.get((action, agent))))
    return found


def candidates_of(kinds: str | Sequence[str | Candidate]) -> list[Candidate]:
    """Kinds of bank by name, each once, to be fitted from nothing; one name is one kind."""
    names = [kinds] if isinstance(kinds, str) else list(dict.fromkeys(kinds))
    return [Candidate(name) if isinstance(name, str) else name for name in names]


def cross_validate(
    pairs: Pairs, kinds: str | Sequence[str | Candidate] = "D", **more: Any
) -> list[Score]:
    """Errors over random partitions: fit on the larger part, test on the other, as the paper does.

    Agents are fitted apart: each is predicted by a bank of its own pairs.

    Args:
      pairs: of any actions, agents and materials.
      kinds: of banks; all are fitted to and tested on the same pairs.
      more: other fields of `Study`: partitions, test_share, seed, sizes, across, options.

    Raises:
      UnknownName, BadDataset, JShapeError: as for `Study`.
    """
    return scores_of(Study(pairs, candidates_of(kinds), **more))


def few_shot(
    pairs: Pairs, start: Bank, sizes: Sequence[int] = FEW, name: str = "start", **more: Any
) -> Study:
    """A bank of another agent or material, adapted with few pairs, beside training from scratch.

    Compared are the bank as it is, adapted, its kind fitted from nothing, and f_D.

    Args:
      pairs: of the new agent or material; those of actions that the bank knows are used.
      start: the bank to start from.
      sizes: pairs per action to adapt with.
      name: what to call the bank in tables.
      more: other fields of `Study`.

    Raises:
      BadBank: `start` is of kind "D", to which other pairs add nothing, or knows none of the
        actions.
      BadCamera: it is for another camera.
      BadDataset: as for `Study`.
    """
    check_start(start, pairs)
    if start.kind == "D":
        raise BadBank(f"{name} is of kind 'D', which learns nothing from a start; bring another")
    candidates = [
        Candidate(start.kind, start, fitted=False, name=f"{name} as it is"),
        Candidate(start.kind, start, name=f"{start.kind} from {name}"),
        Candidate(start.kind, name=f"{start.kind} from scratch"),
        Candidate("D", name="D from scratch"),
    ]
    known = pairs.select(np.isin(pairs.action, start.actions))
    return Study(known, candidates, sizes=sizes, **more)


def scores_of(study: Study) -> list[Score]:
    """The scores of a whole study, each beside its noise floor."""
    return summarise(chain.from_iterable(study), noise_floor(study.pairs))
