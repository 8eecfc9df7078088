"""The judging plant: MuJoCo with unilateral contacts, built from the same URDFs as the model.

Nothing of the toolkit's dynamics is used here: the URDFs are read by MuJoCo's own parser.
"""

from __future__ import annotations

import ctypes
import logging
from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from osc_contact.contacts.pairs import ContactPair
from osc_contact.dynamics.assembly import object_pose
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.dynamics.environment import Rail
from osc_contact.errors import PlantError, missing
from osc_contact.interface import Measurement
from osc_contact.lab.plants.faces import Faces
from osc_contact.lab.plants.joint_drives import SPRING, JointDrives, add_drives
from osc_contact.lab.plants.mujoco_io import geoms_beyond
from osc_contact.lab.plants.mujoco_scene import DRIVE_MASS, GRASP_JOINT, GUIDES, scene
from osc_contact.lab.plants.mujoco_truth import OBJECT, MujocoTruth
from osc_contact.lab.plants.noted_wrenches import guided_joints
from osc_contact.lab.scenarios.hardware import PlantSpec, Push
from osc_contact.loop.judge import Truth, require_duration
from osc_contact.robots.mjcf import placed
from osc_contact.spatial import Array, as_array, cross

if TYPE_CHECKING:
    from mujoco import MjData, MjModel, MjSpec

_log = logging.getLogger(__name__)


def quieten(mujoco: ModuleType) -> None:
    """Stop MuJoCo from writing MUJOCO_LOG.TXT and from reading the clock.

    The plant counts warnings itself.

    Args:
        mujoco: the module.
    """
    mujoco.set_mju_user_warning(_log.debug)
    if mujoco.get_mjcb_time() is None:  # its profiler reads the clock thirty times a step
        mujoco.set_mjcb_time(ctypes.pythonapi.PyFloat_GetMin)  # always the same number, from C


class MujocoPlant:
    """Arms, object and environment in MuJoCo (needs the extra `sim`).

    Attributes:
        model, data, spec: MuJoCo's model, state and specification of the scene.
        chain: the true arms.
        contacts: contact pairs.
        faces: bodies of the environment.
        pushes: disturbing forces.
        drives: drives of the joints.
        time: time since the last reset (s).
        object_body: index of the object's body in `model`.
        place: pose of the object's frame in it.
        body_of: (ngeom,) index of the environment's body of each geom; −1: the object, −2: another
            body.
        guided: for each joint of moving bodies the index of the body, and 0 for travel, 1 for an
            angle.
        face_q: indices of these joints in qpos.
    """

    spec: MjSpec | None = None
    pushes: Sequence[Push] = ()
    drives = JointDrives()
    place = pin.SE3.Identity()
    _springs = _spring_v = _face_v = face_q = np.array([], dtype=int)
    guided: tuple[Array, ...] = (face_q, face_q)

    def __init__(
        self,
        chain: ClosedChain,
        arm_urdfs: Sequence[Path],
        object_urdf: Path,
        contacts: Sequence[ContactPair],
        bodies: Sequence[tuple[Path, pin.SE3]],
        *,
        options: PlantSpec | None = None,
        rails: Sequence[Rail] | None = None,
        on: Sequence[int] | None = None,
        drives: JointDrives | None = None,
    ) -> None:
        """Compile the scene.

        Args:
            chain: the true arms and grasps, with names, frames, poses, rotors and joint friction.
            arm_urdfs: one file for each arm.
            object_urdf: file of the held object.
            contacts: pairs in whose magnitudes true forces are expressed; contact itself is
                determined by the collision geometry.
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
            raise PlantError(missing(error)) from error
        quieten(mujoco)
        options = options or PlantSpec(step=2.5e-4)
        self.pushes = options.pushes
        self.drives = drives or JointDrives()
        faces = Faces(rails or [Rail()] * len(bodies), on, len(contacts))
        driven = [chain.joint_names[j] for j in chain.actuated]
        try:
            spec = self.spec = scene(chain, arm_urdfs, object_urdf, bodies, options, faces.rails)
            add_drives(spec, driven, self.drives)
            model = spec.compile()
        except (ValueError, mujoco.FatalError) as error:
            raise PlantError(f"MuJoCo refuses the scene: {error}") from error
        self._connect(model, chain, contacts, faces)
        #: (n,) indices of the joints in qvel; `_q` those in qpos
        self._q, self._v = self._coordinates(chain.joint_names)
        if self.drives.flexible is not None:
            #: (n_a,) indices of the joints' springs in qpos; `_spring_v` those in qvel
            self._springs, self._spring_v = self._coordinates(
                [f"{name}/{SPRING}" for name in driven]
            )
        self.object_body = model.body("object/root").id
        tips = [model.body(f"{arm.name}/{arm.tip}").id for arm in chain.arms]
        #: bodies whose poses are the truth: object, then tips
        self._posed_bodies = [self.object_body, *tips]
        self.body_of = np.full(model.ngeom, OBJECT)
        for i in range(len(bodies)):
            self.body_of[geoms_beyond(model, model.body(f"face{i}/root").id)] = i
        self._find_guides(faces)
        # the solver's tolerance scales with the mean inertia, which a drive's large mass would
        # raise
        if faces.driven:
            model.stat.meaninertia = 1.0
        self._find_wrist_sensors(chain)

    def _find_wrist_sensors(self, chain: ClosedChain) -> None:
        """Find the arms with wrist sensors, and the indices of their wrenches in the sensor data.

        Args:
            chain: the true arms.
        """
        #: indices of the arms with a wrist sensor
        self._sensed_arms = [i for i, arm in enumerate(chain.arms) if arm.wrist_sensor is not None]
        first = [self.model.sensor(f"{chain.arms[i].name}/force").adr[0] for i in self._sensed_arms]
        #: (k, 6) indices of their wrenches in the sensor data
        self._wrench_indices = np.add.outer(np.array(first, dtype=int), np.arange(6))

    def _find_guides(self, faces: Faces) -> None:
        """Find the coordinates of the joints that guide bodies of the environment.

        Args:
            faces: bodies and their rails.
        """
        self.guided = guided_joints(faces.rails)
        guides = [f"face{i}/{GUIDES[k]}" for i, k in zip(*self.guided, strict=True)]
        #: indices of the guides of moving bodies in qvel; `face_q` those in qpos
        self.face_q, self._face_v = self._coordinates(guides)
        by_drive = np.isin(self.guided[0], list(faces.driven))
        #: bodies and axes of the guides with a prescribed motion
        self._driven_guides = tuple(x[by_drive] for x in self.guided)
        self._driven_q = self.face_q[by_drive]  #: indices of these guides in qpos
        self._driven_v = self._face_v[by_drive]  #: indices of these guides in qvel

    def _connect(
        self, model: MjModel, chain: ClosedChain, contacts: Sequence[ContactPair], faces: Faces
    ) -> None:
        """Make the state of a compiled scene, and views of the arrays that each step uses.

        Args:
            model: compiled scene.
            chain: the true arms.
            contacts: contact pairs.
            faces: bodies of the environment.
        """
        import mujoco

        self._mj: ModuleType = mujoco  #: module `mujoco`
        self.model = model
        self.data: MjData = mujoco.MjData(model)
        self.chain = chain
        self.contacts = tuple(contacts)
        self.faces = faces
        self._qpos = self.data.qpos  #: view of MuJoCo's positions
        self._qvel = self.data.qvel  #: view of MuJoCo's velocities
        self._sensordata = self.data.sensordata  #: view of MuJoCo's sensor data
        self._ctrl = self.data.ctrl  #: view of the motor torques (N m, N)
        #: view of the numbers of MuJoCo's warnings, by kind
        self._warnings = self.data.warning.number
        self._option = model.opt  #: MuJoCo's options
        self._step = model.opt.timestep  #: time step (s)
        self._flags = model.opt.disableflags  #: disabled parts of a step
        #: disabled parts of a step whose sensors are not read
        self._flags_without_sensors = self._flags | int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
        self.time = 0.0

    def _coordinates(self, joints: Sequence[str]) -> tuple[Array, Array]:
        """Indices of joints in qpos and in qvel.

        Args:
            joints: names of the joints.
        """
        ids = np.array([self.model.joint(name).id for name in joints], dtype=int)
        return self.model.jnt_qposadr[ids], self.model.jnt_dofadr[ids]

    def reset(self, q: Array) -> None:
        """Start at rest at joint positions q (n,) at which loops are closed and contacts touch."""
        q = as_array("q", q, (self.chain.nq,))
        self._mj.mj_resetData(self.model, self.data)
        self._qpos[self._q] = q
        self._set_grasp_joint(q)
        self.time = 0.0
        self.faces.reset()
        self.data.qfrc_applied[self._face_v] = [self.faces.rails[i].preload for i in self.guided[0]]
        self._set_driven_faces(0.0)
        self._mj.mj_forward(self.model, self.data)

    def _set_grasp_joint(self, q: Array) -> None:
        """Set the joint of the first grasp, if it has one, so that the others hold the object, too.

        Args:
            q: (n,) joint positions of the arms (rad, m).
        """
        grasp = self.chain.grasps[0]
        if grasp.is_rigid:
            return
        X_WO = object_pose(self.chain, q)  # and the chain's placements, which tip_poses reads
        R = (self.chain.tip_poses()[0] * grasp.X_TO).rotation.T @ X_WO.rotation
        joint = self.data.joint(GRASP_JOINT)
        if grasp.kind == "ball":
            joint.qpos = placed(pin.SE3(R, np.zeros(3)))["quat"]
        else:
            joint.qpos = pin.log3(R) @ self.model.joint(GRASP_JOINT).axis

    def hold(self, tau: Array) -> None:
        """Apply torques from now on without letting time pass.

        Springs get the deflection that these torques cause, and motors move accordingly, so that
        the links stay in place; the motors' errors have not deflected them yet, as friction holds
        motors at rest.

        Args:
            tau: (n_a,) torques (N m, N).
        """
        self._send(tau)
        if self.drives.flexible is not None:
            motors = self._q[self.chain.actuated]
            links = self._qpos[motors] + self._qpos[self._springs]
            deflection = -as_array("tau", tau, self._ctrl.shape) / self.drives.flexible.stiffness
            self._qpos[motors] = links - deflection
            self._qpos[self._springs] = deflection
        self._mj.mj_forward(self.model, self.data)

    def _send(self, tau: Array) -> None:
        """Write motor torques to MuJoCo's controls, with the motors' errors if these are modelled.

        Args:
            tau: (n_a,) torques (N m, N).
        """
        is_valid = type(tau) is np.ndarray and tau.shape == self._ctrl.shape
        if not (is_valid and isfinite(tau.dot(tau))):  # this test is faster than the conversion
            tau = as_array("tau", tau, self._ctrl.shape)
        if self.drives.motors is not None:
            tau = self.drives.motors.torque(tau, self._qpos[self._q[self.chain.actuated]])
        self._ctrl[:] = tau

    def readings(self, qpos: Array, qvel: Array, sensed: Array) -> tuple[Array, Array, Array]:
        """Readings of encoders and wrists, of one plant or of the rows of a batch.

        Args:
            qpos, qvel, sensed: (…, m) MuJoCo's positions, velocities and sensor data.

        Returns:
            q, v (…, n) and wrenches (…, arms, 6), zero where an arm has no sensor.
        """
        q = self._link_values(qpos, self._q, self._springs)
        v = self._link_values(qvel, self._v, self._spring_v)
        return q, v, self._wrenches(sensed)

    def _wrenches(self, sensed: Array) -> Array:
        """Readings (…, arms, 6) of the wrists, zero where an arm has no sensor.

        Args:
            sensed: (…, m) MuJoCo's sensor data.
        """
        measured: Array = sensed.take(self._wrench_indices, axis=-1)
        if len(self._sensed_arms) == len(self.chain.arms):
            return measured
        wrenches = np.zeros((*sensed.shape[:-1], len(self.chain.arms), 6))
        wrenches[..., self._sensed_arms, :] = measured
        return wrenches

    def _link_values(self, x: Array, joints: Array, springs: Array) -> Array:
        """Positions or velocities (…, n) of the links: those of the motors plus the springs'.

        Args:
            x: (…, m) MuJoCo's positions or velocities.
            joints: (n,) indices of the joints.
            springs: (n_a,) indices of the springs; empty: stiff joints.
        """
        links: Array = x.take(joints, axis=-1)
        if len(springs):
            links[..., self.chain.actuated] += x[..., springs]
        return links

    def reading(self, name: str) -> Array:
        """Reading of one kind of sensor at present, as `measure` has it.

        Args:
            name: "q" (n,), "wrenches" (arms, 6) or "joint_torques" (n_a,).
        """
        if name == "q":
            return self._link_values(self._qpos, self._q, self._springs)
        if name == "wrenches":
            return self._wrenches(self._sensordata)
        return self._joint_torques()

    def _joint_torques(self) -> Array:
        """Readings (n_a,) of the joint torque sensors (N m, N): of springs, or of stiff motors."""
        flexible = self.drives.flexible
        if flexible is None:
            return self._ctrl.copy()
        deflection = self._qpos[self._springs]
        return -flexible.stiffness * deflection - flexible.damping * self._qvel[self._spring_v]

    def measure(self) -> Measurement:
        """Read encoders after the last step, and wrenches at its beginning (one step old)."""
        q, v, wrenches = self.readings(self._qpos, self._qvel, self._sensordata)
        faces = self.faces
        if len(self.face_q):
            faces.drive(self.time)
            faces.s[self.guided] = self._qpos[self.face_q]
            faces.rates[self.guided] = self._qvel[self._face_v]
        return Measurement(q, v, wrenches, faces.touched(), self._joint_torques())

    def _set_driven_faces(self, t: float) -> None:
        """Set the state of driven faces at time t (s), and the force that accelerates them."""
        faces = self.faces
        faces.drive(t)
        bodies, axes = self._driven_guides
        s, rates, second = faces.state[:, bodies, axes]
        self._qpos[self._driven_q] = s
        self._qvel[self._driven_v] = rates
        self.data.qfrc_applied[self._driven_v] = DRIVE_MASS * second

    def truth(self) -> Truth:
        """True state at the beginning of the last step, the instant of the wrist readings."""
        log = self.log()
        log.note()
        return log.truths(log.noted())[0]

    def poses(self) -> Array:
        """True poses (1 + arms, 4, 4) of object and tips at the beginning of the last step."""
        X = np.tile(np.eye(4), (len(self._posed_bodies), 1, 1))
        X[:, :3, :3] = self.data.xmat[self._posed_bodies].reshape(-1, 3, 3)
        X[:, :3, 3] = self.data.xpos[self._posed_bodies]
        X @= self.place.homogeneous
        return X

    def log(self) -> MujocoTruth:
        """New, empty record of the truth."""
        return MujocoTruth(self)

    def command(self, tau: Array, duration: float) -> None:
        """Hold torques for a control period.

        Moving faces are set before each step. Without them all steps but the last are made in one
        call, without sensors.

        Args:
            tau: (n_a,) motor torques (N m, N).
            duration: period (s), rounded to whole steps.

        Raises:
            PlantError: MuJoCo has warned: the simulation diverged.
        """
        require_duration(duration)
        self._send(tau)
        if self.pushes:
            self.data.xfrc_applied[:] = 0.0
            for push in self.pushes:
                self._apply_push(push, push.at(self.time))
        steps = self.steps_in(duration)
        if self.faces.driven:
            for k in range(steps):
                self._set_driven_faces(self.time + k * self._step)
                self._mj.mj_step(self.model, self.data)
        else:
            if steps > 1:  # readings in between are not used
                self._option.disableflags = self._flags_without_sensors
                self._mj.mj_step(self.model, self.data, steps - 1)
                self._option.disableflags = self._flags
            self._mj.mj_step(self.model, self.data)
        self.time += steps * self._step
        # MuJoCo counts its warnings by kind, such as accelerations that are not finite
        if any(self._warnings.tolist()):
            warnings = [self._mj.mjtWarning(i).name for i in np.flatnonzero(self._warnings)]
            raise PlantError(
                f"MuJoCo diverged at t = {self.time:.4f} s ({', '.join(warnings)}); largest speed "
                f"{np.abs(self._qvel).max():.3g}. Lower the gains or the plant step."
            )

    def stop(self, reason: str = "") -> None:
        """Accept a stop; a simulation needs no action, because torques have been commanded."""

    @property
    def steps_alone(self) -> bool:
        """Whether MuJoCo's steps need no further code: no moving faces, motor errors, pushes."""
        return not (self.faces.moving or self.pushes or self.drives.motors is not None)

    def steps_in(self, period: float) -> int:
        """Number of MuJoCo's steps in a control period (s)."""
        return round(period / self._step) or 1

    def _apply_push(self, push: Push, force: Array) -> None:
        """Apply a disturbance at the wrist sensor of an arm.

        Args:
            push: disturbance, which names the arm.
            force: (3,) present force in world axes (N).
        """
        sensor = self.model.site(f"{push.arm}/wrist")
        body = int(self.model.body_parentid[int(sensor.bodyid[0])])
        lever = self.data.site_xpos[sensor.id] - self.data.xipos[body]
        self.data.xfrc_applied[body, :3] += force
        self.data.xfrc_applied[body, 3:] += cross(lever, force)
