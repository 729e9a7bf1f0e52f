"""A simulated data set made in shards, by any engine: the files that one process would write.

The keys of the simulator's pairs follow one another (`simulate_pairs` splits one off for each), so
a shard begins with the key of its first pair and needs nothing of the others.  Finished shards are
data sets beside the one that is made of them in the end, each with the checksums of its files.
"""

import json
import shutil
from collections.abc import Callable, Generator, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jshape.camera import PAPER_BOX
from jshape.data.simulate import DEPTH_UNIT, ROIS, SimulatedPair, keys_along, simulate_pairs
from jshape.errors import BadFile, JShapeError, one_line
from jshape.grid.engines import Engine, here
from jshape.io import datasets, files, folders

RECIPE = "recipe.json"


class Shard(NamedTuple):
    """Pairs of one action and agent that follow one another."""

    start: int
    """Number of its first pair in the data set."""
    index: int
    """Of its first pair among those of the same action and agent."""
    count: int
    action: str
    agent: str
    key: np.ndarray
    """Data of the key of its first pair."""

    @property
    def name(self) -> str:
        """Of its folder."""
        return f"{self.start:06d}"


@dataclass(frozen=True)
class Simulation:
    """A data set to be simulated; the fields are those of `simulate_pairs`."""

    pairs: int
    """Per action and agent."""
    actions: tuple[str, ...] = tuple(ROIS)
    agents: tuple[str, ...] = ("robot",)
    material: str = "flour"
    beds: tuple[str, ...] = ("flat",)
    frames: int = 5
    strengths: tuple[float, float] = (1.0, 1.0)
    seed: int = 0
    size: int = 16
    """Most pairs of a shard: 5 s of work, and the 25 MB that come back at once."""

    def __len__(self) -> int:
        return self.pairs * len(self.actions) * len(self.agents)

    @property
    def shards(self) -> list[Shard]:
        """All shards, in the order of the data set."""
        keys = np.asarray(jax.random.key_data(keys_along(jax.random.key(self.seed), len(self))))
        found, first = [], 0
        for agent in self.agents:
            for action in self.actions:
                for index in range(0, self.pairs, self.size):
                    count, key = min(self.size, self.pairs - index), keys[first + index]
                    found.append(Shard(first + index, index, count, action, agent, key))
                first += self.pairs
        return found


def simulate(
    simulation: Simulation,
    out: Path,
    engine: Engine = here,
    *,
    overwrite: bool = False,
    say: Callable[[str], object] = lambda line: None,
) -> Generator[str, None, None]:
    """Make a data set; gives the name of each shard when it is there.

    Shards are kept in `OUT.shards` until all are there, so that the same call goes on.  One whose
    files are not those that were written is made again.

    Args:
      simulation: what to make.
      out: folder of the data set.
      engine: what computes.
      overwrite: replace the data set that is there.
      say: is told of each shard that is made again.

    Raises:
      UnknownName, JShapeError: as for `simulate_pairs`.
      BadFile: the folder exists or cannot be written; or shards that were made with other fields
        are kept.
    """
    folders.check_target(out, overwrite, contents=datasets.CONTENTS)
    kept = kept_beside(out)
    _begin(simulation, kept)
    shards, left = simulation.shards, []
    for shard in shards:
        folder = kept / shard.name
        if _is_whole(folder):
            yield shard.name
            continue
        left.append(shard)
        if folder.is_dir():
            say(f"{folder}: damaged or not finished; it is made again")
            shutil.rmtree(folder)
        _checksums_of(folder).unlink(missing_ok=True)
    for number, pairs in engine(simulated, simulation, left):
        folder = kept / left[number].name
        with datasets.dataset_writer(folder, PAPER_BOX, DEPTH_UNIT) as add:
            for index, pair in enumerate(pairs, left[number].start):
                add(
                    id=f"{pair.action}_{pair.agent}_{index:05d}", action=pair.action,
                    agent=pair.agent, material=pair.material, prior=pair.prior,
                    posterior=pair.posterior, u=pair.position[0], v=pair.position[1],
                    width=pair.roi[0], height=pair.roi[1], strength=pair.strength,
                )  # fmt: skip
        files.write_json(_checksums_of(folder), _digests(folder))
        yield left[number].name
    with datasets.dataset_writer(out, PAPER_BOX, DEPTH_UNIT, overwrite=overwrite) as add:
        for shard in shards:
            part = datasets.load_pairs(kept / shard.name)
            for k in range(len(part)):
                add(**datasets.row_of(part, k))
    shutil.rmtree(kept)


def kept_beside(out: Path) -> Path:
    """The folder of a data set's shards, until they are merged."""
    return folders.beside(out, ".shards")


def finished(out: Path) -> int:
    """How many shards of a data set are kept."""
    return len(list(kept_beside(out).glob(_checksums_of(Path("[0-9]*")).name)))


def simulated(simulation: Simulation, shard: Shard) -> list[SimulatedPair]:
    """The pairs of a shard."""
    turn = shard.index % len(simulation.beds)  # they are taken in turn, from where it begins
    beds = simulation.beds[turn:] + simulation.beds[:turn]
    key = jax.random.wrap_key_data(jnp.asarray(shard.key))
    return list(_pairs(simulation, key, shard.count, (shard.action,), (shard.agent,), beds))


def _pairs(
    simulation: Simulation,
    key: jax.Array,
    count: int,
    actions: tuple[str, ...],
    agents: tuple[str, ...],
    beds: tuple[str, ...],
) -> Iterator[SimulatedPair]:
    return simulate_pairs(
        key, count, actions=actions, agents=agents, beds=beds, material=simulation.material,
        frames=simulation.frames, strengths=simulation.strengths,
    )  # fmt: skip


def _checksums_of(folder: Path) -> Path:
    """The file beside a shard's folder that says what is in it; written last."""
    return folder.with_name(f"{folder.name}.json")


def _digests(folder: Path) -> dict[str, str]:
    """SHA-256 of every file below a folder, by its path there."""
    paths = sorted(path for path in folder.rglob("*") if not path.is_dir())
    return {path.relative_to(folder).as_posix(): files.sha256(path) for path in paths}


def _is_whole(folder: Path) -> bool:
    """Whether a shard is there with the files that were written, and no others."""
    try:
        return files.read_json(_checksums_of(folder)) == _digests(folder)
    except JShapeError:
        return False


def _begin(simulation: Simulation, kept: Path) -> None:
    """Check what is asked for, and make the folder of shards, which says what they are shards of.

    Raises:
      BadFile: it holds shards that were made with other fields, or something else.
    """
    nothing = jax.random.key(0), 0, simulation.actions, simulation.agents, simulation.beds
    next(_pairs(simulation, *nothing), None)  # names and numbers are checked all the same
    recipe = json.loads(files.json_text(asdict(simulation), str(kept)))
    if not kept.exists():
        with folders.atomic_folder(kept) as temp:
            files.write_json(temp / RECIPE, recipe)
        return
    if not (kept / RECIPE).is_file():
        raise BadFile(f"{kept}: is for shards, but holds no {RECIPE}; remove it")
    before = files.read_json(kept / RECIPE)
    for name, wanted in recipe.items():
        if before.get(name) != wanted:
            was, now = (one_line(fields.get(name), 60) for fields in (before, recipe))
            raise BadFile(
                f"{kept}: holds shards that were made with another {name}: {was}, now {now}; give "
                "the same to go on, or remove that folder"
            )
