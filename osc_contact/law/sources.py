"""Which law this is: a hash of its sources."""

from __future__ import annotations

from functools import cache
from hashlib import sha256
from pathlib import Path


@cache
def law_hash() -> str:
    """SHA-256 of all sources of the law."""
    found = sha256()
    for source in sorted(Path(__file__).parent.glob("*.py")):
        found.update(source.read_bytes())
    return found.hexdigest()
