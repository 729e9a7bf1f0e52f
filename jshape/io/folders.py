"""Folders of results: written whole or not at all, and never lost at the end of long work."""

import errno
import os
import re
import shlex
import shutil
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
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
            inside = sorted(path.parent for path in folder.glob(f"[!.]*/{needed[0]}"))
            held = ", ".join(str(path) for path in inside[:5]) + ", ..." * (len(inside) > 5)
            hint = f"; name one that it holds: {held}" if inside else ""
            raise BadFile(f"{folder}: has no {name}, so it is not {what}{hint}")
    return folder


def check_writable(folder: str | os.PathLike) -> Path:
    """The folder as a path, if it is writable or can be made; nothing is left behind.

    Raises BadFile: it, or the nearest folder above it that exists, is a file or refuses new files.
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

    Arguments and errors are those of `atomic_folder`; a name `own` in the target is no obstacle.
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
        why = "exists and is not empty; choose another name, or replace it with --overwrite"
    elif contents is not None and not (target / contents[0]).is_file():
        why = f"holds no {contents[0]}, so it is not replaced; choose another name"
    elif foreign:
        odd = one_line(foreign[0], 80)
        why = f"also holds {odd}, which was not written by this command; choose another name"
    elif _holds_here(target) and not os.path.samefile(target, os.curdir):
        why = "holds the one that this command is run in, so it is not replaced; run it elsewhere"
    else:
        return
    raise BadFile(f"{target}: the folder {why}")


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
                if not match or not (found := parent / name).is_dir():
                    continue
                with _held(found) as mine:
                    if not mine:
                        continue
                count = sum(path.is_file() for path in found.rglob("[!.]*"))
                keep = f"mv {shlex.quote(str(found))} {shlex.quote(f'{target}-{match[1][:4]}')}"
                lines.append(
                    f"left unfinished before: {found}, {count} whole files; to keep it: {keep}; "
                    f"to remove it: rm -r {shlex.quote(str(found))}"
                )
    return lines


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


def beside(target: Path, ending: str) -> Path:
    """The folder beside a target where unfinished work for it is kept.

    Raises BadFile: nothing is beside the root of the disk.
    """
    target = _resolved(target)
    if not target.name:
        raise BadFile(f"{target}: is not a folder that a result can be in")
    return target.with_name(target.name + ending)


def _resolved(path: Path) -> Path:
    with refused(path, "cannot be resolved"):
        return path.resolve()


def _make_temp(target: Path) -> Path:
    """A new folder to fill: beside the target, or inside if no rename can replace it."""
    beside, inside = temp_beside(target), temp_beside(target / target.name)
    with refused(target, "cannot be made"):
        if not (target.is_dir() and (os.path.ismount(target) or _holds_here(target))):
            try:
                beside.mkdir()
                return beside
            except OSError:  # the folder above may be read-only
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
"""A folder may still be written into: a mount point, a container's layer, in somebody else's."""


def _put_in_place(temp: Path, target: Path) -> None:
    """Make `temp` the target; what stands there goes, or comes back if that fails."""
    with refused(target, "cannot be written"):
        _sync_tree(temp)
        old = temp_beside(target)
        if temp.parent == target or not _renamed(temp, target, old):
            old = temp_beside(target / target.name)
            _move_up(temp, target, old)
        sync_folder(target.parent)
    shutil.rmtree(old, ignore_errors=True)


def _renamed(temp: Path, target: Path, old: Path) -> bool:
    """Rename the target to `old` and `temp` to the target; False: nothing can be renamed here."""
    occupied = target.is_dir() and bool(os.listdir(target))
    try:
        if occupied:
            os.rename(target, old)
        os.rename(temp, target)
    except OSError as problem:
        if occupied and old.exists():
            os.rename(old, target)
        if problem.errno not in _NO_RENAME:
            raise
        return False
    return True


def _move_up(temp: Path, target: Path, old: Path) -> None:
    """Move what is in `target` into `old`, and up what is in `temp`; back if that fails."""
    before = _names(target, temp.name) if target.is_dir() else []
    old.mkdir(parents=True)
    with ExitStack() as undo:
        undo.callback(old.rmdir)
        for source, goal, names in ((target, old, before), (temp, target, os.listdir(temp))):
            for name in names:
                shutil.move(source / name, goal / name)  # copied where it cannot be renamed
                undo.callback(shutil.move, goal / name, source / name)
        undo.pop_all()
    temp.rmdir()
    sync_folder(target)


def _sync_tree(folder: Path) -> None:
    for root, _, names in os.walk(folder):
        for name in names:
            with open(os.path.join(root, name), "rb") as file:
                os.fsync(file.fileno())
        sync_folder(Path(root))
