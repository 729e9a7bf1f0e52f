"""`python -m benchmarks.grid train|simulate`: many trainings or a large data set, over Ray.

Both fall into pieces that know nothing of each other.  Ray runs the pieces, on this machine's cores
or on a cluster; this process writes what comes back, so machines need no common disk.  Finished
pieces are kept: the same command goes on where it was stopped.
"""

import argparse
import hashlib
import os
import shutil
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

import jax
import jax.numpy as jnp
import numpy as np

import jshape
from benchmarks import console
from jshape import PAPER_BOX, Bank, Pairs, load_pairs
from jshape.cli import tables
from jshape.data.simulate import DEPTH_UNIT, ROIS, keys_along, simulate_pairs, together
from jshape.errors import BadFile, JShapeError
from jshape.io import banks, datasets, files, folders
from jshape.learn.fit import FITTERS, fit
from jshape.learn.noise_floor import noise_floor
from jshape.learn.report import scores_csv, scores_table
from jshape.learn.scores import Trial, roi_errors_mm, summarise
from jshape.learn.settings import settings_from
from jshape.learn.study import split_pairs, unrefined
from jshape.planning.devices import cores, remember_compiled

TRAINING = {
    "seed": console.seed,
    "width": int,
    "epochs": int,
    "batch": int,
    "learning_rate": float,
    "patience": int,
    "validation": float,
    "morphology": str,
}
"""Options of `jshape.learn.settings.Training`, and how they are read."""
RECIPE = ("actions", "agents", "material", "beds", "frames", "strengths")
"""Options of `simulate_pairs`."""
VERSIONS = {"jshape": jshape.__version__, "jax": jax.__version__}


def mapped(
    work: Callable, tasks: Sequence, *shared: Any, address: str | None = None, cpus: int = 1
) -> Iterator[Any]:
    """Yield `work(task, *shared)` of each task as Ray finishes it; an error of `work` is raised.

    Args:
      work: a function of a module that Ray's workers can import.
      tasks: its first arguments.
      shared: its others, sent once to each machine.
      address: of a cluster, as for `ray.init`; None: $RAY_ADDRESS, else this machine's cores.
      cpus: cores of each task.
    """
    try:
        import ray
    except ImportError:
        raise JShapeError("needs Ray: pip install 'jshape[grid]'") from None
    started = not ray.is_initialized()
    if started:
        address = address or os.environ.get("RAY_ADDRESS") or "local"
        here = {"num_cpus": cores(), "include_dashboard": False} if address == "local" else {}
        with warnings.catch_warnings():  # JAX's, of forks: Ray's processes are other programs
            warnings.filterwarnings("ignore", r"os\.fork\(\) was called", RuntimeWarning)
            try:
                ray.init(address, log_to_driver=False, logging_level="ERROR", **here)
            except (OSError, RuntimeError, ValueError) as problem:
                said = str(problem).strip().partition("\n")[0]
                raise JShapeError(f"no Ray cluster at {address}: {said}") from None
    limits = {"num_cpus": cpus, "runtime_env": {"env_vars": {"NPROC": str(cpus)}}}
    remote, waiting, running = ray.remote(_piece).options(**limits), list(tasks)[::-1], []
    try:
        stored = [ray.put(one) for one in shared]
        while waiting or running:
            places = max(1, int(ray.cluster_resources().get("CPU", 1) // cpus))
            while waiting and len(running) < 2 * places:
                running.append(remote.remote(VERSIONS, work, waiting.pop(), *stored))
            (done,), running = ray.wait(running)
            yield ray.get(done)
    except ray.exceptions.RayTaskError as problem:
        raise problem.cause or problem from None
    except ray.exceptions.RayError as problem:
        raise JShapeError(f"Ray gave up: {str(problem).partition(chr(10))[0]}") from None
    finally:
        for one in running:
            ray.cancel(one, force=True)
        if started:
            ray.shutdown()


def _piece(versions: dict[str, str], work: Callable, task: Any, *shared: Any) -> Any:
    if versions != VERSIONS:
        raise JShapeError(f"{os.uname().nodename} has {VERSIONS}; expected {versions}, as here")
    remember_compiled()
    return work(task, *shared)


class Cell(NamedTuple):
    """One bank of the grid: fitted to the pairs of an agent and action that a partition keeps."""

    agent: str
    action: str
    kind: str
    partition: int
    """From 0."""

    @property
    def name(self) -> str:
        """Of its folder: "robot-poke-CR-0"."""
        return "-".join(quote(str(part), safe="").replace("-", "%2D") for part in self)


def fitted(
    cells: Sequence[Cell], pairs: Pairs, recipe: dict[str, Any]
) -> list[tuple[Cell, Bank | None, Trial | str]]:
    """Fit one bank, and test it as each of the cells; f_C is what is inside f_CR.

    Args:
      cells: of one agent, action and partition, and of kinds that are one training.
      pairs: of all agents and actions.
      recipe: options of training; its seed is that of the partitions too.

    Returns:
      Each cell's bank and test, or None and what went wrong.
    """
    agent, action, _, partition = cells[0]
    try:
        mine = pairs.of(action, agent)
        # Partitions are drawn one after the other, so more of them leave the first as they are.
        split = split_pairs(mine, partition + 1, seed=recipe.get("seed", 0))[-1][agent]
        training, tested = mine.select(np.sort(split.train)), mine.select(split.test)
        kind = max((cell.kind for cell in cells), key=len)
        whole, found = fit(training, kind, **recipe), []
        for cell in cells:
            bank = whole if cell.kind == kind else unrefined(whole, cell.kind)
            measured = roi_errors_mm(bank, tested, action, size=mine.roi_size(action))
            trial = Trial(cell.kind, agent, agent, action, len(training), tested.id, *measured)
            found.append((cell, bank, trial))
        return found
    except Exception as problem:  # the other cells do not depend on it
        return [(cell, None, f"{type(problem).__name__}: {problem}") for cell in cells]


def train(options: argparse.Namespace) -> int:
    """Banks of agents x actions x kinds x partitions, and a table of their errors."""
    pairs = load_pairs(options.dataset)
    recipe = {n: getattr(options, n) for n in TRAINING if getattr(options, n) is not None}
    settings_from(recipe)  # checks them
    groups = dict.fromkeys(zip(pairs.agent.tolist(), pairs.action.tolist(), strict=True))
    cells = [
        Cell(agent, action, kind, partition)
        for partition in range(options.partitions)
        for agent, action in groups
        for kind in dict.fromkeys(options.kinds)
        if agent in (options.agents or (agent,)) and action in (options.actions or (action,))
    ]
    common = {"training": recipe, "pairs": _digest(pairs)}
    facts = {cell: {**cell._asdict(), **common} for cell in cells}
    trials = {cell: _finished(options.out / cell.name, facts[cell]) for cell in cells}
    trials = {cell: trial for cell, trial in trials.items() if trial is not None}
    print(f"{len(cells)} cells, {len(trials)} of them finished before", flush=True)
    tasks: dict[Cell, list[Cell]] = {}
    for cell in (cell for cell in cells if cell not in trials):
        tasks.setdefault(cell._replace(kind=cell.kind.removesuffix("R")), []).append(cell)
    made = mapped(
        fitted, [*tasks.values()], pairs, recipe, address=options.address, cpus=options.cpus
    )
    failed = 0
    for cell, bank, trial in chain.from_iterable(tables.progress(made, len(tasks), "trainings")):
        if bank is None:
            failed += 1
            print(f"{cell.name} failed: {trial}")
            continue
        told = {name: np.asarray(part).tolist() for name, part in trial._asdict().items()}
        info = {"cell": facts[cell], "trial": told}
        banks.save_bank(bank, options.out / cell.name, info=info)
        trials[cell] = trial
    scores = summarise([trials[cell] for cell in cells if cell in trials], noise_floor(pairs))
    if scores:
        files.write_atomic(options.out / "scores.csv", scores_csv(scores))
        tables.print_table(*scores_table(scores))
    return 2 if failed or not scores else 0


def _finished(folder: Path, facts: dict[str, Any]) -> Trial | None:
    """The test of a cell that is in a folder, if it was made of the same."""
    if not folder.exists():
        return None
    manifest = banks.bank_manifest(folder)
    if manifest.get("cell") != facts:
        raise BadFile(f"{folder}: is of other pairs or options; remove it, or choose another --out")
    arrays = {name: np.array(manifest["trial"][name]) for name in ("id", "error_mm", "change_mm")}
    return Trial(**manifest["trial"] | arrays)


def _digest(pairs: Pairs) -> str:
    """SHA-256 of the pairs."""
    digest = hashlib.sha256(repr((pairs.camera, pairs.depth_unit, pairs.id.tolist())).encode())
    for field in (pairs.centre, pairs.size, pairs.strength, *pairs.prior, *pairs.posterior):
        digest.update(np.ascontiguousarray(field).data)
    return digest.hexdigest()


class Shard(NamedTuple):
    """Simulated pairs of one action and agent that follow one another in the data set."""

    start: int
    index: int
    """Of the first among those of its action and agent."""
    count: int
    action: str
    agent: str
    key: np.ndarray
    """The simulator's keys follow one another; this is the first pair's."""


def shards_of(seed: int, pairs: int, size: int, recipe: dict[str, Any]) -> list[Shard]:
    """All shards of a data set, at most `size` pairs each, in its order."""
    groups = [(agent, action) for agent in recipe["agents"] for action in recipe["actions"]]
    keys = keys_along(jax.random.key(seed), pairs * len(groups))
    keys, found = np.asarray(jax.random.key_data(keys)), []
    for first, (agent, action) in enumerate(groups):
        for index in range(0, pairs, size):
            start, count = first * pairs + index, min(size, pairs - index)
            found.append(Shard(start, index, count, action, agent, keys[start]))
    return found


def simulated(shard: Shard, recipe: dict[str, Any]) -> tuple[Shard, Pairs]:
    """A shard and its pairs: those of `simulate_pairs` from its key on."""
    turn = shard.index % len(recipe["beds"])  # beds are taken in turn, from where it begins
    beds = [*recipe["beds"][turn:], *recipe["beds"][:turn]]
    mine = recipe | {"beds": beds, "actions": [shard.action], "agents": [shard.agent]}
    key = jax.random.wrap_key_data(jnp.asarray(shard.key))
    return shard, together(simulate_pairs(key, shard.count, **mine))


def simulate(options: argparse.Namespace) -> int:
    """The data set of `jshape dataset simulate`, made in shards."""
    recipe = {name: getattr(options, name) for name in RECIPE}
    recipe["strengths"] = tuple(options.strengths)
    next(simulate_pairs(jax.random.key(0), 0, **recipe), None)  # checks it
    folders.check_target(options.out, options.overwrite, contents=datasets.CONTENTS)
    kept = folders.beside(options.out, ".shards")
    wanted = {"seed": options.seed, "pairs": options.pairs, "size": options.size}
    wanted |= recipe | {"strengths": options.strengths}
    if kept.exists() and files.read_json(kept / "recipe.json") != wanted:
        raise BadFile(f"{kept}: holds shards of other options; give the same, or remove it")
    files.write_json(kept / "recipe.json", wanted)
    shards = shards_of(options.seed, options.pairs, options.size, recipe)
    places = {shard.start: kept / f"{shard.start:06d}" for shard in shards}
    left = [shard for shard in shards if not places[shard.start].exists()]
    print(f"{len(shards)} shards, {len(shards) - len(left)} of them finished before", flush=True)
    made = mapped(simulated, left, recipe, address=options.address, cpus=options.cpus)
    for shard, pairs in tables.progress(made, len(left), "shards"):
        datasets.save_pairs(pairs, places[shard.start])
    with datasets.dataset_writer(
        options.out, PAPER_BOX, DEPTH_UNIT, overwrite=options.overwrite
    ) as add:
        for start, place in places.items():
            part = load_pairs(place)
            for k, name in enumerate(map("_".join, zip(part.action, part.agent, strict=True))):
                add(**datasets.row_of(part, k) | {"id": f"{name}_{start + k:05d}"})
    shutil.rmtree(kept)
    print(f"{options.pairs * len(recipe['actions']) * len(recipe['agents'])} pairs: {options.out}")
    return 0


def build_parser() -> argparse.ArgumentParser:
    """The two commands and their options."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.grid", description=__doc__)
    commands = parser.add_subparsers(metavar="WHAT", required=True)
    count = console.positive_count

    add = _command(commands, "train", train)
    add("dataset", type=Path)
    add("--out", type=Path, required=True, help="folder of the banks and their table")
    add("--kinds", nargs="+", default=["P"], choices=FITTERS, help="of banks (P)")
    add("--agents", nargs="+", metavar="AGENT", help="(all)")
    add("--actions", nargs="+", metavar="ACTION", help="(all)")
    add("--partitions", type=count, default=4, help="of the pairs: 75 %% to fit to (4)")
    for name, kind in TRAINING.items():
        add(f"--{name.replace('_', '-')}", type=kind, help="as for `jshape train`")

    add = _command(commands, "simulate", simulate)
    add("out", type=Path, help="folder of the new data set")
    add("--pairs", type=count, default=25, help="per action and agent (25)")
    add("--actions", nargs="+", default=list(ROIS), help="(all five)")
    add("--agents", nargs="+", default=["robot"], help="robot, human")
    add("--material", default="flour", help="flour, sand or dough")
    add("--beds", nargs="+", default=["flat"], help="flat, irregular, curved")
    add("--frames", type=count, default=5, help="averaged per look (5)")
    add("--strengths", nargs=2, type=float, default=[1.0, 1.0], help="least and greatest (1 1)")
    add("--seed", type=console.seed, default=0)
    add("--size", type=count, default=16, help="most pairs of a shard (16)")
    add("--overwrite", action="store_true", help="replace an earlier data set")
    return parser


def _command(commands: Any, name: str, run: Callable) -> Callable:
    parser = commands.add_parser(name, help=run.__doc__, description=run.__doc__)
    parser.set_defaults(run=run)
    parser.add_argument("--address", help="of a Ray cluster: auto, HOST:6379 (this machine)")
    parser.add_argument("--cpus", type=console.positive_count, default=1, help="per piece (1)")
    return parser.add_argument


def main(words: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code."""
    return console.run("grid", build_parser(), words)


if __name__ == "__main__":
    from benchmarks.grid import main as by_name  # Ray's workers must find what is sent to them

    sys.exit(by_name())
