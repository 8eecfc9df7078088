"""Whether the joints can make a motion: it is gone through beforehand, by the law itself."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from osc_contact.control.controller import Controller
from osc_contact.control.safety import SafetyState
from osc_contact.errors import OscContactError
from osc_contact.interface import Measurement, Reference
from osc_contact.runs.task import Rule, Task
from osc_contact.scenarios.control_schema import SafetySettings
from osc_contact.spatial import Array

__all__ = ["JOINT_RULES", "rehearse"]

PERIOD_S, GAIN = 4e-3, 0.3  #: the longest tick, and the largest product of it and the gains


def rehearse(task: Task) -> tuple[float, str] | None:
    """When (s) and why the controller would stop for its joints' limits; None: it would not.

    The joints follow what the controller commands, without contacts, errors and motor limits.
    """
    safety = SafetySettings.motors_only(
        overspeed_time=task.safety.overspeed_time,
        brake_time=task.safety.brake_time,
        hold_rate=task.safety.hold_rate,
    )
    damping = max(task.gains.motion.damping, 1.0)
    dt = max(task.dt, min(PERIOD_S, GAIN / damping))
    dt = task.dt * round(dt / task.dt)
    chain = task.chain
    q, v, still = task.q.copy(), np.zeros(chain.nq), np.zeros((len(chain.arms), 6))
    try:
        controller = Controller(chain, (), task.gains, dt=dt, posture=task.posture, safety=safety)
        for k, wanted in enumerate(task.every(dt)):
            motion = Reference(wanted.X_WD, wanted.V_D, wanted.A_D)
            controller.tick(Measurement(q.copy(), v.copy(), still), motion)
            if controller.state is SafetyState.SAFE_STOP:
                return k * dt, controller.reason.removesuffix(". See why, then call reset()")
            v = v + _acceleration(controller) * dt
            q = q + v * dt
    except OscContactError:  # what cannot be gone through without its contacts
        return None
    return None


def _acceleration(controller: Controller) -> Array:
    """(n,) q̈ of the last tick: J̄a + offset, and what redundant arms do beside their task.

    Their torques τ₀ move them by (1 − J̄J)M⁻¹(τ₀ − h). Without it nothing holds their posture, and
    they drift until a joint comes near its limit.
    """
    settings, joints = controller.settings, controller._records.joints
    a = controller.joint_acceleration()
    for arm, s, grasp in zip(
        settings.chain.arms, settings.chain.slices, settings.chain.grasps, strict=True
    ):
        n = arm.model.nv
        if n > grasp.N.shape[1]:
            J_bar, rows = np.asarray(joints.J_bar[s]), joints.M[s, :n]
            own = np.linalg.solve(rows, joints.rest[s] - joints.h[s])
            a[s] += own - J_bar @ (np.asarray(joints.J[s]).T @ own)
    return a


def _slow_down(task: Task) -> Iterator[tuple[float, dict[str, Any]]]:
    held = all(grasp.is_rigid for grasp in task.chain.grasps)
    if not held or not _leads(task.plan.X_WD):  # a loose object needs its contacts
        return
    stop = rehearse(task)
    if stop is not None:
        yield 1.0, {"at": stop[0], "why": stop[1]}


def _leads(poses: Array) -> bool:
    """Whether there is a motion at all."""
    return bool(np.ptp(poses, axis=0).max(initial=0.0) > 0.0)


JOINT_RULES = (
    Rule(
        _slow_down,
        0.0,
        0.0,
        "at t = {at:.3g} s the motion would end in a stop: {why}; ask for a smaller or slower "
        "motion, or begin in another posture",
    ),
)
