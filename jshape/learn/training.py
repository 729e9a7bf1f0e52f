"""The training loop that learned predictors share: batches, validation, early stop, resuming.

It knows nothing of networks: what it trains is any pytree of float32 arrays (a predictor is one),
and what it lowers is any `loss(params, examples)` of one number per example.  It touches no disk:
what must outlive a kill goes through `Hooks.keep`.
"""

import hashlib
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh

from jshape._typing import Array, Float
from jshape.data.pairs import Examples
from jshape.errors import BadDataset, BadFile, JShapeError
from jshape.learn.data_parallel import ALONE, DataParallel
from jshape.learn.settings import FREE, Training

Loss = Callable[[Any, Examples], Array]
"""(params, B examples) -> (B,) losses.  A function of a module, not a lambda made for the
occasion: what was compiled for it is found again by its identity."""


class Row(NamedTuple):
    """One epoch of a training curve."""

    epoch: int
    """From 1."""
    train: float
    """Mean loss over the training pairs, each before the step that it took part in."""
    validation: float
    """Mean loss over the validation pairs after the epoch; NaN if there are none."""
    seconds: float
    """What the epoch took."""

    @property
    def score(self) -> float:
        """What the best parameters are chosen by."""
        return self.train if np.isnan(self.validation) else self.validation


class Progress(NamedTuple):
    """What `report` is told after every epoch, and once when nothing is left to do."""

    action: str
    """The action whose predictor is trained."""
    epochs: int
    """The most there will be."""
    curve: tuple[Row, ...]
    """All epochs so far, those of an earlier, interrupted run included."""
    best: Row
    """The epoch whose parameters are the best so far."""
    done: bool
    """No epoch follows: all were made, or patience ran out."""


@dataclass(frozen=True)
class Hooks:
    """What the caller of a fitter watches, keeps and runs it on.  None of it changes the result."""

    action: str = ""
    """Name of the action, for `report`."""
    report: Callable[[Progress], None] | None = None
    """Told of every epoch."""
    keep: Any = None
    """Where checkpoints go, and where an interrupted training is resumed from: an
    `io.checkpoints.Checkpoints`, or something else with its `where`, `load` and `save`."""
    mesh: Mesh | None = None
    """Devices that share every batch, of one axis (see `data_parallel`); None is one device."""


class Trained(NamedTuple):
    """What `train` found."""

    params: Any
    """The best parameters."""
    curve: tuple[Row, ...]
    """Every epoch."""


@dataclass
class _State:
    """Everything a training needs to go on: what a checkpoint holds."""

    params: Any
    optimizer: Any
    best: Any
    curve: list[Row] = field(default_factory=list)

    @property
    def best_row(self) -> Row:
        return min(self.curve, key=lambda row: row.score)  # the first of equals


def roi_loss(predictor: Any, batch: Examples) -> Float[Array, "B"]:
    """Distance d of the predicted from the true ROI, over pixels seen before and after.  Eq. lossC.

    The prediction is not clipped, as a clipped pixel would learn nothing.
    """
    after = predictor(batch.prior, batch.corner)
    seen = jnp.isfinite(batch.prior) & jnp.isfinite(batch.posterior)
    # Chosen before the difference: NaN would come back through the gradient of |.|.
    gap = jnp.abs(jnp.where(seen, after, 0.0) - jnp.where(seen, batch.posterior, 0.0))
    return gap.sum((-2, -1)) / jnp.maximum(seen.sum((-2, -1), jnp.float32), 1.0)


def train(
    loss: Loss, params: Any, examples: Examples, settings: Training, hooks: Hooks = Hooks()
) -> Trained:
    """Lower the mean loss over examples, from `params`; the same every time for the same seed.

    A resumed training makes the same batches, so it ends where an uninterrupted one does.

    `params` is a pytree of float32 arrays, which is copied, not consumed; the loss may see NaN
    pixels (no reading), as `roi_loss` does.

    Raises:
      BadDataset: no examples, too few to keep some out for validation, or one that has no pixel
        with a reading both before and after.
      BadFile: the checkpoint is of other settings or pairs, or cannot be used.
      JShapeError: the loss is no longer a number.
    """
    devices = DataParallel(hooks.mesh)
    training, validation = split(examples, settings)
    step, measure = _compiled(loss, settings.learning_rate, devices)
    params = _copy(params)
    mark = _fingerprint(loss, params, examples, settings)
    state = _State(params, _adam(settings.learning_rate).init(params), _copy(params))
    if hooks.keep is not None and (found := hooks.keep.load()) is not None:
        arrays, facts = found
        state = _restore(state, arrays, facts, mark, hooks.keep.where)
    saved = len(state.curve)
    state.params, state.optimizer = devices.replicate((state.params, state.optimizer))
    order = jax.random.key(settings.seed)
    if done := _finished(state, settings):
        _tell(hooks, state, settings, done)
    while not done:
        epoch, start = len(state.curve) + 1, time.perf_counter()
        shuffle = jax.random.permutation(jax.random.fold_in(order, epoch), len(training.prior))
        total = 0.0
        for batch, counted in _batches(training, np.asarray(shuffle), settings.batch, devices):
            state.params, state.optimizer, part = step(
                state.params, state.optimizer, batch, counted
            )
            total += part
        row = Row(
            epoch,
            float(total) / len(training.prior),
            _mean_loss(measure, state.params, validation, settings.batch, devices),
            time.perf_counter() - start,
        )
        if not np.isfinite(row.score):
            raise JShapeError(
                f"{hooks.action or 'training'}: the loss of epoch {epoch} is {row.score}; lower "
                f"learning_rate ({settings.learning_rate:g})"
            )
        state.curve.append(row)
        if state.best_row is row:
            state.best = _copy(state.params)
        done = _finished(state, settings)
        if hooks.keep is not None and (done or epoch - saved >= settings.save_every):
            hooks.keep.save(*_snapshot(state, mark))
            saved = epoch
        _tell(hooks, state, settings, done)
    return Trained(devices.gather(state.best), tuple(state.curve))


def split(examples: Examples, settings: Training) -> tuple[Examples, Examples]:
    """(training, validation) examples, by the seed; at least one of each.

    Raises:
      BadDataset: as for `train`.
    """
    count = len(examples.prior)
    if count == 0:
        raise BadDataset("no pairs to train with")
    blind = ~examples.seen.any((1, 2))
    if blind.any():
        raise BadDataset(
            f"{int(blind.sum())} of {count} pairs have no pixel with a reading before and after, "
            f"the first is number {int(np.argmax(blind)) + 1}"
        )
    if settings.validation == 0:
        return examples, examples.select(np.arange(0))
    if count < 2:
        raise BadDataset(
            "1 pair cannot be split into training and validation; bring more, or train with "
            "validation=0"
        )
    out = min(max(1, round(settings.validation * count)), count - 1)
    order = np.random.default_rng(settings.seed).permutation(count)
    return examples.select(np.sort(order[out:])), examples.select(np.sort(order[:out]))


def _batches(
    examples: Examples, order: np.ndarray, most: int, devices: DataParallel = ALONE
) -> Iterator[tuple[Examples, Array]]:
    """Batches of one size with a mask of what counts: as even as can be, then filled up.

    10 pairs at a batch of 8 are two batches of 5, which wastes less than 8 and 2; on 4 devices they
    are filled up to 8, 2 for each.
    """
    size = -(-len(order) // -(-len(order) // most)) if len(order) else 1
    full = -(-size // devices.count) * devices.count
    for start in range(0, len(order), size):
        chosen = order[start : start + size]
        counted = np.arange(full) < len(chosen)
        chosen = np.concatenate([chosen, np.full(full - len(chosen), chosen[0])])
        batch = examples.select(chosen)._replace(path_mm=None)  # a number has no axis to split
        yield devices.split((batch, counted))


@cache
def _adam(learning_rate: float) -> Any:
    """The paper's optimizer (section V)."""
    import optax

    return optax.adam(learning_rate, b1=0.5, b2=0.999, eps=1e-8)


@cache
def _compiled(
    loss: Loss, learning_rate: float, devices: DataParallel = ALONE
) -> tuple[Callable, Callable]:
    """(step, sum of losses), compiled once per loss and batch shape, not once per training."""
    import optax

    def total(params: Any, batch: Examples, counted: Array) -> Array:
        return jnp.where(counted, loss(params, batch), 0.0).sum()

    slopes = devices.summed(jax.value_and_grad(total))

    @jax.jit(donate_argnums=(0, 1))
    def step(params: Any, state: Any, batch: Examples, counted: Array) -> tuple[Any, Any, Array]:
        summed, slope = slopes(params, batch, counted)
        slope = jax.tree.map(lambda x: x / counted.sum(dtype=jnp.float32), slope)
        with jax.numpy_dtype_promotion("standard"):  # optax's Adam counts in int32
            updates, state = _adam(learning_rate).update(slope, state, params)
        return optax.apply_updates(params, updates), state, summed

    return step, jax.jit(devices.summed(total))


def _mean_loss(
    measure: Callable, params: Any, examples: Examples, most: int, devices: DataParallel
) -> float:
    count = len(examples.prior)
    order = np.arange(count)
    parts = [measure(params, *batch) for batch in _batches(examples, order, most, devices)]
    return float(sum(parts)) / count if count else float("nan")


def _finished(state: _State, settings: Training) -> bool:
    made = len(state.curve)
    if made == 0 or made >= settings.epochs:
        return made >= settings.epochs
    return 0 < settings.patience <= made - state.best_row.epoch


def _tell(hooks: Hooks, state: _State, settings: Training, done: bool) -> None:
    if hooks.report is not None:
        curve = tuple(state.curve)
        hooks.report(Progress(hooks.action, settings.epochs, curve, state.best_row, done))


def _copy(tree: Any) -> Any:
    """A copy that stays when the original is donated to a step."""
    return jax.tree.map(lambda x: jnp.array(x, copy=True), tree)


def _fingerprint(loss: Loss, params: Any, examples: Examples, settings: Training) -> str:
    """What a checkpoint must have been made with to be gone on from."""
    fixed = {name: value for name, value in asdict(settings).items() if name not in FREE}
    leaves, structure = jax.tree.flatten(params)
    digest = hashlib.sha256(
        json.dumps([loss.__module__, loss.__qualname__, str(structure), fixed]).encode()
    )
    for array in (*examples, *leaves):
        array = np.ascontiguousarray(array)
        digest.update(f"{array.dtype}{array.shape}".encode())
        digest.update(array.data)
    return digest.hexdigest()


def _snapshot(state: _State, mark: str) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    leaves = jax.tree.leaves((state.params, state.optimizer, state.best))
    arrays = {f"leaf.{number}": np.asarray(leaf) for number, leaf in enumerate(leaves)}
    return arrays | {"curve": np.array(state.curve, np.float64)}, {"fingerprint": mark}


def _restore(
    fresh: _State, arrays: dict[str, np.ndarray], facts: dict[str, Any], mark: str, where: str
) -> _State:
    """The state that was saved, in the structure of a fresh one."""
    if facts.get("fingerprint") != mark:
        raise BadFile(
            f"{where}: holds a training with other pairs or settings (only epochs, patience and "
            "save_every may change); remove it to start again"
        )
    leaves, structure = jax.tree.flatten((fresh.params, fresh.optimizer, fresh.best))
    try:
        found = [jnp.asarray(arrays[f"leaf.{number}"]) for number in range(len(leaves))]
        if [(a.shape, a.dtype) for a in found] != [(a.shape, a.dtype) for a in leaves]:
            raise ValueError("arrays of another training")
        curve = np.asarray(arrays["curve"], np.float64).reshape(-1, len(Row._fields))
    except (KeyError, ValueError):
        raise BadFile(f"{where}: its checkpoint is incomplete; remove it to start again") from None
    rows = [Row(int(epoch), *rest) for epoch, *rest in curve.tolist()]
    params, optimizer, best = jax.tree.unflatten(structure, found)
    return _State(params, optimizer, best, rows)
