"""Pairs cut from recordings at an angle, by one camera or two at once, against straight above.

    python -m benchmarks.tilted_pairs --count 6

Each row is one recording of the same actions (simulated, with noise) as `jshape dataset segment`
and `annotate` make pairs of it: the overlap of found boxes with what changed by 0.5 mm without
noise, and how far a bank of kind P that is fitted to them is off on other pairs, seen from straight
above.
"""

import argparse
from collections.abc import Sequence
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import jax
import numpy as np

from benchmarks.annotation import iou
from benchmarks.tilted import posed
from jshape import sim
from jshape.camera import PAPER_BOX, Camera
from jshape.cli.main import main as jshape
from jshape.data.pairs import Pairs
from jshape.data.recording import Truth, changed_box, simulate_recording
from jshape.data.simulate import DEPTH_UNIT, simulate_pairs, together
from jshape.errors import BadDataset
from jshape.io.datasets import load_pairs
from jshape.io.recordings import recording_writer
from jshape.learn.fit import fit
from jshape.learn.scores import roi_errors_mm


def recorded(
    folder: Path, cameras: Sequence[Camera], actions: Sequence[str], seed: int, **settings: Any
) -> tuple[Pairs, list[tuple[int, int, int, int]]]:
    """The pairs that the commands make of a recording by cameras, and the true boxes in them."""
    key, truth = jax.random.key(seed), Truth()
    for number, camera in enumerate(cameras):
        truth, frames = simulate_recording(key, actions, camera=camera, **settings)
        own = folder / "recording" / (str(number) if len(cameras) > 1 else "")
        with recording_writer(own, camera, DEPTH_UNIT) as add:
            for counts in frames:
                add(counts)
    cut, found, labels = folder / "cut", folder / "pairs", folder / "labels.csv"
    labels.write_text("\n".join(["action", *actions]))
    said = ("--labels", labels, "--agent", "robot", "--material", "flour")
    with redirect_stdout(StringIO()):
        for command in (("segment", folder / "recording", cut, *said), ("annotate", cut, found)):
            if jshape(["dataset", *map(str, command)]):
                raise SystemExit(f"{folder}: jshape dataset {command[0]} failed")
    pairs = load_pairs(found)
    depths = [np.asarray(sim.render(bed, pairs.camera)) for bed in truth.beds]
    true = [changed_box(a, b) for a, b in zip(depths, depths[1:], strict=False)]
    return pairs, [box or (0, 0, 0, 0) for box in true]


def overlaps(pairs: Pairs, boxes: Sequence[tuple[int, int, int, int]]) -> np.ndarray:
    """(N,) intersection over union of the pairs' ROIs with boxes (left, top, width, height)."""
    first = pairs.centre - pairs.size // 2
    own = np.concatenate([first, pairs.size], 1)
    return np.array([iou(tuple(a), b) for a, b in zip(own.tolist(), boxes, strict=True)])


def errors_mm(pairs: Pairs, others: Pairs) -> tuple[float, float]:
    """How far a bank of an action's pairs is off on others from straight above, and the change.

    Means over the others' ROIs, mm.

    Raises:
      BadDataset: the pairs do not show enough of it.
    """
    (action,) = pairs.actions
    bank = fit(pairs, "P")
    if bank.camera.orthographic:
        bank = bank.seen_by(others.camera, sim.SURFACE)
    off, change = roi_errors_mm(bank, others, action, size=others.roi_size(action))
    return float(off.mean()), float(change.mean())


def main(words: Sequence[str] | None = None) -> int:
    """The table of all views."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=6, help="of each action")
    parser.add_argument("--actions", nargs="+", default=["knock", "poke"])
    parser.add_argument("--bed", default="irregular")
    parser.add_argument("--tilts", type=float, nargs="+", default=[30.0])
    parser.add_argument("--away", type=float, default=0.6, help="metres")
    asked = parser.parse_args(words)
    views = {"from above, 0.45 m": [PAPER_BOX]}
    for tilt in asked.tilts:
        left, right = (posed(each, asked.away) for each in (tilt, -tilt))
        views[f"{tilt:g} degrees, {asked.away:g} m"] = [left]
        views[f"+-{tilt:g} degrees, {asked.away:g} m"] = [left, right]
    other = simulate_pairs(
        jax.random.key(99), 6, actions=asked.actions, beds=(asked.bed,), frames=10
    )
    others = together(other)
    for name, cameras in views.items():
        with TemporaryDirectory() as folder:
            pairs, true = recorded(
                Path(folder), cameras, asked.actions * asked.count, 1, bed=asked.bed, agent="robot"
            )
        overlap = overlaps(pairs, true)
        for action in asked.actions:
            mine = overlap[pairs.action == action]
            said = f"{len(mine)} pairs: IoU {mine.mean():.2f} (least {mine.min():.2f})"
            try:
                off, change = errors_mm(pairs.of(action), others.of(action))
                said += f"; f_P off by {off:.2f} of {change:.2f} mm"
            except BadDataset as problem:
                said += f"; {problem}"
            print(f"{name:21} {action:6} {said}", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
