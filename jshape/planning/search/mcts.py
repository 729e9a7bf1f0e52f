"""Monte Carlo tree search (mctx, the extra `search`) over a short list of candidates.

For every action the list is made anew: the best candidate of each move after a local search.  A
node of the tree is the history of what was taken; its map is made again from that, which is cheaper
than keeping a map per node.  Priors are the greedy gains in the node: without them tree search does
poorly at this branching.
"""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax

from jshape._typing import Array, Float, Int
from jshape.errors import needs
from jshape.planning.search import greedy
from jshape.planning.search.base import SearchProblem, SearchResult, Status, better, compiled, ended
from jshape.planning.search.beam import listed
from jshape.planning.search.step import Carry, begin, take
from jshape.planning.state import SearchState

LISTED = 12
"""Candidates on the list, at most: one of each move."""
SIMULATIONS = 32
"""Simulations per action."""
DEPTH = 6
"""Actions that the tree looks ahead, at most."""
SHARP = 8.0
"""Prior logits over the greedy gains: the best gain is worth this, no gain 0."""


def search(problem: SearchProblem) -> SearchResult:
    """The best of greedy's sequence and the one that tree search takes action by action.

    Raises:
      JShapeError: mctx is not installed.
    """
    _mctx()
    best = greedy.search(problem)
    carry = begin(problem.state, problem.candidates, problem.max_steps)
    key = jax.random.key(problem.seed)
    while int(carry.result.steps) < problem.max_steps:
        listed, carry = _list(problem, carry)
        if listed is None:
            break
        key, mine = jax.random.split(key)
        work = SIMULATIONS * (LISTED + DEPTH + 1)
        if problem.budget.over or not problem.budget.holds(work):
            return ended(problem, best, Status.BUDGET)
        choice = problem.budget.call(
            _policy, mine, problem.state, carry.now, carry.result.distance, *listed
        )
        problem.budget.spend(work)
        move = (of_all[choice] for of_all in listed)
        carry = problem.budget.call(take, carry, problem.state, problem.candidates, *move)
        best = better(best, replace(carry.result, status=best.status))
        if float(best.distance) <= float(problem.limits.tolerance):
            return ended(problem, best, Status.CONVERGED)
    return ended(problem, best, Status.BUDGET if problem.budget.over else None)


def _mctx() -> Any:
    with needs("search", "planner mcts"):
        import mctx
    return mctx


def _list(problem: SearchProblem, carry: Carry) -> tuple[tuple[Array, Array, Array] | None, Carry]:
    """Moves, first nodes and strengths to choose from; None if none is worth it."""
    best, carry = listed(problem, carry, LISTED)
    if best is None or not float(best.gain.max()) > 0:
        return None, carry
    # What is not worth its action stands in for the best, so that the list keeps its length.
    order = jnp.where(best.gain > 0, jnp.arange(len(best.gain)), jnp.argmax(best.gain))
    return (best.move[order], best.first[order], best.strength[order]), carry


@compiled
def _policy(
    key: Array,
    state: SearchState,
    now: Float[Array, "R C"],
    distance: Array,
    moves: Int[Array, "L"],
    firsts: Int[Array, "L 2"],
    strengths: Float[Array, "L"],
) -> Int[Array, ""]:
    """The number on the list that tree search would take first."""
    mctx = _mctx()
    unit = distance + 1e-9

    def acted(m: Array, k: Array) -> Array:
        return state.act(moves[k], m, firsts[k], strengths[k])

    def gain(m: Array, k: Array) -> Array:
        def one(kernel, effect, before, m, first, strength):
            first = (first - before)[None]
            return state.change(effect, state.windows(kernel, m, first), first, strength)[0]

        return -state.with_kernel(moves[k], one, m, firsts[k], strengths[k]) / unit

    def map_after(history: Int[Array, "D"]) -> Array:
        def one(m, entry):
            return lax.cond(entry >= 0, lambda m: acted(m, entry), lambda m: m, m), None

        return lax.scan(one, now, history)[0]

    def gains_on(m: Array) -> Array:
        return lax.map(lambda k: gain(m, k), jnp.arange(len(moves)))

    def judged(gains: Array) -> tuple[Array, Array]:
        """Prior logits, and the value: what the best single action would still gain."""
        most = jnp.maximum(gains.max(), 1e-9)
        return SHARP * gains / most, jnp.maximum(gains.max(), 0.0)

    def recurrent(_, key, action, embedding):
        history, depth = embedding

        def one(history, depth, action):
            before = map_after(history)
            reward = gain(before, action)
            logits, value = judged(gains_on(acted(before, action)))
            history = history.at[jnp.minimum(depth, DEPTH - 1)].set(action)
            ended = depth + 1 >= DEPTH
            return reward, jnp.where(ended, 0.0, 1.0), logits, value, history, depth + 1

        # One by one: under vmap every branch of a switch would be computed.
        reward, discount, logits, value, history, depth = lax.map(
            lambda entry: one(*entry), (history, depth, action)
        )
        output = mctx.RecurrentFnOutput(
            reward=reward, discount=discount, prior_logits=logits, value=value
        )
        return output, (history, depth)

    logits, value = judged(gains_on(now))
    root = mctx.RootFnOutput(
        prior_logits=logits[None],
        value=value[None],
        embedding=(jnp.full((1, DEPTH), -1, jnp.int32), jnp.zeros(1, jnp.int32)),
    )
    with jax.numpy_dtype_promotion("standard"):  # mctx divides by counts
        policy = mctx.gumbel_muzero_policy(
            params=None,
            rng_key=key,
            root=root,
            recurrent_fn=recurrent,
            num_simulations=SIMULATIONS,
            max_num_considered_actions=min(LISTED, len(moves)),
            max_depth=DEPTH,
            gumbel_scale=1.0,
        )
    return policy.action[0]
