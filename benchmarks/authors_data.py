"""The data of the paper's authors as a data set: `python -m benchmarks.authors_data SOURCE OUT`.

Their layout is 8-bit crops around each action, and where in the image they lie:

    <agent>/data/<action>/{train,test}/{beg,end}/<instance>/*.png   crops of L, averaged
    <agent>/r_value/<action>/{train,test}/{beg,end}/<instance>.npy  R of the same pixels
    .../<instance>*.xml    action, name, bbox/{xmin,ymin,xmax,ymax} in pixels of the whole image

An instance is a number, with or without `beg` or `end` behind it.  The XML files may lie anywhere
in the folder.  Either they or R say where a crop lies; where both do, they must agree.
"""

import argparse
import os
import re
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from jshape.camera import D435_BAZAR, D435_NOMINAL, Camera
from jshape.errors import BadDataset, BadFile, BadImage, JShapeError, one_line, quoted
from jshape.io.cameras import read_camera
from jshape.io.datasets import dataset_writer
from jshape.io.files import read_bytes
from jshape.io.formats import FILE_LIMIT, parse_npy, read_array
from jshape.io.images import to_counts
from jshape.io.recordings import by_number

SPLITS = ("train", "test")
XML_LIMIT = 2**16
"""Largest annotation that is read, bytes."""
AGREE_PX = 2
"""The annotation and R may differ by this: the authors round halves either way."""

_INSTANCE = re.compile(r"([0-9]+)(beg|end)?(?:[^0-9].*)?")


class AuthorsPair(NamedTuple):
    """One pair of the authors', in a whole image that is empty around it."""

    id: str
    action: str
    agent: str
    prior: np.ndarray
    posterior: np.ndarray
    centre: tuple[int, int]
    size: tuple[int, int]
    clipped: float
    """Share of the crop that is black or white: at or beyond the camera's range."""


class Annotation(NamedTuple):
    """What an XML file says."""

    action: str
    box: tuple[int, int, int, int]
    """(xmin, ymin, xmax, ymax)."""


def depth_unit_for(camera: Camera) -> float:
    """Metres per count: the finest power of ten that holds the camera's range in 16 bits."""
    return next(unit for unit in (1e-5, 1e-4, 1e-3, 1e-2, 1.0) if camera.z_max < 65534 * unit)


def authors_instances(source: str | os.PathLike) -> list[tuple[str, str, Path, Path]]:
    """(agent, action, folder of priors, folder of posteriors) of every instance, in order.

    Raises:
      BadDataset: not this layout, or a prior without its posterior.
    """
    source = Path(source)
    if not source.is_dir():
        raise BadDataset(f"{source}: no such folder")
    agents = [source] if (source / "data").is_dir() else _folders(source)
    found = []
    for agent in agents:
        for action in _folders(agent / "data"):
            for split in SPLITS:
                priors, posteriors = (
                    {_instance(p): p for p in _folders(action / split / state)}
                    for state in ("beg", "end")
                )
                for name in sorted(priors.keys() ^ posteriors.keys()):
                    has, lacks = ("beg", "end") if name in priors else ("end", "beg")
                    raise BadDataset(
                        f"{action / split}: instance {name} is in {has} but not in {lacks}"
                    )
                for name in sorted(priors, key=by_number):
                    who = agent.resolve().name
                    found.append((who, action.name, priors[name], posteriors[name]))
    if not found:
        raise BadDataset(
            f"{source}: holds no instances; expected "
            "AGENT/data/ACTION/{train,test}/{beg,end}/INSTANCE/*.png"
        )
    return found


def authors_pairs(source: str | os.PathLike, camera: Camera) -> Iterator[AuthorsPair]:
    """The authors' pairs, one at a time, as counts of `depth_unit_for(camera)`.

    Args:
      source: folder that holds the agents' folders, or one agent's.
      camera: that took the whole images; its 8-bit luminance is turned into depth.

    Raises:
      BadDataset: not this layout, a file that cannot be read, crops of several sizes, a place that
        is not given, is given twice, or leaves the image.
    """
    source = Path(source)
    instances = authors_instances(source)
    notes = _annotations(source)
    for agent, action, prior, posterior in instances:
        frames, places = [], []
        for state, folder in (("beg", prior), ("end", posterior)):
            crop = _mean_crop(folder)
            frames.append(crop)
            places.append(_place(source, agent, action, state, folder, crop.shape, camera, notes))
        if frames[0].shape != frames[1].shape:
            raise BadDataset(
                f"{posterior}: crops are {_size(frames[1])}; those of {prior} {_size(frames[0])}"
            )
        if np.abs(np.subtract(*places)).max() > AGREE_PX:
            raise BadDataset(f"{posterior}: lies at {places[1]}, but {prior} at {places[0]}")
        (left, top), (h, w) = places[0], frames[0].shape
        levels = np.stack(frames)
        whole = [_whole(crop, (left, top), camera) for crop in frames]
        split = prior.parent.parent.name
        yield AuthorsPair(
            id=f"{agent}_{action}_{split}_{_instance(prior)}",
            action=action,
            agent=agent,
            prior=whole[0],
            posterior=whole[1],
            centre=(left + w // 2, top + h // 2),
            size=(w, h),
            clipped=float(((levels == 0) | (levels == 255)).mean()),
        )


def read_annotation(path: str | os.PathLike) -> Annotation:
    """One of the authors' XML files.

    Raises:
      BadDataset: it cannot be read, declares entities or a document type, or lacks a number.
    """
    path = Path(path)
    try:
        text = read_bytes(path, limit=XML_LIMIT).decode("utf-8-sig")
    except BadFile as problem:
        raise BadDataset(str(problem)) from None
    except UnicodeDecodeError:
        raise BadDataset(f"{path}: is not UTF-8 text") from None
    # Entities can grow without bound or name other files; these annotations need none.
    if re.search(r"<!\s*(doctype|entity)", text, re.IGNORECASE):
        raise BadDataset(f"{path}: declares a document type or entities, which are not read")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, RecursionError) as problem:
        raise BadDataset(f"{path}: not XML that can be read: {one_line(problem)}") from None
    numbers = []
    for name in ("xmin", "ymin", "xmax", "ymax"):
        number = (root.findtext(f"bbox/{name}") or "").strip()
        if not re.fullmatch(r"-?[0-9]{1,6}", number):
            raise BadDataset(f"{path}: bbox/{name} is {quoted(number)}; it must be a whole number")
        numbers.append(int(number))
    if numbers[2] <= numbers[0] or numbers[3] <= numbers[1]:
        raise BadDataset(f"{path}: the box {tuple(numbers)} is empty")
    return Annotation((root.findtext("action") or "").strip(), tuple(numbers))


def place_of_r(r: np.ndarray, camera: Camera, where: str) -> tuple[int, int]:
    """Where in the image a crop of R lies: (left, top).

    R² - 1 = ((u - u0)/fx)² + ((v - v0)/fy)² is a parabola along rows and columns, whose curvature
    tells the focal length and whose vertex the place.  The authors computed R with the nominal
    numbers of the D435, others may with those of `camera`: the curvature says which.

    Args:
      r: (h, w), not divided by its maximum.
      camera: of the whole image.
      where: what to call it in errors.

    Raises:
      BadDataset: it is no such crop.
    """
    square = np.asarray(r, float) ** 2
    if min(square.shape) < 8 or not np.isfinite(square).all():
        raise BadDataset(f"{where}: has shape {square.shape}; a crop of R has 8x8 numbers or more")
    fits = [np.polyfit(np.arange(n), square.mean(axis), 2) for axis, n in
            ((0, square.shape[1]), (1, square.shape[0]))]  # fmt: skip
    focal = [a**-0.5 if a > 0 else np.inf for a, _, _ in fits]
    for known in (D435_NOMINAL, camera):
        if np.allclose(focal, (float(known.fx), float(known.fy)), rtol=0.03):
            left, top = (
                float(middle) + b / (2 * a)
                for (a, b, _), middle in zip(fits, (known.u0, known.v0), strict=True)
            )
            return round(left), round(top)
    raise BadDataset(
        f"{where}: is R of a camera with fx {focal[0]:.0f}, fy {focal[1]:.0f}; expected "
        f"{float(camera.fx):g}, {float(camera.fy):g} or {D435_NOMINAL.fx:g}, {D435_NOMINAL.fy:g}"
    )


def _place(source, agent, action, state, folder, shape, camera, notes) -> tuple[int, int]:
    """(left, top) of an instance's crops, from its annotation, its R, or both."""
    h, w = shape
    number = _instance(folder)
    note = notes.get((agent, action, number, state)) or notes.get((agent, action, number, ""))
    places = []
    if note is not None:
        path, (_, (xmin, ymin, xmax, ymax)) = note
        left, top = int((xmin + xmax - w) / 2), int((ymin + ymax - h) / 2)
        # The authors shift a crop inside, as here.
        left, top = max(min(left, camera.width - w), 0), max(min(top, camera.height - h), 0)
        places.append(((left, top), path))
    home = folder.parents[4] / "r_value" / action / folder.parent.parent.name / state
    for path in (home / f"{folder.name}.npy", home / f"{number}.npy"):
        if path.is_file():
            places.append((place_of_r(_read_r(path, shape), camera, str(path)), path))
            break
    if not places:
        raise BadDataset(
            f"{folder}: nothing says where it lies: no {home / (folder.name + '.npy')}, and no "
            f"XML annotation called {number}{state}*.xml or {number}*.xml for {action}"
        )
    (first, says), (found, path) = places[0], places[-1]  # R is what the authors cut by
    if np.abs(np.subtract(first, found)).max() > AGREE_PX:
        raise BadDataset(f"{folder}: {says} puts it at {first}, but {path} at {found}")
    if min(found) < 0 or found[0] + w > camera.width or found[1] + h > camera.height:
        raise BadDataset(
            f"{folder}: the {w}x{h} crop at {found} leaves the {camera.width}x{camera.height} image"
        )
    return found


def _annotations(source: Path) -> dict[tuple[str, str, str, str], tuple[Path, Annotation]]:
    """Every XML file below a folder by (agent, action, instance, state); state "" is both."""
    found = {}
    single = (source / "data").is_dir()
    for path in sorted(source.rglob("*")):
        match = _INSTANCE.fullmatch(path.stem)
        if not match or path.suffix.lower() != ".xml" or not path.is_file():
            continue
        note = read_annotation(path)
        within = path.relative_to(source).parts
        agent = source.resolve().name if single else within[0]
        state = match[2] or next((s for s in ("beg", "end") if s in within), "")
        for action in {note.action, *within[:-1]}:
            key = agent, action, match[1], state
            # Several frames of one instance repeat its box.
            if action == note.action and key in found and found[key][1].box != note.box:
                raise BadDataset(f"{path}: says {note.box}; {found[key][0]} {found[key][1].box}")
            found.setdefault(key, (path, note))
    return found


def _mean_crop(folder: Path) -> np.ndarray:
    """Mean luminance (h, w) of the PNG files in a folder."""
    files = sorted(p for p in folder.iterdir() if p.suffix.lower() == ".png")
    if not files:
        raise BadDataset(f"{folder}: holds no PNG files")
    total = np.zeros((0, 0))
    for path in files:
        try:
            crop = read_array(path)
        except (BadFile, BadImage) as problem:
            raise BadDataset(str(problem)) from None
        if crop.dtype != np.uint8:
            raise BadDataset(f"{path}: holds {crop.dtype}; the authors' crops have 8 bits")
        if total.size == 0:
            total = np.zeros(crop.shape)
        if crop.shape != total.shape:
            raise BadDataset(f"{path}: is {_size(crop)}; the first of its folder {_size(total)}")
        total += crop
    return total / len(files)


def _read_r(path: Path, shape: tuple[int, int]) -> np.ndarray:
    try:
        r = parse_npy(read_bytes(path, limit=FILE_LIMIT), str(path))
    except (BadFile, BadImage) as problem:
        raise BadDataset(str(problem)) from None
    if r.ndim == 3 and r.shape[2] == 1:
        r = r[..., 0]
    if r.shape != shape:
        raise BadDataset(f"{path}: has shape {r.shape}; the crops of this instance {shape}")
    return r


def _whole(crop: np.ndarray, place: tuple[int, int], camera: Camera) -> np.ndarray:
    """Counts of the whole image, with a crop of luminance at its place and no reading around."""
    depth = np.zeros(camera.shape, np.float32)
    (left, top), (h, w) = place, crop.shape
    depth[top : top + h, left : left + w] = np.asarray(replace(camera, bits=8).depth(crop))
    return to_counts(depth, depth_unit_for(camera))


def _instance(folder: Path) -> str:
    match = _INSTANCE.fullmatch(folder.name)
    return match[1] if match else folder.name


def _folders(parent: Path) -> list[Path]:
    if not parent.is_dir():
        return []
    return sorted(p for p in parent.iterdir() if p.is_dir() and not p.name.startswith("."))


def _size(image: np.ndarray) -> str:
    return f"{image.shape[1]}x{image.shape[0]} pixels"


def import_pairs(
    source: Path, out: Path, camera: Camera = D435_BAZAR, material: str = "flour"
) -> tuple[dict[str, int], float]:
    """Write the authors' pairs as a data set.

    Returns:
      How many of each "agent action", and the share of their pixels at the ends of the range.
    """
    clipped, groups = [], {}
    with dataset_writer(out, camera, depth_unit_for(camera)) as add:
        for pair in authors_pairs(source, camera):
            names = {"action": pair.action, "agent": pair.agent, "material": material}
            (u, v), (w, h) = pair.centre, pair.size
            frames = {"prior": pair.prior, "posterior": pair.posterior}
            add(id=pair.id, **names, **frames, u=u, v=v, width=w, height=h)
            clipped.append(pair.clipped)
            key = f"{pair.agent} {pair.action}"
            groups[key] = groups.get(key, 0) + 1
    return groups, float(np.mean(clipped))


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("source", type=Path, help="the agents' folders, or one agent's")
    parser.add_argument("out", type=Path, help="folder of the new data set")
    parser.add_argument("--camera-file", type=Path, help="instead of the paper's camera")
    parser.add_argument("--material", default="flour")
    options = parser.parse_args(argv)
    try:
        given = options.camera_file
        camera = read_camera(given, 1.0)[0] if given else D435_BAZAR
        groups, clipped = import_pairs(options.source, options.out, camera, options.material)
    except JShapeError as problem:
        print(f"error: {problem}", file=sys.stderr)
        return 2
    counts = ", ".join(f"{count} {name}" for name, count in groups.items())
    print(f"{sum(groups.values())} pairs ({counts}); {clipped:.1%} of their pixels are clipped")
    return 0


if __name__ == "__main__":
    sys.exit(main())
