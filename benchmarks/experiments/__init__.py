"""Whole runs that show something: each makes its data, figures and report."""

from typing import NamedTuple

from jshape.errors import JShapeError


class LeftOut(JShapeError):
    """An experiment needs what this machine does not have; a report says so and goes on."""


class Experiment(NamedTuple):
    """One that ends in a page (`pages`): its module has `run(out, quick=, seed=, ...)`."""

    module: str
    """Where it is; loaded when it is run."""
    what: str
    """One line of help."""
    data: bool = False
    """Takes a data set."""
    options: tuple[str, ...] = ()
    """What else may be asked for: names of the keywords of `run`."""
    own_command: bool = False
    """Its command has options of its own."""


_STUDY = ("actions", "pairs", "partitions", "width", "epochs")

EXPERIMENTS = {
    "metric": Experiment(
        "benchmarks.experiments.metric", "the distance d beside Chamfer, ICP and the earth mover"
    ),
    "viewpoint": Experiment(
        "benchmarks.experiments.viewpoint", "d with and without R from other viewpoints"
    ),
    "prediction": Experiment(
        "benchmarks.experiments.prediction",
        "errors of prediction with the same agent and across agents",
        True,
        ("kinds", *_STUDY),
    ),
    "datasize": Experiment(
        "benchmarks.experiments.datasize",
        "errors of prediction against the size of the training set",
        True,
        ("kinds", "sizes", *_STUDY),
    ),
    "refinement": Experiment(
        "benchmarks.experiments.refinement", "networks with and without refinement", True, _STUDY
    ),
    "ablation": Experiment(
        "benchmarks.experiments.ablation",
        "what each component of f_P brings",
        True,
        ("actions", "pairs", "partitions"),
    ),
    "shaping": Experiment(
        "benchmarks.experiments.shaping",
        "the paper's six shaping problems, planned and carried out, with the search tree",
    ),
    "generalization": Experiment(
        "benchmarks.experiments.generalization",
        "five actions, sand, uneven beds, overlapping and deeper actions, with f_D and f_P",
    ),
    "planning": Experiment(
        "benchmarks.experiments.planning_report",
        "planners on goals that another hand or no action made",
        own_command=True,
    ),
    "robot": Experiment(
        "benchmarks.experiments.robot",
        "the paper's six robot problems, looking after each action",
        own_command=True,
    ),
    "twin": Experiment(
        "benchmarks.experiments.twin",
        "every action at every place in the physics twin: collisions, place errors",
        own_command=True,
    ),
}
"""By name, in the order of the report: a new one is a module and a row here."""
