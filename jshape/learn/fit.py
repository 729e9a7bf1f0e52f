"""From pairs to a bank."""

from jshape.data.pairs import Pairs
from jshape.errors import BadDataset, UnknownName
from jshape.predict.bank import Bank
from jshape.predict.difference import fit_difference

FITTERS = {"D": fit_difference}
"""Kind of bank -> what fits one action's predictor to prior and posterior ROIs (N, h, w)."""


def fit(pairs: Pairs, kind: str = "D") -> Bank:
    """A bank of one kind, fitted to pairs: one predictor per action in them.

    Args:
      pairs: of any actions; each action's ROI size is the mean over its pairs.
      kind: "D" is f_D, the mean difference (Eq. DiffImage), which needs no training.

    Raises:
      UnknownName: no such kind.
      BadDataset: no pairs, a ROI outside the image, or pixels that no pair has seen.
    """
    if kind not in FITTERS:
        raise UnknownName("kind of bank", kind, FITTERS)
    if len(pairs) == 0:
        raise BadDataset("no pairs to fit a bank to")
    predictors = []
    for name in pairs.actions:
        try:
            predictors.append(FITTERS[kind](*pairs.rois(name)[:2]))
        except BadDataset as error:
            raise BadDataset(f"{name}: {error}") from None
    return Bank(pairs.camera, tuple(predictors), pairs.actions, kind)
