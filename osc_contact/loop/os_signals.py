"""Signals of the operating system that end the loop by an exception, but not during a record."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, NoReturn, ParamSpec

Parameters = ParamSpec("Parameters")  #: arguments of a protected call

#: Signals that end a program, with Python's default handlers, as far as the system has them.
_DEFAULT_HANDLERS: dict[int, Any] = {
    getattr(signal, name): signal.default_int_handler if name == "SIGINT" else signal.SIG_DFL
    for name in ("SIGINT", "SIGTERM", "SIGHUP")
    if hasattr(signal, name)
}


class RaisedSignals:
    """Signals that end a block by an exception, as Ctrl-C does, but not during protected calls.

    Attributes:
        seen: numbers of the signals received.
        busy: True while signals are deferred; a third signal is never deferred.
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

    def whole(
        self, call: Callable[Parameters, None], *args: Parameters.args, **kwargs: Parameters.kwargs
    ) -> None:
        """Call a function with signals deferred; a deferred signal ends the block after the call.

        Args:
            call: function that must not be interrupted, such as `Recorder.append`.
            args, kwargs: arguments of the function.
        """
        self.busy = True
        call(*args, **kwargs)
        self.busy = False
        if self.seen:
            self.end()

    def end(self) -> NoReturn:
        """Raise the exception of the first signal.

        Raises:
            KeyboardInterrupt: the signal is SIGINT, sent by Ctrl-C.
            SystemExit: the signal is another one; the exit code is 128 plus its number, the
                convention of shells.
        """
        if self.seen[0] == signal.SIGINT:
            raise KeyboardInterrupt
        raise SystemExit(128 + self.seen[0])


@contextmanager
def raised_signals() -> Iterator[RaisedSignals]:
    """Context in which signals end a block by an exception; deferred ones do so at its end.

    Only default handlers are replaced, so that a program's own handlers stay in use, and only in
    the main thread, because Python handles signals there.

    Yields:
        Signals received so far, and the calls that no signal interrupts.
    """
    signals = RaisedSignals()
    if threading.current_thread() is threading.main_thread():
        for number, default in _DEFAULT_HANDLERS.items():
            if signal.getsignal(number) == default:
                signal.signal(number, signals.note)
    try:
        yield signals
    finally:
        for number, default in _DEFAULT_HANDLERS.items():
            if signal.getsignal(number) == signals.note:
                signal.signal(number, default)
    if signals.seen:
        signals.end()
