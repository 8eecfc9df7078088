"""The compiled functions of the law, made or loaded from the cache when first used.

Compiling takes one to three minutes, once on a machine; listeners get a message and the progress.
"""

from __future__ import annotations

import gc
import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from time import perf_counter
from types import ModuleType
from typing import Any

import numpy as np

from osc_contact.law import terms
from osc_contact.law import tick as law
from osc_contact.law.jit import COMPILES, READY
from osc_contact.law.records import Rows, new_model

_log = logging.getLogger(__name__)
_usual: list[tuple[int, int, int]] = []  #: thresholds that `announced` has met
_PARTS = 2.0 / 3.0  #: of the time is over when all parts are translated; the rest is machine code


def _nowhere(share: float) -> None:
    """Where progress goes as long as no display is set."""


_shown: list[Callable[[float], None]] = [_nowhere]


@cache
def rows() -> Any:
    """The tick over rows, see `law.tick.rows`; other types than its own are a TypeError."""
    none = np.zeros(0)
    empty = Rows(new_model(1, 1, 1))
    empty.job.last = 0
    none_6 = np.zeros((0, 6))
    none_4 = np.zeros((0, 4))
    given = none, none, none_6, none_4, none, none, none, np.zeros((0, 28))
    return _made(law.rows, empty.raw, 0, *given)


@cache
def operational_space() -> Any:
    """The terms of one arm, see `law.terms.operational_space`, likewise."""
    none = np.zeros(0)
    return _made(terms.operational_space, Rows(new_model(1, 1, 1)).raw, none, none, none[:, None])


def _made(call: Any, *nothing: Any) -> Any:
    """An entry, compiled by a call for nothing; what it compiles for is then settled."""
    if READY is not None:
        return call.call
    if COMPILES:
        with announced(call):
            call(*nothing)
        call.disable_compile()
    return call


def parts_of(call: Any) -> set[Any]:
    """The functions of the law that an entry calls, directly or not."""
    found: set[Any] = set()
    left = [getattr(call, "__wrapped__", call)]
    while left:
        function = left.pop()
        names = function.__code__.co_names
        space = function.__globals__
        modules = [space[name] for name in names if isinstance(space.get(name), ModuleType)]
        called = [space.get(name) for name in names]
        called += [getattr(module, name, None) for module in modules for name in names]
        parts = {getattr(one, "py_func", None) for one in called} - {None} - found
        found |= parts
        left += parts
    return found


@contextmanager
def announced(call: Any = None) -> Iterator[None]:
    """Log (INFO) when numba begins to compile inside the block, and how long it took.

    The display of `report_to` gets the share of the work that is done. Python looks through its
    objects for those to give back less often meanwhile: numba makes millions that stay,
    and a tenth of the time would go there.

    Args:
        call: the entry that may be compiled, whose functions are counted.
    """
    from numba.core import event

    began: list[float] = []
    left = set() if call is None else parts_of(call)
    count = len(left)
    _usual.append(gc.get_threshold())

    class Compiling(event.Listener):
        def on_start(self, event: Any) -> None:
            if not began:
                began.append(perf_counter())
                gc.set_threshold(50_000, 20, 100)
                _log.info("compiling the control tick: one to three minutes, then it is cached …")

        def on_end(self, event: Any) -> None:
            left.discard(event.data["dispatcher"].py_func)
            _shown[-1](_PARTS * (1.0 - len(left) / max(1, count)))

    try:
        with event.install_listener("numba:compile", Compiling()):
            yield
    finally:
        gc.set_threshold(*_usual.pop())  # of another thread's, if one has begun meanwhile
        if began:
            _shown[-1](1.0)
    if began:
        _log.info("compiled in %.0f s", perf_counter() - began[0])


class _Teller(logging.Handler):
    def __init__(self, say: Callable[[str], None]) -> None:
        super().__init__()
        self.say = say

    def emit(self, record: logging.LogRecord) -> None:
        self.say(record.getMessage())


def report_to(say: Callable[[str], None], show: Callable[[float], None] = _nowhere) -> None:
    """Hand these messages to `say`, and progress to `show`, in place of the former listeners.

    Args:
        say: takes a line. show: takes the share that is done, 0 … 1; 1 at the end in any case.
    """
    _log.handlers = [_Teller(say)]
    _log.setLevel(logging.INFO)
    _shown[:] = [show]
