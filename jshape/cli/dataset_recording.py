"""`jshape dataset simulate-recording` and `jshape dataset segment`."""

import argparse
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from jshape.cli import arguments
from jshape.cli.tables import print_table, progress
from jshape.data import segment as cutting
from jshape.errors import BadDataset
from jshape.io import annotations, folders, recordings
from jshape.io.recordings import LABELS, LEAVE_OUT, Label, Recording
from jshape.io.simulated import material_of
from jshape.io.tables import check_action
from jshape.viz import sheets
from jshape.viz.style import drawn

_COLOURS = {"action": "black", "none": "0.55", "reset": "tab:red"}


def simulate_recording(options: argparse.Namespace) -> dict[str, Any]:
    """`jshape dataset simulate-recording OUT`."""
    import jax

    from jshape.camera import PAPER_BOX
    from jshape.data import recording
    from jshape.data.simulate import DEPTH_UNIT

    folders.check_target(options.out, options.overwrite, contents=recordings.CONTENTS)
    actions = [options.actions[k % len(options.actions)] for k in range(options.count)]
    truth, frames = recording.simulate_recording(
        jax.random.key(options.seed),
        actions,
        agent=options.agent,
        material=material_of(options.material),
        bed=options.bed,
        still=options.still_frames,
        idle=options.idle,
        level_every=options.level_every,
    )
    with recordings.recording_writer(
        options.out, PAPER_BOX, DEPTH_UNIT, overwrite=options.overwrite
    ) as add:
        for counts in progress(frames, truth.frames, "recording"):
            add(counts)
        add.labels = actions
        add.truth = {"still": truth.still, "changes": truth.changes}
    if not options.json:
        print(f"{add.count} frames, {len(actions)} actions: {options.out}")
    return {"out": str(options.out), "frames": add.count, "actions": actions}


def segment(options: argparse.Namespace) -> dict[str, Any]:
    """`jshape dataset segment RECORDING OUT`."""
    folders.check_target(options.out, options.overwrite, contents=annotations.FOUND_CONTENTS)
    recording = recordings.open_recording(options.recording, allow_gaps=options.allow_gaps)
    labels = _labels(options)
    thumbs = np.stack([
        cutting.thumbnail(counts)
        for counts in progress(recording.frames(), len(recording), "reading")
    ])  # fmt: skip
    cut = cutting.cut(
        thumbs, recording.depth_unit, near_mm=options.near_mm, min_frames=options.min_frames
    )
    _check(recording, cut, options.min_frames)
    averages = _averages(recording, cut)
    noise = float(np.median([a.noise_mm for a in averages]))
    pairs = list(zip(averages, averages[1:], strict=False))
    changes = [
        cutting.compare(a, b, recording.depth_unit, noise, reset_share=options.reset_share)
        for a, b in pairs
    ]
    actions = [change for change in changes if change.kind == "action"]
    named = _match(options, recording, labels, changes)
    kept = [(c, label) for c, label in zip(actions, named, strict=True) if label is not None]
    if not kept:
        raise BadDataset(
            f"{options.recording}: no pair is left of {len(changes)} changes: {_story(changes)}"
        )
    name = options.recording.resolve().name
    texts = iter([label.action if label else "left out" for label in named])
    story = [next(texts) if c.kind == "action" else c.kind for c in changes]
    with annotations.found_writer(
        options.out, recording.camera, recording.depth_unit, overwrite=options.overwrite
    ) as add:
        for number, (change, label) in enumerate(kept):
            left, top, w, h = cutting.provisional_box(change.effect, recording.camera.shape)
            add(
                id=f"{name}_{number:03d}_{label.action}",
                action=label.action,
                agent=label.agent,
                material=label.material,
                prior=change.before.counts,
                posterior=change.after.counts,
                u=left + w // 2,
                v=top + h // 2,
                width=w,
                height=h,
            )
        timeline = partial(
            sheets.timeline_figure,
            cut.motion,
            cut.occluded,
            [(s.start, s.stop, s.state) for s in cut.segments],
            [
                ((c.before.segment.stop + c.after.segment.start) / 2, text, _COLOURS[c.kind])
                for c, text in zip(changes, story, strict=True)
            ],
            title=f"{name}: {len(cut.open)} open segments, {len(kept)} pairs",
        )
        add.pictures.update(drawn({annotations.TIMELINE: timeline}))
    rows = [
        (f"{c.before.segment} / {c.after.segment}", text, c.why)
        for c, text in zip(changes, story, strict=True)
    ]
    if not options.json:
        hidden = sum(s.state == "occluded" for s in cut.segments)
        print(
            f"{len(recording)} frames: {len(cut.open)} segments with the open bed at rest, "
            f"{hidden} at rest but hidden; noise {noise:.2f} mm after averaging"
        )
        print_table(("frames before / after", "what", "why no pair"), rows)
        print(f"{len(kept)} pairs, and {annotations.TIMELINE} to check: {options.out}")
    return {
        "out": str(options.out),
        "frames": len(recording),
        "segments": [[s.start, s.stop, s.state] for s in cut.segments],
        "changes": [
            {"before": c.before.segment.stop - 1, "after": c.after.segment.start, "what": text,
             "why": c.why}
            for c, text in zip(changes, story, strict=True)
        ],
        "pairs": len(kept),
        "noise_mm": noise,
    }  # fmt: skip


def _labels(options: argparse.Namespace) -> list[Label] | None:
    """The labels of a file, checked before anything is read; None: one action for all changes."""
    if options.labels is not None:
        if options.action is not None:
            raise BadDataset("--action and --labels are two ways to say it; give one of them")
        return list(
            recordings.read_labels(options.labels, options.agent, options.material).values()
        )
    lacking = [
        n for n in ("action", "agent", "material") if not (getattr(options, n) or "").strip()
    ]
    if lacking:
        hint = ", or --labels FILE with one row per change" if "action" in lacking else ""
        if "action" in lacking and (options.recording / LABELS).is_file():
            hint = f", or --labels {options.recording / LABELS}"
        raise BadDataset(f"what was done? give --{lacking[0]}{hint}")
    check_action(options.action, "--action")
    return None


def _averages(recording: Recording, cut: cutting.Cut) -> list[cutting.Averaged]:
    found = []
    for part in progress(cut.open, len(cut.open), "averaging"):
        stack = np.stack(list(recording.frames(cutting.averaged_frames(part))))
        found.append(cutting.average_segment(part, stack, recording.depth_unit))
    return found


def _check(recording: Recording, cut: cutting.Cut, least: int) -> None:
    """Refuse a recording without two looks at the open bed; say what was seen instead."""
    where = f"{recording.folder}: {len(recording)} frames"
    if len(cut.open) >= 2:
        return
    hidden = [s for s in cut.segments if s.state == "occluded"]
    short = [s for s in cut.segments if s.state == "short"]
    if len(cut.open) == 1:
        raise BadDataset(
            f"{where}: the open bed is at rest once only (frames {cut.open[0]}); "
            "a pair needs it before and after an action"
        )
    longest = max((s.stop - s.start for s in short), default=0)
    raise BadDataset(
        f"{where}: the open bed is nowhere at rest for {least} frames "
        f"({len(hidden)} quiet parts are hidden by something, the longest open one has {longest} "
        "frames); --min-frames and --near-mm change what counts"
    )


def _match(
    options: argparse.Namespace,
    recording: Recording,
    labels: list[Label] | None,
    changes: list[cutting.Change],
) -> list[Label | None]:
    """A label, or None to leave it out, for every change that is an action."""
    actions = [c for c in changes if c.kind == "action"]
    if labels is None:
        return [Label(options.action, options.agent, options.material)] * len(actions)
    if len(labels) != len(actions):
        raise BadDataset(
            f"{options.labels}: has {len(labels)} rows; {recording.folder} shows "
            f"{len(actions)} actions: {_story(changes)} (a row '{LEAVE_OUT}' leaves one out)"
        )
    return [None if label.action == LEAVE_OUT else label for label in labels]


def _story(changes: list[cutting.Change]) -> str:
    """What was found between which frames, in one line."""
    parts = [f"{c.kind} at {c.before.segment.stop}-{c.after.segment.start - 1}" for c in changes]
    return ", ".join(parts[:20]) + (f" and {len(parts) - 20} more" if len(parts) > 20 else "")


def add(commands: Any) -> None:
    """The parsers, below `jshape dataset`."""
    parser = arguments.command(
        commands, "simulate-recording", simulate_recording,
        "a simulated recording: a hand comes, acts and leaves, again and again",
    )  # fmt: skip
    parser.add_argument("out", type=Path, help="folder of the new recording")
    parser.add_argument("--actions", nargs="+", default=["poke"], help="in turn (default: poke)")
    parser.add_argument(
        "--count", type=arguments.positive_count, default=6, help="how many actions (default: 6)"
    )
    parser.add_argument("--agent", default="human", help="robot or human (default)")
    arguments.add_material(parser)
    parser.add_argument("--bed", default="flat", help="flat, irregular or curved")
    parser.add_argument(
        "--still-frames", type=arguments.positive_count, default=10,
        help="of the open bed between two visits of the hand (default: 10)",
    )  # fmt: skip
    parser.add_argument(
        "--idle", type=arguments.count, default=0, help="visits of the hand without a touch"
    )
    parser.add_argument(
        "--level-every", type=arguments.count, default=0,
        help="level the bed after so many actions (default: never)",
    )  # fmt: skip
    parser.add_argument("--seed", type=arguments.seed, default=0)

    parser = arguments.command(
        commands, "segment", segment, "pairs of frames from a recording of repeated actions"
    )
    parser.add_argument("recording", type=Path, help="folder with camera.json and numbered frames")
    parser.add_argument("out", type=Path, help="folder of the new data set")
    parser.add_argument("--action", help="what was done, every time")
    parser.add_argument("--agent", help="who or what did it: human, robot ...")
    parser.add_argument("--material", help="flour, sand ...")
    parser.add_argument(
        "--labels", type=Path, metavar="FILE",
        help="instead of --action: a CSV with the column action (agent and material if need be), "
        "one row per action in order; '-' leaves one out",
    )  # fmt: skip
    parser.add_argument(
        "--min-frames", type=arguments.positive_count, default=cutting.MIN_FRAMES,
        help=f"least length of a still segment (default: {cutting.MIN_FRAMES})",
    )  # fmt: skip
    parser.add_argument(
        "--near-mm", type=arguments.positive, default=cutting.NEAR_MM,
        help="what rises this far above the bed is a hand or an arm "
        f"(default: {cutting.NEAR_MM:g})",
    )  # fmt: skip
    parser.add_argument(
        "--reset-share", type=arguments.share, default=cutting.RESET_SHARE,
        help="a change of more than this share of the bed is levelling, and makes no pair "
        f"(default: {cutting.RESET_SHARE:g})",
    )  # fmt: skip
    parser.add_argument("--allow-gaps", action="store_true", help="frame numbers may be missing")
