"""The rigs that are timed, each in motion on its contacts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from osc_contact import robots
from osc_contact.contacts.pairs import VertexOnFace
from osc_contact.control.controller import Controller, Gains, Status
from osc_contact.control.force import ForceGains
from osc_contact.control.motion import MotionGains
from osc_contact.control.phases import PhaseSettings
from osc_contact.dynamics.arm import Arm
from osc_contact.dynamics.assembly import close, object_pose, reach
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.dynamics.payload import RigidObject
from osc_contact.errors import InvalidInputError
from osc_contact.interface import Measurement, Reference
from osc_contact.plants.rigid import RigidPlant
from osc_contact.runs.loop import run_loop
from osc_contact.runs.rig import Rig, build_rig
from osc_contact.scenarios import load_scenario
from osc_contact.spatial import Array

__all__ = [
    "CASES",
    "DT",
    "TickCase",
    "in_motion",
    "one_panda",
    "repeatable",
    "require_status",
    "rod_rig",
    "two_contact_rod",
    "two_pandas",
]

DT = 1e-3
MOVING_TICKS = 40
ROD = pin.Inertia(1.5, np.array([0.01, -0.004, 0.006]), np.diag([2e-3, 0.045, 0.044]))
END, RADIUS = np.array([0.29, 0.0, 0.0]), 0.01  # the packaged rod's
PANDA_Q = np.array([0.0, -0.3, 0.0, -2.2, 0.0, 2.0, 0.78])
GAINS = Gains(MotionGains(900.0, 60.0), ForceGains(30.0, 100.0))


def require_status(controller: Controller, name: str, expected: Status = Status.OK) -> None:
    """Refuse to time a tick that did not end as expected.

    Args:
        controller: after the tick. name: of the case. expected: how its ticks end.

    Raises:
        InvalidInputError: with the status and its reason.
    """
    if controller.status is not expected:
        reason = f" ({controller.reason})" if controller.status is not Status.OK else ""
        raise InvalidInputError(
            f"{name}: a timed tick ended {controller.status.name}{reason}, expected {expected.name}"
        )


def repeatable(controller: Controller) -> Controller:
    """The same controller, to be ticked with the very same readings again and again."""
    endless = replace(
        controller.settings.safety,
        stuck_speed=np.inf,
        frozen_time=np.inf,
        speed_error=np.inf,
        position_drift=np.inf,
    )
    return controller.with_safety(endless)


@dataclass(frozen=True)
class TickCase:
    """A rig at one instant.

    Attributes:
        chain, pairs: arms, object and contacts. gains, posture: of the controller.
        measurement, reference: in the middle of a motion along the faces, all contacts pressed.
        status: how every tick at this instant ends. life: of the controller.
    """

    name: str
    chain: ClosedChain
    pairs: tuple[VertexOnFace, ...]
    gains: Gains
    posture: Array
    measurement: Measurement
    reference: Reference
    status: Status = Status.OK
    life: PhaseSettings | None = None

    def controller(self) -> Controller:
        """A controller of this rig."""
        return Controller(
            self.chain, self.pairs, self.gains, dt=DT, posture=self.posture, life=self.life,
            reading="filter",  # the paper's
        )  # fmt: skip

    def tick(self) -> tuple[Callable[[], Array], Callable[[], None]]:
        """A tick at this instant, and what is to be called after each.

        That is: how the tick ended is checked, and its integrators are set back to zero.
        """
        return self.ticking(repeatable(self.controller()))

    def ticking(self, controller: Controller) -> tuple[Callable[[], Array], Callable[[], None]]:
        """The same with a given controller."""

        def tick() -> Array:
            return controller.tick(self.measurement, self.reference)

        def unwind() -> None:
            require_status(controller, self.name, self.status)
            controller.motion_law.integral = np.zeros(6)
            controller.force_law.integral = np.zeros(0)

        return tick, unwind

    def floor(self) -> Callable[[], object]:
        """`pin.computeAllTerms` of the same arms at the same q and v."""
        model, data = self.chain.model, self.chain.model.createData()
        q, v = (np.array(x, dtype=float) for x in (self.measurement.q, self.measurement.v))
        return lambda: pin.computeAllTerms(model, data, q, v)


def in_motion(
    name: str,
    chain: ClosedChain,
    pairs: tuple[VertexOnFace, ...],
    q: Array,
    gains: Gains,
    reference: Callable[[float], Reference],
    status: Status = Status.OK,
) -> TickCase:
    """Let the rigid plant follow a reference for a moment; there the case stands.

    Args:
        name: of the case. chain, pairs, gains: of its controller. q: (n,) start.
        reference: by time (s). status: how its ticks end.
    """
    plant = RigidPlant(chain, pairs, DT)
    plant.reset(q)
    still = TickCase(name, chain, pairs, gains, q, plant.measure(), reference(0.0))
    run_loop(plant, still.controller(), (reference(k * DT) for k in range(MOVING_TICKS)))
    end = reference(MOVING_TICKS * DT)
    return TickCase(name, chain, pairs, gains, q, plant.measure(), end, status)


def rod_rig() -> tuple[Rig, Gains, tuple[VertexOnFace, ...]]:
    """The packaged scenario's rig, its gains and its two contacts."""
    rig = build_rig(load_scenario("two_contact_rod"))
    return rig, rig.gains, tuple(pair for pair in rig.pairs if isinstance(pair, VertexOnFace))


def two_contact_rod() -> TickCase:
    """Two SCARA arms with gripper hinges, a rod, two skew contacts: d = 5, r = 2."""
    rig, gains, pairs = rod_rig()
    at = rig.references.at
    return in_motion("two_contact_rod", rig.chain, pairs, rig.q_contact, gains, at)


def one_panda() -> TickCase:
    """One Panda, its rod pressed on a face by one end: d = 6, r = 1, one redundant joint."""
    arm = panda("arm", pin.SE3.Identity())
    grasp = pin.SE3(np.eye(3), np.array([0.02, 0.01, 0.08]))
    chain = ClosedChain([arm], [grasp], RigidObject(ROD))
    return _sliding("one_panda", chain, PANDA_Q, [END])


def two_pandas() -> TickCase:
    """Two Pandas hold a rod, each end on a face: d = 6, r = 2."""
    down = pin.rpy.rpyToMatrix(np.pi, 0.0, 0.0)
    turned = pin.rpy.rpyToMatrix(np.pi, 0.0, np.pi)
    arms = [
        panda("left", pin.SE3(np.eye(3), np.array([-0.55, 0.0, 0.0]))),
        panda("right", pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, np.pi), np.array([0.55, 0.0, 0.0]))),
    ]
    grasps = [
        pin.SE3(R, np.array([x, 0.0, 0.0])).inverse() for R, x in ((down, -0.15), (turned, 0.15))
    ]
    chain = ClosedChain(arms, grasps, RigidObject(ROD))
    X = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.45]))
    q = close(chain, reach(chain, np.concatenate((PANDA_Q, PANDA_Q)), X))
    return _sliding("two_pandas", chain, q, [-END, END])


CASES: dict[str, Callable[[], TickCase]] = {
    "two_contact_rod": two_contact_rod,
    "one_panda": one_panda,
    "two_pandas": two_pandas,
}


def panda(name: str, base: pin.SE3) -> Arm:
    """A Panda with its fingers locked and a force sensor where the hand is flanged on."""
    urdf, _ = robots.find_robot("panda")
    return Arm.from_urdf(
        urdf, name=name, tip="panda_hand_tcp", base=base, wrist_sensor="panda_hand"
    )


def _sliding(name: str, chain: ClosedChain, q: Array, vertices: list[Array]) -> TickCase:
    """Faces that lean towards the rod, so that only its ends touch; the rod slides across."""
    X = object_pose(chain, q)
    up = np.array([0.0, 0.0, 1.0])
    pairs = []
    for i, vertex in enumerate(vertices):
        outward = X.rotation @ vertex / np.linalg.norm(vertex)
        normal = up - 0.5 * outward
        normal = normal / np.linalg.norm(normal)
        point = X.act(vertex) - RADIUS * normal
        pairs.append(VertexOnFace(vertex, point, normal, RADIUS, name=f"contact{i}"))
    across = np.cross(up, X.rotation[:, 0])
    speed = 0.1 * across / np.linalg.norm(across)

    def reference(t: float) -> Reference:
        V = np.concatenate((speed, np.zeros(3)))
        X_WD = pin.SE3(X.rotation, X.translation + speed * t)
        return Reference(X_WD, V, np.zeros(6), np.full(len(pairs), 10.0))

    return in_motion(name, chain, tuple(pairs), q, GAINS, reference)
