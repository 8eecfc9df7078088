"""A process made for the control loop: its priority and memory, its deadlines, its side work."""

from __future__ import annotations

import ctypes
import gc
import logging
import os
import sys
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from math import ceil, log1p
from threading import Event, Thread
from time import sleep
from typing import Any

from osc_contact.errors import PlantError
from osc_contact.runs.shadow import ShadowReport

__all__ = ["Deadlines", "LoopReport", "SideWork", "latency", "realtime_process"]

PRIORITY = 80  #: of SCHED_FIFO; network interrupts of real-time kernels have 50
SWITCH_S = 5e-5  #: after which Python's other threads give way to the loop
BIN_S = 5e-6  #: width of the histogram's bins; longer times than 2 ms share the last
BINS = 400
BARS = " ▁▂▃▄▅▆▇█"
BAR_BINS = 20  #: bins of the histogram that a bar shows
LATE_SHARE = 0.5  #: of the period from reading to writing; a robot needs the rest
LATE_CYCLES = 1.5  #: periods from one reading to the next
MOST_MISSED = 20  #: deadlines in a row
SLACK_SHARE = 0.1  #: of the period, after the torques are sent, that is left to side work
_LOCK_ALL = 3  # MCL_CURRENT | MCL_FUTURE
_log = logging.getLogger(__name__)


@dataclass
class LoopReport:
    """How a loop ran.

    Attributes:
        ticks: computed. missed: deadlines, see `Deadlines`.
        read_to_write_us: "p50", "p99", "p99_9", "max" of the time from a measurement to its
            torques, to 5 µs.
        histogram: counts of that time, in bins of 5 µs.
        notes: what the system did not permit, a sentence each.
        shadow: what a run with `shadow=True` found; else None.
    """

    ticks: int = 0
    missed: int = 0
    read_to_write_us: dict[str, float] = field(default_factory=dict)
    histogram: list[int] = field(default_factory=list, repr=False)
    notes: list[str] = field(default_factory=list)
    shadow: ShadowReport | None = None

    def as_dict(self) -> dict[str, Any]:
        """JSON-able form, which recordings carry."""
        names = ("ticks", "missed", "read_to_write_us", "histogram", "notes")
        return {name: getattr(self, name) for name in names}


def latency(loop: Mapping[str, Any]) -> str:
    """For people: times from a measurement to its torques, and their histogram.

    Args:
        loop: `LoopReport.as_dict`, as recordings carry it.
    """
    times = loop["read_to_write_us"]
    counts = loop["histogram"]
    bars = [sum(counts[k : k + BAR_BINS]) for k in range(0, len(counts), BAR_BINS)]
    most = log1p(max(*bars, 1))
    drawn = "".join(BARS[ceil((len(BARS) - 1) * log1p(n) / most)] for n in bars)
    return (
        f"p50 {times['p50']:.0f} µs, p99.9 {times['p99_9']:.0f} µs, max {times['max']:.0f} µs; "
        f"{loop['missed']} of {loop['ticks']} deadlines missed; a bar for "
        f"{1e6 * BAR_BINS * BIN_S:.0f} µs, logarithms of counts: |{drawn}|"
    )


class Deadlines:
    """When torques were sent, tick by tick.

    A deadline is missed where torques come later than half a period after their measurement, or a
    measurement later than one and a half periods after the last one.
    """

    def __init__(self, period: float) -> None:
        """Begin a loop of this period (s)."""
        self.period = period
        self.counts = [0] * (BINS + 1)
        self.largest = 0.0
        self.ticks = self.missed = self.in_a_row = 0
        self.last: float | None = None

    def note(self, read: float, seconds: float) -> None:
        """One tick.

        Args:
            read: s, when it was measured. seconds: from then until its torques were sent.
        """
        self.counts[min(int(seconds / BIN_S), BINS)] += 1
        self.largest = max(self.largest, seconds)
        cycle = 0.0 if self.last is None else read - self.last
        late = seconds > LATE_SHARE * self.period or cycle > LATE_CYCLES * self.period
        self.last = read
        self.ticks += 1
        self.missed += late
        self.in_a_row = self.in_a_row + 1 if late else 0

    def require(self) -> None:
        """Refuse to continue once too many in a row were missed.

        Raises:
            PlantError: 20 were.
        """
        if self.in_a_row >= MOST_MISSED:
            raise PlantError(
                f"{self.in_a_row} deadlines in a row were missed, {self.missed} of {self.ticks} in "
                f"all: torques took up to {1e3 * self.largest:.3g} ms, a period is "
                f"{1e3 * self.period:g} ms. Free the machine of other work, permit real-time "
                "priority, or raise the period"
            )

    def report(self, notes: list[str]) -> LoopReport:
        """Of the loop so far; `notes` are handed on."""
        shares = {"p50": 0.5, "p99": 0.99, "p99_9": 0.999}
        found = {name: 1e6 * BIN_S * self._bin(share) for name, share in shares.items()}
        found["max"] = 1e6 * self.largest
        return LoopReport(self.ticks, self.missed, found, self.counts, notes)

    def _bin(self, share: float) -> int:
        """Upper end of the bin below which this share is."""
        left = share * self.ticks
        for k, count in enumerate(self.counts):
            left -= count
            if left <= 0:
                return k + 1
        return BINS + 1


@contextmanager
def realtime_process() -> Iterator[list[str]]:
    """Real-time priority, locked memory, no garbage collection; what is not permitted, as notes."""
    notes: list[str] = []
    before = None
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except (AttributeError, OSError) as error:
        notes.append(
            f"no real-time priority ({error}): other processes delay ticks; permit it by "
            "'rtprio 99' in /etc/security/limits.conf"
        )
    system = ctypes.CDLL(None, use_errno=True)
    if not hasattr(system, "mlockall") or system.mlockall(_LOCK_ALL):
        notes.append(
            f"memory is not locked ({os.strerror(ctypes.get_errno())}): a page that is fetched "
            "delays a tick; permit it by 'memlock unlimited' in /etc/security/limits.conf"
        )
    interval = sys.getswitchinterval()
    collecting = gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    sys.setswitchinterval(SWITCH_S)
    for note in notes:
        _log.warning(note)
    try:
        yield notes
    finally:
        sys.setswitchinterval(interval)
        gc.unfreeze()
        if collecting:
            gc.enable()
        if hasattr(system, "munlockall"):
            system.munlockall()
        if before is not None:
            os.sched_setscheduler(0, *before)


class SideWork:
    """A thread for what may take long: files, viewers.

    It runs while the loop waits, one priority below it, and gives way within 50 µs.

    Attributes:
        failure: the first error of a call; the calls after it are made all the same.
    """

    def __init__(self, period: float) -> None:
        """Begin; the loop leaves a tenth of its period (s) to it where there is work."""
        self._slack = SLACK_SHARE * period
        self._calls: deque[Callable[[], object]] = deque()
        self._there = Event()
        self._ended = False
        self.failure: Exception | None = None
        self._thread = Thread(target=self._work, name="side work", daemon=True)
        self._thread.start()

    @property
    def idle(self) -> bool:
        """Whether nothing is left to do."""
        return not self._calls

    def submit(self, call: Callable[[], object]) -> None:
        """Have something done soon; an error of it is logged, and kept as `failure`."""
        self._calls.append(call)
        self._there.set()

    def give_way(self) -> None:
        """Called by the loop when its torques are sent."""
        if self._calls:
            sleep(self._slack)

    def close(self) -> None:
        """Wait until everything is done."""
        self._ended = True
        self._there.set()
        self._thread.join()

    def _work(self) -> None:
        if hasattr(os, "SCHED_FIFO") and os.sched_getscheduler(0) == os.SCHED_FIFO:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY - 1))
        while self._calls or not self._ended:
            self._there.wait()
            self._there.clear()
            while self._calls:
                try:
                    self._calls[0]()
                except Exception as error:
                    _log.exception("side work of the control loop failed")
                    self.failure = self.failure or error
                self._calls.popleft()
