"""What the documentation's commands take: made when a command names it and it is not there yet."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import jax
import numpy as np

from jshape import (
    D435_BAZAR,
    PAPER_BOX,
    Camera,
    Pairs,
    heightmap,
    metric,
    rollout,
    save_pairs,
    sim,
)
from jshape.cli.main import main
from jshape.data.recording import simulate_recording
from jshape.data.simulate import DEPTH_UNIT, look, simulate_pairs, together
from jshape.height_map import as_frame
from jshape.io.cameras import read_camera, write_camera
from jshape.io.images import write_depth_png
from jshape.io.maps import write_map
from jshape.reproject import reproject
from jshape.robot.cameras.base import CameraSettings
from jshape.robot.cameras.names import open_camera
from jshape.robot.cameras.played import Played
from jshape.viz.style import png
from tests.conftest import ROOT, SHARED
from tests.seen_beds import above_simulated, dug_simulated, seen_by, standing

APPLIED = (("knock", (130, 110)), ("poke", (330, 280)))
FAR = Camera(640, 530, 780.0, 780.0, 319.5, 264.5, 0.4, 0.9)
"""A camera that is not the bank's, 0.6 m from the bed."""


def bed_and_goal() -> tuple[np.ndarray, np.ndarray]:
    """Depths of a bed, and of what two actions made of it."""
    bed = goal = sim.flat_bed()
    for name, at in APPLIED:
        xy = sim.position_to_xy(PAPER_BOX, np.array(at))
        goal = sim.apply_action(jax.random.key(1), goal, "flour", (name, "robot"), xy)
    first, second = (
        look(jax.random.key(k), one, PAPER_BOX, frames=5) for k, one in enumerate((bed, goal))
    )
    return first, second


def samples(folder: Path) -> None:
    """What `jshape samples` makes, and the poses by the other name that a page gives them."""
    assert main(["samples", str(folder / "samples")]) == 0
    for path in list((folder / "samples").iterdir()):
        path.rename(folder / path.name)
    shutil.copy(folder / "poses.json", folder / "pairs.json")


def far(folder: Path) -> None:
    """The same bed, seen by another camera from 0.15 m higher up, at 20 degrees."""
    a, pose = np.radians(20.0), np.eye(4)
    pose[:3, :3] = [[1, 0, 0], [0, np.cos(a), np.sin(a)], [0, -np.sin(a), np.cos(a)]]
    pose[:3, 3] = [0.0, 0.0, 0.45] - 0.6 * pose[:3, 2]
    posed = replace(FAR, pose=as_frame(pose))
    for name, depth in zip(("far", "far-wanted"), bed_and_goal(), strict=True):
        whole = np.where(depth > 0, depth, np.median(depth))
        seen = reproject(whole, PAPER_BOX, posed, np.array([0.45, 0.8], np.float32))
        write_depth_png(folder / f"{name}.png", np.nan_to_num(np.asarray(seen)), DEPTH_UNIT)
    write_camera(folder / "far.json", FAR, DEPTH_UNIT)


def tilted(folder: Path) -> None:
    """A frame of a tilted bin with holes, and its camera."""
    camera = Camera(640, 480, 619.871, 619.871, 314.241, 238.906, 0.5, 1.0)
    v, u = np.mgrid[:480, :640]
    depth = 0.86 / (1 + 0.6 * (v - 238.9) / 619.9) * (1 + 0.002 * np.sin(u / 9))
    counts = np.where(np.hypot(u - 80, v - 120) < 190, 0, np.rint(depth / DEPTH_UNIT))
    cv2.imwrite(str(folder / "background-0.depth.png"), counts.astype(np.uint16))
    write_camera(folder / "sr300.json", camera, DEPTH_UNIT)


def looks(folder: Path) -> None:
    """A level bed, one now and a wanted one from a tripod at 30 degrees; two from two sides."""
    rng, middle = np.random.default_rng(3), Camera(424, 240, 215.0, 215.0, 211.5, 119.5, 0.3, 0.9)
    now, wanted = (heightmap(depth, PAPER_BOX) for depth in bed_and_goal())
    base = np.diag([1.0, -1.0, -1.0, 1.0])  # of an arm, at the paper's camera but upright
    write_camera(folder / "intrinsics.json", middle, DEPTH_UNIT)
    for name, bed, turn in (
        ("level", now, 0), ("look", now, 0), ("look-wanted", wanted, 0), ("left", now, 0),
        ("right", now, 180), ("level-left", now, 0), ("level-right", now, 180),
    ):  # fmt: skip
        pose = np.array(bed.frame) @ np.array(standing(30, 0.6, turn, middle).pose)
        depth = seen_by(replace(middle, pose=as_frame(pose)), bed)
        depth += 2.2e-3 * depth**2 * rng.standard_normal(depth.shape)
        write_depth_png(folder / f"{name}.png", depth, DEPTH_UNIT)
        if name in ("left", "right"):
            pose = base @ pose
            fields = {"format": "jshape-pose", "version": 1, "T_base_camera": pose.tolist()}
            (folder / f"{name}-base.json").write_text(json.dumps(fields))
            write_camera(folder / f"{name}.json", replace(middle, pose=as_frame(pose)), DEPTH_UNIT)
    write_camera(folder / "tripod.json", middle, DEPTH_UNIT)


def pokes(count: int, seed: int, material: str = "flour") -> Pairs:
    """Pairs of pokes of a robot and a human."""
    who = {"actions": ("poke",), "agents": ("robot", "human"), "material": material}
    return together(simulate_pairs(jax.random.key(seed), count, **who))


def bank(folder: Path) -> None:
    """A bank: a copy of a bundled one."""
    shutil.copytree(ROOT / "weights/pressed-flour-human", folder / "my-bank")


def plan(folder: Path, name: str = "my-plan") -> None:
    """What `jshape plan --out my-plan` leaves, of actions that were given."""
    from jshape.viz import pictures

    whole = [np.where(depth > 0, depth, np.median(depth)) for depth in bed_and_goal()]
    now, wanted = (metric.weigh(PAPER_BOX.luminance(z, quantize=False), PAPER_BOX) for z in whole)
    names, places = zip(*APPLIED, strict=True)
    found = rollout(now, wanted, names, np.array(places), bank="flour-robot")
    (folder / name).mkdir()
    found.to_json(folder / name / "plan.json")
    (folder / name / "plan.png").write_bytes(png(pictures.plan_figure(found)))


def run(folder: Path) -> None:
    """What `jshape demo` leaves."""
    words = [
        "demo",
        "--bank",
        "flour-robot",
        "--max-steps",
        "2",
        "--out",
        str(folder / "runs/demo"),
    ]
    assert main(words) == 0


def learning(folder: Path) -> None:
    """What `jshape mold --adapt` leaves after one action."""
    samples(folder)
    words = ["--arm", "sim:3", "--yes", "--adapt", "--max-steps", "1"]
    out = str(folder / "runs/sand")
    assert main(["mold", str(folder / "wanted.png"), *words, "--out", out]) == 0


def goal(folder: Path) -> None:
    """What `jshape goal` leaves."""
    assert main(["goal", "flat", "--text", "J", "--out", str(folder / "my-goal")]) == 0


def base(folder: Path) -> None:
    """A pose of the camera, written by hand."""
    matrix = [[1, 0, 0, 0.55], [0, -1, 0, 0.02], [0, 0, -1, 0.61], [0, 0, 0, 1]]
    fields = {"format": "jshape-pose", "version": 1, "T_base_camera": matrix}
    (folder / "base.json").write_text(json.dumps(fields))


def own(folder: Path) -> None:
    """The material and the hand of `own_material.md`, as it writes them."""
    text = (ROOT / "docs/own_material.md").read_text(encoding="utf-8")
    for block in re.findall(r"```toml\n(.*?)```", text, re.S):
        name = re.match(r"# (\S+)", block)
        (folder / name[1]).write_text(block)


def before_after(folder: Path) -> None:
    """Frames of others: NAME_before.png and NAME_after.png."""
    inside, pairs = folder / "frames", pokes(2, 4)
    inside.mkdir()
    write_camera(inside / "camera.json", PAPER_BOX, DEPTH_UNIT)
    for name, prior, posterior in zip("ab", pairs.prior, pairs.posterior, strict=False):
        cv2.imwrite(str(inside / f"{name}_before.png"), prior)
        cv2.imwrite(str(inside / f"{name}_after.png"), posterior)


def mcap(folder: Path) -> None:
    """A bag as ROS 2 records it."""
    from tests.written_bags import depth_bag

    _, shots = simulate_recording(jax.random.key(3), ["poke"], still=2, move=1, rest=1)
    in_mm = [np.rint(shot * (DEPTH_UNIT / 1e-3)).astype(np.uint16) for shot in shots]
    made = depth_bag(folder / "bag", "mcap", PAPER_BOX, in_mm)
    shutil.copy(next(made.glob("*.mcap")), folder / "session.mcap")


def sdk(folder: Path) -> None:
    """A recording of the RealSense SDK: pokes below a virtual D435."""
    from tests.virtual_realsense import record

    _, shots = simulate_recording(jax.random.key(9), ["poke"] * 4, still=8, move=3, rest=3)
    record(folder / "session.db3", PAPER_BOX, DEPTH_UNIT, shots)


def camera(serial: str | None, count: int | None) -> Played:
    """The D435 that is plugged in; somebody presses Ctrl-C after `count` frames.

    One of a serial number sees what `--camera sim:3` sees with the camera file of that name.
    """
    if serial is not None:
        given = read_camera(f"{serial.lower()}.json", DEPTH_UNIT)
        found = open_camera("sim:3", CameraSettings(given))
        assert isinstance(found, Played)
        return found
    depth = np.asarray(sim.render(sim.flat_bed(), D435_BAZAR))
    rng = np.random.default_rng(5)

    def shots():
        taken = 0
        while count is None or taken < count:
            taken += 1
            noisy = depth + 0.00045 * rng.standard_normal(depth.shape)
            yield np.rint(noisy / DEPTH_UNIT).astype(np.uint16)
        raise KeyboardInterrupt

    return Played("virtual D435", D435_BAZAR, DEPTH_UNIT, shots(), live=True)


def maps(folder: Path) -> None:
    """Height maps of the looks from a tripod."""
    looks(folder)
    like: list[str] = []
    for name, frame in (("now", "look"), ("wanted", "look-wanted")):
        words = [str(folder / f"{frame}.png"), "--camera-file", str(folder / "tripod.json"), *like]
        assert main(["heightmap", *words, "--out", str(folder / f"{name}.npz")]) == 0
        like = ["--like", str(folder / "now.npz")]


def over_simulated(folder: Path) -> None:
    """Two cameras over the bed of `sim:3`, and a map of that bed as it is wanted."""
    write_map(folder / "wanted.npz", dug_simulated(3))
    for name, tilt in (("left", -30), ("right", 30)):
        write_camera(folder / f"{name}.json", above_simulated(tilt), DEPTH_UNIT)


INPUTS = {
    "robot: wanted.npz": over_simulated,
    "robot: left.json": over_simulated,
    "robot: right.json": over_simulated,
    "now.png": samples,
    "wanted.png": samples,
    "camera.json": samples,
    "background-0.depth.png": tilted,
    "sr300.json": tilted,
    "far.png": far,
    "far-wanted.png": far,
    "far.json": far,
    "now.npz": maps,
    "wanted.npz": maps,
    "level.png": looks,
    "level-left.png": looks,
    "level-right.png": looks,
    "left-base.json": looks,
    "right-base.json": looks,
    "intrinsics.json": looks,
    "look.png": looks,
    "look-wanted.png": looks,
    "left.png": looks,
    "right.png": looks,
    "tripod.json": looks,
    "left.json": looks,
    "right.json": looks,
    "pairs": lambda folder: save_pairs(pokes(8, 0), folder / "pairs"),
    "monday": lambda folder: save_pairs(pokes(1, 1), folder / "monday"),
    "tuesday": lambda folder: save_pairs(pokes(1, 2), folder / "tuesday"),
    "dough-pairs": lambda folder: save_pairs(pokes(4, 5, "dough"), folder / "dough-pairs"),
    "both": lambda folder: save_pairs(pokes(2, 6), folder / "both"),
    "more-pairs": lambda folder: save_pairs(pokes(2, 3), folder / "more-pairs"),
    "uneven": lambda folder: save_pairs(pokes(4, 7), folder / "uneven"),
    "my-bank": bank,
    "my-goal": goal,
    "my-plan": plan,
    "letter": lambda folder: plan(folder, "letter"),
    "runs/demo": run,
    "runs/sand": learning,
    "poses.json": samples,
    "pairs.json": samples,
    "base.json": base,
    "frames": before_after,
    "data": lambda folder: (folder / "data").symlink_to(SHARED / "data"),
    "session.mcap": mcap,
    "clay.toml": own,
    "spatula.toml": own,
    "session.db3": sdk,
}
"""By the name that the pages give it, or that one page does, how it is made."""


def input_of(word: str) -> str | None:
    """The input that a word of a command names: "realsense:session.db3", "my-plan/plan.json"."""
    path = Path(word.rpartition(":")[2])
    names = [path.as_posix(), *(parent.as_posix() for parent in path.parents)]
    return next((name for name in names if name in INPUTS), None)
