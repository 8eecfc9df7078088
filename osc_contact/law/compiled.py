"""Compiled functions of the law for Python, made or loaded when first used.

Compiling takes a minute (three without a C compiler), once on a machine. Listeners receive a
message and the progress.
"""

from __future__ import annotations

import gc
import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from time import perf_counter
from typing import Any

import numpy as np

from osc_contact.law import jit, operational
from osc_contact.law import rows as law
from osc_contact.law.records import Rows, new_model

_log = logging.getLogger(__name__)


def _nowhere(share: float) -> None:
    """Ignore the completed share of a compilation (0 … 1), until a display is set."""


_shown: list[Callable[[float], None]] = [_nowhere]


@cache
def rows() -> Any:
    """Return the compiled `law.rows.rows`; it raises a TypeError for arguments of other types.

    numba compiles it for the types of its arguments, here of arrays without rows: q, v, wrenches,
    X_WD, V_D, A_D, alpha_d, touched bodies and active contacts. A JOB without rows computes
    nothing.
    """
    no_numbers = np.zeros(0)
    no_rows = Rows(new_model(1, 1, 1))
    no_rows.job.last = 0
    wrenches = np.zeros((0, 6))
    X_WD = np.zeros((0, 4))
    inputs = (
        no_numbers,
        no_numbers,
        wrenches,
        X_WD,
        no_numbers,
        no_numbers,
        no_numbers,
        np.zeros((0, 28)),
        no_numbers,
    )
    return _compiled_call(law.rows, no_rows.raw, 0, inputs)


@cache
def operational_space() -> Any:
    """Return the compiled `law.operational.operational_space`.

    It raises a TypeError for arguments of other types than those of this first call, without rows.
    """
    no_numbers = np.zeros(0)
    return _compiled_call(
        operational.operational_space,
        Rows(new_model(1, 1, 1)).raw,
        no_numbers,
        no_numbers,
        no_numbers[:, None],
    )


def _compiled_call(call: Any, *nothing: Any) -> Any:
    """Return the function that Python calls for an entry of the law, compiled for one signature.

    An entry of the library is compiled already. In numba's usual way it is compiled here, by a call
    with empty arguments, and for no other types afterwards. In plain Python it is the entry itself.

    Args:
        call: entry of the law.
        *nothing: arguments of the right types without content.
    """
    if isinstance(call, jit.Entry):
        return call.call
    if not jit.PLAIN_PYTHON:
        with announced():
            call(*nothing)
        call.disable_compile()
    return call


@contextmanager
def announced() -> Iterator[Callable[[float], None]]:
    """Log (INFO) that the law is compiled in this block, and the time it took.

    The block gets a function that shows the completed share of the work; at the end 1 is shown.
    Garbage collection runs less often in the block: numba makes millions of lasting objects, and a
    tenth of the time would be spent on them.
    """
    began = perf_counter()
    thresholds = gc.get_threshold()
    gc.set_threshold(50_000, 20, 100)
    _log.info("compiling the control tick, once: a minute (without a C compiler, three) …")
    _shown[-1](0.0)
    try:
        yield _shown[-1]
    finally:
        gc.set_threshold(*thresholds)
        _shown[-1](1.0)
    _log.info("compiled in %.0f s", perf_counter() - began)


class _Listener(logging.Handler):
    """Handler of a logger that passes messages to a function."""

    def __init__(self, say: Callable[[str], None]) -> None:
        """Make the handler.

        Args:
            say: called with the text of each message.
        """
        super().__init__()
        self.say = say

    def emit(self, record: logging.LogRecord) -> None:
        """Pass the text of a log record to the function."""
        self.say(record.getMessage())


def report_to(say: Callable[[str], None], show: Callable[[float], None] = _nowhere) -> None:
    """Set the listeners of messages and progress.

    Args:
        say: called with each line of a message.
        show: called with the completed share, 0 … 1, and with 1 at the end in any case.
    """
    _log.handlers = [_Listener(say)]
    _log.setLevel(logging.INFO)
    _shown[:] = [show]
