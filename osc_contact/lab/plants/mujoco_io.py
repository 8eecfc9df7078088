"""Inputs and outputs of an arm in a MuJoCo model: torques, wrist sensors, geoms of the tool."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from osc_contact.errors import PlantError, did_you_mean
from osc_contact.robots.mjcf import joint_name, motors_of
from osc_contact.spatial import Array

if TYPE_CHECKING:
    from mujoco import MjData, MjModel


class TorqueInputs:
    """Places in MuJoCo's data that receive the torques of an arm's joints.

    A joint with exactly one plain motor is driven through that motor's control. Any other joint
    (with a position servo, several motors or none) receives its torque as `qfrc_applied`, and its
    actuators are switched off in the model.

    Args:
        mj: `mujoco.MjModel`; gains of actuators are set to zero in it where they are switched off.
        joints: numbers of the joints with a motor, in the order of the torques.
    """

    def __init__(self, mj: MjModel, joints: Array) -> None:
        """Find the motor of each joint whose force is proportional to its control.

        Other actuators of these joints are switched off, and torques are applied to the joint
        directly.

        Args:
            mj: MuJoCo's model, changed.
            joints: indices of the joints.
        """
        types = (mj.actuator_biastype, mj.actuator_gaintype, mj.actuator_dyntype)
        per_torque = mj.actuator_gear[:, 0] * mj.actuator_gainprm[:, 0]
        plain = (per_torque != 0.0) & ~np.any(types, axis=0)  # force is gain × control, at once
        motors = []  # index of each joint's motor; −1: torques are applied to the joint directly
        for joint in joints:
            actuators = motors_of(mj, joint)
            if len(actuators) == 1 and plain[actuators[0]]:
                motors.append(actuators[0])
                continue
            motors.append(-1)
            mj.actuator_gainprm[actuators] = mj.actuator_biasprm[actuators] = 0.0
        motor_of_joint = np.array(motors, dtype=int)
        self._driven = motor_of_joint >= 0
        self._motors = motor_of_joint[self._driven]
        self._direct = mj.jnt_dofadr[joints][~self._driven]
        self._per_torque = per_torque[self._motors]

    def send(self, data: MjData, tau: Array) -> None:
        """Write torques of the joints into MuJoCo's data.

        A joint that one plain motor drives (`_driven`) gets a control signal, the torque over that
        of a unit signal (`_per_torque`), at the motor's index (`_motors`); the torques of the
        others are applied to the joints directly, at their indices in qvel (`_direct`).

        Args:
            data: `mujoco.MjData`, changed.
            tau: (n_a,) torques (N m; N).
        """
        data.ctrl[self._motors] = tau[self._driven] / self._per_torque
        data.qfrc_applied[self._direct] = tau[~self._driven]


def sensor_rows(mj: MjModel, site: str) -> Array:
    """Places (6,) of a wrist sensor's force and torque in MuJoCo's sensor data.

    Args:
        mj: `mujoco.MjModel`.
        site: name of a site with a <force> and a <torque> sensor.

    Raises:
        PlantError: the model has no such site, or the site lacks one of the sensors.
    """
    from mujoco import mjtSensor

    require_name("site", site, [mj.site(i).name for i in range(mj.nsite)])
    number = mj.site(site).id
    rows = []
    for tag in ("force", "torque"):
        kind = getattr(mjtSensor, f"mjSENS_{tag.upper()}")
        sensors = np.flatnonzero((mj.sensor_type == kind) & (mj.sensor_objid == number))
        if not len(sensors):
            raise PlantError(
                f'site {site!r} has no {tag} sensor; add to <sensor>: <{tag} site="{site}"/>'
            )
        rows.append(mj.sensor_adr[sensors[0]] + np.arange(3))
    return np.concatenate(rows)


def geoms_beyond(mj: MjModel, body: int) -> Array:
    """Indices of the geoms of a body and of all its descendants.

    Args:
        mj: `mujoco.MjModel`.
        body: index of the body.
    """
    bodies = [body]
    for other in range(body + 1, mj.nbody):  # descendants come later than their parents
        if mj.body_parentid[other] in bodies:
            bodies.append(other)
    return np.flatnonzero(np.isin(mj.geom_bodyid, bodies))


def moving_geoms(mj: MjModel, body: int) -> Array:
    """Mask (ngeom,) of the geoms in the kinematic tree of a body that can move.

    Args:
        mj: `mujoco.MjModel`.
        body: index of a body of the tree.
    """
    bodies = mj.geom_bodyid
    tree: Array = mj.body_rootid[bodies] == mj.body_rootid[body]
    return tree & (mj.body_weldid[bodies] != 0)


def loose_joints(mj: MjModel, body: int, dofs: Array) -> dict[str, float]:
    """Joints of an arm that neither the controller nor the scene holds, with the mass beyond each.

    Args:
        mj: `mujoco.MjModel`.
        body: number of a body of the arm.
        dofs: addresses in qvel of the joints that the controller moves.

    Returns:
        Mass (kg) by the name of the joint.
    """
    from mujoco import mjtEq

    tree = mj.body_rootid == mj.body_rootid[body]
    is_coupling = mj.eq_type == mjtEq.mjEQ_JOINT
    coupled_joints = {*mj.eq_obj1id[is_coupling].tolist(), *mj.eq_obj2id[is_coupling].tolist()}
    masses = {}
    for j in range(mj.njnt):
        position_gains = mj.actuator_biasprm[motors_of(mj, j), 1]
        has_servo = bool(np.any(position_gains))
        is_held = has_servo or mj.jnt_stiffness[j] > 0.0 or j in coupled_joints
        if tree[mj.jnt_bodyid[j]] and mj.jnt_dofadr[j] not in dofs and not is_held:
            masses[joint_name(mj, j)] = float(mj.body_subtreemass[mj.jnt_bodyid[j]])
    return masses


def require_name(kind: str, name: str, names: Sequence[str]) -> None:
    """Refuse a name that a MuJoCo model does not have.

    Args:
        kind: kind of the named element, for the message.
        name: name of the element.
        names: names of all elements of that kind.

    Raises:
        PlantError: there is no such element; the message has similar names.
    """
    if name not in names:
        similar = did_you_mean(name, filter(None, names))
        raise PlantError(f"the MuJoCo model has no {kind} {name!r}; {similar}")
