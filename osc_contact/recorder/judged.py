"""Which ticks of a run its forces are judged at: those of closed contacts that have settled.

A contact's force is commanded in phases: the contact is approached, it lands, it is closed. Only a
closed contact has a force to judge; of the approach there is none, and the landing is judged by its
overshoot. What happens after a landing counts, contact lost or not, until no force is commanded.
"""

from collections.abc import Iterator, Mapping
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from osc_contact.recorder.recording import Recording

SETTLE_S = 1.0  #: judged from here on
LANDING_S = 0.35  #: a force is judged from so long after its contact closed: the landing
STEP_BLANK_S = 0.05  #: a force is not judged while a step of it rises, and this much longer
CLOSED = 2  #: of channel `contact_phase`: the controller takes the contact as closed
READ = ("t", "alpha_cmd", "closed", "contact_phase")  #: channels that decide

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


class JudgedTicks:
    """Finds the judged ticks, piece after piece.

    Attributes:
        columns: (r,) the contact of each force magnitude.
        landed: per contact, the time (s) at which it first closed; None: never.
        open: per contact, whether a force is commanded and the contact has not closed since.
    """

    def __init__(self, recording: Recording) -> None:
        """Begin before the first tick of a recording."""
        meta = recording.meta
        contacts = len(meta["contact_names"])
        self.columns = np.array(meta.get("columns", range(contacts)), dtype=int)
        blank = STEP_BLANK_S + meta.get("force_rise_s", 0.0)
        self._blanks = [(step, step + blank) for step in meta.get("force_steps_s", ())]
        self.landed: list[float | None] = [None] * contacts
        self.open = [False] * contacts
        self._since: list[float | None] = [None] * contacts

    def add(self, piece: Mapping[str, npt.NDArray[np.generic]]) -> tuple[Flags, Flags, Flags]:
        """Ticks that follow those before.

        Args:
            piece: channels `READ`, k ticks.

        Returns:
            (k, c) whether each contact is judged; (k, r) whether each force magnitude is: not
            while a commanded step rises; (k,) whether the run as a whole is: settled, no contact
            is approached or lands, and no step rises.
        """
        t = np.asarray(piece["t"], dtype=float)
        contacts = np.zeros((len(t), len(self.landed)), dtype=bool)
        whole = t >= SETTLE_S - 1e-9
        for i in range(len(self.landed)):
            commanded = (piece["alpha_cmd"][:, self.columns == i] != 0.0).any(axis=1)
            commanded |= piece["contact_phase"][:, i] == CLOSED
            closed = np.asarray(piece["closed"], dtype=bool)[:, i]
            contacts[:, i] = self._settled(i, t, commanded, closed)
            whole &= contacts[:, i] | ~commanded
        quiet = np.ones(len(t), dtype=bool)
        for begin, end in self._blanks:
            quiet &= ~((t >= begin - 1e-9) & (t < end - 1e-9))
        return (contacts, contacts[:, self.columns] & quiet[:, None], whole & quiet)

    def _settled(self, i: int, t: Array, commanded: Flags, closed: Flags) -> Flags:
        """Which ticks of contact i are judged."""
        settled = np.zeros(len(t), dtype=bool)
        if self.landed[i] is None and closed.any():
            self.landed[i] = float(t[np.argmax(closed)])
        for start, stop in stretches(commanded):
            if not commanded[start]:
                self._since[i] = None
                self.open[i] = False
                continue
            here = closed[start:stop]
            if self._since[i] is None and here.any():
                self._since[i] = float(t[start + int(np.argmax(here))])
            since = self._since[i]
            self.open[i] = since is None
            if since is not None:
                begin = max(SETTLE_S, since + LANDING_S if since > 0.0 else 0.0)
                settled[start:stop] = t[start:stop] >= begin - 1e-9
        return settled


def judged_ticks(recording: Recording) -> tuple[Flags, Flags]:
    """(T, r) whether each force magnitude is judged, (T,) whether the run is; see `JudgedTicks`."""
    ticks = JudgedTicks(recording)
    found = [ticks.add(piece)[1:] for piece in recording.pieces(*READ)]
    return (np.concatenate([one[0] for one in found]), np.concatenate([one[1] for one in found]))


def stretches(flags: Flags) -> Iterator[tuple[int, int]]:
    """[start, stop) of ticks with the same flag."""
    edges = np.flatnonzero(flags[1:] != flags[:-1]) + 1
    yield from pairwise([0, *edges.tolist(), len(flags)] if len(flags) else [])
