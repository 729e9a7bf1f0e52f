"""Errors of a bank over the ROIs of pairs in mm, and what many of them come to."""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jshape import metric
from jshape._typing import Array
from jshape.camera import Camera, check_same_camera
from jshape.data.missing import fill_nan
from jshape.data.pairs import SAME_PATH, Examples, Pairs
from jshape.errors import BadDataset
from jshape.learn.noise_floor import Floor
from jshape.models.bank import Bank
from jshape.models.base import Predictor
from jshape.models.spread import around, radii_px

BATCH = 8
"""ROIs predicted at once: a network's memory, and one compiled shape for any number of pairs."""
SAMPLED = 400
"""Pixels of a ROI that are kept of it: enough for a quantile, and 3 kB."""


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
    floor_mm: float | None = None
    """The noise floor (see `noise_floor`): what no predictor can beat; None where unknown."""
    floor_from: str = ""
    """From "repetitions"; or "flat": the floor is at most that; "" where it is unknown."""
    predictor: str = ""
    """What was tested: a kind of bank, and what it started from."""
    trained_on: str = ""
    """The agent whose pairs it was fitted to; "" for a bank that was not fitted here."""
    pairs: int = 0
    """Pairs of the action that it was fitted to; 0 if it was not fitted here."""


class Trial(NamedTuple):
    """The test of one fitted predictor on the pairs that were kept out."""

    predictor: str
    trained_on: str
    agent: str
    action: str
    pairs: int
    """Pairs of the action that it was fitted to."""
    id: np.ndarray
    """(n,) names of the pairs tested."""
    error_mm: np.ndarray
    """(n,) errors over the ROI."""
    change_mm: np.ndarray
    """(n,) changes by the action over the ROI."""
    pixels_mm: np.ndarray = np.zeros((0, SAMPLED, 2), np.float32)
    """(n, SAMPLED, 2) |error| and largest predicted change around, of pixels all over the ROI."""


class Errors(NamedTuple):
    """How far off a predictor is on n pairs, mm."""

    error_mm: np.ndarray
    """(n,) mean errors over the ROI."""
    change_mm: np.ndarray
    """(n,) mean changes by the action over the ROI."""
    pixels_mm: np.ndarray
    """(n, SAMPLED, 2) |error| and largest predicted change around, as in `Trial`."""


class Comparison(NamedTuple):
    """Two predictors on the same test pairs."""

    action: str
    agent: str
    trained_on: str
    predictor: str
    against: str
    count: int
    """Different pairs that both were tested on."""
    difference_mm: float
    """Mean error minus that of `against`: negative is better."""
    error_mm: float
    """Standard error of that mean over the pairs; NaN for a single pair."""
    better: float
    """Share of the pairs on which it is better, in [0, 1]."""


def roi_errors_mm(
    bank: Bank, pairs: Pairs, action: str, *, size: tuple[int, int] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Errors of the bank on the pairs of one action, and the changes themselves: (n,) mm each.

    The error is d between the predicted and the true ROI (Eq. distNewImg) as the mean distance of
    matched points.  Pixels without a reading before or after are left out; the predictor sees gaps
    filled, as planning does, and its path is as long as the pair's.  With a `size`, (w, h) pixels,
    the mean is over so many and not over the bank's ROI (as long as the path makes it), so that
    banks with other ROIs can be compared: outside its own a bank predicts no change.

    Raises:
      BadCamera: bank and pairs have different cameras.
      BadDataset: a pair without a single pixel seen before and after, or a ROI outside the image.
      UnknownName: the bank or the pairs have no such action.
    """
    return roi_errors(bank, pairs, action, size=size)[:2]


def roi_errors(
    bank: Bank, pairs: Pairs, action: str, *, size: tuple[int, int] | None = None
) -> Errors:
    """`roi_errors_mm` with the errors of single pixels."""
    check_same_camera(bank.camera, pairs.camera, "the data set's")
    predictor, mine = bank.predictor(action), pairs.of(action=action)
    count = len(mine)
    found = Errors(np.zeros(count), np.zeros(count), np.zeros((count, SAMPLED, 2), np.float32))
    lengths = _lengths(predictor, mine)
    for length in np.unique(lengths):
        rows = lengths == length
        hand = predictor if length == 1 else predictor.lengthened(float(length))
        measured, predicted = _measured(hand, mine.select(rows), action, size)
        for whole, part in zip(found, _gaps(predicted, measured, bank.camera), strict=True):
            whole[rows] = part
    return found


def _lengths(predictor: Predictor, pairs: Pairs) -> np.ndarray:
    """(n,) path of each pair, times the predictor's; 1 where one has none, or about that."""
    if not predictor.path_mm:
        return np.ones(len(pairs))
    lengths = np.where(pairs.path_mm > 0, pairs.path_mm / predictor.path_mm, 1.0)
    return np.where(np.abs(lengths - 1.0) <= SAME_PATH, 1.0, lengths)


def _measured(
    hand: Predictor, pairs: Pairs, action: str, size: tuple[int, int] | None
) -> tuple[Examples, np.ndarray]:
    """The windows over which errors are taken, and what is predicted in them."""
    own = hand.roi
    inside = pairs.rois(action, own, padded=True)
    measured = inside if size in (None, own) else pairs.rois(action, size, padded=True)
    seen = measured.seen
    if not seen.any((1, 2)).all():
        name = pairs.id[~seen.any((1, 2))][0]
        raise BadDataset(f"pair {name}: no pixel of its ROI has a reading before and after")
    predicted = _predict(hand, inside)
    return measured, predicted if measured is inside else _pasted(predicted, inside, measured)


def errors_of(predictor: Predictor, examples: Examples, camera: Camera) -> Errors:
    """The same of one predictor on examples of its ROI."""
    return _gaps(_predict(predictor, examples), examples, camera)


def _gaps(predicted: np.ndarray, measured: Examples, camera: Camera) -> Errors:
    to_mm, seen = float(metric.to_mm(1.0, camera)), measured.seen
    count = seen.sum((1, 2))
    error = np.where(seen, np.abs(predicted - measured.posterior), 0.0)
    change = np.where(seen, np.abs(measured.posterior - measured.prior), 0.0)
    pixels, radii = np.zeros((len(seen), SAMPLED, 2), np.float32), radii_px(camera)
    for k, of_pair in enumerate(seen):
        nearby = around(predicted[k] - measured.prior[k], radii)
        which = np.flatnonzero(of_pair)
        which = which[np.linspace(0, len(which) - 1, SAMPLED).astype(int)]
        pixels[k] = to_mm * np.stack([error[k].flat[which], nearby.flat[which]], -1)
    return Errors(error.sum((1, 2)) / count * to_mm, change.sum((1, 2)) / count * to_mm, pixels)


def score(action: str, agent: str, parts: list[tuple[np.ndarray, np.ndarray]], **more) -> Score:
    """A line from (errors, changes) of every partition, (n,) mm each."""
    errors = np.concatenate([error for error, _ in parts])
    changes = np.concatenate([change for _, change in parts])
    spread = errors if len(parts) == 1 else np.array([error.mean() for error, _ in parts])
    means = float(errors.mean()), float(spread.std()), float(changes.mean())
    return Score(action, agent, len(errors), *means, **more)


def summarise(
    trials: Iterable[Trial], floors: Mapping[tuple[str, str], Floor] | None = None
) -> list[Score]:
    """One line per action, agents, predictor and number of pairs, in order of first appearance.

    `floors` are by (action, agent), as `noise_floor` gives them.
    """
    cells: dict[tuple, list[Trial]] = {}
    for trial in trials:
        cells.setdefault(trial[:5], []).append(trial)
    found = []
    for (predictor, trained_on, agent, action, pairs), mine in cells.items():
        floor = (floors or {}).get((action, agent))
        parts = [(trial.error_mm, trial.change_mm) for trial in mine]
        line = score(action, agent, parts, predictor=predictor, trained_on=trained_on, pairs=pairs)
        found.append(with_floor(line, floor))
    return found


def with_floor(line: Score, floor: Floor | None) -> Score:
    """The line with a floor beside its error."""
    return line._replace(floor_mm=floor.mm, floor_from=floor.how) if floor else line


def compare(trials: Iterable[Trial], against: str) -> list[Comparison]:
    """Every other predictor against one, pair by pair: what differs between pairs drops out.

    All are of the same partitions, as `Study` makes them; a pair in several of them counts once,
    with its mean error.  Pairs share training sets, so the standard error is a little too small.
    """
    cells: dict[tuple, dict[str, dict[str, list[float]]]] = {}
    for trial in trials:
        cell = cells.setdefault((trial.action, trial.agent, trial.trained_on), {})
        errors = cell.setdefault(trial.predictor, {})
        for name, error in zip(trial.id.tolist(), trial.error_mm.tolist(), strict=True):
            errors.setdefault(name, []).append(error)
    found = []
    for (action, agent, trained_on), cell in cells.items():
        base = cell.get(against, {})
        for predictor, errors in cell.items():
            both = [name for name in errors if name in base]
            if predictor == against or not both:
                continue
            gap = np.array([np.mean(errors[name]) - np.mean(base[name]) for name in both])
            spread = float(gap.std(ddof=1) / len(gap) ** 0.5) if len(gap) > 1 else float("nan")
            numbers = len(gap), float(gap.mean()), spread, float((gap < 0).mean())
            found.append(Comparison(action, agent, trained_on, predictor, against, *numbers))
    return found


@jax.jit
def _compiled(predictor: Predictor, roi: Array, corner: Array, strength: Array) -> Array:
    return jnp.clip(predictor(roi, corner, strength), 0.0, 1.0)


def _predict(predictor: Predictor, examples: Examples) -> np.ndarray:
    """(n, h, w) of I after, in batches of one size."""
    strength = jnp.asarray(examples.strengths)
    prior = np.stack([fill_nan(roi) if np.isfinite(roi).any() else roi for roi in examples.prior])
    found = []
    for start in range(0, len(prior), BATCH):
        rows = np.minimum(np.arange(start, start + BATCH), len(prior) - 1)
        found.append(_compiled(predictor, prior[rows], examples.corner[rows], strength[rows]))
    return np.concatenate([np.asarray(part) for part in found])[: len(prior)]


def _pasted(predicted: np.ndarray, inside: Examples, measured: Examples) -> np.ndarray:
    """Predictions in the windows that are measured: cut to them, and no change around them."""
    whole = measured.prior.copy()
    first = (inside.corner - measured.corner)[0, ::-1]  # all ROIs have one size, so one shift
    low, high = np.maximum(first, 0), np.minimum(first + predicted.shape[1:], whole.shape[1:])
    theirs = [slice(*ends) for ends in zip(low - first, high - first, strict=True)]
    ours = [slice(*ends) for ends in zip(low, high, strict=True)]
    whole[:, *ours] = predicted[:, *theirs]
    return whole
