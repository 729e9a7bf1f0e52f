"""What a hand can do, on disk: a folder with `limits.yaml` and one YAML file per action."""

import os
from pathlib import Path
from typing import Any

from jshape.errors import BadFile, needs, one_line, quoted
from jshape.io.files import read_bytes
from jshape.io.records import read_record
from jshape.robot.procedure import ArmLimits, Hand, Procedure

with needs("robot", "a hand or waypoint file"):
    import yaml

LIMITS = "limits.yaml"
FILE_LIMIT = 2**16
"""Largest file that is read, bytes."""


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
    limits = read_record(ArmLimits, _parsed(folder / LIMITS), str(folder / LIMITS))
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
    return read_record(Procedure, _parsed(Path(path)), str(path))


def _parsed(path: Path) -> Any:
    try:
        return yaml.load(read_bytes(path, limit=FILE_LIMIT).decode(), _Strict)
    except BadFile:
        raise
    except Exception as problem:  # PyYAML promises no type for a damaged file
        raise BadFile(f"{path}: not a YAML file: {one_line(problem)}") from None
