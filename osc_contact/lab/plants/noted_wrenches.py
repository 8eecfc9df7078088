"""True contact forces of plants with compliant contacts, from the wrenches at their points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from osc_contact.contacts.pairs import ContactPair
from osc_contact.contacts.pairs.law_pair import normals_over
from osc_contact.contacts.pairs.pair import pushes_only
from osc_contact.dynamics.environment import Rail
from osc_contact.lab.plants.faces import Faces
from osc_contact.loop.judge import Truths
from osc_contact.spatial import Array, Poses

#: Least share of the total force on a body with which a contact counts as closed. Contacts that do
#: not touch get 1e-17 … 1e-7 by rounding and by the positions of the points, others 1e-3 and more.
_LEAST_SHARE = 1e-5


def guided_joints(rails: Sequence[Rail]) -> tuple[Array, Array]:
    """Index of the body, and kind (0 travel, 1 angle), of each joint of the moving bodies.

    Args:
        rails: rails of the bodies of the environment.
    """
    guides = [(i, k) for i, rail in enumerate(rails) for k in rail.joints]
    bodies, kinds = np.array(guides, dtype=int).reshape(-1, 2).T
    return bodies, kinds


class NotedWrenches:
    """Evaluation of the truth from rows of poses and contact wrenches, one for each instant.

    The normal forces at all points where the object touches a body are added to a wrench. It is
    distributed over the columns of the contacts on this body: exactly, if it is in their range.
    """

    def __init__(self, contacts: Sequence[ContactPair], faces: Faces, inertia: Array) -> None:
        """Prepare the evaluation of the numbers that a plant stores for each tick.

        Args:
            contacts: contact pairs of the plant.
            faces: bodies of its environment.
            inertia: (6, 6) inertia of the object at its origin, in its axes.
        """
        self._contacts = contacts  #: contact pairs of the plant
        self._faces = faces  #: bodies of the environment
        #: bodies and axes of the guides, in the order of the positions in a row
        self._guided_joints = guided_joints(faces.rails)
        self._metric_root = np.linalg.cholesky(np.linalg.inv(inertia)).T  #: Φ = rootᵀ root

    def truths(self, rows: Array) -> Truths:
        """True states and contact forces at k instants.

        Args:
            rows: (k, m) rows. The m columns are: R of the object by rows (9), its position p (3;
                m), its twist at O in world axes (6; m/s, rad/s), the positions of the bodies on
                rails (m, rad), then for each body the wrench of normal forces that the object
                exerts on it at O (6; N, N m), then for each body 1 if the object touches it, else
                0.
        """
        faces = self._faces
        k = len(rows)
        bodies = len(faces.rails)
        sizes = [9, 3, 6, len(self._guided_joints[0]), 6 * bodies]
        R, p, V_O, positions, wrenches, touched = np.split(rows.T.copy(), np.cumsum(sizes))
        X_WO = Poses(R.reshape(3, 3, k), p)
        X_WE: tuple[Poses | None, ...] = (None,) * len(faces.on)
        if len(positions):
            s = np.zeros((bodies, 2, k))
            s[self._guided_joints] = positions
            poses = [rail.over(*path) for rail, path in zip(faces.rails, s, strict=True)]
            X_WE = tuple(poses[body] for body in faces.on)
        N = tuple(normals_over(pair, X_WO, X) for pair, X in zip(self._contacts, X_WE, strict=True))
        alpha, closed = self._distribute_wrenches(
            X_WO, N, wrenches.reshape(bodies, 6, k), touched > 0.0
        )
        return Truths(alpha, closed, X_WO, V_O.T.copy(), X_WE, N)

    def _distribute_wrenches(
        self, X_WO: Poses, N: Sequence[Array], wrenches: Array, touched: Array
    ) -> tuple[Array, Array]:
        """Distribute the wrench on each body over the contacts that touch it.

        α with NᵀΦN α = NᵀΦf, Φ⁻¹ the inertia of the object: the least-squares solution in the
        accelerations that columns and wrench f would cause of the free object.

        Args:
            X_WO: k poses of the object.
            N: lines of force (6, r_i, k) of each contact at O, world axes.
            wrenches: (bodies, 6, k) wrench of the object on each body at O, world axes (N, N m).
            touched: (bodies, k) whether the object touches each body.

        Returns:
            Magnitudes (k, r) (N), and whether each contact is closed (k, contacts).
        """
        on = self._faces.on  # body of each contact
        owner = np.repeat(np.arange(len(N)), [lines.shape[1] for lines in N])
        alpha = np.zeros((touched.shape[1], len(owner)))
        presses = alpha > 0.0
        for body in sorted(set(on)):
            ticks = touched[body]
            contacts = [i for i, other in enumerate(on) if other == body]
            if not ticks.any():
                continue
            # columns of N and the wrench, in object axes, then in coordinates of the root of Φ, in
            # which the metric is the identity
            lines = [N[i] for i in contacts]
            F = np.concatenate([*lines, wrenches[body][:, None]], axis=1)[:, :, ticks]
            X = Poses(X_WO.R[:, :, ticks], X_WO.p[:, ticks])
            F = np.concatenate((X.rotate_back(F[:3]), X.rotate_back(F[3:])))  # object axes
            F = np.moveaxis(np.tensordot(self._metric_root, F, 1), 2, 0)  # (ticks, 6, columns + 1)
            columns = F[..., :-1]
            shares = np.linalg.solve(columns.mT @ columns, columns.mT @ F[..., -1:])[..., 0]
            sizes = np.linalg.norm(F, axis=1)
            places = np.ix_(ticks, np.isin(owner, contacts))
            alpha[places] = shares
            presses[places] = shares * sizes[:, :-1] > _LEAST_SHARE * sizes[:, -1:]
        closed = np.empty((len(alpha), len(N)), dtype=bool)
        for i, (body, pair) in enumerate(zip(on, self._contacts, strict=True)):
            closed[:, i] = touched[body]
            if pushes_only(pair):  # every force of a unilateral contact must press
                closed[:, i] &= presses[:, owner == i].all(axis=1)
        return alpha, closed
