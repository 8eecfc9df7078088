"""Folder of cached results under keys that are hashes of all their ingredients.

Every file begins with the SHA-256 of its key and its content, so that a file that is damaged,
incomplete or of another key is detected and made again. Several processes may write at the same
time: files appear complete, and files of the same key have the same content. A folder into which
other users may write is not used.
"""

from __future__ import annotations

import os
from contextlib import suppress
from hashlib import sha256
from pathlib import Path

from osc_contact.files import require_private, write_whole

_DIGEST = 32  #: bytes


def _digest(key: str, content: bytes) -> bytes:
    """Checksum (SHA-256) of a key and the bytes stored under it, with which a file begins.

    Args:
        key: key of the result.
        content: bytes of the result.
    """
    return sha256(key.encode() + content).digest()


class Store:
    """Cached results by key; empty if other users may write to the folder.

    A folder that is not writable is read; nothing is added to it.

    Attributes:
        folder: folder of the files, made when the first result is stored.
    """

    def __init__(self, folder: Path) -> None:
        """Set the folder; it need not exist.

        Args:
            folder: folder of the files.
        """
        self.folder = folder

    def find(self, key: str) -> bytes | None:
        """Return the content stored under a key, or None if it is missing or damaged.

        The file counts as used now, see `remove_old`.

        Args:
            key: key of the result, the name of its file.
        """
        path = self.folder / key
        try:
            self._require_private()
            content = path.read_bytes()
        except OSError:
            return None
        if _digest(key, content[_DIGEST:]) != content[:_DIGEST]:
            return None
        with suppress(OSError):
            os.utime(path)
        return content[_DIGEST:]

    def keep(self, key: str, content: bytes) -> None:
        """Store a result under a key; without success it is made again next time.

        Args:
            key: key of the result, the name of its file.
            content: bytes of the result.
        """
        with suppress(OSError):
            for folder in (self.folder.parent, self.folder):
                folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._require_private()
            write_whole(_digest(key, content) + content, self.folder / key)

    def _require_private(self) -> None:
        """Refuse a folder into which other users may write, because its content is executed.

        Raises:
            OSError: other users may write to it, or it does not exist.
        """
        require_private(self.folder.parent)
        require_private(self.folder)

    def remove_old(self, limit: int) -> None:
        """Remove the least recently used results, by the times of their files, which `find` renews.

        An error ends the removal silently: another process may remove the same files.

        Args:
            limit: number of results that remain.
        """
        with suppress(OSError):
            by_use = sorted(self.folder.iterdir(), key=lambda path: path.stat().st_mtime)
            for path in by_use[: max(0, len(by_use) - limit)]:
                path.unlink(missing_ok=True)
