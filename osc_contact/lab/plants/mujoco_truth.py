"""True state of object and contacts in MuJoCo: raw numbers of each tick, evaluated afterwards."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np
import pinocchio as pin
from numpy.lib.stride_tricks import as_strided

from osc_contact.contacts.pairs import ContactPair
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.lab.plants.faces import Faces
from osc_contact.lab.plants.noted_wrenches import NotedWrenches
from osc_contact.spatial import Array, cross

if TYPE_CHECKING:
    from mujoco import MjData, MjModel
    from mujoco._structs import _MjContactList

OBJECT = -1  #: in `Noted.body_of`: a geom of the object
OTHER = -2  #: neither of the object nor of the environment

_NO_CONTACTS = np.zeros((0, 1))  #: in place of the words of contacts where there are none


class Noted(Protocol):
    """Plant in MuJoCo, with the attributes that its truth is read from.

    Attributes:
        model, data: MuJoCo's model and state.
        chain: the true arms.
        contacts: contact pairs.
        faces: bodies of the environment.
        object_body: index of the object's body in `model`.
        place: pose of the object's frame in it.
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


class MujocoTruth(NotedWrenches):
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
        self._plant = plant  #: plant whose truth is recorded
        data = plant.data
        body = plant.object_body
        root = plant.model.body_rootid[body]
        #: views of position, rotation, velocity and reference point of the object
        self._object_views = (
            data.xpos[body],
            data.xmat[body],
            data.cvel[body],
            data.subtree_com[root],
        )
        self._contact_count = -1  # in the last call of `note`
        self._contact_layout: np.dtype[np.void] = np.dtype([])  #: of a contact's record
        self._states: list[Array] = []  #: numbers of object and rails at each instant
        self._contact_records: list[Array] = []  #: see `_view_contacts`, of each instant
        self._forces: list[Array] = []  #: constraint forces of each instant (N, N m)

    def note(self) -> None:
        """Append the present poses of object and rails, and MuJoCo's contacts with their forces.

        A row of the object has its position (m), rotation matrix, velocities as MuJoCo states them,
        and the centre of mass to which they refer, then the positions of the rails. Contacts are
        copied as bytes.
        """
        data = self._plant.data
        self._states.append(
            np.concatenate((*self._object_views, data.qpos.take(self._plant.face_q)))
        )
        if data.ncon != self._contact_count:
            # a view of the contacts stays valid: they are at the start of MuJoCo's arena in all
            # steps
            self._contact_count = data.ncon
            if self._contact_count:
                #: view of the records of MuJoCo's contacts
                self._contact_layout, self._contact_view = _view_contacts(data.contact)
            else:
                self._contact_view = _NO_CONTACTS
        self._contact_records.append(self._contact_view.copy())
        self._forces.append(data.efc_force.copy())

    def noted(self, start: int = 0) -> Array:
        """States of object and environment at the k instants recorded since `start`, (k, m).

        The columns, which `NotedWrenches.truths` reads, are: rotation matrix of the object by rows
        (9), position of O (3; m), velocity and angular velocity there (6; m/s, rad/s), positions of
        the rails (m, rad), wrenches on the bodies (6 each; N, N m), and flags of those touched; in
        world axes.

        Args:
            start: index of the first instant.
        """
        # rows of `note`: velocities by MuJoCo are angular first, at the centre of mass
        p, R, velocity, centre, positions = np.split(
            np.array(self._states[start:]).T, [3, 12, 18, 21]
        )
        R = R.reshape(3, 3, -1)
        place = self._plant.place
        p = p + np.einsum("ijk,j->ik", R, place.translation)
        R = np.einsum("ijk,jl->ilk", R, place.rotation)
        omega = velocity[:3]
        v = velocity[3:] + cross(omega, p - centre)
        parts = (R.reshape(9, -1), p, v, omega, positions, *self._wrenches_on_bodies(p, start))
        return np.concatenate(parts).T

    def _wrenches_on_bodies(self, O: Array, start: int) -> tuple[Array, Array]:  # noqa: E741
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
        counts = [len(records) for records in self._contact_records[start:]]
        if not any(counts):
            return wrenches.transpose(0, 2, 1).reshape(-1, k), touched
        records = np.concatenate([words for words in self._contact_records[start:] if len(words)])
        contacts = records.view(self._contact_layout)[:, 0]
        between = self._plant.body_of[contacts["geom"]]
        chosen = (between.min(axis=1) == OBJECT) & (between.max(axis=1) >= 0)
        contacts = contacts[chosen]
        tick = np.repeat(np.arange(k), counts)[chosen]
        body = between[chosen].max(axis=1)
        presses = contacts["efc_address"] >= 0
        # the first constraint force of each contact, in the forces of all instants
        forces = np.concatenate([np.zeros(1), *self._forces[start:]])
        before = np.cumsum([1, *(len(force) for force in self._forces[start:])])
        normal = forces[np.where(presses, before[tick] + contacts["efc_address"], 0)]
        # the normal points from the first geom to the second
        sign = np.where(between[chosen, 0] == OBJECT, 1.0, -1.0)
        f = np.where(presses, sign * normal, 0.0) * contacts["normal"].T
        moment = cross(contacts["pos"].T - O[:, tick], f)
        np.add.at(wrenches, (body, tick), np.concatenate((f, moment)).T)
        np.logical_or.at(touched, (body, tick), presses)
        return wrenches.transpose(0, 2, 1).reshape(-1, k), touched

    def clear(self) -> None:
        """Delete the recorded instants."""
        self._states.clear()
        self._contact_records.clear()
        self._forces.clear()


def _view_contacts(contact: _MjContactList) -> tuple[np.dtype[np.void], Array]:
    """Layout of MuJoCo's records of contacts, and a view of all of them.

    The copy of this view is one block of memory, which is faster than copies of its fields.

    Args:
        contact: `MjData.contact`, with one contact at least.

    Returns:
        Record type with the fields pos (3; m), normal (3; the first row of the frame, world axes),
        geom (2) and efc_address (of the first constraint; −1: none), and a view (contacts, words)
        as words of eight bytes.
    """
    size = contact.dist.strides[0]
    fields = {
        "pos": ("3<f8", contact.pos),
        "normal": ("3<f8", contact.frame),
        "geom": ("2<i4", contact.geom),
        "efc_address": ("<i4", contact.efc_address),
    }
    first = contact.dist.ctypes.data  # the first field of a record
    layout = np.dtype(
        {
            "names": list(fields),
            "formats": [code for code, _ in fields.values()],
            "offsets": [values.ctypes.data - first for _, values in fields.values()],
            "itemsize": size,
        }
    )
    words = as_strided(contact.dist, (len(contact.dist), size // 8), (size, 8), writeable=False)
    return layout, words
