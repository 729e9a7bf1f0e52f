"""What the tab works with besides the desk: the robot, the run, where files go."""

from dataclasses import dataclass, field
from pathlib import Path

from jshape.robot.robot import Robot
from jshape.studio.molder import Molder
from jshape.studio.page import Guard


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

    def next_run(self) -> Path:
        """A folder that is not there yet."""
        number = 1
        while (self.out / f"run-{number:03d}").exists():
            number += 1
        return self.out / f"run-{number:03d}"
