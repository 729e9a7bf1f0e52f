"""All places and strengths of a sequence moved together down the gradient of d.

JAX differentiates the distance through every predicted action of the sequence.  d is a sum of
absolute values, so the step is Adam's and the best sequence on the way is kept.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import optax

from jshape._typing import Array
from jshape.planning.evaluate import Candidates
from jshape.planning.search import greedy
from jshape.planning.search.base import Found, Limits, Status, Task, better, compiled, ended
from jshape.planning.search.sequence import begun, carry_out, least_and_most
from jshape.planning.state import Terrain

ROUNDS = 24
"""Calls of `descend`, at most; it stops at the first that gains less than `LEAST`."""
STEPS = 5
"""Gradient steps between two looks at the clock."""
PLACE = 0.4
"""First step of a place, nodes."""
STRENGTH = 0.03
"""First step of a strength."""
LEAST = 0.001
"""Share of d that a round must gain."""


def search(task: Task) -> Found:
    """What greedy finds, or what was to begin with, refined; never worse than either."""
    best = greedy.search(task)
    start = begun(task)
    if start is not None:
        best = better(best, replace(start, status=best.status))
    return refined(task, best)


def refined(task: Task, found: Found) -> Found:
    """A sequence after as many rounds of descent as gain something and the budget allows."""
    if not int(found.steps) or float(found.distance) <= float(task.limits.tolerance):
        return found
    rate, took = 1.0, 0.0
    for _ in range(ROUNDS):
        work = 3 * STEPS * int(found.steps)  # a gradient costs about two evaluations more
        # A step goes through the whole map: its time is that of the step before, not a sweep's.
        if task.budget.over or not task.budget.holds(work) or not task.budget.lasts(took):
            return ended(task, found, Status.BUDGET)
        before, began = float(found.distance), task.budget.elapsed
        found = task.budget.call(
            descend, task.terrain, task.candidates, task.limits, found, jnp.float32(rate)
        )
        task.budget.spend(work)
        took = task.budget.elapsed - began
        if float(found.distance) > (1 - LEAST) * before:
            if rate < 0.3:
                break
            rate /= 4
    return ended(task, found, None)


@compiled
def descend(
    terrain: Terrain, candidates: Candidates, limits: Limits, found: Found, rate: Array
) -> Found:
    """`STEPS` steps of Adam on all places and strengths; the best sequence on the way."""
    low, high = least_and_most(terrain, candidates)
    known = candidates.strengths
    used = found.move >= 0
    scale = jnp.array([PLACE, PLACE, STRENGTH], jnp.float32) * rate
    start = jnp.column_stack([found.node, found.strength])
    least = jnp.column_stack([low[found.move], jnp.full(used.shape, known.min())])
    most = jnp.column_stack([high[found.move], jnp.full(used.shape, known.max())])

    def with_values(values: Array) -> Found:
        return replace(found, node=values[:, :2], strength=values[:, 2])

    def distance(values: Array) -> Array:
        return carry_out(terrain, with_values(values))[1][-1]

    def reachable(values: Array) -> Array:
        row, column = jnp.rint(values[:, :2]).astype(jnp.int32).T
        return (candidates.reach[row, column] | ~used).all()

    optimiser = optax.adam(1.0)

    def step(state, _):
        values, memory, best, least_d = state
        d, slope = jax.value_and_grad(distance)(values)
        nearer = (d < least_d) & reachable(values)
        best, least_d = jnp.where(nearer, values, best), jnp.where(nearer, d, least_d)
        update, memory = optimiser.update(slope, memory)
        moved = jnp.clip(values + scale * jnp.asarray(update), least, most)
        return (jnp.where(used[:, None], moved, values), memory, best, least_d), None

    state = (start, optimiser.init(start), start, found.distance)
    (values, _, best, least_d), _ = jax.lax.scan(step, state, None, length=STEPS)
    d = distance(values)
    nearer = (d < least_d) & reachable(values)
    return replace(
        with_values(jnp.where(nearer, values, best)), distance=jnp.where(nearer, d, least_d)
    )
