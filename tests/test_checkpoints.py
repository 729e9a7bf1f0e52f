"""Checkpoints: there and back to the bit, and nothing damaged is gone on from."""

import hashlib
import json
import os
import shutil

import numpy as np
import pytest

from jshape.errors import BadFile
from jshape.io.checkpoints import Checkpoints, check_folder, discard


@pytest.fixture
def arrays(rng):
    return {
        "params.0": rng.random((3, 3, 2, 5)).astype(np.float32),
        "optimizer.0": np.asarray(7, np.int32),
        "curve": np.array([[1, 0.5, np.nan, 2.0]]),
    }


@pytest.fixture
def keep(tmp_path):
    return Checkpoints(tmp_path / "bank.training", "poke/ é")


def test_round_trip(keep, arrays, monkeypatch):
    assert keep.load() is None and not keep.folder.exists()
    keep.save(arrays, {"fingerprint": "x"})
    found, facts = keep.load()
    assert facts == {"fingerprint": "x"} and set(found) == set(arrays)
    for name, array in arrays.items():
        assert found[name].dtype == array.dtype
        np.testing.assert_array_equal(found[name], array)
    keep.save({**arrays, "curve": np.zeros((2, 4))}, {"fingerprint": "y"})
    found, facts = keep.load()
    assert found["curve"].shape == (2, 4) and facts["fingerprint"] == "y"
    assert len(os.listdir(keep.folder)) == 1  # the older one is gone
    monkeypatch.chdir(keep.folder.parents[1])  # Orbax itself fails on relative paths
    relative = Checkpoints("bank.training", "poke/ é")
    relative.save(arrays, {})
    assert keep.load()[1] == {}


def test_one_whole_checkpoint_is_there_whenever_the_process_dies(keep, arrays, monkeypatch):
    keep.save(arrays, {"number": 1})
    monkeypatch.setattr("jshape.io.checkpoints.shutil.rmtree", lambda *a, **k: None)
    keep.save(arrays, {"number": 2})  # killed before the older one was removed
    assert len(os.listdir(keep.folder)) == 2 and keep.load()[1] == {"number": 2}
    monkeypatch.undo()

    def fail(*_):
        raise BadFile("no space")

    monkeypatch.setattr("jshape.io.checkpoints.write_json", fail)
    with pytest.raises(BadFile, match="no space"):
        keep.save(arrays, {"number": 3})
    assert keep.load()[1] == {"number": 2}


def test_a_file_that_cannot_be_made_is_one_line(tmp_path, arrays):
    (tmp_path / "file").write_text("x")
    with pytest.raises(BadFile) as info:
        Checkpoints(tmp_path / "file", "poke").save(arrays, {})
    assert "\n" not in str(info.value)


@pytest.mark.parametrize("how", ["flip", "cut", "gone", "empty"])
def test_damage_anywhere_is_one_line(keep, arrays, how, capfd):
    keep.save(arrays, {"fingerprint": "x"})
    place = next(keep.folder.iterdir())
    files = [path for path in place.rglob("*") if path.is_file()]
    assert len(files) > 5
    for path in files:
        content = path.read_bytes()
        middle = len(content) // 2
        if how == "gone":
            path.unlink()
        elif how == "cut":
            path.write_bytes(content[:middle])
        elif how == "flip":
            flipped = bytes([content[middle] ^ 1]) if content else b"x"
            path.write_bytes(content[:middle] + flipped + content[middle + 1 :])
        else:
            path.write_bytes(b"" if content else b"x")
        if path.read_bytes() != content if path.exists() else True:
            with pytest.raises(BadFile, match="remove .*action-poke.* to start") as info:
                keep.load()
            assert "\n" not in str(info.value)
        path.write_bytes(content)
    assert keep.load()[1] == {"fingerprint": "x"}
    assert capfd.readouterr() == ("", "")


def test_what_orbax_cannot_read_is_one_line(keep, arrays):
    keep.save(arrays, {})
    place = next(keep.folder.iterdir())
    for path in (place / "arrays").rglob("*"):
        if path.is_file():
            path.unlink()
    (place / "arrays" / "notes").write_text("x")
    sums = {"arrays/notes": hashlib.sha256(b"x").hexdigest()}
    (place / "checkpoint.json").write_text(
        json.dumps({"format": "jshape-checkpoint", "facts": {}, "checksums": sums})
    )
    with pytest.raises(BadFile, match="not a readable checkpoint") as info:
        keep.load()
    assert "\n" not in str(info.value)


@pytest.mark.parametrize("how", ["facts", "list", "no sums", "one sum less", "a file more"])
def test_what_no_checksum_covers_is_damage(keep, arrays, how):
    keep.save(arrays, {})
    path = next(keep.folder.iterdir()) / "checkpoint.json"
    content = json.loads(path.read_text())
    if how == "facts":
        content["facts"] = [1]
    elif how == "list":
        content = [content]
    elif how == "no sums":
        content["checksums"] = {}
    elif how == "one sum less":
        content["checksums"].popitem()
    else:
        (path.parent / "arrays" / "more").write_text("x")
    path.write_text(json.dumps(content))
    with pytest.raises(BadFile, match="remove .*action-poke.* to start") as info:
        keep.load()
    assert "\n" not in str(info.value)


def test_a_damaged_checkpoint_beside_an_older_whole_one(keep, arrays, monkeypatch):
    keep.save(arrays, {"number": 1})
    with monkeypatch.context() as patch:
        patch.setattr("jshape.io.checkpoints.shutil.rmtree", lambda *a, **k: None)
        keep.save(arrays, {"number": 2})
    first, second = sorted(keep.folder.iterdir())
    (second / "checkpoint.json").write_text("{")
    with pytest.raises(BadFile) as info:
        keep.load()
    assert str(info.value).endswith(f"; remove {second} to go on from the one before")
    shutil.rmtree(second)
    assert keep.load()[1] == {"number": 1}
    assert first.is_dir()


def test_only_a_training_is_discarded(tmp_path, keep, arrays):
    folder = keep.folder.parent
    discard(folder)
    assert check_folder(folder) is False
    keep.save(arrays, {})
    assert check_folder(folder) is True
    (folder / "notes.md").write_text("mine")
    for call in (check_folder, discard):
        with pytest.raises(BadFile, match="is for checkpoints, but holds notes.md"):
            call(folder)
    assert keep.load() is not None
    (folder / "notes.md").unlink()
    discard(folder)
    assert not folder.exists()
    (tmp_path / "file").write_text("x")
    with pytest.raises(BadFile, match="not a folder"):
        check_folder(tmp_path / "file")
