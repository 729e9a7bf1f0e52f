"""Banks on disk: a folder with `manifest.json`, and `effects.npz` with the arrays of all actions.

The manifest says what the bank is and holds the checksum of every other file; arrays are read only
after their file has matched it, and nothing is unpickled.  What a kind's arrays are is in `kinds`.
"""

import hashlib
import io
import os
import re
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from jshape.errors import BadBank, BadCamera, BadFile, UnknownName, is_name, one_line, quoted
from jshape.io.arrays import read_arrays
from jshape.io.cameras import camera_fields, camera_from
from jshape.io.files import inside, read_bytes, read_json, sha256, write_atomic, write_json
from jshape.io.folders import atomic_folder
from jshape.io.kinds import KINDS, Kind
from jshape.models.bank import Bank

FORMAT = "jshape-bank"
VERSION = 1
MANIFEST = "manifest.json"
EFFECTS = "effects.npz"
EXTRAS = ("card.md", "curve.csv", "curve.png")
"""For people: what the bank is and how good, and training curves."""
CONTENTS = (MANIFEST, EFFECTS, *EXTRAS)
"""What a bank's folder holds."""
FILE_LIMIT = 1024 * 2**20
"""Largest array file that is read, and largest that it may unpack to, bytes."""
LARGEST_ERROR_MM = 1e6
"""Larger errors of prediction are refused: no bed is that deep."""

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")


def save_bank(
    bank: Bank,
    folder: str | os.PathLike,
    *,
    info: Mapping[str, Any] | None = None,
    extras: Mapping[str, bytes | str] | None = None,
    overwrite: bool = False,
) -> Path:
    """Write a bank as a folder, whole or not at all.

    Args:
      bank: what to save.
      folder: where; it must not hold anything unless `overwrite`.
      info: more for the manifest: `data` (what it was fitted to), `licence`, or anything else that
        JSON can hold and that is not a name of the manifest's own.  `errors` is a list of
        {"action": its name, "mm": the mean error over its ROI, ...}, from which `load_bank` fills
        the bank's `errors_mm`; without it, it is written from them.
      extras: contents of files named in `EXTRAS`.
      overwrite: replace the bank that is there.

    Returns:
      The folder.

    Raises:
      BadBank: what `load_bank` would refuse: a kind that cannot be saved, no actions, a ROI larger
        than the image, an effect that is not finite; or `info` takes a reserved name, or `extras`
        another one than those of `EXTRAS`.
      BadCamera: its camera makes no sense.
      BadFile: the folder exists or cannot be written.
    """
    where = str(folder)
    kind = _kind(bank.kind, where)
    if len(set(bank.actions)) != len(bank.actions) or len(bank.actions) != len(bank.predictors):
        raise BadBank(f"{where}: actions {bank.actions} are not one per predictor, each once")
    arrays = {}
    for number, (name, predictor) in enumerate(zip(bank.actions, bank.predictors, strict=True)):
        for part, array in kind.pack(predictor).items():
            if not np.isfinite(array).all():
                raise BadBank(f"{where}: {part} of {name} holds NaN or infinity")
            arrays[f"{number}.{part}"] = array
    manifest: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "kind": bank.kind,
        "actions": list(bank.actions),
        "rois": {name: [int(x) for x in size] for name, size in bank.rois.items()},
        "camera": camera_fields(bank.camera),
        "data": bank.fitted_to,
        "code_version": _code_version(),
        "licence": "",
    }
    taken = set(manifest) - {"data", "licence"} | {"checksums"}
    if errors := _error_rows(bank, where):
        manifest["errors"] = errors  # unless `info` has its own, which may say more
    clash = sorted(taken & set(info or {}))
    if clash:
        raise BadBank(f"{where}: info must not set {', '.join(clash)}")
    stream = io.BytesIO()
    np.savez_compressed(stream, allow_pickle=False, **arrays)
    others = {name: _bytes(content) for name, content in (extras or {}).items()}
    for name in others:
        if name not in EXTRAS:
            raise BadBank(f"{where}: extra file {quoted(name)}; allowed: {', '.join(EXTRAS)}")
    contents = {EFFECTS: stream.getvalue(), **others}
    checksums = {name: hashlib.sha256(data).hexdigest() for name, data in contents.items()}
    manifest |= dict(info or {}) | {"checksums": checksums}
    _check_manifest(manifest, where)
    with atomic_folder(folder, overwrite, contents=CONTENTS) as temp:
        for name, data in contents.items():
            write_atomic(temp / name, data)
        write_json(temp / MANIFEST, manifest)
    return Path(folder)


def load_bank(name_or_folder: str | os.PathLike) -> Bank:
    """A bundled bank by its name, or a bank from a folder.

    Raises:
      UnknownName: neither a bundled bank nor a folder.
      BadBank: something of it is missing, damaged, of another shape, or from a newer version.
    """
    folder, manifest = _open(name_or_folder)
    where = str(folder)
    kind = _kind(manifest["kind"], where)
    path = folder / EFFECTS
    try:
        arrays = read_arrays(read_bytes(path, limit=FILE_LIMIT), str(path), FILE_LIMIT)
    except BadFile as problem:
        raise BadBank(str(problem)) from None
    camera = camera_from(manifest["camera"], f"{folder / MANIFEST}: camera")
    predictors = []
    for number, name in enumerate(manifest["actions"]):
        start = f"{number}."
        mine = {k[len(start) :]: a for k, a in arrays.items() if k.startswith(start)}
        w, h = manifest["rois"][name]
        try:
            predictors.append(kind.unpack(mine, (w, h), camera))
        except KeyError as missing:
            raise BadBank(f"{where}: {EFFECTS} has no {missing.args[0]} of {name}") from None
        except BadBank as problem:
            raise BadBank(f"{where}: action {name}: {problem}") from None
    actions = tuple(manifest["actions"])
    known = {row["action"]: row["mm"] for row in manifest.get("errors", ())}
    errors = jnp.array([known.get(name, np.nan) for name in actions], jnp.float32)
    return Bank(
        camera,
        tuple(predictors),
        actions,
        manifest["kind"],
        errors if known else None,
        _in_words(manifest.get("data", "")),
    )


def _in_words(data: Any) -> str:
    """What a manifest says of the pairs, for people."""
    if isinstance(data, Mapping):
        data = ", ".join(f"{k}: {v if isinstance(v, str) else quoted(v)}" for k, v in data.items())
    return one_line(data, 120)


def list_banks() -> tuple[str, ...]:
    """Names of the bundled banks."""
    found = {
        path.parent.name
        for root in _bundled_roots()
        for path in root.glob(f"*/{MANIFEST}")
        if _NAME.fullmatch(path.parent.name)
    }
    return tuple(sorted(found))


def bank_manifest(name_or_folder: str | os.PathLike) -> dict[str, Any]:
    """What a bank says of itself, its files verified.

    Raises:
      UnknownName, BadBank: as for `load_bank`.
    """
    return _open(name_or_folder)[1]


def _open(name_or_folder: str | os.PathLike) -> tuple[Path, dict[str, Any]]:
    folder = _find(name_or_folder)
    try:
        manifest = read_json(folder / MANIFEST)
        _check_manifest(manifest, f"{folder / MANIFEST}")
        for name, expected in manifest["checksums"].items():
            if sha256(inside(folder, name)) != expected:
                raise BadBank(f"{folder / name}: checksum differs from the manifest's; damaged?")
    except (BadFile, BadCamera) as problem:
        raise BadBank(str(problem)) from None
    return folder, manifest


def _find(name_or_folder: str | os.PathLike) -> Path:
    """The folder of a bank.  A name of both a bundled one and a bank's folder here is refused."""
    if isinstance(name_or_folder, str):
        if _NAME.fullmatch(name_or_folder):
            for root in _bundled_roots():
                if (root / name_or_folder / MANIFEST).is_file():
                    _check_alone(name_or_folder, root / name_or_folder)
                    return root / name_or_folder
            if not os.path.lexists(name_or_folder):
                raise UnknownName("bank", name_or_folder, list_banks())
        elif not name_or_folder or "\0" in name_or_folder:
            raise UnknownName("bank", name_or_folder, list_banks())
    elif not isinstance(name_or_folder, os.PathLike):
        raise UnknownName("bank", name_or_folder, list_banks())
    folder = Path(name_or_folder)
    if not folder.is_dir():
        what = "is a file; a bank is a folder" if folder.exists() else "no such bank folder"
        raise BadBank(f"{folder}: {what}")
    if not (folder / MANIFEST).is_file():
        raise BadBank(f"{folder}: has no {MANIFEST}, so it is not a bank")
    return folder


def _check_alone(name: str, bundled: Path) -> None:
    """Refuse a bundled bank's name that a bank in the working directory has too."""
    here = Path(name)
    if (here / MANIFEST).is_file() and here.resolve() != bundled.resolve():
        raise BadBank(
            f"{name}: is a bundled bank and a folder here; write ./{name} for the folder, or "
            "rename it for the bundled one"
        )


def _bundled_roots() -> tuple[Path, ...]:
    """Where banks come with the program: in the installed package, or in the repository."""
    package = Path(__file__).resolve().parents[1]
    roots = [package / "weights"]
    if (package.parent / "pyproject.toml").is_file():
        roots.append(package.parent / "weights")
    return tuple(root for root in roots if root.is_dir())


def _check_manifest(manifest: dict[str, Any], where: str) -> None:
    """Everything that the manifest must hold, in the types that the loader counts on."""
    if manifest.get("format") != FORMAT:
        raise BadBank(f"{where}: format is {quoted(manifest.get('format'))}; expected {FORMAT!r}")
    version = manifest.get("version")
    if not isinstance(version, int) or isinstance(version, bool) or version < 1:
        raise BadBank(f"{where}: version is {quoted(version)}; expected a whole number from 1")
    if version > VERSION:
        raise BadBank(
            f"{where}: version {quoted(version)} is newer than this program reads "
            f"({VERSION}); update it"
        )
    types = {"kind": str, "actions": list, "rois": dict, "camera": dict, "checksums": dict}
    for name, kind in types.items():
        if name not in manifest:
            raise BadBank(f"{where}: missing {name}")
        if not isinstance(manifest[name], kind):
            raise BadBank(f"{where}: {name} is a {type(manifest[name]).__name__}")
    actions = manifest["actions"]
    if not actions or not all(map(is_name, actions)):
        raise BadBank(f"{where}: actions must be names, at least one; they are {quoted(actions)}")
    if len(set(actions)) != len(actions):
        raise BadBank(f"{where}: an action is named twice")
    camera = camera_from(manifest["camera"], f"{where}: camera")
    for name in actions:
        size = manifest["rois"].get(name)
        whole = isinstance(size, list) and [type(x) for x in size] == [int, int]
        if not whole or not (0 < size[0] <= camera.width and 0 < size[1] <= camera.height):
            raise BadBank(
                f"{where}: ROI of {name} is {quoted(size)}; expected [w, h], at most "
                f"{camera.width}x{camera.height} pixels"
            )
    if EFFECTS not in manifest["checksums"]:
        raise BadBank(f"{where}: checksums lacks {EFFECTS}")
    _check_errors(manifest.get("errors", []), actions, where)


def _check_errors(rows: Any, actions: list[str], where: str) -> None:
    """Rows of an action's name and its usual error; actions may be missing, as not known."""
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise BadBank(f"{where}: errors must be a list of rows with action and mm")
    names = [row.get("action") for row in rows]
    for name, row in zip(names, rows, strict=True):
        if name not in actions or names.count(name) > 1:
            raise BadBank(f"{where}: errors has a row of {quoted(name)}; expected each action once")
        mm = row.get("mm")
        number = isinstance(mm, int | float) and not isinstance(mm, bool)
        if not number or not 0 <= mm <= LARGEST_ERROR_MM:
            raise BadBank(f"{where}: error of {name} is {quoted(mm)}; expected mm, a number from 0")


def _error_rows(bank: Bank, where: str) -> list[dict[str, Any]]:
    """The errors of a bank that are known, for its manifest."""
    if bank.errors_mm is None:
        return []
    if np.shape(bank.errors_mm) != (len(bank.actions),):
        raise BadBank(f"{where}: errors_mm has shape {np.shape(bank.errors_mm)}, not one an action")
    known = zip(bank.actions, np.asarray(bank.errors_mm, np.float64).tolist(), strict=True)
    return [{"action": name, "mm": mm} for name, mm in known if not np.isnan(mm)]


def _kind(name: str, where: str) -> Kind:
    if name not in KINDS:
        raise BadBank(f"{where}: kind {quoted(name)} is not known; allowed: {', '.join(KINDS)}")
    return KINDS[name]


def _bytes(content: bytes | str) -> bytes:
    return content.encode() if isinstance(content, str) else content


def _code_version() -> str:
    try:
        return metadata.version("jshape")
    except metadata.PackageNotFoundError:
        return "unknown"
