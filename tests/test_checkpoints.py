"""Checkpoints: there and back to the bit, and nothing damaged is gone on from."""

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


def assert_same(found, arrays):
    assert set(found) == set(arrays)
    for name, array in arrays.items():
        assert found[name].dtype == array.dtype
        np.testing.assert_array_equal(found[name], array)


def test_round_trip(keep, arrays, monkeypatch):
    folder = keep.path.parent
    assert keep.load() is None and not folder.exists()
    keep.save(arrays, {"fingerprint": "x"})
    found, facts = keep.load()
    assert facts == {"fingerprint": "x"}
    assert_same(found, arrays)
    keep.save({**arrays, "curve": np.zeros((2, 4))}, {"fingerprint": "y"})
    found, facts = keep.load()
    assert found["curve"].shape == (2, 4) and facts["fingerprint"] == "y"
    assert len(os.listdir(folder)) == 1  # the older one is gone
    monkeypatch.chdir(folder.parent)
    Checkpoints("bank.training", "poke/ é").save(arrays, {})
    assert keep.load()[1] == {}


def test_one_whole_checkpoint_is_there_whenever_the_process_dies(keep, arrays, monkeypatch):
    keep.save(arrays, {"number": 1})

    def killed(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("jshape.io.files.os.replace", killed)
        patch.setattr("jshape.io.files.remove_file", lambda path: None)
        with pytest.raises(KeyboardInterrupt):
            keep.save(arrays, {"number": 2})
    folder = keep.path.parent
    assert len(os.listdir(folder)) == 2 and keep.load()[1] == {"number": 1}
    assert check_folder(folder)  # what is left of the write is the training's, too
    discard(folder)
    assert not folder.exists()


def test_a_file_that_cannot_be_made_is_one_line(tmp_path, arrays):
    (tmp_path / "file").write_text("x")
    with pytest.raises(BadFile) as info:
        Checkpoints(tmp_path / "file", "poke").save(arrays, {})
    assert "\n" not in str(info.value)


def test_damage_anywhere_is_one_line_or_harmless(keep, arrays, capfd):
    keep.save(arrays, {"fingerprint": "x"})
    content, refused = keep.path.read_bytes(), 0
    damaged = [content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :]
               for at in range(0, len(content), 3)]  # fmt: skip
    for data in (*damaged, b"", b"x", content[: len(content) // 2], content[:-1]):
        keep.path.write_bytes(data)
        try:
            found, facts = keep.load()
        except BadFile as problem:
            refused += 1
            assert str(problem).endswith("; remove it to start this action again")
            assert str(problem).startswith(keep.where) and "\n" not in str(problem)
        else:  # times and the like, which the archive keeps beside the arrays
            assert_same(found, arrays)
            assert facts == {"fingerprint": "x"}
    assert refused > 0.7 * len(damaged)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("more", [{}, {"facts": np.frombuffer(b"[1]", np.uint8)}])
def test_an_archive_of_somebody_else_is_no_checkpoint(keep, arrays, more):
    keep.path.parent.mkdir()
    np.savez(keep.path, **arrays, **more)
    with pytest.raises(BadFile, match="remove it to start this action again"):
        keep.load()


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
