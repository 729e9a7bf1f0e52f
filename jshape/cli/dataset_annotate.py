"""`jshape dataset annotate`: find the box of every pair."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from jshape.cli.options import Writes
from jshape.cli.tables import print_table, progress
from jshape.data import annotate as finding
from jshape.data.annotate import Effect
from jshape.data.pairs import Pairs
from jshape.errors import BadDataset, one_line
from jshape.io import annotations, datasets, folders
from jshape.viz import sheets
from jshape.viz.style import drawn

_DOUBT = 0.35
"""A box whose area is off the action's mean by more than this share is worth a look."""


@dataclass(frozen=True, kw_only=True)
class DatasetAnnotateOptions(Writes):
    """Of `jshape dataset annotate`."""

    skip: bool = False
    """Leave out pairs without an effect."""
    all: bool = False
    """Find boxes anew where they were given by hand."""


def annotate(
    dataset: Path, out: Path, /, options: DatasetAnnotateOptions = DatasetAnnotateOptions()
) -> dict[str, Any]:
    """`jshape dataset annotate DATASET OUT`.

    Args:
      dataset: Folder with pairs of frames.
      out: Folder of the new data set; the same as DATASET with --overwrite replaces it.
    """
    folders.check_target(out, options.overwrite, contents=datasets.CONTENTS)
    pairs = datasets.load_pairs(dataset)
    if len(pairs) > sheets.PER_PAGE * len(datasets.SHEETS):
        pages = len(datasets.SHEETS)
        raise BadDataset(f"a contact sheet has at most {pages} pages; annotate fewer pairs")
    by_hand = annotations.boxes_by_hand(dataset)
    if options.all:
        by_hand[:] = False
    elif by_hand.all():
        raise BadDataset(
            f"{dataset}: all {len(pairs)} boxes were given by hand (no row has a box in "
            f"the column {datasets.FOUND!r} that is still its own); --all finds them anew"
        )
    effects = [
        finding.find_effect(prior, posterior, pairs.depth_unit, hidden=pairs.camera.orthographic)
        for prior, posterior in progress(
            zip(pairs.prior, pairs.posterior, strict=True), len(pairs), "finding"
        )
    ]
    found, there = finding.place_boxes(pairs, effects, by_hand)
    unseen = pairs.id[~there].tolist()
    if unseen and not options.skip:
        noise = np.median([e.noise_mm for e in effects])
        raise BadDataset(
            f"{dataset}: nothing changed beyond the noise of {noise:.2f} mm in "
            f"{one_line(', '.join(unseen), 120)}; --skip leaves such pairs out"
        )
    if not there.any():
        raise BadDataset(f"{dataset}: no pair shows a change, so none is left")
    doubts = _doubts(found, effects, by_hand, there)
    kept = np.flatnonzero(there).tolist()
    with datasets.dataset_writer(
        out, pairs.camera, pairs.depth_unit, overwrite=options.overwrite
    ) as add:
        for k in kept:
            add(by_hand=bool(by_hand[k]), **datasets.row_of(found, k))
        pages = [kept[k : k + sheets.PER_PAGE] for k in range(0, len(kept), sheets.PER_PAGE)]
        for number, page in enumerate(progress(pages, len(pages), "drawing")):
            tiles = [
                _tile(found, effects[k], k, bool(by_hand[k]), found.id[k] in doubts) for k in page
            ]
            sheet = partial(sheets.contact_sheet, tiles)
            add.pictures.update(drawn({datasets.SHEETS[number]: sheet}, dpi=90))
    rows = []
    for action, mine in found.select(there).by_action():
        (w, h), drawn_by_hand = mine.roi_size(action), by_hand & there & (found.action == action)
        rows.append((action, len(mine), int(drawn_by_hand.sum()), f"{w}x{h}"))
    print_table(("action", "pairs", "by hand", "ROI (w x h)"), rows)
    for name, why in doubts.items():
        print(f"look at {name}: {why}")
    if unseen:
        print(f"left out, nothing changed: {', '.join(unseen)}")
    print(f"{len(kept)} pairs, and contact_sheet.png to check: {out}")
    return {
        "out": str(out),
        "pairs": len(kept),
        "by_hand": int(by_hand[there].sum()),
        "groups": [dict(zip(("action", "pairs", "by_hand", "roi"), r, strict=True)) for r in rows],
        "look_at": doubts,
        "left_out": unseen,
        "sheets": len(pages),
    }


def _doubts(
    pairs: Pairs, effects: list[Effect], by_hand: np.ndarray, there: np.ndarray
) -> dict[str, str]:
    """Pairs whose found box a person should look at, and why."""
    doubts = {}
    for k in np.flatnonzero(there & ~by_hand):
        size, why = pairs.size[k], []
        if (box := effects[k].box) is None:
            continue
        left, top, w, h = box
        if abs(np.log(w * h / float(size.prod()))) > np.log(1 + _DOUBT):
            why.append(f"its own box is {w}x{h}, the mean {size[0]}x{size[1]}")
        if effects[k].second_mm > 0.5 * effects[k].peak_mm:
            why.append(f"{1 + len(effects[k].others)} places changed")
        at_end = left + w >= pairs.camera.width or top + h >= pairs.camera.height
        if left == 0 or top == 0 or at_end:
            why.append("the effect reaches the image's edge")
        if why:
            doubts[str(pairs.id[k])] = "; ".join(why)
    return doubts


def _tile(pairs: Pairs, effect: Effect, k: int, by_hand: bool, doubt: bool) -> sheets.Tile:
    counts = pairs.prior[k]
    depth = np.where(counts > 0, counts * np.float32(1e3 * pairs.depth_unit), np.nan)
    (u, v), (w, h) = pairs.centre[k].tolist(), pairs.size[k].tolist()
    marks = (" [by hand]" if by_hand else "") + (" [look]" if doubt else "")
    return sheets.Tile(
        f"{pairs.id[k]}: {pairs.action[k]} {w}x{h}{marks}",
        str(pairs.action[k]),
        depth,
        effect.change_mm,
        (u - w // 2, v - h // 2, w, h),
        by_hand,
    )
