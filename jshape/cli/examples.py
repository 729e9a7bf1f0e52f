"""What `--help` of every command ends with: command lines that work, and what they are for."""

GENERAL = (
    ("jshape doctor", "what is installed and works"),
    ("jshape demo", "everything in simulation: pictures and a report in runs/demo"),
    ("jshape plan now.png wanted.png --out my-plan", "your own depth images"),
)
"""Of `jshape --help`."""

_TEXT = """\
jshape demo --out runs/sand --material sand --bank pressed-sand-robot  # in sand
jshape demo --out runs/blind --open-loop --seed 3  # another bed, and no second look
jshape samples try  # now.png, wanted.png, their camera.json, poses.json
jshape plan now.png wanted.png --out my-plan  # plan.json and pictures
jshape plan now.png wanted.ply --stride 8 --error-margin 0.5  # places 8 pixels apart
jshape plan now.png wanted.png --planner refine --stride 4 --seconds 5s  # search 5 s
jshape plan a.npy b.npy --camera-file camera.json  # another camera, from anywhere
jshape plan bed.npz wanted.npz --out my-plan  # on height maps: any camera, any tilt
jshape limit now.png wanted.png --out limit.png  # 16 actions of the bundled hand
jshape limit now.png wanted.png --bank moving-flour-robot --stock-cm3 200  # with a stock
jshape heightmap look.png --out bed.npz  # a tilted camera: its plane is found
jshape heightmap recording --out bed.npz  # the mean of all frames
jshape heightmap left.png right.png --camera-file left.json right.json \
--out bed.npz  # two cameras, each with a pose
jshape heightmap later.png --like bed.npz --out wanted.npz  # on the nodes of bed.npz
jshape goal flat --text J --out my-goal  # a sunk J for a simulated level bed
jshape goal now.png --mask drawn.png --raise-mm 6 --balance --out my-goal  # a drawing
jshape goal now.png --mesh star.stl --size-mm 120 --depth-mm 10 --out my-goal  # a mold
jshape goal now.png --actions 'knock 240,197; press 91,92x1.5' --out my-goal  # actions
jshape mold wanted.png --arm sim:3 --yes --out runs/first  # everything simulated
jshape mold wanted.png --arm dry --camera realsense --out runs/dry  # your camera
jshape mold wanted.npz --arm sim:3 --camera-file left.json --camera-file right.json \
--out runs/two  # two cameras, each with a pose
jshape mold --resume --arm sim:3 --out runs/first  # go on with a run
jshape execute my-plan/plan.json --arm sim:3 --out runs/plan  # asks before each action
jshape execute my-plan --arm dry --camera realsense --out runs/dry  # only says it
jshape view runs/demo  # in the browser, on this computer only
jshape view my-plan --save my-plan.rrd  # for the Rerun viewer
jshape dataset simulate pairs  # 25 pairs of each action
jshape dataset simulate few --pairs 2 --actions knock poke --frames 2  # a quick look
jshape dataset info pairs  # actions, agents, ROIs, missing depth
jshape dataset simulate-recording recording --actions poke --count 2  # two pokes
jshape dataset simulate-recording mixed --actions knock poke --idle 1  # in turn
jshape dataset segment recording cut --action poke --agent human \
--material flour  # one action, again and again
jshape dataset segment recording cut --labels recording/labels.csv --agent human \
--material flour  # a row per action
jshape dataset annotate cut pairs  # look at pairs/contact_sheet.png
jshape dataset annotate cut pairs --skip  # leave out what changed nothing
jshape dataset import frames pairs --action poke --agent human \
--material sand  # NAME_before.png and NAME_after.png
jshape dataset merge all monday tuesday  # of one camera
jshape dataset from-run run pairs  # of what a robot did
jshape dataset from-run run pairs --agent human --material sand  # said of all
jshape train pairs --out my-bank  # kind P, in seconds
jshape train pairs --start pressed-flour-human --out my-bank  # 5 to 25 pairs do
jshape train pairs --kind DCR --epochs 100 --out network  # a network of the paper
jshape evaluate pairs --kinds D P --out scores  # kinds side by side
jshape evaluate pairs --bank my-bank  # a bank on data that it has not seen
jshape evaluate pairs --start pressed-flour-human --few 5 10  # adapted with few
jshape record realsense --out recording  # until Ctrl-C
jshape record realsense:LEFT realsense:RIGHT --camera-file left.json \
--camera-file right.json --out both  # two cameras at once, each with a pose
jshape record sim --frames 3 --out simulated  # without a camera
jshape record field.bag --topic /camera/depth --window 181,46,480x395 \
--out recording  # a part of a ROS bag
jshape setup realsense --out camera.json  # tilt, distance, noise, holes; its file
jshape setup sim:7 --frames 5  # without a camera
jshape setup frame.png --camera-file mine.json --out camera.json  # one depth picture
jshape camera list  # RealSense cameras, and what else opens
jshape calibrate poses.json --out base.json  # a fixed camera, target in the gripper
jshape calibrate poses.json --eye-in-hand --out hand.json  # a camera in the gripper
jshape waypoints my-plan --base base.json --out waypoints.yaml  # in the arm's frame
jshape waypoints my-plan --out waypoints.json  # in the camera's frame
jshape studio now.png wanted.png  # draw, plan and look at the plan
jshape studio --arm sim:3  # act on a simulated bed
jshape doctor  # all of it, in about ten seconds
jshape doctor --json  # for a program
jshape config --init  # an example of jshape.toml, here
jshape config  # what applies
jshape config plan  # every option of a command, and where its value comes from
jshape completion bash > ~/.local/share/bash-completion/completions/jshape  # bash
jshape completion zsh > ~/.zfunc/_jshape  # zsh, with ~/.zfunc in fpath
jshape completion fish > ~/.config/fish/completions/jshape.fish  # fish
"""
EXAMPLES = tuple(tuple(line.split("  # ")) for line in _TEXT.splitlines())
"""Of every command: (line, what it is for)."""


def of(name: str) -> list[tuple[str, str]]:
    """The examples of a command, by its words."""
    return [(line, what) for line, what in EXAMPLES if f"{line} ".startswith(f"jshape {name} ")]


def text(name: str = "") -> str:
    """The examples of a command, or of jshape, behind its help."""
    found = of(name) if name else GENERAL
    lines = [f"  {line}\n      {what}\n" for line, what in found]
    return "".join(["\nexamples:\n", *lines]) if found else ""
