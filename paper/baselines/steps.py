"""Steps of one desired quantity at rest, and what they do to the other: force ↔ motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pinocchio as pin

from osc_contact.interface import Reference
from osc_contact.plants.rigid import RigidPlant
from osc_contact.projections import Omega_m_bar
from osc_contact.runs.contacts import feet
from osc_contact.runs.loop import Witness, run_loop
from osc_contact.runs.rig import Rig
from osc_contact.runs.run import start
from osc_contact.spatial import Array, pose_error
from paper.baselines.coupling import Coupling, Instant
from paper.baselines.laws import Law

__all__ = ["FORCE_STEP_N", "MOTION_STEP_M", "StepRun", "measured_coupling", "run_steps"]

FORCE_STEP_N = 5.0
MOTION_STEP_M = 0.005  #: along a unit free motion; angles count with the object's size
_SETTLE_S = 0.5
_WINDOW_S = 0.4


@dataclass(frozen=True)
class StepRun:
    """One law on one plant: desired forces step one after the other, then each free motion.

    Attributes:
        t: (ticks,) s. starts: when the steps happen (s), the first r of them of forces.
        alpha: (ticks, r) true contact forces (N). alpha_d: (ticks, r) desired.
        motion: (ticks, 6) true displacement from the start, m and rad; `free` part of it.
        ends: (points, 3) points of the object whose displacement counts, from O (m).
        closed: fraction of the time that all contacts were closed. saturated: ticks.
    """

    t: Array
    starts: tuple[float, ...]
    alpha: Array
    alpha_d: Array
    motion: Array
    ends: Array
    closed: float
    saturated: int

    def window(self, k: int, before: float = 0.0) -> slice:
        """Ticks of step k, from `before` s ahead of it."""
        first, last = np.searchsorted(self.t, (self.starts[k] - before - 1e-9,
                                               self.starts[k] + _WINDOW_S - 1e-9))  # fmt: skip
        return slice(int(first), int(last))

    def motion_effect(self, k: int, before: float = 0.0) -> Array:
        """(ticks,) m: how far step k takes the point of the object that it takes farthest."""
        d = self.motion - self.motion[self.window(k).start - 1]
        d = d[self.window(k, before)]
        moved = d[:, None, :3] + np.cross(d[:, None, 3:], self.ends)
        return np.asarray(np.linalg.norm(moved, axis=2).max(axis=1))

    def force_effect(self, k: int, before: float = 0.0) -> Array:
        """(ticks, r) N: true minus desired forces around step k."""
        rows = self.window(k, before)
        return np.asarray(self.alpha[rows] - self.alpha_d[rows])

    @cached_property
    def force_to_motion(self) -> Array:
        """(r,) m: largest displacement along the free motions after each force step."""
        return np.array([self.motion_effect(k).max() for k in range(self.alpha.shape[1])])

    @cached_property
    def motion_to_force(self) -> Array:
        """(n,) N: largest force error on any contact after each motion step."""
        steps = range(self.alpha.shape[1], len(self.starts))
        return np.array([np.abs(self.force_effect(k)).max() for k in steps])


def run_steps(
    rig: Rig, law: Law, instant: Instant, progress: Callable[[float], None] | None = None
) -> StepRun:
    """At rest on the contacts, at t = 0.5 s and every 0.4 s one more desired value steps.

    The motion that counts is what a contact force by itself cannot cause, Ω_m(Φ₀) of the
    displacement (on a soft contact the object also gives way along N, whatever the law).

    Args:
        rig: with the plant.
        law: to be installed.
        instant: the start, whose free motions are stepped along.
        progress: called with the simulated time now and then.
    """
    r, n = instant.contact.r, instant.free.shape[1]
    starts = tuple(_SETTLE_S + _WINDOW_S * k for k in range(r + n))
    period = 1.0 / rig.scenario.control.rate
    at_rest = replace(rig.references.at(0.0), V_D=np.zeros(6), A_D=np.zeros(6))
    t = period * np.arange(round((starts[-1] + _WINDOW_S) / period))
    done = [sum(now >= start - 1e-9 for start in starts) for now in t]
    stepped = [_stepped(at_rest, instant, count) for count in range(len(starts) + 1)]
    plant, controller = start(rig, install=law.install)
    witness = Witness(plant, controller)
    run_loop(plant, controller, (stepped[k] for k in done), recorder=witness, progress=progress)
    X = instant.state.X_WO
    free_part = np.eye(6) - Omega_m_bar(instant.contact.N, instant.state.Phi)
    motion = np.array([free_part @ pose_error(truth.X_WO, X) for truth in witness.truths])
    alpha = np.array([truth.alpha for truth in witness.truths])
    alpha_d = np.array([stepped[k].alpha_d for k in done])
    closed = float(np.mean([truth.closed.all() for truth in witness.truths]))
    ends = np.vstack([np.zeros(3), *(feet(pair, X)[0] - X.translation for pair in rig.pairs)])
    saturated = int(np.count_nonzero(witness.status))
    return StepRun(t, starts, alpha, alpha_d, motion, ends, closed, saturated)


def measured_coupling(rig: Rig, law: Law, instant: Instant) -> Coupling:
    """The same matrices as `Instant.coupling`, from whole ticks and the rigid plant's answer.

    Args:
        rig: with the rigid plant's chain. law: to be installed. instant: the start.
    """
    plant = RigidPlant(rig.chain, rig.pairs, rig.scenario.plant.step)
    plant.reset(rig.q_start)
    measurement, at_rest = plant.measure(), rig.references.at(0.0)
    r, n = instant.contact.r, instant.free.shape[1]

    def answer(reference: Reference) -> Array:
        controller = law.install(rig.controller())
        _, a, alpha = plant.accelerations(controller.tick(measurement, reference))
        return np.concatenate((alpha, instant.along @ a))

    base = answer(at_rest)
    forces = [replace(at_rest, alpha_d=at_rest.alpha_d + e) for e in np.eye(r)]
    motions = [replace(at_rest, A_D=at_rest.A_D + u) for u in instant.free.T]
    change = np.array([answer(x) - base for x in (*forces, *motions)]).T.reshape(r + n, r + n)
    return Coupling(change[:r, :r], change[r:, r:], change[r:, :r], change[:r, r:], instant.inertia)


def _stepped(at_rest: Reference, instant: Instant, done: int) -> Reference:
    """With the first `done` steps made: forces, then free motions."""
    r = instant.contact.r
    alpha_d = at_rest.alpha_d + FORCE_STEP_N * (np.arange(r) < done)
    steps = MOTION_STEP_M * (np.arange(instant.free.shape[1]) < done - r)
    d = instant.free @ steps
    X = at_rest.X_WD
    X_WD = pin.SE3(pin.exp3(d[3:]) @ X.rotation, X.translation + d[:3])
    return replace(at_rest, X_WD=X_WD, alpha_d=alpha_d)
