"""The tick beside what else could be run in its place, on the same rigs."""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin

from benchmarks.cases import CASES, TickCase
from benchmarks.measuring import Call, spread, take_turns
from benchmarks.textbook import TextbookLaw
from osc_contact import robots
from osc_contact.plants.mujoco import MujocoPlant
from osc_contact.spatial import Array
from paper.study import Data, with_object

BLOCKS = 10
TICK = "tick"

Calls = dict[str, Call]
Peers = tuple[Calls, Calls, Call]


def peers_of(case: TickCase) -> Peers:
    """The tick and what could be run in its place, at the case's instant.

    Returns:
        Calls of compiled code, one in Python, and what is called after each tick.
    """
    import mujoco

    tick, unwind = case.tick()
    compiled: Calls = {
        TICK: tick,
        "floor: computeAllTerms": case.floor(),
        "pin.constraintDynamics": constraint_dynamics(case),
        "MuJoCo mj_inverse": partial(mujoco.mj_inverse, *mujoco_state(case)),
    }
    return compiled, {"textbook law in NumPy": TextbookLaw(case).tick}, unwind


def measure(rounds: int) -> Data:
    """{case: rows of its peers}, times in µs.

    Compiled peers take turns among themselves, in blocks that alternate with the one in Python:
    microseconds measured right after a millisecond of Python are those of cold caches.
    `ratio` is a median over the tick's.

    Args:
        rounds: of the peer in Python; compiled ones have ten times as many.
    """
    found: Data = {}
    for name in ("one_panda", "two_contact_rod"):
        times = _in_blocks(peers_of(CASES[name]()), rounds)
        tick = np.median(times[TICK])
        found[name] = [
            {"peer": peer, **spread(some), "ratio": np.median(some) / tick}
            for peer, some in times.items()
        ]
    return found


def _in_blocks(peers: Peers, rounds: int) -> dict[str, Array]:
    compiled, python, unwind = peers
    blocks = min(BLOCKS, rounds)
    found = []
    for _ in range(blocks):
        fast = take_turns(compiled, 10 * rounds // blocks, unwind)
        found.append(fast | take_turns(python, max(1, rounds // blocks)))
    return {name: np.concatenate([block[name] for block in found]) for name in found[0]}


# --- What other engines need for one evaluation of the same rig's equations of motion ---


DEPTH = 2e-5  # m


def constraint_dynamics(case: TickCase) -> Call:
    """`pin.constraintDynamics`: forward dynamics of arms, object, loop and contacts.

    The object is part of the first arm's last link, six-row constraints weld the other arms to it;
    Pinocchio's point contacts have three rows (they do not slide). A proximal term of 1e-10 bears
    the redundant rows of the loop.
    """
    chain = case.chain
    model, _ = with_object(chain)
    ends = []
    for number, grasp in zip(chain.tips, chain.grasps, strict=True):
        tip = model.frames[number]
        ends.append((tip.parentJoint, tip.placement * grasp.X_TO))
    (first, at), *others = ends
    data = model.createData()
    q = case.measurement.q
    v = case.measurement.v
    pin.forwardKinematics(model, data, q)

    def hold(kind: Any, here: pin.SE3, joint: int, there: pin.SE3) -> Any:
        return pin.RigidConstraintModel(kind, model, first, here, joint, there, pin.LOCAL)

    constraints = [hold(pin.ContactType.CONTACT_6D, at, *end) for end in others]
    for pair in case.pairs:
        here = at * pin.SE3(np.eye(3), pair.vertex)
        there = data.oMi[first] * here
        constraints.append(hold(pin.ContactType.CONTACT_3D, here, 0, there))
    states = [constraint.createData() for constraint in constraints]
    pin.initConstraintDynamics(model, data, constraints, states)
    settings = pin.ProximalSettings(1e-12, 1e-10, 10)
    tau = np.zeros(chain.nq)
    tau[chain.actuated] = case.controller().tick(case.measurement, case.reference)
    tau -= model.damping * v  # which `pin.constraintDynamics` does not know
    all_of_it = (model, data, q, v, tau, constraints, states, settings)
    return partial(pin.constraintDynamics, *all_of_it)


def mujoco_state(case: TickCase) -> tuple[Any, Any]:
    """MuJoCo's model and data of a case, under the torques of its tick; object: packaged rod.

    The faces stand a little into the object, so that MuJoCo finds every contact.
    """
    pairs = [replace(pair, point=pair.point + DEPTH * pair.normal) for pair in case.pairs]
    urdfs = [robots.resolve_urdf(arm.model.name)[0] for arm in case.chain.arms]
    faces = [(robots.urdf_path("face"), pair.face_placement()) for pair in pairs]
    plant = MujocoPlant(case.chain, urdfs, robots.urdf_path("rod"), pairs, faces)
    for i, name in enumerate(case.chain.joint_names):
        joint = plant.model.joint(name)
        plant.data.qpos[joint.qposadr] = case.measurement.q[i]
        plant.data.qvel[joint.dofadr] = case.measurement.v[i]
    plant.hold(case.controller().tick(case.measurement, case.reference))
    return plant.model, plant.data
