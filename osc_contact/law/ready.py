"""The law as a library made beforehand: wheels hold it, and need no compiler.

osc_law.abi3.so is `extension.c` with law.o of `c_object`, which lies beside it; one pair of files
serves every Python from 3.11 on. It is used where it was made from the very sources that lie here;
elsewhere numba compiles them. OSC_CONTACT_LAW: path of another such file, or "jit": use none.

    python -m osc_contact.law.ready FOLDER      makes both files
"""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
from importlib.machinery import ExtensionFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from typing import Any

from osc_contact.errors import OscContactError
from osc_contact.law.sources import law_hash

LIBRARY = "osc_law.abi3.so"
OBJECT = "law.o"


def load() -> Any:
    """The library that fits the sources; None: there is none."""
    where = os.environ.get("OSC_CONTACT_LAW", "")
    path = Path(where) if where else Path(__file__).parent / LIBRARY
    if where == "jit" or not path.is_file():
        return None
    loader = ExtensionFileLoader("osc_law", str(path))
    spec = spec_from_loader("osc_law", loader)
    assert spec is not None
    try:
        module: Any = module_from_spec(spec)
        loader.exec_module(module)
    except ImportError:  # of another platform
        return None
    return module if law_hash() == module.LAW else None


def build(folder: Path, code: bytes) -> None:
    """Make both files.

    Args:
        folder: where. code: of `c_object.object_file`.

    Raises:
        OscContactError: there is no C compiler, or it has no headers of Python.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / OBJECT).write_bytes(code)
    source = Path(__file__).with_name("extension.c")
    include = sysconfig.get_paths()["include"]
    compiler = os.environ.get("CC", "cc")
    command = [compiler, "-O2", "-shared", "-fPIC", f"-I{include}", f'-DLAW="{law_hash()}"']
    command += [str(source), str(folder / OBJECT), "-lm", "-o", str(folder / LIBRARY)]
    try:
        done = subprocess.run(command, capture_output=True, text=True)
    except OSError as error:
        raise OscContactError(f"no C compiler: {error}") from error
    if done.returncode != 0:
        raise OscContactError(f"{compiler} cannot build the law: {done.stderr.strip()[-500:]}")


if __name__ == "__main__":
    os.environ["OSC_CONTACT_LAW"] = "jit"
    from osc_contact.law.c_object import object_file

    build(Path(sys.argv[1]), object_file())
