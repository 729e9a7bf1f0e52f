"""Mold soft plastic material by looking at it: depth images in, a plan of actions out."""

from jshape.actions import PAPER_ACTIONS, Action, ActionSet, grid
from jshape.camera import D435_BAZAR, D435_NOMINAL, PAPER_BOX, Camera
from jshape.data.pairs import Pairs
from jshape.errors import JShapeError
from jshape.learn.fit import fit
from jshape.metric import distance, r_matrix, ray_lengths, to_mm, unweigh, weigh
from jshape.planners.base import Status
from jshape.planning import Plan, plan, plan_depth, rollout
from jshape.predict.bank import Bank
from jshape.store.banks import list_banks, load_bank, save_bank
from jshape.store.datasets import load_pairs, save_pairs

__version__ = "0.1.0"

__all__ = [
    "D435_BAZAR",
    "D435_NOMINAL",
    "PAPER_ACTIONS",
    "PAPER_BOX",
    "Action",
    "ActionSet",
    "Bank",
    "Camera",
    "JShapeError",
    "Pairs",
    "Plan",
    "Status",
    "distance",
    "fit",
    "grid",
    "list_banks",
    "load_bank",
    "load_pairs",
    "plan",
    "plan_depth",
    "r_matrix",
    "ray_lengths",
    "rollout",
    "save_bank",
    "save_pairs",
    "to_mm",
    "unweigh",
    "weigh",
]
