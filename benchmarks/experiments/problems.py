"""Problems of planning that nobody can game: a bed, the image wanted, and who made it, if anybody.

Goals are of two kinds.  "applied": another hand made them on a copy of the bed, with deeper,
turned and overlapping actions at places of no grid; whoever plans with the simulator of a robot
meets a hand that is not the planner's.  "shape": no action made them.  A problem of the simulator
holds its bed, so that plans can be carried out in a `SimulatedWorld`, and the goal without noise,
so that what is left is measured on what is really there, not on the camera's noise.

`PAPER_BOX` sees from 0.42 to 0.47 m, 20 mm below the mean bed: what a deep action digs below that
is 0.47 m deep in start, goal and truth alike, for planners as for their scores.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from benchmarks.experiments import shapes
from jshape import metric, sim
from jshape._typing import Array, Float, Key
from jshape.camera import PAPER_BOX, Camera
from jshape.data.simulate import random_bed
from jshape.data.view import image_of_depth
from jshape.errors import BadImage
from jshape.io.points import read_mesh
from jshape.models.bank import Bank
from jshape.robot.simulated import SimulatedWorld

DEEP_EVERY = 5
"""Every so many applied problems are one deep knock: is it found as one deep knock?"""
OVERLAPPING = (0, 2, 3, 5, 7)
"""Which of every ten applied problems have two actions in a row whose ROIs overlap."""
OVERLAP = (0.2, 0.5)
"""Share of the smaller ROI that lies in the other one."""
LEAST_AREA = 0.1
"""Share of the image that the ROIs of a problem's actions have in total, at least: a goal that
hardly differs from the bed tells nothing."""
TURN = np.radians(30)
"""Half of the hands are turned, by up to this, radians."""
TRIES = 500
"""Places that are drawn until one fits."""


class Applied(NamedTuple):
    """One action that made a goal."""

    action: str
    position: tuple[int, int]
    """(u, v) pixels."""
    strength: float
    """How many times as deep as the hand's nominal action."""
    yaw: float
    """Turn of the hand from u towards v, radians."""


@dataclass(frozen=True, eq=False)
class Problem:
    """A bed as it is, and the image that is wanted of it."""

    name: str
    """Short, for tables; several problems may share one."""
    kind: str
    """"applied" or "shape"."""
    bed: sim.Bed | None
    """The simulator's bed at the start; None where there is none to act in."""
    start: Float[np.ndarray, "H W"]
    """I of the bed at the start, as the noisy camera sees it."""
    goal: Float[np.ndarray, "H W"]
    """I that is wanted."""
    applied: tuple[Applied, ...] = ()
    """What made the goal, in order; () for "shape"."""
    camera: Camera = PAPER_BOX
    """Of the images."""
    material: str = "flour"
    """Of the bed."""
    agent: str = ""
    """Whose hand made the goal."""
    places: np.ndarray | None = None
    """(N, 2) the grid of (u, v) that the actions were placed on, where there is one."""
    truth: np.ndarray | None = None
    """(H, W) the goal without the camera's noise; no planner sees it.  None: not known."""

    @property
    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """I (H, W) of the bed at the start and of the goal, both without noise where that is known.

        What one look's noise adds to the distance no action can take away.
        """
        if self.bed is None or self.truth is None:
            return self.start, self.goal
        return _true(self.bed, self.camera), self.truth

    @property
    def start_mm(self) -> float:
        """Distance from the start to the goal as the noisy camera sees both, mm."""
        return float(metric.to_mm(metric.distance(self.start, self.goal), self.camera))

    def distance_mm(self, bed: sim.Bed) -> float:
        """Distance from a bed to the goal, both without the camera's noise, mm.

        Raises:
          BadImage: the goal is known with the camera's noise only.
        """
        if self.truth is None:
            raise BadImage(f"{self.name}: its goal is known with the camera's noise only")
        left = metric.distance(_true(bed, self.camera), self.truth)
        return float(metric.to_mm(left, self.camera))


def applied_problems(
    seed: int, count: int, bank: Bank, *, material: str = "flour", frames: int = 5
) -> list[Problem]:
    """Goals that another hand made: human and robot in turn, on irregular and curved beds.

    Two to four actions, mostly 1 to 2 times as deep as nominal, half of them turned; every fifth
    goal is one knock, 2 to 2.5 times as deep.  In half of the problems two actions in a row
    overlap by 20 to 50 %.  Problem k does not depend on `count`.

    Args:
      seed: other beds, goals and noise.
      count: how many.
      bank: its camera sees, its actions are applied, and their ROIs are all in the image.
      material: of the beds.
      frames: frames averaged into each look.

    Raises:
      UnknownName: no such material, or the bank has no knock.
    """
    return [_applied_problem(seed, k, bank, material, frames) for k in range(count)]


def shape_problems(
    seed: int,
    count: int,
    data: Path | None = None,
    *,
    camera: Camera = PAPER_BOX,
    material: str = "flour",
    frames: int = 5,
) -> list[Problem]:
    """Goals that no action made, at the mean depth that the camera sees of the bed.

    Letters, bowls, trenches and ridges in turn, then sand and dough that others measured if they
    are there.  The bed was levelled: hills of 2 mm would be more of the distance than the shapes
    are (2.2 mm against 0.5 to 0.8).  Problem k does not depend on `count`.

    Args:
      seed: other shapes and noise.
      count: how many.
      data: folder that may hold `sand/*.npz` (depth maps in `arr_0`, positive is lower) and
        `dough/*.ply` (point clouds, metres, z upwards).
      camera: sees the bed.
      material: of the bed that a plan is carried out in.
      frames: frames averaged into each look.

    Raises:
      UnknownName: no such material.
      BadImage, BadFile: a file of `data` that is not what it should be.
    """
    files = {"sand": _files(data, "sand/*.npz"), "dough": _files(data, "dough/*.ply")}
    kinds = [*shapes.DRAWN, *(kind for kind in files if files[kind])]
    problems = []
    for k in range(count):
        around, kind = divmod(k, len(kinds))
        rng = np.random.default_rng([seed, 1, k])
        if kinds[kind] in shapes.DRAWN:
            shape = shapes.DRAWN[kinds[kind]](rng, camera)
        else:
            there = files[kinds[kind]]
            order = np.random.default_rng([seed, 2, kind]).permutation(len(there))
            shape = _measured(there[order[around % len(there)]], camera)
        problems.append(shape_problem(shape, _key(rng), camera, material, frames))
    return problems


def shape_problem(
    shape: shapes.Shape,
    key: Key[Array, ""],
    camera: Camera = PAPER_BOX,
    material: str = "flour",
    frames: int = 5,
) -> Problem:
    """A shape in a levelled bed, at the mean depth that the camera sees of it."""
    bed = sim.flat_bed()
    world = SimulatedWorld(key, bed, material=material, camera=camera, frames=frames)
    level = float(np.mean(sim.render(bed, camera)))
    depth = shapes.depth_of_relief(shape.relief, camera, middle=level)
    goal = image_of_depth(depth, camera, where=shape.name).image
    rest = {"camera": camera, "material": material, "truth": goal}
    return Problem(shape.name, "shape", bed, _seen(world), goal, **rest)


def overlap(first: Applied, second: Applied, bank: Bank) -> float:
    """Share of the smaller of two ROIs that lies in the other one, in [0, 1]."""
    sizes = np.array([bank.roi(first.action), bank.roi(second.action)])
    low = np.array([first.position, second.position]) - sizes // 2
    both = np.maximum((low + sizes).min(0) - low.max(0), 0)
    return float(both.prod() / sizes.prod(1).min())


def _applied_problem(seed: int, k: int, bank: Bank, material: str, frames: int) -> Problem:
    rng = np.random.default_rng([seed, 0, k])
    for_bed, for_start, for_other = jax.random.split(_key(rng), 3)
    hills = random_bed(for_bed, "irregular", std=rng.uniform(0.003, 0.005))
    bed = _bent(hills, rng.choice([-0.25, 0.25])) if k % 4 == 3 else hills
    agent = ("human", "robot")[k % 2]
    deep = k % DEEP_EVERY == DEEP_EVERY - 1
    applied = _deep_knock(rng, bank) if deep else _drawn(rng, bank, k % 10 in OVERLAPPING)
    who: dict[str, Any] = {
        "material": material, "agent": agent, "camera": bank.camera, "frames": frames,
    }  # fmt: skip
    other = SimulatedWorld(for_other, bed, **who)
    for action in applied:
        other.act(*action)
    over = " overlapping" if k % 10 in OVERLAPPING else " apart"
    name = "deep knock" if deep else f"{len(applied)} actions{over}"
    start = _seen(SimulatedWorld(for_start, bed, **who))
    goal, truth = _seen(other), _true(other.bed, bank.camera)
    return Problem(
        name, "applied", bed, start, goal, applied, bank.camera, material, agent, truth=truth
    )


def _bent(bed: sim.Bed, radius: float) -> sim.Bed:
    """An irregular bed with a dome or a bowl below its hills, low enough for the camera's range."""
    curved = sim.curved_bed(radius, crown=0.008, drop=0.014)
    return sim.loose_bed(bed.height + curved.height - sim.DEPTH)


def _deep_knock(rng: np.random.Generator, bank: Bank) -> tuple[Applied, ...]:
    return (Applied("knock", _anywhere(rng, bank, "knock"), rng.uniform(2.0, 2.5), 0.0),)


def _drawn(rng: np.random.Generator, bank: Bank, overlapping: bool) -> tuple[Applied, ...]:
    """Two to four actions; one pair in a row overlaps, or all lie apart as far as there is room."""
    known = [name for name in bank.actions if name in sim.ACTIONS]
    area = np.array([np.prod(bank.roi(name)) for name in known])
    least = LEAST_AREA * bank.camera.width * bank.camera.height
    chosen = np.zeros(0, int)
    for _ in range(TRIES):
        chosen = rng.integers(len(known), size=rng.integers(2, 5))
        if area[chosen].sum() >= least:
            break
    pair = rng.integers(1, len(chosen)) if overlapping else None
    done: list[Applied] = []
    for k, name in enumerate(known[n] for n in chosen):
        strength = rng.uniform(1.0, 2.0) if rng.random() < 0.8 else rng.uniform(0.7, 1.0)
        yaw = rng.uniform(-TURN, TURN) if rng.random() < 0.5 else 0.0
        best, lowest = Applied(name, (0, 0), strength, yaw), np.inf
        for _ in range(TRIES):
            drawn = best._replace(position=_anywhere(rng, bank, name))
            if k == pair:
                share = overlap(done[-1], drawn, bank)
                cost = abs(share - np.clip(share, *OVERLAP))
            else:
                cost = max((overlap(other, drawn, bank) for other in done), default=0.0)
            if cost < lowest:
                best, lowest = drawn, cost
            if cost == 0:
                break
        done.append(best)
    return tuple(done)


def _anywhere(rng: np.random.Generator, bank: Bank, action: str) -> tuple[int, int]:
    """A place whose ROI is in the image, anywhere."""
    w, h = bank.roi(action)
    u = w // 2 + rng.integers(bank.camera.width - w + 1)
    v = h // 2 + rng.integers(bank.camera.height - h + 1)
    return int(u), int(v)


def _measured(path: Path, camera: Camera) -> shapes.Shape:
    """Sand or dough that was measured, as a relief."""
    if path.suffix == ".npz":
        with np.load(path, allow_pickle=False) as arrays:
            return shapes.Shape(f"sand {path.stem}", shapes.sand(arrays["arr_0"], camera))
    # Such as "dumpling_001_cutter_planar": which piece, and after how many tools.
    name = " ".join(path.stem.split("_")[: 3 if path.stem.startswith("alphabet") else 2])
    return shapes.Shape(f"dough {name}", shapes.dough(read_mesh(path)[0], camera))


def _seen(world: SimulatedWorld) -> np.ndarray:
    return image_of_depth(world.look(), world.camera, where="look").image


def _true(bed: sim.Bed, camera: Camera) -> np.ndarray:
    """I of a bed as a camera without noise and gaps would see it."""
    level = camera.luminance(sim.render(bed, camera), quantize=False)
    return np.asarray(metric.weigh(level, camera))


def _files(folder: Path | None, pattern: str) -> list[Path]:
    return [] if folder is None else sorted(folder.glob(pattern))


def _key(rng: np.random.Generator):
    return jax.random.key(int(rng.integers(2**31)))
