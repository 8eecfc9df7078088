"""The judging plant: MuJoCo with unilateral contacts, built from the same URDFs as the model."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from functools import cache, lru_cache
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
from osc_contact.dynamics.grasp import Grasp
from osc_contact.errors import PlantError, missing
from osc_contact.interface import Measurement, Touched
from osc_contact.plants.faces import Rail, touched
from osc_contact.plants.joint_drives import SPRING, JointDrives, add_drives, add_dry_friction
from osc_contact.plants.judge import Truth, Truths, require_duration
from osc_contact.robots import is_mjcf
from osc_contact.robots.mjcf import mjcf_skeleton
from osc_contact.scenarios.hardware import PlantSpec, Push
from osc_contact.spatial import Array, Poses, as_array, cross

__all__ = ["DRIVE_MASS", "GRASP_JOINT", "GUIDES", "MujocoPlant", "MujocoTruth", "scene"]


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
_NEXT_TO_NOTHING = 1e-9  # kg, kg m²: MuJoCo needs mass in moving bodies


def scene(
    mujoco: Any,
    chain: ClosedChain,
    arm_urdfs: Sequence[Path],
    object_urdf: Path,
    bodies: Sequence[tuple[Path, pin.SE3]],
    options: PlantSpec,
    rails: Sequence[Rail | None],
) -> Any:
    """The uncompiled specification, see `MujocoPlant`.

    Args:
        mujoco: the module. chain: of the arms. arm_urdfs, object_urdf: their files.
        bodies: URDF and pose of each body touched. options: of the plant.
        rails: how each body moves; None: at rest.
    """
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.compiler.fusestatic = False
    spec.option.timestep = options.step
    spec.option.tolerance = 1e-12
    spec.option.iterations = 100
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    off = mujoco.mjtDisableBit
    disabled = off.mjDSBL_AUTORESET | off.mjDSBL_MIDPHASE  # few geometries, all looked at
    if not any(rails):  # all that is constrained hangs together
        disabled |= off.mjDSBL_ISLAND
    spec.option.disableflags = int(disabled)
    for arm, urdf in zip(chain.arms, arm_urdfs, strict=True):
        part = _arm(mujoco, arm, urdf)
        spec.attach(part, prefix=f"{arm.name}/", frame=_frame(spec.worldbody, arm.base))
        if arm.wrist_sensor is not None:
            _wrist_sensor(mujoco, spec, arm.name)
    _joint_numbers(spec, chain)
    for index in chain.actuated:
        name = chain.joint_names[index]
        limit = float(chain.model.upperEffortLimit[index])
        motor = spec.add_actuator(
            name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT, ctrlrange=[-limit, limit]
        )
        motor.set_to_motor()
    _hold_object(mujoco, spec, chain, object_urdf)
    for i, (body, rail) in enumerate(zip(bodies, rails, strict=True)):
        _body(mujoco, spec, i, *body, options, rail)
    if options.friction > 0.0:
        _add_friction(spec, options)
    return spec


def _arm(mujoco: Any, arm: Arm, file: Path) -> Any:
    """An arm without shapes and losses, locked joints welded, a site where its wrist sensor is."""
    if is_mjcf(file):
        return mjcf_skeleton(mujoco, file, arm.tip, arm.wrist_sensor, arm.locked)
    part = mujoco.MjSpec.from_string(_skeleton(file))
    part.compiler.fusestatic = False
    for joint in list(part.joints):
        if joint.name in arm.locked:
            _lock(mujoco, part, joint, arm.locked[joint.name])
    if arm.wrist_sensor is not None:
        part.body(arm.wrist_sensor).add_site(name="wrist")
    return part


def _skeleton(urdf: Path) -> str:
    """A robot's URDF without shapes, which may be meshes, and without losses in its joints."""
    return _without_shapes(urdf.read_bytes())


@lru_cache(maxsize=32)
def _without_shapes(text: bytes) -> str:
    root = ElementTree.fromstring(text)
    for element in root.iter():
        for tag in ("visual", "collision", "dynamics"):
            for child in element.findall(tag):
                element.remove(child)
    return ElementTree.tostring(root, encoding="unicode")


def _lock(mujoco: Any, part: Any, joint: Any, position: float) -> None:
    """Weld a link where its joint is held; a URDF's joints have the axes of their child links."""
    body = joint.parent
    axis = np.array(joint.axis)
    pose = np.zeros(3)
    turn = np.zeros(4)
    if joint.type == mujoco.mjtJoint.mjJNT_SLIDE:
        mujoco.mju_rotVecQuat(pose, position * axis, body.quat)
        body.pos = np.array(body.pos) + pose
    else:
        mujoco.mju_axisAngle2Quat(turn, axis, position)
        held = np.zeros(4)
        mujoco.mju_mulQuat(held, body.quat, turn)
        body.quat = held
    part.delete(joint)


def _joint_numbers(spec: Any, chain: ClosedChain) -> None:
    """Rotor inertia, damping and dry friction of every joint, as the chain has them."""
    model = chain.model
    for i, name in enumerate(chain.joint_names):
        joint = spec.joint(name)
        joint.armature = float(model.armature[i])
        joint.damping = np.resize([model.damping[i], 0.0, 0.0], np.shape(joint.damping))
        joint.frictionloss = 0.0
        add_dry_friction(spec, joint, float(model.upperDryFrictionLimit[i]))


def _frame(body: Any, X: pin.SE3) -> Any:
    x, y, z, w = pin.Quaternion(X.rotation).coeffs()
    return body.add_frame(pos=X.translation, quat=[w, x, y, z])


def _wrist_sensor(mujoco: Any, spec: Any, arm: str) -> None:
    for kind in ("force", "torque"):
        spec.add_sensor(
            name=f"{arm}/{kind}",
            type=getattr(mujoco.mjtSensor, f"mjSENS_{kind.upper()}"),
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            objname=f"{arm}/wrist",
        )


def _hold_object(mujoco: Any, spec: Any, chain: ClosedChain, urdf: Path) -> None:
    """The object rides on the first arm; equality constraints tie it to the others."""
    for arm, grasp in zip(chain.arms, chain.grasps, strict=True):
        if grasp.kind == "other":
            raise PlantError(
                f"arm '{arm.name}': MuJoCo is given rigid, hinge and ball grasps only; "
                "use the rigid plant"
            )
    part = mujoco.MjSpec.from_file(str(urdf))
    part.compiler.fusestatic = False
    for geom in part.geoms:
        geom.contype = 0
        geom.conaffinity = 1
    root = part.worldbody.first_body()
    root.name = "root"
    root.add_site(name="held")
    _weigh(root, chain)
    first = chain.grasps[0]
    for i, grasp in enumerate(chain.grasps[1:], start=1):
        for k, point in enumerate(_tie_points(mujoco, grasp)):
            root.add_site(name=f"tie{i}.{k}", pos=grasp.X_TO.actInv(point))
    if not first.is_rigid:
        axis = np.zeros(3) if first.kind == "ball" else first.X_TO.rotation.T @ first.T[3:, 0]
        root.add_joint(
            name="grasp",
            type=getattr(mujoco.mjtJoint, f"mjJNT_{first.kind.upper()}"),
            pos=first.X_TO.inverse().translation,
            **({} if first.kind == "ball" else {"axis": axis}),
        )
    tip = spec.body(f"{chain.arms[0].name}/{chain.arms[0].tip}")
    spec.attach(part, prefix="object/", frame=_frame(tip, first.X_TO))
    for i, (arm, grasp) in enumerate(zip(chain.arms[1:], chain.grasps[1:], strict=True), start=1):
        tip = spec.body(f"{arm.name}/{arm.tip}")
        points = _tie_points(mujoco, grasp)
        if not points:
            x, y, z, w = pin.Quaternion(grasp.X_TO.rotation).coeffs()
            tip.add_site(name=f"{arm.name}/hold", pos=grasp.X_TO.translation, quat=[w, x, y, z])
            tie = _tie(mujoco, spec, f"{arm.name}/weld", f"{arm.name}/hold", "object/held")
            tie.type = mujoco.mjtEq.mjEQ_WELD
            data = np.zeros(len(tie.data))  # 11 or 12, by version
            data[10] = 1.0  # torque scale of the weld
            tie.data = data
        for k, point in enumerate(points):
            own = f"{arm.name}/tie.{k}"
            other = f"object/tie{i}.{k}"
            tip.add_site(name=own, pos=point)
            _tie(mujoco, spec, own, own, other).type = mujoco.mjtEq.mjEQ_CONNECT


def _weigh(root: Any, chain: ClosedChain) -> None:
    """The chain's object where that is not the one of the file."""
    assert chain.payload is not None
    inertia = chain.payload.inertia
    if inertia.mass == root.mass:
        return
    I = inertia.inertia  # noqa: E741 - the field's letter
    root.explicitinertial = True
    root.mass = inertia.mass
    root.ipos = inertia.lever
    root.iquat = [1.0, 0.0, 0.0, 0.0]
    root.fullinertia = [I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]]


def _tie_points(mujoco: Any, grasp: Grasp) -> list[Array]:
    """Points of the tip frame that stay together in a hinge or a ball; none: a weld."""
    if grasp.is_rigid:
        return [] if mujoco.mj_version() >= WELDS else list(TIE_SPAN * np.eye(3))
    if grasp.kind == "ball":
        return [np.zeros(3)]
    axis = grasp.T[3:, 0]
    return [TIE_SPAN * axis, -TIE_SPAN * axis]


def _tie(mujoco: Any, spec: Any, name: str, first: str, second: str) -> Any:
    return spec.add_equality(
        name=name,
        objtype=mujoco.mjtObj.mjOBJ_SITE,
        name1=first,
        name2=second,
        solref=[2 * spec.option.timestep, 1.0],
        solimp=[0.9999, 0.9999, 0.001, 0.5, 2.0],
    )


def _body(
    mujoco: Any,
    spec: Any,
    i: int,
    urdf: Path,
    placement: pin.SE3,
    options: PlantSpec,
    rail: Rail | None,
) -> None:
    part = mujoco.MjSpec.from_file(str(urdf))
    part.compiler.fusestatic = False
    root = part.worldbody.first_body()
    root.name = "root"
    for geom in part.geoms:
        geom.contype = 1
        geom.conaffinity = 0
        geom.priority = 1
        geom.solref = list(options.solref)
        geom.solimp = [*options.solimp, 0.5, 2.0]
        geom.condim = 1 if options.friction == 0.0 else 3
        geom.friction = [options.friction, 0.0, 0.0]
    if rail is not None:
        _put_on_rail(mujoco, part, root, placement, rail)
    spec.attach(part, prefix=f"face{i}/", frame=_frame(spec.worldbody, placement))


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


def _put_on_rail(mujoco: Any, part: Any, root: Any, X_WB: pin.SE3, rail: Rail) -> None:
    """A slide, a hinge or both, whose inertia is all there is: a cart's weighs, others' does not.

    It sits in the joints (armature), where a slide and a hinge do not act on one another.
    """
    driven = rail.motion is not None
    for body in part.bodies[1:]:  # links fixed to the body weigh nothing beside it
        body.explicitinertial = True
        body.fullinertia = [np.nan] * 6  # not given
        body.mass = 0.0
        body.inertia = [0.0] * 3
    cart = not driven and rail.joints == [0]
    root.mass = rail.inertia if cart else _NEXT_TO_NOTHING
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

    def __init__(
        self,
        plant: tuple[Any, Any],
        body: int,
        body_of: Mapping[int, int],
        rails: Sequence[Rail | None],
        guided: tuple[Array, tuple[Array, ...]],
        *,
        contacts: Sequence[ContactPair],
        on: Sequence[int],
        inertia: Array,
    ) -> None:
        """Watch a plant.

        Args:
            plant: `MjModel` and `MjData`. Cones are elliptic: the first number of a contact's
                constraint force is its normal force.
            body: the object's. body_of: body of the environment by its geom; geoms that are not
                named, and −1, are the object's, others neither.
            rails: how each of these moves. guided: places in qpos of their joints; the body of
                each joint and whether it is the travel (0) or the angle (1).
            contacts: the pairs. on: the body of each.
            inertia: (6, 6) of the object at its origin, in its own axes.
        """
        model, self._data = plant
        self._rails = rails
        self._on = on
        self._contacts = tuple(contacts)
        self._travel, self._guided = guided
        d = self._data
        root = int(model.body_rootid[body])
        self.place: pin.SE3 | None = None  #: of the object in that body
        self._parts: tuple[Array, ...] = (
            d.xpos[body],
            d.xmat[body],
            d.cvel[body],
            d.subtree_com[root],
        )
        self._body_of = np.full(model.ngeom, -1)
        self._body_of[list(body_of)] = list(body_of.values())
        self._Phi = np.linalg.inv(inertia)
        self._seen = -1
        self._states: list[Array] = []
        self._points: list[Array] = []
        self._forces: list[Array] = []

    def note(self) -> None:
        """Keep where the object and bodies on rails are, and each contact with its force."""
        data = self._data
        parts = self._parts
        if len(self._travel):
            parts = (*parts, data.qpos[self._travel])
        self._states.append(np.concatenate(parts))
        if data.ncon != self._seen:  # contacts stand at the start of MuJoCo's arena at every step
            contact = data.contact
            self._seen = data.ncon
            self._address = contact.efc_address
            self._contact = contact.geom, self._address[:, None], contact.pos, contact.frame[:, :3]
        self._points.append(np.concatenate(self._contact, axis=1))
        force = data.efc_force
        self._forces.append(force.take(self._address) if len(force) else np.zeros(self._seen))

    def noted(self, start: int = 0) -> Array:
        """(k, m): R, p and twist of the object, where bodies on rails are, and of each body

        the wrench into it at O and whether it is touched.
        """
        p, R, velocity, centre, travelled = np.split(
            np.array(self._states[start:]).T, [3, 12, 18, 21]
        )
        k = p.shape[1]
        R = R.reshape(3, 3, k)
        if self.place is not None:
            p = p + np.einsum("ijk,j->ik", R, self.place.translation)
            R = np.einsum("ijk,jl->ilk", R, self.place.rotation)
        omega = velocity[:3]
        v = velocity[3:] + cross(omega, p - centre)
        parts = (R.reshape(9, k), p, v, omega, travelled, *self._wrenches(p, start))
        return np.concatenate(parts).T

    def _wrenches(self, O: Array, start: int) -> tuple[Array, Array]:  # noqa: E741
        """Into each body: (6 bodies, k) at O (3, k), and whether it is touched (bodies, k)."""
        k = O.shape[1]
        bodies = len(self._rails)
        pushed = np.zeros((bodies, k, 6))
        touched = np.zeros((bodies, k))
        points = np.concatenate(self._points[start:])
        first, second = self._body_of[points[:, :2].astype(int)].T
        body = np.maximum(first, second)
        here = (np.minimum(first, second) == -1) & (body >= 0)  # the object is one of the two
        tick = np.repeat(np.arange(k), [len(one) for one in self._points[start:]])
        presses = points[:, 2] >= 0.0
        size = np.where(presses, np.concatenate(self._forces[start:]), 0.0)
        # the normal points from the first geom to the second
        f = np.where(first < 0, size, -size) * points[:, 6:].T
        wrench = np.concatenate((f, cross(points[:, 3:6].T - O[:, tick], f)))
        body = body[here]
        tick = tick[here]
        np.add.at(pushed, (body, tick), wrench[:, here].T)
        np.logical_or.at(touched, (body, tick), presses[here])
        return pushed.transpose(0, 2, 1).reshape(-1, k), touched

    def clear(self) -> None:
        """Forget the instants noted so far."""
        for notes in (self._states, self._points, self._forces):
            notes.clear()

    def truths(self, noted: Array) -> Truths:
        """See `TruthLog.truths`."""
        k = len(noted)
        bodies = len(self._rails)
        sizes = [9, 3, 6, len(self._travel), 6 * bodies]
        R, p, V_O, travelled, pushed, touched = np.split(noted.T.copy(), np.cumsum(sizes))
        X_WO = Poses(R.reshape(3, 3, k), p)
        X_WE = self._faces(travelled.T)
        N = tuple(normals_over(q, X_WO, X) for q, X in zip(self._contacts, X_WE, strict=True))
        alpha, closed = self._shares(X_WO, N, pushed.reshape(bodies, 6, k), touched > 0.0)
        return Truths(alpha, closed, X_WO, V_O.T.copy(), X_WE, N)

    def _faces(self, travelled: Array) -> tuple[Poses | None, ...]:
        """Of each contact the poses of its body; None for all where no body can move."""
        if not len(self._travel):
            return (None,) * len(self._on)
        k = len(travelled)
        s = np.zeros((len(self._rails), 2, k))
        s[self._guided] = travelled.T
        still = Poses(np.eye(3)[:, :, None], np.zeros((3, k)))
        poses = [
            still if rail is None else rail.over(*path)
            for rail, path in zip(self._rails, s, strict=True)
        ]
        return tuple(poses[body] for body in self._on)

    def _shares(
        self, X_WO: Poses, N: Sequence[Array], pushed: Array, touched: Array
    ) -> tuple[Array, Array]:
        """Magnitudes (k, r) and whether each contact touches (k, contacts)."""
        k = touched.shape[1]
        alpha = [np.zeros((part.shape[1], k)) for part in N]
        presses = [np.zeros(part.shape, dtype=bool) for part in alpha]
        for body in sorted(set(self._on)):
            rows = touched[body]
            here = [i for i, other in enumerate(self._on) if other == body]
            if not rows.any():
                continue
            at = Poses(X_WO.R[:, :, rows], X_WO.p[:, rows])
            columns = _in_axes_of(at, np.concatenate([N[i][:, :, rows] for i in here], axis=1))
            whole = _in_axes_of(at, pushed[body][:, None, rows])
            share = _split(columns, self._Phi, whole[:, 0])
            felt = share * self._mobility(columns) > _PRESSES * self._mobility(whole)
            ends = np.cumsum([len(alpha[i]) for i in here])[:-1]
            for i, part, on in zip(here, np.split(share, ends), np.split(felt, ends), strict=True):
                alpha[i][:, rows] = part
                presses[i][:, rows] = on
        closed = [
            touched[body] & (on.all(axis=0) if pushes_only(pair) else True)
            for body, pair, on in zip(self._on, self._contacts, presses, strict=True)
        ]
        both = np.concatenate([np.zeros((0, k)), *alpha])
        return both.T.copy(), np.array(closed, dtype=bool).reshape(-1, k).T.copy()

    def _mobility(self, wrenches: Array) -> Array:
        """√(fᵀΦf) (m, k), what the object alone would feel of wrenches (6, m, k) in its axes."""
        return np.sqrt((wrenches * np.tensordot(self._Phi, wrenches, 1)).sum(axis=0))


def _in_axes_of(X: Poses, wrenches: Array) -> Array:
    """Wrenches (6, m, k) at O in the object's axes."""
    return np.concatenate((X.rotate_back(wrenches[:3]), X.rotate_back(wrenches[3:])))


def _split(N: Array, Phi: Array, f: Array) -> Array:
    """(r, k) α with NᵀΦ N α = NᵀΦ f; N (6, r, k), Φ (6, 6), f (6, k)."""
    r = N.shape[1]
    Phi_N = np.tensordot(Phi, N, 1)
    right = (Phi_N * f[:, None]).sum(axis=0)
    gram = np.array([[(N[:, i] * Phi_N[:, j]).sum(axis=0) for j in range(r)] for i in range(r)])
    if r == 1:
        return np.asarray(right / gram[0])
    return np.asarray(np.linalg.solve(gram.transpose(2, 0, 1), right.T[:, :, None])[:, :, 0].T)


# --- The plant ------------------------------------------------------------------------------------
#
# Nothing of the toolkit's dynamics is used here: the URDFs are read by MuJoCo's own parser.

_log = logging.getLogger(__name__)


def _stopped() -> float:
    return 0.0


@cache
def _no_clock() -> Any:
    """A clock that stands still, in compiled code."""
    try:
        from numba import cfunc
    except ImportError:  # then MuJoCo reads its own
        return None
    return cfunc("float64()", cache=True)(_stopped).ctypes


def quieten(mujoco: Any) -> None:
    """Let MuJoCo write no MUJOCO_LOG.TXT and read no clock: the plant counts warnings itself."""
    mujoco.set_mju_user_warning(_log.debug)
    if mujoco.get_mjcb_time() is None:  # its profiler reads the clock thirty times a step
        mujoco.set_mjcb_time(_no_clock())


class MujocoPlant:
    """Arms, object and environment in MuJoCo (needs the extra `sim`)."""

    def __init__(
        self,
        chain: ClosedChain,
        arm_urdfs: Sequence[Path],
        object_urdf: Path,
        contacts: Sequence[ContactPair],
        bodies: Sequence[tuple[Path, pin.SE3]],
        *,
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
            raise PlantError(missing(error)) from error
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
            self.spec: Any = spec
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
        self._qpos = self.data.qpos
        self._qvel = self.data.qvel
        self._sensordata = self.data.sensordata
        self._ctrl = self.data.ctrl
        self._warnings = self.data.warning.number
        self._size = self._ctrl.shape
        self._calm = bytes(self._warnings.nbytes)
        self._option = self.model.opt
        self._step = float(self._option.timestep)
        self._flags = int(self._option.disableflags)
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
            known = wrenches
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
        wound = self.data.qpos[self._springs]
        rate = self.data.qvel[self._spring_v]
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
            (self.model, self.data),
            self._object,
            self._body_of,
            self.rails,
            (self._face_q, self._guided),
            contacts=self.contacts,
            on=self.on,
            inertia=inertia,
        )

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
