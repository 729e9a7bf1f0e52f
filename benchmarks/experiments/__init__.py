"""Whole runs that show something: each makes its data, figures and report."""

from typing import NamedTuple

from jshape.errors import JShapeError


class LeftOut(JShapeError):
    """An experiment needs what this machine does not have; a report says so and goes on."""


class Experiment(NamedTuple):
    """One that ends in a page (`pages`): the module of its name has `run(out, Asked(...))`."""

    what: str
    """One line of help."""
    data: bool = False
    """Takes a data set."""
    options: tuple[str, ...] = ()
    """What else may be asked for: fields of `samples.Asked`."""
    own_command: bool = False
    """Its command has options of its own."""
    module: str = ""
    """Of another name."""


_STUDY = ("actions", "pairs", "partitions", "width", "epochs")

EXPERIMENTS = {
    "metric": Experiment("the distance d beside Chamfer, ICP and the earth mover"),
    "viewpoint": Experiment("d with and without R from other viewpoints"),
    "prediction": Experiment(
        "errors of prediction with the same agent and across agents", True, ("kinds", *_STUDY)
    ),
    "datasize": Experiment(
        "errors of prediction against the size of the training set",
        True,
        ("kinds", "sizes", *_STUDY),
    ),
    "refinement": Experiment("networks with and without refinement", True, _STUDY),
    "ablation": Experiment("what each component of f_P brings", True, _STUDY[:3]),
    "shaping": Experiment(
        "the paper's six shaping problems, planned and carried out, with the search tree"
    ),
    "generalization": Experiment(
        "five actions, sand, uneven beds, overlapping and deeper actions, with f_D and f_P"
    ),
    "planning": Experiment(
        "planners on goals that another hand or no action made",
        own_command=True,
        module="planning_report",
    ),
    "robot": Experiment(
        "the paper's six robot problems, looking after each action", own_command=True
    ),
    "twin": Experiment(
        "every action at every place in the physics twin: collisions, place errors",
        own_command=True,
    ),
}
"""By name, in the order of the report: a new one is a module and a row here."""
