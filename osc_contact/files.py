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

StrPath = str | os.PathLike[str]  #: path of a file, as for `open`
Json = dict[str, Any]  #: object of a JSON file


def hold(descriptor: int, name: StrPath) -> None:
    """Lock an open file or folder until it is closed, at the latest by the end of the process.

    Nothing is locked on a file system without locks.

    Args:
        descriptor: file descriptor of the open file or folder.
        name: name of the file or folder, for messages.

    Raises:
        InvalidInputError: another program has locked it.
    """
    if fcntl is None:
        return
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise InvalidInputError(
            f"another program writes to {name} now: wait until it ends, or give another folder "
            "(--out)"
        ) from error
    except OSError:  # a file system without locks
        pass


@contextmanager
def sole_user(folder: Path) -> Iterator[None]:
    """Make a folder and lock it for this process while the block runs.

    The lock binds programs that lock the folder by this function.

    Args:
        folder: folder for results.

    Raises:
        InvalidInputError: another program has locked the folder.
        OSError: the folder cannot be made.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if fcntl is None:
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        hold(descriptor, folder)
        yield
    finally:
        os.close(descriptor)


def require_private(folder: Path) -> None:
    """Refuse to load programs from a folder into which other users may write.

    A folder of root is accepted.

    Raises:
        PermissionError: the folder is another user's, or its group or all users may write to it.
        OSError: the folder does not exist.
    """
    if not hasattr(os, "getuid"):  # Windows
        return
    status = folder.stat()
    if status.st_uid not in (0, os.getuid()):
        raise PermissionError(f"{folder} belongs to another user: name a folder of your own")
    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise PermissionError(f"other users may write to {folder}: chmod go-w {folder}")


@contextmanager
def one_by_one(folder: Path) -> Iterator[None]:
    """Make a private folder and run the block while no other program runs such a block in it.

    Programs wait for one another; on a file system without locks they do not.

    Args:
        folder: folder whose `.lock` file is locked.

    Raises:
        PermissionError: other users may write to the folder.
        OSError: the folder cannot be made, or its `.lock` is a link.
    """
    folder.mkdir(mode=stat.S_IRWXU, parents=True, exist_ok=True)
    require_private(folder)
    not_through_a_link = getattr(os, "O_NOFOLLOW", 0)  # Windows has none
    descriptor = os.open(folder / ".lock", os.O_RDWR | os.O_CREAT | not_through_a_link, 0o600)
    try:
        if fcntl is not None:
            with suppress(OSError):
                fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


@contextmanager
def whole_file(path: StrPath) -> Iterator[Path]:
    """Yield a temporary path, which is renamed to `path` at the end and removed after an error.

    Args:
        path: final name of the file; its folder is made, and an older file is replaced.

    Raises:
        OSError: the folder cannot be made, or the file cannot be written.
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
    """Write a file (text as UTF-8) that appears complete or not at all; return its path.

    Args:
        content: text or bytes.
        path: name of the file; its folder is made, an older file replaced.

    Raises:
        OSError: the file cannot be written.
    """
    if isinstance(content, str):
        content = content.encode()
    with whole_file(path) as unfinished:
        unfinished.write_bytes(content)
    return Path(path)
