"""`jshape dataset simulate-recording` and `jshape dataset segment`."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from jshape.cli.dataset_import import Labelled, labels_of, like_of, placed
from jshape.cli.names import Action, Agent, Simulates
from jshape.cli.options import (
    CameraFile,
    Count,
    Positive,
    PositiveCount,
    Seed,
    Several,
    Share,
    Writes,
)
from jshape.cli.tables import print_table, progress, warn
from jshape.data import segment as cutting
from jshape.data.annotate import provisional_box
from jshape.data.changes import (
    RESET_SHARE,
    Averaged,
    Change,
    average_segment,
    averaged_frames,
    compare,
)
from jshape.data.moved import TURNED_DEG, moved
from jshape.data.pair_view import PairView, pair_view
from jshape.errors import BadDataset
from jshape.io import datasets, folders, recordings
from jshape.io.at_once import open_at_once
from jshape.io.recordings import LABELS, LEAVE_OUT, Label, Recording
from jshape.io.simulated import material_of
from jshape.viz import sheets
from jshape.viz.style import drawn

_COLOURS = {"action": "black", "none": "0.55", "reset": "tab:red"}


@dataclass(frozen=True, kw_only=True)
class Simulated(Simulates, Writes):
    """Of `jshape dataset simulate-recording`."""

    actions: Annotated[list[Action], Several] = field(default_factory=lambda: ["poke"])
    """Actions to do in turn."""
    count: PositiveCount = 6
    """Number of actions."""
    agent: Agent = "human"
    """Hand that acts: robot, human or FILE.toml."""
    bed: str = "flat"
    """Shape of the bed: flat, irregular or curved."""
    still_frames: PositiveCount = 10
    """Number of frames of the open bed between two visits of the hand."""
    idle: Count = 0
    """Number of visits of the hand without a touch."""
    level_every: Count = 0
    """Number of actions after which the bed is levelled; 0: never."""
    seed: Seed = 0
    """Random seed."""
    camera_file: Annotated[Path | None, CameraFile] = None
    """camera.json; its pose is in the bed's frame: x along u, y along v, z down, the bed at 0.45 m
    (default: the paper's camera, straight above)."""


@dataclass(frozen=True, kw_only=True)
class Segmented(Labelled):
    """Of `jshape dataset segment`."""

    min_frames: PositiveCount = cutting.MIN_FRAMES
    """Least length of a still segment, frames."""
    near_mm: Positive = cutting.NEAR_MM
    """Height above the bed from which something is a hand or an arm, mm."""
    reset_share: Share = RESET_SHARE
    """Share of the bed, 0 to 1, above which a change is levelling and makes no pair."""
    allow_gaps: bool = False
    """Accept a recording in which frame numbers are missing."""


def simulate_recording(out: Path, /, options: Simulated = Simulated()) -> dict[str, Any]:
    """`jshape dataset simulate-recording OUT`.

    Args:
      out: Folder of the new recording.
    """
    import jax

    from jshape.camera import PAPER_BOX
    from jshape.data import recording
    from jshape.data.simulate import DEPTH_UNIT
    from jshape.io.cameras import read_camera

    folders.check_target(out, options.overwrite, contents=recordings.CONTENTS)
    file = options.camera_file
    camera = PAPER_BOX if file is None else read_camera(file, DEPTH_UNIT)[0]
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
        camera=camera,
    )
    with recordings.recording_writer(out, camera, DEPTH_UNIT, overwrite=options.overwrite) as add:
        for counts in progress(frames, truth.frames, "recording"):
            add(counts)
        add.labels = actions
        add.truth = {"still": truth.still, "changes": truth.changes}
    print(f"{add.count} frames, {len(actions)} actions: {out}")
    return {"out": str(out), "frames": add.count, "actions": actions}


def segment(folder: Path, out: Path, /, options: Segmented = Segmented()) -> dict[str, Any]:
    """`jshape dataset segment RECORDING OUT`.

    Args:
      folder: camera.json and numbered frames; of several cameras at once, a folder of each in it.
      out: Folder of the new data set.
    """
    folders.check_target(out, options.overwrite, contents=datasets.CONTENTS)
    parts = open_at_once(folder, allow_gaps=options.allow_gaps)
    file = str(folder / LABELS) if (folder / LABELS).is_file() else "FILE with one row per change"
    labels = labels_of(options, file)
    thumbs = [
        np.stack([cutting.thumbnail(c) for c in progress(one.frames(), len(one), "reading")])
        for one in parts
    ]
    how = {"near_mm": options.near_mm, "min_frames": options.min_frames}
    cuts = [cutting.cut(t, one.depth_unit, **how) for t, one in zip(thumbs, parts, strict=True)]
    cut = cutting.cut_at_once(cuts, [str(one.folder) for one in parts], options.min_frames)
    count = len(parts[0])
    _check(f"{folder}: {count} frames", cut, options.min_frames)
    means = _averages(parts, cut)
    sources = [(one.camera, one.depth_unit) for one in parts]
    wheres = [f"{folder}: frames {segment}" for segment in cut.open]
    seen = pair_view(sources, [one.counts for one in means[0]], wheres[0], like_of(options))
    for one, thumb in zip(parts, thumbs, strict=True):
        _check_still(one, cut, thumb, seen)
    averages = [
        replace(
            max(several, key=lambda one: one.noise_mm),
            counts=seen.counts([one.counts for one in several], where),
        )
        for several, where in zip(means, wheres, strict=True)
    ]
    noise = float(np.median([a.noise_mm for a in averages]))
    pairs = list(zip(averages, averages[1:], strict=False))
    compared = {"reset_share": options.reset_share, "hidden": seen.camera.orthographic}
    changes = [compare(a, b, seen.depth_unit, noise, **compared) for a, b in pairs]
    actions = [change for change in changes if change.kind == "action"]
    named = _match(options, folder, labels, changes)
    kept = [(c, label) for c, label in zip(actions, named, strict=True) if label is not None]
    if not kept:
        raise BadDataset(f"{folder}: no pair is left of {len(changes)} changes: {_story(changes)}")
    name = folder.resolve().name
    texts = iter([label.action if label else "left out" for label in named])
    told = [(c, next(texts) if c.kind == "action" else c.kind) for c in changes]
    with datasets.dataset_writer(
        out, seen.camera, seen.depth_unit, overwrite=options.overwrite
    ) as add:
        for number, (change, label) in enumerate(kept):
            add(
                id=f"{name}_{number:03d}_{label.action}",
                prior=change.before.counts,
                posterior=change.after.counts,
                by_hand=False,
                **label._asdict(),
                **placed(provisional_box(change.effect, seen.camera.shape)),
            )
        title = f"{name}: {len(cut.open)} open segments, {len(kept)} pairs"
        marks = [(sum(c.between) / 2, text, _COLOURS[c.kind]) for c, text in told]
        segments = [(s.start, s.stop, s.state) for s in cut.segments]
        timeline = partial(
            sheets.timeline_figure, cut.motion, cut.occluded, segments, marks, title=title
        )
        add.pictures.update(drawn({datasets.TIMELINE: timeline}))
    rows = [(f"{c.before.segment} / {c.after.segment}", text, c.why) for c, text in told]
    hidden = sum(s.state == "occluded" for s in cut.segments)
    print(
        f"{count} frames: {len(cut.open)} segments with the open bed at rest, "
        f"{hidden} at rest but hidden; noise {noise:.2f} mm after averaging"
    )
    if seen.said:
        print(seen.said)
    print_table(("frames before / after", "what", "why no pair"), rows)
    print(f"{len(kept)} pairs, and {datasets.TIMELINE} to check: {out}")
    return {
        "out": str(out),
        "frames": count,
        "segments": [[s.start, s.stop, s.state] for s in cut.segments],
        "changes": [
            {"before": c.between[0] - 1, "after": c.between[1], "what": text, "why": c.why}
            for c, text in told
        ],
        "pairs": len(kept),
        "noise_mm": noise,
        "view": seen.said,
    }


def _averages(parts: Sequence[Recording], cut: cutting.Cut) -> list[list[Averaged]]:
    """Of every open segment the mean of each camera's frames."""
    return [
        [
            average_segment(
                segment, np.stack(list(one.frames(averaged_frames(segment)))), one.depth_unit
            )
            for one in parts
        ]
        for segment in progress(cut.open, len(cut.open), "averaging")
    ]


def _check_still(
    recording: Recording, cut: cutting.Cut, thumbs: np.ndarray, seen: PairView
) -> None:
    """Warn of a camera that moved; refuse what it then sees aslant, if it is seen from above.

    A hand at rest has a relief of its own: the bed beside it tells only how it lies as a whole.
    """
    first = cut.open[0]
    still = [s for s in cut.segments if s.start >= first.start and s.state != "short"]
    means = [cutting.mean_of(thumbs[s.start : s.stop], recording.depth_unit) for s in still]
    for later, mean in zip(still[1:], means[1:], strict=True):
        how = moved(means[0], mean, recording.camera, cutting.BLOCK)
        if how is None or (how.aside_mm and later.state != "open"):
            continue
        said = f"{recording.folder}: frames {later}: {how.said(f'frames {first}')}: "
        if seen.view is not None and how.turned_deg > TURNED_DEG:
            raise BadDataset(
                f"{said}the camera moved; what comes from there on is another recording"
            )
        warn(f"{said}did the camera move, or was material added?")
        return


def _check(what: str, cut: cutting.Cut, least: int) -> None:
    """Refuse a recording without two looks at the open bed; say what was seen instead."""
    if len(cut.open) >= 2:
        return
    where = f"{what}: the open bed is"
    if cut.open:
        raise BadDataset(
            f"{where} at rest once only (frames {cut.open[0]}); a pair needs it before and after "
            "an action"
        )
    hidden = sum(s.state == "occluded" for s in cut.segments)
    longest = max((s.stop - s.start for s in cut.segments if s.state == "short"), default=0)
    raise BadDataset(
        f"{where} nowhere at rest for {least} frames ({hidden} quiet parts are hidden by "
        f"something, the longest open one has {longest} frames); --min-frames and --near-mm change "
        "what counts"
    )


def _match(
    options: Segmented,
    folder: Path,
    labels: dict[str, Label] | Label,
    changes: list[Change],
) -> list[Label | None]:
    """A label, or None to leave it out, for every change that is an action."""
    actions = [c for c in changes if c.kind == "action"]
    if isinstance(labels, Label):
        return [labels] * len(actions)
    if len(labels) != len(actions):
        raise BadDataset(
            f"{options.labels}: has {len(labels)} rows; {folder} shows "
            f"{len(actions)} actions: {_story(changes)} (a row '{LEAVE_OUT}' leaves one out)"
        )
    return [None if label.action == LEAVE_OUT else label for label in labels.values()]


def _story(changes: list[Change]) -> str:
    """What was found between which frames, in one line."""
    parts = [f"{c.kind} at {c.between[0]}-{c.between[1] - 1}" for c in changes]
    return ", ".join(parts[:20]) + (f" and {len(parts) - 20} more" if len(parts) > 20 else "")
