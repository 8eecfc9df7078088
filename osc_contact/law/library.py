"""Library of the compiled law: its location, and whether it was made from the present sources.

osc_law.abi3.so consists of `extension.c` and law.o of `c_object`, which is stored beside it; the
two files serve every Python from 3.11 on. Wheels contain both. Otherwise they are made once, when
the law is first used or by `python -m osc_contact.law.c_object`, and stored in the user's cache
under the hash of the sources, so that an edited law has another library.

Environment variables:
    OSC_CONTACT_LAW: path of another library; "compile": existing libraries are ignored, so that
        law.o of another platform can be made; "quick": a library whose functions are compiled one
        by one, made in seconds after an edit, with slower ticks (`machine_code`); "jit": no
        library, numba compiles in its usual way.
    OSC_CONTACT_CACHE: folder of compiled files; default osc_contact in XDG_CACHE_HOME or ~/.cache.
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
LAW, QUICK = "law", "quick"  #: kinds of libraries, see `kept`
CHECKSUM = "sha256"  #: file with the checksum of both files
COMPILER = os.environ.get("CC", "cc")
_log = logging.getLogger(__name__)
HEADERS = sysconfig.get_paths()["include"]


@cache
def law_hash() -> str:
    """Hash (SHA-256) of all sources of the law."""
    folder = Path(__file__).parent
    hash_sum = sha256()
    for source in (*sorted(folder.glob("*.py")), folder / "extension.c"):
        hash_sum.update(source.read_bytes())
    return hash_sum.hexdigest()


def missing_tool() -> str:
    """Describe the tool without which the library cannot be made here; empty if none is missing.

    Tools are the C compiler `COMPILER` and the header Python.h in `HEADERS`.

    Returns:
        Clause for a message, such as `there is no C compiler 'cc' here`.
    """
    if shutil.which(COMPILER) is None:
        return f"there is no C compiler {COMPILER!r} here"
    if not (Path(HEADERS) / "Python.h").is_file():
        return f"there is no Python.h in {HEADERS} (Debian: python3-dev)"
    return ""


def cache_folder() -> Path:
    """Folder of libraries that are made on this machine."""
    user_folder = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(os.environ.get("OSC_CONTACT_CACHE") or Path(user_folder) / "osc_contact")


def is_quick() -> bool:
    """Return whether the user requests the library whose functions are compiled one by one."""
    return os.environ.get("OSC_CONTACT_LAW") == QUICK


def kept(kind: str = LAW) -> Path:
    """Folder of the files that are made from the present sources.

    Its name contains the platform and the hash of the sources, so that an edited law has another
    folder.

    Args:
        kind: LAW for the library and its object file, QUICK for the one whose functions are
            compiled one by one, "numba" for numba's own cache.
    """
    return cache_folder() / f"{kind}-{sysconfig.get_platform()}-{law_hash()[:16]}"


def checksum(folder: Path) -> str:
    """Checksum (SHA-256) of the library and the object file in a folder."""
    return sha256(b"".join((folder / name).read_bytes() for name in (LIBRARY, OBJECT))).hexdigest()


def found() -> Any:
    """Existing library that fits the sources, or None.

    Raises:
        OscContactError: OSC_CONTACT_LAW names a file that is not a library of these sources.
    """
    where = os.environ.get("OSC_CONTACT_LAW", "")
    if is_quick():
        return found_in(kept(QUICK))
    if where:
        return None if where in ("jit", "compile") else named(Path(where))
    return load(Path(__file__).with_name(LIBRARY)) or found_in(kept())


def named(path: Path) -> Any:
    """Load the library at a path that the user gives.

    Raises:
        OscContactError: the file does not exist, or is not a library of these sources for this
            platform.
    """
    module = load(path)
    if module is None:
        problem = (
            "is no library of this law for this platform" if path.is_file() else "is not there"
        )
        raise OscContactError(
            f"OSC_CONTACT_LAW names {path}, which {problem}: unset it, or make the library by "
            "OSC_CONTACT_LAW= python -m osc_contact.law.c_object, which prints where it is"
        )
    return module


def may_keep(folder: Path) -> bool:
    """Return whether code may be loaded from a folder: it exists, and only its owner can write.

    A folder to which other users can write is logged as a warning.
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
    """Load the library in a folder; None if it is missing or damaged, or if others may write."""
    if not (may_keep(folder.parent) and may_keep(folder)):
        return None
    try:
        is_complete = (folder / CHECKSUM).read_text("ascii", "replace") == checksum(folder)
    except OSError:
        return None
    return load(folder / LIBRARY) if is_complete else None


def load(path: Path) -> Any:
    """Load the compiled law as an extension module, if it was made of the present sources.

    Args:
        path: file of the library. It is executed only if it contains the hash of the sources.

    Returns:
        The module; None if the file is missing, or was made for another platform or of other
        sources.
    """
    if not path.is_file() or law_hash().encode() not in path.read_bytes():
        return None  # loading a foreign file would execute it
    loader = ExtensionFileLoader("osc_law", str(path))
    spec = spec_from_loader("osc_law", loader)
    assert spec is not None
    try:
        module: Any = module_from_spec(spec)
        loader.exec_module(module)
    except ImportError:
        return None
    return module if law_hash() == module.LAW else None
