"""A camera and an arm of somebody's own: a row each, and the command line opens them."""

import json
import re
import subprocess
import sys

import numpy as np
import pytest

from jshape.camera import PAPER_BOX
from jshape.cli.main import main
from jshape.errors import JShapeError
from jshape.robot.arms.base import ArmSettings, OpenedArm
from jshape.robot.arms.dry_run import DryRun
from jshape.robot.arms.names import ARMS, open_arm
from jshape.robot.cameras.names import CAMERAS, open_camera
from jshape.robot.registry import DeviceKind, seed_of
from tests.conftest import ROOT

HOST = "192.168.0.1:30002"


class ToyCamera:
    """No more than the protocol asks for."""

    def __init__(self, address):
        self.name, self.camera, self.depth_unit = f"toy at {address}", PAPER_BOX, 1e-4
        self.closed = 0
        self._rng = np.random.default_rng(0)

    def frame(self):
        return self._rng.integers(4495, 4505, PAPER_BOX.shape, dtype=np.uint16)

    def close(self):
        self.closed += 1


@pytest.fixture
def toys(monkeypatch):
    """The devices that were opened."""
    opened = []

    def camera(address, settings):
        opened.append(ToyCamera(address))
        return opened[-1]

    def arm(address, settings):
        if address == "off":
            raise JShapeError("toy at off: no answer")
        opened.append(DryRun(settings.say))
        opened[-1].name = f"toy at {address}"
        return OpenedArm(opened[-1])

    monkeypatch.setitem(CAMERAS, "toy", DeviceKind(camera, "a toy", ":HOST:PORT"))
    monkeypatch.setitem(ARMS, "toy", DeviceKind(arm, "a toy", ":HOST:PORT"))
    return opened


def test_a_camera_opens_at_its_raw_address(toys, capsys):
    assert open_camera(f"toy:{HOST}", window=(0, 0, 9, 9)).name == f"toy at {HOST}"
    assert main(["setup", f"toy:{HOST}", "--frames", "3", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["camera"] == f"toy at {HOST}"
    assert toys[-1].closed == 1


def test_an_arm_opens_at_its_raw_address(toys, tmp_path, capsys):
    assert open_arm(f"toy:{HOST}", ArmSettings(PAPER_BOX)).arm.name == f"toy at {HOST}"
    goal = tmp_path / "goal.npy"
    np.save(goal, np.full(PAPER_BOX.shape, 0.45, np.float32))
    command = ["mold", str(goal), "--out", str(tmp_path / "run"), "--yes"]
    for arm, said in (("toy:off", "toy at off: no answer"), (f"toy:{HOST}", f"toy:{HOST} brings")):
        assert main([*command, "--arm", arm]) == 2
        assert said in capsys.readouterr().err.splitlines()[-1]


ROWS = """
from jshape.cli.completion import script_of
from jshape.cli.main import main
from jshape.robot.arms.names import ARMS
from jshape.robot.cameras.names import CAMERAS
from jshape.robot.registry import DeviceKind

for table in (ARMS, CAMERAS):
    table["toy"] = DeviceKind(lambda address, settings: None, "a toy", ":HOST:PORT")
main(["mold", "--help"])
script = script_of("fish")
for table in (ARMS, CAMERAS):
    assert f"-a '{' '.join(table)}'" in script
"""


@pytest.mark.full
def test_help_and_completion_name_every_row():
    """A row that is there before a command's file is read, in a process of its own."""
    done = subprocess.run([sys.executable, "-c", ROWS], capture_output=True, text=True, cwd=ROOT)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.count("toy:HOST:PORT") == 2


def test_a_wrong_name_or_address_is_refused(toys):
    for text, said in (
        ("dry:3", "dry takes no address"),
        ("toy", "toy: needs an address: toy:HOST:PORT"),
        ("toi:3", r"not an arm; allowed: dry, sim\[:SEED\], .*did you mean toy"),
        ("sim:-1", "sim:-1: a seed is a whole number"),
    ):
        with pytest.raises(JShapeError, match=said):
            open_arm(text, ArmSettings(PAPER_BOX))
    assert seed_of("") == 0 and seed_of("4294967295") == 2**32 - 1


def test_contributing_names_tables_that_are_there():
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    named = re.findall(r"`([A-Z]+)` in `(jshape/[\w/]+\.py)`", text)
    assert {table for table, _ in named} == {
        *("FITTERS", "KINDS", "PLANNERS", "CAMERAS", "ARMS", "MATERIALS")
    }
    for table, file in named:
        assert re.search(rf"^{table}\b.* = ", (ROOT / file).read_text(encoding="utf-8"), re.M), file
    for folder in re.findall(r"`(jshape/[\w/]+)/NAME\.py`", text):
        assert (ROOT / folder).is_dir(), folder
