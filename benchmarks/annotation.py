"""How well recordings are cut and boxes found: against what the simulator knows.

    python -m benchmarks.annotation [--pairs 6] [--frames 8] [--recordings 2] [--data DIR]

The true box holds every pixel that differs by more than 0.5 mm between the two noise-free frames.
`found` is the overlap (intersection over union) of each pair's own box, `mean size` that of the
box which annotate writes: the action's mean size around each pair's centre.  DIR holds the
independent material-point samples (`pairs/` and `pairs_noisy/`), which are skipped if absent.
"""

import argparse
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.sim_against_mpm import default_data
from jshape import load_pairs, sim
from jshape.camera import PAPER_BOX
from jshape.data import segment as cutting
from jshape.data.annotate import find_effect, place_boxes
from jshape.data.changes import average_segment, averaged_frames, compare
from jshape.data.pairs import Pairs
from jshape.data.recording import changed_box, simulate_recording
from jshape.data.simulate import DEPTH_UNIT, ROIS, look, random_bed


def iou(a, b) -> float:
    """Intersection over union of two boxes (left, top, width, height)."""
    w = min(a[0] + a[2], b[0] + b[2]) - max(a[0], b[0])
    h = min(a[1] + a[3], b[1] + b[3]) - max(a[1], b[1])
    both = max(w, 0) * max(h, 0)
    return both / (a[2] * a[3] + b[2] * b[3] - both)


def pairs_with_truth(key, action, agent, bed_kind, material, count, frames):
    """Simulated pairs and the true boxes of their effects."""
    camera, w, h = PAPER_BOX, *ROIS[action]
    rows = []
    for k in jax.random.split(key, count):
        for_bed, for_place, for_act, for_prior, for_posterior = jax.random.split(k, 5)
        bed = random_bed(for_bed, bed_kind)
        low = jnp.array([w // 2, h // 2])
        high = low + jnp.array([camera.width - w, camera.height - h])
        place = jax.random.randint(for_place, (2,), low, high + 1)
        xy = sim.position_to_xy(camera, place)
        after = sim.apply_action(for_act, bed, material, (action, agent), xy)
        box = changed_box(
            np.asarray(sim.render(bed, camera)), np.asarray(sim.render(after, camera))
        )
        shots = [
            np.asarray(sim.to_uint16(look(x, b, camera, frames=frames), DEPTH_UNIT))
            for x, b in ((for_prior, bed), (for_posterior, after))
        ]
        rows.append((*shots, np.asarray(place), box))
    prior, posterior, centre, boxes = (list(x) for x in zip(*rows, strict=True))
    n = len(rows)
    pairs = Pairs(
        camera, DEPTH_UNIT, np.stack(prior), np.stack(posterior), np.array([action] * n),
        np.array([agent] * n), np.array([material] * n), np.stack(centre).astype(np.int32),
        np.array([(w, h)] * n, np.int32), np.array([str(k) for k in range(n)]),
    )  # fmt: skip
    return pairs, boxes


def overlaps(pairs, boxes):
    """(overlap of each pair's own box, overlap of the mean-size box, mean size), misses as 0."""
    effects = [
        find_effect(a, b, pairs.depth_unit)
        for a, b in zip(pairs.prior, pairs.posterior, strict=True)
    ]
    found, there = place_boxes(pairs, effects, np.zeros(len(pairs), bool))
    own = [iou(e.box, b) if e.box else 0.0 for e, b in zip(effects, boxes, strict=True)]
    corner = found.centre - found.size // 2
    written = [
        iou((*c, *s), b) if ok else 0.0
        for c, s, b, ok in zip(corner, found.size, boxes, there, strict=True)
    ]
    return own, written, found.roi_size(pairs.actions[0])


def independent(data: Path) -> None:
    """The same on the material-point pairs, whose frames hold only the surroundings of the action.

    The noisy ones are single frames (0.65 mm of noise in a difference): a rim of 1 mm is lost in
    it, so they are also compared with the box of what has changed by 2 mm.
    """
    print("material-point pairs          action  found  worst  size     true size")
    for group in sorted((data / "pairs").iterdir()):
        clean = load_pairs(group)
        for noise, least in (("pairs", 0.5), ("pairs_noisy", 0.5), ("pairs_noisy", 2.0)):
            seen = load_pairs(data / noise / group.name)
            for action in clean.actions:
                mine, ours = seen.of(action), clean.of(action)
                depth = (ours.prior * np.float32(1e-4), ours.posterior * np.float32(1e-4))
                boxes = [
                    changed_box(a, b, least) or (0, 0, 0, 0) for a, b in zip(*depth, strict=True)
                ]
                own, _, (w, h) = overlaps(mine, boxes)
                true = np.mean(boxes, 0)
                kind = f"{'noisy' if noise != 'pairs' else 'clean'} {least:g} mm"
                print(
                    f"{group.name:21s} {kind:12s} {action:6s}  {np.mean(own):.3f}  "
                    f"{np.min(own):.3f}  {w:3d}x{h:3d}  {true[2]:.0f}x{true[3]:.0f}"
                )


def recordings(count: int) -> None:
    """Simulated recordings cut and compared with their truth: what was found, missed, made up."""
    print(
        "recording                       still segments        pairs                 none reset IoU"
    )
    kinds = {"idle": "none", "action": "action", "level": "reset"}
    settings = [
        (bed, material, agent, noise)
        for bed, material in (("flat", "flour"), ("irregular", "flour"), ("irregular", "sand"))
        for agent in sim.AGENTS
        for noise in (0.00045, 0.0009)
    ]
    for number, (bed, material, agent, noise) in enumerate(settings):
        still, right, overlap, told = [0, 0, 0], [0, 0, 0], [], {"idle": [], "level": []}
        for repeat in range(count):
            truth, frames = simulate_recording(
                jax.random.key(100 * number + repeat), tuple(sim.ACTIONS), agent=agent,
                material=material, bed=bed, idle=2, level_every=2, noise=noise,
            )  # fmt: skip
            kept = np.stack(list(frames))
            found = cutting.cut(np.stack([cutting.thumbnail(f) for f in kept]), DEPTH_UNIT)
            good = [
                any(a - 4 <= s.start and s.stop <= b + 4 for s in found.open)
                for a, b in truth.still
            ]
            hidden = [any(s.start < b and a < s.stop for a, b in truth.still) for s in found.open]
            still = np.add(still, (len(good), sum(good), len(hidden) - sum(hidden)))
            parts = [average_segment(s, kept[averaged_frames(s)], DEPTH_UNIT) for s in found.open]
            level = float(np.median([part.noise_mm for part in parts]))
            changes = [
                compare(a, b, DEPTH_UNIT, level) for a, b in zip(parts, parts[1:], strict=False)
            ]
            right = np.add(right, (sum(c["kind"] == "action" for c in truth.changes), 0, 0))
            if len(changes) != len(truth.changes):
                right = np.add(right, (0, 0, sum(c.kind == "action" for c in changes)))
                continue
            for change, true in zip(changes, truth.changes, strict=True):
                same = change.kind == kinds[true["kind"]]
                if true["kind"] == "action":
                    right = np.add(right, (0, same, 0))
                    overlap += [iou(change.effect.box, true["box"])] if same else []
                else:
                    told[true["kind"]].append(same)
                    right = np.add(right, (0, 0, change.kind == "action"))
        print(
            f"{bed:9s} {material:6s} {agent:6s} {1e3 * noise:.2f} mm  "
            f"{still[1]} of {still[0]}, {still[2]} false    {right[1]} of {right[0]}, "
            f"{right[2]} false     {sum(told['idle'])}/{len(told['idle'])}  "
            f"{sum(told['level'])}/{len(told['level'])}   {np.mean(overlap):.3f}",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description="Overlap of found boxes with true ones.")
    parser.add_argument("--pairs", type=int, default=6, help="per row of the table")
    parser.add_argument("--frames", type=int, default=8, help="averaged into each frame")
    parser.add_argument("--recordings", type=int, default=2, help="per row of their table")
    parser.add_argument("--data", type=Path, default=default_data())
    options = parser.parse_args()
    recordings(options.recordings)
    if (options.data / "pairs").is_dir():
        independent(options.data)
    print("bed        material agent  action  found  worst  mean size  size     true size")
    everything = [[], []]
    key = jax.random.key(0)
    for bed, material in (("flat", "flour"), ("irregular", "flour"), ("irregular", "sand")):
        for agent in sim.AGENTS:
            for action in sim.ACTIONS:
                key, mine = jax.random.split(key)
                pairs, boxes = pairs_with_truth(
                    mine, action, agent, bed, material, options.pairs, options.frames
                )
                own, written, (w, h) = overlaps(pairs, boxes)
                for total, part in zip(everything, (own, written), strict=True):
                    total += part
                true = np.mean(boxes, 0)
                print(
                    f"{bed:10s} {material:8s} {agent:6s} {action:6s}  {np.mean(own):.3f}  "
                    f"{np.min(own):.3f}  {np.mean(written):.3f}      {w:3d}x{h:3d}  "
                    f"{true[2]:.0f}x{true[3]:.0f}"
                )
    print(f"all: {np.mean(everything[0]):.3f} each, {np.mean(everything[1]):.3f} with mean size")


if __name__ == "__main__":
    main()
