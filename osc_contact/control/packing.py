"""Packing of a controller's settings into a row of MODEL."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact.contacts.pairs.law_pair import PairRow, law_row
from osc_contact.contacts.pairs.pair import has_known_points, presses_flat, pushes_only
from osc_contact.control.controller_settings import Settings
from osc_contact.dynamics.arm import effort_scale
from osc_contact.dynamics.chain_records import pack_chain
from osc_contact.dynamics.environment import Conveyor, Guided, Yielding
from osc_contact.law import records as at
from osc_contact.law.holding import BRAKE_RATE
from osc_contact.law.nested import View
from osc_contact.law.phases import SURE
from osc_contact.law.records import Bytes, new_model
from osc_contact.robots.model import position_limits
from osc_contact.settings.control import HEADROOM, LEAST_CEILING, Friction, PhaseSettings
from osc_contact.settings.quantities import Spec
from osc_contact.spatial import Array

_GIVEN = PairRow(at.GIVEN, ())
#: Bodies that the law evaluates, and their parameters.
_BODIES: dict[type, tuple[int, tuple[str, ...]]] = {
    type(None): (at.UNYIELDING, ()),
    Conveyor: (at.CONVEYOR, ()),
    Yielding: (at.YIELDING, ("compliance",)),
    Guided: (at.CART, ("direction", "inertia", "stiffness", "damping", "preload", "descent")),
}
#: Largest speed by feedback of the motion, as a share of a limit whose excess stops the arms.
_FASTEST = 0.9
_NEVER_TICKS = 1e12  #: number of ticks that no run reaches
_WHOLE = np.pi  #: largest range of a joint that counts for the width of its margins (rad, m)
#: Speed of a joint above which its Coulomb friction counts as fully developed (rad/s).
SLIP = 3e-4
SLIDING = 0.3  #: ratio of that speed of sliding to that of turning joints (m/rad)
_ASSUMED_LIMIT = 100.0  #: torque limit assumed of motors without a limit (N m, N)
_RESIDUAL_SHARE = 0.003  #: residuals that are not friction, as a share of the torque limit
_ROUNDING_SHARE = (
    2e-4  #: residuals by discrete time with an exact model, as a share of the torque limit
)
#: Standard deviations by which residuals have to exceed zero before friction is compensated in a
#: joint whose model has less friction than noise.
_SURE_DEVIATIONS = 2.0
# Priors of the identified parameters F, D, A, bias and mass error of a joint, in a unit in which F,
# D at 1 rad/s and A at 1 rad/s² are at most 1.
#: Initial deviation, plus half the model's value.
_PRIOR_DEVIATIONS = np.array([0.07, 0.07, 0.07, 0.017, 0.07])
_MOST_DEVIATION = np.array([0.5, 0.5, 0.5, 0.5, 0.2])  #: largest standard deviation
_PARAMETER_BOUNDS = np.array([1.0, 20.0, 20.0, 1.0, 0.5])  #: bound of the magnitude


def pack_model(settings: Settings, columns: dict[int, int]) -> Bytes:
    """Pack settings into new bytes of MODEL, which also determine the sizes of MEMORY and WORK.

    Args:
        settings: settings of the controller.
        columns: number of columns of N of each pair that is evaluated by Python, by the index of
            the pair; 0 for pairs that are not in it.
    """
    # numbers of columns and shapes of all pairs determine the size of MODEL
    chain = settings.chain
    pairs = [law_row(pair) or _GIVEN for pair in settings.contacts]
    counts = [
        columns.get(number, 0) if row.kind == at.GIVEN else len(row.shapes) - row.freedoms
        for number, row in enumerate(pairs)
    ]
    shapes = [shape for row in pairs for shape in row.shapes]
    raw = new_model(len(chain.arms), chain.nq, chain.n_a, len(pairs), len(shapes), sum(counts))
    head = at.MODEL.view(raw)
    pack_chain(chain, raw, chain.leader)
    _pack_joints(settings, head)
    # columns and shapes of all pairs are in common tables, each pair with its first index and count
    first_column = first_shape = 0
    for number, row in enumerate(pairs):
        count = counts[number]
        contact = settings.contacts[number]
        pair = head.pairs[number]
        pair.kind = row.kind
        pair.first = first_column
        pair.count = count
        pair.shape_at = first_shape
        pair.freedoms = row.freedoms
        pair.address = row.address
        pair.has_friction = has_known_points(contact)
        head.columns.contact[first_column : first_column + count] = number
        _pack_body(settings, head, number)
        first_column += count
        first_shape += len(row.shapes)
    head.shapes.row[:] = np.reshape(shapes, (-1, 16))
    pack_gains(settings, head)
    pack_safety(settings, head)
    return raw


def _pack_body(settings: Settings, head: View, number: int) -> None:
    """Pack the touched body of a contact into its row of `bodies` of MODEL.

    Args:
        settings: settings of the controller.
        head: view of MODEL.
        number: index of the contact.
    """
    touched = settings.bodies[number]
    body = head.bodies[number]
    contact = settings.contacts[number]
    body.pushes = pushes_only(contact)
    body.face = presses_flat(contact)
    body.kind, names = _BODIES.get(type(touched), (at.ELSEWHERE, ()))
    body.same = number if touched is None else settings.bodies.index(touched)
    source: Any = touched
    if isinstance(touched, Guided):
        source = touched.rail
        if source.joints == [1]:  # a revolute rail is evaluated by Python
            body.kind = at.ELSEWHERE
    numbers = np.hstack([[], *(getattr(source, name) for name in names)])
    body.parameters[: len(numbers)] = numbers


#: Fields of MODEL for each gain, and the fields of MEMORY's contacts for gains of the force law,
#: which contact phases may change there.
GAIN_FIELDS: dict[str, tuple[str, str]] = {
    "motion.stiffness": ("stiffness", ""),
    "motion.damping": ("damping", ""),
    "motion.integral": ("integral", ""),
    "force.integral": ("force_gain", "gain"),
    "force.damping": ("force_damping", "damping"),
}


#: Keys of `PhaseSettings` whose fields of MODEL have other names.
PHASE_NAMES = {
    "speed": "approach_speed",
    "damping": "approach_damping",
    "least": "least_force",
    "share": "lost_share",
    "torque_rate": "phase_rate",
}


def pack_gains(settings: Settings, head: View) -> None:
    """Pack gains, phases, friction, metric and period into MODEL.

    These settings may differ between controllers of the same structure.

    Args:
        settings: settings of the controller.
        head: MODEL, which is changed.
    """
    dt = settings.dt
    motion = settings.gains.motion
    force = settings.gains.force
    _copy_settings(motion, head)
    head.period = dt
    _copy_settings(
        force,
        head,
        integral="force_gain",
        damping="force_damping",
        brake="force_brake",
        rise="step_time",
    )
    head.hold_gain = force.hold_integral
    head.hold_brake = force.hold_brake
    # share of one tick in a low-pass with the rate `drift`; 0 without brake and estimated normals
    drifts = force.brake > 0.0 or force.tilt > 0.0
    head.drift_share = -np.expm1(-force.drift * dt) if drifts else 0.0
    head.tilt = 2.0 * np.sin(0.5 * force.tilt)  # length of the chord between unit normals
    _copy_settings(
        settings.posture_task, head, stiffness="posture_stiffness", damping="posture_damping"
    )
    _copy_settings(settings.friction or Friction(mu=0.0), head)
    _pack_friction(settings, head)
    head.reading = at.LEAST_SQUARES if settings.reading == "least_squares" else at.FILTER
    B = settings.B
    codes = {"object": at.BY_OBJECT, "chain": at.BY_CHAIN}
    head.metric = codes[B] if isinstance(B, str) else at.BY_MATRIX
    head.B_inv[:] = np.eye(6) if isinstance(B, str) else np.linalg.inv(B)
    head.phased = settings.life is not None
    # the limited torque rate after a change of the active set is needed without phases, too
    _copy_settings(settings.life or PhaseSettings(), head, **PHASE_NAMES)


def pack_safety(settings: Settings, head: View) -> None:
    """Pack limits of the robot and settings of holds and stops into MODEL.

    Args:
        settings: settings of the controller.
        head: MODEL, which is changed.
    """
    safety = settings.safety
    _copy_settings(safety, head, stop_after="fault_ticks")
    # effective delay (s) from the decision to stop until the brakes act, for stopping distances
    head.reaction = 0.5 / safety.hold_rate + 0.5 / BRAKE_RATE + SURE
    for key in ("contact", "wrist"):  # a ceiling that is not set follows the commands
        ceiling = getattr(safety, f"{key}_ceiling")
        setattr(head, f"{key}_ceiling", LEAST_CEILING if ceiling is None else ceiling)
        setattr(head, f"{key}_headroom", HEADROOM if ceiling is None else 0.0)
    head.guarded = 1
    head.fast_ticks = round(min(safety.overspeed_time / settings.dt, _NEVER_TICKS))
    head.fastest = _FASTEST if np.isfinite(safety.overspeed_time) else np.inf
    weight = 9.81 * settings.chain.reference.inertia.mass
    head.force_range = max(safety.force_range, 3.0 * weight)
    head.torque_range = max(safety.torque_range, 3.0 * weight)  # at a lever arm of 1 m
    model = settings.chain.model
    rows = head.joints
    # only motors can brake before a limit of position; passive joints have no limits here
    has_limits = (rows.motor >= 0) & (safety.brake_time > 0.0)
    rows.lower[:] = np.where(has_limits, model.lowerPositionLimit, -np.inf)
    rows.upper[:] = np.where(has_limits, model.upperPositionLimit, np.inf)
    rows.brake[:] = 0.5 * safety.brake_time / rows.speed_max


def _pack_joints(settings: Settings, head: View) -> None:
    """Fill the joints of MODEL: motors, limits, effort, posture and margins of the joint limits.

    Fills of each joint `motor` (number of its motor; unchanged, −1, without one), `tau_max` (N m,
    N), `effort` and `ease` (square of the torque by which the effort of a motor is measured, and
    its inverse), `rated` and `speed_max` (speed limit, with and without that of passive joints),
    `posture` (rad, m), and the margins in which the posture law repels joints from their limits.

    Args:
        settings: settings of the controller.
        head: view of MODEL, whose `joints` are filled.
    """
    chain = settings.chain
    posture = settings.posture_task
    rows = head.joints
    margins = joint_limit_margins(chain.model, posture.limit_stiffness, posture.limit_margin)
    effort = effort_scale(chain.tau_max)
    rows.motor[chain.actuated] = np.arange(chain.n_a)
    rows.effort[chain.actuated] = effort**2
    rows.tau_max[chain.actuated] = chain.tau_max
    rows.ease[chain.actuated] = 1.0 / effort**2
    speed = chain.model.velocityLimit
    rows.rated[:] = np.where(np.isfinite(speed) & (speed > 0.0), speed, np.inf)
    rows.speed_max[:] = np.where(rows.motor < 0, np.inf, rows.rated)
    rows.posture[:] = settings.posture
    for name, values in zip(("low", "high", "width", "most"), margins, strict=True):
        rows[name][:] = values


def _pack_friction(settings: Settings, head: View) -> None:
    """Pack the joints' friction of the model, and the priors of its identification, into MODEL.

    Fills `rubs`, the fields friction_…, `brake_ratio` and `priors`, and `slip` and `theta` of the
    joints. theta has F (N m), D (N m s/rad), A (kg m²), a bias and a mass error of each joint.

    Args:
        settings: settings of the controller.
        head: view of MODEL, whose joints have their limits.
    """
    friction: Any = settings.joint_friction
    if friction is None:
        return
    model = settings.chain.model
    rows = head.joints
    model_values = np.zeros((len(rows), 5))
    model_values[:, 0] = model.upperDryFrictionLimit
    model_values[:, 1] = model.damping
    head.rubs = friction.learning or friction.errors or model_values.any()
    head.friction_learning = friction.learning
    head.friction_errors = bool(friction.errors)
    head.friction_share = friction.share
    head.friction_smoothing = friction.smoothing
    head.brake_ratio = friction.brake_ratio
    limit = np.minimum(rows.tau_max, _ASSUMED_LIMIT)
    largest = friction.most * limit
    priors = head.priors
    priors.noise[:] = _RESIDUAL_SHARE * limit
    priors.rounding[:] = _ROUNDING_SHARE * limit
    rows.slip[:] = np.where(rows.slides != 0, SLIDING * SLIP, SLIP)
    rows.theta[:] = model_values
    scale = np.ones_like(model_values)
    scale[:, :4] = largest[:, None]
    priors.sure[:] = np.where(model_values.sum(axis=1) > priors.noise, 0.0, _SURE_DEVIATIONS)
    priors.doubt[:] = 0.5 * model_values + scale * _PRIOR_DEVIATIONS
    priors.spread[:] = scale * _MOST_DEVIATION
    priors.high[:] = np.maximum(scale * _PARAMETER_BOUNDS, model_values)
    priors.low[:, 2] = -np.array(model.armature)  # rotor inertia ≥ 0 in total; F and D ≥ 0
    priors.low[:, 3:] = -priors.high[:, 3:]


def joint_limit_margins(
    model: pin.Model, stiffness: float, margin: float
) -> tuple[Array, Array, Array, Array]:
    """Margins of the joint limits in which the posture task repels joints, (n,) each.

    At the depth s in a margin of width w (0 at its beginning, 1 at the limit and beyond) a joint is
    repelled by a = k w (3s² − 2s³), the slope of the potential k w² (s³ − s⁴/2): continuous with
    its first derivative, and at most k w (a potential field after Khatib, 1986).

    Args:
        model: model of all arms.
        stiffness: k (1/s²).
        margin: width as a share of a joint's range, of which at most π (rad or m) is counted.

    Returns:
        Beginning of the lower and of the upper margins (∓inf without a limit), widths w, and k w.
    """
    lower, upper = position_limits(model)
    with np.errstate(over="ignore"):  # limits of ±1.8e308 mean no limit
        width = margin * np.minimum(upper - lower, _WHOLE)
    return lower + width, upper - width, width, stiffness * width


def _copy_settings(settings: Spec, head: View, **names: str) -> None:
    """Copy settings into fields of MODEL; settings of None, or without a field, are left out.

    Args:
        settings: group of settings.
        head: view of MODEL.
        **names: name of the field for each setting whose field has another name.
    """
    for key in type(settings).model_fields:
        value = getattr(settings, key)
        if value is not None and (name := names.get(key, key)) in at.MODEL.dtype.names:
            setattr(head, name, value)
