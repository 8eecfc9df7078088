"""What a MuJoCo plant knows of the object and its contacts: noted raw, worked out afterwards."""

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

_POINTS = 4  #: of contact that have room at first; more are made room for
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
        capacity: int,
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
            capacity: instants there is room for; more is made for more.
        """
        model, self._data = plant
        self._rails, self._on, self._contacts = rails, on, tuple(contacts)
        self._travel, self._guided = guided
        d, root = self._data, int(model.body_rootid[body])
        self.place: pin.SE3 | None = None  #: of the object in that body
        self.parts: Sequence[Array] = (
            d.xpos[body], d.xmat[body], d.cvel[body], d.subtree_com[root],
        )  # fmt: skip
        self._travelled = np.zeros((capacity, len(self._travel)))
        self._body_of = np.full(model.ngeom, -1)
        self._body_of[list(body_of)] = list(body_of.values())
        self._Phi = np.linalg.inv(inertia)
        self._count = self._seen = 0
        self._contact: list[tuple[Array, Array]] = []
        self._points = np.zeros(capacity, dtype=int)
        self._geom = np.zeros((capacity, _POINTS, 2), dtype=np.int32)
        self._address = np.zeros((capacity, _POINTS), dtype=np.int32)
        self._force = np.zeros((capacity, 6 * _POINTS))  # of all constraints
        self._place = np.zeros((capacity, _POINTS, 3))
        self._frame = np.zeros((capacity, _POINTS, 9))

    def note(self) -> None:
        """Keep what moves about in memory: contacts, and where bodies on rails are."""
        k, data = self._count, self._data
        if k == len(self._points):
            self._make_room()
        if len(self._travel):
            self._travelled[k] = data.qpos[self._travel]
        self._points[k] = n = data.ncon
        if n:
            if n != self._seen:
                self._look(n)
            force = data.efc_force
            if len(force) > self._force.shape[1]:
                self._force = _widened(self._force, len(force))
            for rows, view in self._contact:
                rows[k, :n] = view
            self._force[k, : len(force)] = force
        self._count = k + 1

    def _make_room(self) -> None:
        """For twice as many instants."""
        for name in ("_travelled", "_points", "_geom", "_address", "_force", "_place", "_frame"):
            rows = getattr(self, name)
            setattr(self, name, np.concatenate((rows, np.zeros_like(rows))))
        self._seen = 0  # look for the contacts again, to write into the new rows

    def _look(self, n: int) -> None:
        """Find n contacts in memory; they lie at the start of MuJoCo's arena at every step."""
        if n > self._place.shape[1]:
            for name in ("_geom", "_address", "_place", "_frame"):
                setattr(self, name, _widened(getattr(self, name), n))
        contact, self._seen = self._data.contact, n
        self._contact = [
            (self._geom, contact.geom), (self._address, contact.efc_address),
            (self._place, contact.pos), (self._frame, contact.frame),
        ]  # fmt: skip

    def noted(self, start: int, stop: int) -> Array:
        """(stop − start, m): where bodies on rails are; of each point where the object touches

        the number of its body, from 1, 0 for no point; 1 if it presses; its place; its force.
        """
        rows = slice(start, stop)
        count = self._points[rows]
        points = np.zeros((stop - start, int(count.max(initial=0)), 8))
        for i in range(points.shape[1]):
            first, second = self._body_of[self._geom[rows, i]].T
            address = self._address[rows, i]
            presses = address >= 0
            normal = self._frame[rows, i, :3]  # from the first geom to the second
            force = np.where(presses, self._force[np.arange(start, stop), address], 0.0)
            out = points[:, i]
            touches = np.minimum(first, second) == -1  # the object is one of the two
            out[:, 0] = np.where(touches, 1 + np.maximum(first, second), 0)
            out[:, 1], out[:, 2:5] = presses, self._place[rows, i]
            out[:, 5:] = force[:, None] * np.where(first < 0, normal.T, -normal.T).T
            out[i >= count] = 0.0
        return np.concatenate((self._travelled[rows], points.reshape(stop - start, -1)), axis=1)

    def clear(self) -> None:
        """Forget the instants noted so far."""
        self._count = 0

    def truths(self, parts: Array, noted: Array) -> Truths:
        """k instants: `parts` (k, 21), and what was `noted` (k, m)."""
        k, rails = len(parts), len(self._travel)
        p, R, velocity, centre = np.split(parts.T.copy(), [3, 12, 18])
        R = R.reshape(3, 3, k)
        if self.place is not None:
            p = p + np.einsum("ijk,j->ik", R, self.place.translation)
            R = np.einsum("ijk,jl->ilk", R, self.place.rotation)
        X_WO = Poses(R, p)
        v, omega = velocity[3:] + cross(velocity[:3], p - centre), velocity[:3]
        X_WE = self._faces(noted[:, :rails])
        N = tuple(normals_over(q, X_WO, X) for q, X in zip(self._contacts, X_WE, strict=True))
        pushed, touched = self._wrenches(p, noted[:, rails:].reshape(k, -1, 8))
        alpha, closed = self._shares(X_WO, N, pushed, touched)
        return Truths(alpha, closed, X_WO, np.concatenate((v, omega)).T.copy(), X_WE, N)

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

    def _wrenches(self, O: Array, points: Array) -> tuple[Array, Array]:  # noqa: E741
        """Into each body: (bodies, 6, k) at O, and whether it is touched (bodies, k)."""
        k = len(points)
        pushed = np.zeros((len(self._rails), 6, k))
        touched = np.zeros((len(self._rails), k), dtype=bool)
        for body_from_1, presses, *place, fx, fy, fz in points.transpose(1, 2, 0):
            f = np.array((fx, fy, fz))
            wrench = np.concatenate((f, cross(np.array(place) - O, f)))
            for body in range(len(pushed)):
                here = body_from_1 == body + 1
                pushed[body] += np.where(here, wrench, 0.0)
                touched[body] |= here & (presses > 0.0)
        return pushed, touched

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


def _widened(rows: Array, wanted: int) -> Array:
    """Room for twice as many as wanted along the second axis."""
    return np.pad(rows, [(0, 0), (0, 2 * wanted - rows.shape[1]), (0, 0)][: rows.ndim])


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
