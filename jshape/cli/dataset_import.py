"""`jshape dataset import` and `jshape dataset merge`."""

import argparse
from collections import Counter
from pathlib import Path
from typing import Any

from jshape.cli import arguments
from jshape.cli.tables import progress
from jshape.data.missing import said as said_of
from jshape.errors import BadDataset, one_line, quoted
from jshape.io import annotations, cameras, datasets, folders, imports, recordings
from jshape.io.recordings import LEAVE_OUT, Label
from jshape.io.tables import check_action


def import_dataset(options: argparse.Namespace) -> dict[str, Any]:
    """`jshape dataset import SOURCE OUT`."""
    folders.check_target(options.out, options.overwrite, contents=annotations.FOUND_CONTENTS)
    found = imports.before_after_files(options.source)
    camera, unit = imports.before_after_camera(options.source, options.camera)
    labels = _labels(options, list(found))
    kept = {name: paths for name, paths in found.items() if labels[name].action != LEAVE_OUT}
    still, left_out = [], Counter()
    with annotations.found_writer(options.out, camera, unit, overwrite=options.overwrite) as add:
        pairs = imports.before_after_pairs(kept, camera, unit, left_out)
        for pair in progress(pairs, len(kept), "importing"):
            (left, top, w, h), label = pair.box, labels[pair.name]
            if (w, h) == (camera.width, camera.height):
                still.append(pair.name)
            add(
                id=pair.name, action=label.action, agent=label.agent, material=label.material,
                prior=pair.prior, posterior=pair.posterior,
                u=left + w // 2, v=top + h // 2, width=w, height=h,
            )  # fmt: skip
    said = [f"{len(kept)} pairs"]
    if gaps := sum(left_out.values()):
        said.append(f"{gaps} pixels without depth{said_of(left_out)}")
    if still:
        said.append(f"no single place that changed in {one_line(', '.join(still), 80)}")
    said.append("next: jshape dataset annotate")
    if not options.json:
        print("; ".join(said) + f": {options.out}")
    return {
        "out": str(options.out),
        "pairs": len(kept),
        "without_effect": still,
        "left_out": left_out,
    }


def _labels(options: argparse.Namespace, names: list[str]) -> dict[str, Label]:
    """The label of every name, from a file with the columns name and action, or one for all."""
    if options.labels is not None:
        if options.action is not None:
            raise BadDataset("--action and --labels are two ways to say it; give one of them")
        labels = recordings.read_labels(options.labels, options.agent, options.material, named=True)
        lacking = [name for name in names if name not in labels]
        unknown = [name for name in labels if name not in names]
        if lacking or unknown:
            what = (
                f"no row for {quoted(lacking[0])}"
                if lacking
                else f"no frames for {quoted(unknown[0])}"
            )
            raise BadDataset(f"{options.labels}: {what} ({len(names)} names in {options.source})")
        return labels
    for name in ("action", "agent", "material"):
        if not (getattr(options, name) or "").strip():
            hint = ", or --labels FILE with the columns name and action" * (name == "action")
            raise BadDataset(f"what was done? give --{name}{hint}")
    check_action(options.action, "--action")
    return dict.fromkeys(names, Label(options.action, options.agent, options.material))


def merge(options: argparse.Namespace) -> dict[str, Any]:
    """`jshape dataset merge OUT DATASET...`."""
    folders.check_target(options.out, options.overwrite, contents=annotations.FOUND_CONTENTS)
    parts = [datasets.load_pairs(folder) for folder in options.datasets]
    first = parts[0]
    for folder, pairs in zip(options.datasets, parts, strict=True):
        fields = (cameras.camera_fields(p.camera) | {"depth_unit": p.depth_unit}
                  for p in (first, pairs))  # fmt: skip
        differs = [(k, a, b) for (k, a), b in zip(*_items(*fields), strict=True) if a != b]
        if differs:
            name, ours, theirs = differs[0]
            raise BadDataset(
                f"{folder}: another camera: its {name} is {theirs}, that of "
                f"{options.datasets[0]} {ours}"
            )
    seen = set()
    with annotations.found_writer(
        options.out, first.camera, first.depth_unit, overwrite=options.overwrite
    ) as add:
        for folder, pairs in zip(options.datasets, parts, strict=True):
            by_hand = annotations.boxes_by_hand(folder)
            for k in range(len(pairs)):
                name = str(pairs.id[k])
                name = name if name not in seen else f"{folder.resolve().name}/{name}"
                if name in seen:
                    raise BadDataset(f"{folder}: pair {quoted(name)} is there twice")
                seen.add(name)
                add(by_hand=bool(by_hand[k]), **datasets.row_of(pairs, k) | {"id": name})
    if not options.json:
        print(f"{len(seen)} pairs of {len(parts)} data sets: {options.out}")
    return {"out": str(options.out), "pairs": len(seen)}


def _items(ours: dict[str, Any], theirs: dict[str, Any]) -> tuple[list, list]:
    return list(ours.items()), [theirs[name] for name in ours]


def add(commands: Any) -> None:
    """The parsers, below `jshape dataset`."""
    parser = arguments.command(
        commands, "import", import_dataset, "pairs that others recorded, as a data set"
    )
    parser.add_argument(
        "source",
        type=Path,
        help="camera.json with NAME_before.png and NAME_after.png, or before/ and after/",
    )
    parser.add_argument("out", type=Path, help="folder of the new data set")
    parser.add_argument("--camera-file", "--camera", dest="camera", type=Path, metavar="FILE",
                        help="camera.json instead of SOURCE's own")  # fmt: skip
    parser.add_argument("--action", help="what was done, every time")
    parser.add_argument("--agent", help="who or what did it")
    parser.add_argument("--material", help="flour, sand ...")
    parser.add_argument(
        "--labels", type=Path, metavar="FILE",
        help="instead of --action: a CSV with the columns name and action (agent and material if "
        "need be); '-' leaves one out",
    )  # fmt: skip
    parser = arguments.command(commands, "merge", merge, "one data set of several of one camera")
    parser.add_argument("out", type=Path, help="folder of the new data set")
    parser.add_argument("datasets", type=Path, nargs="+", metavar="DATASET")
