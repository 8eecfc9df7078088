"""The law as a library made beforehand: wheels hold it, and need no compiler.

osc_law.abi3.so is `extension.c` with law.o of `c_object`, which lies beside it; one pair of files
serves every Python from 3.11 on. It is used where it was made from the very sources that lie here;
elsewhere numba compiles them. OSC_CONTACT_LAW: path of another such file, or "jit": use none.

    python -m osc_contact.law.c_object FOLDER      makes both files
"""

from __future__ import annotations

import os
from importlib.machinery import ExtensionFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from typing import Any

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
