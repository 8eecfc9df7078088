"""The law as a library: where it is, and whether it was made from the sources that lie here.

osc_law.abi3.so is `extension.c` with law.o of `c_object`, which lies beside it; one pair of files
serves every Python from 3.11 on. Wheels bring both. Elsewhere they are made once, when the law is
first used or by `python -m osc_contact.law.c_object`, and kept in the user's cache under the hash
of the sources, so that an edited law is another library.

Environment variables:
    OSC_CONTACT_LAW: path of another library; "compile": none that is there, so that law.o of
        another platform can be made; "jit": none at all, numba compiles in its usual way.
    OSC_CONTACT_CACHE: folder for what is made; default osc_contact in XDG_CACHE_HOME or ~/.cache.
"""

from __future__ import annotations

import logging
import os
import shutil
import sysconfig
from functools import cache
from hashlib import sha256
from importlib.machinery import ExtensionFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from typing import Any

from osc_contact.errors import OscContactError
from osc_contact.files import require_private

LIBRARY = "osc_law.abi3.so"
OBJECT = "law.o"
CHECKSUM = "sha256"  #: of both files, in a third one
COMPILER = os.environ.get("CC", "cc")
_log = logging.getLogger(__name__)
HEADERS = sysconfig.get_paths()["include"]


@cache
def law_hash() -> str:
    """SHA-256 of all sources of the law."""
    here = Path(__file__).parent
    found = sha256()
    for source in (*sorted(here.glob("*.py")), here / "extension.c"):
        found.update(source.read_bytes())
    return found.hexdigest()


def obstacle() -> str:
    """What is missing to make the library; "" where nothing is."""
    if shutil.which(COMPILER) is None:
        return f"there is no C compiler {COMPILER!r} here"
    if not (Path(HEADERS) / "Python.h").is_file():
        return f"there is no Python.h in {HEADERS} (Debian: python3-dev)"
    return ""


def cache_folder() -> Path:
    """For libraries that are made here."""
    usual = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(os.environ.get("OSC_CONTACT_CACHE") or Path(usual) / "osc_contact")


def kept(kind: str = "law") -> Path:
    """The folder of what is made of this law: the library, or numba's files."""
    return cache_folder() / f"{kind}-{sysconfig.get_platform()}-{law_hash()[:16]}"


def checksum(folder: Path) -> str:
    """Of the two files."""
    return sha256(b"".join((folder / name).read_bytes() for name in (LIBRARY, OBJECT))).hexdigest()


def found() -> Any:
    """The library that fits the sources; None: there is none.

    Raises:
        OscContactError: OSC_CONTACT_LAW names what is none of this law.
    """
    where = os.environ.get("OSC_CONTACT_LAW", "")
    if where:
        return None if where in ("jit", "compile") else named(Path(where))
    return load(Path(__file__).with_name(LIBRARY)) or found_in(kept())


def named(path: Path) -> Any:
    """The library at a path that the user gives.

    Raises:
        OscContactError: there is no such file, or it is none of this law, for this platform.
    """
    made = load(path)
    if made is None:
        what = "is no library of this law for this platform" if path.is_file() else "is not there"
        raise OscContactError(
            f"OSC_CONTACT_LAW names {path}, which {what}: unset it, or make the library by "
            "OSC_CONTACT_LAW= python -m osc_contact.law.c_object, which prints where it is"
        )
    return made


def may_keep(folder: Path) -> bool:
    """Whether programs may be loaded from a folder: it is there, and no other user's to write to.

    One that others may write to is logged.
    """
    try:
        require_private(folder)
    except PermissionError as error:
        _log.warning("the compiled law that is kept is not used: %s", error)
        return False
    except OSError:
        return False
    return True


def found_in(folder: Path) -> Any:
    """The library that was made there; None: there is none, it is damaged, or others may write."""
    if not (may_keep(folder.parent) and may_keep(folder)):
        return None
    try:
        whole = (folder / CHECKSUM).read_text("ascii", "replace") == checksum(folder)
    except OSError:
        return None
    return load(folder / LIBRARY) if whole else None


def load(path: Path) -> Any:
    """A library; None: it is none for this platform, or of other sources."""
    if not path.is_file() or law_hash().encode() not in path.read_bytes():
        return None  # a foreign one is not loaded: that would run it
    loader = ExtensionFileLoader("osc_law", str(path))
    spec = spec_from_loader("osc_law", loader)
    assert spec is not None
    try:
        module: Any = module_from_spec(spec)
        loader.exec_module(module)
    except ImportError:
        return None
    return module if law_hash() == module.LAW else None
