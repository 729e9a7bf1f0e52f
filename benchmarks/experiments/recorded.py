"""Recorded sequences as problems: first and last frame, and what was applied between them."""

from pathlib import Path

import numpy as np

from benchmarks.experiments.problems import Applied, Problem
from jshape.data.view import image_of_depth
from jshape.errors import BadDataset
from jshape.io.cameras import read_camera
from jshape.io.files import read_json
from jshape.io.images import read_depth


def mpm_problems(data: Path, *, noisy: bool = False) -> list[Problem]:
    """The recorded sequences of an independent simulation: from the first frame to the last.

    There is no bed to act in; what was applied is known.

    Args:
      data: folder that holds `seqs/` and `seqs_noisy/`.
      noisy: the frames as a noisy camera sees them.

    Raises:
      BadDataset: no sequence is there.
      BadFile, BadImage, BadCamera: a file is not what it should be.
    """
    pattern = f"seqs{'_noisy' * noisy}/*/sequence.json"
    folders = [path.parent for path in sorted(data.glob(pattern))]
    if not folders:
        raise BadDataset(f"{data}: holds no {pattern}")
    return [_problem(folder) for folder in folders]


def _problem(folder: Path) -> Problem:
    """One recorded sequence."""
    sequence = read_json(folder / "sequence.json")
    camera, unit = read_camera(folder / "camera.json")
    applied = tuple(
        Applied(done["action"], tuple(done["position"]), 1.0, 0.0) for done in sequence["applied"]
    )
    start, goal = (
        image_of_depth(read_depth(folder / f"{k}.png", depth_unit=unit), camera).image
        for k in (0, len(applied))
    )
    return Problem(
        folder.name, "applied", None, start, goal, applied, camera, sequence["material"],
        sequence["agent"], np.array(sequence["positions"], np.int32),
    )  # fmt: skip
