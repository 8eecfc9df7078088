"""Benchmark of the tick and of alternatives from other software, on the same rigs."""

import json
import subprocess
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import osc_contact as osc
from benchmarks.cases import CASES, TickCase
from benchmarks.measuring import Call, Rows, spread, take_turns
from benchmarks.textbook import TextbookLaw
from osc_contact import robots
from osc_contact.contacts.pairs.pair import triad
from osc_contact.lab.plants.mujoco import MujocoPlant
from osc_contact.spatial import Array
from paper.study import Data, with_object

BLOCKS = 10
TSID_CASE = "one_panda"
TICK = "tick"
FLOOR = "floor: computeAllTerms"
TOTAL = "TSID: pose, posture, one contact"
HOW_TO_TSID = (
    'python3 -m venv ENV && ENV/bin/pip install "tsid==1.7.1" "pin==3.4.0" "cmeel-urdfdom<5" '
    '"cmeel-tinyxml2<11", then --tsid-python ENV/bin/python'
)


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
        FLOOR: case.floor(),
        "pin.constraintDynamics": constraint_dynamics(case),
        "MuJoCo mj_inverse": partial(mujoco.mj_inverse, *mujoco_state(case)),
    }
    return (compiled, {"textbook law in NumPy": TextbookLaw(case).tick}, unwind)


def measure(rounds: int, tsid_python: Path | None = None) -> Data:
    """{case: rows of its peers, "tsid": rows}, times in µs.

    Compiled peers take turns among themselves, in blocks that alternate with the one in Python:
    microseconds measured right after a millisecond of Python are those of cold caches.
    `ratio` is a median over the tick's. TSID alternates with its own Pinocchio's floor in another
    process; then the tick alternates with its floor alone: their ratio is the last row.

    Args:
        rounds: rounds of the peer in Python; compiled ones have ten times as many.
        tsid_python: interpreter of TSID's environment.

    Raises:
        InvalidInputError: TSID's interpreter fails.
    """
    found: Data = {}
    for name in (TSID_CASE, "two_contact_rod"):
        peers = peers_of(CASES[name]())
        times = _in_blocks(peers, rounds)
        tick = np.median(times[TICK])
        found[name] = [
            {"peer": peer, **spread(some), "ratio": np.median(some) / tick}
            for peer, some in times.items()
        ]
        if name == TSID_CASE:
            found["tsid"] = (
                HOW_TO_TSID
                if tsid_python is None
                else _beside_tsid(peers, tsid_python, 10 * rounds)
            )
    return found


def _in_blocks(peers: Peers, rounds: int) -> dict[str, Array]:
    compiled, python, unwind = peers
    blocks = min(BLOCKS, rounds)
    found = []
    for _ in range(blocks):
        fast = take_turns(compiled, 10 * rounds // blocks, unwind)
        found.append(fast | take_turns(python, max(1, rounds // blocks)))
    return {name: np.concatenate([block[name] for block in found]) for name in found[0]}


def _beside_tsid(peers: Peers, python: Path, rounds: int) -> Rows:
    """TSID's run, and the tick in the same pattern: next to its floor."""
    program = Path(__file__).with_name("tsid_peer.py")
    urdf, _ = robots.find_robot("panda")
    command = [str(python), "-I", str(program), str(urdf), str(rounds)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    except OSError as error:
        raise osc.InvalidInputError(f"{python} cannot be run: {error}. {HOW_TO_TSID}") from error
    if done.returncode != 0:
        message = (done.stderr.strip() or "nothing").splitlines()[-1]
        raise osc.InvalidInputError(f"{python} cannot run TSID: {message}. {HOW_TO_TSID}")
    parts = {part: np.array(times) for part, times in json.loads(done.stdout).items()}
    compiled, _, unwind = peers
    alone = {name: compiled[name] for name in (TICK, FLOOR)}
    tick = take_turns(alone, rounds, unwind)[TICK]
    parts |= {"the tick": tick, "TSID / tick": parts[TOTAL] / np.median(tick)}
    return [{"part": part, **spread(some)} for part, some in parts.items()]


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
    return partial(pin.constraintDynamics, model, data, q, v, tau, constraints, states, settings)


def mujoco_state(case: TickCase) -> tuple[Any, Any]:
    """MuJoCo's model and data of a case, under the torques of its tick; object: packaged rod.

    The faces stand a little into the object, so that MuJoCo finds every contact.
    """
    pairs = [replace(pair, point=pair.point + DEPTH * pair.normal) for pair in case.pairs]
    urdfs = [robots.resolve_urdf(arm.model.name)[0] for arm in case.chain.arms]
    faces = [(robots.urdf_path("face"), pin.SE3(triad(pair.normal), pair.point)) for pair in pairs]
    plant = MujocoPlant(case.chain, urdfs, robots.urdf_path("rod"), pairs, faces)
    for i, name in enumerate(case.chain.joint_names):
        joint = plant.model.joint(name)
        plant.data.qpos[joint.qposadr] = case.measurement.q[i]
        plant.data.qvel[joint.dofadr] = case.measurement.v[i]
    plant.hold(case.controller().tick(case.measurement, case.reference))
    return (plant.model, plant.data)
