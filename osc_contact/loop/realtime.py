"""Real-time process of the control loop: priority, locked memory, deadlines, side work."""

from __future__ import annotations

import ctypes
import gc
import logging
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from math import inf
from time import sleep
from typing import Any

import numpy as np

from osc_contact.errors import PlantError
from osc_contact.files import Json
from osc_contact.loop.shadow import ShadowReport

_log = logging.getLogger(__name__)

PRIORITY = 80  #: SCHED_FIFO priority; network interrupts of real-time kernels have 50
SWITCH_S = 5e-5  #: s after which Python's other threads yield to the loop
BIN_S = 5e-6  #: s, width of the histogram's bins; times longer than 2 ms are in the last one
BINS = 400
LATE_SHARE = 0.5  #: latest time of the torques after a measurement, as a share of the period
LATE_CYCLES = 1.5  #: longest time between measurements, in periods
MOST_MISSED = 20  #: consecutive missed deadlines that end the loop
SLACK_SHARE = 0.1  #: share of the period for side work after the torques are sent
_LOCK_ALL = 3  # MCL_CURRENT | MCL_FUTURE


@dataclass
class LoopReport:
    """Timing of a control loop.

    A deadline is missed if torques are sent later than half a period after their measurement, or
    if a measurement is later than one and a half periods after the last one.

    Attributes:
        period: period of the loop (s).
        ticks: number of ticks.
        missed: number of missed deadlines.
        in_a_row: number of consecutive deadlines missed last.
        histogram: counts of the time from a measurement to its torques, in bins of 5 µs.
        largest: largest of these times (s).
        notes: sentences on requests that the system refused.
        shadow: result of a run with `shadow=True`; else None.
    """

    period: float
    ticks: int = 0
    missed: int = 0
    in_a_row: int = 0
    histogram: list[int] = field(default_factory=lambda: [0] * (BINS + 1), repr=False)
    largest: float = 0.0
    notes: list[str] = field(default_factory=list)
    shadow: ShadowReport | None = None
    _last_read: float = inf  #: clock at the last measurement (s)

    def note(self, read: float, seconds: float) -> None:
        """Count a tick and check its deadlines.

        A tick is late if its torques took more than the share `LATE_SHARE` of a period, or if its
        measurement came more than `LATE_CYCLES` periods after the last one. The first measurement
        is not late, since the time of the last one is infinite before it.

        Args:
            read: time of its measurement (s).
            seconds: time from then until its torques were sent (s).
        """
        self.histogram[min(int(seconds / BIN_S), BINS)] += 1
        self.largest = max(self.largest, seconds)
        late = (
            seconds > LATE_SHARE * self.period or read - self._last_read > LATE_CYCLES * self.period
        )
        self._last_read = read
        self.ticks += 1
        if late:
            self.missed += 1
            self.in_a_row += 1
        else:
            self.in_a_row = 0

    def require(self) -> None:
        """End the loop if too many consecutive deadlines were missed.

        Raises:
            PlantError: 20 consecutive deadlines were missed.
        """
        if self.in_a_row >= MOST_MISSED:
            raise PlantError(
                f"{self.in_a_row} deadlines in a row were missed, {self.missed} of {self.ticks} in "
                f"all: torques took up to {1e3 * self.largest:.3g} ms, a period is "
                f"{1e3 * self.period:g} ms. Free the machine of other work, permit real-time "
                "priority, or raise the period"
            )

    @property
    def read_to_write_us(self) -> dict[str, float]:
        """Quantiles (µs) of the time from a measurement to its torques, to 5 µs.

        The keys are "p50", "p99", "p99_9" and "max".
        """
        counts = np.cumsum(self.histogram)
        times = {}
        for name, share in (("p50", 0.5), ("p99", 0.99), ("p99_9", 0.999)):
            k = int(np.searchsorted(counts, share * self.ticks))
            times[name] = 1e6 * BIN_S * (k + 1)  # the upper end of the bin
        return {**times, "max": 1e6 * self.largest}

    def as_dict(self) -> Json:
        """Report as a dictionary for JSON, as stored in recordings."""
        names = ("ticks", "missed", "read_to_write_us", "histogram", "notes")
        return {name: getattr(self, name) for name in names}


def latency(loop: Mapping[str, Any]) -> str:
    """Sentence on times from a measurement to its torques and on missed deadlines.

    Args:
        loop: result of `LoopReport.as_dict`, as stored in recordings.
    """
    times = loop["read_to_write_us"]
    return (
        f"p50 {times['p50']:.0f} µs, p99.9 {times['p99_9']:.0f} µs, max {times['max']:.0f} µs; "
        f"{loop['missed']} of {loop['ticks']} deadlines missed"
    )


def at_once(call: Callable[[], object]) -> None:
    """Call a function immediately, the default of `Recorder.hand_over`."""
    call()


@contextmanager
def realtime_process() -> Iterator[list[str]]:
    """Request real-time priority and locked memory, and stop garbage collection, for a block.

    Yields:
        Sentences on requests that the system refused, which are also logged.
    """
    # real-time priority; `before` is restored at the end
    notes: list[str] = []
    before = None
    try:
        before = (os.sched_getscheduler(0), os.sched_getparam(0))
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except (AttributeError, OSError) as error:
        notes.append(
            f"no real-time priority ({error}): other processes delay ticks; permit it by "
            "'rtprio 99' in /etc/security/limits.conf"
        )
    # locked memory
    system = ctypes.CDLL(None, use_errno=True)
    if not hasattr(system, "mlockall") or system.mlockall(_LOCK_ALL):
        notes.append(
            f"memory is not locked ({os.strerror(ctypes.get_errno())}): a page that is fetched "
            "delays a tick; permit it by 'memlock unlimited' in /etc/security/limits.conf"
        )
    # no garbage collection; existing objects are frozen so that later collections skip them
    interval = sys.getswitchinterval()
    was_collecting = gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    sys.setswitchinterval(SWITCH_S)  # other threads give the interpreter back sooner
    for note in notes:
        _log.warning(note)
    try:
        yield notes
    finally:
        sys.setswitchinterval(interval)
        gc.unfreeze()
        if was_collecting:
            gc.enable()
        if hasattr(system, "munlockall"):
            system.munlockall()
        if before is not None:
            os.sched_setscheduler(0, *before)


class SideWork:
    """Thread for calls that may take long: writing files, showing pictures.

    It runs while the loop waits, one priority below it, and yields to it within 50 µs.

    Attributes:
        failure: first error of a call, or None; later calls are made even after an error.
    """

    def __init__(self, period: float) -> None:
        """Start the thread.

        Args:
            period: control period (s), of which the loop leaves a tenth to the thread when it has
                work.
        """
        #: time that the loop leaves to the thread in each period (s)
        self._slack = SLACK_SHARE * period
        self._executor = ThreadPoolExecutor(1, "side work", _lower_priority)  #: the thread
        self.failure: Exception | None = None
        # the thread begins with its first call, one without effect
        self._last_call: Future[None] = self._executor.submit(self._run_and_log, int)
        self._last_call.result()

    @property
    def idle(self) -> bool:
        """Whether the last call has been completed."""
        return self._last_call.done()

    def submit(self, call: Callable[[], object]) -> None:
        """Queue a call for the thread; an error in it is logged and stored in `failure`.

        Args:
            call: function without arguments.
        """
        self._last_call = self._executor.submit(self._run_and_log, call)

    def give_way(self) -> None:
        """Sleep for the slack time if calls are waiting; the loop calls this after its command."""
        if not self.idle:
            sleep(self._slack)

    def close(self) -> None:
        """Wait until all calls are completed, and end the thread."""
        self._executor.shutdown()

    def _run_and_log(self, call: Callable[[], object]) -> None:
        """Call a function of the side thread; log its exception, and store the first one."""
        try:
            call()
        except Exception as error:
            _log.exception("side work of the control loop failed")
            self.failure = self.failure or error


def _lower_priority() -> None:
    """Give the present thread a priority one below the loop's, if the process is real-time."""
    if hasattr(os, "SCHED_FIFO") and os.sched_getscheduler(0) == os.SCHED_FIFO:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY - 1))
