"""Runs a session beside the page: it asks before each action and waits for the answer."""

import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Executor, ThreadPoolExecutor, wait
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jshape.data.simulate import bed_of_depth
from jshape.data.view import image_of_depth
from jshape.errors import JShapeError, one_line
from jshape.models.bank import Bank
from jshape.planning.maps import bank_for
from jshape.planning.options import StopCriteria
from jshape.planning.plan import Plan
from jshape.robot.arms.base import ArmError, stop_arm
from jshape.robot.arms.simulated import SimulatedArm
from jshape.robot.cameras.simulated import simulated_camera
from jshape.robot.loop import HEAD
from jshape.robot.procedure_file import load_hand
from jshape.robot.robot import Robot
from jshape.robot.session import Session
from jshape.robot.simulated import SimulatedWorld
from jshape.viz.pictures import molding_pictures


class State(StrEnum):
    """Where a run is."""

    ACTING = "looking or acting"
    ASKING = "waiting for your answer"
    FINISHED = "finished"
    FAILED = "stopped by an error"


def simulated_robot(
    depth: np.ndarray, bank: Bank, material: str, seed: int = 0, stock_cm3: float = 0.0
) -> Robot:
    """A simulated arm over the bed of a depth image (H, W), with the bank's camera above it.

    A stock of loose material lies beside the bed.
    """
    for_world, for_eye = jax.random.split(jax.random.key(seed))
    camera = replace(bank.camera, pose=None)  # the simulated bed's frame is its own
    bed = bed_of_depth(depth, camera)
    world = SimulatedWorld(for_world, bed, material=material, camera=camera, stock_cm3=stock_cm3)
    eye = simulated_camera(world, for_eye)
    return Robot(eye, SimulatedArm(world), load_hand(None), bank.camera)


def over_simulated(bank: Bank, plan: Plan | None) -> tuple[Bank, Plan | None]:
    """The bank and the plan over a simulated bed, which lies around the middle of a map."""
    camera = bank.camera
    if not camera.orthographic:
        return bank, plan
    camera = replace(camera, u0=(camera.width - 1) / 2, v0=(camera.height - 1) / 2)
    return bank_for(bank, camera), None if plan is None else replace(plan, camera=camera)


def seen(robot: Robot) -> np.ndarray:
    """(H, W) image I of a look."""
    return image_of_depth(robot.look(), robot.camera, where=robot.depth_camera.name).image


class RunController:
    """One run, in the thread that is the robot's own."""

    def __init__(
        self,
        robot: Robot,
        bank: Bank,
        goal: np.ndarray,
        folder: Path,
        *,
        meta: dict[str, Any],
        plan: Plan | None = None,
        search: Mapping[str, Any] | None = None,
        ask_first: bool = False,
        on_look: Callable[[np.ndarray], None] = lambda image: None,
        thread: Executor | None = None,
    ):
        """Start it.

        Args:
          robot: looks and acts; stopped, but not closed at the end.
          bank: predicts.
          goal: (H, W) the image wanted.
          folder: of the run; must be new.
          meta: of the run: bank, arm.
          plan: gone through action by action; None: made anew after each look.
          search: keywords of `mold` where plans are made anew.
          ask_first: ask before the arm goes home, too.
          on_look: called in the run's thread with each image I that was seen.
          thread: the robot's own, of one worker; None: a new one.
        """
        self.folder = folder
        self.state = State.ACTING
        self.question = ""
        """What it asks while it does."""
        self.number = 0
        """Of the question: an answer to an earlier one is none."""
        self.ahead: Plan | None = None
        """What is left of the plan while it asks, the next action first."""
        self.lines: list[str] = []
        """What a run says on the command line."""
        self.why = ""
        """How it ended."""
        self._robot, self._bank, self._plan = robot, bank, plan
        self._arm = robot.guard
        self._arm.allow()
        self._search = dict(search or {})
        if plan is not None:
            self._search = {"stop": StopCriteria(max_steps=max(len(plan), 1)), "afresh": True}
        self._ask_first = ask_first
        self._answers = threading.Condition()
        self._answer: bool | None = None
        self._stopped = False
        self._on_look = on_look
        self._session = Session.start(folder, goal, meta, say=self.lines.append)
        self._session.seen = self._look
        self.lines.append(HEAD)
        self._done = (thread or ThreadPoolExecutor(1, "molding")).submit(self._run)

    @property
    def running(self) -> bool:
        """Whether it still goes on."""
        return not self._done.done()

    def answer(self, act: bool, number: int | None = None) -> None:
        """Do the next action, or end the run; nothing, unless it asks question `number`."""
        with self._answers:
            if self.state is State.ASKING and number in (None, self.number):
                self._answer = act
                self._answers.notify_all()

    def stop(self) -> None:
        """Stop the arm at once, and end the run.

        From any thread, at any time, as often as one likes.  Returns within milliseconds, whatever
        the arm does; `trouble` says later what went wrong.
        """
        self._arm.interrupt()
        with self._answers:
            self._stopped = True
            self._answers.notify_all()

    @property
    def trouble(self) -> str | None:
        """What went wrong with stopping the arm, in one line; None: nothing so far."""
        return self._arm.trouble

    def wait(self, seconds: float | None = None) -> None:
        """Until it ends."""
        wait([self._done], seconds)

    def _ask(self, question: str, ahead: Plan | None) -> bool:
        """What a person answers; an ArmError if the run was stopped."""
        with self._answers:
            self._answer, self.question, self.ahead = None, question, ahead
            self.number += 1
            self.state = State.ASKING
            while self._answer is None and not self._stopped:
                self._answers.wait()
            self.question, self.ahead, self.state = "", None, State.ACTING
            if self._stopped:
                raise ArmError(f"{self._arm.name}: stopped by a person")
            return bool(self._answer)

    def _ask_about(self, ahead: Plan) -> bool:
        d, doing = ahead.distances_mm, ahead[0].words(ahead.camera)
        return self._ask(f"{doing}: {d[0]:.3f} -> {d[1]:.3f} mm from the goal. Act?", ahead)

    def _look(self, depth: np.ndarray) -> None:
        camera = self._bank.camera
        self._on_look(image_of_depth(depth, camera, max_missing=1.0, where="look").image)

    def _run(self) -> None:
        try:
            home = "the arm goes home, out of the camera's view, and looks. Go?"
            if self._ask_first and not self._ask(home, None):
                self.why, self.state = "the arm was not to move", State.FINISHED
                return
            draw, how = molding_pictures(self._bank.rois), self._search
            summary = self._session.mold(
                self._robot, self._bank, plan=self._plan, confirm=self._ask_about, draw=draw, **how
            )
        except Exception as problem:  # nobody else would hear of it
            why = one_line(problem, 1000)
            if not isinstance(problem, JShapeError):
                why = f"{type(problem).__name__}: {why}"
            broken = stop_arm(self._arm)
            self.why, self.state = why if broken is None else f"{why}; {broken}", State.FAILED
        else:
            self.why, self.state = summary["why"], State.FINISHED
