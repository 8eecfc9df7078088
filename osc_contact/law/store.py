"""A folder of results, each under a key that holds all it is made from.

Every file begins with the SHA-256 of its key and its content, so that one which is damaged, half
written or of another key is noticed and made anew. Several processes may write at once: a file
appears whole, and two that are written under one key have the same content. A folder into which
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
    return sha256(key.encode() + content).digest()


class Store:
    """Results by their keys, in a folder; none where it cannot be written to, or others may write.

    Attributes:
        folder: where they are; it is made when the first result is kept.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def find(self, key: str) -> bytes | None:
        """Content that was kept under a key; None: there is none, or it is damaged."""
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
        """Keep a result; where that is not possible, it is made anew next time."""
        with suppress(OSError):
            for folder in (self.folder.parent, self.folder):
                folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._require_private()
            write_whole(_digest(key, content) + content, self.folder / key)

    def _require_private(self) -> None:
        """Refuse a folder into which other users may write: what is found there is executed.

        Raises:
            OSError: they may, or it is not there.
        """
        require_private(self.folder.parent)
        require_private(self.folder)

    def remove_old(self, most: int) -> None:
        """Remove the results that were not used for the longest time.

        Args:
            most: number of results that stay.
        """
        with suppress(OSError):
            by_use = sorted(self.folder.iterdir(), key=lambda path: path.stat().st_mtime)
            for path in by_use[: max(0, len(by_use) - most)]:
                path.unlink(missing_ok=True)
