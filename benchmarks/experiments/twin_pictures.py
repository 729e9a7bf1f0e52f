"""Pictures of the physics twin at work: a strip of the six operations, and a film.

`python -m benchmarks.experiments.twin_pictures FOLDER` writes both.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from benchmarks.experiments.bystander import Bystander, strip
from benchmarks.experiments.twin import ACTIONS, BOX
from jshape import sim
from jshape._typing import Num
from jshape.errors import BadFile
from jshape.io import files
from jshape.robot.arms.mujoco import Ready, make_twin
from jshape.robot.perform import OperationResult, perform
from jshape.robot.procedure import Hand
from jshape.robot.procedure_file import load_hand
from jshape.robot.twin.world import Twin

PLACE = (0.0, -0.02, sim.SURFACE)
"""Of the actions in pictures, camera frame, metres."""
SMALL, LARGE = (300, 300), (480, 480)
"""Of the strip's pictures and of the film's, pixels."""
RATE = 25
"""Pictures per second of a film; time runs as in the physics."""


def operations_strip(
    names: Sequence[str] = ACTIONS, hand: Hand | None = None
) -> Num[np.ndarray, "H W 3"]:
    """A row of six pictures per action: what a bystander sees at the end of each operation.

    Raises:
      NoPicture: MuJoCo cannot draw here.
    """
    hand = load_hand() if hand is None else hand
    pictures, titles = [], []
    for name in names:
        ready = _ready()
        with _bystander(ready, SMALL) as bystander:

            def told(done: OperationResult, see: Bystander = bystander, name: str = name) -> None:
                pictures.append(see.picture())
                titles.append(f"{name}: {done.operation}")

            perform(ready.arm, hand, name, np.array(PLACE), ready.base_camera, on_operation=told)
    return strip(pictures, titles)


def film(path: str | Path, name: str = "grasp", hand: Hand | None = None) -> Path:
    """An action as an MP4 file.

    Raises:
      BadFile: it cannot be written.
      NoPicture: MuJoCo cannot draw here.
    """
    hand, path, ready = load_hand() if hand is None else hand, Path(path), _ready()
    every = round(1 / RATE / ready.arm.twin.model.opt.timestep)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), RATE, LARGE)
    if not writer.isOpened():
        raise BadFile(f"{path}: no film can be written there")
    steps = 0
    with _bystander(ready, LARGE) as bystander:

        def watch(twin: Twin) -> None:
            nonlocal steps
            steps += 1
            if steps % every == 0:
                writer.write(bystander.picture()[..., ::-1])

        ready.arm.watch = watch
        try:
            perform(ready.arm, hand, name, np.array(PLACE), ready.base_camera)
        finally:
            writer.release()
    return path


def write_strip(path: str | Path, names: Sequence[str] = ACTIONS) -> Path:
    """`operations_strip` as a PNG file.

    Raises:
      BadFile: it cannot be written.
    """
    # In steps of 4 the file is a fifth as large, and looks the same.
    picture = operations_strip(names)[..., ::-1] // 4 * 4 + 2
    content = cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 9])[1]
    return files.write_atomic(path, content.tobytes())


def _ready() -> Ready:
    return make_twin(0, sim.flat_bed(size=BOX), noise=0.0)


def _bystander(ready: Ready, size: tuple[int, int]) -> Bystander:
    # From the far side of the box, towards the arm: the palm does not hide the fingers.
    twin = ready.arm.twin
    return Bystander(twin, size=size, azimuth=215.0, elevation=-24.0, distance=0.72, raised=0.16)


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    print(write_strip(folder / "twin_strip.png"), film(folder / "twin_grasp.mp4"))
