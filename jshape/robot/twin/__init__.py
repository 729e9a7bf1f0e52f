"""A physics twin of the paper's robot in MuJoCo: an arm, a hand, a box of soft material, a camera.

`engine` imports MuJoCo and mink where they are needed, `iiwa` and `fingers` are the arm and the
hand as numbers, `model` the scene, `world` its state, `press` how the bed gives way, `ik` the
inverse kinematics, `picture` what a bystander sees.  The arm is `jshape.robot.arms.mujoco`, its
camera `jshape.robot.cameras.mujoco`; `make_twin` gives both.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jshape.robot.twin.model import Obstacle
    from jshape.robot.twin.start import Ready, make_twin

__all__ = ["Obstacle", "Ready", "make_twin"]


def __getattr__(name: str) -> Any:
    # The arm imports this package: what needs the arm can only be imported when asked for.
    if name in __all__:
        from jshape.robot.twin import start

        return getattr(start, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
