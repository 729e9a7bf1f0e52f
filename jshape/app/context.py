"""What the panels share besides the editor's state: the robot, the run, where files go."""

from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

from jshape.app.goal_limit import GoalLimit
from jshape.app.run_controller import RunController
from jshape.app.widgets import OneAtATime
from jshape.robot.robot import Robot

END_TIMEOUT = 30.0
"""Seconds that a run is given to end."""


@dataclass
class AppContext:
    """The same for every browser."""

    robot: Robot | None
    """That the command line named; None: only the simulation."""
    arm: str
    """Its name."""
    out: Path
    """Folder for what is saved and for runs."""
    camera: str | None = None
    """The camera.json of files that are loaded."""
    controller: RunController | None = None
    """Of the run that goes on, or the last one."""
    do: OneAtATime = field(default_factory=OneAtATime)
    limit: GoalLimit = field(default_factory=GoalLimit)
    robot_thread: Executor = field(default_factory=lambda: ThreadPoolExecutor(1, "robot"))
    """Looks and moves: cameras and renderers belong to the thread that opened them."""

    @property
    def running(self) -> bool:
        """Whether a run goes on."""
        return self.controller is not None and self.controller.running

    def stop(self) -> str:
        """Stop the arm at once, from any thread, if a run goes on; what came of it, in words."""
        controller = self.controller
        if controller is None or not controller.running:
            return "nothing is carried out"
        controller.stop()
        return controller.trouble or "the arm was told to stop"

    def end(self) -> None:
        """End a run before the program does: the arm is stopped, and the run says so."""
        if self.controller is not None and self.controller.running:
            self.controller.stop()
            self.controller.wait(END_TIMEOUT)
        self.robot_thread.shutdown(wait=False)

    @property
    def saved(self) -> Path:
        """Folder for bed, goal and plan."""
        return self.out / "saved"

    def next_run(self) -> Path:
        """A folder that is not there yet."""
        number = 1
        while (self.out / f"run-{number:03d}").exists():
            number += 1
        return self.out / f"run-{number:03d}"
