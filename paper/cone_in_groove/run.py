"""The run of fig. 2, and how far steps of force and motion disturb each other."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from osc_contact.contacts.raibert_craig import RaibertCraig
from osc_contact.control.controller import Controller
from osc_contact.control.safety import SafetySettings
from osc_contact.errors import InvalidInputError
from osc_contact.interface import Measurement, Reference
from osc_contact.plants.rigid import RigidPlant
from osc_contact.runs.loop import Witness, run_loop
from osc_contact.runs.rig import build_rig
from osc_contact.runs.run import start
from osc_contact.spatial import Array
from paper.cone_in_groove.geometry import Seat, seated_cone
from paper.cone_in_groove.scenario import PERIOD, STEP_TIMES, cone_scenario

__all__ = ["ConeResult", "couplings", "run"]

SETTLE_S = 0.5  #: judged from here on


@dataclass(frozen=True, eq=False)
class ConeResult:
    """What one run gave.

    Attributes:
        seat: where the cone lies. step_times: of the wall forces (s).
        t: (k,) s.
        wall_d, wall: (k, 4) desired and true pushes at the ends of the lines of contact (N), just
            after the torques have changed: the difference is what the arm's motion makes of them
            within a period (it halves with the period), and the integral action on it.
        motion_d, motion: (k, 2) desired and true turn (rad) and slide (m).
        power: (k,) of the contact force on the object's motion (W).
        N: (k, 6, 4) as the controller had it.
        force_to_motion, motion_to_force: (probes, 4) and (probes, 8), see `couplings`.
        status: (k,) of the controller.
    """

    seat: Seat
    step_times: tuple[float, ...]
    t: Array
    wall_d: Array
    wall: Array
    motion_d: Array
    motion: Array
    power: Array
    N: Array
    force_to_motion: Array
    motion_to_force: Array
    status: Array

    @property
    def raibert_craig(self) -> RaibertCraig:
        """The nearest constraint frame at the start, moments over the cone's height about O."""
        return self.seat.contact().as_raibert_craig(self.seat.cone.height)

    def as_dict(self) -> dict[str, Any]:
        """The verdict, for JSON."""
        judged = self.t >= SETTLE_S
        force = (self.wall - self.wall_d)[judged]
        motion = (self.motion - self.motion_d)[judged]
        frame = self.raibert_craig
        bend = self.N[2:] - 2 * self.N[1:-1] + self.N[:-2]
        return {
            "r": self.seat.contact().r,
            "axes_deg": float(np.rad2deg(self.seat.inclination)),
            "raibert_craig": {
                "describes_it": bool(frame),
                "reason": frame.reason,
                "residual": frame.residual,
            },
            "duration_s": len(self.t) * PERIOD,
            "wall_force_rms_N": np.sqrt((force**2).mean(axis=0)).tolist(),
            "wall_force_peak_error_N": float(np.abs(force).max()),
            "wall_force_least_N": float(self.wall[judged].min()),
            "turn_rms_rad": float(np.sqrt((motion[:, 0] ** 2).mean())),
            "slide_rms_m": float(np.sqrt((motion[:, 1] ** 2).mean())),
            "turned_rad": float(np.ptp(self.motion[:, 0])),
            "slid_m": float(np.ptp(self.motion[:, 1])),
            "force_step_to_motion": float(self.force_to_motion.max()),
            "motion_step_to_force": float(self.motion_to_force.max()),
            "contact_power_W": float(np.abs(self.power[judged]).max()),
            "N_change_per_tick": float(np.abs(np.diff(self.N, axis=0)).max()),
            "N_second_difference": float(np.abs(bend).max()),
            "ticks_not_ok": int(np.count_nonzero(self.status)),
        }


class _ConeWitness(Witness):
    """Keeps N as the controller had it, too, and probes the coupling now and then."""

    def __init__(self, plant: RigidPlant, controller: Controller, R: Array, every: int) -> None:
        super().__init__(plant, controller)
        self.rigid, self.R, self.every = plant, R, every
        self.N: list[Array] = []
        self.probes: list[tuple[list[float], list[float]]] = []

    def append(
        self, measurement: Measurement, reference: Reference, tau: Array, seconds: float
    ) -> None:
        self.N.append(self.controller.last_signals().contact.N)
        if len(self.N) % self.every == 0:
            probe = couplings(self.controller, self.rigid, measurement, reference, self.R)
            self.probes.append(probe)
        super().append(measurement, reference, tau, seconds)


def run(
    duration: float = 5.0,
    step_times: tuple[float, ...] = STEP_TIMES,
    moving: bool = True,
    probe_s: float = 0.05,
) -> ConeResult:
    """Run the task on the rigid plant at 1 kHz, probing the coupling every `probe_s` seconds.

    Args:
        duration, step_times, moving: as in `cone_scenario`.
        probe_s: s.

    Raises:
        InvalidInputError: too short to be judged, or probe_s not positive.
    """
    if not (np.isfinite(duration) and duration > SETTLE_S and probe_s >= PERIOD):
        raise InvalidInputError(
            f"duration {duration} s, probe_s {probe_s} s: a run is judged from t = {SETTLE_S:g} s; "
            f"run it longer, and probe not more often than every {PERIOD:g} s"
        )
    seat = seated_cone()
    rig = build_rig(cone_scenario(seat, duration, step_times, moving))
    plant, controller = start(rig)
    assert isinstance(plant, RigidPlant)
    t = np.arange(round(duration / PERIOD)) * PERIOD
    plan = rig.references.over(t)
    witness = _ConeWitness(plant, controller, seat.from_wall_forces, round(probe_s / PERIOD))
    run_loop(plant, controller, plan, recorder=witness)
    to_walls = np.linalg.inv(seat.from_wall_forces).T
    alpha, N = np.array([truth.alpha for truth in witness.truths]), np.array(witness.N)
    V_O = np.array([truth.V_O for truth in witness.truths])
    to_motion, to_force = (np.array(part) for part in zip(*witness.probes, strict=True))
    return ConeResult(
        seat,
        step_times,
        t,
        wall_d=plan.alpha_d @ to_walls,
        wall=alpha @ to_walls,
        motion_d=np.array([seat.motion(reference.X_WD) for reference in plan]),
        motion=np.array([seat.motion(truth.X_WO) for truth in witness.truths]),
        power=np.einsum("kir,kr,ki->k", N, alpha, V_O),
        N=N,
        force_to_motion=to_motion,
        motion_to_force=to_force,
        status=np.array(witness.status),
    )


def couplings(
    controller: Controller,
    plant: RigidPlant,
    measurement: Measurement,
    reference: Reference,
    to_pair: Array,
) -> tuple[list[float], list[float]]:
    """How far a step of each wall force moves the cone, and steps of motion press on the walls.

    Both are ratios of like quantities in the held object's energy metric Λ_o, so that metres and
    radians never meet: the acceleration caused by a force step over the one that force would give
    the free object, √(ΔaᵀΛ_oΔa / Δf_cᵀΛ_o⁻¹Δf_c); and the contact force caused by a step of the
    acceleration command over the force that the command means, √(Δf_cᵀΛ_o⁻¹Δf_c / Δa_uᵀΛ_oΔa_u).
    The steps of force are 5 N on each of the walls' magnitudes, α = `to_pair` λ; those of motion
    are the two permitted ones and the six unit vectors, permitted or not.

    Args:
        controller, plant: in the state of the measurement.
        measurement, reference: of the tick whose commands are changed.
        to_pair: (4, 4) from the wall forces λ (N) to the pair's magnitudes α.

    Returns:
        The ratios of the four steps of force, and of the eight steps of motion.
    """
    controller = controller.with_safety(SafetySettings.motors_only())  # the same readings again
    before = (controller.motion_law.integral, controller.force_law.integral)

    def answer(changed: Reference) -> tuple[Array, Array]:
        tau = controller.tick(measurement, changed)
        controller.motion_law.integral, controller.force_law.integral = before
        _, a, alpha = plant.accelerations(tau)
        return a, controller.last_signals().contact.N @ alpha

    a_0, f_0 = answer(reference)
    s = controller.last_signals()
    Lambda, T = s.state.metric, s.contact.T

    def size(motion: Array, force: Array) -> tuple[float, float]:
        squares = motion @ Lambda @ motion, force @ np.linalg.solve(Lambda, force)
        return float(np.sqrt(squares[0])), float(np.sqrt(squares[1]))

    to_motion, to_force = [], []
    for step in 5.0 * to_pair.T:
        a, f = answer(replace(reference, alpha_d=reference.alpha_d + step))
        moved, pressed = size(a - a_0, f - f_0)
        to_motion.append(moved / pressed)
    for step in np.hstack((T, np.eye(6))).T:
        a, f = answer(replace(reference, A_D=reference.A_D + step))
        to_force.append(size(step, f - f_0)[1] / size(step, f)[0])
    return to_motion, to_force
