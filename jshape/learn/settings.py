"""How predictors are trained: numbers with the paper's as defaults, where it prints them."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from jshape.errors import JShapeError, quoted

MORPHOLOGIES = ("erode", "dilate")
FREE = ("epochs", "patience", "save_every")
"""Settings that may differ when training is resumed: they change no step."""


@dataclass(frozen=True)
class Training:
    """How predictors are trained.  `fit(pairs, kind, **options)` takes these names."""

    epochs: int = 500
    """Most passes over the training pairs; the paper's number."""
    batch: int = 8
    """Pairs per step, at most."""
    learning_rate: float = 2e-4
    """Learning rate of Adam, the paper's; beta1 0.5, beta2 0.999 and epsilon 1e-8 are fixed."""
    validation: float = 0.2
    """Share of the pairs, at least one, that is kept out to choose the best parameters by; 0 keeps
    none out and chooses by the training loss."""
    patience: int = 50
    """Number of epochs without a better loss after which training stops; 0: never."""
    seed: int = 0
    """Random seed of the first parameters, the validation split and the order of the pairs."""
    save_every: int = 10
    """Number of epochs between two checkpoints, where checkpoints are kept."""
    width: int = 32
    """Features of the U-Net's first block; the paper's 32 goes up to 512."""
    morphology: str = "erode"
    """Morphology of the mask after Otsu: "erode" (the paper) or "dilate" (its authors' code)."""


def settings_from(options: dict[str, Any]) -> Training:
    """Training settings from options by name, checked.

    Raises:
      JShapeError: an unknown option, or a value out of its range.
    """
    values = asdict(Training())
    for name in options:
        if name not in values:
            raise JShapeError(
                f"unknown option {quoted(name)} of training; allowed: {', '.join(values)}"
            )
    values |= options
    for least, names in (
        (1, ("epochs", "batch", "save_every", "width")),
        (0, ("patience", "seed")),
    ):
        for name in names:
            values[name] = _whole(name, values[name], least)
    values["seed"] = _whole("seed", values["seed"], 0, 2**32 - 1)
    for name, most in (("learning_rate", 1.0), ("validation", 0.9)):
        values[name] = _number(name, values[name], most)
    if values["learning_rate"] == 0:
        raise JShapeError("learning_rate is 0; expected more")
    if values["morphology"] not in MORPHOLOGIES:
        allowed = ", ".join(MORPHOLOGIES)
        raise JShapeError(f"morphology is {quoted(values['morphology'])}; allowed: {allowed}")
    return Training(**values)


def _whole(name: str, value: Any, least: int, most: int = 2**31 - 1) -> int:
    if not isinstance(value, int | np.integer) or isinstance(value, bool):
        raise JShapeError(f"{name} is {quoted(value)}; expected a whole number from {least}")
    if not least <= value <= most:
        raise JShapeError(
            f"{name} is {quoted(value)}; expected a whole number from {least} to {most}"
        )
    return int(value)


def _number(name: str, value: Any, most: float) -> float:
    number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    if not number or not 0 <= value <= most:
        raise JShapeError(f"{name} is {quoted(value)}; expected a number from 0 to {most:g}")
    return float(value)
