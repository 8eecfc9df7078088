"""Contact phases: which contacts are open, approached or closed, and what that means for the law.

    OPEN ── a force is wanted ──▶ APPROACHING ── contact made ──▶ CLOSED
     ▲                             │      ▲                         │
     └──── no force is wanted ─────┘      └────── contact lost ─────┤
     └──────────────────── no force is wanted ──────────────────────┘

An open contact is out of N: its column is free motion. A closed one is in N under the law of
fig. 5. An approaching one is in N too, but in place of the force law it gets a damper that drags it
towards its face at a set speed, α_u = K_a (v_a − NᵀV_rel): a guarded move, which pushes with no
more than K_a v_a when the face is met before anybody has noticed. So N does not change at the
moment of impact, and every magnitude of a contact to be made is measured by the filter of fig. 5.
Made and lost is told by `monitor.watched`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from osc_contact.control.force import ForceGains
from osc_contact.control.phases import Phase, PhaseSettings
from osc_contact.spatial import Array
from readable.low_pass import FilteredForce, filter_force
from readable.monitor import MonitorState, watched

__all__ = ["ContactPhases", "PhaseSettings", "PhaseState", "Phase", "commanded", "lived", "slewed"]

Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class PhaseState:
    """Where each contact stands.

    Attributes:
        phase: (contacts,) of `Phase`. since: (contacts,) s in this phase.
        seen: the monitor's state of each magnitude (r_all,). heard: what it listens to.
        expected: (r_all,) N that should be read. gap, astray: (r_all,) m moved away, and s, since
            contact was lost.
        held: (contacts,) whether it has pressed for the time of a rise since it was open last.
    """

    phase: Array
    since: Array
    seen: MonitorState
    heard: FilteredForce
    expected: Array
    gap: Array
    astray: Array
    held: Array

    @property
    def active(self) -> Flags:
        """(contacts,) whether the contact is in N."""
        return np.asarray(self.phase != Phase.OPEN)


@dataclass(frozen=True)
class Columns:
    """What is fixed about the columns of N.

    Attributes:
        owners: (r_all,) contact of each. pushing: (contacts,) whether it can only push; the others
            (hinges, holes, grooves) are closed for ever.
    """

    owners: NDArray[np.intp]
    pushing: Flags

    def any(self, flags: Array) -> Flags:
        """(contacts,) whether any column of the contact has its flag (r_all,) set."""
        return np.bincount(self.owners, flags, len(self.pushing)) > 0.0

    def all(self, flags: Array) -> Flags:
        """(contacts,) whether all have."""
        return ~self.any(~flags)


def lived(
    state: PhaseState,
    alpha: Array,
    speed: Array,
    inertia: Array,
    wanted: Array,
    columns: Columns,
    dt: float,
    settings: PhaseSettings,
    here: Flags,
) -> PhaseState:
    """The state one tick later.

    Args:
        state: before.
        alpha, speed: (r_all,) measured magnitudes (N) and NᵀV_rel (m/s), 0 out of N.
        inertia: (r_all, r_all) of what is outboard of the sensors (kg), see `monitor.heard`.
        wanted: (r_all,) desired magnitudes; a contact with none > 0 is left.
        columns, dt, settings: as they are. here: (r_all,) which were in N.
    """
    audible, force = filter_force(state.heard, alpha, speed, inertia, here, dt, settings.lag)
    more = settings.share * np.maximum(state.expected - settings.push, 0.0)
    more = np.where(state.expected > settings.limits.force_on, more, -np.inf)
    force = np.where(here, force, 0.0)
    open_ = ~np.asarray(state.seen.closed, dtype=bool)
    clear = np.minimum(force, 1.5 * audible.force) - audible.noise
    flies = open_ & (speed > 0.5 * settings.speed) & (state.seen.high_for < 0.5)
    seen = watched(
        state.seen, np.where(open_, clear, force), speed, dt, settings.limits, more,
        np.where(flies, np.inf, settings.limits.dwell),
    )  # fmt: skip
    seen = replace(
        seen,
        closed=seen.closed & state.active[columns.owners],
        collision=seen.collision & state.active[columns.owners],
    )
    held = state.active & (
        np.asarray(state.held, bool) | columns.any(seen.high_for > settings.rise)
    )
    light = wanted <= settings.limits.force_on  # too little to be told from nothing
    made = columns.all(seen.closed | light) & columns.any(seen.closed)
    closed = np.where(made, Phase.CLOSED, Phase.APPROACHING)
    closed = np.where(state.phase == Phase.OPEN, Phase.APPROACHING, closed)
    phase = np.where(columns.any(wanted > 0.0), closed, Phase.OPEN)
    phase = np.where(columns.pushing, phase, Phase.CLOSED)
    since = np.where(phase == state.phase, state.since + dt, 0.0)
    steady = (phase == Phase.CLOSED) & (since > settings.rise)
    astray = ((phase != Phase.OPEN) & (state.phase != Phase.OPEN) & ~steady)[columns.owners]
    gap = np.where(astray, np.maximum(state.gap - dt * speed, 0.0), 0.0)
    lost = (state.phase == Phase.CLOSED) & (phase == Phase.APPROACHING) & held
    lost = lost[columns.owners] | (state.astray > 0.0)
    late = np.where(astray & lost, state.astray + dt, 0.0)
    return PhaseState(phase, since, seen, audible, state.expected, gap, late, held)


def expected(before: Array, asked: Array, limited: bool, dt: float, k: PhaseSettings) -> Array:
    """(r,) what contacts should read: what was asked a while ago, or now where that is less."""
    late = np.exp(-np.log1p(dt / k.rise)) * before + dt / (k.rise + dt) * asked
    out = np.minimum(asked, late)
    return np.minimum(out, k.push) if limited else out


def commanded(
    state: PhaseState,
    wanted: Array,
    columns: Columns,
    gains: ForceGains,
    settings: PhaseSettings,
    rows: Array,
) -> Array:
    """Goals α (r_all,) for the force law, and its terms for each contact.

    Args:
        state: see `lived`. wanted: (r_all,) desired magnitudes (N).
        columns, gains, settings: as they are.
        rows: (contacts, 5) filled, see `ContactTerms`.
    """
    approaching, guarded = state.phase == Phase.APPROACHING, columns.pushing
    on_its_way = state.since * settings.speed < settings.travel
    back = 5.0 * np.where(approaching[columns.owners], state.gap, 0.0)
    pace = np.maximum(np.minimum(settings.speed + back, 0.1), settings.speed)
    push = settings.damping * pace
    rows[:, 0] = state.active
    rows[:, 1] = np.where(approaching, 0.0, gains.integral)
    rows[:, 2] = np.where(approaching, settings.damping, gains.damping)
    rows[:, 3] = np.where(guarded & ~approaching, settings.least, -np.inf)
    rows[:, 4] = approaching
    gentle = 0.5 * settings.limits.force_on * pace / settings.speed
    moving = np.minimum(np.abs(state.heard.pace), np.abs(state.heard.speed))
    gentle = gentle + settings.damping * moving
    start = np.where(approaching[columns.owners], np.minimum(push, gentle), push)
    start = start * (on_its_way | ~approaching)[columns.owners]
    risen = np.where(guarded[columns.owners], _risen(state, columns, settings), 1.0)
    return np.asarray(start + risen * (wanted - start))


def _risen(state: PhaseState, columns: Columns, settings: PhaseSettings) -> Array:
    """(r_all,) how much of the way from K_a v_a to its command each force has risen."""
    risen = np.minimum(state.since / settings.rise, 1.0)
    own = columns.pushing & (state.phase == Phase.CLOSED)
    return np.where(own, risen, 0.0)[columns.owners]


def slewed(tau: Array, last: Array, step: Array) -> Array:
    """Torques on the straight way from `last` to `tau`, no motor further than its `step` (> 0)."""
    change = tau - last
    share = float(np.max(np.abs(change) / step, initial=0.0))
    return tau if share <= 1.0 else last + change / share


class ContactPhases:
    """`lived`, remembered from tick to tick.

    Attributes:
        settings: as given. columns: of N. state: of the last tick. asked: (r_all,) goals in it.
    """

    def __init__(
        self, settings: PhaseSettings, owners: Array, pushing: Array, dt: float, closed: bool
    ) -> None:
        """Start with every pushing contact closed, or open.

        Args:
            settings: of all contacts. owners: (r_all,) the contact of each column of N.
            pushing: (contacts,) whether it can only push (`pair.pushes_only`).
            dt: control period (s). closed: at the start.
        """
        pushing = np.asarray(pushing, dtype=bool)
        self.settings, self.dt = settings, dt
        self.columns = Columns(np.asarray(owners, dtype=np.intp), pushing)
        phase = np.where(closed | ~pushing, Phase.CLOSED, Phase.OPEN)
        since = np.full(len(pushing), np.inf)
        seen = MonitorState.of((phase == Phase.CLOSED)[self.columns.owners])
        n = len(self.columns.owners)
        held = np.zeros(len(pushing), dtype=bool)
        heard, zeros = FilteredForce.nothing(n), np.zeros((3, n))
        self.state = PhaseState(phase, since, seen, heard, *zeros, held)
        self.asked = np.zeros(n)

    def expect(self, limited: bool, here: Flags) -> None:
        """After a tick: what should be read of the columns (r_all,) that were in N."""
        found = expected(self.state.expected, self.asked, limited, self.dt, self.settings)
        self.state = replace(self.state, expected=np.where(here, found, 0.0))

    def advance(
        self, wanted: Array, alpha: Array, speed: Array, inertia: Array, here: Flags
    ) -> Flags:
        """One tick; arguments as in `lived`.

        Returns:
            (r_all,) whose integrals go on: of columns in N whose contact was not lost.
        """
        before = self.state.phase
        self.state = lived(
            self.state, alpha, speed, inertia, wanted, self.columns, self.dt, self.settings, here
        )  # fmt: skip
        kept = (before != Phase.OPEN) & (self.state.phase >= before)
        return np.asarray(kept[self.columns.owners])
