"""A physics twin of the paper's robot in MuJoCo: an arm, a hand, a box of soft material, a camera.

The XML files are the robot (`iiwa`, `hand` with `finger` and `skin`) and what stands around
(`scene`); `model` puts the box and the bed into it, `world` is its state, `stroke` how the bed
gives way, `fingers` the hand's postures, `ik` the inverse kinematics, `engine` imports MuJoCo and
mink.
The arm is `jshape.robot.arms.mujoco`, its camera `jshape.robot.cameras.mujoco`.
"""
