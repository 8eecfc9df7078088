"""The compiled functions of the law, made or loaded from the cache when first asked for.

Compiling takes most of a minute, once on a machine; listeners get a message.
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

from osc_contact.law import tables as at
from osc_contact.law import tick as law
from osc_contact.law.jit import PLAIN_PYTHON, forget_code

__all__ = ["announced", "rows", "tell"]

_log = logging.getLogger(__name__)
_usual: list[tuple[int, int, int]] = []  #: thresholds that `announced` has met


@cache
def rows() -> Any:
    """The tick over rows, see `law.tick.build`; other types than its own are a TypeError."""
    call = law.build(0)  # `jit.entry` marks what is cached with the sources
    if PLAIN_PYTHON:
        return call
    none, raw = np.zeros(0), np.zeros(at.CHAIN_BYTES, np.uint8)
    with announced():
        call(
            raw, raw, raw, none, none, np.zeros((0, 6)), np.zeros((0, 4)), none, none, none, none,
            np.zeros((0, 28)), 0, none, np.zeros(0, np.int64), law.LOOK, law.END, 0, 0,
        )  # fmt: skip
    call.disable_compile()
    forget_code(call)
    return call


@contextmanager
def announced() -> Iterator[None]:
    """Log (INFO) when numba begins to compile inside the block, and how long it took.

    Python looks through its objects for those to give back less often meanwhile: numba makes
    millions that stay, and a tenth of the time would go there.
    """
    from numba.core import event

    began: list[float] = []
    _usual.append(gc.get_threshold())

    class Begun(event.Listener):
        def on_start(self, event: Any) -> None:
            if not began:
                began.append(perf_counter())
                gc.set_threshold(50_000, 20, 100)
                _log.info("compiling the control tick: about a minute, then it is cached …")

        def on_end(self, event: Any) -> None:
            pass

    try:
        with event.install_listener("numba:compile", Begun()):
            yield
    finally:
        gc.set_threshold(*_usual.pop())  # of another thread's, if one has begun meanwhile
    if began:
        _log.info("compiled in %.0f s", perf_counter() - began[0])


class _Teller(logging.Handler):
    def __init__(self, say: Callable[[str], None]) -> None:
        super().__init__()
        self.say = say

    def emit(self, record: logging.LogRecord) -> None:
        self.say(record.getMessage())


def tell(say: Callable[[str], None]) -> None:
    """Hand these messages to `say`, in place of the former listener."""
    _log.handlers = [_Teller(say)]
    _log.setLevel(logging.INFO)
