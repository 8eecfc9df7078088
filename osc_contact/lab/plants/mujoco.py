"""The judging plant: MuJoCo with unilateral contacts, built from the same URDFs as the model."""

from __future__ import annotations

import ctypes
import logging
from collections.abc import Sequence
from functools import lru_cache
from itertools import product
from math import isfinite
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from osc_contact.contacts.pairs import ContactPair
from osc_contact.contacts.pairs.law_pair import normals_over
from osc_contact.contacts.pairs.pair import pushes_only
from osc_contact.dynamics.arm import Arm
from osc_contact.dynamics.assembly import object_pose
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.dynamics.environment import Rail
from osc_contact.dynamics.grasp import Grasp
from osc_contact.errors import PlantError, missing
from osc_contact.interface import Measurement
from osc_contact.lab.plants.faces import Faces
from osc_contact.lab.plants.joint_drives import SPRING, JointDrives, add_drives, set_dry_friction
from osc_contact.lab.scenarios.hardware import PlantSpec, Push
from osc_contact.loop.judge import Truth, Truths, require_duration
from osc_contact.robots import is_mjcf
from osc_contact.robots.mjcf import mjcf_skeleton, placed, weld_joints
from osc_contact.spatial import Array, Poses, as_array, cross

# --- The MuJoCo model of a rig --------------------------------------------------------------------
#
# The object hangs on the first arm's gripper, welded or by a joint of the grasp's kind; equality
# constraints tie it to the others: a weld, one point (ball) or two points of an axis (hinge). Up to
# 3.13 MuJoCo's force sensors count the torque of a weld in the axes of its site; three points are
# tied there in its place. Only the object and the bodies of the environment touch, with the
# collision geometry of their URDFs and soft enough not to chatter. Rotor inertia, damping and
# friction of the joints are the chain's.

#: The joint between the first arm's tip and the object, if its grasp is a hinge or a ball.
GRASP_JOINT = "object/grasp"
#: Distance of the points that make a hinge, or a weld, from the tip's origin (m).
TIE_SPAN = 0.05

#: Heavy enough that no contact force moves a driven face between two steps (kg, kg m²).
DRIVE_MASS = 1e6
WELDS = 3014000  #: version of MuJoCo from which on sensors feel welds as they are
GUIDES = ("slide", "hinge")  #: joints of a body that moves
_LEAST_INERTIA = 1e-9  # kg, kg m²: MuJoCo needs mass in moving bodies
OBJECT = -1  #: of `MujocoPlant.body_of`
OTHER = -2


def scene(
    chain: ClosedChain,
    arm_urdfs: Sequence[Path],
    object_urdf: Path,
    bodies: Sequence[tuple[Path, pin.SE3]],
    options: PlantSpec,
    rails: Sequence[Rail],
) -> Any:
    """The uncompiled specification, see `MujocoPlant`.

    Args:
        chain: of the arms. arm_urdfs, object_urdf: their files.
        bodies: URDF and pose of each body touched. options: of the plant.
        rails: how each body moves.
    """
    import mujoco

    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.compiler.fusestatic = False
    spec.option.timestep = options.step
    spec.option.tolerance = 1e-12
    spec.option.iterations = 100
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    off = mujoco.mjtDisableBit
    disabled = off.mjDSBL_AUTORESET | off.mjDSBL_MIDPHASE  # few geometries, all looked at
    if not any(rail.joints for rail in rails):  # all that is constrained hangs together
        disabled |= off.mjDSBL_ISLAND
    spec.option.disableflags = int(disabled)
    for arm, file in zip(chain.arms, arm_urdfs, strict=True):
        frame = spec.worldbody.add_frame(**placed(arm.base))
        spec.attach(_arm(arm, file), prefix=f"{arm.name}/", frame=frame)
        for kind in ("force", "torque") if arm.wrist_sensor is not None else ():
            spec.add_sensor(
                name=f"{arm.name}/{kind}",
                type=getattr(mujoco.mjtSensor, f"mjSENS_{kind.upper()}"),
                objtype=mujoco.mjtObj.mjOBJ_SITE,
                objname=f"{arm.name}/wrist",
            )
    model = chain.model
    for i, name in enumerate(chain.joint_names):
        joint = spec.joint(name)
        joint.armature = model.armature[i]
        joint.damping = np.resize([model.damping[i], 0.0, 0.0], np.shape(joint.damping))
        set_dry_friction(joint, model.upperDryFrictionLimit[i], options.step)
    for actuated in chain.actuated:
        name = chain.joint_names[actuated]
        limit = model.upperEffortLimit[actuated]
        motor = spec.add_actuator(
            name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT, ctrlrange=[-limit, limit]
        )
        motor.set_to_motor()
    _hold_object(spec, chain, object_urdf)
    for i, ((file, placement), rail) in enumerate(zip(bodies, rails, strict=True)):
        part, root = _read_body(file)
        for geom in part.geoms:
            geom.contype = 1
            geom.conaffinity = 0
            geom.priority = 1
            geom.solref = list(options.solref)
            geom.solimp = [*options.solimp, 0.5, 2.0]
            geom.condim = 1 if options.friction == 0.0 else 3
            geom.friction = [options.friction, 0.0, 0.0]
        if rail.joints:
            _put_on_rail(part, root, placement, rail)
        frame = spec.worldbody.add_frame(**placed(placement))
        spec.attach(part, prefix=f"face{i}/", frame=frame)
    if options.friction > 0.0:
        _add_friction(spec, options)
    return spec


def _arm(arm: Arm, file: Path) -> Any:
    """An arm without shapes and losses, locked joints welded, a site where its wrist sensor is."""
    import mujoco

    if is_mjcf(file):
        return mjcf_skeleton(file, arm.tip, arm.wrist_sensor, arm.locked)
    part = mujoco.MjSpec.from_string(_without_shapes(file.read_bytes()))
    part.compiler.fusestatic = False
    weld_joints(part, arm.locked)
    if arm.wrist_sensor is not None:
        part.body(arm.wrist_sensor).add_site(name="wrist")
    return part


@lru_cache(maxsize=32)
def _without_shapes(urdf: bytes) -> str:
    """A robot's URDF without shapes, which may be meshes, and without losses in its joints."""
    root = ElementTree.fromstring(urdf)
    for element in root.iter():
        for tag in ("visual", "collision", "dynamics"):
            for child in element.findall(tag):
                element.remove(child)
    return ElementTree.tostring(root, encoding="unicode")


def _read_body(urdf: Path) -> tuple[Any, Any]:
    """The specification of one body, and its root."""
    import mujoco

    part = mujoco.MjSpec.from_file(str(urdf))
    part.compiler.fusestatic = False
    root = part.worldbody.first_body()
    root.name = "root"
    return part, root


def _hold_object(spec: Any, chain: ClosedChain, urdf: Path) -> None:
    """The object rides on the first arm; equality constraints tie it to the others."""
    import mujoco

    for arm, grasp in zip(chain.arms, chain.grasps, strict=True):
        if grasp.kind == "other":
            raise PlantError(
                f"arm '{arm.name}': MuJoCo is given rigid, hinge and ball grasps only; "
                "use the rigid plant"
            )
    part, root = _read_body(urdf)
    for geom in part.geoms:
        geom.contype = 0
        geom.conaffinity = 1
    assert chain.payload is not None
    inertia = chain.payload.inertia
    if inertia.mass != root.mass:  # the chain's object is not the one of the file
        I = inertia.inertia  # noqa: E741 - the field's letter
        root.explicitinertial = True
        root.mass = inertia.mass
        root.ipos = inertia.lever
        root.iquat = [1.0, 0.0, 0.0, 0.0]
        root.fullinertia = [*np.diag(I), I[0, 1], I[0, 2], I[1, 2]]
    first = chain.grasps[0]
    if not first.is_rigid:
        root.add_joint(
            name="grasp",
            type=getattr(mujoco.mjtJoint, f"mjJNT_{first.kind.upper()}"),
            pos=first.X_TO.inverse().translation,
            axis=[0, 0, 1] if first.kind == "ball" else first.X_TO.rotation.T @ first.T[3:, 0],
        )
    tips = [spec.body(f"{arm.name}/{arm.tip}") for arm in chain.arms]
    spec.attach(part, prefix="object/", frame=tips[0].add_frame(**placed(first.X_TO)))
    held = spec.body("object/root")
    for arm, tip, grasp in list(zip(chain.arms, tips, chain.grasps, strict=True))[1:]:
        points = _tie_points(grasp)
        poses = [pin.SE3(np.eye(3), point) for point in points] or [grasp.X_TO]
        for k, X in enumerate(poses):
            name = f"{arm.name}/tie.{k}"
            tip.add_site(name=name, **placed(X))
            held.add_site(name=f"object/{name}", **placed(grasp.X_TO.actInv(X)))
            tie = spec.add_equality(
                name=name,
                type=mujoco.mjtEq.mjEQ_CONNECT if points else mujoco.mjtEq.mjEQ_WELD,
                objtype=mujoco.mjtObj.mjOBJ_SITE,
                name1=name,
                name2=f"object/{name}",
                solref=[2 * spec.option.timestep, 1.0],
                solimp=[0.9999, 0.9999, 0.001, 0.5, 2.0],
            )
            if not points:
                tie.data = np.eye(len(tie.data))[10]  # of 11 or 12, by version: its torque scale


def _tie_points(grasp: Grasp) -> list[Array]:
    """Points of the tip frame that stay together in a hinge or a ball; none: a weld."""
    import mujoco

    if grasp.is_rigid:
        return [] if mujoco.mj_version() >= WELDS else list(TIE_SPAN * np.eye(3))
    if grasp.kind == "ball":
        return [np.zeros(3)]
    axis = grasp.T[3:, 0]
    return [TIE_SPAN * axis, -TIE_SPAN * axis]


_IMPEDANCE = 0.03  #: MuJoCo's d of contacts with friction, at `width`
_FRICTION_IMPEDANCE = 0.9  #: d of the friction itself
#: 1/s, of slip: friction is whole from μ f/(9 m · 1000/s) on, and turns back 1 ms before the slip.
_FRICTION_DAMPING = 1e3


def _add_friction(spec: Any, options: PlantSpec) -> None:
    """Coulomb friction between the object's geometries and those of all bodies.

    MuJoCo's cone couples slip and normal force: what slides at v rests higher by μ b v/(d k), d the
    impedance, k and b the reference stiffness and damping. With `solref` and `solimp` as they are
    that is more than the depth of light contacts: they chatter, and are struck where a motion turns
    back. Spring d²k/(1 − d) and damper d b/(1 − d), both for a unit of mass, are as declared here,
    but made by a small d and a large k, and friction has a damping and an impedance apart.
    """
    time, ratio = options.solref
    low, high, width = options.solimp
    most = _IMPEDANCE

    def root(d: float) -> float:
        """Of the spring, d/√(1 − d)."""
        return d / np.sqrt(1.0 - d)

    share = most / root(high)
    power = 1.0
    if low != high:  # of the curve between them, by its middle
        power = -np.log2((root(0.5 * (low + high)) - root(low)) / (root(high) - root(low)))
    fastest = 1.0 / spec.option.timestep  # no damper stops a motion within less than a step
    damping = min(2.0 / time * (1.0 - most) / (1.0 - high), fastest)
    stiffness = (1.0 - most) / ((1.0 - high) * (time * ratio) ** 2)
    friction = _FRICTION_IMPEDANCE / (1.0 - _FRICTION_IMPEDANCE)
    spec.option.impratio = friction * (1.0 - most) / most
    for i, geom in enumerate(spec.geoms):
        geom.name = geom.name or f"geom{i}"
    held = [geom.name for geom in spec.geoms if geom.conaffinity and not geom.contype]
    touched = [geom.name for geom in spec.geoms if geom.contype and not geom.conaffinity]
    for first, second in product(held, touched):
        pair = spec.add_pair(geomname1=first, geomname2=second)
        pair.condim = 3
        pair.friction = [options.friction, options.friction, 0.0, 0.0, 0.0]
        pair.solref = [-stiffness, -damping]
        pair.solimp = [share * root(low), most, width, 1.0, power]
        pair.solreffriction = [-1e-9, -min(_FRICTION_DAMPING, fastest) * most]


def _put_on_rail(part: Any, root: Any, X_WB: pin.SE3, rail: Rail) -> None:
    """A slide, a hinge or both, whose inertia is all there is: a cart's weighs, others' does not.

    It sits in the joints (armature), where a slide and a hinge do not act on one another.
    """
    import mujoco

    driven = rail.motion is not None
    for body in part.bodies[1:]:  # links fixed to the body weigh nothing beside it
        body.explicitinertial = True
        body.fullinertia = [np.nan] * 6  # not given
        body.mass = 0.0
        body.inertia = [0.0] * 3
    cart = not driven and rail.joints == [0]
    root.mass = rail.inertia if cart else _LEAST_INERTIA
    root.inertia = [root.mass] * 3
    for k in rail.joints:
        root.add_joint(
            name=GUIDES[k],
            type=getattr(mujoco.mjtJoint, f"mjJNT_{GUIDES[k].upper()}"),
            pos=X_WB.actInv(rail.through) if k else [0.0] * 3,
            axis=X_WB.rotation.T @ (rail.axis if k else rail.direction),
            armature=DRIVE_MASS if driven else 0.0 if cart else rail.inertia,
            stiffness=0.0 if driven else rail.stiffness,
            damping=0.0 if driven else rail.damping,
        )


# --- True state of object and contacts: noted raw, worked out afterwards --------------------------

#: Of what the body takes. One that only seems to touch gets 1e-17 … 1e-7, by rounding and by the
#: places of the points; one that does, 1e-3 and more.
_PRESSES = 1e-5


class MujocoTruth:
    """Pose, twist and contact forces as of the last step's beginning, like the wrench sensors.

    The normal forces of all points where the object touches one body make one wrench, which the
    columns of the contacts on that body share: exactly, as far as it lies in their range.
    """

    def __init__(self, plant: MujocoPlant) -> None:
        """Watch a plant; cones are elliptic: a contact's first constraint force is its normal's."""
        self._plant = plant
        data = plant.data
        body = plant.object_body
        root = plant.model.body_rootid[body]
        self._parts = (
            data.xpos[body],
            data.xmat[body],
            data.cvel[body],
            data.subtree_com[root],
        )
        inertia = plant.chain.reference_inertia(pin.SE3.Identity())
        self._root = np.linalg.cholesky(np.linalg.inv(inertia)).T  #: Φ = rootᵀ root
        self._seen = -1
        self._states: list[Array] = []
        self._points: list[Array] = []

    def note(self) -> None:
        """Keep where the object and bodies on rails are, and each contact with its force."""
        data = self._plant.data
        self._states.append(np.concatenate((*self._parts, data.qpos.take(self._plant.face_q))))
        if data.ncon != self._seen:  # contacts stand at the start of MuJoCo's arena at every step
            contact = data.contact
            self._seen = data.ncon
            self._address = contact.efc_address[:, None]
            self._contact = contact.geom, self._address, contact.pos, contact.frame[:, :3]
        force = data.efc_force
        normal = force.take(self._address) if len(force) else np.zeros((self._seen, 1))
        self._points.append(np.concatenate((*self._contact, normal), axis=1))

    def noted(self, start: int = 0) -> Array:
        """(k, m): R, p and twist of the object, where bodies on rails are, and of each body

        the wrench into it at O and whether it is touched.
        """
        p, R, velocity, centre, travelled = np.split(
            np.array(self._states[start:]).T, [3, 12, 18, 21]
        )
        R = R.reshape(3, 3, -1)
        place = self._plant.place
        p = p + np.einsum("ijk,j->ik", R, place.translation)
        R = np.einsum("ijk,jl->ilk", R, place.rotation)
        omega = velocity[:3]
        v = velocity[3:] + cross(omega, p - centre)
        parts = (R.reshape(9, -1), p, v, omega, travelled, *self._wrenches(p, start))
        return np.concatenate(parts).T

    def _wrenches(self, O: Array, start: int) -> tuple[Array, Array]:  # noqa: E741
        """Into each body: (6 bodies, k) at O (3, k), and whether it is touched (bodies, k)."""
        k = O.shape[1]
        bodies = len(self._plant.faces.rails)
        pushed = np.zeros((bodies, k, 6))
        touched = np.zeros((bodies, k))
        counts = [len(one) for one in self._points[start:]]
        points = np.concatenate(self._points[start:])
        between = self._plant.body_of[points[:, :2].astype(int)]
        here = (between.min(axis=1) == OBJECT) & (between.max(axis=1) >= 0)
        points = points[here]
        tick = np.repeat(np.arange(k), counts)[here]
        body = between[here].max(axis=1)
        presses = points[:, 2] >= 0.0
        # the normal points from the first geom to the second
        sign = np.where(between[here, 0] == OBJECT, 1.0, -1.0)
        f = np.where(presses, sign * points[:, 9], 0.0) * points[:, 6:9].T
        moment = cross(points[:, 3:6].T - O[:, tick], f)
        np.add.at(pushed, (body, tick), np.concatenate((f, moment)).T)
        np.logical_or.at(touched, (body, tick), presses)
        return pushed.transpose(0, 2, 1).reshape(-1, k), touched

    def clear(self) -> None:
        """Forget the instants noted so far."""
        self._states.clear()
        self._points.clear()

    def truths(self, noted: Array) -> Truths:
        """See `TruthLog.truths`."""
        plant = self._plant
        faces = plant.faces
        k = len(noted)
        bodies = len(faces.rails)
        sizes = [9, 3, 6, len(plant.face_q), 6 * bodies]
        R, p, V_O, travelled, pushed, touched = np.split(noted.T.copy(), np.cumsum(sizes))
        X_WO = Poses(R.reshape(3, 3, k), p)
        X_WE: tuple[Poses | None, ...] = (None,) * len(faces.on)
        if len(travelled):
            s = np.zeros((bodies, 2, k))
            s[plant.guided] = travelled
            poses = [rail.over(*path) for rail, path in zip(faces.rails, s, strict=True)]
            X_WE = tuple(poses[body] for body in faces.on)
        N = tuple(normals_over(q, X_WO, X) for q, X in zip(plant.contacts, X_WE, strict=True))
        alpha, closed = self._shares(X_WO, N, pushed.reshape(bodies, 6, k), touched > 0.0)
        return Truths(alpha, closed, X_WO, V_O.T.copy(), X_WE, N)

    def _shares(
        self, X_WO: Poses, N: Sequence[Array], pushed: Array, touched: Array
    ) -> tuple[Array, Array]:
        """Magnitudes (k, r) and whether each contact touches (k, contacts).

        α with NᵀΦN α = NᵀΦf, Φ⁻¹ the inertia of the object: the least-squares solution of what the
        object alone would feel of the columns and of the wrench f.
        """
        on = self._plant.faces.on
        owner = np.repeat(np.arange(len(N)), [part.shape[1] for part in N])
        alpha = np.zeros((touched.shape[1], len(owner)))
        presses = alpha > 0.0
        for body in sorted(set(on)):
            rows = touched[body]
            here = [i for i, other in enumerate(on) if other == body]
            if not rows.any():
                continue
            F = np.concatenate([*(N[i] for i in here), pushed[body][:, None]], axis=1)[:, :, rows]
            at = Poses(X_WO.R[:, :, rows], X_WO.p[:, rows])
            F = np.concatenate((at.rotate_back(F[:3]), at.rotate_back(F[3:])))  # object axes
            F = np.moveaxis(np.tensordot(self._root, F, 1), 2, 0)
            columns = F[..., :-1]
            share = np.linalg.solve(columns.mT @ columns, columns.mT @ F[..., -1:])[..., 0]
            size = np.linalg.norm(F, axis=1)
            places = np.ix_(rows, np.isin(owner, here))
            alpha[places] = share
            presses[places] = share * size[:, :-1] > _PRESSES * size[:, -1:]
        closed = np.empty((len(alpha), len(N)), dtype=bool)
        for i, (body, pair) in enumerate(zip(on, self._plant.contacts, strict=True)):
            all_press = presses[:, owner == i].all(axis=1)
            closed[:, i] = touched[body] & (all_press if pushes_only(pair) else True)
        return alpha, closed


# --- The plant ------------------------------------------------------------------------------------
#
# Nothing of the toolkit's dynamics is used here: the URDFs are read by MuJoCo's own parser.

_log = logging.getLogger(__name__)


def quieten(mujoco: Any) -> None:
    """Let MuJoCo write no MUJOCO_LOG.TXT and read no clock: the plant counts warnings itself."""
    mujoco.set_mju_user_warning(_log.debug)
    if mujoco.get_mjcb_time() is None:  # its profiler reads the clock thirty times a step
        mujoco.set_mjcb_time(ctypes.pythonapi.PyFloat_GetMin)  # always the same number, from C


class MujocoPlant:
    """Arms, object and environment in MuJoCo (needs the extra `sim`).

    Attributes:
        model, data, spec: MuJoCo's. chain: the true arms. contacts: the pairs.
        faces: bodies of the environment. pushes: forces from outside. drives: of the joints.
        time: s since the last reset.
        object_body: the number of the object's body in `model`. place: of the object in it.
        body_of: (ngeom,) body of the environment by geom; −1: of the object, −2: neither.
        guided: of the joints of moving bodies the body, and whether it is travel (0) or angle (1).
        face_q: their places in qpos.
    """

    spec: Any = None
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
            chain: the true arms and grasps; names, frames, poses and what rotors and friction
                add to the joints are taken from it.
            arm_urdfs: one file for each arm. object_urdf: the held object.
            contacts: what true forces are expressed in; what touches is decided by the geometry.
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
        self._q, self._v = self._places(chain.joint_names)
        if self.drives.flexible is not None:
            self._springs, self._spring_v = self._places([f"{name}/{SPRING}" for name in driven])
        self.object_body = model.body("object/root").id
        tips = [model.body(f"{arm.name}/{arm.tip}").id for arm in chain.arms]
        self._seen = [self.object_body, *tips]
        self.body_of = np.full(model.ngeom, OBJECT)
        for i in range(len(bodies)):
            self.body_of[self._geoms_of(model.body(f"face{i}/root").id)] = i
        guides = [(i, k) for i, rail in enumerate(faces.rails) for k in rail.joints]
        self.guided = tuple(np.array(guides, dtype=int).reshape(-1, 2).T)
        self.face_q, self._face_v = self._places([f"face{i}/{GUIDES[k]}" for i, k in guides])
        by_drive = np.isin(self.guided[0], list(faces.driven))
        self._driven = tuple(x[by_drive] for x in self.guided)
        self._driven_q = self.face_q[by_drive]
        self._driven_v = self._face_v[by_drive]
        if faces.driven:  # the drive's mass must not set the scale of the solver's accuracy
            model.stat.meaninertia = 1.0
        self._sensed = [i for i, arm in enumerate(chain.arms) if arm.wrist_sensor is not None]
        readings = [model.sensor(f"{chain.arms[i].name}/force").adr[0] for i in self._sensed]
        self._readings = np.add.outer(np.array(readings, dtype=int), np.arange(6))

    def _connect(
        self, model: Any, chain: ClosedChain, contacts: Sequence[ContactPair], faces: Faces
    ) -> None:
        """The state of a compiled scene, and views of what every step reads and writes."""
        import mujoco

        self._mj: Any = mujoco
        self.model = model
        self.data: Any = mujoco.MjData(model)
        self.chain = chain
        self.contacts = tuple(contacts)
        self.faces = faces
        self._qpos = self.data.qpos
        self._qvel = self.data.qvel
        self._sensordata = self.data.sensordata
        self._ctrl = self.data.ctrl
        self._warnings = self.data.warning.number
        self._option = model.opt
        self._step = model.opt.timestep
        self._flags = model.opt.disableflags
        self._blind = self._flags | int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
        self.time = 0.0

    def _places(self, joints: Sequence[str]) -> tuple[Array, Array]:
        """Places of joints in qpos and qvel."""
        ids = np.array([self.model.joint(name).id for name in joints], dtype=int)
        return self.model.jnt_qposadr[ids], self.model.jnt_dofadr[ids]

    def _geoms_of(self, root: int) -> Array:
        """Geoms of a body and of the bodies that hang on it."""
        bodies = [root]
        for body in range(root + 1, self.model.nbody):
            if self.model.body_parentid[body] in bodies:
                bodies.append(body)
        return np.flatnonzero(np.isin(self.model.geom_bodyid, bodies))

    def reset(self, q: Array) -> None:
        """Start at rest at joint positions q (n,); loops and gaps must fit."""
        q = as_array("q", q, (self.chain.nq,))
        self._mj.mj_resetData(self.model, self.data)
        self._qpos[self._q] = q
        self._turn_object(q)
        self.time = 0.0
        self.faces.reset()
        self.data.qfrc_applied[self._face_v] = [self.faces.rails[i].preload for i in self.guided[0]]
        self._drive(0.0)
        self._mj.mj_forward(self.model, self.data)

    def _turn_object(self, q: Array) -> None:
        """Put the joint of the first grasp, if it is one, where the other arms hold the object."""
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
        """Apply torques from now on; time stands still."""
        self._send(tau)
        if self.drives.flexible is not None:  # springs wound up, motors where that puts them
            motors = self._q[self.chain.actuated]
            links = self._qpos[motors] + self._qpos[self._springs]
            wound = -self._ctrl / self.drives.flexible.stiffness
            self._qpos[motors] = links - wound
            self._qpos[self._springs] = wound
        self._mj.mj_forward(self.model, self.data)

    def _send(self, tau: Array) -> None:
        known = type(tau) is np.ndarray and tau.shape == self._ctrl.shape
        if not (known and isfinite(tau.dot(tau))):  # four times faster than to convert it
            tau = as_array("tau", tau, self._ctrl.shape)
        if self.drives.motors is not None:
            tau = self.drives.motors.torque(tau, self._qpos[self._q[self.chain.actuated]])
        self._ctrl[:] = tau

    def readings(self, qpos: Array, qvel: Array, sensed: Array) -> tuple[Array, Array, Array]:
        """What encoders and wrists read, of one plant or of the rows of a batch.

        Args:
            qpos, qvel, sensed: (…, m) MuJoCo's positions, velocities and sensor data.

        Returns:
            q, v (…, n) and wrenches (…, arms, 6), zero where an arm has no sensor.
        """
        wrenches = known = sensed.take(self._readings, axis=-1)
        if len(self._sensed) < len(self.chain.arms):
            wrenches = np.zeros((*sensed.shape[:-1], len(self.chain.arms), 6))
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
        wound = self._qpos[self._springs]
        return -flexible.stiffness * wound - flexible.damping * self._qvel[self._spring_v]

    def measure(self) -> Measurement:
        """Encoders after the last step, wrist wrenches as of its beginning (one step old)."""
        q, v, wrenches = self.readings(self._qpos, self._qvel, self._sensordata)
        faces = self.faces
        if len(self.face_q):
            faces.drive(self.time)
            faces.s[self.guided] = self._qpos[self.face_q]
            faces.rates[self.guided] = self._qvel[self._face_v]
        return Measurement(q, v, wrenches, faces.touched(), self._joint_torques())

    def _drive(self, t: float) -> None:
        """Put driven faces where they are at t, with the force that moves them to the next step."""
        faces = self.faces
        faces.drive(t)
        self._qpos[self._driven_q] = faces.s[self._driven]
        self._qvel[self._driven_v] = faces.rates[self._driven]
        self.data.qfrc_applied[self._driven_v] = DRIVE_MASS * faces.second[self._driven]

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
        X @= self.place.homogeneous
        return X

    def log(self) -> MujocoTruth:
        """A log of the truth."""
        return MujocoTruth(self)

    def command(self, tau: Array, duration: float) -> None:
        """Hold the torques over the steps that fit into `duration`.

        Raises:
            PlantError: MuJoCo has warned: the simulation diverged.
        """
        require_duration(duration)
        self._send(tau)
        if self.pushes:
            self.data.xfrc_applied[:] = 0.0
            for push in self.pushes:
                self._push(push, push.at(self.time))
        steps = self.steps_in(duration)
        if self.faces.driven:
            for k in range(steps):
                self._drive(self.time + k * self._step)
                self._mj.mj_step(self.model, self.data)
        else:
            if steps > 1:  # readings in between are not used
                self._option.disableflags = self._blind
                self._mj.mj_step(self.model, self.data, steps - 1)
                self._option.disableflags = self._flags
            self._mj.mj_step(self.model, self.data)
        self.time += steps * self._step
        if any(self._warnings.tolist()):  # of accelerations that are not finite, too
            kinds = [self._mj.mjtWarning(i).name for i in np.flatnonzero(self._warnings)]
            raise PlantError(
                f"MuJoCo diverged at t = {self.time:.4f} s ({', '.join(kinds)}); largest speed "
                f"{np.abs(self._qvel).max():.3g}. Lower the gains or the plant step."
            )

    def stop(self, reason: str = "") -> None:
        """Nothing to do."""

    @property
    def steps_alone(self) -> bool:
        """Whether MuJoCo's steps are all there is to a period: no driven faces, errors, pushes."""
        return not (self.faces.moving or self.pushes or self.drives.motors is not None)

    def steps_in(self, period: float) -> int:
        """How many of MuJoCo's steps a control period (s) has."""
        return round(period / self._step) or 1

    def _push(self, push: Push, force: Array) -> None:
        sensor = self.model.site(f"{push.arm}/wrist")
        body = int(self.model.body_parentid[int(sensor.bodyid[0])])
        arm = self.data.site_xpos[sensor.id] - self.data.xipos[body]
        self.data.xfrc_applied[body, :3] += force
        self.data.xfrc_applied[body, 3:] += cross(arm, force)
