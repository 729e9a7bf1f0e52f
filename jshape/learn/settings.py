"""How predictors are trained: numbers with the paper's as defaults, where it prints them."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from jshape.errors import JShapeError, UnknownName, quoted

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


_RANGES = {
    "learning_rate": (1e-12, 1.0),
    "validation": (0.0, 0.9),
    "patience": (0, 2**31 - 1),
    "seed": (0, 2**32 - 1),
}
"""The least and the greatest of a number; of the others 1 and 2**31 - 1."""


def settings_from(options: dict[str, Any]) -> Training:
    """Training settings from options by name, checked.

    Raises:
      JShapeError: an unknown option, or a value out of its range.
    """
    known, values = {one.name: type(one.default) for one in fields(Training)}, {}
    for name, value in options.items():
        if name not in known:
            raise UnknownName("option of training", name, known)
        kind = known[name]
        if kind is str:
            good, expected = value in MORPHOLOGIES, f"allowed: {', '.join(MORPHOLOGIES)}"
        else:
            low, high = _RANGES.get(name, (1, 2**31 - 1))
            kinds = (int, np.integer) if kind is int else (int, float, np.number)
            good = isinstance(value, kinds) and not isinstance(value, bool) and low <= value <= high
            expected = f"expected a {'whole ' * (kind is int)}number from {low:.10g} to {high:.10g}"
        if not good:
            raise JShapeError(f"{name} is {quoted(value)}; {expected}")
        values[name] = kind(value)
    return Training(**values)
