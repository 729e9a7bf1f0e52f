"""A whole sequence carried out on the map, at places between nodes too: differentiable."""

from collections import Counter
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jshape._typing import Array, Bool, Float, Int
from jshape.camera import namespace
from jshape.planning.evaluate import Candidates
from jshape.planning.kernels import Kernel
from jshape.planning.search.base import (
    SearchProblem,
    SearchResult,
    compiled,
    empty_result,
    ended,
)
from jshape.planning.state import SearchState

ROOM = 4
"""Nodes around a hand's window into which its change may reach once it is turned or stretched."""
UNSURE = 0.03
"""Share of what the actions of a plan gain, as the root of their squares' sum: less is not known.
Of 40 goals that two to four actions of another hand made, `refine` finds these and nothing else
in 48 % at 0, 70 % at 0.03; as much is left in truth.  Goals of no action lose nothing."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Pose:
    """Where and how an action is carried out: its entry in a sequence, and its move's own path."""

    node: Float[Array, "*K 2"]
    turn: Float[Array, "*K"]
    stretch: Float[Array, "*K"]
    yaw: Float[Array, "*K"]
    half: Float[Array, "*K"]
    """Half of the move's path, nodes."""

    def to_map(self, v: Array, u: Array) -> tuple[Array, Array]:
        """Nodes (v, u) of the map, of nodes beside the place as the move's own hand has them."""
        v, u = self._stretched(v, u, self.half, self.stretch)
        cos, sin = jnp.cos(self.turn), jnp.sin(self.turn)
        return cos * v + sin * u + self.node[0], cos * u - sin * v + self.node[1]

    def from_map(self, v: Array, u: Array) -> tuple[Array, Array]:
        """The inverse of `to_map`."""
        v, u = v - self.node[0], u - self.node[1]
        cos, sin = jnp.cos(self.turn), jnp.sin(self.turn)
        v, u = cos * v - sin * u, cos * u + sin * v
        return self._stretched(v, u, self.half * self.stretch, 1.0 / self.stretch)

    def _stretched(self, v: Array, u: Array, half: Array, by: Array) -> tuple[Array, Array]:
        """What lies before and behind the path moves with its ends, as in `models.stretch`."""
        cos, sin = jnp.cos(self.yaw), jnp.sin(self.yaw)
        more = jnp.clip(cos * u + sin * v, -half, half) * (by - 1.0)
        return v + sin * more, u + cos * more


def act_between(
    state: SearchState, kernel: Kernel, effect: Any, now: Array, pose: Pose, strength: Array
) -> Float[Array, "R C"]:
    """The map after a move whose place, direction and length lie between those tried.

    The bed as the hand sees it, interpolated bilinearly, and the change put back the same way; on a
    node, and neither turned nor stretched, that is `SearchState.act`.
    """
    shape = kernel.shape
    v, u = (jnp.arange(n, dtype=jnp.float32) - n // 2 for n in shape)
    seen = _between(now, *pose.to_map(v[:, None], u[None]))
    middle = np.array([n // 2 for n in shape], np.int32)
    corner = jnp.rint(lax.stop_gradient(pose.node)).astype(jnp.int32) - middle
    change = state.seen(effect(seen, corner[::-1], strength)) - seen
    # Put back into a window that has room around the hand's own.
    window = tuple(min(n + 2 * ROOM, most) for n, most in zip(shape, now.shape, strict=True))
    most = jnp.array(now.shape, jnp.int32) - jnp.array(window, jnp.int32)
    first = jnp.clip(corner - ROOM, 0, most)
    from_first = first.astype(jnp.float32)
    v, u = (jnp.arange(n, dtype=jnp.float32) + at for n, at in zip(window, from_first, strict=True))
    v, u = pose.from_map(v[:, None], u[None])
    framed = jnp.pad(change, 1)  # beyond the hand's window nothing changes
    put = _between(framed, v + (shape[0] // 2 + 1), u + (shape[1] // 2 + 1), ahead=False)
    return lax.dynamic_update_slice(now, lax.dynamic_slice(now, first, window) + put, first)


def _between(field: Float[Array, "n m"], v: Array, u: Array, *, ahead: bool = True) -> Array:
    """A map between its nodes; beyond its edge as at the edge.

    On a node it has the slope of the cell ahead, or behind: a change put back moves against its
    window, and both must tell the slope towards the same side.
    """
    n, m = field.shape
    v, u = jnp.clip(v, 0.0, n - 1.0), jnp.clip(u, 0.0, m - 1.0)
    top, left = (
        jnp.clip(jnp.floor(x) if ahead else jnp.ceil(x) - 1, 0, most - 2).astype(jnp.int32)
        for x, most in ((lax.stop_gradient(v), n), (lax.stop_gradient(u), m))
    )
    down, right = v - top.astype(v.dtype), u - left.astype(u.dtype)
    above = (1 - right) * field[top, left] + right * field[top, left + 1]
    below = (1 - right) * field[top + 1, left] + right * field[top + 1, left + 1]
    return (1 - down) * above + down * below


def carry_out(state: SearchState, result: SearchResult) -> tuple[Array, Array, Array]:
    """A sequence carried out: the second half of a carry brings what the first took out.

    Returns:
      The map after it (R, C); d before and after each of its K entries (K+1,); the strengths (K,).
    """
    node_m = jnp.asarray(1.0 if state.node_m is None else state.node_m, jnp.float32)
    half, move = _numbers(state, "path_m") / (2 * node_m), result.move
    yaw = _numbers(state, "yaw")
    poses = Pose(result.node, result.turn, result.stretch, yaw[move], half[move])

    def between(kernel, effect, _, now, pose, strength):
        return act_between(state, kernel, effect, now, pose, strength)

    def one(carry, entry):
        before, taken = carry
        move, second, strength, pose = entry

        def act(now: Array, strength: Array) -> Array:
            return state.with_kernel(move, between, now, pose, strength, apply=True)

        def as_much(strength: Array) -> Array:
            # What it brings is in proportion to its strength.
            brought = (act(before, strength) - before).sum()
            return strength * jnp.clip(-taken / jnp.where(brought == 0, 1.0, brought), 0.0, 100.0)

        if state.carries:
            strength = lax.cond(second, as_much, lambda strength: strength, strength)
        now = lax.cond(move >= 0, act, lambda now, _: now, before, strength)
        return (now, (now - before).sum()), (state.distance_of(now), strength)

    start = state.now, jnp.zeros((), state.now.dtype)
    entries = move, brings(state, move), result.strength, poses
    (now, _), (distances, strengths) = lax.scan(one, start, entries)
    return now, jnp.concatenate([state.distance[None], distances]), strengths


def brings(state: SearchState, move: Int[Any, "K"]) -> Bool[Any, "K"]:
    """Which of a sequence's moves bring what the one before them took out."""
    xp = namespace(move)
    partner = np.full(1 + state.actions.max(initial=0), -1, np.int32)
    for take, bring in state.carries:
        partner[take] = bring
    action = xp.where(move < 0, -2, xp.asarray(state.actions)[move])
    pairs = xp.asarray(partner)[xp.maximum(action[:-1], 0)] == action[1:]
    return xp.concatenate([np.zeros(1, bool), pairs & (move[:-1] >= 0)])


def _numbers(state: SearchState, name: str) -> Float[Array, "A"]:
    """One number of each move."""
    return jnp.stack([jnp.asarray(getattr(move, name), jnp.float32) for move in state.moves])


@compiled
def measured(state: SearchState, result: SearchResult) -> tuple[SearchResult, Array, Array]:
    """A sequence with its distance, the map after it, and d before and after each entry.

    The second half of a carry gets the strength that brings what the first took out.
    """
    now, distances, strengths = carry_out(state, result)
    return replace(result, distance=distances[-1], strength=strengths), now, distances


def warm_start(problem: SearchProblem) -> SearchResult | None:
    """The sequence to begin with, measured; None if there is none, or no budget for it (host).

    Its numbers are moved into their bounds.  Left out is what is farther from them than a place may
    be from its node, out of reach, used too often, one too many, or half of a carry.
    """
    if problem.start is None or problem.budget.over:
        return None
    state, candidates, start = problem.state, problem.candidates, jax.device_get(problem.start)
    low, high = jax.device_get(bounds(state, candidates))
    open_moves = set(np.asarray(candidates.move)[np.asarray(candidates.valid)].tolist())
    limits, found, used = problem.limits, [], Counter()
    for unit in units(state, start):
        moves, values = start.move[unit], numbers_of(start)[unit]
        if not set(moves.tolist()) <= open_moves or len(found) + len(moves) > problem.max_steps:
            continue
        inside = np.clip(values, low[moves], high[moves])
        rows, columns = np.rint(inside[:, :2]).astype(int).T
        free = np.asarray(candidates.reachable)[rows, columns].all()
        most = np.asarray(limits.max_uses if len(moves) == 1 else limits.carry_uses)
        actions = [state.moves[move].action for move in moves]
        allowed = all(used[a] < (most[a] if most.ndim else most) for a in actions)
        if np.abs(inside - values)[:, :2].max() < 0.51 and free and allowed:
            used.update(actions)
            found += zip(moves, inside, strict=True)
    result, steps = empty_result(state, problem.max_steps), len(found)
    if steps:
        moves, values = (np.array(one) for one in zip(*found, strict=True))
        whole = np.asarray(numbers_of(result)).copy()
        whole[:steps] = values
        result = with_numbers(result, jnp.asarray(whole, jnp.float32))
        move = result.move.at[:steps].set(moves.astype(np.int32))
        result = replace(result, steps=jnp.int32(steps), move=move)
    problem.budget.spend(steps)
    return problem.budget.call(measured, state, result)[0]


def pruned(problem: SearchProblem, result: SearchResult, unsure: float = UNSURE) -> SearchResult:
    """A sequence without actions and carries that add less to it than is known for sure (host).

    Those after it may have made an action superfluous, or it mends what the others are predicted
    to leave.  Weakest first; all together no more than three times that, nor beyond the tolerance.
    Where errors do not count, only what gains less than the least gain is taken out.
    """
    state, before, limits = problem.state, int(result.steps), problem.limits
    _, _, distances = problem.budget.call(measured, state, result)
    gains = -np.diff(np.asarray(distances, np.float64))
    unsure *= float(np.sqrt((gains**2).sum())) if np.any(limits.errors) else 0.0
    least, near = max(float(limits.min_gain), unsure), float(limits.tolerance)
    most = float(result.distance) + max(3 * unsure, before * float(limits.min_gain))
    gone: list[slice] = []
    for unit in sorted(units(state, result), key=lambda unit: float(gains[unit].sum())):
        if problem.budget.over:
            break
        count = unit.stop - unit.start
        k = unit.start - sum(one.stop - one.start for one in gone if one.start < unit.start)
        fewer, _, _ = problem.budget.call(measured_without, state, result, k, count=count)
        problem.budget.spend(int(result.steps))
        enough = min(most, float(result.distance) + least * count)
        if float(fewer.distance) <= (near if float(result.distance) <= near else enough):
            result = replace(fewer, status=result.status)
            gone.append(unit)
    return ended(problem, result, None)


@partial(compiled, static=("count",))
def measured_without(
    state: SearchState, result: SearchResult, k: int | Array, *, count: int
) -> tuple[SearchResult, Array, Array]:
    """`measured` of a sequence without `count` actions from the k-th on."""
    return measured(state, without(result, k, count))


def units(state: SearchState, result: SearchResult) -> list[slice]:
    """The sequence cut into what belongs together, actions and carries (host)."""
    second = brings(state, np.asarray(result.move))
    steps = int(result.steps)
    return [
        slice(k, k + 1 + int(k + 1 < steps and second[k + 1]))
        for k in range(steps)
        if not second[k]
    ]


def numbers_of(result: SearchResult) -> Any:
    """(K, 5) place (v, u), strength, turn and stretch of every entry."""
    xp = np if isinstance(result.node, np.ndarray) else jnp
    return xp.column_stack([result.node, result.strength, result.turn, result.stretch])


def with_numbers(result: SearchResult, numbers: Float[Array, "K 5"]) -> SearchResult:
    """A sequence with other numbers; see `numbers_of`."""
    strength, turn, stretch = numbers[:, 2:].T
    return replace(result, node=numbers[:, :2], strength=strength, turn=turn, stretch=stretch)


def without(result: SearchResult, k: int | Array, count: int = 1) -> SearchResult:
    """A sequence without `count` actions from the k-th on."""
    order = jnp.arange(result.move.shape[0])
    source = jnp.where(order < k, order, order + count)

    def closed(entries: Array, filler: Array | int) -> Array:
        past = jnp.broadcast_to(jnp.asarray(filler, entries.dtype), (count, *entries.shape[1:]))
        return jnp.concatenate([entries, past])[source]

    none = jnp.array([0.0, 0.0, 0.0, 0.0, 1.0], jnp.float32)
    left = with_numbers(result, closed(numbers_of(result), none))
    return replace(left, steps=result.steps - count, move=closed(result.move, -1))


def bounds(state: SearchState, candidates: Candidates) -> tuple[Array, Array]:
    """Least and greatest numbers (see `numbers_of`) of each move, (moves, 5) each.

    The hand is turned and its path stretched where several directions and lengths are tried: up to
    half-way to the next direction, and to the shortest and the longest path.
    """
    middle, tried = jnp.asarray(state.shapes // 2), candidates.strengths
    yaw, path = _numbers(state, "yaw"), _numbers(state, "length")
    same = jnp.asarray(state.actions[:, None] == state.actions[None])
    apart = jnp.abs((yaw[:, None] - yaw[None] + np.pi) % (2 * np.pi) - np.pi)
    next_to = jnp.where(same & (apart > 1e-3), apart, jnp.inf).min(1)
    turn = jnp.where(jnp.isfinite(next_to), next_to / 2, 0.0)
    found = []
    for bound, end, sign, far in (
        (candidates.low, jnp.min, -1.0, jnp.inf), (candidates.high, jnp.max, 1.0, -jnp.inf)
    ):  # fmt: skip
        length = end(jnp.where(same, path[None], far), 1) / path
        strength, place = jnp.full(len(state.moves), end(tried)), bound + middle
        place = place.astype(jnp.float32)
        found.append(jnp.column_stack([place, strength, sign * turn, length]))
    return found[0], found[1]
