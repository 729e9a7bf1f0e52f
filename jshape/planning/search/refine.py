"""All places, strengths, directions and lengths of a sequence moved down the gradient of d.

JAX differentiates the distance through every predicted action of the sequence.  d is a sum of
absolute values, so the step is Adam's and the best sequence on the way is kept.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import optax

from jshape._typing import Array
from jshape.planning.evaluate import Candidates
from jshape.planning.search import careful
from jshape.planning.search.base import (
    SearchProblem,
    SearchResult,
    Status,
    compiled,
    ended,
)
from jshape.planning.search.sequence import (
    bounds,
    carry_out,
    numbers_of,
    pruned,
    with_numbers,
)
from jshape.planning.state import SearchState

ROUNDS = 24
"""Calls of `descend`, at most; it stops at the first that gains less than `LEAST`."""
STEPS = 5
"""Gradient steps between two looks at the clock."""
PLACE = 0.4
"""First step of a place, nodes."""
STRENGTH = 0.03
"""First step of a strength."""
TURN = 0.04
"""First step of a direction, radians: the end of a hand ten nodes long moves as far as a place."""
STRETCH = 0.03
"""First step of a path's length."""
LEAST = 0.001
"""Share of d that a round must gain."""


def search(problem: SearchProblem) -> SearchResult:
    """What `careful` finds, or what was to begin with and greedy after it, refined and pruned."""
    return pruned(problem, refined(problem, careful.search(problem)))


def refined(problem: SearchProblem, result: SearchResult) -> SearchResult:
    """A sequence after as many rounds of descent as gain something and the budget allows."""
    if not int(result.steps) or float(result.distance) <= float(problem.limits.tolerance):
        return result
    rate, took = 1.0, 0.0
    for _ in range(ROUNDS):
        work = 3 * STEPS * int(result.steps)  # a gradient costs about two evaluations more
        # A step goes through the whole map: its time is that of the step before, not a sweep's.
        if problem.budget.over or not problem.budget.holds(work) or not problem.budget.lasts(took):
            return ended(problem, result, Status.BUDGET)
        before, began = float(result.distance), problem.budget.elapsed
        result = problem.budget.call(
            descend, problem.state, problem.candidates, result, jnp.float32(rate)
        )
        problem.budget.spend(work)
        took = problem.budget.elapsed - began
        if float(result.distance) > (1 - LEAST) * before:
            if rate < 0.3:
                break
            rate /= 4
    return ended(problem, result, None)


@compiled
def descend(
    state: SearchState,
    candidates: Candidates,
    result: SearchResult,
    rate: Array,
) -> SearchResult:
    """`STEPS` steps of Adam on all numbers of a sequence; the best sequence on the way."""
    low, high = bounds(state, candidates)
    used = result.move >= 0
    scale = jnp.array([PLACE, PLACE, STRENGTH, TURN, STRETCH], jnp.float32) * rate
    start, least, most = numbers_of(result), low[result.move], high[result.move]

    def distance(values: Array) -> tuple[Array, Array]:
        _, distances, strengths = carry_out(state, with_numbers(result, values))
        return distances[-1], strengths

    def allowed(values: Array, strengths: Array) -> Array:
        row, column = jnp.rint(values[:, :2]).astype(jnp.int32).T
        inside = (strengths >= least[:, 2]) & (strengths <= most[:, 2])
        return ((candidates.reachable[row, column] & inside) | ~used).all()

    optimiser = optax.adam(1.0)

    def step(carry, _):
        values, memory, best, least_d = carry
        (d, strengths), slope = jax.value_and_grad(distance, has_aux=True)(values)
        nearer = (d < least_d) & allowed(values, strengths)
        best, least_d = jnp.where(nearer, values, best), jnp.where(nearer, d, least_d)
        with jax.numpy_dtype_promotion("standard"):  # optax's Adam counts in int32
            update, memory = optimiser.update(slope, memory)
        moved = jnp.clip(values + scale[None] * jnp.asarray(update), least, most)
        return (jnp.where(used[:, None], moved, values), memory, best, least_d), None

    carry = (start, optimiser.init(start), start, result.distance)
    (values, _, best, least_d), _ = jax.lax.scan(step, carry, None, length=STEPS)
    d, strengths = distance(values)
    nearer = (d < least_d) & allowed(values, strengths)
    best = with_numbers(result, jnp.where(nearer, values, best))
    return replace(best, distance=jnp.where(nearer, d, least_d), strength=carry_out(state, best)[2])
