"""Devices by name: one kind of table for arms and cameras.

A person writes `NAME` or `NAME:ADDRESS`.  The table's row for NAME opens the device and is given
the raw address, whatever that is: a seed, a serial number, `192.168.0.1:30002`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from jshape.errors import JShapeError, did_you_mean, one_line, quoted

Settings = TypeVar("Settings")
Device = TypeVar("Device")


@dataclass(frozen=True)
class DeviceKind(Generic[Settings, Device]):
    """One kind of device."""

    open: Callable[[str, Settings], Device]
    """Opens it, given the raw address ("" without one) and what all devices of the table get."""
    help: str
    """What it is, in a few words."""
    address: str = ""
    """How an address is written behind the name, as `[:SEED]` or `:HOST:PORT`; "" for none."""


def usage(rows: Mapping[str, DeviceKind]) -> list[str]:
    """How each device of a table is named: `["dry", "sim[:SEED]"]`."""
    return [f"{name}{row.address}" for name, row in rows.items()]


def described(rows: Mapping[str, DeviceKind]) -> str:
    """The same with what each of them is, for the help of an option."""
    return ", ".join(f"{name}{row.address} ({row.help})" for name, row in rows.items())


def open_device(
    text: str, rows: Mapping[str, DeviceKind[Settings, Device]], settings: Settings, what: str
) -> Device:
    """The device of a table that `NAME` or `NAME:ADDRESS` names; `what` is `an arm`, for errors.

    Raises:
      JShapeError: no such name, an address too many or too few, or as the device itself says.
    """
    name, _, address = text.partition(":")
    if name not in rows:
        raise JShapeError(
            f"{quoted(text)} is not {what}; allowed: {', '.join(usage(rows))}"
            f"{did_you_mean(name, rows)}"
        )
    row: DeviceKind[Settings, Any] = rows[name]
    if address and not row.address:
        raise JShapeError(f"{one_line(text, 80)}: {name} takes no address")
    if not address and row.address and not row.address.startswith("["):
        raise JShapeError(f"{one_line(text, 80)}: needs an address: {name}{row.address}")
    return row.open(address, settings)


def seed_of(address: str, name: str = "sim") -> int:
    """The seed that an address gives; 0 for "".

    Raises:
      JShapeError: it is no seed.
    """
    number = address or "0"
    if not (number.isascii() and number.isdecimal()) or len(number) > 10 or int(number) >= 2**32:
        raise JShapeError(
            f"{name}:{one_line(address, 80)}: a seed is a whole number from 0 to {2**32 - 1}, as "
            f"in {name}:7"
        )
    return int(number)
