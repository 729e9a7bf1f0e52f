"""A physics twin of the paper's robot in MuJoCo: an arm, a hand, a box of soft material, a camera.

`engine` imports MuJoCo and mink where they are needed, `iiwa` and `fingers` are the arm and the
hand as numbers, `model` the scene, `world` its state, `press` how the bed gives way, `ik` the
inverse kinematics.  The arm is `jshape.robot.arms.mujoco`, its camera
`jshape.robot.cameras.mujoco`; `make_twin` of the first gives both.
"""
