"""Which pairs are fitted to and which are kept out: the same for everything that is compared."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from jshape.camera import check_same_camera
from jshape.data.pairs import Pairs
from jshape.errors import BadBank, BadDataset, JShapeError, UnknownName
from jshape.learn.fit import FITTERS, fit
from jshape.learn.scores import Trial, roi_errors
from jshape.learn.training import Progress
from jshape.models.bank import Bank
from jshape.models.refined import Refined


class Split(NamedTuple):
    """Indices into the data set, of one agent."""

    train: np.ndarray
    """In random order per action, so that the first n of each are a smaller training set."""
    test: np.ndarray


class Candidate(NamedTuple):
    """What is compared: a kind of bank, how it begins, and whether it is fitted at all."""

    kind: str
    start: Bank | None = None
    """Training starts from this bank; None is from nothing."""
    fitted: bool = True
    """False: `start` is tested as it is."""
    name: str = ""
    """In tables; "" is the kind."""

    @property
    def label(self) -> str:
        """What it is called in tables and figures."""
        return self.name or self.kind


def split_pairs(
    pairs: Pairs, partitions: int = 4, test_share: float = 0.25, seed: int = 0
) -> list[dict[str, Split]]:
    """Random partitions, each with a split per agent; every action is split on its own.

    Raises:
      BadDataset: no pairs, or an action of an agent with too few pairs to split.
      JShapeError: no partition, or a share that is not between 0 and 1.
    """
    if partitions < 1:
        raise JShapeError(f"partitions is {partitions}; expected a whole number from 1")
    if not 0 < test_share < 1:
        raise JShapeError(f"test_share is {test_share}; expected a number between 0 and 1")
    if len(pairs) == 0:
        raise BadDataset("no pairs to split for testing")
    rng = np.random.default_rng(seed)
    found: list[dict[str, Split]] = [{} for _ in range(partitions)]
    for agent in dict.fromkeys(pairs.agent.tolist()):
        for splits in found:
            train, test = [], []
            for action in dict.fromkeys(pairs.action[pairs.agent == agent].tolist()):
                index = np.flatnonzero((pairs.agent == agent) & (pairs.action == action))
                tested = max(1, round(test_share * len(index)))
                if tested >= len(index):
                    raise BadDataset(
                        f"{action} of {agent}: {len(index)} pair(s) cannot be split for testing"
                    )
                order = rng.permutation(index)
                test.append(order[:tested])
                train.append(order[tested:])
            splits[agent] = Split(np.concatenate(train), np.sort(np.concatenate(test)))
    return found


def fewest(pairs: Pairs, test_share: float = 0.25) -> tuple[int, str, str]:
    """(n, action, agent): the smallest training set of a partition, and whose it is.

    Raises:
      BadDataset, JShapeError: as for `split_pairs`.
    """
    counts = {
        (action, agent): int((pairs.action[split.train] == action).sum())
        for agent, split in split_pairs(pairs, 1, test_share)[0].items()
        for action in dict.fromkeys(pairs.action[split.train].tolist())
    }
    action, agent = min(counts, key=lambda key: counts[key])
    return counts[action, agent], action, agent


@dataclass(frozen=True)
class Study:
    """Candidates over partitions, agents and sizes of the training set; iterate to run it.

    Each step of the iteration is one candidate on one training set, and gives its `Trial`s, so a
    study can be watched; `len` is the number of steps.  All candidates see the same training and
    test pairs and are measured over the same pixels, so that they can be compared pair by pair.  A
    network that is asked for both with and without refinement is trained once.

    Raises:
      UnknownName: a kind that is not in `FITTERS`.
      BadBank: a candidate that is neither fitted nor has a bank, or whose bank has no such action.
      BadCamera: a bank to start from is for another camera.
      BadDataset: no pairs, too few to split, or for a size; or `across` with those of one agent.
      JShapeError: two candidates of one name, or none; no partition, or a share to test with that
        is not between 0 and 1.
    """

    pairs: Pairs
    candidates: Sequence[Candidate]
    partitions: int = 4
    test_share: float = 0.25
    seed: int = 0
    """Of the partitions."""
    sizes: Sequence[int] = ()
    """Pairs per action to fit to: nested subsets, one and the same test.  Empty: all there are."""
    across: bool = False
    """Test what was fitted to one agent's pairs on every agent's test pairs."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Of training, see `learn.settings.Training`."""
    report: Callable[[Progress], None] | None = None
    """Told of every epoch of every training."""

    def __post_init__(self):
        split_pairs(self.pairs, self.partitions, self.test_share)
        labels = [candidate.label for candidate in self.candidates]
        if not labels or len(set(labels)) < len(labels):
            raise JShapeError(f"predictors to compare are {labels}; expected different ones")
        for kind, start, fitted, _ in self.candidates:
            if kind not in FITTERS:
                raise UnknownName("kind of bank", kind, FITTERS)
            if not fitted and start is None:
                raise BadBank(f"{kind} is not to be fitted and has no bank")
            if start is not None:
                check_start(start, self.pairs)
        agents = list(dict.fromkeys(self.pairs.agent.tolist()))
        if self.across and len(agents) < 2:
            raise BadDataset(f"testing across agents needs two; all pairs are of {agents[0]}")
        least, action, agent = fewest(self.pairs, self.test_share)
        if much := [size for size in self.sizes if not 0 < size <= least]:
            raise BadDataset(
                f"a training set of {much[0]} pairs per action: {action} of {agent} has {least}"
            )

    def _steps(self) -> list[tuple[int, str, int | None, Candidate]]:
        sizes = list(self.sizes) or [None]
        return [
            (partition, agent, size, candidate)
            for partition in range(self.partitions)
            for agent in dict.fromkeys(self.pairs.agent.tolist())
            for size in sizes
            for candidate in self.candidates
            # What is not fitted is the same for all sizes.
            if candidate.fitted or size == sizes[0]
        ]

    def __len__(self) -> int:
        return len(self._steps())

    def __iter__(self) -> Iterator[list[Trial]]:
        splits = split_pairs(self.pairs, self.partitions, self.test_share, self.seed)
        at, banks = None, {}
        for partition, agent, size, candidate in self._steps():
            if at != (partition, agent, size):
                at, banks = (partition, agent, size), {}
                training = self.pairs.select(self._first(splits[partition][agent].train, size))
            bank = self._bank(candidate, training, banks)
            yield self._test(bank, candidate, training, splits[partition])

    def _first(self, train: np.ndarray, size: int | None) -> np.ndarray:
        """The first `size` of every action, in the data set's order; None is all."""
        kept = [
            train[self.pairs.action[train] == action][:size]
            for action in dict.fromkeys(self.pairs.action[train].tolist())
        ]
        return np.sort(np.concatenate(kept))

    def _bank(self, candidate: Candidate, training: Pairs, banks: dict[Any, Bank]) -> Bank:
        """Fitted, or taken out of one of `banks` that was fitted to the same pairs."""
        kind, start, fitted, _ = candidate
        if not fitted and start is not None:
            return start
        refined = start is None and any(
            other.start is None and other.kind == kind + "R" for other in self.candidates
        )
        wanted = kind + "R" * refined, id(start)
        if wanted not in banks:
            how = {"start": start, "report": self.report, **self.options}
            banks[wanted] = fit(training, wanted[0], **how)
        return unrefined(banks[wanted], kind) if refined else banks[wanted]

    def _test(
        self, bank: Bank, candidate: Candidate, training: Pairs, splits: dict[str, Split]
    ) -> list[Trial]:
        mine, found = str(training.agent[0]), []
        for agent in splits if self.across else [mine]:
            kept_out = self.pairs.select(splits[agent].test)
            for action, held_out in kept_out.by_action():
                if action not in bank.actions:
                    continue
                fitted = int((training.action == action).sum()) if candidate.fitted else 0
                errors = roi_errors(bank, held_out, action, size=self.pairs.roi_size(action))
                whose = mine if candidate.fitted else ""
                found.append(
                    Trial(candidate.label, whose, agent, action, fitted, held_out.id, *errors)
                )
        return found


def check_start(start: Bank, pairs: Pairs) -> None:
    """Refuse a bank that has nothing to do with the pairs.

    Raises:
      BadBank: it has none of their actions.
      BadCamera: it is for another camera.
    """
    check_same_camera(start.camera, pairs.camera, "the data set's")
    if not set(pairs.actions) & set(start.actions):
        raise BadBank(
            f"the bank to start from knows {', '.join(start.actions)}; "
            f"the pairs are of {', '.join(pairs.actions)}"
        )


def unrefined(bank: Bank, kind: str) -> Bank:
    """The networks inside a refined bank's predictors, as a bank of `kind`: f_C out of f_CR."""
    inside = tuple(p.inside if isinstance(p, Refined) else p for p in bank.predictors)
    return Bank(bank.camera, inside, bank.actions, kind)
