"""What the tab works with besides the desk: the robot, the run, where files go."""

from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

from jshape.app.molder import Molder
from jshape.app.page import Guard
from jshape.robot.robot import Robot

LAST = 30.0
"""Seconds that a run is given to end."""


@dataclass
class Bench:
    """The same for every browser."""

    robot: Robot | None
    """That the command line named; None: only the simulation."""
    arm: str
    """Its name."""
    out: Path
    """Folder for what is saved and for runs."""
    camera: str | None = None
    """The camera.json of files that are loaded."""
    reproject: bool = False
    """Look at files of other cameras as the bank's would."""
    molder: Molder | None = None
    """The run that goes on, or the last one."""
    guard: Guard = field(default_factory=Guard)
    hands: Executor = field(default_factory=lambda: ThreadPoolExecutor(1, "robot"))
    """The one thread that looks and moves: cameras and renderers belong to the thread that opened
    them."""

    def stop(self) -> str:
        """Stop the arm at once, from any thread, if a run goes on; what came of it, in words."""
        molder = self.molder
        if molder is None or not molder.running:
            return "nothing is carried out"
        molder.stop()
        return molder.trouble or "the arm was told to stop"

    def end(self) -> None:
        """End a run before the program does: the arm is stopped, and the run says so."""
        if self.molder is not None and self.molder.running:
            self.molder.stop()
            self.molder.wait(LAST)
        self.hands.shutdown(wait=False)

    def next_run(self) -> Path:
        """A folder that is not there yet."""
        number = 1
        while (self.out / f"run-{number:03d}").exists():
            number += 1
        return self.out / f"run-{number:03d}"
