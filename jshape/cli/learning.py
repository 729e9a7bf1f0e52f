"""The options of a training that `jshape train` and `jshape evaluate` share."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from jshape.cli.options import Common, Count, Positive, PositiveCount, Seed, Share
from jshape.learn.fit import FITTERS
from jshape.learn.settings import Training

if TYPE_CHECKING:
    Kind = str
else:
    Kind = Literal[tuple(FITTERS)] | str


@dataclass(frozen=True, kw_only=True)
class Trains(Common, Training):
    """The fields of `learn.settings.Training`, as the command line reads them."""

    epochs: PositiveCount = Training.epochs
    batch: PositiveCount = Training.batch
    learning_rate: Positive = Training.learning_rate
    validation: Share = Training.validation
    patience: Count = Training.patience
    seed: Seed = Training.seed
    save_every: PositiveCount = Training.save_every
    width: PositiveCount = Training.width
    morphology: Literal["erode", "dilate"] = "erode"
