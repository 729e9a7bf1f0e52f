"""What is measured of plans: retrieved actions, what is left of the distance, how sure that is.

A run is a dict, as `planning` writes it: one method in one loop on one problem.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching

from benchmarks.experiments.problems import Applied, Problem
from jshape import metric
from jshape.actions import PAPER_Z
from jshape.camera import Camera
from jshape.models.bank import Bank
from jshape.planning.limit import efficiency, limit
from jshape.planning.options import options
from jshape.planning.plan import Plan

Run = dict[str, Any]
NEAR_MM = 10.0
"""A planned action is the applied one if it is of the same type and within this of its place."""
FAMILIES = {
    "applied": ("apart", "overlapping", "deep knock"),
    "shape": ("letter", "bowl", "trench", "ridge", "sand", "dough"),
    "mpm": ("noise-free", "noisy"),
}
"""Parts of each kind of problems, by a word of their names."""
DRAWS = 10_000
"""Of the bootstrap."""


class Retrieval(NamedTuple):
    """How much of what was applied a plan says."""

    retrieved: float
    """Share of the applied actions that are in the plan."""
    exact: bool
    """All of them are, and nothing else."""


def retrieval(applied: Sequence[Applied], plan: Plan, camera: Camera) -> Retrieval:
    """Applied actions matched to planned ones, as many as possible and each at most once.

    The same type within `NEAR_MM` of the place; order, strength and direction do not count.
    """
    if not len(plan):
        return Retrieval(0.0, False)
    size = 1e3 * PAPER_Z / np.array([float(camera.fx), float(camera.fy)])  # mm of a pixel
    places = np.array([action.position for action in applied], float).reshape(-1, 1, 2)
    apart = np.linalg.norm((plan.exact_positions[None] - places) * size, axis=-1)
    names = np.array([action.action for action in applied])[:, None]
    fits = (apart <= NEAR_MM) & (names == np.array(plan.actions, dtype=object)[None])
    matched = maximum_bipartite_matching(csr_array(fits.astype(np.int8)), perm_type="column")
    found = int((matched >= 0).sum())
    return Retrieval(found / len(applied), found == len(applied) == len(plan))


def tried(method: Mapping[str, Any]) -> dict[str, Any]:
    """Options of a method that its limit depends on; methods that share them share it.

    Depths are those that `jshape.limit` takes by itself, which no method goes beyond: so methods
    that try fewer, or fewer places, are held against what their bank can do.
    """
    return {name: method[name] for name in ("bank", "yaws", "stock_cm3") if name in method}


def limit_of(problem: Problem, bank: Bank, method: Mapping[str, Any], max_steps: int) -> float:
    """Share of the distance that no plan of such a method can go below; 0: nothing is proven."""
    asked = options(**tried(method) | {"bank": bank})
    return limit(*problem.ends, max_steps=max_steps, **asked).left


def errors_mm(bank: Bank) -> dict[str, float]:
    """Per action, what one prediction usually makes wrong of the distance of the image, mm."""
    errors = np.asarray(metric.to_mm(bank.error_of_d(), bank.camera)).tolist()
    return dict(zip(bank.actions, errors, strict=True))


def error_mm(run: Run, bank: Bank) -> float:
    """The usual errors of all predictions of a run together; a deeper action's is larger."""
    errors = errors_mm(bank)
    acts = run["steps"] if run["true_mm"] else run["plan"]
    return float(sum(errors[act["action"]] * act["strength"] ** 0.5 for act in acts))


def is_below_limit(run: Run) -> bool:
    """Whether a run ended below its limit by more than its predictions' errors: none should."""
    distances = _measured(run)
    return distances[-1] < run["limit"] * distances[0] - run["error_mm"]


def limits_kept(runs: Sequence[Run]) -> str:
    """A line on how many runs ended below their limits, and which."""
    known = [run for run in runs if run.get("limit") is not None]
    below = [f"{run['method']}, {run['loop']}, {run['problem']}" for run in known
             if is_below_limit(run)]  # fmt: skip
    return (
        f"{len(below)} of {len(known)} runs ended below their limit by more than the usual errors "
        f"of their predictions together{': ' if below else ''}{'; '.join(below)}"
    )


def family(kind: str, name: str) -> str:
    """Which part of its kind a problem belongs to; of recorded sequences whether noisy."""
    known = [word for word in FAMILIES[kind] if f" {word} " in f" {name} "]
    return known[0] if known else FAMILIES[kind][0]


def interval(values: Iterable[float]) -> tuple[float, float]:
    """95 % confidence interval of a mean: percentile bootstrap, always the same draws."""
    known = np.array(list(values), float)
    drawn = np.random.default_rng(0).integers(len(known), size=(DRAWS, len(known)))
    low, high = np.percentile(known[drawn].mean(1), (2.5, 97.5))
    return float(low), float(high)


def summarise(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """A row of means per kind, method and loop, in their order of appearance.

    `left` is d left over d at the start, without the camera's noise; `seen_left` the same as the
    camera sees it; `limit` what no plan can go below, and `efficiency` what was covered, of what
    that lets any plan cover (where there is nothing to act in, as predicted).  What was not
    measured is None.
    """
    groups: dict[tuple[str, str, str], list[Run]] = {}
    for run in runs:
        groups.setdefault((run["kind"], run["method"], run["loop"]), []).append(run)
    rows = []
    for (kind, method, loop), mine in groups.items():
        deep = [run["exact"] for run in mine if run["family"] == "deep knock"]
        rows.append({
            "kind": kind, "method": method, "loop": loop, "problems": len(mine),
            "failed": sum(run["stop"] == "FAILED" for run in mine),
            **_left(mine),
            "seen_left": _mean(_share(run["seen_mm"]) for run in mine),
            "predicted_left": _mean(_share(run["predicted_mm"]) for run in mine),
            "actions": _mean(len(run["steps"]) for run in mine),
            "planned": _mean(len(run["plan"]) for run in mine),
            "retrieved": _mean(run["retrieved"] for run in mine),
            "exact": _mean(run["exact"] for run in mine),
            "one_knock": _mean(deep),
            # Medians: a run that had to compile does not count.
            "seconds": _median(run["seconds"] for run in mine),
            "seconds_per_look": _median(run["seconds_per_look"] for run in mine),
            "evaluations": _mean(run["evaluations"] for run in mine),
            "families": {
                name: {"problems": len(them)} | _left(them)
                for name in FAMILIES[kind]
                if (them := [run for run in mine if run["family"] == name])
            },
        })  # fmt: skip
    return rows


def _left(runs: Sequence[Run]) -> dict[str, Any]:
    shares = [_share(run["true_mm"]) for run in runs]
    known = [one for one in shares if one is not None]
    low, high = interval(known) if known else (None, None)
    return {
        "left": _mean(shares), "left_low": low, "left_high": high,
        "limit": _mean(run.get("limit") for run in runs),
        "efficiency": _mean(_efficiency(run) for run in runs),
    }  # fmt: skip


def _efficiency(run: Run) -> float | None:
    """What a run covered of what any can; None where its limit is not known, or is all."""
    left, most = _share(_measured(run)), run.get("limit")
    return None if left is None or most is None or most >= 1 else efficiency(left, most)


def _measured(run: Run) -> Sequence[float]:
    """Distances without noise, or as predicted where there is nothing to act in, mm."""
    return run["true_mm"] or run["predicted_mm"]


def _share(distances: Sequence[float]) -> float | None:
    """The last of some distances over the first."""
    return distances[-1] / distances[0] if distances else None


def _mean(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def _median(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known else None
