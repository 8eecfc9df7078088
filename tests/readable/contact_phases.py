"""Contact phases applied to a controller: terms of the next tick, what goes on when N changes."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from osc_contact.control.reports import Status
from osc_contact.interface import Reference
from osc_contact.spatial import Array
from readable.command_filter import object_coordinates
from readable.phases import ContactPhases, Phase, commanded

if TYPE_CHECKING:
    from readable.controller import ReadableController as Controller

__all__ = ["hand_over", "live", "measured", "phases"]


def live(controller: Controller, life: ContactPhases, reference: Reference) -> Reference:
    """Decide which contacts are in N at this tick; returns the reference with their force goals.

    Integrals of contacts that are not under force control before and after are reset. Where N
    changes, what the motion integral has learnt goes on as a constant wrench (`hand_over`).
    """
    wanted = np.asarray(reference.alpha_d, dtype=float)
    owners, law = life.columns.owners, controller.force_law
    if not controller.engaged or wanted.shape != owners.shape:
        return reference
    terms = controller.terms
    active = terms.active.copy()
    if controller.ticked and controller.status is not Status.HELD:
        life.expect(controller.status is Status.SATURATED, active[owners])
        alpha, speed = measured(controller, owners)
        inertia = _outboard(controller, owners)
        kept = life.advance(wanted, alpha, speed, inertia, active[owners])
        if (life.state.active != active).any() and controller.motion_law.integral.any():
            hand_over(controller)
        before, integral = active[owners], np.zeros(len(owners))
        if (life.state.active == active).all() and kept[before].all():
            pass  # they go on, fewer than columns where these are dependent
        elif len(law.integral) == before.sum():
            integral[before] = law.integral
            law.integral = np.where(kept, integral, 0.0)[life.state.active[owners]]
        else:
            law.integral = np.zeros(0)
    life.asked = goal = commanded(
        life.state, wanted, life.columns, law.gains, life.settings, terms.rows
    )
    return replace(reference, alpha_d=goal)


def measured(controller: Controller, owners: Array) -> tuple[Array, Array]:
    """Magnitudes (N) and speeds NᵀV_rel (m/s) of the last tick, (r_all,) each.

    Zero where the contact was out of N. Where columns depend on others this is one split of many,
    see `Contact.magnitudes`.

    Args:
        controller: after a tick. owners: (r_all,) the contact of each column of N.
    """
    found = controller.result()
    alpha, speed = found.alpha_meas, found.normal_speed
    if len(alpha) == len(owners):
        return alpha, speed
    if not len(alpha):
        return np.zeros(len(owners)), np.zeros(len(owners))
    here = controller.terms.active[owners]
    if len(alpha) < np.count_nonzero(here):
        contact = controller.last_signals().contact
        alpha, speed = contact.magnitudes(alpha), speed @ contact.R
    out = np.zeros((2, len(owners)))
    out[:, here] = alpha, speed
    return out[0], out[1]


def phases(controller: Controller) -> NDArray[np.int64]:
    """(contacts,) open 0, approaching 1, closed 2 (`life.Phase`) as of the last tick."""
    phase = Phase.CLOSED if controller.life is None else controller.life.state.phase
    return np.where(controller.terms.active, phase, Phase.OPEN).astype(np.int64)


def _outboard(controller: Controller, owners: Array) -> Array:
    """D⁻¹ (r_all, r_all) of the force filter (kg); 0 out of N and where columns are dependent."""
    D, here = controller.result().mobility, np.flatnonzero(controller.terms.active[owners])
    out = np.zeros((len(owners), len(owners)))
    if 0 < len(D) == len(here):
        known = controller.reading == "least_squares"
        out[np.ix_(here, here)] = controller.inertia if known else np.linalg.inv(D)
    return out


def hand_over(controller: Controller) -> None:
    """What the motion integral has learnt in free directions goes on as a constant wrench.

    That is S⁻ᵀΛ_S P_T K_i∫e, added to `f_bias`: weight errors stay balanced in directions that
    leave the motion law. The integral starts again from zero.
    """
    s, motion = controller.last_signals(), controller.motion_law
    learnt = motion.gains.integral * motion.integral
    force = s.state.Lambda_S @ object_coordinates(s.state, s.contact, learnt + s.state.sigma)
    H = s.state.S.T @ s.state.metric @ s.state.S
    wrench = s.state.metric @ s.state.S @ np.linalg.solve(H, force)  # Sᵀ wrench = force
    controller.f_bias = controller.f_bias + wrench
    motion.integral = np.zeros(6)
