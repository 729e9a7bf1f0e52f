"""What several cameras recorded of one bed at once: a folder with a recording of each.

Their frames match by the numbers at the end of their names: equal counts, or times that are at most
half the time between two frames apart.
"""

import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from jshape.camera import Camera
from jshape.data.fusion import check_poses
from jshape.errors import BadDataset
from jshape.io.cameras import CAMERA
from jshape.io.folders import atomic_folder
from jshape.io.recordings import FrameAdder, Recording, open_recording, recording_writer

CONTENTS = (f"1/{CAMERA}", *"123456789")
"""What the folder holds that `writers` make of several cameras, at the top."""
RATES = 0.1
"""Share by which the rates of two cameras may differ: less is what clocks and lost frames do."""


def open_at_once(folder: str | os.PathLike, *, allow_gaps: bool = False) -> list[Recording]:
    """The recording in a folder; or those in its folders, of as many frames that match.

    Raises:
      BadDataset: as `open_recording`; or frames of several cameras that do not match.
      BadCamera: as `open_recording`; or one of several has no pose.
    """
    found = [Path(folder)]
    if not (found[0] / CAMERA).is_file():
        inside = sorted(path.parent for path in found[0].glob(f"[!.]*/{CAMERA}"))
        found = inside if len(inside) > 1 else found
    parts = [open_recording(path, allow_gaps=allow_gaps) for path in found]
    if len(parts) == 1:
        return parts
    check_poses([one.camera for one in parts], [str(one.folder / CAMERA) for one in parts])
    return _matched(parts, allow_gaps)


@contextmanager
def writers(
    folder: Path, sources: Sequence[tuple[Camera, float]], *, overwrite: bool = False
) -> Iterator[list[FrameAdder]]:
    """What adds frames to the recording of one camera; or of each of several, in 1, 2 ...

    `sources` are the cameras, and metres per count of their frames.  As `recording_writer`.
    """
    with ExitStack() as stack:
        within = [folder]
        if len(sources) > 1:
            made = stack.enter_context(atomic_folder(folder, overwrite, contents=CONTENTS))
            within = [made / str(number + 1) for number in range(len(sources))]
        yield [
            stack.enter_context(recording_writer(path, *source, overwrite=overwrite))
            for path, source in zip(within, sources, strict=True)
        ]


def _matched(parts: Sequence[Recording], allow_gaps: bool) -> list[Recording]:
    """The recordings with those frames only that all cameras took at one moment."""
    first = parts[0]
    times = [np.array([float(n - first.numbers[0]) for n in one.numbers]) for one in parts]
    steps = [float(np.median(np.diff(t))) if len(t) > 1 else 1.0 for t in times]
    for one, step in zip(parts[1:], steps[1:], strict=True):
        if one.counted != first.counted:
            how = [f"by {'number' if p.counted else 'time'} in {p.folder}" for p in (one, first)]
            raise BadDataset(f"frames are named {' and '.join(how)}; one of them says what matches")
        if first.counted and one.numbers != first.numbers and not allow_gaps:
            raise BadDataset(
                f"{_named(one)} and {_named(first)}: frames of several cameras match by their "
                "numbers; --allow-gaps takes those that all have"
            )
        if abs(step / steps[0] - 1) > RATES:
            raise BadDataset(
                f"{one.folder}: a frame every {step:g}, in {first.folder} every {steps[0]:g} (by "
                f"their names); the rates may differ by {RATES:.0%}"
            )
    nearest = [np.searchsorted((time[1:] + time[:-1]) / 2, times[0]) for time in times]
    off = [np.abs(time[near] - times[0]) for time, near in zip(times, nearest, strict=True)]
    kept = np.flatnonzero(np.max(off, axis=0) <= max(steps) / 2)
    if not len(kept):
        raise BadDataset(
            f"{_named(first)}, {' and '.join(map(_named, parts[1:]))}: no frames were taken within "
            f"{max(steps) / 2:g} of each other (by their names): have the cameras one clock?"
        )
    return [
        replace(one, **{name: tuple(getattr(one, name)[near[k]] for k in kept)
                        for name in ("files", "numbers")})
        for one, near in zip(parts, nearest, strict=True)
    ]  # fmt: skip


def _named(one: Recording) -> str:
    return f"{one.folder} has {len(one)} frames ({one.numbers[0]} to {one.numbers[-1]})"
