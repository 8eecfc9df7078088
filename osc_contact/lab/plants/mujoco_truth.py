"""True state of object and contacts in MuJoCo: noted raw at each tick, worked out afterwards."""

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
    """A plant in MuJoCo, as far as its truth is read from it.

    Attributes:
        model, data: MuJoCo's. chain: the true arms. contacts: the pairs.
        faces: bodies of the environment.
        object_body: the number of the object's body in `model`. place: of the object in it.
        body_of: (ngeom,) body of the environment by geom; `OBJECT`, or `OTHER`.
        face_q: places in qpos of the joints of moving bodies, see `guided_joints`.
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


#: Of what the body takes. One that only seems to touch gets 1e-17 … 1e-7, by rounding and by the
#: places of the points; one that does, 1e-3 and more.
_PRESSES = 1e-5


def guided_joints(rails: Sequence[Rail]) -> tuple[Array, Array]:
    """Body and kind (0 travel, 1 turn) of each joint of the moving bodies.

    Args:
        rails: rails of the bodies of the environment.
    """
    guides = [(i, k) for i, rail in enumerate(rails) for k in rail.joints]
    bodies, kinds = np.array(guides, dtype=int).reshape(-1, 2).T
    return bodies, kinds


class MujocoNotes:
    """The truth from what `MujocoTruth` noted.

    The normal forces of all points where the object touches one body make one wrench, which the
    columns of the contacts on that body share: exactly, as far as it lies in their range.
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
        """See `ReadsTruth.truths`."""
        faces = self._faces
        k = len(noted)
        bodies = len(faces.rails)
        sizes = [9, 3, 6, len(self._guided[0]), 6 * bodies]
        R, p, V_O, travelled, pushed, touched = np.split(noted.T.copy(), np.cumsum(sizes))
        X_WO = Poses(R.reshape(3, 3, k), p)
        X_WE: tuple[Poses | None, ...] = (None,) * len(faces.on)
        if len(travelled):
            s = np.zeros((bodies, 2, k))
            s[self._guided] = travelled
            poses = [rail.over(*path) for rail, path in zip(faces.rails, s, strict=True)]
            X_WE = tuple(poses[body] for body in faces.on)
        N = tuple(normals_over(q, X_WO, X) for q, X in zip(self._contacts, X_WE, strict=True))
        alpha, closed = self._shares(X_WO, N, pushed.reshape(bodies, 6, k), touched > 0.0)
        return Truths(alpha, closed, X_WO, V_O.T.copy(), X_WE, N)

    def _shares(
        self, X_WO: Poses, N: Sequence[Array], pushed: Array, touched: Array
    ) -> tuple[Array, Array]:
        """Magnitudes (k, r) and whether each contact touches (k, contacts).

        α with NᵀΦN α = NᵀΦf, Φ⁻¹ the inertia of the object: the least-squares solution of what the
        object alone would feel of the columns and of the wrench f.
        """
        on = self._faces.on
        owner = np.repeat(np.arange(len(N)), [part.shape[1] for part in N])
        alpha = np.zeros((touched.shape[1], len(owner)))
        presses = alpha > 0.0
        for body in sorted(set(on)):
            rows = touched[body]
            here = [i for i, other in enumerate(on) if other == body]
            if not rows.any():
                continue
            F = np.concatenate([*(N[i] for i in here), pushed[body][:, None]], axis=1)[:, :, rows]
            at = Poses(X_WO.R[:, :, rows], X_WO.p[:, rows])
            F = np.concatenate((at.rotate_back(F[:3]), at.rotate_back(F[3:])))  # object axes
            F = np.moveaxis(np.tensordot(self._root, F, 1), 2, 0)
            columns = F[..., :-1]
            share = np.linalg.solve(columns.mT @ columns, columns.mT @ F[..., -1:])[..., 0]
            size = np.linalg.norm(F, axis=1)
            places = np.ix_(rows, np.isin(owner, here))
            alpha[places] = share
            presses[places] = share * size[:, :-1] > _PRESSES * size[:, -1:]
        closed = np.empty((len(alpha), len(N)), dtype=bool)
        for i, (body, pair) in enumerate(zip(on, self._contacts, strict=True)):
            all_press = presses[:, owner == i].all(axis=1)
            closed[:, i] = touched[body] & (all_press if pushes_only(pair) else True)
        return alpha, closed


class MujocoTruth(MujocoNotes):
    """Pose, twist and contact forces as of the last step's beginning, like the wrench sensors."""

    def __init__(self, plant: Noted) -> None:
        """Watch a plant; cones are elliptic: a contact's first constraint force is its normal's."""
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
        self._seen = -1
        self._states: list[Array] = []
        self._points: list[Array] = []

    def note(self) -> None:
        """Append the present poses of object and rails, and MuJoCo's contacts with their forces."""
        data = self._plant.data
        self._states.append(np.concatenate((*self._parts, data.qpos.take(self._plant.face_q))))
        if data.ncon != self._seen:  # contacts stand at the start of MuJoCo's arena at every step
            contact = data.contact
            self._seen = data.ncon
            self._address = contact.efc_address[:, None]
            self._contact = contact.geom, self._address, contact.pos, contact.frame[:, :3]
        force = data.efc_force
        normal = force.take(self._address) if len(force) else np.zeros((self._seen, 1))
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
        p, R, velocity, centre, travelled = np.split(
            np.array(self._states[start:]).T, [3, 12, 18, 21]
        )
        R = R.reshape(3, 3, -1)
        place = self._plant.place
        p = p + np.einsum("ijk,j->ik", R, place.translation)
        R = np.einsum("ijk,jl->ilk", R, place.rotation)
        omega = velocity[:3]
        v = velocity[3:] + cross(omega, p - centre)
        parts = (R.reshape(9, -1), p, v, omega, travelled, *self._wrenches(p, start))
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
        pushed = np.zeros((bodies, k, 6))
        touched = np.zeros((bodies, k))
        counts = [len(one) for one in self._points[start:]]
        points = np.concatenate(self._points[start:])
        between = self._plant.body_of[points[:, :2].astype(int)]
        here = (between.min(axis=1) == OBJECT) & (between.max(axis=1) >= 0)
        points = points[here]
        tick = np.repeat(np.arange(k), counts)[here]
        body = between[here].max(axis=1)
        presses = points[:, 2] >= 0.0
        # the normal points from the first geom to the second
        sign = np.where(between[here, 0] == OBJECT, 1.0, -1.0)
        f = np.where(presses, sign * points[:, 9], 0.0) * points[:, 6:9].T
        moment = cross(points[:, 3:6].T - O[:, tick], f)
        np.add.at(pushed, (body, tick), np.concatenate((f, moment)).T)
        np.logical_or.at(touched, (body, tick), presses)
        return pushed.transpose(0, 2, 1).reshape(-1, k), touched

    def clear(self) -> None:
        """Forget the instants noted so far."""
        self._states.clear()
        self._points.clear()
