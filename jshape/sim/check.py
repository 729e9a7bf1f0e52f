"""Refuse numbers that would make nonsense, as long as they are known: traced ones pass."""

from typing import Any

import jax
import numpy as np

from jshape.errors import JShapeError, quoted


def known(value: Any) -> np.ndarray | None:
    """The value as float64, or None if it is traced.

    Raises:
      TypeError, ValueError: it is no number.
    """
    try:
        return np.asarray(value, float)
    except (jax.errors.TracerArrayConversionError, jax.errors.ConcretizationTypeError):
        return None


def number(
    what: str, value: Any, *, above: float | None = None, at_least: float | None = None
) -> None:
    """Refuse what is not one finite number, or not above (not at least) a limit.

    Raises:
      JShapeError: says what came.
    """
    if above is not None:
        rule = f"one finite number above {above:g}"
    elif at_least is not None:
        rule = f"one finite number, at least {at_least:g}"
    else:
        rule = "one finite number"
    try:
        got = known(value)
    except (TypeError, ValueError):
        raise JShapeError(f"{what} is {brief(value)}; it must be {rule}") from None
    if got is None:
        return
    good = got.shape == () and bool(np.isfinite(got))
    good = good and (above is None or got > above) and (at_least is None or got >= at_least)
    if not good:
        raise JShapeError(f"{what} is {brief(value)}; it must be {rule}")


def brief(value: Any) -> str:
    """A value on one short line, for a message."""
    shape = getattr(value, "shape", ())
    if shape != ():
        return f"an array of shape {shape}"
    return quoted(value.item() if hasattr(value, "item") else value, 60)
