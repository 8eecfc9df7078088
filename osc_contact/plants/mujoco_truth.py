"""The truth of a MuJoCo plant about object and contacts: noted raw, computed afterwards."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact.contacts.pairs.law_pair import normals_over
from osc_contact.contacts.pairs.pair import ContactPair, pushes_only
from osc_contact.plants.faces import Rail
from osc_contact.plants.judge import Truths
from osc_contact.spatial import Array, Poses, cross

__all__ = ["MujocoTruth"]

#: Of what the body takes. One that only seems to touch gets 1e-17 … 1e-7, by rounding and by the
#: places of the points; one that does, 1e-3 and more.
_PRESSES = 1e-5


class MujocoTruth:
    """Pose, twist and contact forces as of the last step's beginning, like the wrench sensors.

    The normal forces of all points where the object touches one body make one wrench, which the
    columns of the contacts on that body share: exactly, as far as it lies in their range.
    """

    def __init__(
        self,
        plant: tuple[Any, Any],
        body: int,
        body_of: Mapping[int, int],
        rails: Sequence[Rail | None],
        guided: tuple[Array, tuple[Array, ...]],
        contacts: Sequence[ContactPair],
        on: Sequence[int],
        inertia: Array,
    ) -> None:
        """Watch a plant.

        Args:
            plant: `MjModel` and `MjData`. Cones are elliptic: the first number of a contact's
                constraint force is its normal force.
            body: the object's. body_of: body of the environment by its geom; geoms that are not
                named, and −1, are the object's, others neither.
            rails: how each of these moves. guided: places in qpos of their joints; the body of
                each joint and whether it is the travel (0) or the angle (1).
            contacts: the pairs. on: the body of each.
            inertia: (6, 6) of the object at its origin, in its own axes.
        """
        model, self._data = plant
        self._rails, self._on, self._contacts = rails, on, tuple(contacts)
        self._travel, self._guided = guided
        d, root = self._data, int(model.body_rootid[body])
        self.place: pin.SE3 | None = None  #: of the object in that body
        self._parts: tuple[Array, ...] = (
            d.xpos[body],
            d.xmat[body],
            d.cvel[body],
            d.subtree_com[root],
        )
        self._body_of = np.full(model.ngeom, -1)
        self._body_of[list(body_of)] = list(body_of.values())
        self._Phi = np.linalg.inv(inertia)
        self._seen = -1
        self._states: list[Array] = []
        self._points: list[Array] = []
        self._forces: list[Array] = []

    def note(self) -> None:
        """Keep where the object and bodies on rails are, and each contact with its force."""
        data = self._data
        parts = self._parts
        if len(self._travel):
            parts = (*parts, data.qpos[self._travel])
        self._states.append(np.concatenate(parts))
        if data.ncon != self._seen:  # contacts stand at the start of MuJoCo's arena at every step
            contact = data.contact
            self._seen, self._address = data.ncon, contact.efc_address
            self._contact = contact.geom, self._address[:, None], contact.pos, contact.frame[:, :3]
        self._points.append(np.concatenate(self._contact, axis=1))
        force = data.efc_force
        self._forces.append(force.take(self._address) if len(force) else np.zeros(self._seen))

    def noted(self, start: int = 0) -> Array:
        """(k, m): R, p and twist of the object, where bodies on rails are, and of each body

        the wrench into it at O and whether it is touched.
        """
        p, R, velocity, centre, travelled = np.split(
            np.array(self._states[start:]).T, [3, 12, 18, 21]
        )
        k = p.shape[1]
        R = R.reshape(3, 3, k)
        if self.place is not None:
            p = p + np.einsum("ijk,j->ik", R, self.place.translation)
            R = np.einsum("ijk,jl->ilk", R, self.place.rotation)
        omega = velocity[:3]
        v = velocity[3:] + cross(omega, p - centre)
        parts = (R.reshape(9, k), p, v, omega, travelled, *self._wrenches(p, start))
        return np.concatenate(parts).T

    def _wrenches(self, O: Array, start: int) -> tuple[Array, Array]:  # noqa: E741
        """Into each body: (6 bodies, k) at O (3, k), and whether it is touched (bodies, k)."""
        k, bodies = O.shape[1], len(self._rails)
        pushed = np.zeros((bodies, k, 6))
        touched = np.zeros((bodies, k))
        points = np.concatenate(self._points[start:])
        first, second = self._body_of[points[:, :2].astype(int)].T
        body = np.maximum(first, second)
        here = (np.minimum(first, second) == -1) & (body >= 0)  # the object is one of the two
        tick = np.repeat(np.arange(k), [len(one) for one in self._points[start:]])
        presses = points[:, 2] >= 0.0
        size = np.where(presses, np.concatenate(self._forces[start:]), 0.0)
        # the normal points from the first geom to the second
        f = np.where(first < 0, size, -size) * points[:, 6:].T
        wrench = np.concatenate((f, cross(points[:, 3:6].T - O[:, tick], f)))
        body, tick = body[here], tick[here]
        np.add.at(pushed, (body, tick), wrench[:, here].T)
        np.logical_or.at(touched, (body, tick), presses[here])
        return pushed.transpose(0, 2, 1).reshape(-1, k), touched

    def clear(self) -> None:
        """Forget the instants noted so far."""
        for notes in (self._states, self._points, self._forces):
            notes.clear()

    def truths(self, noted: Array) -> Truths:
        """See `TruthLog.truths`."""
        k, bodies = len(noted), len(self._rails)
        sizes = [9, 3, 6, len(self._travel), 6 * bodies]
        R, p, V_O, travelled, pushed, touched = np.split(noted.T.copy(), np.cumsum(sizes))
        X_WO = Poses(R.reshape(3, 3, k), p)
        X_WE = self._faces(travelled.T)
        N = tuple(normals_over(q, X_WO, X) for q, X in zip(self._contacts, X_WE, strict=True))
        alpha, closed = self._shares(X_WO, N, pushed.reshape(bodies, 6, k), touched > 0.0)
        return Truths(alpha, closed, X_WO, V_O.T.copy(), X_WE, N)

    def _faces(self, travelled: Array) -> tuple[Poses | None, ...]:
        """Of each contact the poses of its body; None for all where no body can move."""
        if not len(self._travel):
            return (None,) * len(self._on)
        k = len(travelled)
        s = np.zeros((len(self._rails), 2, k))
        s[self._guided] = travelled.T
        still = Poses(np.eye(3)[:, :, None], np.zeros((3, k)))
        poses = [
            still if rail is None else rail.over(*path)
            for rail, path in zip(self._rails, s, strict=True)
        ]
        return tuple(poses[body] for body in self._on)

    def _shares(
        self, X_WO: Poses, N: Sequence[Array], pushed: Array, touched: Array
    ) -> tuple[Array, Array]:
        """Magnitudes (k, r) and whether each contact touches (k, contacts)."""
        k = touched.shape[1]
        alpha = [np.zeros((part.shape[1], k)) for part in N]
        presses = [np.zeros(part.shape, dtype=bool) for part in alpha]
        for body in sorted(set(self._on)):
            rows = touched[body]
            here = [i for i, other in enumerate(self._on) if other == body]
            if not rows.any():
                continue
            at = Poses(X_WO.R[:, :, rows], X_WO.p[:, rows])
            columns = _in_axes_of(at, np.concatenate([N[i][:, :, rows] for i in here], axis=1))
            whole = _in_axes_of(at, pushed[body][:, None, rows])
            share = _split(columns, self._Phi, whole[:, 0])
            felt = share * self._mobility(columns) > _PRESSES * self._mobility(whole)
            ends = np.cumsum([len(alpha[i]) for i in here])[:-1]
            for i, part, on in zip(here, np.split(share, ends), np.split(felt, ends), strict=True):
                alpha[i][:, rows], presses[i][:, rows] = part, on
        closed = [
            touched[body] & (on.all(axis=0) if pushes_only(pair) else True)
            for body, pair, on in zip(self._on, self._contacts, presses, strict=True)
        ]
        both = np.concatenate([np.zeros((0, k)), *alpha])
        return both.T.copy(), np.array(closed, dtype=bool).reshape(-1, k).T.copy()

    def _mobility(self, wrenches: Array) -> Array:
        """√(fᵀΦf) (m, k), what the object alone would feel of wrenches (6, m, k) in its axes."""
        return np.sqrt((wrenches * np.tensordot(self._Phi, wrenches, 1)).sum(axis=0))


def _in_axes_of(X: Poses, wrenches: Array) -> Array:
    """Wrenches (6, m, k) at O in the object's axes."""
    return np.concatenate((X.rotate_back(wrenches[:3]), X.rotate_back(wrenches[3:])))


def _split(N: Array, Phi: Array, f: Array) -> Array:
    """(r, k) α with NᵀΦ N α = NᵀΦ f; N (6, r, k), Φ (6, 6), f (6, k)."""
    r = N.shape[1]
    Phi_N = np.tensordot(Phi, N, 1)
    right = (Phi_N * f[:, None]).sum(axis=0)
    gram = np.array([[(N[:, i] * Phi_N[:, j]).sum(axis=0) for j in range(r)] for i in range(r)])
    if r == 1:
        return np.asarray(right / gram[0])
    return np.asarray(np.linalg.solve(gram.transpose(2, 0, 1), right.T[:, :, None])[:, :, 0].T)
