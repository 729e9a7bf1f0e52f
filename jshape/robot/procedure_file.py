"""What a hand can do, on disk: a folder with `limits.yaml` and one YAML file per action."""

import os
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from jshape.errors import BadFile, JShapeError, one_line, quoted
from jshape.io.files import read_bytes
from jshape.robot.procedure import IN_THE_AIR, NAMES, ArmLimits, Hand, Operation, Procedure

try:
    import yaml
except ImportError:
    raise JShapeError("hands and waypoints need PyYAML: pip install 'jshape[robot]'") from None

LIMITS = "limits.yaml"
FILE_LIMIT = 2**16
"""Largest file that is read, bytes."""
REACH_MM = 2000.0
"""No arm's tool is farther than this from anything, mm."""
MOST = {
    "height_mm": REACH_MM,
    "depth_mm": REACH_MM,
    "speed_mm_s": 2000.0,
    "seconds": 60.0,
    "effort_nm": 1000.0,
}
"""Greatest numbers of an operation: beyond them somebody mistook a unit."""


LEAST = {"height_mm": 1.0, "depth_mm": 0.1, "speed_mm_s": 1.0}
"""Least sizes of those: what is smaller and not 0 is metres where mm are meant."""
TOOL_MM, ROOM_MM = 1.0, 20.0
"""The same for the distance of a tool's point from its flange and for the room of the limits."""


class _Strict(yaml.SafeLoader):
    """A safe loader that refuses aliases, and a name that is given twice.

    A few nested aliases stand for more values than any memory holds.
    """

    def compose_node(self, parent: Any, index: Any) -> Any:
        """As the safe loader, unless it is an alias."""
        if self.check_event(yaml.AliasEvent):
            event = self.peek_event()
            raise yaml.constructor.ConstructorError(
                None, None, "aliases (*name) are not read; write the value out", event.start_mark
            )
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> dict:
        """As the safe loader, unless a key is there already."""
        seen = set()
        for key, _ in node.value:
            name = key.tag, str(key.value)
            if isinstance(key, yaml.ScalarNode) and name in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"{quoted(key.value)} is given twice", key.start_mark
                )
            seen.add(name)
        return super().construct_mapping(node, deep)


_METRES = "less than {:g} mm looks like metres: times 1000"


def load_hand(folder: str | os.PathLike | None = None) -> Hand:
    """The procedures of all actions in a folder, and its limits.

    Args:
      folder: with `limits.yaml` and `ACTION.yaml`; None is the hand of the simulated robot.

    Raises:
      BadFile: no such folder, no limits or no action in it, or a file that is not as it should be.
    """
    folder = Path(__file__).parents[1] / "robot" / "hand" if folder is None else Path(folder)
    if not folder.is_dir():
        raise BadFile(f"{folder}: no such folder; a hand is a folder with {LIMITS} and ACTION.yaml")
    if not (folder / LIMITS).is_file():
        raise BadFile(f"{folder}: holds no {LIMITS}, so nothing says what the arm must not exceed")
    limits = _limits(folder / LIMITS)
    other = sorted(
        path.name
        for path in folder.glob("*")
        if path.suffix.lower() in (".yml", ".yaml") and path.suffix != ".yaml"
    )
    if other:
        raise BadFile(f"{folder}: {other[0]} would not be read; name it {Path(other[0]).stem}.yaml")
    found = [read_procedure(path) for path in sorted(folder.glob("*.yaml")) if path.name != LIMITS]
    if not found:
        raise BadFile(f"{folder}: no action in it; expected files like knock.yaml")
    names = [procedure.action for procedure in found]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise BadFile(f"{folder}: two files for the action {one_line(twice[0], 80)}")
    return Hand(dict(zip(names, found, strict=True)), limits)


def read_procedure(path: str | os.PathLike) -> Procedure:
    """One action's six operations.

    Raises:
      BadFile: not YAML, unknown or missing fields, a number that makes no sense, or other
        operations than the six in their order.
    """
    path = Path(path)
    content = _mapping(_parsed(path), ("action", "tool_mm", "operations"), str(path))
    action = content.get("action")
    if not isinstance(action, str) or not action:
        raise BadFile(f"{path}: action is {quoted(action)}; expected a name")
    several = content.get("operations")
    names = [one.get("name") for one in several if isinstance(one, dict)] if (
        isinstance(several, list)
    ) else None  # fmt: skip
    if names != list(NAMES):
        raise BadFile(
            f"{path}: operations are {one_line(names, 120)}; expected {', '.join(NAMES)}, "
            "in this order"
        )
    made = [_operation(one, f"{path}: {one['name']}") for one in several or ()]
    tool = _three(content.get("tool_mm", [0, 0, 0]), f"{path}: tool_mm")
    length = sum(x * x for x in tool) ** 0.5
    if 0 < length < TOOL_MM:
        raise BadFile(f"{path}: tool_mm is {length:g} mm long; {_METRES.format(TOOL_MM)}")
    return Procedure(action, tuple(made), tool)


def _operation(content: dict[str, Any], where: str) -> Operation:
    _mapping(content, [field.name for field in fields(Operation)], where)
    read: dict[str, Any] = {}
    for name, value in content.items():
        if name in ("name", "posture"):
            if not isinstance(value, str):
                raise BadFile(f"{where}: {name} is {quoted(value)}; expected a name")
            read[name] = value
            continue
        read[name] = _number(value, f"{where}: {name}")
        if read[name] <= 0 and name != "height_mm":
            raise BadFile(f"{where}: {name} is {quoted(value)}; expected a number above 0")
    for name, most in MOST.items():
        if abs(read.get(name, 0.0)) > most:
            raise BadFile(f"{where}: {name} is {read[name]:g}; at most {most:g}")
    for name, least in LEAST.items():
        if 0 < abs(read.get(name, 0.0)) < least:
            raise BadFile(f"{where}: {name} is {read[name]:g}; {_METRES.format(least)}")
    if content["name"] == "clear" and len(content) > 1:
        raise BadFile(f"{where}: the arm goes home, there is nothing else to say of it")
    if content["name"] in IN_THE_AIR and not read.get("height_mm", 0.0) > 0:
        raise BadFile(f"{where}: needs a height_mm above 0: the tool touches nothing there")
    if "height_mm" in content and "depth_mm" in content:
        raise BadFile(f"{where}: height_mm and depth_mm are both given; one says where the tool is")
    return Operation(**read)


def _limits(path: Path) -> ArmLimits:
    content = _mapping(_parsed(path), [field.name for field in fields(ArmLimits)], str(path))
    read: dict[str, Any] = {}
    for name, value in content.items():
        several = name in ("low_mm", "high_mm")
        read[name] = (_three if several else _number)(value, f"{path}: {name}")
    made = ArmLimits(**read)
    if not all(low < high for low, high in zip(made.low_mm, made.high_mm, strict=True)):
        raise BadFile(f"{path}: low_mm {made.low_mm} is not below high_mm {made.high_mm}")
    room = max(high - low for low, high in zip(made.low_mm, made.high_mm, strict=True))
    if room < ROOM_MM:
        raise BadFile(
            f"{path}: low_mm to high_mm is {room:g} mm at most; {_METRES.format(ROOM_MM)}"
        )
    if made.speed_mm_s < LEAST["speed_mm_s"]:
        raise BadFile(
            f"{path}: speed_mm_s is {made.speed_mm_s:g}; {_METRES.format(LEAST['speed_mm_s'])}"
        )
    for name in ("speed_mm_s", "effort_nm"):
        if not 0 < getattr(made, name) <= MOST[name]:
            raise BadFile(
                f"{path}: {name} is {getattr(made, name):g}; it must be above 0 and at most "
                f"{MOST[name]:g}"
            )
    return made


def _parsed(path: Path) -> Any:
    try:
        return yaml.load(read_bytes(path, limit=FILE_LIMIT).decode(), _Strict)
    except BadFile:
        raise
    except Exception as problem:  # PyYAML promises no type for a damaged file
        raise BadFile(f"{path}: not a YAML file: {one_line(problem)}") from None


def _mapping(content: Any, allowed: Any, where: str) -> Mapping[str, Any]:
    if not isinstance(content, dict):
        raise BadFile(f"{where}: holds a {type(content).__name__}; expected {', '.join(allowed)}")
    unknown = [str(name) for name in content if name not in allowed]
    if unknown:
        raise BadFile(f"{where}: unknown {quoted(unknown[0])}; allowed: {', '.join(allowed)}")
    return content


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e6:
        raise BadFile(f"{where} is {quoted(value)}; expected a number")
    return float(value)


def _three(value: Any, where: str) -> tuple[float, float, float]:
    if not isinstance(value, list) or len(value) != 3:
        raise BadFile(f"{where} is {quoted(value)}; expected three numbers")
    x, y, z = (_number(one, where) for one in value)
    if max(abs(x), abs(y), abs(z)) > REACH_MM:
        raise BadFile(f"{where} is {quoted(value)}; at most {REACH_MM:g} mm")
    return x, y, z
