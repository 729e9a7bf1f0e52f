"""Folders of results: written whole or not at all, and never lost at the end of long work."""

import errno
import os
import re
import shlex
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from jshape.errors import BadFile, one_line, quoted
from jshape.io.files import lock, parents, refused, remove_file, sync_folder, temp_beside, write_new


def folder_of(folder: str | os.PathLike, what: str, *needed: str) -> Path:
    """The folder that holds `what` (a data set) and the files that it needs, else BadFile."""
    folder = Path(folder)
    if not folder.is_dir():
        why = f"is a file; {what} is a folder" if folder.exists() else "no such folder"
        raise BadFile(f"{folder}: {why}")
    for name in needed:
        if not (folder / name).is_file():
            raise BadFile(f"{folder}: has no {name}, so it is not {what}")
    return folder


def check_writable(folder: str | os.PathLike) -> Path:
    """The folder as a path, if it is writable or can be made; nothing is left behind.

    Raises:
      BadFile: it, or the nearest folder above it that exists, is a file or refuses new files.
    """
    folder = Path(folder)
    if "\0" in str(folder):
        raise BadFile(f"{quoted(str(folder))}: is not a folder name")
    with refused(folder, "cannot be written"):
        nearest = next(p for p in (folder, *folder.absolute().parents) if os.path.lexists(p))
        if not nearest.is_dir():
            raise BadFile(f"{folder}: cannot be written: {nearest} is not a folder")
        probe = temp_beside(nearest / "probe")
        try:
            write_new(probe, b"")
        finally:
            remove_file(probe)
    return folder


@contextmanager
def atomic_folder(
    target: str | os.PathLike, overwrite: bool = False, *, contents: Sequence[str] | None = None
) -> Iterator[Path]:
    """A temporary folder that becomes `target` when the block ends without an error.

    Args:
      target: the folder to make.  An empty folder may be there already.
      overwrite: replace what is there; it is removed only after the new folder is complete.
      contents: the top-level names that the caller writes.  A folder is replaced only if it holds
        the first of them and nothing else than them, so that neither a mistyped path nor notes
        kept beside a result cost somebody's other work.  None: whatever is there is replaced.

    Yields:
      The temporary folder, beside the target.

    Where a rename cannot replace the target (a mount point, the folder that the shell is in, one
    whose parent is read-only), the temporary folder lies inside it and its content is moved up.

    Raises:
      BadFile: the target exists (and must not be replaced), or cannot be written.  If that turns
        out after the block has ended, what was made stays, and the message says where.
    """
    target = _resolved(Path(target))
    check_target(target, overwrite, contents=contents)
    with parents(target), _held(temp := _make_temp(target)):
        try:
            yield temp
        except BaseException:
            shutil.rmtree(temp, ignore_errors=True)
            raise
        try:
            # Again: the block may have taken hours, in which somebody put something there.
            check_target(target, overwrite, contents=contents, own=temp.name)
            _put_in_place(temp, target)
        except (BadFile, KeyboardInterrupt) as problem:
            if not temp.exists():
                raise
            said = f"{problem}; " if str(problem) else ""
            raise type(problem)(f"{said}what was made is kept in {temp}") from None


def check_target(
    target: str | os.PathLike,
    overwrite: bool = False,
    *,
    contents: Sequence[str] | None = None,
    own: str = "",
) -> None:
    """Refuse what `atomic_folder` may not write to: call it before long work.

    Arguments are those of `atomic_folder`; a name `own` in the target is no obstacle.  Raises
    likewise.
    """
    target = check_writable(target)
    with refused(target, "cannot be read"):
        if target.is_dir():
            if names := _names(target, own):
                _check_replaceable(target, names, overwrite, contents)
        elif os.path.lexists(target):
            raise BadFile(f"{target}: is a file; a folder is to be made there")


def _check_replaceable(
    target: Path, names: list[str], overwrite: bool, contents: Sequence[str] | None
) -> None:
    # A write that was cut short by SIGKILL leaves a temporary file, which is the command's too.
    meant = {re.sub(r"^\.(.+)\.[0-9a-f]{12}\.tmp$", r"\1", name): name for name in names}
    foreign = [meant[name] for name in meant if contents is not None and name not in contents]
    if not overwrite:
        why = "the folder exists and is not empty; choose another name, or replace it with "
        why += "--overwrite"
    elif contents is not None and not (target / contents[0]).is_file():
        why = f"the folder holds no {contents[0]}, so it is not replaced; choose another name"
    elif foreign:
        why = f"also holds {one_line(foreign[0], 80)}, which was not written by this command; "
        why += "choose another name"
    elif _holds_here(target) and not os.path.samefile(target, os.curdir):
        why = "holds the folder that this command is run in, so it is not replaced; run it "
        why += "elsewhere"
    else:
        return
    raise BadFile(f"{target}: {why}")


def left_behind(target: Path) -> list[str]:
    """What killed processes left of a target, in hidden folders: a line for people on each.

    A folder that another process is still writing is none of them.
    """
    lines = []
    with suppress(OSError, ValueError):
        target = target.resolve()
        pattern = re.compile(rf"\.{re.escape(target.name[:80])}\.([0-9a-f]{{12}})\.tmp")
        for parent in (target.parent, target):
            for name in sorted(os.listdir(parent)) if parent.is_dir() else ():
                match = pattern.fullmatch(name)
                if match and (parent / name).is_dir() and not _is_held(parent / name):
                    lines.append(_ways_out(parent / name, f"{target}-{match[1][:4]}"))
    return lines


def _ways_out(found: Path, free: str) -> str:
    """How to keep or remove a folder that was left behind."""
    count = sum(path.is_file() for path in found.rglob("[!.]*"))
    name = shlex.quote(str(found))
    return (
        f"left unfinished before: {found}, {count} whole files; to keep it: mv {name} "
        f"{shlex.quote(free)}; to remove it: rm -r {name}"
    )


@contextmanager
def _held(folder: Path) -> Iterator[bool]:
    """Mark a folder as being written until the block or the process ends; False: another does."""
    handle, mine = None, True
    try:
        with suppress(OSError):  # Windows opens no folder, some network disks lock none
            handle = os.open(folder, os.O_RDONLY)
            mine = lock(handle)
        yield mine
    finally:
        if handle is not None:
            os.close(handle)


def _is_held(folder: Path) -> bool:
    with _held(folder) as mine:
        return not mine


def beside(target: Path, ending: str) -> Path:
    """The folder beside a target where unfinished work for it is kept.

    Raises:
      BadFile: nothing is beside the root of the disk.
    """
    target = _resolved(target)
    if not target.name:
        raise BadFile(f"{target}: is not a folder that a result can be in")
    return target.with_name(target.name + ending)


def _resolved(path: Path) -> Path:
    with refused(path, "cannot be resolved"):
        return path.resolve()


def _make_temp(target: Path) -> Path:
    """A new folder to fill: beside the target, or inside where it cannot be replaced by a rename.

    Beside, it is on the same file system, unless the target is a mount point; and a parent that is
    read-only takes no new folder, though the target may.
    """
    beside, inside = temp_beside(target), temp_beside(target / target.name)
    with refused(target, "cannot be made"):
        if not (target.is_dir() and (os.path.ismount(target) or _holds_here(target))):
            try:
                beside.mkdir()
                return beside
            except OSError:
                if not target.is_dir():
                    raise
        inside.mkdir()
    return inside


def _holds_here(folder: Path) -> bool:
    """Whether a folder is the one that this process (and its shell) is in, or one above it."""
    try:
        here = Path.cwd()
    except OSError:  # it was removed
        return False
    return any(os.path.samefile(folder, one) for one in (here, *here.parents))


def _names(folder: Path, own: str) -> list[str]:
    """What a folder holds, without `own` and what every new ext4 volume holds."""
    return sorted({*os.listdir(folder)} - {own, "lost+found"})


_NO_RENAME = (errno.EBUSY, errno.EXDEV, errno.EACCES, errno.EPERM, errno.EROFS)
"""Where a folder may still be written into: a mount point, a layer of a container's image, a
folder in somebody else's."""


def _put_in_place(temp: Path, target: Path) -> None:
    """Make `temp` the target; what stands there goes, or comes back if that fails."""
    with refused(target, "cannot be written"):
        _sync_tree(temp)
        old = temp_beside(target)
        within = temp.parent == target
        if not within:
            try:
                _replace(temp, target, old)
            except OSError as problem:
                if problem.errno not in _NO_RENAME:
                    raise
                within = True
        if within:
            old = temp_beside(target / target.name)
            _move_up(temp, target, old)
        sync_folder(target.parent)
    shutil.rmtree(old, ignore_errors=True)


def _replace(temp: Path, target: Path, old: Path) -> None:
    """Rename `temp` to `target`; what stands there is renamed to `old`, and back if that fails."""
    occupied = target.is_dir() and bool(os.listdir(target))
    if occupied:
        os.rename(target, old)
    try:
        os.rename(temp, target)
    except OSError:
        if occupied:
            os.rename(old, target)
        raise


def _move_up(temp: Path, target: Path, old: Path) -> None:
    """Move the content of `temp` into `target`; what is there goes into `old`, and back."""
    before = _names(target, temp.name) if target.is_dir() else []
    old.mkdir(parents=True)
    done: list[tuple[Path, Path]] = []
    try:
        for name in before:
            shutil.move(target / name, old / name)
            done.append((target / name, old / name))
        for name in os.listdir(temp):
            shutil.move(temp / name, target / name)  # copied where it cannot be renamed
            done.append((temp / name, target / name))
    except BaseException:
        for was, now in reversed(done):
            shutil.move(now, was)
        old.rmdir()
        raise
    temp.rmdir()
    sync_folder(target)


def _sync_tree(folder: Path) -> None:
    for root, _, names in os.walk(folder):
        for name in names:
            with open(os.path.join(root, name), "rb") as file:
                os.fsync(file.fileno())
        sync_folder(Path(root))
