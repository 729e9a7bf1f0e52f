"""Materials and hands of the simulator on disk: one TOML or JSON file each (docs/own_material.md).

Whoever takes the name of a material or of an agent takes the path of such a file, too.
"""

import os
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from jshape.errors import UnknownName, quoted
from jshape.io.files import read_json, read_toml
from jshape.io.records import Numbers, OneLine, Range, read_record
from jshape.sim.hands import AGENTS, Agent, agent_of_numbers
from jshape.sim.material import MATERIALS, Material
from jshape.sim.tools import NUM_FINGERS, NUM_WAYPOINTS, Load

SUFFIXES = (".toml", ".json")
LIMIT = 2**16
"""Largest file that is read, bytes."""
FAR_MM = 140.0
"""No finger is farther than this from the place: an action changes a window of 280 mm."""

_UNITS = {"_mm": 1e-3, "_deg": np.pi / 180}
_Millimetres = Annotated[float, Range(1, 100)] | None
_Share = Annotated[float, Range(0, 1)]


@dataclass(frozen=True)
class MaterialFile:
    """A material: ten numbers, of which those may be left out that the material `like` has."""

    name: Annotated[str, OneLine()] | None = None
    like: str | None = None
    repose_deg: Annotated[float, Range(0, 80)] | None = None
    cohesion: Annotated[float, Range(0, 20)] | None = None
    compressibility: _Share | None = None
    packing_max: Annotated[float, Range(1.001, 10)] | None = None
    elastic: Annotated[float, Range(0, 0.99)] | None = None
    ahead_mm: _Millimetres = None
    pile_mm: _Millimetres = None
    near_mm: _Millimetres = None
    far_mm: _Millimetres = None
    far_share: _Share | None = None
    bulk: Annotated[float, Range(1, 3)] | None = None
    """May be left out, as what is poured only needs it."""

    def problem(self) -> str | None:
        """What no single field tells."""
        if self.like is not None and self.like not in MATERIALS:
            return f"like is {quoted(self.like)}; allowed: {', '.join(MATERIALS)}"
        lacking = [one.name for one in fields(self)[2:-1] if getattr(self, one.name) is None]
        if self.like is None and lacking:
            usual = next(iter(MATERIALS))
            return f"has no {lacking[0]}; give all ten numbers, or like = {usual!r} for the others"
        return None


@dataclass(frozen=True)
class SpreadFile:
    """How much a hand's repetitions differ."""

    place_mm: Annotated[float, Range(0, 20)] = 0.0
    yaw_deg: Annotated[float, Range(0, 90)] = 0.0
    depth: Annotated[float, Range(0, 0.3)] = 0.0
    size: Annotated[float, Range(0, 0.3)] = 0.0
    finger_mm: Annotated[float, Range(0, 10)] = 0.0


@dataclass(frozen=True)
class FingerFile:
    """A finger's way, and its shape."""

    path_mm: Annotated[np.ndarray, Numbers((NUM_WAYPOINTS, 2, 3), -FAR_MM, FAR_MM)]
    radius_mm: Annotated[float, Range(2, 100)]
    rise_mm: Annotated[float, Range(0, 60)] | None = None
    """Of its tip; None: half the radius."""
    flat: _Share = 0.3

    @property
    def numbers(self) -> tuple[np.ndarray, float, float, float]:
        """As `agent_of_numbers` takes them."""
        rise = self.radius_mm / 2 if self.rise_mm is None else self.rise_mm
        return self.path_mm, self.radius_mm, rise, self.flat


@dataclass(frozen=True)
class ActionFile:
    """A stroke of some fingers."""

    fingers: list[FingerFile]
    reach_mm: Annotated[tuple[float, float], Range(1, FAR_MM)]
    times: Annotated[np.ndarray, Numbers((NUM_WAYPOINTS,), 0, 1)] = field(
        default_factory=lambda: np.array([0.0, 1.0, 1.0])
    )
    under: _Share | None = None
    """This and the next: of a hand that moves material; None of all three: it presses."""
    takes: _Share | None = None
    gives_cm3: Annotated[float, Range(0, 1000)] | None = None

    def problem(self) -> str | None:
        """What no single field tells."""
        if not 1 <= len(self.fingers) <= NUM_FINGERS:
            return f"has {len(self.fingers)} fingers; expected 1 to {NUM_FINGERS}"
        times = self.times
        if times[0] != 0 or (np.diff(times) < 0).any() or times[-1] != 1:
            return f"times are {times.tolist()}; expected three rising from 0 to 1"
        return None

    @property
    def load(self) -> Load | None:
        """What the hand does with material, SI."""
        given = (self.under, self.takes, self.gives_cm3)
        if given == (None, None, None):
            return None
        return Load(self.under or 0.0, self.takes or 0.0, (self.gives_cm3 or 0.0) * 1e-6)


@dataclass(frozen=True)
class AgentFile:
    """A hand."""

    actions: dict[str, ActionFile]
    name: Annotated[str, OneLine()] | None = None
    spread: SpreadFile = SpreadFile()

    def problem(self) -> str | None:
        """What no single field tells."""
        return None if self.actions else "has no actions; expected tables such as [actions.poke]"


def material_of(text: str) -> Material:
    """The material that a text names: one of the simulator's, or that of a file.

    Raises UnknownName, or BadFile as `read_material`.
    """
    return read_material(text) if _is_file(text) else MATERIALS[_known("material", text, MATERIALS)]


def agent_of(text: str) -> str | Agent:
    """The agent that a text names: one of the simulator's, or that of a file.

    Raises UnknownName, or BadFile as `read_agent`.
    """
    return read_agent(text) if _is_file(text) else _known("agent", text, AGENTS)


def read_material(path: str | os.PathLike) -> Material:
    """The material of a `MaterialFile`.

    Raises BadFile: not such a file, an unknown or missing field, or a number beyond what can be.
    """
    found = read_record(MaterialFile, _content(path), str(path))
    name, given = found.name or Path(path).stem, _in_si(found)
    if found.like:
        return replace(MATERIALS[found.like], name=name, **given)
    return Material(name, **given)


def read_agent(path: str | os.PathLike) -> Agent:
    """The hand of an `AgentFile`.  Raises as `read_material`."""
    found = read_record(AgentFile, _content(path), str(path))
    spread = {f"spread_{'xy' if n == 'place' else n}": x for n, x in _in_si(found.spread).items()}
    numbers = {
        name: {
            "fingers": [finger.numbers for finger in one.fingers],
            "reach": one.reach_mm,
            "times": tuple(one.times.tolist()),
            "load": one.load,
        }
        for name, one in found.actions.items()
    }
    return agent_of_numbers(found.name or Path(path).stem, numbers, spread)


def _is_file(text: str) -> bool:
    return Path(text).suffix.lower() in SUFFIXES


def _known(what: str, text: str, allowed: Any) -> str:
    if text not in allowed:
        raise UnknownName(what, text, [*allowed, "FILE.toml", "FILE.json"])
    return text


def _content(path: str | os.PathLike) -> dict[str, Any]:
    read = read_json if Path(path).suffix.lower() == ".json" else read_toml
    return read(path, limit=LIMIT)


def _in_si(record: Any) -> dict[str, float]:
    """The numbers of a file that are there, in metres and radians, without their unit's name."""
    found = {}
    for name, value in vars(record).items():
        unit = next((end for end in _UNITS if name.endswith(end)), "")
        if isinstance(value, float):
            found[name.removesuffix(unit)] = value * _UNITS.get(unit, 1.0)
    return found
