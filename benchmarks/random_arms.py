"""Any number of arms around one object, with contacts, made up at random in code."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from benchmarks.cases import DT, GAINS
from osc_contact.contacts.contact import Contact
from osc_contact.contacts.pairs import ContactPair, VertexOnFace
from osc_contact.control.controller import Controller
from osc_contact.dynamics.arm import Arm
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.dynamics.payload import RigidObject
from osc_contact.errors import InvalidInputError
from osc_contact.interface import Measurement, Reference
from osc_contact.spatial import Array

__all__ = ["KINDS", "RandomRig", "faces_of", "random_rig"]

#: Degree of freedom of an object held by arms of a kind.
KINDS = {"planar": 3, "scara": 4, "ur5": 6}
BODY = pin.Inertia(4.0, np.array([0.01, -0.02, 0.015]), np.diag([0.09, 0.11, 0.14]))


@dataclass(frozen=True)
class RandomRig:
    """Arms that hold an object, at rest, at positions q."""

    chain: ClosedChain
    q: Array
    X_WO: pin.SE3

    def controller(self, pairs: list[ContactPair]) -> tuple[Controller, Measurement, Reference]:
        """A controller and what it gets: at rest, wrists that read zero, 1 N on each contact."""
        controller = Controller(self.chain, pairs, GAINS, dt=DT, posture=self.q)
        wrenches = np.zeros((len(self.chain.arms), 6))
        measurement = Measurement(self.q, np.zeros(self.chain.nq), wrenches)
        count = sum(pair.contact(self.X_WO, np.zeros(6)).r for pair in pairs)
        reference = Reference(self.X_WO, np.zeros(6), np.zeros(6), np.full(count, 1.0))
        return controller, measurement, reference


def random_rig(kinds: list[str], rng: np.random.Generator) -> RandomRig:
    """Arms of the given kinds around an object; hands and bases lie where they have to.

    Planar arms turn in the horizontal plane and SCARAs stand upright, so that several of a kind
    permit the same motions.

    Raises:
        InvalidInputError: an unknown kind.
    """
    X_WO = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.6]))
    arms, grasps, positions = [], [], []
    for i, kind in enumerate(kinds):
        if kind not in KINDS:
            raise InvalidInputError(f"no arm '{kind}'; there are {', '.join(KINDS)}")
        model, q = _MAKE[kind](rng)
        angle = 2.0 * np.pi * i / len(kinds)
        grip = 0.2 * np.array([np.cos(angle), np.sin(angle), 0.0])
        X_OT = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, rng.uniform(-3.0, 3.0)), grip)
        data = model.createData()
        pin.framesForwardKinematics(model, data, q)
        base = X_WO * X_OT * data.oMf[model.getFrameId("tip")].inverse()
        name = f"arm{i}"
        arms.append(Arm.from_urdf(model, name=name, tip="tip", base=base, wrist_sensor="wrist"))
        grasps.append(X_OT.inverse())
        positions.append(q)
    chain = ClosedChain(arms, grasps, RigidObject(BODY))
    return RandomRig(chain, np.concatenate(positions), X_WO)


def faces_of(
    rig: RandomRig, contacts: int, rank: int, rng: np.random.Generator
) -> list[ContactPair]:
    """Vertices on faces whose lines of force span `rank` dimensions of the object's forces.

    Faces beyond the first `rank` are copies of these, moved along their lines of force.

    Args:
        rig: holds the object. contacts: how many. rank: of their forces. rng: random numbers.

    Raises:
        InvalidInputError: more dimensions than contacts, or than the object has motions.
    """
    state = rig.chain.state(rig.q, np.zeros(rig.chain.nq))
    if not 0 <= rank <= min(contacts, state.d):
        raise InvalidInputError(
            f"{contacts} contacts on an object with d = {state.d} cannot have r = {rank}"
        )
    pairs: list[ContactPair] = []
    for i in range(contacts):
        if i < rank:
            pairs.append(_another(rig, pairs, rng, state.S))
        else:
            first = pairs[i % rank]
            assert isinstance(first, VertexOnFace)
            inward = -0.02 * (i // rank) * (rig.X_WO.rotation.T @ first.normal)
            vertex = first.vertex + inward
            at = rig.X_WO.act(vertex)
            pairs.append(VertexOnFace(vertex, at, first.normal, name=f"face{i}"))
    return pairs


def _another(
    rig: RandomRig, pairs: list[ContactPair], rng: np.random.Generator, S: Array
) -> VertexOnFace:
    """The one of some random faces that depends least on the others."""
    best, least = None, -1.0
    for _ in range(30):
        vertex, normal = rng.uniform(-0.3, 0.3, 3), rng.normal(size=3)
        pair = VertexOnFace(vertex, rig.X_WO.act(vertex), normal, name=f"face{len(pairs)}")
        N = np.hstack([p.contact(rig.X_WO, np.zeros(6)).N for p in (*pairs, pair)])
        felt = np.linalg.solve(np.linalg.cholesky(S.T @ BODY.matrix() @ S), S.T @ N)
        apart = float(np.linalg.svd(felt / np.linalg.norm(felt, axis=0))[1][-1])
        if apart > least:
            best, least = pair, apart
    assert best is not None
    return best


def contact_of(rig: RandomRig, pairs: list[ContactPair]) -> Contact:
    """The stacked contact state at rest."""
    return Contact.stack([pair.contact(rig.X_WO, np.zeros(6)) for pair in pairs])


def _planar(rng: np.random.Generator) -> tuple[pin.Model, Array]:
    lengths = rng.uniform(0.25, 0.4, 3)
    turns = [(pin.JointModelRZ(), np.eye(3), np.array([a, 0.0, 0.0])) for a in (0.0, *lengths[:2])]
    q = np.array([rng.uniform(-3, 3), *rng.uniform(1.0, 1.8, 2)])  # well bent
    return _chain(turns, np.array([lengths[2], 0.0, 0.0]), rng), q


def _scara(rng: np.random.Generator) -> tuple[pin.Model, Array]:
    a, b = rng.uniform(0.25, 0.4, 2)
    joints = [
        (pin.JointModelRZ(), np.eye(3), np.array([0.0, 0.0, 0.4])),
        (pin.JointModelRZ(), np.eye(3), np.array([a, 0.0, 0.0])),
        (pin.JointModelPZ(), np.eye(3), np.array([b, 0.0, 0.0])),
        (pin.JointModelRZ(), np.eye(3), np.array([0.0, 0.0, -0.2])),
    ]
    q = np.array([rng.uniform(-3, 3), rng.uniform(0.6, 2.0), -0.1, rng.uniform(-3, 3)])
    return _chain(joints, np.array([0.05, 0.0, -0.1]), rng), q


def _ur5(rng: np.random.Generator) -> tuple[pin.Model, Array]:
    """Six revolute joints with the proportions of a UR5, lengths varied by a tenth."""
    quarter = pin.rpy.rpyToMatrix(np.pi / 2, 0.0, 0.0)
    k = rng.uniform(0.9, 1.1, 6)
    joints = [
        (pin.JointModelRZ(), np.eye(3), np.array([0.0, 0.0, 0.089 * k[0]])),
        (pin.JointModelRZ(), quarter, np.zeros(3)),
        (pin.JointModelRZ(), np.eye(3), np.array([0.425 * k[1], 0.0, 0.0])),
        (pin.JointModelRZ(), np.eye(3), np.array([0.392 * k[2], 0.0, 0.109 * k[3]])),
        (pin.JointModelRZ(), quarter, np.array([0.0, -0.095 * k[4], 0.0])),
        (pin.JointModelRZ(), quarter.T, np.array([0.0, 0.082 * k[5], 0.0])),
    ]
    q = np.array([0.0, -1.2, 1.4, -1.0, -1.5, 0.3]) + rng.uniform(-0.3, 0.3, 6)
    return _chain(joints, np.array([0.0, 0.0, 0.12]), rng), q


_MAKE = {"planar": _planar, "scara": _scara, "ur5": _ur5}


def _chain(
    joints: list[tuple[object, Array, Array]], tip: Array, rng: np.random.Generator
) -> pin.Model:
    """A serial arm: joints with the placement of each in the one before; links of 1 to 3 kg."""
    model, last = pin.Model(), 0
    for i, (joint, R, p) in enumerate(joints):
        last = model.addJoint(last, joint, pin.SE3(R, p), f"joint{i}")
        body = pin.Inertia(rng.uniform(1.0, 3.0), rng.uniform(-0.1, 0.1, 3), 0.02 * np.eye(3))
        model.appendBodyToJoint(last, body, pin.SE3.Identity())
    model.upperEffortLimit[:] = 1e4
    identity, to_tip = pin.SE3.Identity(), pin.SE3(np.eye(3), tip)
    model.addFrame(pin.Frame("wrist", last, 0, identity, pin.FrameType.OP_FRAME))
    model.addFrame(pin.Frame("tip", last, 0, to_tip, pin.FrameType.OP_FRAME))
    return model
