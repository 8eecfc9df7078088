"""Which law this is: a hash of its sources, and of what compiles them."""

from __future__ import annotations

from functools import cache
from hashlib import sha256
from pathlib import Path

import llvmlite
import numba


@cache
def law_hash() -> str:
    """SHA-256 of all sources of the law and of the versions of what compiles them."""
    found = sha256(f"{numba.__version__} {llvmlite.__version__}".encode())
    for source in sorted(Path(__file__).parent.glob("*.py")):
        found.update(source.read_bytes())
    return found.hexdigest()
