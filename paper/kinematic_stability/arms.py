"""Two revolute arms that hold an object and press along one world axis."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from osc_contact import robots
from osc_contact.contacts.pairs import VertexOnFace
from osc_contact.dynamics.arm import Arm
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.dynamics.payload import RigidObject
from osc_contact.spatial import Array

__all__ = ["HybridArm", "planar_arm", "ur5_arm"]

_WORLD_AXES = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
_HELD = pin.Inertia(1.2, np.array([0.03, 0.0, 0.02]), np.diag([4e-3, 6e-3, 5e-3]))
_STIFFNESS = np.diag([300.0, 300.0, 300.0, 3.0, 3.0, 3.0])


@dataclass(frozen=True, eq=False)
class HybridArm:
    """An arm of n joints that controls the force along one world axis and n − 1 motions.

    Attributes:
        name: in titles.
        chain: one arm and the held object, whose frame is the tip.
        rows: (n,) which rows of the tip's twist (world axes at the tip) are the task coordinates.
        force: which of them is force-controlled.
        K_q: (n, n) joint stiffness of the classic scheme (N m/rad).
        K_prime: (6, 6) stiffness of ours, world axes (N/m, N m/rad).
    """

    name: str
    chain: ClosedChain
    rows: tuple[int, ...]
    force: int
    K_q: Array
    K_prime: Array

    @cached_property
    def plant(self) -> pin.Model:
        """The arm with the object's inertia on its last joint."""
        model = self.chain.model.copy()
        frame = model.frames[self.tip]
        model.appendBodyToJoint(frame.parentJoint, _HELD, frame.placement)
        return model

    @cached_property
    def data(self) -> pin.Data:
        """Scratch of `plant`; nothing read from it outlives the next call."""
        return self.plant.createData()

    @cached_property
    def tip(self) -> int:
        """Index of the tip frame in `plant`."""
        arm = self.chain.arms[0]
        return robots.frame_id(self.chain.model, f"{arm.name}/{arm.tip}")

    @cached_property
    def pair(self) -> VertexOnFace:
        """The contact: a face square to the force axis, touched at the tip."""
        return VertexOnFace(np.zeros(3), np.zeros(3), -np.eye(6)[self.force, :3])

    @property
    def selection(self) -> Array:
        """(n,) 1 where the task coordinate is position-controlled, 0 where the force is."""
        return np.array([float(row != self.force) for row in self.rows])

    def terms(self, q: Array) -> tuple[Array, Array, pin.SE3]:
        """M (n, n) with the object, the tip's Jacobian (6, n), world axes, and its pose."""
        data = self.data
        M = np.array(pin.crba(self.plant, data, q))
        J = pin.computeFrameJacobian(self.plant, data, q, self.tip, _WORLD_AXES)
        pin.updateFramePlacement(self.plant, data, self.tip)
        return np.triu(M) + np.triu(M, 1).T, np.array(J), pin.SE3(data.oMf[self.tip])

    def tangents(self, J: Array) -> Array:
        """(6, n−1) what the contact permits and the arm can do, J (6, n) the tip's Jacobian."""
        if len(self.rows) == 6:  # the arm can do everything
            return np.delete(np.eye(6), self.force, axis=1)
        return J @ np.linalg.svd(J[[self.force]])[2][1:].T

    def metric(self, tip: pin.SE3) -> Array:
        """B (6, 6) at the tip, world axes: the inverse inertia of the held object."""
        return np.linalg.inv(pin.SE3(tip.rotation, np.zeros(3)).act(_HELD).matrix())


def planar_arm() -> HybridArm:
    """Two revolute joints in a horizontal plane; x of the tip is position-, y force-controlled."""
    model = pin.Model()
    parent, placement = 0, pin.SE3.Identity()
    for name, length, mass in (("shoulder", 0.5, 6.0), ("elbow", 0.4, 4.0)):
        parent = model.addJoint(parent, pin.JointModelRZ(), placement, name)
        inertia = mass * length**2 / 12 * np.diag([0.02, 1.0, 1.0])
        link = pin.Inertia(mass, np.array([0.5 * length, 0.0, 0.0]), inertia)
        model.appendBodyToJoint(parent, link, pin.SE3.Identity())
        placement = pin.SE3(np.eye(3), np.array([length, 0.0, 0.0]))
    model.upperEffortLimit = np.full(2, 100.0)
    model.lowerEffortLimit = -model.upperEffortLimit
    model.addFrame(pin.Frame("tip", parent, placement, pin.FrameType.OP_FRAME))
    chain = ClosedChain(
        [Arm.from_urdf(model, name="planar", tip="tip")], payload=RigidObject(_HELD)
    )
    return HybridArm("planar 2R arm", chain, (0, 1), 1, 120.0 * np.eye(2), _STIFFNESS)


def ur5_arm() -> HybridArm:
    """A UR5 that controls the force along z and all other motions of its tool."""
    arm = Arm.from_urdf(robots.find_robot("ur5")[0], name="ur5", tip="tool0")
    chain = ClosedChain([arm], payload=RigidObject(_HELD))
    K_q = np.diag([400.0, 400.0, 200.0, 20.0, 20.0, 20.0])
    return HybridArm("UR5", chain, tuple(range(6)), 2, K_q, _STIFFNESS)
