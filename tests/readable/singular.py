"""Motion commands that fade in directions an arm is losing, and come back with them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from osc_contact.contacts.contact import Contact
from osc_contact.control.reports import LostDirection, Status
from osc_contact.dynamics.closed_chain import ChainState, ClosedChain
from osc_contact.spatial import Array

if TYPE_CHECKING:
    from readable.controller import ReadableController as Controller

__all__ = ["faded_motion", "note_lost"]


def note_lost(controller: Controller, state: ChainState, motion: Array) -> None:
    """Say which directions were faded; the motion integral (6,) stays what it was before."""
    controller.lost_directions = () if controller.restaged else _told(state, controller.chain)
    if controller.lost_directions:
        controller.motion_law.integral = motion
        if controller.status is Status.OK:
            controller.status = Status.DEGRADED


def _told(state: ChainState, chain: ClosedChain) -> tuple[LostDirection, ...]:
    """`state.singular_directions` in words and units."""
    return tuple(
        LostDirection(
            chain.arms[lost.arm].name,
            lost.share,
            1.0 / max(lost.chi, 1e-12) ** 2,
            lost.twist / (np.linalg.norm(lost.twist[:3]) or np.linalg.norm(lost.twist[3:])),
        )
        for lost in state.singular_directions
    )


_HARD = 1e-8  # shares below it are as good as 0
_GONE = 1e-6  # of the mobility that Λ_ref has along any direction, 1


def faded_motion(
    state: ChainState, contact: Contact, chain: ClosedChain, eta_c: Array, posture: Array
) -> Array:
    """η̇ (d,): the motion command with the arms' lost directions left to their posture task.

    What an arm's joints must do along a lost direction u is (uᵀ(a − γ))/χ: it grows without bound
    while it does ever less. Share φ of it is kept; the rest is replaced by the posture's own
    acceleration there, with the least change of the command in Λ_o that the contacts permit (the
    metric in which commands in locked directions are dropped, see `object_coordinates`):

        min Δᵀ H Δ + Σ (1 − φ)/φ (uᵀLᵀSΔ − t)² / (uᵀLᵀS H⁻¹SᵀLu),   N_SᵀΔ = 0
        t = χ vᵀKᵀq̈_posture − uᵀLᵀ(a − γ),   H = SᵀΛ_oS

    Args:
        state, contact: at this instant. chain: its structure.
        eta_c: (d,) filtered command. posture: (n,) acceleration of joints left to themselves.
    """
    if not state.singular_directions or not state.d:
        return eta_c
    a = state.S @ eta_c + state.sigma
    plain = H = state.S.T @ state.metric @ state.S
    pull = np.zeros(state.d)
    for lost in state.singular_directions:
        arm = state.arms[lost.arm]
        row = state.S.T @ lost.wrench
        q_dd = posture[chain.slices[lost.arm]]
        target = lost.chi * (lost.mode @ arm.M @ q_dd) - lost.wrench @ (a - arm.gamma)
        size = row @ np.linalg.solve(plain, row)
        if lost.locked or size < _GONE:  # no motion of the chain's any more
            continue
        weight = (1.0 - lost.share) / (max(lost.share, _HARD) * size)
        H = H + weight * np.outer(row, row)
        pull += weight * target * row
    N = state.S.T @ contact.N
    change = np.linalg.solve(H, np.column_stack((pull, N)))
    step, held = change[:, 0], change[:, 1:]
    return np.asarray(eta_c + step - held @ np.linalg.solve(N.T @ held, N.T @ step))
