"""What every arm must obey, whoever built it: a new row of `KINDS` inherits these."""

import importlib.util

import numpy as np
import pytest

from jshape.camera import PAPER_BOX
from jshape.robot.arms.base import Arm, ArmError, Doing, Moved
from jshape.robot.arms.names import KINDS, open_arm
from jshape.robot.procedure import NAMES, perform, pose_of
from jshape.store.procedures import load_hand

NEEDS = {"mujoco": ("mujoco", "mink")}


@pytest.fixture(params=KINDS)
def opened(request):
    for package in NEEDS.get(request.param, ()):
        if importlib.util.find_spec(package) is None:
            pytest.skip(f"{package} is not installed")
    opened = open_arm(f"{request.param}:3", PAPER_BOX, say=lambda line: None)
    yield opened
    opened.arm.stop()
    opened.arm.close()
    if opened.eye is not None:
        opened.eye.close()


def _surface(opened):
    """A point of the bed near its middle, in the camera's frame."""
    if opened.eye is None:
        return np.array([0.02, -0.01, 0.45])
    camera, counts = opened.eye.camera, opened.eye.frame()
    x, y = 0.02, -0.01
    u, v = (round(float(c)) for c in (x / 0.45 * camera.fx + camera.u0,
                                      y / 0.45 * camera.fy + camera.v0))  # fmt: skip
    around = counts[v - 3 : v + 4, u - 3 : u + 4]
    return np.array([x, y, float(np.median(around[around > 0])) * opened.eye.depth_unit])


def _base(opened):
    return np.eye(4) if opened.base_camera is None else opened.base_camera


def test_an_arm_goes_where_it_is_told_and_says_so(opened):
    arm, hand, point = opened.arm, load_hand(), _surface(opened)
    assert isinstance(arm, Arm) and arm.name
    procedure = hand.procedures["poke"]
    tool = np.eye(4)
    tool[:3, 3] = np.array(procedure.tool_mm) / 1000
    pose = _base(opened) @ pose_of(procedure.operations[0], point)
    arm.begin(Doing("poke", "above", 1.0, 0.0), tool)
    moved = arm.move(pose, speed=0.25, threshold=40.0)
    assert isinstance(moved, Moved) and not moved.contact
    for reached in (moved.pose, arm.pose()):
        assert 1000 * np.linalg.norm(reached[:3, 3] - pose[:3, 3]) < 2.0
        assert np.degrees(np.arccos(np.clip(reached[2, :3] @ pose[2, :3], -1, 1))) < 1.0
    assert np.isfinite(arm.effort()) and arm.effort() >= 0


def test_an_action_is_six_operations_and_ends_at_home(opened):
    arm, done = opened.arm, []
    perform(arm, load_hand(), "poke", _surface(opened), _base(opened), told=done.append)
    assert [one.operation for one in done] == list(NAMES)
    assert all(one.effort_nm >= 0 for one in done)
    camera_base = np.linalg.inv(_base(opened))
    above, act = (np.array(done[NAMES.index(name)].tool_mm) for name in ("above", "act"))
    assert act[2] > above[2] + 100  # into the bed
    arm.stop()
    arm.stop()  # as often as one likes
    assert np.isfinite(camera_base @ arm.pose()).all()


def test_an_action_that_is_none_is_refused(opened):
    with pytest.raises(ArmError, match="cannot stroke"):
        perform(opened.arm, load_hand(), "stroke", _surface(opened), _base(opened))
