"""Who takes part in the planning benchmark: options of `mold` and `plan`, by name."""

import importlib.util
from collections.abc import Sequence
from typing import Any

from jshape import metric
from jshape.errors import UnknownName
from jshape.experiments.baselines import FLOORS
from jshape.planners import PLANNERS
from jshape.planning import DEFAULT_BANK
from jshape.predict.bank import Bank

Entry = dict[str, Any]
"""Options that JSON can hold.  `bank` is a name, `min_gain_mm` in mm, `patience` for closed loops;
`positions` is a grid, for which recorded sequences have their own."""

COMMON: Entry = {"planner": "greedy", "min_gain_mm": 0.005, "patience": 2}
"""What an entry does not say.  The least gain is `jshape plan`'s: below it noise decides."""
DENSE: Entry = {
    "bank": DEFAULT_BANK,
    "stride": 8,
    "strengths": [0.2, 0.3, 0.45, 0.7, 1.0, 1.4, 2.0],
    "yaws": 4,
}
"""Every action at every place, in four directions, from a fifth to twice as deep."""
FLOOR: Entry = {"bank": "flour-robot", "stride": 8, "patience": 1000}
"""Floors act whatever comes of it; of the bank they use the ROIs."""

ENTRIES: dict[str, Entry] = {
    "paper": {"bank": "flour-robot", "positions": "7x3"},
    "f_D-dense": {"bank": "flour-robot", "stride": 8},
    "greedy": DENSE,
    "beam": DENSE | {"planner": "beam"},
    "improve": DENSE | {"planner": "improve"},
    "refine": DENSE | {"planner": "refine"},
    "mcts": DENSE | {"planner": "mcts"},
    "random": FLOOR | {"planner": "random"},
    "surplus": FLOOR | {"planner": "surplus"},
}
"""From the paper's planner to ours, and the floors: a plan has to be worth more than those."""
EXTRAS = {"mcts": "mctx"}
"""Planners that need a package which jshape does not bring."""


def entries_of(names: Sequence[str]) -> tuple[dict[str, Entry], list[str]]:
    """The entries of some names, and why those of them that cannot run here are left out.

    Raises:
      UnknownName: an entry that is none.
    """
    found, notes = {}, []
    for name in names:
        if name not in ENTRIES:
            raise UnknownName("entry", name, ENTRIES)
        entry = COMMON | ENTRIES[name]
        planner = entry["planner"]
        package = EXTRAS.get(planner)
        if planner not in (*PLANNERS, *FLOORS):
            notes.append(f"{name} is left out: there is no planner {planner!r}")
        elif package and importlib.util.find_spec(package) is None:
            notes.append(f"{name} is left out: {package} is not installed")
        else:
            found[name] = entry
    return found, notes


def options_of(entry: Entry, bank: Bank) -> dict[str, Any]:
    """Options of `mold` as the library takes them: the bank itself, and gains of d."""
    options = {name: value for name, value in entry.items() if name != "min_gain_mm"}
    least = entry["min_gain_mm"] / float(metric.to_mm(1.0, bank.camera))
    return options | {"bank": bank, "min_gain": least}
