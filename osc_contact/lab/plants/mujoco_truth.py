"""True state of object and contacts in MuJoCo: raw numbers of each tick, evaluated afterwards."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np
import pinocchio as pin

from osc_contact.contacts.pairs import ContactPair
from osc_contact.contacts.pairs.law_pair import normals_over
from osc_contact.contacts.pairs.pair import pushes_only
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.dynamics.environment import Rail
from osc_contact.lab.plants.faces import Faces
from osc_contact.loop.judge import Truths
from osc_contact.spatial import Array, Poses, cross

if TYPE_CHECKING:
    from mujoco import MjData, MjModel

OBJECT = -1  #: in `Noted.body_of`: a geom of the object
OTHER = -2  #: neither of the object nor of the environment


class Noted(Protocol):
    """Plant in MuJoCo, with the attributes that its truth is read from.

    Attributes:
        model, data: MuJoCo's model and state. chain: the true arms. contacts: contact pairs.
        faces: bodies of the environment.
        object_body: index of the object's body in `model`. place: pose of the object's frame in it.
        body_of: (ngeom,) index of the environment's body of each geom; `OBJECT`, or `OTHER`.
        face_q: indices in qpos of the joints of moving bodies, see `guided_joints`.
    """

    model: MjModel
    data: MjData
    chain: ClosedChain
    contacts: tuple[ContactPair, ...]
    faces: Faces
    object_body: int
    place: pin.SE3
    body_of: Array
    face_q: Array


#: Least share of the total force on a body with which a contact counts as closed. Contacts that do
#: not touch get 1e-17 … 1e-7 by rounding and by the positions of the points, others 1e-3 and more.
_PRESSES = 1e-5


def guided_joints(rails: Sequence[Rail]) -> tuple[Array, Array]:
    """Index of the body, and kind (0 travel, 1 angle), of each joint of the moving bodies.

    Args:
        rails: rails of the bodies of the environment.
    """
    guides = [(i, k) for i, rail in enumerate(rails) for k in rail.joints]
    bodies, kinds = np.array(guides, dtype=int).reshape(-1, 2).T
    return bodies, kinds


class MujocoNotes:
    """Evaluation of the truth from the rows that `MujocoTruth` recorded.

    The normal forces at all points where the object touches a body are added to a wrench. It is
    distributed over the columns of the contacts on this body: exactly, if it is in their range.
    """

    def __init__(self, contacts: Sequence[ContactPair], faces: Faces, inertia: Array) -> None:
        """Prepare the evaluation of the numbers that a plant stores for each tick.

        Args:
            contacts: contact pairs of the plant. faces: bodies of its environment.
            inertia: (6, 6) inertia of the object at its origin, in its axes.
        """
        self._contacts = contacts
        self._faces = faces
        self._guided = guided_joints(faces.rails)
        self._root = np.linalg.cholesky(np.linalg.inv(inertia)).T  #: Φ = rootᵀ root

    def truths(self, noted: Array) -> Truths:
        """True states and contact forces at k instants.

        Args:
            noted: (k, m) rows returned by `MujocoTruth.noted`.
        """
        faces = self._faces
        k = len(noted)
        bodies = len(faces.rails)
        sizes = [9, 3, 6, len(self._guided[0]), 6 * bodies]
        R, p, V_O, positions, wrenches, touched = np.split(noted.T.copy(), np.cumsum(sizes))
        X_WO = Poses(R.reshape(3, 3, k), p)
        X_WE: tuple[Poses | None, ...] = (None,) * len(faces.on)
        if len(positions):
            s = np.zeros((bodies, 2, k))
            s[self._guided] = positions
            poses = [rail.over(*path) for rail, path in zip(faces.rails, s, strict=True)]
            X_WE = tuple(poses[body] for body in faces.on)
        N = tuple(normals_over(pair, X_WO, X) for pair, X in zip(self._contacts, X_WE, strict=True))
        alpha, closed = self._shares(X_WO, N, wrenches.reshape(bodies, 6, k), touched > 0.0)
        return Truths(alpha, closed, X_WO, V_O.T.copy(), X_WE, N)

    def _shares(
        self, X_WO: Poses, N: Sequence[Array], wrenches: Array, touched: Array
    ) -> tuple[Array, Array]:
        """Distribute the wrench on each body over the contacts that touch it.

        α with NᵀΦN α = NᵀΦf, Φ⁻¹ the inertia of the object: the least-squares solution in the
        accelerations that columns and wrench f would cause of the free object.

        Args:
            X_WO: k poses of the object. N: lines of force (6, r_i, k) of each contact at O, world
                axes. wrenches: (bodies, 6, k) wrench of the object on each body at O, world axes
                (N, N m). touched: (bodies, k) whether the object touches each body.

        Returns:
            Magnitudes (k, r) (N), and whether each contact is closed (k, contacts).
        """
        on = self._faces.on
        owner = np.repeat(np.arange(len(N)), [lines.shape[1] for lines in N])
        alpha = np.zeros((touched.shape[1], len(owner)))
        presses = alpha > 0.0
        for body in sorted(set(on)):
            ticks = touched[body]
            contacts = [i for i, other in enumerate(on) if other == body]
            if not ticks.any():
                continue
            lines = [N[i] for i in contacts]
            F = np.concatenate([*lines, wrenches[body][:, None]], axis=1)[:, :, ticks]
            X = Poses(X_WO.R[:, :, ticks], X_WO.p[:, ticks])
            F = np.concatenate((X.rotate_back(F[:3]), X.rotate_back(F[3:])))  # object axes
            F = np.moveaxis(np.tensordot(self._root, F, 1), 2, 0)  # (ticks, 6, columns + 1)
            columns = F[..., :-1]
            shares = np.linalg.solve(columns.mT @ columns, columns.mT @ F[..., -1:])[..., 0]
            sizes = np.linalg.norm(F, axis=1)
            places = np.ix_(ticks, np.isin(owner, contacts))
            alpha[places] = shares
            presses[places] = shares * sizes[:, :-1] > _PRESSES * sizes[:, -1:]
        closed = np.empty((len(alpha), len(N)), dtype=bool)
        for i, (body, pair) in enumerate(zip(on, self._contacts, strict=True)):
            closed[:, i] = touched[body]
            if pushes_only(pair):  # every force of a unilateral contact must press
                closed[:, i] &= presses[:, owner == i].all(axis=1)
        return alpha, closed


class MujocoTruth(MujocoNotes):
    """Record of poses, twists and contact forces at the beginning of the last step.

    This is the instant of the wrist readings.
    """

    def __init__(self, plant: Noted) -> None:
        """Set the plant whose states are recorded.

        Args:
            plant: plant with elliptic friction cones, so that the first constraint force of a
                contact is its normal force.
        """
        inertia = plant.chain.reference_inertia(pin.SE3.Identity())
        super().__init__(plant.contacts, plant.faces, inertia)
        self._plant = plant
        data = plant.data
        body = plant.object_body
        root = plant.model.body_rootid[body]
        self._parts = (
            data.xpos[body],
            data.xmat[body],
            data.cvel[body],
            data.subtree_com[root],
        )
        self._contact_count = -1  # in the last call of `note`
        self._states: list[Array] = []
        self._points: list[Array] = []

    def note(self) -> None:
        """Append the present poses of object and rails, and MuJoCo's contacts with their forces."""
        data = self._plant.data
        self._states.append(np.concatenate((*self._parts, data.qpos.take(self._plant.face_q))))
        if data.ncon != self._contact_count:
            # views of the contacts stay valid: they are at the start of MuJoCo's arena in all steps
            contact = data.contact
            self._contact_count = data.ncon
            self._address = contact.efc_address[:, None]
            self._contact = contact.geom, self._address, contact.pos, contact.frame[:, :3]
        force = data.efc_force
        normal = force.take(self._address) if len(force) else np.zeros((self._contact_count, 1))
        self._points.append(np.concatenate((*self._contact, normal), axis=1))

    def noted(self, start: int = 0) -> Array:
        """States of object and environment at the k instants recorded since `start`, (k, m).

        The m columns are: R of the object by rows (9), its position p (3, m), its twist at O in
        world axes (6; m/s, rad/s), the positions of the bodies on rails (m), then for each body the
        wrench that the object exerts on it at O (6; N, N m), then for each body 1 if the object
        touches it, else 0.

        Args:
            start: index of the first instant.
        """
        p, R, velocity, centre, positions = np.split(
            np.array(self._states[start:]).T, [3, 12, 18, 21]
        )
        R = R.reshape(3, 3, -1)
        place = self._plant.place
        p = p + np.einsum("ijk,j->ik", R, place.translation)
        R = np.einsum("ijk,jl->ilk", R, place.rotation)
        omega = velocity[:3]
        v = velocity[3:] + cross(omega, p - centre)
        parts = (R.reshape(9, -1), p, v, omega, positions, *self._wrenches(p, start))
        return np.concatenate(parts).T

    def _wrenches(self, O: Array, start: int) -> tuple[Array, Array]:  # noqa: E741
        """Wrenches that the object exerts on the bodies of the environment.

        Args:
            O: (3, k) positions of the operational point, world (m).
            start: index of the first instant.

        Returns:
            (6 bodies, k) wrenches at O in world axes (N, N m), and (bodies, k) True where a body is
            touched.
        """
        k = O.shape[1]
        bodies = len(self._plant.faces.rails)
        wrenches = np.zeros((bodies, k, 6))
        touched = np.zeros((bodies, k))
        counts = [len(points) for points in self._points[start:]]
        # columns: two geoms, address of the constraint (−1: none), position, normal, normal force
        points = np.concatenate(self._points[start:])
        between = self._plant.body_of[points[:, :2].astype(int)]
        chosen = (between.min(axis=1) == OBJECT) & (between.max(axis=1) >= 0)
        points = points[chosen]
        tick = np.repeat(np.arange(k), counts)[chosen]
        body = between[chosen].max(axis=1)
        presses = points[:, 2] >= 0.0
        # the normal points from the first geom to the second
        sign = np.where(between[chosen, 0] == OBJECT, 1.0, -1.0)
        f = np.where(presses, sign * points[:, 9], 0.0) * points[:, 6:9].T
        moment = cross(points[:, 3:6].T - O[:, tick], f)
        np.add.at(wrenches, (body, tick), np.concatenate((f, moment)).T)
        np.logical_or.at(touched, (body, tick), presses)
        return wrenches.transpose(0, 2, 1).reshape(-1, k), touched

    def clear(self) -> None:
        """Delete the recorded instants."""
        self._states.clear()
        self._points.clear()
