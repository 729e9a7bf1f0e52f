"""`jshape dataset import` and `jshape dataset merge`."""

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from jshape.camera import Camera
from jshape.cli.names import Action
from jshape.cli.options import CameraFile, File, Writes
from jshape.cli.tables import progress
from jshape.data.missing import said as said_of
from jshape.errors import BadDataset, one_line, quoted
from jshape.io import annotations, cameras, datasets, folders, imports, recordings
from jshape.io.recordings import LEAVE_OUT, Label
from jshape.io.tables import check_action


@dataclass(frozen=True, kw_only=True)
class Labelled(Writes):
    """What was done in every pair, and by whom."""

    action: Action | None = None
    """Action that was done in every pair."""
    agent: str | None = None
    """Who or what acted: human, robot ..."""
    material: str | None = None
    """Material of the bed: flour, sand ..."""
    labels: Annotated[Path | None, File] = None
    """CSV with a column action instead of --action (and agent and material, if need be): for an
    import also a column name; for a recording one row per action, in order.  '-' leaves one out."""
    like: Annotated[Path | None, Parameter(metavar="DATASET")] = None
    """Data set that the new one is to be merged with: frames are seen as by its camera."""


@dataclass(frozen=True, kw_only=True)
class DatasetImportOptions(Labelled):
    """Of `jshape dataset import`."""

    camera_file: Annotated[Path | None, CameraFile] = None
    """camera.json (default: SOURCE's own)."""


def import_dataset(
    source: Path, out: Path, /, options: DatasetImportOptions = DatasetImportOptions()
) -> dict[str, Any]:
    """`jshape dataset import SOURCE OUT`.

    Args:
      source: Folder: camera.json with NAME_before.png and NAME_after.png, or before/ and after/.
      out: Folder of the new data set.
    """
    folders.check_target(out, options.overwrite, contents=datasets.CONTENTS)
    found = imports.before_after_files(source)
    seen = imports.before_after_view(source, found, options.camera_file, like_of(options))
    labels = _by_name(options, source, list(found))
    kept = {name: paths for name, paths in found.items() if labels[name].action != LEAVE_OUT}
    still, left_out = [], Counter()
    with datasets.dataset_writer(
        out, seen.camera, seen.depth_unit, overwrite=options.overwrite
    ) as add:
        pairs = imports.before_after_pairs(kept, seen, left_out)
        for pair in progress(pairs, len(kept), "importing"):
            if pair.box[2:] == (seen.camera.width, seen.camera.height):
                still.append(pair.name)
            label, place = labels[pair.name], placed(pair.box)
            frames = {"prior": pair.prior, "posterior": pair.posterior}
            add(id=pair.name, by_hand=False, **frames, **label._asdict(), **place)
    said = [f"{len(kept)} pairs"]
    if gaps := sum(left_out.values()):
        said.append(f"{gaps} pixels without depth{said_of(left_out)}")
    if still:
        said.append(f"no single place that changed in {one_line(', '.join(still), 80)}")
    said.append("next: jshape dataset annotate")
    print("; ".join(said) + f": {out}")
    return {
        "out": str(out), "pairs": len(kept), "without_effect": still, "left_out": left_out,
        "view": seen.said,
    }  # fmt: skip


def like_of(options: Labelled) -> tuple[Camera, float] | None:
    """Camera and depth unit of the data set that `--like` names."""
    if options.like is None:
        return None
    folder = folders.folder_of(options.like, "a data set", cameras.CAMERA, datasets.TABLE)
    return cameras.read_camera(folder / cameras.CAMERA)


def labels_of(options: Labelled, file: str, *, named: bool = False) -> dict[str, Label] | Label:
    """The labels of a file, by name if it is `named`, else by number; or the one of everything.

    `file` is what `--labels` could be given, where nothing is said.
    """
    if options.labels is not None:
        if options.action is not None:
            raise BadDataset("--action and --labels are two ways to say it; give one of them")
        return recordings.read_labels(options.labels, options.agent, options.material, named=named)
    one = Label(options.action or "", options.agent or "", options.material or "")
    for name, text in one._asdict().items():
        if not text.strip():
            hint = f", or --labels {file}" * (name == "action")
            raise BadDataset(f"what was done? give --{name}{hint}")
    check_action(one.action, "--action")
    return one


def _by_name(options: DatasetImportOptions, source: Path, names: list[str]) -> dict[str, Label]:
    labels = labels_of(options, "FILE with the columns name and action", named=True)
    if isinstance(labels, Label):
        return dict.fromkeys(names, labels)
    for whose, known, what in ((names, labels, "row"), (labels, names, "frames")):
        for name in (name for name in whose if name not in known):
            what = f"no {what} for {quoted(name)} ({len(names)} names in {source})"
            raise BadDataset(f"{options.labels}: {what}")
    return labels


def placed(box: tuple[int, int, int, int]) -> dict[str, Any]:
    """A box (left, top, width, height) as the columns of a data set."""
    left, top, w, h = box
    return {"u": left + w // 2, "v": top + h // 2, "width": w, "height": h}


def merge(out: Path, dataset: Path, /, *more: Path, options: Writes = Writes()) -> dict[str, Any]:
    """`jshape dataset merge OUT DATASET...`.

    Args:
      out: Folder of the new data set.
      dataset: First data set.
      more: The others.
    """
    whole = (dataset, *more)
    folders.check_target(out, options.overwrite, contents=datasets.CONTENTS)
    parts = [datasets.load_pairs(folder) for folder in whole]
    first = parts[0]
    fields = [
        # Where it stood says nothing of pairs.
        cameras.camera_fields(replace(p.camera, pose=None)) | {"depth_unit": p.depth_unit}
        for p in parts
    ]
    for folder, theirs in zip(whole, fields, strict=True):
        for name, ours in fields[0].items():
            if theirs[name] != ours:
                what = f"its {name} is {theirs[name]}, that of {dataset} {ours}"
                raise BadDataset(f"{folder}: another camera: {what}")
    seen = set()
    with datasets.dataset_writer(
        out, first.camera, first.depth_unit, overwrite=options.overwrite
    ) as add:
        for folder, pairs in zip(whole, parts, strict=True):
            by_hand = annotations.boxes_by_hand(folder)
            for k in range(len(pairs)):
                name = str(pairs.id[k])
                name = name if name not in seen else f"{folder.resolve().name}/{name}"
                if name in seen:
                    raise BadDataset(f"{folder}: pair {quoted(name)} is there twice")
                seen.add(name)
                add(by_hand=bool(by_hand[k]), **datasets.row_of(pairs, k) | {"id": name})
    print(f"{len(seen)} pairs of {len(parts)} data sets: {out}")
    return {"out": str(out), "pairs": len(seen)}
