"""Who takes part in the planning benchmark: options of `mold` and `plan`, by name."""

from collections.abc import Sequence
from typing import Any

from benchmarks.experiments.baselines import FLOORS
from jshape.errors import UnknownName, quoted
from jshape.models.bank import Bank
from jshape.planning.options import DEFAULT_BANK, PAPER, options
from jshape.planning.search import PLANNERS

Method = dict[str, Any]
"""Options that JSON can hold.  `bank` is a name, `min_gain_mm` in mm, `patience` for closed loops;
`positions` is a grid, for which recorded sequences have their own."""

COMMON: Method = {"planner": "greedy", "patience": 4}
"""What a method does not say, and `jshape plan` has no default for, or another."""
DENSE: Method = {
    "bank": DEFAULT_BANK,
    "stride": 12,
    "strengths": [0.2, 0.5, 1.0, 1.6, 2.3],
    "yaws": {"grasp": 6, "press": 6, "pinch": 6},
    "error_margin": 0.5,
}
"""Every action all over the bed, the long ones in several directions, from a fifth to 2.3 times
as deep.  An action must gain more than half of its own usual error."""
SEARCH: Method = DENSE | {"horizon": 2, "evaluations": {"open": 400_000, "closed": 100_000}}
"""Searches that could go on for long: what they may spend on a plan.  Evaluations, not seconds, so
that a busy machine finds the same; a plan of `greedy` takes 130,000 to 380,000."""
MOVING: Method = DENSE | {
    "bank": "moving-flour-robot",
    "yaws": {"grasp": 6, "press": 6, "pinch": 6, "sweep": 6, "scoop": 4},
}
"""The actions that move material too: a carry counts as two actions."""
FLOOR: Method = {"bank": "flour-robot", "stride": 12, "patience": 1000}
"""Floors act whatever comes of it; of the bank they use the ROIs."""

METHODS: dict[str, Method] = {
    "paper": {"bank": "flour-robot", "positions": "7x3"},
    "f_D-dense": {"bank": "flour-robot", "stride": 12},
    "greedy": DENSE,
    "moving": MOVING,
    "moving-refine": MOVING | {"planner": "refine"},
    "moving-stock": MOVING | {"stock_cm3": 500.0},
    "random": FLOOR | {"planner": "random"},
    "surplus": FLOOR | {"planner": "surplus"},
    "careful": SEARCH | {"planner": "careful"},
    "refine": SEARCH | {"planner": "refine"},
}
"""From the paper's planner to ours, the floors (a plan has to be worth more than those), and the
searches beyond greedy."""


def methods_of(names: Sequence[str]) -> tuple[dict[str, Method], list[str]]:
    """The methods of some names, and why those of them that cannot run here are left out.

    Raises:
      UnknownName: a method that is none.
    """
    found, notes = {}, []
    for name in names:
        if name not in METHODS:
            raise UnknownName("method", name, METHODS)
        method = COMMON | METHODS[name]
        planner = method["planner"]
        if planner not in (*PLANNERS, *FLOORS):
            notes.append(f"{name} is left out: there is no planner {quoted(planner)}")
        else:
            found[name] = method
    return found, notes


def options_of(method: Method, bank: Bank, loop: str) -> dict[str, Any]:
    """Keywords of `mold` as the library takes them: the bank itself, the budget."""
    own = {name: method[name] for name in ("patience", "horizon") if name in method}
    fields = {name: value for name, value in method.items() if name not in own}
    fields |= {"bank": bank, "evaluations": method.get("evaluations", {}).get(loop)}
    return options(PAPER, **fields) | own
