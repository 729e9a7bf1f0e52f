"""Banks on disk: a folder with `manifest.json`, and `effects.npz` with the arrays of all actions.

The manifest says what the bank is and holds the checksum of every other file; arrays are read only
after their file has matched it, and nothing is unpickled.  What a kind's arrays are is in `kinds`.
"""

import hashlib
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any, ClassVar

import jax.numpy as jnp
import numpy as np

from jshape.errors import BadBank, BadCamera, BadFile, UnknownName, one_line, quoted
from jshape.io.arrays import npz_bytes, read_arrays
from jshape.io.cameras import camera_fields, camera_from
from jshape.io.files import as_error, check_sums, read_bytes, read_json, write_atomic, write_json
from jshape.io.folders import atomic_folder, folder_of
from jshape.io.kinds import KINDS, pack, unpack
from jshape.io.records import OneLine, Range, check_format, read_record
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

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")


@dataclass(frozen=True)
class _Error:
    allow_unknown: ClassVar[bool] = True
    action: str
    mm: Annotated[float, Range(0, 1e6)]  # no bed is deeper
    spread: Annotated[tuple[float, float], Range(0, 1e6)] | None = None
    """(mm, share) of the 80 % interval.  Older manifests have none."""


@dataclass(frozen=True)
class Manifest:
    """What a bank's manifest must hold; more is left to people."""

    allow_unknown: ClassVar[bool] = True

    kind: str
    actions: list[Annotated[str, OneLine()]]
    rois: dict[str, Annotated[tuple[int, int], Range(1)]]
    """(w, h) by action, pixels."""
    camera: dict
    checksums: dict[str, str]
    """SHA-256 of the other files."""
    errors: list[_Error] | None = None
    """The usual error of actions' predictions; it is not known of the others."""

    def problem(self) -> str | None:
        """What no single field tells."""
        if self.kind not in KINDS:
            return f"kind {quoted(self.kind)} is not known; allowed: {', '.join(KINDS)}"
        if not self.actions or len(set(self.actions)) != len(self.actions):
            return f"actions are {quoted(self.actions)}; expected at least one, each once"
        width, height = self.camera.get("width", 0), self.camera.get("height", 0)
        for name in self.actions:
            w, h = self.rois.get(name, (0, 0))
            if not (0 < w <= width and 0 < h <= height):
                size = quoted(self.rois.get(name))
                return f"ROI of {name} is {size}; expected [w, h], at most {width}x{height} pixels"
        if EFFECTS not in self.checksums:
            return f"checksums lacks {EFFECTS}"
        rows = [row.action for row in self.errors or ()]
        odd = [name for name in rows if name not in self.actions or rows.count(name) > 1]
        return f"errors has a row of {quoted(odd[0])}; expected each action once" if odd else None


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
        {"action": its name, "mm": the mean error over its ROI, "spread": [mm, share], ...}, from
        which `load_bank` fills the bank's `errors_mm` and `spread`; without it, it is written from
        them.
      extras: contents of files named in `EXTRAS`.
      overwrite: replace the bank that is there.

    Returns:
      The folder.

    Raises:
      BadBank: what `load_bank` would refuse; `info` takes a reserved name, or `extras` another one
        than those of `EXTRAS`.
      BadCamera: its camera makes no sense.
      BadFile: the folder exists or cannot be written.
    """
    where, info, extras = str(folder), dict(info or {}), dict(extras or {})
    if len(set(bank.actions)) != len(bank.actions) or len(bank.actions) != len(bank.predictors):
        raise BadBank(f"{where}: actions {bank.actions} are not one per predictor, each once")
    manifest: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "kind": bank.kind,
        "actions": list(bank.actions),
        "rois": {name: [int(x) for x in size] for name, size in bank.rois.items()},
        "camera": camera_fields(bank.camera),
        "code_version": _code_version(),
    }
    if clash := sorted((manifest.keys() | {"checksums"}) & info.keys()):
        raise BadBank(f"{where}: info must not set {', '.join(clash)}")
    manifest |= {"data": bank.fitted_to, "licence": ""}
    if errors := _error_rows(bank, where):
        manifest["errors"] = errors  # unless `info` has its own, which may say more
    if other := sorted(extras.keys() - set(EXTRAS)):
        raise BadBank(f"{where}: extra file {quoted(other[0])}; allowed: {', '.join(EXTRAS)}")
    manifest |= info | {"checksums": {EFFECTS: ""}}
    _check(manifest, where)
    contents = {EFFECTS: _packed(bank, where), **{n: _bytes(c) for n, c in extras.items()}}
    manifest["checksums"] = {n: hashlib.sha256(data).hexdigest() for n, data in contents.items()}
    with atomic_folder(folder, overwrite, contents=CONTENTS) as temp:
        for name, data in contents.items():
            write_atomic(temp / name, data)
        write_json(temp / MANIFEST, manifest)
    return Path(folder)


def _packed(bank: Bank, where: str) -> bytes:
    """The NPZ of all actions' arrays."""
    arrays = {}
    for number, (name, predictor) in enumerate(zip(bank.actions, bank.predictors, strict=True)):
        for part, array in pack(predictor, bank.kind).items():
            if not np.isfinite(array).all():
                raise BadBank(f"{where}: {part} of {name} holds NaN or infinity")
            arrays[f"{number}.{part}"] = array
    return npz_bytes(arrays)


def load_bank(name_or_folder: str | os.PathLike) -> Bank:
    """A bundled bank by its name, or a bank from a folder.

    Raises:
      UnknownName: neither a bundled bank nor a folder.
      BadBank: something of it is missing, damaged, of another shape, or from a newer version.
    """
    folder, content, manifest = _open(name_or_folder)
    path = folder / EFFECTS
    with as_error(BadBank):
        arrays = read_arrays(read_bytes(path, limit=FILE_LIMIT), str(path), FILE_LIMIT)
    camera = camera_from(manifest.camera, f"{folder / MANIFEST}: camera")
    predictors = []
    for number, name in enumerate(manifest.actions):
        start = f"{number}."
        mine = {k[len(start) :]: a for k, a in arrays.items() if k.startswith(start)}
        try:
            predictors.append(unpack(manifest.kind, mine, manifest.rois[name], camera))
        except KeyError as missing:
            raise BadBank(f"{folder}: {EFFECTS} has no {missing.args[0]} of {name}") from None
        except BadBank as problem:
            raise BadBank(f"{folder}: action {name}: {problem}") from None
    known = {row.action: row for row in manifest.errors or ()}
    errors = [known[n].mm if n in known else np.nan for n in manifest.actions]
    unknown = (np.nan, np.nan)
    spreads = [(known[n].spread if n in known else None) or unknown for n in manifest.actions]
    return Bank(
        camera,
        tuple(predictors),
        tuple(manifest.actions),
        manifest.kind,
        jnp.array(errors, jnp.float32) if known else None,
        jnp.array(spreads, jnp.float32) if any(x.spread for x in known.values()) else None,
        _in_words(content.get("data", "")),
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
    """What a bank says of itself, its files verified.  Raises as `load_bank`."""
    return _open(name_or_folder)[1]


def _open(name_or_folder: str | os.PathLike) -> tuple[Path, dict[str, Any], Manifest]:
    folder = _find(name_or_folder)
    with as_error(BadBank, BadFile, BadCamera):
        content = read_json(folder / MANIFEST)
        manifest = _check(content, f"{folder / MANIFEST}")
        check_sums(folder, manifest.checksums)
    return folder, content, manifest


def _check(content: dict[str, Any], where: str) -> Manifest:
    check_format(content, FORMAT, VERSION, where, BadBank)
    if isinstance(camera := content.get("camera"), dict):
        camera_from(camera, f"{where}: camera")
    return read_record(Manifest, content, where, error=BadBank)


def _find(name_or_folder: str | os.PathLike) -> Path:
    """The folder of a bank.  A name of both a bundled one and a bank's folder here is refused."""
    text = isinstance(name_or_folder, str)
    if text and _NAME.fullmatch(name_or_folder):
        for root in _bundled_roots():
            if (root / name_or_folder / MANIFEST).is_file():
                return _alone(name_or_folder, root / name_or_folder)
    named = text and name_or_folder and "\0" not in name_or_folder
    if not (named or isinstance(name_or_folder, os.PathLike)) or (
        text and _NAME.fullmatch(name_or_folder) and not os.path.lexists(name_or_folder)
    ):
        raise UnknownName("bank", name_or_folder, list_banks())
    with as_error(BadBank):
        return folder_of(name_or_folder, "a bank", MANIFEST)


def _alone(name: str, bundled: Path) -> Path:
    """The folder of a bundled bank, unless one in the working directory has its name."""
    here = Path(name)
    if (here / MANIFEST).is_file() and here.resolve() != bundled.resolve():
        raise BadBank(
            f"{name}: is a bundled bank and a folder here; write ./{name} for the folder, or "
            "rename it for the bundled one"
        )
    return bundled


def _bundled_roots() -> tuple[Path, ...]:
    """Where banks come with the program: in the installed package, or in the repository."""
    package = Path(__file__).resolve().parents[1]
    roots = [package / "weights"]
    if (package.parent / "pyproject.toml").is_file():
        roots.append(package.parent / "weights")
    return tuple(root for root in roots if root.is_dir())


def _error_rows(bank: Bank, where: str) -> list[dict[str, Any]]:
    """The errors of a bank that are known, for its manifest."""
    if bank.errors_mm is None:
        return []
    count = len(bank.actions)
    if np.shape(bank.errors_mm) != (count,):
        raise BadBank(f"{where}: errors_mm has shape {np.shape(bank.errors_mm)}, not one an action")
    spread = np.full((count, 2), np.nan) if bank.intervals is None else np.asarray(bank.intervals)
    if spread.shape != (count, 2):
        raise BadBank(f"{where}: spread has shape {spread.shape}, not (mm, share) of each action")
    errors = np.asarray(bank.errors_mm, np.float64).tolist()
    return [
        {"action": name, "mm": mm} | ({} if np.isnan(pair).all() else {"spread": pair})
        for name, mm, pair in zip(bank.actions, errors, spread.astype(float).tolist(), strict=True)
        if not np.isnan(mm)
    ]


def _bytes(content: bytes | str) -> bytes:
    return content.encode() if isinstance(content, str) else content


def _code_version() -> str:
    try:
        return metadata.version("jshape")
    except metadata.PackageNotFoundError:
        return "unknown"
