"""What is wrong with a task before it runs: where faces and robot are, what is asked of both."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin

from osc_contact.contacts.detection import CollisionShape, collision_shapes
from osc_contact.dynamics.arm import Arm
from osc_contact.dynamics.joint_modes import modes
from osc_contact.errors import InvalidInputError, ModelError, OscContactError, ScenarioError
from osc_contact.runs import hardware
from osc_contact.runs.contacts import feet
from osc_contact.runs.references import force_names
from osc_contact.runs.rig import Rig
from osc_contact.scenarios.touching import CartSpec
from osc_contact.spatial import Array

__all__ = ["Finding", "preflight", "require_ready"]

MOVED_M, MISPLACED_M = 0.02, 0.1  #: start pose that moved: doubtful, refused
BESIDE_M = 0.005  #: a contact further than this beside its body is refused
LIFTED_M = 0.005  #: a motion that opens or closes a gap by more is doubtful
CART_M = 0.2  #: a free cart that runs further is doubtful
SLOW, TOO_SLOW = 0.7, 2.0  #: gain × control period: doubtful, refused (a sampled loop diverges)
SOFT_HZ = 100.0  #: joints whose springs swing slower want a joint torque loop
OVERLOAD = 2.0  #: forces that need more than so many times the motors' limits are refused
_SAMPLES = 400  #: instants at which references are looked at
_logger = logging.getLogger("osc_contact.preflight")


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong, or doubtful.

    Attributes:
        refused: whether it cannot run; else it is doubtful.
        text: a sentence with the numbers and the cure.
    """

    refused: bool
    text: str


def preflight(rig: Rig) -> tuple[Finding, ...]:
    """Everything that is wrong or doubtful about a task, before it runs.

    Compared are the start pose with the scenario's, faces with object and arms, contacts with the
    bodies they are on, motions with the contacts and the arms' reach, forces with motors and carts,
    the control rate with the gains, springs in the joints with their loop, masses and sensors with
    the tare.

    Args:
        rig: see `build_rig`.
    """
    checks: tuple[Callable[[Rig], Iterator[Finding]], ...] = (
        _sensors, _tare, _rate, _springs, _normals, _start, _beside, _reach, _lifted, _motors,
        _carts,
    )  # fmt: skip
    return tuple(finding for check in checks for finding in check(rig))


def require_ready(rig: Rig) -> list[str]:
    """The doubts about a task, which are logged too.

    Raises:
        ScenarioError: it cannot run; with everything that `preflight` refuses.
    """
    found = preflight(rig)
    refused = [one.text for one in found if one.refused]
    if refused:
        raise ScenarioError("\n".join(refused))
    for one in found:
        _logger.warning("doubtful: %s", one.text)
    return [one.text for one in found]


def _sensors(rig: Rig) -> Iterator[Finding]:
    for arm in rig.chain.arms if rig.pairs else ():
        if arm.wrist_sensor is None:
            yield Finding(
                True,
                f"arm '{arm.name}' has no wrist sensor, and contact forces are controlled by what "
                "wrist sensors read; name a frame of its URDF as wrist_sensor",
            )


def _tare(rig: Rig) -> Iterator[Finding]:
    """Weights that the wrists read and the model does not know; the exact plant has no tare."""
    scenario = rig.scenario
    if not rig.pairs or scenario.tare is not None or scenario.plant.type == "rigid":
        return
    error, wrist = scenario.model_error, scenario.sensors.wrist
    wrong = [
        f"model_error.{key} is {value:g}"
        for key, value in (("object_mass", error.object_mass), ("arm_mass", error.arm_mass))
        if value != 1.0
    ]
    if wrist is not None:
        wrong += [
            f"sensors.wrist.{key} has a bias of {of.bias:g} {unit}"
            for key, of, unit in (("force", wrist.force, "N"), ("torque", wrist.torque, "N m"))
            if of.bias > 0.0
        ]
    if wrong:
        yield Finding(
            False,
            f"{' and '.join(wrong)}, and nothing zeroes the wrist sensors: what they read wrongly "
            "is taken for contact force; set tare={} to zero them in free space before contact",
        )


def _springs(rig: Rig) -> Iterator[Finding]:
    try:
        joints = hardware.flexible_joints(rig.scenario, rig.chain, rig.state())
        hardware.torque_loop(rig.scenario, rig.chain, joints)
    except OscContactError as error:
        yield Finding(True, str(error))
        return
    if joints is None or rig.scenario.control.joint_torque is not None:
        return
    swing = modes(rig.state(), rig.chain.actuated, joints.stiffness)
    first = float(swing[swing > 0.0].min(initial=np.inf))
    if first < SOFT_HZ:
        yield Finding(
            False,
            f"the springs in the joints swing at {first:.3g} Hz (first mode, motors held), and no "
            f"joint torque loop makes them carry what is commanded: below {SOFT_HZ:g} Hz contact "
            f"is lost; set control.joint_torque={{rate: {1e-3 / rig.scenario.plant.step:g} kHz}}",
        )


def _rate(rig: Rig) -> Iterator[Finding]:
    rate, gains = rig.scenario.control.rate, rig.scenario.gains
    for name, gain in (
        ("motion.damping", gains.motion.damping),
        ("force.integral", gains.force.integral if rig.pairs else 0.0),
    ):
        if gain / rate >= SLOW:
            refused = gain / rate >= TOO_SLOW
            yield Finding(
                refused,
                f"control.rate {rate:g} Hz is too slow for gains.{name} {gain:g} 1/s: their ratio "
                f"is {gain / rate:.2g}, and a sampled loop diverges from {TOO_SLOW:g} on; raise "
                f"the rate to {10 * gain:.0f} Hz, or lower the gain",
            )


def _normals(rig: Rig) -> Iterator[Finding]:
    X = rig.state().X_WO
    pin.forwardKinematics(rig.chain.model, rig.chain.data, rig.q_contact)
    tips = [tip.translation for tip in rig.chain.tip_poses()]
    for i, (pair, spec) in enumerate(zip(rig.pairs, rig.scenario.contacts, strict=True)):
        face = getattr(spec, "face", None)
        if face is None:
            continue
        point, normal = np.array(face.point), np.array(face.normal)
        heights = [float(normal @ (p - point)) for p in (X.translation, *tips)]
        if max(heights) < 0.0:
            yield Finding(
                True,
                f"the normal of the face of contact '{pair.name}' looks away from the robot: the "
                f"object and all arm tips lie {-1e3 * max(heights):.0f} mm or more behind it; the "
                f"normal points out of the face, towards the object: reverse "
                f"contacts.{rig.scenario.contacts[i].name}.face.normal",
            )


def _start(rig: Rig) -> Iterator[Finding]:
    asked, found = np.array(rig.scenario.object.pose.xyz), rig.state().X_WO.translation
    moved = float(np.linalg.norm(found - asked))
    if moved > MOVED_M:
        yield Finding(
            moved > MISPLACED_M,
            f"to touch its contacts the object starts {1e3 * moved:.0f} mm away from object.pose, "
            f"at {np.round(found, 4).tolist()} m instead of {np.round(asked, 4).tolist()} m; move "
            "the faces to the object, or object.pose and posture to the faces",
        )


def _beside(rig: Rig) -> Iterator[Finding]:
    """Contacts beside their bodies; those of the exact plant have no ends."""
    if rig.scenario.plant.type == "rigid":
        return
    X = rig.state().X_WO
    for i, pair in enumerate(rig.pairs):
        if getattr(pair, "surface_point", None) is None:
            continue
        body = rig.bodies[rig.on[i]]
        try:
            shapes = collision_shapes(body.urdf[0])
        except (InvalidInputError, ModelError):  # meshes that are not convex, …
            continue
        for point in feet(pair, X)[0] if shapes else ():
            away = min(_distance(shape, body.placement, point) for shape in shapes)
            if away > BESIDE_M:
                yield Finding(
                    True,
                    f"contact '{pair.name}' would touch at {np.round(point, 3).tolist()} m, "
                    f"{1e3 * away:.0f} mm beside '{body.name}', whose collision geometry ends "
                    "before; move the face, or the contact's place on the object",
                )
                break


def _distance(shape: CollisionShape, X_WB: pin.SE3, point: Array) -> float:
    """From a point to a shape of a body, not positive inside."""
    X = X_WB * shape.placement
    return float(
        coal.distance(
            shape.shape,
            coal.Transform3s(X.rotation, X.translation),
            coal.Sphere(1e-6),
            coal.Transform3s(np.eye(3), np.asarray(point)),
            coal.DistanceRequest(),
            coal.DistanceResult(),
        )
    )


def _reach(rig: Rig) -> Iterator[Finding]:
    poses = rig.references.over(_times(rig)).X_WD[:, :3]
    for arm, grasp in zip(rig.chain.arms, rig.chain.grasps, strict=True):
        most = _length(arm) + float(np.linalg.norm(grasp.X_TO.translation))
        far = np.linalg.norm(poses - arm.base.translation, axis=1)
        if far.max() > most:
            k = int(far.argmax())
            yield Finding(
                True,
                f"the motion leads the object to {far[k]:.3g} m from the base of arm "
                f"'{arm.name}' at t = {_times(rig)[k]:.3g} s, and the stretched arm reaches "
                f"{most:.3g} m; ask for a smaller motion (are its signals in the right unit?)",
            )


def _length(arm: Arm) -> float:
    """No point of the tip is further from the base: all links stretched out (m)."""
    model = arm.model
    links = sum(float(np.linalg.norm(X.translation)) for X in model.jointPlacements)
    frame = model.frames[model.getFrameId(arm.tip)]
    slides = 0.0
    for joint in list(model.joints)[1:]:
        if joint.shortname().startswith("JointModelP"):
            ends = (model.lowerPositionLimit, model.upperPositionLimit)
            slides += max(abs(float(end[joint.idx_q])) for end in ends)
    return links + float(np.linalg.norm(frame.placement.translation)) + slides


def _lifted(rig: Rig) -> Iterator[Finding]:
    if rig.scenario.control.life is not None:  # it opens contacts on purpose
        return
    t = _times(rig)
    t = t[t >= rig.references.engage_at]
    plan = rig.references.over(t[:: max(1, len(t) // 100)]).X_WD
    poses = [pin.XYZQUATToSE3(x) for x in plan]
    for i, pair in enumerate(rig.pairs):
        if rig.bodies[rig.on[i]].motion is not None:
            continue
        gaps = np.array([pair.gaps(X) for X in poses])
        worst = float(np.abs(gaps).max(initial=0.0))
        if worst > LIFTED_M:
            way = "into" if np.abs(gaps.min()) >= gaps.max() else "off"
            yield Finding(
                False,
                f"the motion asks the object to go {1e3 * worst:.0f} mm {way} the surface of "
                f"contact '{pair.name}', which does not permit it: that part is not followed; give "
                "a direction along the surface, such as common_tangent, and press with force",
            )


def _motors(rig: Rig) -> Iterator[Finding]:
    """What is asked needs at least max|x|/limit, |x|₂ least: exact where nothing is redundant."""
    state, r = rig.state(), rig.contact().r
    if not r or not state.d:
        return
    t = _times(rig)
    alpha = np.asarray(rig.references.over(t).alpha_d)
    limits = np.minimum(rig.chain.tau_max, 1e12)
    N_S = state.S.T @ rig.contact().N
    inverse = np.linalg.pinv(state.G * limits)
    independent = rig.contact().R @ alpha.T  # (r,) out of all
    wanted = inverse @ (state.bias[:, None] + N_S @ independent)  # of each motor's limit
    spare = len(limits) - int(np.linalg.matrix_rank(state.G * limits))
    needed = np.abs(wanted).max(axis=0)
    if spare:  # another choice of internal forces may do with less, but not with less than this
        needed = np.linalg.norm(wanted, axis=0) / np.sqrt(len(limits))
    k = int(np.argmax(needed))
    if needed[k] > OVERLOAD:  # a little more only saturates, which a run tells
        joint = rig.chain.joint_names[rig.chain.actuated[int(np.abs(wanted[:, k]).argmax())]]
        name = force_names(rig.scenario)[int(alpha[k].argmax())]
        yield Finding(
            True,
            f"force.{name} asks for {alpha[k].max():.4g} N at t = {t[k]:.3g} s, for which motors "
            f"would need {needed[k]:.2g} times their limits at least (most of all {joint}, "
            f"{limits[int(np.abs(wanted[:, k]).argmax())]:.3g} N m or N); ask for less force, or "
            "choose another posture",
        )


def _carts(rig: Rig) -> Iterator[Finding]:
    t = _times(rig)
    alpha = np.asarray(rig.references.over(t).alpha_d)
    X, dt = rig.state().X_WO, t[1] - t[0]
    for body in rig.bodies:
        cart = body.motion
        if not isinstance(cart, CartSpec):
            continue
        u = np.array(cart.direction)
        push = np.zeros(len(t))
        for i in body.contacts:
            push += alpha[:, rig.owners == i] @ (feet(rig.pairs[i], X)[1] @ u)
        constant = cart.preload - 9.81 * cart.mass * u[2]
        s = speed = most = 0.0
        for force in push + constant:  # implicit in spring and damper: stable for any of them
            m, c, k = cart.mass, cart.damping, cart.stiffness
            speed = (m * speed + dt * (force - k * s)) / (m + dt * c + dt**2 * k)
            s += dt * speed
            most = max(most, abs(s))
        if most > CART_M:
            yield Finding(
                False,
                f"nothing balances the cart of '{body.name}': weight, preload and contact forces "
                f"leave {push[-1] + constant:.3g} N along its rail at the end, which moves it by "
                f"{most:.3g} m in {rig.scenario.duration:g} s; give it a preload of "
                f"{cart.preload - float(np.mean(push + constant)):.3g} N, or a stiffness",
            )


def _times(rig: Rig) -> Array:
    return np.linspace(0.0, rig.scenario.duration, _SAMPLES)
