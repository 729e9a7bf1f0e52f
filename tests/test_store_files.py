"""Files and folders appear whole or not at all, and nothing leads out of its folder."""

import errno
import json
import os
import shutil
import socket
import subprocess
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jshape.errors import BadFile
from jshape.io import files, folders, journal


def one_line(info) -> str:
    message = str(info.value)
    assert "\n" not in message and message
    return message


def _full(handle):
    raise OSError(28, "No space left on device")


@pytest.fixture
def broken_disk(monkeypatch):
    """Every sync fails, as on a full disk."""
    monkeypatch.setattr(files.os, "fsync", _full)


def test_write_atomic_replaces_and_makes_folders(tmp_path):
    path = tmp_path / "a" / "b.txt"
    files.write_atomic(path, "old")
    files.write_atomic(path, b"new")
    assert path.read_bytes() == b"new"
    assert os.listdir(path.parent) == ["b.txt"]


def test_a_failed_write_leaves_what_was_there(tmp_path, broken_disk):
    path = tmp_path / "b.txt"
    path.write_text("old")
    with pytest.raises(BadFile, match="No space left") as info:
        files.write_atomic(path, "new")
    assert str(path) in one_line(info)
    with pytest.raises(BadFile):
        files.write_atomic(tmp_path / "new" / "deep" / "c.txt", "new")
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["b.txt"]


def test_an_interrupted_rename_leaves_nothing(tmp_path, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(files.os, "replace", interrupt)
    with pytest.raises(KeyboardInterrupt):
        files.write_atomic(tmp_path / "b.txt", "new")
    assert os.listdir(tmp_path) == []


def test_a_file_is_not_written_over_a_folder_or_under_a_file(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("x")
    for path in (tmp_path / "folder", tmp_path / "file" / "below"):
        with pytest.raises(BadFile) as info:
            files.write_atomic(path, "new")
        one_line(info)
    assert sorted(os.listdir(tmp_path)) == ["file", "folder"]


def test_a_symbolic_link_is_replaced_and_not_followed(tmp_path):
    (tmp_path / "target").write_text("kept")
    (tmp_path / "link").symlink_to("target")
    files.write_atomic(tmp_path / "link", "new")
    assert (tmp_path / "target").read_text() == "kept"
    assert (tmp_path / "link").read_text() == "new"


def test_atomic_folder_appears_whole(tmp_path):
    target = tmp_path / "deep" / "folder"
    with folders.atomic_folder(target) as temp:
        (temp / "sub").mkdir()
        (temp / "sub" / "a").write_text("1")
        assert not target.exists()
    assert (target / "sub" / "a").read_text() == "1"
    assert os.listdir(target.parent) == ["folder"]


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_failure_inside_leaves_the_old_folder(tmp_path, overwrite):
    target = tmp_path / "folder"
    if overwrite:
        target.mkdir()
        (target / "old").write_text("old")
    with pytest.raises(RuntimeError):
        with folders.atomic_folder(target, overwrite) as temp:
            (temp / "half").write_text("half")
            raise RuntimeError("in the middle")
    assert os.listdir(tmp_path) == (["folder"] if overwrite else [])
    assert not overwrite or (target / "old").read_text() == "old"


def test_a_failed_last_rename_puts_the_old_folder_back(tmp_path, monkeypatch):
    target = tmp_path / "folder"
    target.mkdir()
    (target / "old").write_text("old")
    rename, calls = os.rename, []

    def second_fails(source, to):
        calls.append(to)
        if len(calls) == 2:
            raise OSError(5, "Input/output error")
        rename(source, to)

    monkeypatch.setattr(folders.os, "rename", second_fails)
    with pytest.raises(BadFile, match="Input/output.*kept in ") as info:
        with folders.atomic_folder(target, overwrite=True) as temp:
            (temp / "new").write_text("new")
    assert len(calls) == 3 and os.listdir(target) == ["old"]
    assert kept_of(info) == {"new": "new"} and len(os.listdir(tmp_path)) == 2


def kept_of(info) -> dict[str, str]:
    """The files of the folder that an error says was kept."""
    kept = Path(one_line(info).split("what was made is kept in ")[1])
    return {path.name: path.read_text() for path in kept.iterdir()}


def test_a_full_disk_in_the_block_leaves_no_folder_and_no_parents(tmp_path, monkeypatch):
    with pytest.raises(BadFile, match="No space left"):
        with folders.atomic_folder(tmp_path / "a" / "b") as temp:
            monkeypatch.setattr(files.os, "fsync", _full)
            files.write_atomic(temp / "x", "x")
    assert os.listdir(tmp_path) == []


def test_a_full_disk_at_the_end_keeps_what_was_made(tmp_path, monkeypatch):
    with pytest.raises(BadFile, match="No space left") as info:
        with folders.atomic_folder(tmp_path / "a" / "b") as temp:
            (temp / "x").write_text("x")
            monkeypatch.setattr(files.os, "fsync", _full)
    assert kept_of(info) == {"x": "x"} and not (tmp_path / "a" / "b").exists()


NO_RENAME = [errno.EBUSY, errno.EXDEV, errno.EACCES, errno.EPERM, errno.EROFS]


@pytest.mark.parametrize("code", NO_RENAME)
@pytest.mark.parametrize("there", [None, "nothing", "an earlier result"])
def test_where_no_folder_can_be_renamed_the_content_is_moved(tmp_path, monkeypatch, code, there):
    target = tmp_path / "volume"
    if there is not None:
        (target / "sub").mkdir(parents=True)
        (target / "sub" / "a").write_text("old")
        (target / "result").write_text("old")
    if there == "nothing":
        shutil.rmtree(target)
        target.mkdir()
    rename = os.rename

    def of_folders_fails(source, to):
        if target in (Path(source), Path(to)):
            raise OSError(code, os.strerror(code))
        rename(source, to)

    monkeypatch.setattr(folders.os, "rename", of_folders_fails)
    names = ("result", "sub")
    with folders.atomic_folder(target, bool(there), contents=names) as temp:
        (temp / "sub").mkdir()
        (temp / "sub" / "b").write_text("new")
        (temp / "result").write_text("new")
    assert sorted(os.listdir(target)) == ["result", "sub"] and os.listdir(tmp_path) == ["volume"]
    assert (target / "result").read_text() == "new" and os.listdir(target / "sub") == ["b"]


@pytest.fixture
def volume(tmp_path):
    """A mounted folder, as a container's volume is."""
    place = tmp_path / "volume"
    place.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(place)]
    if not shutil.which("mount") or subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("nothing can be mounted here")
    yield place
    subprocess.run(["umount", str(place)], check=True)


def test_a_mounted_folder_is_written_into(volume):
    (volume / "lost+found").mkdir()  # every new ext4 volume has it
    for content, overwrite in (("1", False), ("2", True)):
        with folders.atomic_folder(volume, overwrite, contents=("result",)) as temp:
            assert temp.parent == volume
            (temp / "result").write_text(content)
        assert sorted(os.listdir(volume)) == ["lost+found", "result"]
        assert (volume / "result").read_text() == content
    with pytest.raises(BadFile, match="not empty"):
        folders.check_target(volume)
    with pytest.raises(BadFile, match="No space left") as info:
        with folders.atomic_folder(volume / "full") as temp:
            files.write_atomic(temp / "large", bytes(2**21))
    assert str(volume) in one_line(info) and not (volume / "full").exists()


def test_a_failed_move_puts_everything_back(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "result").write_text("old")
    move = shutil.move

    def breaks(source, to):
        if Path(source).name == "two" and Path(to).parent == tmp_path:
            raise OSError(5, "Input/output error")
        return move(source, to)

    monkeypatch.setattr(folders.shutil, "move", breaks)
    with pytest.raises(BadFile, match="Input/output") as info:
        with folders.atomic_folder(".", True, contents=("result", "one", "two")) as temp:
            for name in ("result", "one", "two"):
                (temp / name).write_text("new")
    assert (tmp_path / "result").read_text() == "old"
    assert kept_of(info) == {"result": "new", "one": "new", "two": "new"}
    assert len(os.listdir(tmp_path)) == 2  # "result" and what is kept


@pytest.mark.parametrize("spelling", [".", "{}", "../{name}", "link"])
def test_the_folder_that_the_shell_is_in_stays(tmp_path, monkeypatch, spelling):
    here = tmp_path / "here"
    here.mkdir()
    (tmp_path / "link").symlink_to(here)
    monkeypatch.chdir(here)
    node = here.stat().st_ino
    target = "../link" if spelling == "link" else spelling.format(here, name="here")
    for content, overwrite in (("1", False), ("2", True)):
        with folders.atomic_folder(target, overwrite, contents=("result",)) as temp:
            (temp / "result").write_text(content)
        assert Path("result").read_text() == content and os.listdir(here) == ["result"]
    assert here.stat().st_ino == node == os.stat(".").st_ino


def test_a_folder_around_the_shell_is_not_replaced(tmp_path, monkeypatch):
    (tmp_path / "rec" / "frames").mkdir(parents=True)
    (tmp_path / "rec" / "result").write_text("1")
    monkeypatch.chdir(tmp_path / "rec" / "frames")
    with pytest.raises(BadFile, match="command is run in"):
        folders.check_target("..", True, contents=("result", "frames"))


def test_a_folder_whose_parent_is_read_only_is_written_into(tmp_path, monkeypatch):
    target = tmp_path / "mine"
    target.mkdir()
    mkdir = Path.mkdir

    def refused(path, *more, **options):  # root may write everywhere
        if path.parent == tmp_path:
            raise PermissionError(13, "Permission denied")
        mkdir(path, *more, **options)

    monkeypatch.setattr(Path, "mkdir", refused)
    with folders.atomic_folder(target) as temp:
        (temp / "result").write_text("1")
    assert os.listdir(target) == ["result"] and os.listdir(tmp_path) == ["mine"]
    with pytest.raises(BadFile, match="cannot be made: Permission denied"):
        with folders.atomic_folder(tmp_path / "other"):
            raise AssertionError("not reached")


def test_an_interrupt_at_the_end_keeps_what_was_made(tmp_path, monkeypatch):
    def interrupt(folder):
        raise KeyboardInterrupt

    monkeypatch.setattr(folders, "_sync_tree", interrupt)
    with pytest.raises(KeyboardInterrupt, match="kept in") as info:
        with folders.atomic_folder(tmp_path / "recording") as temp:
            (temp / "frame").write_text("1")
    assert kept_of(info) == {"frame": "1"}


@pytest.mark.parametrize("inside", [False, True])
def test_what_a_killed_process_left_is_named_with_the_ways_out(tmp_path, inside):
    target = tmp_path / "my rec"
    home = target if inside else tmp_path
    with folders.atomic_folder(target) as temp:
        (temp / "camera.json").write_text("{}")
        (temp / "frames").mkdir()
        for name in ("000000.png", "000001.png", ".000002.png.0123456789ab.tmp"):
            (temp / "frames" / name).write_text("x")
        assert folders.left_behind(target) == [], "somebody is writing it"
        left = home / ".my rec.0123456789ab.tmp"
        shutil.copytree(temp, left)
        (home / ".my rec.0123456789ac.tmp").mkdir()
        (home / ".my rec.0123456789ac.tmp" / "pairs.csv").write_text("x")
        (home / ".my recording.0123456789ab.tmp").mkdir()
        (home / ".my rec.0123456789ad.tmp").write_text("a file that was being written")
        lines = folders.left_behind(target)
        shutil.rmtree(target, ignore_errors=True)
    if inside:
        assert len(lines) == 2
        return
    assert len(lines) == 2 and lines == folders.left_behind(target)
    kept = f"{tmp_path}/my rec-0123"
    assert lines[0] == (
        f"left unfinished before: {left}, 3 whole files; "
        f"to keep it: mv '{left}' '{kept}'; to remove it: rm -r '{left}'"
    )
    assert ", 1 whole files; " in lines[1]
    subprocess.run(lines[0].split("to keep it: ")[1].split(";")[0], shell=True, check=True)
    assert os.path.isfile(f"{kept}/frames/000001.png") and len(folders.left_behind(target)) == 1


def test_an_existing_folder_is_replaced_only_on_demand(tmp_path):
    target = tmp_path / "folder"
    target.mkdir()
    with folders.atomic_folder(target) as temp:  # an empty one is as good as none
        (temp / "result").write_text("1")
    with pytest.raises(BadFile, match="exists") as info:
        with folders.atomic_folder(target):
            raise AssertionError("not reached")
    one_line(info)
    names = ("result", "picture")
    with folders.atomic_folder(target, overwrite=True, contents=names) as temp:
        (temp / "picture").write_text("2")
    assert os.listdir(target) == ["picture"]
    with pytest.raises(BadFile, match="holds no result"):
        with folders.atomic_folder(target, overwrite=True, contents=names):
            raise AssertionError("not reached")
    assert os.listdir(target) == ["picture"] and os.listdir(tmp_path) == ["folder"]


@pytest.mark.parametrize("foreign", ["my_notes.txt", "thesis", ".hidden", "two\nlines"])
def test_a_folder_with_foreign_files_is_not_replaced(tmp_path, foreign):
    target, names = tmp_path / "folder", ("result", "picture")
    target.mkdir()
    (target / "result").write_text("1")
    (target / "picture").write_text("2")
    if foreign == "thesis":
        (target / foreign).mkdir()
    else:
        (target / foreign).write_text("mine")
    for replacing in (folders.atomic_folder, folders.check_target):
        with pytest.raises(BadFile, match="also holds .*not written by this command") as info:
            with replacing(target, overwrite=True, contents=names):
                raise AssertionError("not reached")
        assert foreign.split()[0] in str(info.value)
        one_line(info)
    assert sorted(os.listdir(target)) == sorted(["result", "picture", foreign])
    assert os.listdir(tmp_path) == ["folder"]


def test_what_a_killed_write_left_in_a_folder_does_not_keep_it(tmp_path):
    target, names = tmp_path / "folder", ("result", "picture")
    target.mkdir()
    (target / "result").write_text("1")
    (target / ".picture.0123456789ab.tmp").write_text("half")
    folders.check_target(target, overwrite=True, contents=names)
    with folders.atomic_folder(target, overwrite=True, contents=names) as temp:
        (temp / "result").write_text("2")
    assert os.listdir(target) == ["result"]
    (target / ".notes.0123456789ab.tmp").write_text("somebody else's")
    with pytest.raises(BadFile, match="also holds .notes.0123456789ab.tmp"):
        folders.check_target(target, overwrite=True, contents=names)


@pytest.mark.parametrize("before", [False, True])
def test_what_appears_while_the_new_folder_is_made_is_kept(tmp_path, before):
    target = tmp_path / "folder"
    if before:
        target.mkdir()
        (target / "result").write_text("1")
    with pytest.raises(BadFile, match="folder") as info:
        with folders.atomic_folder(target, overwrite=True, contents=("result",)) as temp:
            (temp / "result").write_text("2")
            target.mkdir(exist_ok=True)
            (target / "my_notes.txt").write_text("mine")
    assert (target / "my_notes.txt").read_text() == "mine"
    assert not before or (target / "result").read_text() == "1"
    assert kept_of(info) == {"result": "2"} and len(os.listdir(tmp_path)) == 2


def test_a_folder_does_not_replace_a_file(tmp_path):
    (tmp_path / "file").write_text("x")
    for target in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(BadFile) as info:
            with folders.atomic_folder(target, overwrite=True):
                raise AssertionError("not reached")
        one_line(info)
    assert (tmp_path / "file").read_text() == "x"


def test_check_writable_leaves_nothing(tmp_path):
    (tmp_path / "file").write_text("x")
    assert folders.check_writable(tmp_path / "a" / "b") == tmp_path / "a" / "b"
    folders.check_writable(tmp_path)
    assert os.listdir(tmp_path) == ["file"]
    for bad in (tmp_path / "file", tmp_path / "file" / "below", "a\0b"):
        with pytest.raises(BadFile) as info:
            folders.check_writable(bad)
        one_line(info)


def test_check_writable_reports_a_full_disk(tmp_path, broken_disk):
    with pytest.raises(BadFile, match="No space left"):
        folders.check_writable(tmp_path / "a")
    assert os.listdir(tmp_path) == []


def test_sha256(tmp_path):
    path = files.write_atomic(tmp_path / "x", b"abc")
    assert files.sha256(path).startswith("ba7816bf8f01cfea414140de5dae2223")
    for bad in (tmp_path / "none", tmp_path):
        with pytest.raises(BadFile):
            files.sha256(bad)


@pytest.mark.parametrize(
    "content, match",
    [
        (b"", "empty"),
        (b"{", "not JSON"),
        (b'{"a": NaN}', "NaN is not a number"),
        (b'{"a": -Infinity}', "Infinity is not a number"),
        (b'{"a": 1e999}', "too large"),
        (b'{"a": 1, "b": {"c": 1, "c": 2}}', "'c' is there twice"),
        (b"[1, 2]", "holds a list"),
        (b"3", "holds a int"),
        (b'{"a": "\xff"}', "UTF-8"),
        (b'{"a": ' + b"[" * 100_000, "not JSON"),
        (b'{"a": ' + b"9" * 10_000 + b"}", "not JSON"),
        (b'{"a": [' + b"0," * 1_000_000 + b"0]}", "1,000,002 values; at most 1,000,000 are read"),
        (
            b"{%b}" % b",".join(b'"%d": 0' % (k % 60_000) for k in range(60_001)),
            "'0' is there twice",
        ),
        (b'{"a": "' + b"x" * 2000 + b'"}', "at most 1,000"),
    ],
)
def test_bad_json(tmp_path, content, match):
    path = tmp_path / "x.json"
    path.write_bytes(content)
    limit = 1000 if b"xxx" in content else 10**7
    with pytest.raises(BadFile, match=match) as info:
        files.read_json(path, limit=limit)
    assert str(path) in one_line(info)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("none.json", "no such file"),
        ("folder", "is a folder"),
        ("pipe", "not a regular file"),
        ("link", "not a regular file"),
        ("socket", "not a regular file"),
        ("/dev/zero", "not a regular file"),
    ],
)
def test_what_is_no_file_is_refused_and_not_waited_for(tmp_path, name, said):
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("pipe")
    with socket.socket(socket.AF_UNIX) as unix:
        unix.bind(str(tmp_path / "socket"))
    for read in (files.read_json, files.sha256, lambda path: journal.note(path, {})):
        if read in (files.read_json, files.sha256) or name != "none.json":  # which is made there
            with pytest.raises(BadFile, match=said) as info:
                read(tmp_path / name)
            one_line(info)


def test_a_file_that_becomes_a_pipe_is_not_waited_for(tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "file").write_text("{}")
    before = os.stat(tmp_path / "file")
    monkeypatch.setattr(files.os, "stat", lambda path: before)
    with pytest.raises(BadFile, match="not a regular file"):
        files.read_bytes(tmp_path / "pipe", limit=9)


numbers = st.integers(-(2**53), 2**53) | st.floats(allow_nan=False, allow_infinity=False)
values = st.recursive(
    st.none() | st.booleans() | numbers | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@settings(max_examples=40)
@given(st.dictionaries(st.text(), values, max_size=4))
def test_json_round_trip(content):
    assert files.parse_json(files.json_text(content, "x"), "x") == content


def test_write_json_takes_numpy_and_refuses_the_rest(tmp_path):
    path = tmp_path / "x.json"
    files.write_json(path, {"a": np.float32(0.5), "b": np.arange(3), "c": np.int64(2)})
    assert files.read_json(path) == {"a": 0.5, "b": [0, 1, 2], "c": 2}
    for bad in (float("nan"), np.float32("inf"), object(), {1, 2}, path, np.array([np.nan])):
        with pytest.raises(BadFile) as info:
            files.write_json(path, {"a": bad})
        one_line(info)
    assert files.read_json(path)["a"] == 0.5


def test_json_may_start_with_a_byte_order_mark(tmp_path):
    (tmp_path / "x.json").write_bytes(b"\xef\xbb\xbf" + json.dumps({"a": 1}).encode())
    assert files.read_json(tmp_path / "x.json") == {"a": 1}


ESCAPES = [
    "../x", "a/../../x", "a/../b", "/etc/passwd", "..", "", " ", "C:\\x", "C:/x", "\\\\host\\x",
    "a\\b", "//host/x", "a\0b", "link/x", "file_link",
]  # fmt: skip


@pytest.mark.parametrize("relative", ESCAPES)
def test_paths_do_not_leave_their_folder(tmp_path, relative):
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "link").symlink_to(tmp_path)
    (folder / "file_link").symlink_to("/etc/passwd")
    with pytest.raises(BadFile) as info:
        files.inside(folder, relative)
    one_line(info)


def test_paths_inside_are_allowed(tmp_path):
    folder = tmp_path / "folder"
    (folder / "sub").mkdir(parents=True)
    (folder / "near").symlink_to("sub")
    (tmp_path / "alias").symlink_to("folder")
    for relative in ("a.png", "sub/a.png", "near/a.png", "./a..png", "..a/b"):
        assert files.inside(folder, relative) == folder / relative
    files.inside(tmp_path / "alias", "sub/a.png")


@given(st.text(max_size=30))
def test_no_name_leaves_the_folder(tmp_path_factory, text):
    folder = tmp_path_factory.getbasetemp()
    try:
        path = files.inside(folder, text)
    except BadFile as problem:
        assert "\n" not in str(problem)
    else:
        assert path.resolve().is_relative_to(folder.resolve())


@pytest.mark.parametrize("spelling", ["a", "./a/", "a/../a", "a/b/.."])
def test_unfinished_work_is_kept_beside_its_target(tmp_path, monkeypatch, spelling):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a" / "b").mkdir(parents=True)
    assert folders.beside(Path(spelling), ".shards") == tmp_path / "a.shards"
    with pytest.raises(BadFile, match="not a folder that"):
        folders.beside(Path("/"), ".shards")
