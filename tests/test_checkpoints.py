"""Checkpoints: there and back to the bit, and nothing damaged is gone on from."""

import io
import os

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
    folder = keep.path.parent
    assert keep.load() is None and not folder.exists()
    keep.save(arrays, {"fingerprint": "x"})
    found, facts = keep.load()
    assert facts == {"fingerprint": "x"} and set(found) == set(arrays)
    for name, array in arrays.items():
        assert found[name].dtype == array.dtype
        np.testing.assert_array_equal(found[name], array)
    keep.save({**arrays, "curve": np.zeros((2, 4))}, {"fingerprint": "y"})
    found, facts = keep.load()
    assert found["curve"].shape == (2, 4) and facts["fingerprint"] == "y"
    assert os.listdir(folder) == [keep.path.name]  # the older one is gone
    monkeypatch.chdir(folder.parent)
    relative = Checkpoints("bank.training", "poke/ é")
    relative.save(arrays, {})
    assert keep.load()[1] == {}


def test_one_whole_checkpoint_is_there_whenever_the_process_dies(keep, arrays, monkeypatch):
    keep.save(arrays, {"number": 1})
    killed = keep.path.with_name(f".{keep.path.name}.0123456789ab.tmp")
    killed.write_bytes(b"half of it")  # killed while it wrote the next one
    assert keep.load()[1] == {"number": 1} and check_folder(keep.path.parent)

    def fail(*_):
        raise OSError("no space")

    monkeypatch.setattr("jshape.io.files.os.replace", fail)
    with pytest.raises(BadFile, match="no space"):
        keep.save(arrays, {"number": 2})
    assert keep.load()[1] == {"number": 1}
    monkeypatch.undo()
    discard(keep.path.parent)
    assert not keep.path.parent.exists()


def test_a_file_that_cannot_be_made_is_one_line(tmp_path, arrays):
    (tmp_path / "file").write_text("x")
    with pytest.raises(BadFile) as info:
        Checkpoints(tmp_path / "file", "poke").save(arrays, {})
    assert "\n" not in str(info.value)


@pytest.mark.parametrize("at", np.linspace(0, 1, 25))
@pytest.mark.parametrize("how", ["flip", "cut", "empty"])
def test_damage_anywhere_is_one_line(keep, arrays, how, at, capfd):
    """Or it is in what says nothing of the content, such as the date of an NPZ's member."""
    keep.save(arrays, {"fingerprint": "x"})
    content = keep.path.read_bytes()
    place = int(at * (len(content) - 1))
    flipped = content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :]
    keep.path.write_bytes({"flip": flipped, "cut": content[:place], "empty": b""}[how])
    try:
        found, facts = keep.load()
    except BadFile as problem:
        assert str(problem).endswith(f"; remove {keep.path} to start this action again")
        assert "\n" not in str(problem)
    else:
        assert how == "flip" and facts == {"fingerprint": "x"} and set(found) == set(arrays)
        for name, array in arrays.items():
            np.testing.assert_array_equal(found[name], array)
    assert capfd.readouterr() == ("", "")


def test_every_array_is_checked(keep, arrays):
    keep.save(arrays, {})
    content = keep.path.read_bytes()
    for array in arrays.values():
        place = content.index(array.tobytes()) + array.nbytes // 2
        keep.path.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
        with pytest.raises(BadFile, match="CRC"):
            keep.load()


@pytest.mark.parametrize("facts", [None, b"[1]", b"{", b"\xff"])
def test_what_is_no_checkpoint_is_damage(keep, arrays, facts):
    keep.path.parent.mkdir()
    more = {} if facts is None else {"facts.json": np.frombuffer(facts, np.uint8)}
    np.savez(stream := io.BytesIO(), **arrays, **more)
    keep.path.write_bytes(stream.getvalue())
    with pytest.raises(BadFile, match="remove .*action-poke.* to start") as info:
        keep.load()
    assert "\n" not in str(info.value)


def test_only_a_training_is_discarded(tmp_path, keep, arrays):
    folder = keep.path.parent
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
