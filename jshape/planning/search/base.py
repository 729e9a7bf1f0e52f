"""What every planner takes and gives back."""

import functools
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Any

import jax
import jax.numpy as jnp

from jshape._typing import Array, Bool, Float, Int
from jshape.planning.devices import Execution
from jshape.planning.evaluate import Candidates
from jshape.planning.state import SearchState

UNLIMITED = 2**31 - 1
"""More evaluations, or uses of an action, than any search makes."""


class Status(IntEnum):
    """Why a plan ends."""

    CONVERGED = 0
    """The distance left is at most the tolerance, up to rounding."""
    MAX_STEPS = 1
    """As many actions as allowed were found; `refine` may have taken some out again."""
    NO_IMPROVEMENT = 2
    """No action lowers the distance by more than the least gain asked for."""
    BUDGET = 3
    """The time or the evaluations allowed are spent."""
    PLAN_ENDED = 4
    """It was not searched for: these are the actions that were given."""

    @property
    def meaning(self) -> str:
        """The same in words."""
        return {
            Status.CONVERGED: "the distance left is within the tolerance",
            Status.MAX_STEPS: "as many actions as allowed",
            Status.NO_IMPROVEMENT: "no further action is predicted to gain enough",
            Status.BUDGET: "the time or the evaluations allowed are spent",
            Status.PLAN_ENDED: "these are the actions that were given",
        }[self]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SearchLimits:
    """When a search stops and what it may do.  Numbers, traced: changing one does not recompile."""

    min_gain: float | Array = 0.0
    """An action must lower d by more than this."""
    tolerance: float | Array = 0.0
    """The paper's accuracy d̄: the search has converged when d is at most this."""
    errors: Float[Any, "..."] | float = 0.0
    """By how much d may be wrong because of one prediction, (A,) or one for all; a deeper action is
    wrong by as much more.  An action must gain more than this as well."""
    max_uses: Int[Any, "..."] | int = UNLIMITED
    """How often each action may be used, (A,) or one for all."""
    carry_uses: Int[Any, "..."] | int = UNLIMITED
    """Likewise in carries (see `transfer`): those that are tried in pairs are used in no other
    way."""
    stock: float | Array = float("nan")
    """What a stock beside the bed holds, in units of Σ now; NaN: there is none."""
    max_steps: int | Array = UNLIMITED
    """Most actions, within the room that a search has for them."""

    def needed(
        self, action: Int[Array, "*B"], strengths: Float[Array, "..."]
    ) -> Float[Array, "*B S"]:
        """What actions must gain, for each strength."""
        errors = jnp.asarray(self.errors, jnp.float32)
        error = errors[action] if errors.ndim else jnp.broadcast_to(errors, action.shape)
        strengths = jnp.broadcast_to(strengths, (*action.shape, strengths.shape[-1]))
        needed = error[..., None] * jnp.sqrt(strengths)
        return jnp.maximum(jnp.asarray(self.min_gain, jnp.float32), needed)

    def carry_allowed(self, action: int, used: Int[Array, "A"]) -> Bool[Array, ""]:
        """Whether an action may be used once more in a carry."""
        most = jnp.asarray(self.carry_uses, jnp.int32)
        return used[action] < (most if most.ndim == 0 else most[action])

    def allowed(self, action: Int[Array, "*B"], used: Int[Array, "A"]) -> Bool[Array, "*B"]:
        """Whether actions may be used once more."""
        most = jnp.asarray(self.max_uses, jnp.int32)
        return used[action] < (most if most.ndim == 0 else most[action])


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SearchResult:
    """The sequence that a search found, in storage of fixed size: K = max_steps; B under `vmap`."""

    steps: Int[Any, "*B"]
    """How many actions: entries past this are fillers."""
    move: Int[Any, "*B K"]
    """Numbers of moves, -1 past the end."""
    node: Float[Any, "*B K 2"]
    """Nodes (v, u) of the map: whole ones, or between them after a refinement."""
    strength: Float[Any, "*B K"]
    """How many times as deep as the trained action."""
    turn: Float[Any, "*B K"]
    """Turn of the hand beyond the move's own, radians: 0 before a refinement."""
    stretch: Float[Any, "*B K"]
    """Its path's length as a multiple of the move's own: 1 before a refinement."""
    distance: Float[Any, "*B"]
    """The distance d after the last action, on the map."""
    status: Int[Any, "*B"]
    """A `Status`; -1 while the search goes on."""
    evaluations: Int[Any, "*B"]
    """How many windows were predicted."""


def empty_result(state: SearchState, max_steps: int) -> SearchResult:
    """The empty sequence, with room for `max_steps`."""
    room = room_for(max_steps)
    return SearchResult(
        steps=jnp.int32(0),
        move=jnp.full(room, -1, jnp.int32),
        node=jnp.zeros((room, 2), jnp.float32),
        strength=jnp.zeros(room, jnp.float32),
        turn=jnp.zeros(room, jnp.float32),
        stretch=jnp.ones(room, jnp.float32),
        distance=state.distance,
        status=jnp.int32(-1),
        evaluations=jnp.int32(0),
    )


def room_for(max_steps: int) -> int:
    """Storage for so many actions, in sixteens: another `max_steps` rarely compiles anything."""
    return max(-(-max_steps // 16) * 16, 16)


_traces: list[str] = []
"""Names of the functions that were traced by `compiled`, in this process."""


def compiled(function: Callable, static: tuple[str, ...] = ()) -> Callable:
    """`jax.jit` with these static arguments; a `Budget` sees when it compiles."""

    @functools.wraps(function)
    def traced(*args, **kwargs):
        _traces.append(function.__name__)  # Python runs this only while JAX traces
        return function(*args, **kwargs)

    return jax.jit(traced, static_argnames=static)


class Budget:
    """What a search may spend, and what it has spent.  The clock is whoever plans' own."""

    def __init__(
        self,
        seconds: float | None = None,
        evaluations: int | None = None,
        clock: Callable[[], float] = lambda: 0.0,
    ):
        """A budget that starts now; None is no limit."""
        self.seconds = seconds
        self.evaluations = evaluations
        self.spent = 0
        """Evaluations so far."""
        self._clock = clock
        self._start = clock()
        self._pace = 100.0
        """Evaluations per second: few until some were timed, so that the first look comes soon."""
        self._timed = 0
        self._compiled = False

    @property
    def elapsed(self) -> float:
        """Seconds since the start."""
        return self._clock() - self._start

    @property
    def over(self) -> bool:
        """Nothing is left."""
        late = self.seconds is not None and self.elapsed >= self.seconds
        return late or self.left == 0

    @property
    def left(self) -> int:
        """Evaluations left, whatever the clock says."""
        if self.evaluations is None:
            return UNLIMITED
        return min(max(self.evaluations - self.spent, 0), UNLIMITED)

    def holds(self, evaluations: int) -> bool:
        """Whether there is still enough for so many."""
        if self.seconds is not None and evaluations > self._pace * (self.seconds - self.elapsed):
            return False
        return evaluations <= self.left

    def lasts(self, seconds: float) -> bool:
        """Whether so much time is left."""
        return self.seconds is None or self.elapsed + seconds <= self.seconds

    def call(self, function: Callable, *args: Any, **static: Any) -> Any:
        """The result of a function made by `compiled`, ready.  Compiling it is not counted."""
        known, began = len(_traces), self._clock()
        result = jax.block_until_ready(function(*args, **static))
        if len(_traces) > known:
            self._start += self._clock() - began
            self._compiled = True
        return result

    def spend(self, evaluations: int) -> None:
        """Note what was evaluated; learn how fast it goes."""
        self.spent += int(evaluations)
        if not self._compiled:  # otherwise these took time that is not counted
            self._timed += int(evaluations)
        self._compiled = False
        if self._timed and self.elapsed > 0:
            self._pace = self._timed / self.elapsed

    def room(self) -> int:
        """Evaluations until the clock should be looked at again."""
        room = self.left
        if self.seconds is not None:
            left = max(self.seconds - self.elapsed, 0.0)
            # A twentieth of all the time, so that it is kept within 10 %.
            room = min(room, int(self._pace * min(left, self.seconds / 20)) + 1)
        return room


@dataclass(frozen=True, eq=False)
class SearchProblem:
    """What a search is asked to do."""

    state: SearchState
    """Where it works."""
    candidates: Candidates
    """What it may do."""
    limits: SearchLimits = field(default_factory=SearchLimits)
    max_steps: int = 16
    """Most actions; `limits` says the same."""
    budget: Budget = field(default_factory=Budget)
    fine: int = 0
    """Rounds of local search: the neighbours of the best candidates, at ever smaller steps."""
    start: SearchResult | None = None
    """A sequence to begin with, such as what is left of an earlier plan."""
    execution: Execution = Execution()

    def __post_init__(self) -> None:
        limits = replace(self.limits, max_steps=self.max_steps)
        object.__setattr__(self, "limits", limits)

    @property
    def unpriced(self) -> "SearchProblem":
        """The same where material costs nothing: what is there is shaped."""
        if self.state.price is None:
            return self
        return replace(self, state=replace(self.state, price=jnp.zeros((), jnp.float32)))


def ended(problem: SearchProblem, result: SearchResult, status: Status | None) -> SearchResult:
    """What a search gives back: with all that was spent, and why it ended if that is new."""
    result = replace(result, evaluations=jnp.int32(min(problem.budget.spent, UNLIMITED)))
    if status is None or int(result.status) == Status.CONVERGED:
        return result
    return replace(result, status=jnp.int32(status))
