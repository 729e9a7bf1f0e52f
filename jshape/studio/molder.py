"""A run beside the page: it asks before each action and waits for the answer."""

import threading
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jshape import metric
from jshape.commands.arguments import STRENGTHS
from jshape.commands.robot import draw
from jshape.data.simulate import bed_of_depth
from jshape.data.view import image_of_depth
from jshape.errors import JShapeError
from jshape.planned import Plan
from jshape.predict.bank import Bank
from jshape.robot.arms.base import stop_arm
from jshape.robot.arms.simulated import SimulatedArm
from jshape.robot.cameras.simulated import simulated_camera
from jshape.robot.loop import HEAD
from jshape.robot.robot import Robot
from jshape.robot.session import Session
from jshape.robot.simulated import SimulatedWorld
from jshape.store.procedures import load_hand

STRIDE = 8
"""Pixels between places where plans are made anew."""
MIN_GAIN_MM = 0.01
"""What an action must gain where plans are made anew: below it noise decides."""


class State(StrEnum):
    """Where a run is."""

    ACTING = "looking or acting"
    ASKING = "waiting for your answer"
    FINISHED = "finished"
    FAILED = "stopped by an error"


def simulated_robot(depth: np.ndarray, bank: Bank, material: str, seed: int = 0) -> Robot:
    """A simulated arm over the bed of a depth image (H, W), with the bank's camera above it."""
    for_world, for_eye = jax.random.split(jax.random.key(seed))
    world = SimulatedWorld(
        for_world, bed_of_depth(depth, bank.camera), material=material, camera=bank.camera
    )
    eye = simulated_camera(world, for_eye)
    return Robot(eye, SimulatedArm(world), load_hand(None), bank.camera)


def seen(robot: Robot) -> np.ndarray:
    """(H, W) image I of a look.

    Raises:
      JShapeError: as for `Robot.look`.
    """
    return image_of_depth(robot.look(), robot.camera, where=robot.eye.name).image


class Molder:
    """One run in a thread of its own."""

    def __init__(
        self,
        robot: Robot,
        bank: Bank,
        goal: np.ndarray,
        folder: Path,
        *,
        meta: dict[str, Any],
        plan: Plan | None = None,
        max_steps: int = 16,
        on_look: Callable[[np.ndarray], None] = lambda image: None,
    ):
        """Start it.

        Args:
          robot: looks and acts; stopped, but not closed at the end.
          bank: predicts.
          goal: (H, W) the image wanted.
          folder: of the run; must be new.
          meta: of the run: bank, arm.
          plan: gone through action by action; None: made anew after each look.
          max_steps: most actions where plans are made anew.
          on_look: called in the run's thread with each image I that was seen.

        Raises:
          BadFile: the folder cannot be written, or holds something.
        """
        self.folder = folder
        self.state = State.ACTING
        self.ahead: Plan | None = None
        """What is left of the plan while it asks, the next action first."""
        self.lines: list[str] = []
        """What a run says on the command line."""
        self.why = ""
        """How it ended."""
        self._robot, self._bank, self._plan = robot, bank, plan
        self._max_steps = max_steps if plan is None else max(len(plan), 1)
        self._answers = threading.Condition()
        self._answer: bool | None = None
        self._stopped = False  # by a person: the next question is answered with no
        self._on_look = on_look
        self._session = Session.start(folder, goal, meta, say=self.lines.append)
        self._session.seen = self._look
        self.lines.append(HEAD)
        self._thread = threading.Thread(target=self._run, name="molding", daemon=True)
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether it still goes on."""
        return self._thread.is_alive()

    def answer(self, act: bool) -> None:
        """Do the next action, or end the run; nothing happens while it does not ask."""
        with self._answers:
            if self.state is State.ASKING:
                self._answer = act
                self._answers.notify_all()

    def stop(self) -> None:
        """Stop the arm at once, and end the run."""
        stop_arm(self._robot.arm)
        with self._answers:
            self._stopped, self._answer = True, False
            self._answers.notify_all()

    def wait(self, seconds: float | None = None) -> None:
        """Until it ends."""
        self._thread.join(seconds)

    def _ask(self, ahead: Plan) -> bool:
        with self._answers:
            self.ahead, self.state = ahead, State.ASKING
            self._answer = False if self._stopped else None
            while self._answer is None:
                self._answers.wait()
            self.ahead, self.state = None, State.ACTING
            return self._answer

    def _look(self, depth: np.ndarray) -> None:
        camera = self._bank.camera
        self._on_look(image_of_depth(depth, camera, max_missing=1.0, where="look").image)

    def _run(self) -> None:
        how: dict[str, Any] = {}
        if self._plan is None:
            per_mm = 1.0 / float(metric.to_mm(1.0, self._bank.camera))
            how = {"stride": STRIDE, "strengths": STRENGTHS, "min_gain": MIN_GAIN_MM * per_mm}
        try:
            summary = self._session.mold(
                self._robot, self._bank, plan=self._plan, max_steps=self._max_steps,
                confirm=self._ask, draw=draw(self._bank.rois), **how,
            )  # fmt: skip
        except Exception as problem:  # a driver may raise anything; nobody else would hear of it
            self.why, self.state = " ".join(str(problem).split()), State.FAILED
            if not isinstance(problem, JShapeError):
                self.why = f"{type(problem).__name__}: {self.why}"
        else:
            self.why, self.state = summary["why"], State.FINISHED
