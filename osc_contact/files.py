"""Files that appear complete or not at all, and folders that one program at a time writes to."""

import os
import stat
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from osc_contact.errors import InvalidInputError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

StrPath = str | os.PathLike[str]  #: a file's name, as `open` takes it
Json = dict[str, Any]  #: an object of a JSON file


def hold(number: int, what: StrPath) -> None:
    """Lock an open file or folder until it is closed, at the latest by the end of the process.

    Where the file system has no locks, nothing is locked.

    Args:
        number: of the open file. what: its name.

    Raises:
        InvalidInputError: another program holds it.
    """
    if fcntl is None:
        return
    try:
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise InvalidInputError(
            f"another program writes to {what} now: wait until it ends, or give another folder "
            "(--out)"
        ) from error
    except OSError:  # a file system without locks
        pass


@contextmanager
def sole_user(folder: Path) -> Iterator[None]:
    """Make a folder, and keep other programs that call this from it while the block lasts.

    Args:
        folder: for results.

    Raises:
        InvalidInputError: another program holds it. OSError: it cannot be made.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if fcntl is None:
        yield
        return
    number = os.open(folder, os.O_RDONLY)
    try:
        hold(number, folder)
        yield
    finally:
        os.close(number)


def require_private(folder: Path) -> None:
    """Refuse a folder of programs to be loaded into which other users may write.

    Root counts as no other user.

    Raises:
        PermissionError: it is another user's, or its group or all users may write to it.
        OSError: it is not there.
    """
    if not hasattr(os, "getuid"):  # Windows
        return
    found = folder.stat()
    if found.st_uid not in (0, os.getuid()):
        raise PermissionError(f"{folder} belongs to another user: name a folder of your own")
    if found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise PermissionError(f"other users may write to {folder}: chmod go-w {folder}")


@contextmanager
def one_by_one(folder: Path) -> Iterator[None]:
    """Make a private folder, and let programs that call this do so one after another.

    Where the file system has no locks, nobody waits.

    Args:
        folder: for what they make.

    Raises:
        PermissionError: other users may write to it. OSError: it cannot be made, or its `.lock` is
            a link.
    """
    folder.mkdir(mode=stat.S_IRWXU, parents=True, exist_ok=True)
    require_private(folder)
    not_through_a_link = getattr(os, "O_NOFOLLOW", 0)  # Windows has none
    number = os.open(folder / ".lock", os.O_RDWR | os.O_CREAT | not_through_a_link, 0o600)
    try:
        if fcntl is not None:
            with suppress(OSError):
                fcntl.flock(number, fcntl.LOCK_EX)
        yield
    finally:
        os.close(number)


@contextmanager
def whole_file(path: StrPath) -> Iterator[Path]:
    """Yield a path to write to; in the end that file gets its name, after an error it is removed.

    Args:
        path: the name of the file; its folder is made, an older file of the name is replaced.

    Raises:
        OSError: the folder cannot be made, or the file not be written.
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    unfinished = target.with_name(f".{target.name}.{uuid.uuid4().hex}.tmp")
    try:
        yield unfinished
        os.replace(unfinished, target)
    finally:
        unfinished.unlink(missing_ok=True)


def write_whole(content: str | bytes, path: StrPath) -> Path:
    """Write a file (text as UTF-8), which appears complete or not at all; returns its path."""
    with whole_file(path) as unfinished:
        unfinished.write_bytes(content if isinstance(content, bytes) else content.encode())
    return Path(path)
