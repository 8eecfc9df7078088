"""What a law does at one instant: cross-talk between force and motion, from eqs. 17 and 18.

Everything that answers a command at one instant is linear, so `contact_response` says exactly what
a law does: with commands Δα (r,) and Δa along the free motions (n,)

    change of contact force   M Δα + G_m Δa          change of acceleration   G_f Δα + K Δa

Ours has M = 1, K = 1, G_m = 0, G_f = 0. Feedback makes up for M and K as long as their eigenvalues
are positive, so cross-talk is counted per *achieved* step,

    G_f M⁻¹  (m/s² per N)      G_m K⁻¹  (N per m/s²)

(otherwise the best law would be one that does nothing). Both are made dimensionless by the mean
inertia m of the free motions (kg); an angular acceleration counts with the object's largest radius
of gyration, its `size`. Then 0.1 means: a force step accelerates the object as a tenth of it would
a mass m, an accelerating object presses on the faces with a tenth of its inertia force.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from osc_contact.contacts.contact import Contact
from osc_contact.dynamics.closed_chain import ChainState
from osc_contact.paper.baselines.laws import Law, SelectionLaw
from osc_contact.response import contact_response
from osc_contact.spatial import Array

__all__ = ["Coupling", "Instant"]

_LEAST_GAIN = 0.1


@dataclass(frozen=True)
class Coupling:
    """The answer of a law to unit commands.

    Attributes:
        M: (r, r) N per N. K: (n, n) m/s² per m/s². G_f: (n, r) m/s² per N. G_m: (r, n) N per m/s².
        inertia: m, kg.
    """

    M: Array
    K: Array
    G_f: Array
    G_m: Array
    inertia: float

    @property
    def usable(self) -> bool:
        """Whether feedback can make up for M and K: real parts of the eigenvalues ≥ 0.1."""
        gains = [np.linalg.eigvals(X).real.min(initial=1.0) for X in (self.M, self.K)]
        return bool(min(gains) >= _LEAST_GAIN)

    @property
    def force_to_motion(self) -> Array:
        """(n, r) m G_f M⁻¹: acceleration along the free motions per achieved force."""
        return self.inertia * np.asarray(np.linalg.solve(self.M.T, self.G_f.T).T)

    @property
    def motion_to_force(self) -> Array:
        """(r, n) G_m K⁻¹/m: contact force per achieved acceleration."""
        return np.asarray(np.linalg.solve(self.K.T, self.G_m.T).T) / self.inertia

    @property
    def norms(self) -> tuple[float, float]:
        """Largest gain of `force_to_motion` and of `motion_to_force`."""
        parts = (self.force_to_motion, self.motion_to_force)
        f, m = (float(np.linalg.norm(x, 2)) if x.size else 0.0 for x in parts)
        return f, m

    @property
    def residuals(self) -> Array:
        """Both kinds of cross-talk in one vector, dimensionless."""
        return np.concatenate((self.force_to_motion.ravel(), self.motion_to_force.ravel()))

    @property
    def cost(self) -> float:
        """Root of the sum of squares of `residuals`; infinite where control would be lost."""
        return float(np.linalg.norm(self.residuals)) if self.usable else np.inf


class Instant:
    """Chain and contact at one instant, and what a force f_S does there.

    Attributes:
        state, contact: at this instant.
        size: largest radius of gyration of the object (m).
        free: (6, n) free motions, orthonormal with angles counted in `size`: the principal ones of
            the chain's inertia, lightest first.
        along: (n, 6) coordinates of a motion that is free.
        inertia: mean inertia of the free motions (kg).
    """

    def __init__(self, state: ChainState, contact: Contact) -> None:
        self.state, self.contact = state, contact
        self.size = _radius_of_gyration(state.metric)
        scale = np.array([1.0, 1.0, 1.0, self.size, self.size, self.size])
        N_S = state.S.T @ contact.N
        null = np.linalg.svd(N_S.T, full_matrices=True)[2][contact.r :].T
        Q = np.linalg.qr(scale[:, None] * (state.S @ null))[0]
        e = np.linalg.lstsq(state.S, Q / scale[:, None], rcond=None)[0]
        inertias, principal = np.linalg.eigh(e.T @ state.Lambda_S @ e)
        Q = Q @ (principal * np.sign(principal.sum(axis=0)))
        self.free: Array = Q / scale[:, None]
        self.along: Array = Q.T * scale
        self.inertia = float(inertias.mean()) if len(inertias) else 1.0
        base = contact_response(state, contact, f_S=state.b_S)
        unit = [contact_response(state, contact, f_S=state.b_S + e) for e in np.eye(state.d)]
        self._alpha: Array = np.column_stack([x.alpha - base.alpha for x in unit])
        a = np.column_stack([x.acceleration - base.acceleration for x in unit])
        self._motion: Array = self.along @ a

    def coupling(self, law: Law) -> Coupling:
        """Unit commands through the law and through `contact_response`."""
        state, contact = self.state, self.contact
        if isinstance(law, SelectionLaw):  # without what cancels: the search calls this often
            X, _ = law.baseline.rule(state, law.selection)
            of_a = state.Lambda_S @ X @ self.free
            of_alpha = state.S.T @ (law.selection.force @ contact.N)
        else:
            none = np.zeros(contact.r)
            rest = law.f_S(state, contact, np.zeros(6), none)
            a = [law.f_S(state, contact, u, none) - rest for u in self.free.T]
            alpha = [law.f_S(state, contact, np.zeros(6), e) - rest for e in np.eye(contact.r)]
            of_a, of_alpha = np.column_stack(a), np.column_stack(alpha)
        return Coupling(
            M=self._alpha @ of_alpha,
            K=self._motion @ of_a,
            G_f=self._motion @ of_alpha,
            G_m=self._alpha @ of_a,
            inertia=self.inertia,
        )


def _radius_of_gyration(inertia: Array) -> float:
    """Of a body with this 6×6 inertia, about its centre of mass, largest axis (m)."""
    mass = inertia[0, 0]
    lever = inertia[3:, :3] / mass  # [c]×
    about_centre = inertia[3:, 3:] + mass * lever @ lever
    return float(np.sqrt(np.linalg.eigvalsh(about_centre)[-1] / mass))
