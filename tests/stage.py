"""A robot without hardware for tests: a picture for a bed, that every action changes as predicted.

Run as a program it molds, and dies at a chosen event, as a process that was killed:
python -m tests.stage FOLDER EVENT
"""

import os
import sys

import numpy as np

from jshape import PAPER_BOX, metric
from jshape.actions import PAPER_Z
from jshape.io import journal
from jshape.robot.arms.base import Moved
from jshape.robot.procedure_file import load_hand
from jshape.robot.robot import Robot
from jshape.robot.session import Session
from tests.conftest import mm, paper

UNIT = 0.00005
PLACES = np.array([[91, 92], [239, 197], [387, 302]])


class Eye:
    """Sees the picture; each frame differs in one pixel's last bit, as no real one is the same."""

    name, camera, depth_unit = "test camera", PAPER_BOX, UNIT

    def __init__(self, image):
        self.image = image
        self.spoil = lambda counts: counts
        self.frames = self.closed = 0

    def frame(self):
        self.frames += 1
        depth = np.asarray(self.camera.depth(metric.unweigh(self.image, self.camera)))
        counts = np.rint(depth / UNIT).astype(np.uint16)
        counts[0, 0] += self.frames % 2
        return self.spoil(counts)

    def close(self):
        self.closed += 1

    def __enter__(self):
        return self

    def __exit__(self, *problem):
        self.close()


class Arm:
    """Makes the picture what the bank predicts; `fails` is called with each operation's name."""

    name = "test arm"

    def __init__(self, bank, eye, fails=lambda operation: None):
        self.bank, self.eye, self.fails = bank, eye, fails
        self.acted, self.stops, self.homes, self.closed = [], 0, 0, 0
        self.at = np.eye(4)

    def limit(self, *, effort, speed):
        self.limits = effort, speed

    def check(self, poses, postures, tool):
        self.checked = len(poses), list(postures)

    def begin(self, doing, tool):
        self.doing = doing
        self.fails(doing.operation)

    def move(self, pose, *, speed, threshold):
        self.at = pose
        if self.doing.operation == "act":
            camera, (x, y) = self.eye.camera, pose[:2, 3]
            u = round(x / PAPER_Z * camera.fx + camera.u0)
            v = round(y / PAPER_Z * camera.fy + camera.v0)
            w, h = self.bank.roi(self.doing.action)
            window = np.s_[v - h // 2 : v - h // 2 + h, u - w // 2 : u - w // 2 + w]
            roi, place = self.eye.image[window], np.array([u, v])
            self.eye.image[window] = self.bank.predict(self.doing.action, roi, position=place)
            self.acted.append((self.doing.action, u, v))
        return Moved(False, 0.0, pose)

    def posture(self, name, *, seconds, threshold):
        return Moved(False, 0.0, self.at)

    def home(self):
        self.homes += 1
        return Moved(False, 0.0, self.at)

    def pose(self):
        return self.at

    def stop(self):
        self.stops += 1

    def close(self):
        self.closed += 1


def robot_of(bank, image, fails=lambda operation: None):
    """A robot on a picture of its own."""
    eye = Eye(image.copy())
    return Robot(eye, Arm(bank, eye, fails), load_hand(), bank.camera, frames=3)


def mold(session, robot, bank, **options):
    """Mold at the places where the goal was made."""
    own = {
        name: options.pop(name) for name in ("plan", "confirm", "draw", "batch") if name in options
    }
    usual = {"positions": PLACES, "min_gain_mm": mm(2e-5), "tolerance_mm": mm(4e-4), "max_steps": 6}
    return session.mold(robot, bank, **own, **paper(**usual | options))


def main(folder, event):
    """Mold the fixtures' goal, and die before an event is written."""
    from tests import conftest

    bank = conftest.bank.__wrapped__()
    now, goal, _ = conftest.molded.__wrapped__(bank)
    written, count = journal.note, 0

    def dying(path, content):
        nonlocal count
        if count == int(event):
            os._exit(9)
        count += 1
        written(path, content)

    journal.note = dying
    session = Session.start(folder, goal, {"bank": "fixture"}, say=lambda line: None)
    with robot_of(bank, now) as robot:
        mold(session, robot, bank)


if __name__ == "__main__":
    from pathlib import Path

    main(Path(sys.argv[1]), sys.argv[2])
