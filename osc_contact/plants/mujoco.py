"""The judging plant: MuJoCo with unilateral contacts, built from the same URDFs as the model.

Nothing of the toolkit's dynamics is used here: the URDFs are read by MuJoCo's own parser.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from functools import cache
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact.contacts.pairs import ContactPair
from osc_contact.dynamics.assembly import object_pose
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.errors import PlantError
from osc_contact.interface import Measurement, Touched
from osc_contact.plants.faces import Rail, touched
from osc_contact.plants.joint_drives import SPRING, JointDrives, add_drives
from osc_contact.plants.judge import Truth, require_duration
from osc_contact.plants.mujoco_scene import (
    DRIVE_MASS,
    GRASP_JOINT,
    GUIDES,
    scene,
)
from osc_contact.plants.mujoco_truth import MujocoTruth
from osc_contact.scenarios.hardware import PlantSpec, Push
from osc_contact.spatial import Array, as_array, cross

__all__ = ["MujocoPlant"]

_log = logging.getLogger(__name__)


def _stopped() -> float:
    return 0.0


@cache
def _no_clock() -> Any:
    """A clock that stands still, in compiled code."""
    from numba import cfunc

    return cfunc("float64()", cache=True)(_stopped)


def quieten(mujoco: Any) -> None:
    """Let MuJoCo write no MUJOCO_LOG.TXT and read no clock: the plant counts warnings itself."""
    mujoco.set_mju_user_warning(_log.debug)
    if mujoco.get_mjcb_time() is None:  # its profiler reads the clock thirty times a step
        mujoco.set_mjcb_time(_no_clock().ctypes)


class MujocoPlant:
    """Arms, object and environment in MuJoCo (needs the extra `sim`)."""

    def __init__(
        self,
        chain: ClosedChain,
        arm_urdfs: Sequence[Path],
        object_urdf: Path,
        contacts: Sequence[ContactPair],
        bodies: Sequence[tuple[Path, pin.SE3]],
        options: PlantSpec | None = None,
        rails: Sequence[Rail | None] | None = None,
        on: Sequence[int] | None = None,
        drives: JointDrives | None = None,
    ) -> None:
        """Compile the scene.

        Args:
            chain: the true arms and grasps; names, frames, poses and what rotors and friction
                add to the joints are taken from it.
            arm_urdfs: one file for each arm. object_urdf: the held object.
            contacts: what true forces are expressed in; what touches is the geometry's business.
            bodies: URDF and pose in the world of each body of the environment.
            options: step, softness, friction and pushes on the arms; default: a step of 0.25 ms.
            rails: how each body moves; default: all are fixed.
            on: the body of each contact; default: each has its own.
            drives: springs, motor errors and friction of the joints; default: ideal drives.

        Raises:
            PlantError: MuJoCo is missing or refuses the scene.
        """
        try:
            import mujoco
        except ImportError as error:
            raise PlantError(
                "the MuJoCo plant needs the package 'mujoco': pip install osc_contact[sim]"
            ) from error
        self._mj: Any = mujoco
        quieten(mujoco)
        self.chain = chain
        self.contacts = tuple(contacts)
        options = PlantSpec(step=2.5e-4) if options is None else options
        self.on = tuple(range(len(self.contacts)) if on is None else on)
        self.rails: list[Rail | None] = list(rails or [None] * len(bodies))
        self.pushes = options.pushes
        self.drives = JointDrives() if drives is None else drives
        driven = [chain.joint_names[j] for j in chain.actuated]
        try:
            spec = scene(mujoco, chain, arm_urdfs, object_urdf, bodies, options, self.rails)
            add_drives(mujoco, spec, driven, self.drives)
            self.model: Any = spec.compile()
        except (ValueError, mujoco.FatalError) as error:
            raise PlantError(f"MuJoCo refuses the scene: {error}") from error
        self.data: Any = mujoco.MjData(self.model)
        joints = [self.model.joint(name) for name in chain.joint_names]
        self._q = np.array([int(j.qposadr[0]) for j in joints])
        self._v = np.array([int(j.dofadr[0]) for j in joints])
        self._springs = self._spring_v = np.array([], dtype=int)
        if self.drives.flexible is not None:
            springs = [self.model.joint(f"{name}/{SPRING}") for name in driven]
            self._springs = np.array([int(j.qposadr[0]) for j in springs])
            self._spring_v = np.array([int(j.dofadr[0]) for j in springs])
        self._object = int(self.model.body("object/root").id)
        self._seen = [self._object] + [
            int(self.model.body(f"{arm.name}/{arm.tip}").id) for arm in chain.arms
        ]
        roots = [int(self.model.body(f"face{i}/root").id) for i in range(len(bodies))]
        self._body_of = {geom: i for i, root in enumerate(roots) for geom in self._geoms_of(root)}
        self._moved = {i: rail for i, rail in enumerate(self.rails) if rail is not None}
        kinds = [(i, k) for i, rail in self._moved.items() for k in rail.joints]
        guides = [self.model.joint(f"face{i}/{GUIDES[k]}") for i, k in kinds]
        self._guided = tuple(np.array(kinds, dtype=int).reshape(-1, 2).T)  # body, joint
        self._face_q = np.array([int(j.qposadr[0]) for j in guides], dtype=int)
        self._face_v = np.array([int(j.dofadr[0]) for j in guides], dtype=int)
        self._driven = any(rail.motion is not None for rail in self._moved.values())
        if self._driven:  # the drive's mass must not set the scale of the solver's accuracy
            self.model.stat.meaninertia = 1.0
        self._sensed = [i for i, arm in enumerate(chain.arms) if arm.wrist_sensor is not None]
        readings = [self.model.sensor(f"{chain.arms[i].name}/force").adr[0] for i in self._sensed]
        self._readings = np.add.outer(np.array(readings, dtype=int), np.arange(6))
        self._look_in()

    def _look_in(self) -> None:
        """Views of what every step reads and writes."""
        self._qpos, self._qvel = self.data.qpos, self.data.qvel
        self._sensordata, self._ctrl = self.data.sensordata, self.data.ctrl
        self._warnings, self._size = self.data.warning.number, self._ctrl.shape
        self._calm = bytes(self._warnings.nbytes)
        self._option = self.model.opt
        self._step, self._flags = float(self._option.timestep), int(self._option.disableflags)
        self._blind = int(self._mj.mjtDisableBit.mjDSBL_SENSOR)
        self.time = 0.0

    def reset(self, q: Array) -> None:
        """Start at rest at joint positions q (n,); loops and gaps must fit."""
        q = as_array("q", q, (self.chain.nq,))
        self._mj.mj_resetData(self.model, self.data)
        self.data.qpos[self._q] = q
        self._turn_object(q)
        self.time = 0.0
        for i, v in zip(self._guided[0], self._face_v, strict=True):
            self.data.qfrc_applied[v] = self._moved[i].preload
        self._drive(0.0)
        self._mj.mj_forward(self.model, self.data)

    def _turn_object(self, q: Array) -> None:
        """Put the joint of the first grasp, if it is one, where the other arms hold the object."""
        grasp = self.chain.grasps[0]
        if grasp.is_rigid:
            return
        X_WO = object_pose(self.chain, q)
        R = (self.chain.tip_poses()[0] * grasp.X_TO).rotation.T @ X_WO.rotation
        joint = self.model.joint(GRASP_JOINT)
        start = int(joint.qposadr[0])
        if grasp.kind == "ball":
            x, y, z, w = pin.Quaternion(R).coeffs()
            self.data.qpos[start : start + 4] = w, x, y, z
        else:
            self.data.qpos[start] = pin.log3(R) @ joint.axis

    def hold(self, tau: Array) -> None:
        """Apply torques from now on; time stands still."""
        self._send(tau)
        if self.drives.flexible is not None:  # springs wound up, motors where that puts them
            q = self._joints(self.data.qpos, self._q, self._springs)[self.chain.actuated]
            wound = -self.data.ctrl / self.drives.flexible.stiffness
            self.data.qpos[self._springs] = wound
            self.data.qpos[self._q[self.chain.actuated]] = q - wound
        self._mj.mj_forward(self.model, self.data)

    def _send(self, tau: Array) -> None:
        known = type(tau) is np.ndarray and tau.shape == self._size
        if not known or not isfinite(tau.dot(tau)):
            tau = as_array("tau", tau, self._size)
        if self.drives.motors is not None:
            tau = self.drives.motors.torque(tau, self.data.qpos[self._q[self.chain.actuated]])
        self._ctrl[:] = tau

    def readings(self, qpos: Array, qvel: Array, sensed: Array) -> tuple[Array, Array, Array]:
        """What encoders and wrists read, of one plant or of the rows of a batch.

        Args:
            qpos, qvel, sensed: (…, m) MuJoCo's positions, velocities and sensor data.

        Returns:
            q, v (…, n) and wrenches (…, arms, 6), zero where an arm has no sensor.
        """
        wrenches = sensed.take(self._readings, axis=-1)
        if len(self._readings) < len(self.chain.arms):
            known, wrenches = wrenches, np.zeros((*sensed.shape[:-1], len(self.chain.arms), 6))
            wrenches[..., self._sensed, :] = known
        q = self._joints(qpos, self._q, self._springs)
        return q, self._joints(qvel, self._v, self._spring_v), wrenches

    def _joints(self, x: Array, joints: Array, springs: Array) -> Array:
        """Positions or velocities (…, n) of the links: what the motors do, plus the springs."""
        links: Array = x.take(joints, axis=-1)
        if len(springs):
            links[..., self.chain.actuated] += x[..., springs]
        return links

    def _joint_torques(self) -> Array:
        """(n_a,) what the torque sensors feel: the springs, or the motors themselves."""
        flexible = self.drives.flexible
        if flexible is None:
            return self._ctrl.copy()
        wound, rate = self.data.qpos[self._springs], self.data.qvel[self._spring_v]
        return -flexible.stiffness * wound - flexible.damping * rate

    def measure(self) -> Measurement:
        """Encoders after the last step, wrist wrenches as of its beginning (one step old)."""
        q, v, wrenches = self.readings(self._qpos, self._qvel, self._sensordata)
        return Measurement(q, v, wrenches, self._touched(), self._joint_torques())

    def _touched(self) -> Touched | None:
        if not self._moved:
            return None
        s, rates, second = np.zeros((3, len(self.rails), 2))
        s[self._guided] = self.data.qpos[self._face_q]
        rates[self._guided] = self.data.qvel[self._face_v]
        for i, rail in self._moved.items():
            if rail.motion is not None:
                second[i] = rail.motion(self.time)[2]
        return touched(self.rails, self.on, s, rates, second)

    def _drive(self, t: float) -> None:
        """Put driven faces where they are to be at t, and push them on to the next step."""
        now = {i: rail.motion(t) for i, rail in self._moved.items() if rail.motion is not None}
        for i, k, q, v in zip(*self._guided, self._face_q, self._face_v, strict=True):
            if i in now:
                self.data.qpos[q], self.data.qvel[v], acceleration = (x[k] for x in now[i])
                self.data.qfrc_applied[v] = DRIVE_MASS * acceleration

    def truth(self) -> Truth:
        """As of the last step's beginning, like the wrenches; see `MujocoTruth`."""
        log = self.log()
        log.note()
        return log.truths(log.noted())[0]

    def poses(self) -> Array:
        """See `Judge.poses`; as of the last step's beginning."""
        X = np.tile(np.eye(4), (len(self._seen), 1, 1))
        X[:, :3, :3] = self.data.xmat[self._seen].reshape(-1, 3, 3)
        X[:, :3, 3] = self.data.xpos[self._seen]
        return X

    def log(self) -> MujocoTruth:
        """A log of the truth."""
        inertia = self.chain.reference_inertia(pin.SE3.Identity())
        return MujocoTruth(
            (self.model, self.data), self._object, self._body_of, self.rails,
            (self._face_q, self._guided), self.contacts, self.on, inertia,
        )  # fmt: skip

    def command(self, tau: Array, duration: float) -> None:
        """Hold the torques over the steps that fit into `duration`."""
        require_duration(duration)
        self._send(tau)
        if self.pushes:
            self.data.xfrc_applied[:] = 0.0
            for push in self.pushes:
                self._push(push, push.at(self.time))
        steps = self.steps_in(duration)
        if not self._driven:
            if steps > 1:  # readings in between are not used
                self._option.disableflags = self._flags | self._blind
                self._mj.mj_step(self.model, self.data, steps - 1)
                self._option.disableflags = self._flags
            self._mj.mj_step(self.model, self.data)
        for k in range(steps if self._driven else 0):
            self._drive(self.time + k * self._step)
            self._mj.mj_step(self.model, self.data)
        self.time += steps * self._step
        if self._warnings.tobytes() != self._calm:  # of accelerations that are not finite, too
            self.require_calm()

    def require_calm(self) -> None:
        """Whether MuJoCo has warned of anything since the start.

        Raises:
            PlantError: it has: the simulation diverged.
        """
        if not self._warnings.any():
            return
        kinds = [self._mj.mjtWarning(i).name for i in np.flatnonzero(self._warnings)]
        raise PlantError(
            f"MuJoCo diverged at t = {self.time:.4f} s ({', '.join(kinds)}); largest speed "
            f"{np.abs(self.data.qvel).max():.3g}. Lower the gains or the plant step."
        )

    def stop(self, reason: str = "") -> None:
        """Nothing to do."""

    @property
    def object_body(self) -> int:
        """The number of the object's body in `model`."""
        return self._object

    @property
    def steps_alone(self) -> bool:
        """Whether MuJoCo's steps are all there is to a period: no driven faces, errors, pushes."""
        return not (self._moved or self.pushes or self.drives.motors is not None)

    def steps_in(self, period: float) -> int:
        """How many of MuJoCo's steps a control period (s) has."""
        return round(period / self._step) or 1

    def _push(self, push: Push, force: Array) -> None:
        sensor = self.model.site(f"{push.arm}/wrist")
        body = int(self.model.body_parentid[int(sensor.bodyid[0])])
        arm = self.data.site_xpos[sensor.id] - self.data.xipos[body]
        self.data.xfrc_applied[body, :3] += force
        self.data.xfrc_applied[body, 3:] += cross(arm, force)

    def _geoms_of(self, root: int) -> set[int]:
        """Geoms of a body and of the bodies fixed to it."""
        bodies = {root}
        for body in range(root + 1, self.model.nbody):
            if int(self.model.body_parentid[body]) in bodies:
                bodies.add(body)
        return {g for g in range(self.model.ngeom) if int(self.model.geom_bodyid[g]) in bodies}
