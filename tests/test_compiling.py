"""What is told while the control tick is compiled, and that nothing is told when it is loaded."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

from numba import config  # type: ignore[attr-defined]

from osc_contact.control.compiling import announced, tell

SOURCE = """
from numba import njit

@njit
def twice(x):
    return 2 * x

@njit(cache=True)
def kernel(x):
    return twice(x) + 1
"""


def load(path: Path) -> Any:
    """The module anew, as another process would see it."""
    spec = importlib.util.spec_from_file_location("compiled_somewhere", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_compiling_is_announced_once_and_loading_is_not(tmp_path: Path) -> None:
    path, told, earlier = tmp_path / "kernel.py", [], []
    path.write_text(SOURCE)
    tell(earlier.append)
    tell(told.append)
    try:
        first, second = load(path), load(path)
        with announced():
            assert first.kernel(3) == 7
        if getattr(config, "DISABLE_JIT"):  # noqa: B009 - set at run time
            assert not told
            return
        assert len(told) == 2
        assert told[0].startswith("compiling the control tick") and told[1].startswith("compiled")
        with announced():
            assert second.kernel(3) == 7
            assert first.kernel(5) == 11
        assert len(told) == 2 and not earlier
    finally:
        tell(lambda text: None)
