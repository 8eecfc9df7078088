"""Selection of the ticks of a run at which contact forces are judged: settled, closed contacts.

The phases of a contact are approach, landing and closed contact. A force is judged only in the last
one; the approach has no force, and the landing is judged by its overshoot. After the landing all
ticks count, even if the contact is lost, until no force is commanded and the contact is not active.
A contact that is active but not named any more is unloaded: it alone is not judged.
"""

from collections.abc import Iterator, Mapping
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from osc_contact.recorder.recording import Recording

SETTLE_S = 1.0  #: time from which a run is judged (s)
LANDING_S = 0.35  #: time from the closing of a contact until its force is judged (s)
STEP_BLANK_S = 0.05  #: time after the rise of a force step during which forces are not judged (s)
#: Values of channel `contact_phase` of contacts that are not active, and that the controller treats
#: as closed.
OPEN, CLOSED = 0, 2
#: Channels that are read; recordings of earlier versions lack `contact_named`.
READ = ("t", "alpha_cmd", "closed", "contact_phase", "contact_named")

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


class JudgedTicks:
    """Selection of the judged ticks of a recording, piece by piece.

    Attributes:
        columns: (r,) index of the contact of each force magnitude.
        landed: for each contact, the time at which it first closed (s); None: not yet.
        open: for each contact, True while it is commanded but has not closed.
    """

    def __init__(self, recording: Recording) -> None:
        """Begin before the first tick of a recording, with all contacts closed for no time.

        Args:
            recording: recording of a run, of which names of contacts, columns of forces, times of
                force steps and their rise time (s) are read.
        """
        meta = recording.meta
        contacts = len(meta["contact_names"])
        self.columns = np.array(meta.get("columns", range(contacts)), dtype=int)
        blank = STEP_BLANK_S + meta.get("force_rise_s", 0.0)
        #: intervals after steps of force that are not judged (s)
        self._blanks = [(step, step + blank) for step in meta.get("force_steps_s", ())]
        self.landed: list[float | None] = [None] * contacts
        self.open = [False] * contacts
        #: time at which each contact closed (s); None while it is open
        self._since: list[float | None] = [None] * contacts

    def add(self, piece: Mapping[str, npt.NDArray[np.generic]]) -> tuple[Flags, Flags, Flags]:
        """Flags of judged ticks in the next piece of the recording.

        Args:
            piece: channels `READ` of the k ticks that follow those of the last call.

        Returns:
            (k, c) flags of each contact; (k, r) flags of each force magnitude, not set while a
            commanded step rises; (k,) flags of the run as a whole, set after it has settled while
            no contact is approached or lands and no step rises. A contact that is unloaded is not
            judged itself; the others and the run are.
        """
        t = np.asarray(piece["t"], dtype=float)
        contacts = np.zeros((len(t), len(self.landed)), dtype=bool)
        is_whole = t >= SETTLE_S - 1e-9
        for i in range(len(self.landed)):
            commanded = (piece["alpha_cmd"][:, self.columns == i] != 0.0).any(axis=1)
            commanded |= piece["contact_phase"][:, i] != OPEN
            closed = np.asarray(piece["closed"], dtype=bool)[:, i]
            contacts[:, i] = self._judged_ticks(i, t, commanded, closed)
            is_whole &= contacts[:, i] | ~commanded
        if "contact_named" in piece:
            contacts &= np.asarray(piece["contact_named"], dtype=bool)
        quiet = np.ones(len(t), dtype=bool)
        for begin, end in self._blanks:
            quiet &= ~((t >= begin - 1e-9) & (t < end - 1e-9))
        return (contacts, contacts[:, self.columns] & quiet[:, None], is_whole & quiet)

    def _judged_ticks(self, i: int, t: Array, commanded: Flags, closed: Flags) -> Flags:
        """Flags (k,) of the ticks at which contact i is judged.

        A contact is judged from `LANDING_S` after it first closed, and not before `SETTLE_S`, until
        no force is commanded; a contact that was closed from the first tick on has not landed.

        Args:
            i: index of the contact.
            t: (k,) times (s).
            commanded: (k,) whether a force is commanded, or contact with none.
            closed: (k,) whether the contact is closed.
        """
        settled = np.zeros(len(t), dtype=bool)
        if self.landed[i] is None and closed.any():
            self.landed[i] = float(t[np.argmax(closed)])
        for start, stop in stretches(commanded):
            if not commanded[start]:
                self._since[i] = None
                self.open[i] = False
                continue
            closed_here = closed[start:stop]
            if self._since[i] is None and closed_here.any():
                self._since[i] = float(t[start + int(np.argmax(closed_here))])
            since = self._since[i]
            self.open[i] = since is None
            if since is not None:
                landed = since + LANDING_S if since > 0.0 else 0.0
                begin = max(SETTLE_S, landed)
                settled[start:stop] = t[start:stop] >= begin - 1e-9
        return settled


def judged_ticks(recording: Recording) -> tuple[Flags, Flags]:
    """Flags of judged ticks: (T, r) of force magnitudes, (T,) of the run; see `JudgedTicks`.

    Args:
        recording: recording of a run.
    """
    ticks = JudgedTicks(recording)
    magnitude_flags = []
    run_flags = []
    for piece in recording.pieces(*(name for name in READ if name in recording)):
        _, magnitudes, run = ticks.add(piece)
        magnitude_flags.append(magnitudes)
        run_flags.append(run)
    return (np.concatenate(magnitude_flags), np.concatenate(run_flags))


def stretches(flags: Flags) -> Iterator[tuple[int, int]]:
    """Yield the ranges [start, stop) of successive ticks with equal flags.

    Args:
        flags: (k,) flag of each tick.
    """
    if not len(flags):
        return
    edges = np.flatnonzero(flags[1:] != flags[:-1]) + 1
    yield from pairwise([0, *edges.tolist(), len(flags)])
