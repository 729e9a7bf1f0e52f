"""Banks on disk: there and back to the bit, and nothing damaged is loaded."""

import hashlib
import io
import json
import os
import zipfile
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jshape
from benchmarks.experiments import banks as recipes
from jshape import Bank, Camera, list_banks, load_bank, save_bank
from jshape.data.simulate import ALL_ROIS
from jshape.errors import BadBank, BadFile, UnknownName
from jshape.io import banks
from jshape.io.banks import bank_manifest
from jshape.learn.scores import Score
from jshape.models import unet
from jshape.models.difference import Difference
from jshape.models.network import Network
from jshape.models.refined import Refined

CAMERA = Camera(40, 30, 50.0, 50.0, 19.5, 14.5, 0.4, 0.5)
SIZES = {"grasp": (12, 9), "poke/ é": (3, 4)}


@pytest.fixture
def bank(rng):
    effects = [rng.normal(0, 0.1, (h, w)).astype(np.float32) for w, h in SIZES.values()]
    predictors = tuple(Difference(jnp.asarray(effect)) for effect in effects)
    return Bank(CAMERA, predictors, tuple(SIZES), "D")


@pytest.fixture
def folder(tmp_path, bank):
    return save_bank(bank, tmp_path / "bank")


def same(a, b):
    assert (a.actions, a.kind, a.camera) == (b.actions, b.kind, b.camera)
    for name in a.actions:
        np.testing.assert_array_equal(a.predictor(name).delta, b.predictor(name).delta)
        assert a.roi(name) == b.roi(name)


def edit(folder, **change):
    """Change the manifest; None takes a field away."""
    path = folder / "manifest.json"
    fields = json.loads(path.read_text()) | change
    path.write_text(json.dumps({k: v for k, v in fields.items() if v is not None}))


def replace_arrays(folder, content=None, **arrays):
    """Other arrays, with the checksum that goes with them."""
    if content is None:
        stream = io.BytesIO()
        np.savez(stream, **arrays)
        content = stream.getvalue()
    (folder / "effects.npz").write_bytes(content)
    edit(folder, checksums={"effects.npz": hashlib.sha256(content).hexdigest()})


def refused(folder, match, error=BadBank):
    with pytest.raises(error) as info:
        load_bank(folder)
    message = str(info.value)
    assert match in message and "\n" not in message
    return message


def test_round_trip(folder, bank):
    found = load_bank(folder)
    same(found, bank)
    same(load_bank(str(folder)), bank)
    roi = np.full((9, 12), 0.5, np.float32)
    np.testing.assert_array_equal(found.predict("grasp", roi), bank.predict("grasp", roi))


def test_a_bank_is_written_alike_every_time(tmp_path, bank, folder):
    again = save_bank(bank, tmp_path / "again")
    for name in ("manifest.json", "effects.npz"):
        assert (folder / name).read_bytes() == (again / name).read_bytes()


def test_the_manifest_says_what_the_bank_is(tmp_path, bank):
    info = {"data": {"pairs": 40, "agents": ["robot"]}, "licence": "Apache-2.0", "notes": "x"}
    folder = save_bank(bank, tmp_path / "bank", info=info)
    manifest = bank_manifest(folder)
    assert manifest["format"] == "jshape-bank" and manifest["version"] == 1
    assert manifest["kind"] == "D" and manifest["actions"] == list(SIZES)
    assert manifest["rois"]["grasp"] == [12, 9]
    assert manifest["camera"]["z_min"] == 0.4
    assert {k: manifest[k] for k in info} == info
    assert manifest["code_version"]
    assert set(manifest["checksums"]) == {"effects.npz"}
    assert sorted(os.listdir(folder)) == ["effects.npz", "manifest.json"]


def test_errors_are_kept(tmp_path, bank, folder):
    """As the manifest has them, there and back; where they are not known, NaN or None."""
    assert load_bank(folder).errors_mm is None and "errors" not in bank_manifest(folder)
    rows = [{"action": "poke/ é", "mm": 1, "f_D_mm": 2.5}]
    named = save_bank(bank, tmp_path / "named", info={"errors": rows})
    assert bank_manifest(named)["errors"] == rows
    found = load_bank(named)
    assert found.errors_mm.dtype == jnp.float32
    np.testing.assert_array_equal(found.errors_mm, [np.nan, 1.0])
    again = save_bank(found, tmp_path / "again")
    assert bank_manifest(again)["errors"] == [{"action": "poke/ é", "mm": 1.0}]
    np.testing.assert_array_equal(load_bank(again).errors_mm, [np.nan, 1.0])
    both = replace(bank, errors_mm=jnp.array([0.7407529, 0.0], jnp.float32))
    save_bank(both, again, overwrite=True)
    np.testing.assert_array_equal(load_bank(again).errors_mm, both.errors_mm)
    save_bank(both, again, info={"errors": rows}, overwrite=True)  # told otherwise
    np.testing.assert_array_equal(load_bank(again).errors_mm, [np.nan, 1.0])
    save_bank(replace(bank, errors_mm=jnp.full(2, np.nan)), again, overwrite=True)
    assert load_bank(again).errors_mm is None


@pytest.mark.parametrize("name", [n for n in list_banks() if n != "flour-robot"])
def test_bundled_banks_know_their_errors(name):
    rows = {row["action"]: row for row in bank_manifest(name)["errors"]}
    found = load_bank(name)
    assert found.actions == tuple(rows)
    np.testing.assert_allclose(found.errors_mm, [r["mm"] for r in rows.values()], rtol=1e-6)
    assert (np.asarray(found.error_of_d()) > 0).all()
    np.testing.assert_array_equal(
        found.intervals, np.float32([row["spread"] for row in rows.values()])
    )


def test_the_bundled_bank_of_eight_actions_moves_material():
    bank = load_bank("moving-flour-robot")
    assert bank.actions == tuple(ALL_ROIS) and bank.rois == ALL_ROIS
    assert {a: p.path_mm for a, p in zip(bank.actions, bank.predictors, strict=True)} == {
        name: 85.0 if name == "sweep" else 0.0 for name in ALL_ROIS
    }
    one_way = [name for name in bank.actions if bank.predictor(name).directed]
    assert one_way == ["grasp", "sweep", "scoop"]  # the thumb of a grasp comes from one side
    level, per_cm3 = 0.445, 1e-6

    def brought(name, length=1.0):
        """cm3 that a flat bed gains."""
        one = bank.predictor(name)
        one = one if length == 1 else one.lengthened(length)
        change = np.asarray(one.change(np.full(one.grid.shape, level, np.float32)))
        return -change.sum() * float(one.grid.pitch) ** 2 / per_cm3

    # The simulator's: 58 cm3 of loose flour are poured, about 40 scooped; a sweep packs some.
    assert 50 < brought("pour") < 66 and -60 < brought("scoop") < -35
    assert 2 * brought("sweep") < brought("sweep", 1.6) < brought("sweep") < 0


def test_a_card_tells_errors_over_strengths():
    bank = load_bank("pressed-flour-robot")
    rows = [{"action": a, "mm": 0.5, "f_D_mm": 2.0, "change_mm": 3.0} for a in bank.actions]
    table = {x: [Score(a, "robot", 10, x, 0.1, 4 * x) for a in bank.actions] for x in (0.5, 2.0)}
    text = recipes.card(recipes.RECIPES[0], bank, rows, table, pairs=200, tested=25)
    assert "0.2 to 2 times as deep" in text and "on 10 other pairs each" in text
    assert "| action | 0.5 | 1 | 2 |\n|---|---|---|---|\n" in text
    assert "| knock | 0.50 / 2.00 | 0.50 / 3.00 | 2.00 / 8.00 |" in text
    moving = recipes.card(recipes.RECIPES[-1], bank, rows, table, pairs=75, tested=25)
    assert moving.startswith("# moving-flour-robot\n\nWhat eight actions of a robot do to flour")


def test_an_existing_bank_is_replaced_only_on_demand(tmp_path, bank, folder):
    other = replace(bank, actions=("a", "b"))
    with pytest.raises(BadFile, match="exists"):
        save_bank(other, folder)
    same(load_bank(folder), bank)
    save_bank(other, folder, overwrite=True)
    same(load_bank(folder), other)
    (tmp_path / "file").write_text("x")
    with pytest.raises(BadFile):
        save_bank(bank, tmp_path / "file" / "below")
    with pytest.raises(BadFile, match="not replaced"):
        save_bank(bank, tmp_path, overwrite=True)
    (folder / "notes.md").write_text("mine")
    with pytest.raises(BadFile, match="also holds notes.md"):
        save_bank(bank, folder, overwrite=True)
    same(load_bank(folder), other)
    assert (folder / "notes.md").read_text() == "mine"


def test_training_curves_are_kept_and_checked(tmp_path, bank):
    curves = {"curve.csv": "action,epoch\n", "curve.png": b"PNG"}
    folder = save_bank(bank, tmp_path / "bank", extras=curves)
    assert set(bank_manifest(folder)["checksums"]) == {"effects.npz", *curves}
    assert (folder / "curve.csv").read_text() == curves["curve.csv"]
    same(load_bank(folder), bank)
    save_bank(bank, folder, overwrite=True)
    assert sorted(os.listdir(folder)) == ["effects.npz", "manifest.json"]
    with pytest.raises(BadBank, match="extra file '../x'; allowed: card.md, curve.csv, curve.png"):
        save_bank(bank, tmp_path / "other", extras={"../x": b""})
    save_bank(bank, folder, extras=curves, overwrite=True)
    (folder / "curve.csv").write_text("other")
    refused(folder, "curve.csv: checksum differs")


@pytest.fixture
def networks(tmp_path):
    """A saved bank of kind CR, and its arrays."""
    first = Difference(jnp.zeros((9, 12)))
    inside = Network(unet.init(jax.random.key(0), 2), (12, 9))
    refined = Refined(inside, first, jnp.ones((9, 12)), jnp.asarray(0.1))
    folder = save_bank(Bank(CAMERA, (refined,), ("grasp",), "CR"), tmp_path / "networks")
    with np.load(folder / "effects.npz") as arrays:
        return folder, dict(arrays)


def test_bad_networks_are_refused(networks):
    folder, good = networks
    assert load_bank(folder).kind == "CR"
    kernel = "network.down.0.first.kernel"
    for change, match in (
        ({f"0.{kernel}": None}, f"has no {kernel} of grasp"),
        (
            {f"0.{kernel}": np.zeros((3, 3, 1, 5))},
            f"{kernel} has shape (3, 3, 1, 5); expected (3, 3",
        ),
        ({f"0.{kernel}": np.full((3, 3, 1, 2), np.nan)}, f"{kernel} holds NaN"),
        ({"0.network.output.kernel": np.zeros((1, 1, 10**6, 1))}, "expected (1, 1, width, 1)"),
        ({"0.network.output.kernel": np.zeros(3)}, "expected (1, 1, width, 1)"),
        ({"0.mask": np.full((9, 12), 2)}, "mask holds something else than 0 and 1"),
        ({"0.mask": np.zeros((12, 9))}, "mask has shape (12, 9)"),
        ({"0.offset": None}, "has no offset of grasp"),
        ({"0.offset": np.zeros(2)}, "offset has shape (2,)"),
        ({"0.delta": None}, "has no delta of grasp"),
    ):
        arrays = {k: v for k, v in (good | change).items() if v is not None}
        replace_arrays(folder, **arrays)
        refused(folder, match)


def test_a_failed_save_leaves_the_old_bank(bank, folder, monkeypatch):
    def fail(*_):
        raise BadFile("no space")

    monkeypatch.setattr(banks, "write_json", fail)
    with pytest.raises(BadFile, match="no space"):
        save_bank(replace(bank, actions=("a", "b")), folder, overwrite=True)
    with pytest.raises(BadFile, match="no space"):
        save_bank(bank, folder.parent / "new")
    same(load_bank(folder), bank)
    assert os.listdir(folder.parent) == ["bank"]


def test_what_could_not_be_loaded_again_is_not_saved(tmp_path, bank):
    broken = Difference(jnp.full((3, 4), jnp.nan))
    for bad, match in (
        (replace(bank, kind="Q"), "kind 'Q' is not known; allowed: D"),
        (replace(bank, actions=("a", "a")), "each once"),
        (replace(bank, actions=("a",)), "one per predictor"),
        (replace(bank, predictors=(broken, broken)), "delta of grasp holds NaN"),
        (replace(bank, predictors=(), actions=()), r"actions are \[\]; expected at least one"),
        (replace(bank, actions=("a", "")), "action 2 is ''; expected a line of text"),
        (replace(bank, errors_mm=jnp.ones(3)), r"errors_mm has shape \(3,\)"),
        (
            replace(bank, errors_mm=jnp.array([1.0, -1.0])),
            "error 2: mm is -1.0; expected a number from 0 to 1e[+]06",
        ),
        (replace(bank, errors_mm=jnp.array([jnp.inf, 1.0])), "error 1: mm is inf"),
        (replace(bank, camera=replace(CAMERA, width=11)), r"ROI of grasp is \(12, 9\).*11x30"),
    ):
        with pytest.raises(BadBank, match=match):
            save_bank(bad, tmp_path / "bank")
    with pytest.raises(BadBank, match="info must not set camera, kind"):
        save_bank(bank, tmp_path / "bank", info={"kind": "C", "camera": 1})
    with pytest.raises(BadFile, match="JSON"):
        save_bank(bank, tmp_path / "bank", info={"data": float("nan")})
    assert os.listdir(tmp_path) == []


@pytest.fixture
def bundled(tmp_path, bank, monkeypatch):
    root = tmp_path / "weights"
    save_bank(bank, root / "flour-D")
    save_bank(bank, root / "sand-D")
    (root / "empty").mkdir()
    monkeypatch.setattr(banks, "_bundled_roots", lambda: (root,))
    return root


def test_bundled_banks_go_by_name(bundled, bank, tmp_path, monkeypatch):
    assert list_banks() == ("flour-D", "sand-D")
    same(load_bank("flour-D"), bank)
    assert bank_manifest("flour-D")["kind"] == "D"
    for name in ("snow-D", "", "empty", "a\0b"):
        with pytest.raises(UnknownName, match="unknown bank.*allowed: flour-D, sand-D"):
            load_bank(name)
    monkeypatch.chdir(tmp_path)
    save_bank(replace(bank, actions=("a", "b")), tmp_path / "mine")
    assert load_bank("mine").actions == ("a", "b")  # a folder here, where no bundled bank is meant


def test_a_name_of_two_banks_is_refused(bundled, bank, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "flour-D").mkdir()
    same(load_bank("flour-D"), bank)  # a folder, but no bank
    (tmp_path / "flour-D").rmdir()
    mine = replace(bank, actions=("a", "b"))
    save_bank(mine, "flour-D")
    refused("flour-D", "flour-D: is a bundled bank and a folder here; write ./flour-D")
    with pytest.raises(BadBank, match="./flour-D"):
        bank_manifest("flour-D")
    same(load_bank("./flour-D"), mine)
    same(load_bank(tmp_path / "flour-D"), mine)
    same(load_bank("sand-D"), bank)
    monkeypatch.chdir(bundled)
    same(load_bank("flour-D"), bank)  # one and the same


def test_a_name_does_not_reach_outside(bundled, tmp_path, bank):
    save_bank(bank, tmp_path / "secret")
    for name in ("../secret", "flour-D/../../secret"):
        refused(name, "no such folder")


def test_banks_of_the_repository_load():
    for name in list_banks():
        found = jshape.load_bank(name)
        assert found.actions and bank_manifest(name)["licence"]


def test_where_bundled_banks_are_looked_for(tmp_path, monkeypatch):
    package = tmp_path / "site-packages" / "jshape" / "store"
    package.mkdir(parents=True)
    monkeypatch.setattr(banks, "__file__", str(package / "banks.py"))
    (tmp_path / "site-packages" / "weights").mkdir()  # somebody else's
    assert banks._bundled_roots() == ()
    (package.parent / "weights").mkdir()
    assert banks._bundled_roots() == (package.parent / "weights",)
    (tmp_path / "site-packages" / "pyproject.toml").write_text("")
    assert len(banks._bundled_roots()) == 2


def test_no_bank(tmp_path):
    (tmp_path / "file").write_text("x")
    (tmp_path / "empty").mkdir()
    refused(tmp_path / "none", "no such folder")
    refused(tmp_path / "file", "is a file; a bank is a folder")
    refused(tmp_path / "empty", "no manifest.json")


def test_a_changed_file_is_not_loaded(folder):
    content = bytearray((folder / "effects.npz").read_bytes())
    content[len(content) // 2] ^= 1
    (folder / "effects.npz").write_bytes(content)
    refused(folder, "effects.npz: checksum differs")


def test_a_missing_file_is_named(folder):
    (folder / "effects.npz").unlink()
    refused(folder, "effects.npz")


@pytest.mark.parametrize(
    "change, match",
    [
        ({"format": None}, "format is None"),
        ({"format": "other"}, "expected 'jshape-bank'"),
        ({"version": 2}, "version 2 is newer than this program reads (1)"),
        ({"version": "1"}, "version is '1'"),
        ({"version": None}, "version is None"),
        ({"kind": None}, "missing kind"),
        ({"kind": "Q"}, "kind 'Q' is not known; allowed: D, C"),
        ({"kind": "CR"}, "effects.npz has no network.output.kernel of grasp"),
        ({"kind": 3}, "kind is 3; expected text"),
        ({"actions": None}, "missing actions"),
        ({"actions": []}, "at least one"),
        ({"actions": [1, 2]}, "action 1 is 1; expected a line of text"),
        ({"actions": ["poke\x1b[2J", "knock"]}, r"action 1 is 'poke\x1b[2J'"),
        ({"actions": ["grasp", "grasp"]}, "each once"),
        ({"actions": ["grasp", "knock"]}, "ROI of knock is None"),
        ({"rois": [1]}, "rois is [1]; expected an object"),
        (
            {"rois": {"grasp": [12, 9], "poke/ é": [3.0, 4]}},
            "rois: poke/ é is [3.0, 4]; expected 2 whole numbers",
        ),
        ({"rois": {"grasp": [41, 9], "poke/ é": [3, 4]}}, "at most 40x30"),
        ({"rois": {"grasp": [0, 9], "poke/ é": [3, 4]}}, "rois: grasp is [0, 9]"),
        ({"rois": {"grasp": [9, 12], "poke/ é": [3, 4]}}, "action grasp: delta has shape (9, 12)"),
        ({"camera": None}, "missing camera"),
        ({"camera": {"width": 40}}, "camera: missing height"),
        ({"camera": {**vars(CAMERA), "fx": -1}}, "fx is -1"),
        ({"checksums": {}}, "checksums lacks effects.npz"),
        ({"checksums": {"effects.npz": 3}}, "checksums: effects.npz is 3; expected text"),
        ({"checksums": {"effects.npz": "", "../x": ""}}, "checksum differs"),
        ({"errors": {"grasp": 1.0}}, "errors is {'grasp': 1.0}; expected a list"),
        ({"errors": [1.0, 2.0]}, "error 1: is 1.0; expected an object with action, mm"),
        ({"errors": [{"action": "knock", "mm": 1}]}, "row of 'knock'; expected each action once"),
        ({"errors": [{"mm": 1}]}, "error 1: missing action"),
        (
            {"errors": [{"action": ["grasp"], "mm": 1}]},
            "error 1: action is ['grasp']; expected text",
        ),
        ({"errors": [{"action": "grasp", "mm": 1}] * 2}, "row of 'grasp'; expected each"),
        ({"errors": [{"action": "grasp"}]}, "error 1: missing mm"),
        ({"errors": [{"action": "grasp", "mm": "1"}]}, "error 1: mm is '1'; expected a number"),
        ({"errors": [{"action": "grasp", "mm": True}]}, "error 1: mm is True"),
        ({"errors": [{"action": "grasp", "mm": -0.1}]}, "error 1: mm is -0.1"),
        ({"errors": [{"action": "grasp", "mm": 1e300}]}, "error 1: mm is 1e+300"),
        ({"errors": [{"action": "grasp", "mm": 10**400}]}, "error 1: mm is 1000"),
        (
            {"checksums": {"../../etc/passwd": "", "effects.npz": ""}},
            "must lead into the folder",
        ),
    ],
    ids=str,
)
def test_a_bad_manifest_is_refused(folder, change, match):
    edit(folder, **change)
    refused(folder, match)


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b'{"a": NaN}', b"\xff"])
def test_a_manifest_that_is_no_json(folder, content):
    (folder / "manifest.json").write_bytes(content)
    refused(folder, "manifest.json")


def test_bad_arrays_are_refused(folder):
    good = np.zeros((9, 12), np.float32), np.zeros((4, 3), np.float32)
    nan = good[0].copy()
    nan[2, 3] = np.nan
    replace_arrays(folder, **{"0.delta": good[0], "1.delta": good[1]})
    load_bank(folder)
    for arrays, match in (
        ({"0.delta": good[0]}, "has no delta of poke"),
        ({}, "has no delta of grasp"),
        ({"0.delta": good[0].T, "1.delta": good[1]}, "action grasp: delta has shape (12, 9)"),
        ({"0.delta": nan, "1.delta": good[1]}, "action grasp: delta holds NaN"),
        ({"0.delta": good[0] == 0, "1.delta": good[1]}, "not a number"),
        ({"0.delta": good[0], "1.delta": np.array([[print]])}, "not a readable NPZ"),
    ):
        replace_arrays(folder, **arrays)
        refused(folder, match)
    raw, packed = io.BytesIO(), io.BytesIO()
    with zipfile.ZipFile(raw, "w") as archive:
        archive.writestr("0.delta", b"not an array")
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("0.delta.npy", bytes(1000))
    contents = b"x", b"PK\x03\x04", np.zeros(3).tobytes(), raw.getvalue(), packed.getvalue()
    for content in contents:
        replace_arrays(folder, content)
        refused(folder, "not a readable NPZ")
    replace_arrays(folder, b"")
    refused(folder, "empty")


def test_an_archive_that_unpacks_too_far_is_refused(folder, monkeypatch):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("0.delta.npy", bytes(10**6))
    monkeypatch.setattr(banks, "FILE_LIMIT", 10**5)
    replace_arrays(folder, stream.getvalue())
    refused(folder, "unpacks to 1,000,000 bytes")


def test_a_pipe_in_place_of_the_arrays_is_not_waited_for(folder):
    (folder / "effects.npz").unlink()
    os.mkfifo(folder / "effects.npz")
    refused(folder, "effects.npz: is not a regular file")


def test_a_bank_reached_through_a_link_out_of_it_is_refused(folder):
    (folder / "effects.npz").rename(folder.parent / "elsewhere.npz")
    (folder / "effects.npz").symlink_to(folder.parent / "elsewhere.npz")
    refused(folder, "must lead into the folder")
