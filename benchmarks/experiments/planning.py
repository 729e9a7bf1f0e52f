"""The planning benchmark: methods, loops and problems, each run carried out and measured once.

Planners see noisy looks; what is left is measured on what is really there.  All methods meet the
same problem with the same noise and the same whims of the hand that acts, the robot's.
"""

import json
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from benchmarks.experiments import measures, results
from benchmarks.experiments.baselines import floors
from benchmarks.experiments.methods import METHODS, Method, methods_of, options_of
from benchmarks.experiments.problems import Problem, applied_problems, shape_problems
from benchmarks.experiments.recorded import mpm_problems
from jshape import sim
from jshape.errors import BadDataset, JShapeError, UnknownName
from jshape.io import banks
from jshape.planning.api import Plan, plan
from jshape.planning.devices import Execution
from jshape.planning.options import DEFAULT_BANK
from jshape.planning.options import options as keywords
from jshape.robot.loop import Step, mold
from jshape.robot.simulated import SimulatedWorld

KINDS = ("applied", "shape", "mpm")
"""Kinds of problems."""
LOOPS = ("open", "closed")
"""The first plan applied blindly, or a new one after every look."""
SHOWN = {"applied": 3, "shape": 6}
"""How many problems of a kind are on the contact sheet: of shapes one of each family."""


@dataclass(frozen=True)
class Settings:
    """What decides the results."""

    problems: int = 20
    """Of each kind but the recorded ones."""
    methods: tuple[str, ...] = tuple(METHODS)
    kinds: tuple[str, ...] = KINDS[:2]
    loops: tuple[str, ...] = LOOPS
    max_steps: int = 16
    """Most actions of a run."""
    seconds: float | None = None
    """For each plan, compiling not counted; None is no limit."""
    seed: int = 0


class Case(NamedTuple):
    """One run to be made."""

    kind: str
    number: int
    """Of the problem among its kind."""
    loop: str
    method: str


def run_planning(
    out: Path,
    settings: Settings,
    *,
    data: Path | None = None,
    overwrite: bool = False,
    execution: Execution = Execution(),
    say: Callable[[str], Any] = print,
    progress: Callable[[Iterable[Case], int, str], Iterable[Case]] = lambda cases, *_: cases,
) -> dict[str, Any]:
    """Make all runs that are not in the folder yet; tables and figures after every method.

    Args:
      out: folder of the results; one that was left unfinished with the same settings goes on.
      settings: what to run.
      data: folder that may hold `real/` (measured sand and dough) and `mpm/` (recordings).
      overwrite: begin anew, whatever is there.
      execution: chunks and devices to evaluate candidates with; changes no result.
      say: called with each line for people.
      progress: wraps the runs to be made, to show how far they are.

    Returns:
      The settings, a row of means per kind, method and loop, and what was left out.

    Raises:
      UnknownName: no such method, kind or loop.
      BadDataset: `data` does not hold what is asked for.
      BadFile: the folder holds something else, or runs with other settings.
    """
    for what, given, allowed in (("kind", settings.kinds, KINDS), ("loop", settings.loops, LOOPS)):
        for name in given:
            if name not in allowed:
                raise UnknownName(what, name, allowed)
    methods, notes = methods_of(settings.methods)
    known = {method["bank"]: banks.load_bank(method["bank"]) for method in methods.values()}
    results.check(out, overwrite)
    say(f"drawing problems: {', '.join(settings.kinds)}")
    problems = draw(settings, data)
    meta = asdict(settings) | {
        "methods": methods,
        "banks": {name: banks.bank_manifest(name)["checksums"] for name in known},
        "drawn": {
            kind: [problem.name for problem in several] for kind, several in problems.items()
        },
    }
    record = results.opened(out, meta, overwrite)
    cases = _cases(methods, problems, settings.loops)
    done = {Case(*(step[field] for field in Case._fields)) for step in record.steps}
    left = [case for case in cases if case not in done]
    say(f"{len(cases)} runs, {len(done)} of them there already")
    used = {name: known[method["bank"]] for name, method in methods.items()}
    last = {case.method: case for case in left}
    limits = {_limited(step, methods): step["limit"] for step in record.steps if "limit" in step}

    def so_far() -> None:
        made = f"{len(record)} of {len(cases)} runs are made"
        results.conclude(record, problems, used, [*notes, made])

    with floors():
        try:
            for case in progress(left, len(left), "planning"):
                method, problem = methods[case.method], problems[case.kind][case.number]
                options = options_of(method, known[method["bank"]], case.loop)
                if settings.seconds is not None:
                    options |= {"seconds": settings.seconds}
                found, bed = attempt(problem, case, options | {"execution": execution}, settings)
                what, bank = _limited(case._asdict(), methods), known[method["bank"]]
                if what not in limits:
                    limits[what] = measures.limit_of(problem, bank, method, settings.max_steps)
                found |= {"limit": limits[what], "error_mm": measures.error_mm(found, bank)}
                shown = case.number < SHOWN.get(case.kind, 0) and case.loop == settings.loops[-1]
                depth = sim.render(bed, problem.camera) if shown and bed is not None else None
                record.append(case._asdict() | found, None if depth is None else np.asarray(depth))
                if case is last[case.method] and case is not left[-1]:
                    so_far()
        except KeyboardInterrupt:  # what was made is not lost
            so_far()
            raise
    return results.conclude(record, problems, used, notes)


def _limited(run: Mapping[str, Any], methods: dict[str, Method]) -> tuple[str, int, str]:
    """What the limit of a run is of: each is computed once, since it takes 4 to 12 s."""
    return run["kind"], run["number"], json.dumps(measures.tried(methods[run["method"]]))


def _cases(
    methods: dict[str, Method], problems: dict[str, list[Problem]], loops: Sequence[str]
) -> list[Case]:
    """All runs: the quick methods one after the other, then the long searches problem by problem.

    So what is there after a while compares as many problems of each.
    """
    long = [name for name, method in methods.items() if "evaluations" in method]
    whole = [(kind, number) for kind, several in problems.items() for number in range(len(several))]
    quick = [(name, *one) for name in methods if name not in long for one in whole]
    slow = [(name, *one) for one in sorted(whole, key=lambda one: one[1]) for name in long]
    return [
        Case(kind, number, loop, name)
        for name, kind, number in quick + slow
        for loop in (loops if kind != "mpm" else ("open",))
    ]


def draw(settings: Settings, data: Path | None) -> dict[str, list[Problem]]:
    """The problems of each kind; those of the bundled bank's ROIs, whoever solves them.

    Raises:
      BadDataset: `data` does not hold what is asked for.
    """
    seed, count, found = settings.seed, settings.problems, {}
    if data is not None and not any((data / name).is_dir() for name in ("real", "mpm")):
        raise BadDataset(f"{data}: holds neither real/ nor mpm/")
    if "applied" in settings.kinds:
        found["applied"] = applied_problems(seed, count, banks.load_bank(DEFAULT_BANK))
    if "shape" in settings.kinds:
        found["shape"] = shape_problems(seed, count, None if data is None else data / "real")
    if "mpm" in settings.kinds:
        if data is None:
            raise BadDataset(
                "recorded sequences are in a folder mpm/ of the data, and none is given"
            )
        noisy = mpm_problems(data / "mpm", noisy=True)
        noisy = [replace(problem, name=f"{problem.name} noisy") for problem in noisy]
        found["mpm"] = mpm_problems(data / "mpm") + noisy
    return found


def attempt(
    problem: Problem, case: Case, options: dict[str, Any], settings: Settings
) -> tuple[dict[str, Any], sim.Bed | None]:
    """Plan, act where there is a world, measure: what is written of a run, and the bed after it."""
    found: dict[str, Any] = {
        "problem": problem.name, "family": measures.family(case.kind, problem.name),
        "true_mm": [], "seen_mm": [], "steps": [], "stop": "", "note": "",
        "retrieved": None, "exact": None, "plan": [], "predicted_mm": [],
        "seconds": None, "seconds_per_look": None, "evaluations": None,
    }  # fmt: skip
    if problem.bed is not None:
        acted, first, bed = _acted(problem, problem.bed, case, options, settings)
        found |= acted
    else:
        options = {
            name: value for name, value in options.items() if name not in ("patience", "horizon")
        }
        more: dict[str, Any] = {"max_steps": settings.max_steps}
        if options["space"].positions is not None:  # as in the paper, whose planner knows them
            more |= {"positions": problem.places, "out_of_bounds": "drop"}
        first, bed = plan(problem.start, problem.goal, **keywords(options, **more)), None
        found["stop"] = first.status.name
    if first is not None:
        found |= _planned(first)
        if problem.applied and case.loop == "open":
            found |= measures.retrieval(problem.applied, first, problem.camera)._asdict()
    return found, bed


class Watched:
    """A simulated world that notes what is really there, and how long it waits for an action."""

    def __init__(self, world: SimulatedWorld, problem: Problem):
        self.world, self.problem, self.camera = world, problem, world.camera
        self.true_mm = [problem.distance_mm(world.bed)]
        """Noise-free distances to the goal, at the start and after each action."""
        self.waits: list[float] = []
        """Seconds from each look to the action that follows."""
        self._looked = 0.0

    def look(self) -> np.ndarray:
        """As the world's own."""
        depth = self.world.look()
        self._looked = time.perf_counter()
        return depth

    def act(
        self,
        action: str,
        position: tuple[float | int, float | int],
        strength: float | int = 1.0,
        yaw: float | int = 0.0,
        length: float | int = 1.0,
    ) -> None:
        """As the world's own."""
        self.waits.append(time.perf_counter() - self._looked)
        self.world.act(action, position, strength, yaw, length)
        self.true_mm.append(self.problem.distance_mm(self.world.bed))


def _acted(
    problem: Problem, bed: sim.Bed, case: Case, options: dict[str, Any], settings: Settings
) -> tuple[dict[str, Any], Plan | None, sim.Bed]:
    """What came of acting, the first plan (None where the run failed), and the bed after."""
    rng = np.random.default_rng([settings.seed, 3, KINDS.index(case.kind), case.number])
    key = jax.random.key(int(rng.integers(2**31)))
    beside = options["constraints"].stock_cm3 or 0.0 if "constraints" in options else 0.0
    world = SimulatedWorld(
        key, bed, material=problem.material, camera=problem.camera, stock_cm3=beside
    )
    watched, steps = Watched(world, problem), []
    found: dict[str, Any]
    closed = case.loop == "closed"
    own = {name: options.pop(name) for name in ("patience", "horizon") if name in options}
    try:
        run = mold(
            watched, problem.goal, replan=closed, on_step=lambda step, _: steps.append(step),
            **own, **keywords(options, max_steps=settings.max_steps),
        )  # fmt: skip
    except JShapeError as problem_met:
        # Such as a bed dug out of the camera's range: what is there is the result.
        first, found = None, {"stop": "FAILED", "note": str(problem_met)}
    else:
        first, seen = run.first_plan, [float(d) for d in run.distances_mm]
        found = {"stop": run.stop.name, "seen_mm": seen}
    found["true_mm"] = watched.true_mm
    found["steps"] = _gains(steps, watched.true_mm, None if closed else first)
    if closed and watched.waits:  # the first plan is for all actions, or had to compile
        found["seconds_per_look"] = float(np.median(watched.waits[1:] or watched.waits))
    return found, first, world.bed


def _gains(
    steps: Sequence[Step], true_mm: Sequence[float], blind: Plan | None
) -> list[dict[str, Any]]:
    """What each action was predicted to gain, and gained, mm; a blind plan's as it was made."""
    rows = []
    for k, step in enumerate(steps):
        before, after = step.before_mm, step.predicted_mm
        if blind is not None:
            before, after = (float(d) for d in blind.distances_mm[k : k + 2])
        rows.append({
            "action": step.action, "position": step.position,
            "strength": step.strength, "yaw": step.yaw, "length": step.length,
            "predicted_gain_mm": before - after, "gain_mm": true_mm[k] - true_mm[k + 1],
            "seen_gain_mm": step.before_mm - step.obtained_mm,
        })  # fmt: skip
    return rows


def _planned(first: Plan) -> dict[str, Any]:
    """What is written of a plan."""
    actions = [
        {"action": a.action, "position": a.position, "strength": a.strength, "yaw": a.yaw}
        for a in first
    ]
    return {
        "plan": actions,
        "predicted_mm": [float(d) for d in first.distances_mm],
        "seconds": float(first.seconds),
        "evaluations": int(first.evaluations),
    }
