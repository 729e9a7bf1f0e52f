"""Algorithm 1: take the action that brings the image nearest to the goal, as long as one does."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jshape._typing import Array, Bool, Float
from jshape.planners.base import Found, Limits, Status
from jshape.predict.bank import Bank
from jshape.predict.sweep import Candidates, predict_at, refresh


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class _State:
    """What changes from step to step; all storage is allocated before the loop."""

    image: Float[Array, "H W"]
    total: Float[Array, ""]  # running sum of |I - I*|, for the tolerance only: it drifts
    changes: Float[Array, "M"]
    stale: Bool[Array, "M"]
    found: Found


def _rectangles(bank: Bank, candidates: Candidates) -> tuple[Array, Array, np.ndarray]:
    """First pixels (M, 2), ROI sizes (M, 2) as (v, u), and the action number (M,)."""
    number = np.repeat(np.arange(len(bank.actions)), candidates.counts)
    sizes = np.array([bank.roi(name)[::-1] for name in bank.actions], np.int32)[number]
    return jnp.concatenate(candidates.first), jnp.asarray(sizes.reshape(-1, 2)), number


@jax.jit(static_argnames=["max_steps"])
def search(
    bank: Bank,
    image: Float[Array, "H W"],
    goal: Float[Array, "H W"],
    candidates: Candidates,
    limits: Limits,
    *,
    max_steps: int,
) -> Found:
    """Greedy forward search.  Algorithm 1, with strict decrease and ties to the first candidate.

    A candidate whose ROI the last action did not touch keeps its value: neither its own pixels nor
    the goal's have changed, so it is not evaluated again.
    """
    count, pixels = len(candidates), image.size
    first, sizes, number = _rectangles(bank, candidates)
    number = jnp.asarray(number, jnp.int32)
    w_max, h_max = bank.largest_roi
    total = jnp.abs(image - goal).sum(0).sum()

    def look(state: _State) -> _State:
        """Evaluate what is stale and decide whether to go on."""
        changes = refresh(bank, state.image, goal, candidates, state.changes, state.stale)
        found = state.found
        worth = jnp.min(changes, initial=0.0) < -limits.min_gain * pixels
        near = state.total <= limits.tolerance * pixels
        full = found.steps >= max_steps
        status = jnp.where(
            near,
            Status.CONVERGED,
            jnp.where(~worth, Status.NO_IMPROVEMENT, jnp.where(full, Status.MAX_STEPS, -1)),
        )
        found = replace(
            found,
            status=status.astype(jnp.int32),
            evaluations=found.evaluations + state.stale.sum(),
        )
        return replace(state, changes=changes, stale=jnp.zeros_like(state.stale), found=found)

    def act(state: _State) -> _State:
        """Apply the best candidate (the first of equals) to the image."""
        best = jnp.argmin(state.changes).astype(jnp.int32)

        def with_action(action: int):
            def put(state: _State) -> tuple[Array, Array, Array]:
                raw = predict_at(bank, action, state.image, first[best])
                roi = jnp.clip(raw, 0.0, 1.0)
                patch = jnp.zeros((h_max, w_max)).at[: roi.shape[0], : roi.shape[1]].set(roi)
                after = lax.dynamic_update_slice(state.image, roi, first[best])
                return after, patch, (raw != roi).mean()

            return put

        branches = [with_action(action) for action in range(len(bank.actions))]
        after, patch, clipped = lax.switch(number[best], branches, state)
        k = state.found.steps
        found = replace(
            state.found,
            steps=k + 1,
            chosen=state.found.chosen.at[k].set(best),
            patches=lax.dynamic_update_index_in_dim(state.found.patches, patch, k, 0),
            clipped=state.found.clipped.at[k].set(clipped),
        )
        apart = (first >= first[best] + sizes[best]) | (first[best] >= first + sizes)
        return _State(
            image=after,
            total=state.total + state.changes[best],
            changes=state.changes,
            stale=~apart.any(-1),
            found=found,
        )

    room = max(max_steps, 1)  # the loop's body is traced even where no step is allowed
    empty = Found(
        steps=jnp.int32(0),
        chosen=jnp.full(room, -1, jnp.int32),
        patches=jnp.zeros((room, h_max, w_max)),
        clipped=jnp.zeros(room),
        status=jnp.int32(-1),
        evaluations=jnp.int32(0),
    )
    start = _State(image, total, jnp.zeros(count), jnp.ones(count, dtype=bool), empty)
    if count == 0:
        status = jnp.where(
            total <= limits.tolerance * pixels, Status.CONVERGED, Status.NO_IMPROVEMENT
        )
        return replace(empty, status=status.astype(jnp.int32))
    end = lax.while_loop(lambda s: s.found.status < 0, lambda s: look(act(s)), look(start))
    return end.found
