"""From pairs to a bank."""

from collections.abc import Callable
from functools import partial
from typing import Any

from jax.sharding import Mesh

from jshape.camera import Camera, check_same_camera
from jshape.data.intrinsics import check_straight
from jshape.data.pairs import Examples, Pairs
from jshape.errors import BadBank, BadDataset, UnknownName, quoted
from jshape.learn.imprint import fit_imprint
from jshape.learn.networks import fit_network
from jshape.learn.settings import Training, settings_from
from jshape.learn.training import Hooks, Progress
from jshape.models.bank import Bank
from jshape.models.base import Predictor
from jshape.models.difference import fit_difference
from jshape.models.imprint import Imprint

Fitter = Callable[[Examples, Camera, Training, Predictor | None, Hooks], Predictor]
"""What fits one action's predictor.  Its arguments:

examples: the ROIs of the action's pairs, NaN where there is no reading.
camera: theirs.
settings: of training; what a fitter does not need it ignores.
start: a predictor of the same kind and ROI size to start from, or None.
hooks: to be handed to `training.train`, if the fitter trains.
"""


def _difference(
    examples: Examples, camera: Camera, settings: Training, start: Predictor | None, hooks: Hooks
) -> Predictor:
    """f_D: there is nothing to train, and another bank has nothing to add."""
    return fit_difference(examples.prior, examples.posterior, examples.strengths)


def _pressed(
    examples: Examples, camera: Camera, settings: Training, start: Predictor | None, hooks: Hooks
) -> Predictor:
    """f_P: seconds, so there is nothing to keep; its steps are its own."""
    if start is not None and not isinstance(start, Imprint):
        raise BadBank(f"the predictor to start from is a {type(start).__name__}; expected Imprint")
    return fit_imprint(examples, camera, start, seed=settings.seed)


FITTERS: dict[str, Fitter] = {
    "D": _difference,
    **{kind: partial(fit_network, kind) for kind in ("C", "CR", "DC", "DCR")},
    "P": _pressed,
}
"""Kind of bank -> what fits the predictor of one action.  Another kind is one more entry, and one
in `io.kinds.KINDS` so that it can be saved."""


def fit(
    pairs: Pairs,
    kind: str = "D",
    *,
    start: Bank | None = None,
    report: Callable[[Progress], None] | None = None,
    keep: Callable[[str], Any] | None = None,
    mesh: Mesh | None = None,
    **options: Any,
) -> Bank:
    """A bank of one kind, fitted to pairs, however good it is: `validation.fit` asks that.

    Arguments and errors are those of `validation.fit`.
    """
    if kind not in FITTERS:
        raise UnknownName("kind of bank", kind, FITTERS)
    settings = settings_from(options)
    if len(pairs) == 0:
        raise BadDataset("no pairs to fit a bank to")
    pairs = pairs.of_usual_paths()
    check_straight(pairs.camera, "the data set")
    if start is not None:
        if start.kind != kind:
            raise BadBank(
                f"the bank to start from is of kind {quoted(start.kind)}; expected {quoted(kind)}"
            )
        check_same_camera(start.camera, pairs.camera, "the data set's")
        foreign = [name for name in pairs.actions if name not in start.actions]
        if foreign:
            raise BadBank(
                f"the bank to start from knows {', '.join(start.actions)}, not "
                f"{', '.join(foreign)}; fit those on their own"
            )
    predictors = []
    for name in pairs.actions:
        first = start.predictor(name) if start is not None else None
        hooks = Hooks(name, report, keep(name) if keep is not None else None, mesh)
        try:
            path = float(pairs.of(action=name).path_mm.mean())
            if first is not None and first.path_mm and path:
                first = first.lengthened(path / first.path_mm)
            size = first.roi if first is not None else None
            examples = pairs.rois(name, size, padded=first is not None).without_blind()
            predictors.append(FITTERS[kind](examples, pairs.camera, settings, first, hooks))
        except BadDataset as error:
            raise BadDataset(f"{name}: {error}") from None
    return Bank(pairs.camera, tuple(predictors), pairs.actions, kind)
