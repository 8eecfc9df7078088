"""Signals of the operating system that end the loop by an exception, but not amid a record."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, NoReturn, ParamSpec

Given = ParamSpec("Given")

#: What ends a program, where the system has it: signal → what is called by default.
_USUAL: dict[int, Any] = {
    getattr(signal, name): signal.default_int_handler if name == "SIGINT" else signal.SIG_DFL
    for name in ("SIGINT", "SIGTERM", "SIGHUP")
    if hasattr(signal, name)
}


class RaisedSignals:
    """Signals that end a block by an exception, as Ctrl-C always does, but not amid some calls.

    Attributes:
        seen: signals that came. busy: they are kept until later; the third one is not.
    """

    def __init__(self) -> None:
        """None came yet."""
        self.seen: list[int] = []
        self.busy = False

    @property
    def name(self) -> str:
        """Of the first, such as SIGTERM; empty: none came."""
        return signal.Signals(self.seen[0]).name if self.seen else ""

    def note(self, number: int, frame: FrameType | None) -> None:
        """Take a signal in: as a handler is called."""
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
        """End the block.

        Raises:
            KeyboardInterrupt: by Ctrl-C.
            SystemExit: by another signal, with 128 + its number, as a shell reports it.
        """
        if self.seen[0] == signal.SIGINT:
            raise KeyboardInterrupt
        raise SystemExit(128 + self.seen[0])


@contextmanager
def raised_signals() -> Iterator[RaisedSignals]:
    """Let signals end a block by an exception; those kept until its end are raised then."""
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
