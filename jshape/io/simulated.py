"""Materials and hands of the simulator on disk: one TOML or JSON file each (docs/own_material.md).

Whoever takes the name of a material or of an agent takes the path of such a file, too.
"""

import os
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from jshape.errors import BadFile, UnknownName, did_you_mean, is_name, one_line, quoted
from jshape.io.files import parse_json, read_bytes
from jshape.sim.material import MATERIALS, Material
from jshape.sim.tools import ACTIONS, AGENTS, NUM_FINGERS, NUM_WAYPOINTS, Agent, agent_of_numbers

SUFFIXES = (".toml", ".json")
LIMIT = 2**16
"""Largest file that is read, bytes."""
FAR_MM = 140.0
"""No finger is farther than this from the place: an action changes a window of 280 mm."""

_NUMBERS: dict[str, tuple[str, float, float, float]] = {
    "repose_deg": ("repose", np.pi / 180, 0.0, 80.0),
    "cohesion": ("cohesion", 1.0, 0.0, 20.0),
    "compressibility": ("compressibility", 1.0, 0.0, 1.0),
    "packing_max": ("packing_max", 1.0, 1.001, 10.0),
    "elastic": ("elastic", 1.0, 0.0, 0.99),
    "ahead_mm": ("ahead", 1e-3, 1.0, 100.0),
    "pile_mm": ("pile", 1e-3, 1.0, 100.0),
    "near_mm": ("near", 1e-3, 1.0, 100.0),
    "far_mm": ("far", 1e-3, 1.0, 100.0),
    "far_share": ("far_share", 1.0, 0.0, 1.0),
}
"""Of a material's file: the field of `Material`, its unit, and the least and greatest value."""
_SPREAD = {
    "place_mm": ("spread_xy", 1e-3, 0.0, 20.0),
    "yaw_deg": ("spread_yaw", np.pi / 180, 0.0, 90.0),
    "depth": ("spread_depth", 1.0, 0.0, 0.3),
    "size": ("spread_size", 1.0, 0.0, 0.3),
    "finger_mm": ("spread_finger", 1e-3, 0.0, 10.0),
}
"""The same of how much a hand's repetitions differ."""


def material_of(text: str) -> Material:
    """The material that a text names: one of the simulator's, or that of a file.

    Raises:
      UnknownName: no such material.
      BadFile: as for `read_material`.
    """
    if Path(text).suffix.lower() in SUFFIXES:
        return read_material(text)
    if text not in MATERIALS:
        raise UnknownName("material", text, [*MATERIALS, "FILE.toml", "FILE.json"])
    return MATERIALS[text]


def agent_of(text: str) -> str | Agent:
    """The agent that a text names: one of the simulator's, or that of a file.

    Raises:
      UnknownName: no such agent.
      BadFile: as for `read_agent`.
    """
    if Path(text).suffix.lower() in SUFFIXES:
        return read_agent(text)
    if text not in AGENTS:
        raise UnknownName("agent", text, [*AGENTS, "FILE.toml", "FILE.json"])
    return text


def read_material(path: str | os.PathLike) -> Material:
    """A material: `name`, and ten numbers; those of the material that `like` names may be left out.

    Raises:
      BadFile: not such a file, an unknown or missing field, or a number beyond what can be.
    """
    where, fields = str(path), _table(path, ("name", "like", *_NUMBERS))
    name, like = _name(fields, path), fields.get("like")
    if like is not None and like not in MATERIALS:
        raise BadFile(f"{where}: like is {quoted(like)}; allowed: {', '.join(MATERIALS)}")
    if like is None and (missing := [one for one in _NUMBERS if one not in fields]):
        raise BadFile(
            f"{where}: has no {missing[0]}; give all ten numbers, or like = "
            f"{quoted(next(iter(MATERIALS)))} for those that are left out"
        )
    given = {
        field: _number(fields[key], f"{where}: {key}", low, high) * unit
        for key, (field, unit, low, high) in _NUMBERS.items()
        if key in fields
    }
    if like is None:
        return Material(name, **given)
    return replace(MATERIALS[like], name=name, **given)


def read_agent(path: str | os.PathLike) -> Agent:
    """A hand: `name`, an optional table `spread`, and a table of its `actions`.

    Raises:
      BadFile: not such a file, an unknown or missing field, or a number beyond what can be.
    """
    where, fields = str(path), _table(path, ("name", "spread", "actions"))
    spread = _known(fields.get("spread", {}), _SPREAD, f"{where}: spread")
    spreads = {
        field: _number(spread.get(key, 0.0), f"{where}: spread: {key}", low, high) * unit
        for key, (field, unit, low, high) in _SPREAD.items()
    }
    actions = fields.get("actions")
    if not isinstance(actions, dict) or not actions:
        raise BadFile(f"{where}: has no actions; expected tables such as [actions.poke]")
    numbers = {name: _action(one, f"{where}: {name}") for name, one in actions.items()}
    for name in numbers:
        if not is_name(name):
            raise BadFile(f"{where}: the action {quoted(name)} needs a name such as {ACTIONS[0]}")
    return agent_of_numbers(_name(fields, path), numbers, spreads)


def _action(content: Any, where: str) -> dict[str, Any]:
    """The numbers of a stroke: fingers as (path, radius, rise, flat) in mm, reach and times."""
    content = _known(content, ("fingers", "reach_mm", "times"), where)
    fingers = content.get("fingers")
    if not isinstance(fingers, list) or not 1 <= len(fingers) <= NUM_FINGERS:
        raise BadFile(f"{where}: fingers: expected a list of 1 to {NUM_FINGERS}")
    read = []
    for k, finger in enumerate(fingers):
        at = f"{where}: finger {k + 1}"
        finger = _known(finger, ("path_mm", "radius_mm", "rise_mm", "flat"), at)
        path = _array(finger.get("path_mm"), (NUM_WAYPOINTS, 2, 3), f"{at}: path_mm", FAR_MM)
        radius = _number(finger.get("radius_mm"), f"{at}: radius_mm", 2.0, 60.0)
        rise = _number(finger.get("rise_mm", radius / 2), f"{at}: rise_mm", 0.0, 60.0)
        read.append((path, radius, rise, _number(finger.get("flat", 0.3), f"{at}: flat", 0.0, 1.0)))
    times = _array(content.get("times", [0.0, 1.0, 1.0]), (NUM_WAYPOINTS,), f"{where}: times", 1.0)
    if times[0] != 0 or (np.diff(times) < 0).any() or times[-1] != 1:
        raise BadFile(f"{where}: times are {times.tolist()}; expected three rising from 0 to 1")
    reach = _array(content.get("reach_mm"), (2,), f"{where}: reach_mm", FAR_MM)
    if (reach < 1.0).any():
        raise BadFile(f"{where}: reach_mm is {reach.tolist()}; expected two numbers from 1")
    return {"fingers": read, "reach": tuple(reach.tolist()), "times": tuple(times.tolist())}


def _table(path: str | os.PathLike, allowed: tuple[str, ...]) -> Mapping[str, Any]:
    data, where = read_bytes(path, limit=LIMIT), str(path)
    if Path(path).suffix.lower() == ".json":
        return _known(parse_json(data, where), allowed, where)
    try:
        return _known(tomllib.loads(data.decode("utf-8-sig")), allowed, where)
    except (ValueError, RecursionError) as problem:  # of TOML and of UTF-8
        raise BadFile(f"{where}: is not TOML: {one_line(problem)}") from None


def _known(content: Any, allowed: Mapping[str, Any] | tuple[str, ...], where: str) -> dict:
    if not isinstance(content, dict):
        raise BadFile(f"{where}: is {quoted(content)}; expected {', '.join(allowed)}")
    for name in content:
        if name not in allowed:
            raise BadFile(
                f"{where}: unknown {quoted(name)}; allowed: {', '.join(allowed)}"
                f"{did_you_mean(name, allowed)}"
            )
    return content


def _name(fields: Mapping[str, Any], path: str | os.PathLike) -> str:
    name = fields.get("name", Path(path).stem)
    if not is_name(name):
        raise BadFile(f"{path}: name is {quoted(name)}; expected a word")
    return name


def _number(value: Any, where: str, low: float, high: float) -> float:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not number or not low <= value <= high:
        raise BadFile(f"{where} is {quoted(value)}; expected a number from {low:g} to {high:g}")
    return float(value)


def _array(value: Any, shape: tuple[int, ...], where: str, most: float) -> np.ndarray:
    try:
        found = np.array(value, np.float64)
    except (TypeError, ValueError):
        found = np.empty(0)
    if found.shape != shape or not (np.abs(found) <= most).all():
        raise BadFile(
            f"{where} is {quoted(value)}; expected {' x '.join(map(str, shape))} numbers, at most "
            f"{most:g}"
        )
    return found
