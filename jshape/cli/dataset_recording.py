"""`jshape dataset simulate-recording` and `jshape dataset segment`."""

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from jshape.cli.dataset_import import Labelled
from jshape.cli.names import Action, Agent, Simulates
from jshape.cli.options import Count, Positive, PositiveCount, Seed, Several, Share, Writes
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


@dataclass(frozen=True, kw_only=True)
class Simulated(Simulates, Writes):
    """Of `jshape dataset simulate-recording`."""

    actions: Annotated[list[Action], Several] = field(default_factory=lambda: ["poke"])
    """In turn."""
    count: PositiveCount = 6
    """How many actions."""
    agent: Agent = "human"
    """Who acts: robot, human or FILE.toml."""
    bed: str = "flat"
    """Flat, irregular or curved."""
    still_frames: PositiveCount = 10
    """Of the open bed between two visits of the hand."""
    idle: Count = 0
    """Visits of the hand without a touch."""
    level_every: Count = 0
    """Level the bed after so many actions; 0: never."""
    seed: Seed = 0
    """Of everything random."""


@dataclass(frozen=True, kw_only=True)
class Segmented(Labelled):
    """Of `jshape dataset segment`."""

    min_frames: PositiveCount = cutting.MIN_FRAMES
    """Least length of a still segment."""
    near_mm: Positive = cutting.NEAR_MM
    """What rises this far above the bed is a hand or an arm."""
    reset_share: Share = cutting.RESET_SHARE
    """A change of more than this share of the bed is levelling, and makes no pair."""
    allow_gaps: bool = False
    """Frame numbers may be missing."""


def simulate_recording(out: Path, /, options: Simulated = Simulated()) -> dict[str, Any]:
    """`jshape dataset simulate-recording OUT`.

    Args:
      out: Folder of the new recording.
      options: what of it.
    """
    import jax

    from jshape.camera import PAPER_BOX
    from jshape.data import recording
    from jshape.data.simulate import DEPTH_UNIT

    folders.check_target(out, options.overwrite, contents=recordings.CONTENTS)
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
        out, PAPER_BOX, DEPTH_UNIT, overwrite=options.overwrite
    ) as add:
        for counts in progress(frames, truth.frames, "recording"):
            add(counts)
        add.labels = actions
        add.truth = {"still": truth.still, "changes": truth.changes}
    if not options.json:
        print(f"{add.count} frames, {len(actions)} actions: {out}")
    return {"out": str(out), "frames": add.count, "actions": actions}


def segment(folder: Path, out: Path, /, options: Segmented = Segmented()) -> dict[str, Any]:
    """`jshape dataset segment RECORDING OUT`.

    Args:
      folder: camera.json and numbered frames.
      out: Folder of the new data set.
      options: how.
    """
    folders.check_target(out, options.overwrite, contents=annotations.FOUND_CONTENTS)
    recording = recordings.open_recording(folder, allow_gaps=options.allow_gaps)
    labels = _labels(folder, options)
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
        raise BadDataset(f"{folder}: no pair is left of {len(changes)} changes: {_story(changes)}")
    name = folder.resolve().name
    texts = iter([label.action if label else "left out" for label in named])
    story = [next(texts) if c.kind == "action" else c.kind for c in changes]
    with annotations.found_writer(
        out, recording.camera, recording.depth_unit, overwrite=options.overwrite
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
        print(f"{len(kept)} pairs, and {annotations.TIMELINE} to check: {out}")
    return {
        "out": str(out),
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


def _labels(folder: Path, options: Segmented) -> list[Label] | None:
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
        if "action" in lacking and (folder / LABELS).is_file():
            hint = f", or --labels {folder / LABELS}"
        raise BadDataset(f"what was done? give --{lacking[0]}{hint}")
    check_action(options.action or "", "--action")
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
    options: Segmented,
    recording: Recording,
    labels: list[Label] | None,
    changes: list[cutting.Change],
) -> list[Label | None]:
    """A label, or None to leave it out, for every change that is an action."""
    actions = [c for c in changes if c.kind == "action"]
    if labels is None:
        one = Label(options.action or "", options.agent or "", options.material or "")
        return [one for _ in actions]
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
