"""What is told while the control tick is compiled, and that nothing is told when it is loaded."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
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

PARTS = """
from osc_contact.kernels.compile import compiled, cube, entry, integers, matrix, pose_in, vector

@compiled
def element(x, i):
    return x[i]

@entry
def kernel(bound, i):
    x, y = vector(bound, 1), matrix(bound, 2)
    y[1, 2] = 1000.0 * element(x, 0) + element(x, i) + element(x[2:], 1)
    integers(bound, 3)[1, 0] += 1
    cube(bound, 0)[1, 1, 2] = y.shape[0]
    return pose_in(x, 1)[3, 2]
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


def test_parts_reach_the_bound_arrays_and_are_compiled_once_for_all_integers(
    tmp_path: Path,
) -> None:
    path = tmp_path / "parts.py"
    path.write_text(PARTS)
    arrays = np.zeros((2, 2, 3)), np.arange(20.0), np.zeros((2, 3)), np.ones((2, 1), dtype=int)
    bound = np.zeros((4, 4), dtype=np.int64)
    for row, array in enumerate(arrays):
        bound[row, 0] = array.ctypes.data
        bound[row, 1 : 1 + array.ndim] = array.shape
    module = load(path)
    assert module.kernel(bound, 7) == 15.0
    cube, _, matrix, integers = arrays
    assert matrix.tolist() == [[0, 0, 0], [0, 0, 7 + 3]]
    assert cube[1, 1, 2] == 2 and np.count_nonzero(cube) == 1
    assert integers.tolist() == [[1], [2]]
    if not getattr(config, "DISABLE_JIT"):  # noqa: B009 - set at run time
        assert len(module.element.signatures) == 1
