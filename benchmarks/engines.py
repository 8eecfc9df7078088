"""What other engines need for one evaluation of the same rig's equations of motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from benchmarks.cases import TickCase
from osc_contact import robots
from osc_contact.plants.mujoco import MujocoPlant

__all__ = ["constraint_dynamics", "mujoco_inverse", "mujoco_state"]

DEPTH = 2e-5  # m


def constraint_dynamics(case: TickCase) -> Callable[[], object]:
    """`pin.constraintDynamics`: forward dynamics of arms, object, loop and contacts.

    The object is part of the first arm's last link, six-row constraints weld the other arms to it;
    Pinocchio's point contacts have three rows (they do not slide). A proximal term of 1e-10 bears
    the redundant rows of the loop.
    """
    chain = case.chain
    assert chain.payload is not None
    model = chain.model.copy()
    tips = [model.frames[model.getFrameId(f"{a.name}/{a.tip}")] for a in chain.arms]
    joints = [tip.parentJoint for tip in tips]
    at = [tip.placement * grasp.X_TO for tip, grasp in zip(tips, chain.grasps, strict=True)]
    model.appendBodyToJoint(joints[0], chain.payload.inertia, at[0])
    data = model.createData()
    q, v = case.measurement.q, case.measurement.v
    pin.forwardKinematics(model, data, q)
    constraints = [
        pin.RigidConstraintModel(
            pin.ContactType.CONTACT_6D, model, joints[0], at[0], joint, X, pin.LOCAL
        )
        for joint, X in zip(joints[1:], at[1:], strict=True)
    ]
    for pair in case.pairs:
        here = at[0] * pin.SE3(np.eye(3), pair.vertex)
        there = data.oMi[joints[0]] * here
        constraints.append(
            pin.RigidConstraintModel(
                pin.ContactType.CONTACT_3D, model, joints[0], here, 0, there, pin.LOCAL
            )
        )
    states = [constraint.createData() for constraint in constraints]
    pin.initConstraintDynamics(model, data, constraints, states)
    settings = pin.ProximalSettings(1e-12, 1e-10, 10)
    tau = np.zeros(chain.nq)
    tau[chain.actuated] = case.controller().tick(case.measurement, case.reference)
    tau -= model.damping * v  # which `pin.constraintDynamics` does not know
    return lambda: pin.constraintDynamics(
        model, data, q, v, tau, constraints, states, settings
    )  # fmt: skip


def mujoco_inverse(case: TickCase) -> Callable[[], object]:
    """`mj_inverse`: torques that explain q, v and q̈, with welds and soft contacts.

    Raises:
        PlantError: MuJoCo is missing or refuses the scene.
    """
    model, data = mujoco_state(case)
    import mujoco

    return lambda: mujoco.mj_inverse(model, data)


def mujoco_state(case: TickCase) -> tuple[Any, Any]:
    """MuJoCo's model and data of a case, under the torques of its tick; object: packaged rod.

    The faces stand a little into the object, so that MuJoCo finds every contact.
    """
    pairs = [replace(pair, point=pair.point + DEPTH * pair.normal) for pair in case.pairs]
    with TemporaryDirectory() as folder:
        urdfs = [_without_shapes(arm.model.name, Path(folder)) for arm in case.chain.arms]
        faces = [(robots.urdf_path("face"), pair.face_placement()) for pair in pairs]
        plant = MujocoPlant(case.chain, urdfs, robots.urdf_path("rod"), pairs, faces)
    for name, q, v in zip(
        case.chain.joint_names, case.measurement.q, case.measurement.v, strict=True
    ):
        joint = plant.model.joint(name)
        plant.data.qpos[joint.qposadr] = q
        plant.data.qvel[joint.dofadr] = v
    plant.hold(case.controller().tick(case.measurement, case.reference))
    return plant.model, plant.data


def _without_shapes(name: str, folder: Path) -> Path:
    """The arm's URDF without shapes, which MuJoCo would have to read."""
    packaged = name.startswith("scara")
    tree = ElementTree.parse(robots.urdf_path(name) if packaged else robots.find_robot(name)[0])
    for link in tree.getroot().findall("link"):
        for kind in ("visual", "collision"):
            for shape in link.findall(kind):
                link.remove(shape)
    path = folder / f"{name}.urdf"
    tree.write(path)
    return path
