"""How a run is asked to end: between two ticks, by Ctrl-C or SIGTERM."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

__all__ = ["asked_to_end", "until"]

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
T = TypeVar("T")


@contextmanager
def asked_to_end() -> Iterator[Callable[[], bool]]:
    """Whether Ctrl-C was pressed or SIGTERM sent since the block began.

    The first time is only noted; the second ends the program as always. Signals come to the main
    thread: in others, and where another handler is set, nothing changes.
    """
    seen: list[int] = []
    before: dict[int, Any] = {}

    def note(number: int, frame: Any) -> None:
        seen.append(number)
        for one, handler in before.items():
            signal.signal(one, handler)

    if threading.current_thread() is threading.main_thread():
        usual = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}
        before = {n: usual[n] for n in _SIGNALS if signal.getsignal(n) == usual[n]}
        for number in before:
            signal.signal(number, note)
    try:
        yield lambda: bool(seen)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def until(asked: Callable[[], bool], items: Iterable[T]) -> Iterator[T]:
    """Items until the end is asked for."""
    for item in items:
        if asked():
            return
        yield item
