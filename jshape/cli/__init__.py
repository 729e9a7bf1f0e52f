"""What each command does: from parsed options to a result that JSON can hold.

Each prints for people and returns its result; with `--json`, `cli.main` prints only that.  What is
wrong with words, files or devices is raised as a JShapeError, whose one line `cli.main` prints.
A command's file is imported when the command is asked for: `jshape --help` must be quick.
"""

COMMANDS = {
    "demo": "simulate a bed and a goal, plan, act in closed loop, write pictures and a report",
    "samples": "make the files that the documentation's commands name: try them without a camera",
    "plan": "which actions mold the bed of INITIAL into DESIRED, where and in which order",
    "limit": "how near to WANTED any plan can bring the bed of NOW, where it cannot, and why",
    "heightmap": "the bed from straight above, as cameras that stand anywhere see it",
    "goal": "make a desired depth image for BED that the material can become",
    "mold": "look, plan, act and look again until the bed is as in DESIRED",
    "execute": "carry a plan out, looking after every action",
    "dataset": "make and inspect data sets",
    "train": "fit a bank to a data set",
    "evaluate": "prediction errors in mm: of a bank, or over random partitions of the data set",
    "record": "record depth frames, for data sets; Ctrl-C ends it and keeps them",
    "setup": "how a depth camera stands over its bed, what to improve; writes the camera's file",
    "camera": "list the depth cameras",
    "calibrate": "where the camera is, from pairs of poses of the gripper and a target (hand-eye)",
    "waypoints": "a plan as poses of the tool, for a controller of your own (ROS, RKCL)",
    "view": "show a plan or a run in 3-D, in the browser or as a Rerun recording",
    "studio": "a local web page: draw the goal, plan, edit the plan, act, annotate boxes",
    "doctor": "what is installed and works: versions, devices, extras, banks, a short self-test",
    "config": "the settings of jshape.toml, and which commands they reach",
    "completion": "the script that lets a shell complete jshape's commands and options",
}
"""Each is a function in the file of its name, and the line that says what it does; a new command is
one file, its line here, and its examples in `examples`."""
