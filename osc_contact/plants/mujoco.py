"""The judging plant: MuJoCo with unilateral contacts, built from the same URDFs as the model.

Nothing of the toolkit's dynamics is used here: the URDFs are read by MuJoCo's own parser, the rod
hangs on the first arm's gripper, further arms hold it by welds, and the faces are plates whose
contact is soft enough not to chatter.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact.contacts.pairs import VertexOnFace
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.errors import PlantError
from osc_contact.interface import Measurement
from osc_contact.plants.joint_drives import SPRING, JointDrives, add_drives
from osc_contact.plants.plant import Truth
from osc_contact.spatial import Array, as_array

__all__ = ["MujocoOptions", "MujocoPlant"]

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class MujocoOptions:
    """Integration step (s), contact softness and Coulomb friction of the faces."""

    step: float = 2.5e-4
    solref: tuple[float, float] = (0.01, 1.0)
    solimp: tuple[float, float, float] = (0.2, 0.9, 0.0005)
    friction: float = 0.0


class MujocoPlant:
    """Arms, object and faces in MuJoCo (needs the extra `sim`)."""

    def __init__(
        self,
        chain: ClosedChain,
        arm_urdfs: Sequence[Path],
        object_urdf: Path,
        contacts: Sequence[VertexOnFace],
        face_urdfs: Sequence[Path],
        options: MujocoOptions | None = None,
        drives: JointDrives | None = None,
    ) -> None:
        """Compile the scene.

        Args:
            chain: the true arms and grasps; only names, frames and poses are taken from it.
            arm_urdfs: one file for each arm. object_urdf: the held object.
            contacts: where the faces are. face_urdfs: what each face looks like.
            options: step, softness, friction.
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
        mujoco.set_mju_user_warning(_log.debug)  # counted below; no MUJOCO_LOG.TXT is written
        self.chain = chain
        self.contacts = tuple(contacts)
        options = MujocoOptions() if options is None else options
        self.drives = JointDrives() if drives is None else drives
        try:
            spec = _scene(mujoco, chain, arm_urdfs, object_urdf, contacts, face_urdfs, options)
            driven = [chain.joint_names[j] for j in chain.actuated]
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
        roots = [int(self.model.body(f"face{i}/root").id) for i in range(len(contacts))]
        self._faces = [self._plates_of(root) for root in roots]
        self._sensors = [
            None if arm.wrist_sensor is None else int(self.model.sensor(f"{arm.name}/force").adr[0])
            for arm in chain.arms
        ]  # fmt: skip
        self.time = 0.0

    def reset(self, q: Array) -> None:
        """Start at rest at joint positions q (n,); loops and gaps must fit."""
        q = as_array("q", q, (self.chain.nq,))
        self._mj.mj_resetData(self.model, self.data)
        self.data.qpos[self._q] = q
        self._mj.mj_forward(self.model, self.data)
        self.time = 0.0

    def hold(self, tau: Array) -> None:
        """Apply torques from now on; time stands still."""
        self._command(tau)
        if self.drives.flexible is not None:  # springs wound up, motors where that puts them
            q = self._joints(self.data.qpos, self._q, self._springs)[self.chain.actuated]
            wound = -self.data.ctrl / self.drives.flexible.stiffness
            self.data.qpos[self._springs] = wound
            self.data.qpos[self._q[self.chain.actuated]] = q - wound
        self._mj.mj_forward(self.model, self.data)

    def _command(self, tau: Array) -> None:
        tau = as_array("tau", tau, (self.chain.n_a,))
        if self.drives.motors is not None:
            tau = self.drives.motors.torque(tau, self.data.qpos[self._q[self.chain.actuated]])
        self.data.ctrl[:] = tau

    def _joints(self, x: Array, joints: Array, springs: Array) -> Array:
        """Positions or velocities (n,) of the links: what the motors do, plus the springs."""
        links: Array = x[joints]
        if len(springs):
            links[self.chain.actuated] += x[springs]
        return links

    def _joint_torques(self) -> Array:
        """(n_a,) what the torque sensors feel: the springs, or the motors themselves."""
        flexible = self.drives.flexible
        if flexible is None:
            return self.data.ctrl.copy()
        wound, rate = self.data.qpos[self._springs], self.data.qvel[self._spring_v]
        return -flexible.stiffness * wound - flexible.damping * rate

    def measure(self) -> Measurement:
        """Encoders after the last step, wrist wrenches as of its beginning (one step old)."""
        wrenches = np.zeros((len(self._sensors), 6))
        for i, start in enumerate(self._sensors):
            if start is not None:
                wrenches[i] = self.data.sensordata[start : start + 6]
        q = self._joints(self.data.qpos, self._q, self._springs)
        v = self._joints(self.data.qvel, self._v, self._spring_v)
        return Measurement(q, v, wrenches, joint_torques=self._joint_torques())

    def truth(self) -> Truth:
        """Contact forces, pose and twist as of the last step's beginning, like the wrenches."""
        alpha = np.zeros(len(self._faces))
        closed = np.zeros(len(self._faces), dtype=bool)
        wrench = np.zeros(6)
        for k in range(self.data.ncon):
            pair = self.data.contact[k].geom
            for i, plates in enumerate(self._faces):
                if pair[0] in plates or pair[1] in plates:
                    self._mj.mj_contactForce(self.model, self.data, k, wrench)
                    alpha[i] += wrench[0]
                    closed[i] |= self.data.contact[k].efc_address >= 0
        rotation = self.data.xmat[self._object].reshape(3, 3)
        X_WO = pin.SE3(rotation.copy(), self.data.xpos[self._object].copy())
        V = np.zeros(6)
        body = self._mj.mjtObj.mjOBJ_XBODY
        self._mj.mj_objectVelocity(self.model, self.data, body, self._object, V, 0)
        return Truth(alpha, closed, X_WO, np.concatenate((V[3:], V[:3])))

    def step(self, tau: Array, duration: float) -> None:
        """Hold the torques over the steps that fit into `duration`."""
        self._command(tau)
        steps = max(1, round(duration / self.model.opt.timestep))
        self._mj.mj_step(self.model, self.data, steps)
        self.time += steps * self.model.opt.timestep
        if self.data.warning.number.any() or not np.isfinite(self.data.qacc).all():
            kinds = [
                self._mj.mjtWarning(i).name for i in np.flatnonzero(self.data.warning.number)
            ]  # fmt: skip
            raise PlantError(
                f"MuJoCo diverged at t = {self.time:.4f} s ({', '.join(kinds)}); largest speed "
                f"{np.abs(self.data.qvel).max():.3g}. Lower the gains or the plant step."
            )

    def _plates_of(self, root: int) -> set[int]:
        """Geoms of the face's body and of the bodies fixed to it."""
        bodies = {root}
        for body in range(root + 1, self.model.nbody):
            if int(self.model.body_parentid[body]) in bodies:
                bodies.add(body)
        return {g for g in range(self.model.ngeom) if int(self.model.geom_bodyid[g]) in bodies}


def _scene(
    mujoco: Any,
    chain: ClosedChain,
    arm_urdfs: Sequence[Path],
    object_urdf: Path,
    contacts: Sequence[VertexOnFace],
    face_urdfs: Sequence[Path],
    options: MujocoOptions,
) -> Any:
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.compiler.fusestatic = False
    spec.option.timestep = options.step
    spec.option.tolerance = 1e-12
    spec.option.iterations = 100
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    for arm, urdf in zip(chain.arms, arm_urdfs, strict=True):
        part = mujoco.MjSpec.from_file(str(urdf))
        part.compiler.fusestatic = False
        _silence(part)
        driven = set(list(arm.model.names)[1:])
        for joint in list(part.joints):
            if joint.name not in driven:
                part.delete(joint)
        spec.attach(part, prefix=f"{arm.name}/", frame=_frame(spec.worldbody, arm.base))
        if arm.wrist_sensor is not None:
            _wrist_sensor(mujoco, spec, arm.name, arm.wrist_sensor)
    for index in chain.actuated:
        name = chain.joint_names[index]
        limit = float(chain.model.upperEffortLimit[index])
        motor = spec.add_actuator(
            name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT, ctrlrange=[-limit, limit]
        )
        motor.set_to_motor()
    _hold_object(mujoco, spec, chain, object_urdf)
    for i, (pair, urdf) in enumerate(zip(contacts, face_urdfs, strict=True)):
        _face(mujoco, spec, i, pair, urdf, options)
    return spec


def _silence(part: Any) -> None:
    """Robot links touch nothing: only the object meets the faces."""
    for geom in part.geoms:
        geom.contype = geom.conaffinity = 0


def _frame(body: Any, X: pin.SE3) -> Any:
    x, y, z, w = pin.Quaternion(X.rotation).coeffs()
    return body.add_frame(pos=X.translation, quat=[w, x, y, z])


def _wrist_sensor(mujoco: Any, spec: Any, arm: str, frame: str) -> None:
    spec.body(f"{arm}/{frame}").add_site(name=f"{arm}/wrist")
    for kind in ("force", "torque"):
        spec.add_sensor(
            name=f"{arm}/{kind}",
            type=getattr(mujoco.mjtSensor, f"mjSENS_{kind.upper()}"),
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            objname=f"{arm}/wrist",
        )


def _hold_object(mujoco: Any, spec: Any, chain: ClosedChain, urdf: Path) -> None:
    """The object rides on the first arm; welds tie it to the others."""
    part = mujoco.MjSpec.from_file(str(urdf))
    part.compiler.fusestatic = False
    for geom in part.geoms:
        geom.contype, geom.conaffinity = 0, 1
    root = part.worldbody.first_body()
    root.name = "root"
    root.add_site(name="held")
    first = chain.arms[0]
    spec.attach(
        part,
        prefix="object/",
        frame=_frame(spec.body(f"{first.name}/{first.tip}"), chain.grasps[0]),
    )
    for arm, X_TO in zip(chain.arms[1:], chain.grasps[1:], strict=True):
        x, y, z, w = pin.Quaternion(X_TO.rotation).coeffs()
        spec.body(f"{arm.name}/{arm.tip}").add_site(
            name=f"{arm.name}/hold", pos=X_TO.translation, quat=[w, x, y, z]
        )
        spec.add_equality(
            name=f"{arm.name}/weld",
            type=mujoco.mjtEq.mjEQ_WELD,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            name1=f"{arm.name}/hold",
            name2="object/held",
            solref=[2 * spec.option.timestep, 1.0],
            solimp=[0.9999, 0.9999, 0.001, 0.5, 2.0],
            data=[0.0] * 10 + [1.0, 0.0],  # torque scale of the weld
        )


def _face(
    mujoco: Any, spec: Any, i: int, pair: VertexOnFace, urdf: Path, options: MujocoOptions
) -> None:
    part = mujoco.MjSpec.from_file(str(urdf))
    part.compiler.fusestatic = False
    part.worldbody.first_body().name = "root"
    for geom in part.geoms:
        geom.contype, geom.conaffinity = 1, 0
        geom.priority = 1
        geom.solref = list(options.solref)
        geom.solimp = [*options.solimp, 0.5, 2.0]
        geom.condim = 1 if options.friction == 0.0 else 3
        geom.friction = [options.friction, 0.0, 0.0]
    spec.attach(part, prefix=f"face{i}/", frame=_frame(spec.worldbody, pair.face_placement()))
