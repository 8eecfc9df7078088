"""Contact or no contact, from the paper's own signal: projected force and power (figs. 6, 7).

While a contact holds, the power of the projected force is zero: α_k (NᵀV_rel)_k = 0. A collision
is a burst of it as a contact is made, a lost contact a force that has gone. Force is judged with
hysteresis; power only around the moment when contact is made, so that noisy velocities (faces
followed by vision) raise no alarm while it lasts.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from osc_contact.errors import InvalidInputError
from osc_contact.spatial import Array

__all__ = ["ContactMonitor", "MonitorLimits", "MonitorState", "watch_series", "watched"]


@dataclass(frozen=True)
class MonitorLimits:
    """When contact counts as made, as lost, and as a collision.

    Attributes:
        force_on, force_off: N; made above the first, lost below the second.
        power: W; more than this (in size) is a collision.
        patience: s that the force must stay low before contact counts as lost.
        window: s after contact is made in which a collision is looked for.
        dwell: s that the force must stay high before contact counts as made (sensor noise).
        leaving: m/s; an object that leaves its face faster has no contact, whatever the force
            says: a face does not push on what moves away from it.
    """

    force_on: float = 1.0
    force_off: float = 0.4
    power: float = 0.05
    patience: float = 0.005
    window: float = 0.02
    dwell: float = 0.0
    leaving: float = np.inf

    def __post_init__(self) -> None:
        if not (
            self.force_on > self.force_off > 0.0
            and self.power > 0.0
            and min(self.patience, self.window, self.dwell, self.leaving) >= 0.0
        ):
            raise InvalidInputError(
                f"contact monitor: {self}; force_on must lie above force_off, force_off and power "
                "above 0, times and leaving must be ≥ 0"
            )


@dataclass(frozen=True)
class MonitorState:
    """What is remembered of each contact, (r,) each.

    Attributes:
        closed: whether contact is held to be made.
        low_for, high_for: s since the force went low; since it went high.
        burst: W; the largest power since then, or since contact was made.
        armed_for: s in which a collision may still be told.
        collision: whether one began at this tick.
    """

    closed: Array
    low_for: Array
    high_for: Array
    burst: Array
    armed_for: Array
    collision: Array

    @classmethod
    def of(cls, closed: Array) -> MonitorState:
        """At the start: contacts (r,) made or not."""
        closed = np.asarray(closed, dtype=bool)
        zero = np.zeros(len(closed))
        return cls(closed, zero, zero, zero, zero, np.zeros(len(closed), dtype=bool))


def watched(
    state: MonitorState,
    alpha: Array,
    speed: Array,
    dt: float,
    limits: MonitorLimits,
    more: Array | float = 0.0,
) -> MonitorState:
    """The state one tick later.

    Args:
        state: before. alpha: (r,) measured magnitudes (N), from the wrist filter.
        speed: (r,) NᵀV_rel (m/s). dt: the tick (s). limits: thresholds.
        more: (r,) N above force_off below which contact is lost already.
    """
    away = speed < -limits.leaving
    low_for = np.where(away | (alpha < limits.force_off + more), state.low_for + dt, 0.0)
    high_for = np.where(~away & (alpha > limits.force_on), state.high_for + dt, 0.0)
    lost = state.closed & (low_for > limits.patience)
    closed = (state.closed | (high_for > limits.dwell)) & ~lost
    armed_for = np.where(state.closed, np.maximum(state.armed_for - dt, 0.0), limits.window)
    burst = np.where(closed | (high_for > 0.0), np.maximum(state.burst, np.abs(alpha * speed)), 0.0)
    collision = closed & (armed_for > 0.0) & (burst > limits.power)
    armed_for = np.where(collision, 0.0, armed_for)
    return MonitorState(closed, low_for, high_for, burst, armed_for, collision)


@dataclass
class ContactMonitor:
    """`watched`, remembered from tick to tick."""

    contacts: int
    dt: float
    limits: MonitorLimits = field(default_factory=MonitorLimits)

    def __post_init__(self) -> None:
        self.state = MonitorState.of(np.zeros(self.contacts, dtype=bool))

    @property
    def looks(self) -> bool:
        """Whether speeds matter at the next tick: some contact is open or has just been made."""
        return bool((~self.state.closed | (self.state.armed_for > 0.0)).any())

    def update(self, alpha: Array, speed: Array) -> MonitorState:
        """Judge one tick; see `watched`."""
        self.state = watched(self.state, alpha, speed, self.dt, self.limits)
        return self.state


def watch_series(monitor: ContactMonitor, alpha: Array, speed: Array) -> tuple[Array, Array]:
    """What the monitor would have told tick by tick: closed and collision (k, r).

    As long as all contacts hold, nothing is armed and no force goes low, it has nothing new to
    tell: such ticks are passed over.

    Args:
        monitor: its state moves on. alpha: (k, r) as for `ContactMonitor.update`. speed: (k, r).
    """
    closed, collision = np.ones(alpha.shape, dtype=bool), np.zeros(alpha.shape, dtype=bool)
    low = np.flatnonzero((alpha < monitor.limits.force_off).any(axis=1))
    k = 0
    while k < len(alpha):
        state = monitor.update(alpha[k], speed[k])
        closed[k], collision[k] = state.closed, state.collision
        k += 1
        if state.closed.all() and not (state.armed_for.any() or state.low_for.any()):
            coming = np.searchsorted(low, k)
            k = int(low[coming]) if coming < len(low) else len(alpha)
    return closed, collision
