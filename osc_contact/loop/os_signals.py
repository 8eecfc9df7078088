"""Signals of the operating system that end the loop by an exception, but not during a record."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, NoReturn, ParamSpec

Given = ParamSpec("Given")

#: Signals that end a program, with their default handlers, as far as the system has them.
_USUAL: dict[int, Any] = {
    getattr(signal, name): signal.default_int_handler if name == "SIGINT" else signal.SIG_DFL
    for name in ("SIGINT", "SIGTERM", "SIGHUP")
    if hasattr(signal, name)
}


class RaisedSignals:
    """Signals that end a block by an exception, as Ctrl-C does, but not during protected calls.

    Attributes:
        seen: numbers of the signals received. busy: True while signals are deferred; a third signal
            is never deferred.
    """

    def __init__(self) -> None:
        """Begin without signals."""
        self.seen: list[int] = []
        self.busy = False

    @property
    def name(self) -> str:
        """Name of the first signal received, for example SIGTERM; empty without one."""
        return signal.Signals(self.seen[0]).name if self.seen else ""

    def note(self, number: int, frame: FrameType | None) -> None:
        """Signal handler: store the signal, and end the block unless it is deferred."""
        self.seen.append(number)
        if not self.busy or len(self.seen) > 2:
            self.end()

    def whole(self, call: Callable[Given, None], *given: Given.args, **named: Given.kwargs) -> None:
        """Call something that no signal interrupts; one that came meanwhile ends the block then.

        Args:
            call: function.
            given, named: its arguments.
        """
        self.busy = True
        call(*given, **named)
        self.busy = False
        if self.seen:
            self.end()

    def end(self) -> NoReturn:
        """Raise the exception of the first signal.

        Raises:
            KeyboardInterrupt: the signal is that of Ctrl-C.
            SystemExit: another signal; the exit code is 128 plus its number, as of a shell.
        """
        if self.seen[0] == signal.SIGINT:
            raise KeyboardInterrupt
        raise SystemExit(128 + self.seen[0])


@contextmanager
def raised_signals() -> Iterator[RaisedSignals]:
    """Context in which signals end a block by an exception; deferred ones do so at its end."""
    signals = RaisedSignals()
    if threading.current_thread() is threading.main_thread():
        for number, usual in _USUAL.items():
            if signal.getsignal(number) == usual:
                signal.signal(number, signals.note)
    try:
        yield signals
    finally:
        for number, usual in _USUAL.items():
            if signal.getsignal(number) == signals.note:
                signal.signal(number, usual)
    if signals.seen:
        signals.end()
