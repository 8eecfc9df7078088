"""Why a tick was held, in words: made of codes and numbers when they are read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from osc_contact.control.settings import Settings
from osc_contact.control.tick_records import TickRecords
from osc_contact.errors import InvalidInputError, OscContactError
from osc_contact.interface import Measurement, Reference, Touched, as_squeeze
from osc_contact.law import tables as at
from osc_contact.spatial import Array, as_array

__all__ = [
    "convert_arrays",
    "converting",
    "explain",
    "read_joints",
    "require_shapes",
    "require_sizes",
]

_DOUBLE = np.dtype(float)
_own = partial(np.array, dtype=_DOUBLE, order="C")


def require_sizes(measurement: Measurement, reference: Reference, settings: Settings) -> None:
    """Refuse what no tick can take in.

    Args:
        measurement, reference: of the tick. settings: of the controller.

    Raises:
        InvalidInputError: with what is wrong.
    """
    chain, c = settings.chain, len(settings.contacts)
    k, n = len(chain.arms), chain.nq
    as_array("q", measurement.q, (n,))
    as_array("v", measurement.v, (n,))
    as_array("wrist wrenches", measurement.wrenches, (k, 6))
    touched = measurement.touched
    if touched is not None:
        as_array("touched X_WE", touched.X_WE, (c, 4, 4))
        as_array("touched V_E", touched.V_E, (c, 6))
        as_array("touched A_E", touched.A_E, (c, 6))
    alpha_d = as_array("reference alpha_d", reference.alpha_d, (None,))
    if np.abs(alpha_d).max(initial=0.0) > 1e6:  # the law takes in no more than 1.8e6
        raise InvalidInputError(f"reference alpha_d: {alpha_d} N; no robot presses with 1e6 N")
    if k < 3 and np.ndim(reference.squeeze_d):
        raise InvalidInputError(f"reference squeeze_d: {k} arms take a number, got an array")
    as_squeeze("reference squeeze_d", reference.squeeze_d, k * (k - 1) // 2)
    as_array("reference V_D", reference.V_D, (6,))
    as_array("reference A_D", reference.A_D, (6,))
    as_array("reference X_WD", reference.X_WD.homogeneous, (4, 4))


def require_shapes(measurement: Any, reference: Any, settings: Settings) -> None:
    """Refuse arrays of numbers that no tick of this controller will ever take.

    Args:
        measurement, reference: of the tick. settings: of the controller.

    Raises:
        InvalidInputError: with both shapes.
    """
    chain = settings.chain
    for whole, name, shape in (
        (measurement, "q", (chain.nq,)),
        (measurement, "v", (chain.nq,)),
        (measurement, "wrenches", (len(chain.arms), 6)),
        (reference, "V_D", (6,)),
        (reference, "A_D", (6,)),
    ):
        given = getattr(whole, name, None)
        if isinstance(given, np.ndarray) and given.dtype.kind in "fiu" and given.shape != shape:
            raise InvalidInputError(f"{name}: expected shape {shape}, got {given.shape}")


def convert_arrays(measurement: Measurement, reference: Reference) -> tuple[Measurement, Reference]:
    """Both with arrays of their own, contiguous and of double precision."""

    touched = measurement.touched
    if touched is not None:
        touched = Touched(_own(touched.X_WE), _own(touched.V_E), _own(touched.A_E))
    return (
        replace(
            measurement,
            q=_own(measurement.q),
            v=_own(measurement.v),
            wrenches=_own(measurement.wrenches),
            touched=touched,
        ),
        replace(
            reference,
            V_D=_own(reference.V_D),
            A_D=_own(reference.A_D),
            alpha_d=_own(reference.alpha_d, ndmin=1),
        ),
    )


def converting(rows: Callable[..., int], n: int, arms: int) -> Callable[..., int]:
    """The law's call for arrays of any type and order, and for lists.

    Args:
        rows: the call that takes arrays of double precision. n: joints. arms: how many.
    """
    q_, v_, w_, V_, A_ = np.zeros(n), np.zeros(n), np.zeros((arms, 6)), np.zeros(6), np.zeros(6)
    joints, wrists, six = q_.shape, w_.shape, V_.shape

    def call(
        raw: Any, at: Any, q: Any, v: Any, wrenches: Any, X_WD: Any, V_D: Any, A_D: Any,
        alpha_d: Any, touched: Any,
    ) -> int:  # fmt: skip
        try:
            fits = q.shape == v.shape == joints and wrenches.shape == wrists
            fits = fits and V_D.shape == A_D.shape == six and alpha_d.ndim == 1
        except AttributeError:  # of lists
            fits = False
        if not fits:
            q, v, wrenches, V_D, A_D = _own(q), _own(v), _own(wrenches), _own(V_D), _own(A_D)
            a = _own(alpha_d, ndmin=1)
            return rows(raw, at, q, v, wrenches, X_WD, V_D, A_D, a, touched)
        q_[...] = q
        v_[...] = v
        w_[...] = wrenches
        V_[...] = V_D
        A_[...] = A_D
        a = alpha_d.astype(_DOUBLE)
        return rows(raw, at, q_, v_, w_, X_WD, V_, A_, a, touched)

    return call


def read_joints(x: Any, n: int) -> Array:
    """(n,) numbers, as far as x has them; else all of them NaN."""
    try:
        array = np.array(x, dtype=float)
    except Exception:  # numbers too large, or warnings made errors, among others
        array = np.zeros(0)
    return array if array.shape == (n,) else np.full(n, np.nan)


def explain(
    rows: TickRecords,
    settings: Settings,
    measurement: Measurement,
    reference: Reference,
    failure: Exception | None,
) -> str:
    """The sentence for a tick that ended HELD; `failure`: of Python code called in it.

    Args:
        rows: records of the tick. settings: of the controller.
        measurement, reference: what came in. failure: error of Python code called in it.
    """
    code, work = int(rows.work.reason), rows.work
    if code == at.STOPPED:
        cause = int(rows.memory.cause)
        why = "a tick could not be computed" if failure is None else str(failure)
        if cause != at.BAD_INPUT:
            why = (
                _limit_passed(rows, settings, cause)
                or _not_believed(rows, settings, cause)
                or _SENTENCES.get(cause, "")
            )
        why = why or "code called in the tick failed"
        return f"stopped, until reset() is called. Cause: {why}{_unbraked(rows, settings)}"
    if failure is not None:
        return f"{failure}{_unbraked(rows, settings)}"
    if code in (at.OUT_OF_RANGE, at.JUMPED, at.WRENCH_TIMEOUT):
        return _not_believed(rows, settings, code)
    if code >= at.OVERSPEED:
        return f"{_limit_passed(rows, settings, code)}. See why, then call reset()"
    names = [settings.contacts[c].name for c in rows.row.pairs.owners]
    if code == at.BAD_INPUT:
        try:
            require_sizes(measurement, reference, settings)
        except OscContactError as error:
            return str(error)
        return (
            f"reference alpha_d: {np.size(reference.alpha_d)} forces for {len(names)} columns of "
            "N; give one for each degree of constraint, contact after contact"
        )
    if code in (at.UNREACHABLE, at.CONTRADICTION):
        where = int(work.where)
        chosen = rows.columns.chosen
        column = int(rows.kept()[where]) if code == at.UNREACHABLE else int(where)
        name = names[column] if len(chosen) else ""
        if code == at.UNREACHABLE:
            return (
                f"the arms cannot push on contact column {column} ({name}): its mobility is "
                f"{float(work.amount):.2g} of the free object's. The structure carries this force; "
                "leave the contact out of N."
            )
        return (
            f"{name}: singular at this instant. Its force depends on those of other contacts, but "
            f"the acceleration that keeps it does not: column {column} needs n_γ = "
            f"{float(rows.columns.n_gamma_all[column]):.6g}, the others imply "
            f"{float(work.amount):.6g}. Drop one of these contacts, or move through this pose "
            "slower or with the others released"
        )
    return _SENTENCES[code]


_SENTENCES = {
    at.NO_REASON: "",
    at.OBJECT_UNKNOWN: (
        "the joints do not determine where the object is: its grasps let it move while every arm "
        "stands still. Grasp it so that this is blocked"
    ),
    at.BAD_INERTIA: (
        "the joint-space inertia of an arm is not positive definite; check the masses and inertias "
        "of its links"
    ),
    at.UNACTUATED: (
        "the motors cannot drive every motion of the object. Add a motor, or grasp so that the "
        "motion is blocked"
    ),
    at.DEGENERATE_PAIR: (
        "two edges in contact are parallel: they touch along a line, which edge_on_edge does not "
        "describe. Give an edge on a face, or turn the object"
    ),
    at.DIFFERENT_BODIES: (
        "dependent contacts on different bodies: how their force is split decides how the bodies "
        "move, and no equation says how. Put them on one body, or drop one of them"
    ),
    at.INSEPARABLE: (
        "as seen through the arms, some contact columns are dependent: their forces cannot be told "
        "apart. Keep an independent subset"
    ),
    at.BAD_METRIC: "the metric B of eq. 24 is singular in the motions that the arms permit",
    at.NO_ROTATION: (
        "reference X_WD: its rotation is none (R Rᵀ = 1 and det R = 1 are missed by more than 1e-4)"
    ),
    at.NOT_FINITE: (
        "the computed torques are not finite: the measured state or the integrals are out of any "
        "range. Check the sensors; reset the integrals"
    ),
    at.BLIND: (
        "the inertia beyond the wrist sensors is singular: they cannot tell the contact force. "
        "Check mass and inertia of gripper and object"
    ),
}


def _unbraked(rows: TickRecords, settings: Settings) -> str:
    """A sentence about a stopped joint without any sound reading; empty: there is none."""
    joint = int(rows.memory.unbraked)
    if joint < 0 or rows.memory.state != at.SAFE_STOP:
        return ""
    return (
        f". No sound reading of joint {settings.chain.joint_names[joint]} is left: its motor "
        "cannot brake it reliably, engage the mechanical brakes"
    )


def _not_believed(rows: TickRecords, settings: Settings, code: int) -> str:
    """Which reading was not believed; empty: none."""
    safety, chain, culprit = settings.safety, settings.chain, int(rows.memory.culprit)
    if code == at.OUT_OF_RANGE:
        head = rows.row.head
        return (
            f"the wrist of arm '{chain.arms[culprit].name}' reads more than it measures "
            f"(force_range = {float(head.force_range):g} N, torque_range = "
            f"{float(head.torque_range):g} N m)"
        )
    if code == at.JUMPED:
        return (
            f"joint {chain.joint_names[culprit]} jumps: it reads faster than plausible_speed = "
            f"{safety.plausible_speed:g} times its speed limit of "
            f"{chain.model.velocityLimit[culprit]:.4g} rad/s or m/s"
        )
    if code == at.WRENCH_TIMEOUT:
        return f"no wrench was read for longer than wrench_timeout = {safety.wrench_timeout:g} s"
    return ""


def _limit_passed(rows: TickRecords, settings: Settings, code: int) -> str:
    """Which limit of the robot stopped it; empty: none."""
    safety, chain, culprit = settings.safety, settings.chain, int(rows.memory.culprit)
    if code in (at.OVERSPEED, at.NEAR_END):
        model, name = chain.model, chain.joint_names[culprit]
        if code == at.OVERSPEED:
            return (
                f"joint {name} stayed above its speed limit of {model.velocityLimit[culprit]:.4g} "
                f"rad/s or m/s for {safety.overspeed_time:g} s; the arms are braked"
            )
        low, high = model.lowerPositionLimit[culprit], model.upperPositionLimit[culprit]
        return (
            f"joint {name} came so near to the end of its range [{low:.4g}, {high:.4g}] that it "
            f"could just be stopped before, braked from its speed limit in brake_time = "
            f"{safety.brake_time:g} s"
        )
    if code == at.STUCK:
        return (
            f"the encoder of joint {chain.joint_names[culprit]} reads the very same though it "
            f"was commanded to gain {safety.stuck_speed:g} of its speed limit"
        )
    if code == at.DISAGREE:
        return (
            f"the speed of joint {chain.joint_names[culprit]} is not that of its positions: they "
            f"differ by more than {safety.speed_error:g} of its speed limit, or positions drift by "
            f"more than {safety.position_drift:g} rad or m from what speeds add up to"
        )
    if code == at.UNBALANCED:
        return (
            f"the motor torques of arm '{chain.arms[culprit].name}' contradict its wrist by more "
            f"than wrist_error = {safety.wrist_error:g} of their limits: the sensor's sign, scale, "
            "offset, frame or arm is wrong, or the masses of the links, or a joint rubs"
        )
    if code == at.APART:
        return (
            f"arm '{chain.arms[culprit].name}' is more than closure_error = "
            f"{1e3 * safety.closure_error:g} mm away from where the others hold the object: an "
            "encoder is wrong, those of two arms are swapped, or a grasp has slipped"
        )
    if code == at.WRIST_FROZEN:
        return (
            f"the wrist of arm '{chain.arms[culprit].name}' reads the very same for "
            f"{safety.frozen_time:g} s: it is dead, or its last reading repeats itself. Sensors "
            "too coarse to show any noise take frozen_time = inf"
        )
    if code == at.FROZEN:
        return (
            f"all readings are the very same for {safety.frozen_time:g} s: a packet repeats "
            "itself. Sensors too coarse to show any noise take frozen_time = inf"
        )
    if code == at.POWERED:
        return f"more than contact_power = {safety.contact_power:g} W went into the contacts"
    if code not in (at.CONTACT_LOST, at.OVERFORCE):
        return ""
    column = rows.row.pairs.owners[culprit]
    name, forces = settings.contacts[column].name, rows.column_memory
    read = f"{float(forces.alpha[culprit]):.3g} N when last computed"
    if code == at.CONTACT_LOST:
        return (
            f"{name}: less than a fifth of its command was read for {safety.contact_loss_time:g} "
            f"s, or its integral stood at its bound ({read}), or it was not held again "
            f"{safety.regain_time:g} s after it was lost. Contact is lost, or a wrist sensor is "
            "dead or wired with the wrong sign"
        )
    return (
        f"{name}: more than {safety.contact_force:g} N and three times its command was read for "
        f"{safety.overforce_time:g} s ({read})"
    )
