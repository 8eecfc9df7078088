"""Says so when the control tick is really compiled, which takes a minute, not just loaded."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import perf_counter
from typing import Any

__all__ = ["announced", "tell"]

_log = logging.getLogger(__name__)


@contextmanager
def announced() -> Iterator[None]:
    """Log (INFO) when numba begins to compile inside the block, and how long it took."""
    from numba.core import event

    began: list[float] = []

    class Begun(event.Listener):
        def on_start(self, event: Any) -> None:
            if not began:
                began.append(perf_counter())
                _log.info("compiling the control tick: about a minute, then it is cached …")

        def on_end(self, event: Any) -> None:
            pass

    with event.install_listener("numba:compile", Begun()):
        yield
    if began:
        _log.info("compiled in %.0f s", perf_counter() - began[0])


class _Teller(logging.Handler):
    def __init__(self, say: Callable[[str], None]) -> None:
        super().__init__()
        self.say = say

    def emit(self, record: logging.LogRecord) -> None:
        self.say(record.getMessage())


def tell(say: Callable[[str], None]) -> None:
    """Hand these messages to `say`, in place of whoever was told before."""
    _log.handlers = [_Teller(say)]
    _log.setLevel(logging.INFO)
