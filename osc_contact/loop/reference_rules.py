"""Rules on references alone: desired poses, velocities and forces, and the ceilings for them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from osc_contact.contacts.pairs.pair import pushes_only
from osc_contact.control.status import Status
from osc_contact.interface import Reference
from osc_contact.loop.rules import Task, Values, doubt, rounded, rule
from osc_contact.spatial import norm

LAG_DOUBTFUL = 1e-3  #: m, rad, deviation of an object from X_WD above which a warning is given
LAG_REFUSED = 0.02  #: m, rad, deviation of an object from X_WD above which a task is refused
SAME_RATE = 0.2  #: largest relative remainder of the rate of X_WD after subtracting s V_D
JUMPS = 2  #: number of checked references at which X_WD may jump
SPACING_DOUBTFUL, SPACING_REFUSED = 0.1, 0.4  #: limits of |ln| of the references' period over dt
#: Relations of V_D and the rate of X_WD: V_D is zero, the rate is s V_D, or neither.
_LEFT_OUT, _A_FACTOR, _ANOTHER = "left out", "a factor", "another motion"


@rule(
    "the first reference puts the object {value:.3g} m away from where it is, at {first} m instead "
    "of {now} m; begin the motion at chain.state(q, v).X_WO",
    0.005,
    0.1,
)
def jump(task: Task) -> Values:
    """Distance from the present pose of the object to the first reference (m).

    Args:
        task: task to be checked.

    Yields:
        Value that the rule compares with its limits, and the words of its sentence.
    """
    first = task.poses[0, :3]
    current = task.state.X_WO.translation
    yield norm(first - current), {"first": rounded(first), "now": rounded(current)}


@rule("{name} is −{value:.3g} N at t = {t:.3g} s; this contact cannot pull: give forces ≥ 0")
def pulls(task: Task) -> Values:
    """Negated forces (N) of contacts that cannot pull; positive values are findings."""
    for name, owner, force in zip(task.force_names, task.owners, task.forces.T, strict=True):
        if pushes_only(task.pairs[owner]):
            k = force.argmin()
            yield -force[k], {"name": name, "t": task.times[k]}


@rule(
    "{name} is {force:.4g} N at t = {t:.3g} s, and readings beyond safety.force_range = "
    "{range:.4g} N are rejected; command less force, or raise force_range to what the wrist "
    "sensor measures",
    1.0,
)
def measured_range(task: Task) -> Values:
    """Largest desired force of each column, divided by the range of the wrist sensors."""
    limit = task.safety.force_range
    for name, force in zip(task.force_names, np.abs(task.forces).T, strict=True):
        k = force.argmax()
        words = {"name": name, "t": task.times[k], "force": force[k], "range": limit}
        yield force[k] / limit, words


@rule(
    "{name} is {force:.4g} N at t = {t:.3g} s, above safety.{key} = {most:.4g} N, at which the "
    "arms are stopped; command less force, or raise {key} to what task and robot permit",
    1.0,
)
def force_ceilings(task: Task) -> Values:
    """Commanded forces of single contacts, and their sum, divided by the ceilings that are set.

    Each force, and the internal force of two arms, is compared with
    `control.safety.contact_ceiling`; the sum of all of them, internal forces included, with
    `control.safety.wrist_ceiling`.

    Args:
        task: task to be checked.

    Yields:
        Value that the rule compares with its limits, and the words of its sentence.
    """
    forces = np.abs(task.forces)
    total = forces.sum(axis=1)
    total[: len(task.squeezes)] += task.squeezes
    commands = [
        (name, "contact_ceiling", force)
        for name, force in zip(task.force_names, forces.T, strict=True)
    ]
    if len(task.squeezes) and len(task.chain.arms) == 2:
        commands.append(("the internal force", "contact_ceiling", task.squeezes))
    commands.append(("the sum of all commanded forces", "wrist_ceiling", total))
    for name, key, force in commands:
        ceiling = getattr(task.safety, key)
        if ceiling is not None:
            k = force.argmax()
            words = {"name": name, "t": task.times[k], "force": force[k], "key": key}
            yield force[k] / ceiling, words | {"most": ceiling}


@rule(
    "the motion leads the tip of arm '{name}' at {speed:.3g} m/s at t = {t:.3g} s, above "
    "safety.speed_ceiling = {most:.3g} m/s, at which the arms are stopped; command a slower "
    "motion, or raise speed_ceiling to what task and robot permit",
    1.0,
)
def speed_ceiling(task: Task) -> Values:
    """Largest speed of each arm's tip by V_D, divided by the ceiling of the speed.

    Args:
        task: task to be checked.

    Yields:
        Value that the rule compares with its limits, and the words of its sentence.
    """
    ceiling = task.safety.speed_ceiling
    V = task.commanded
    if not len(V) or not ceiling < np.inf:
        return
    axis = task.poses[:, 3:6]  # vector part of the quaternion
    for arm, grasp in zip(task.chain.arms, task.chain.grasps, strict=True):
        point = grasp.X_TO.inverse().translation  # tip in the object's frame
        # the lever R p of all poses at once, by the quaternion's rotation formula
        first_order = 2.0 * np.cross(axis, point)
        lever = point + task.poses[:, 6:] * first_order + np.cross(axis, first_order)
        speeds = np.linalg.norm(V[:, :3] + np.cross(V[:, 3:], lever), axis=1)
        k = speeds.argmax()
        words = {"name": arm.name, "speed": speeds[k], "t": task.times[k], "most": ceiling}
        yield speeds[k] / ceiling, words


@doubt(
    "the motion leads the object {mm:.0f} mm {way} the surface of contact '{name}', which "
    "does not permit it: that part is not followed; give a direction along the surface, such as "
    "common_tangent, and press with force",
    0.005,
)
def lifted(task: Task) -> Values:
    """Change of a gap (m) by the motion while the contact is to be maintained.

    Of a contact that becomes active later on, the change is counted from the gap at that time. At
    most some hundred references are compared; contacts with moving bodies are not.

    Args:
        task: task to be checked.
    """
    ticks = np.flatnonzero(task.times >= task.kept_from)
    ticks = ticks[:: max(1, len(ticks) // 100)]
    for i, pair in enumerate(task.pairs):
        is_closed = np.any(task.forces[ticks][:, task.owners == i] > 0.0, axis=1)
        is_closed = is_closed | task.bound  # a contact that is not bound opens when its force ends
        if task.active is not None:
            is_closed = np.asarray(task.active[ticks, i] != 0.0)
        gaps = np.array([pair.gaps(pin.XYZQUATToSE3(X)) for X in task.poses[ticks[is_closed]]])
        if task.rests[i] and len(gaps):
            if task.active is not None:
                first = _begin_of_stretches(is_closed)
                touches_at_start = (first == 0) & is_closed[0]
                gaps = np.where(touches_at_start[:, None], gaps, gaps - gaps[first])
            largest = np.abs(gaps).max(initial=0.0)
            depth = -np.min(gaps, initial=0.0)
            height = np.max(gaps, initial=0.0)
            yield largest, {"way": "into" if depth >= height else "off", "name": pair.name}


def _begin_of_stretches(flags: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Index, among the set flags, of the first flag of the stretch that each set flag belongs to.

    Args:
        flags: (k,) flag of each checked reference.

    Returns:
        (m,) indices, m the number of set flags.
    """
    is_first = flags & ~np.append(False, flags[:-1])
    index = np.cumsum(flags)[is_first] - 1
    return np.asarray(index[np.cumsum(is_first)[flags] - 1])


@rule("{names}, active together from t = {t:.3g} s on, cannot be controlled: {why}")
def together(task: Task) -> Values:
    """Find named sets of contacts with which no tick can be computed, at the start of the task.

    For each set a tick is computed with the forces desired when it is first named.

    Args:
        task: task to be checked.

    Yields:
        1 for each set whose tick is HELD, with the words of the finding.
    """
    if task.active is None or task.trial is None:
        return
    _, first = np.unique(task.active, axis=0, return_index=True)
    for k in np.sort(first):
        controller, measured = task.trial()
        reference = Reference(task.state.X_WO, alpha_d=task.forces[k], active=task.active[k])
        controller.tick(measured, reference)
        if controller.status is Status.HELD:
            names = " and ".join(
                task.pairs[i].name for i in np.flatnonzero(task.active[k]).tolist()
            )
            words = {"names": names or "no contact", "t": task.times[k], "why": controller.reason}
            yield 1.0, words


@doubt(
    "contact '{name}' becomes active at t = {t:.3g} s, where the motion has it {mm:.0f} mm away "
    "from what it touches, and is taken as closed at once; {cure}",
    0.005,
)
def far_off(task: Task) -> Values:
    """Gap (m) of contacts that become active later on and are not approached.

    Args:
        task: task to be checked.

    Yields:
        Largest gap of such a contact at the desired pose of the instant at which it is named
        active, with the words of the finding.
    """
    for i, pair in enumerate(task.pairs if task.active is not None else ()):
        assert task.active is not None
        is_approached = not task.bound and pushes_only(pair)
        beginnings = np.flatnonzero(np.diff(task.active[:, i]) > 0.0) + 1
        for k in beginnings if task.rests[i] and not is_approached else ():
            gap = np.abs(pair.gaps(pin.XYZQUATToSE3(task.poses[k]))).max(initial=0.0)
            cure = "lead the object there before"
            if pushes_only(pair):
                cure += ", or have it approached (control.life)"
            yield gap, {"name": pair.name, "t": task.times[k], "cure": cure}


@doubt(
    "at t = {t:.3g} s the motion leads the object {mm:.1f} mm into what contact '{name}' touches, "
    "which is not active then: it is pressed with a force that nothing controls; lead the object "
    "off, or make the contact active",
    0.001,
)
def uncontrolled(task: Task) -> Values:
    """Overlap (m) of known contacts that push and are not active, at rest and in range.

    Args:
        task: task of which the motion is compared with the contacts.
    """
    for i, pair in enumerate(task.pairs if task.active is not None else ()):
        assert task.active is not None
        looks = np.flatnonzero(task.active[:, i] == 0.0)
        looks = looks[:: max(1, len(looks) // 100)]
        if task.rests[i] and pushes_only(pair) and len(looks):
            gaps = [np.min(pair.gaps(pin.XYZQUATToSE3(X))) for X in task.poses[looks]]
            k = np.argmin(gaps)
            yield -gaps[k], {"name": pair.name, "t": task.times[looks[k]]}


@rule(
    "X_WD moves by {share:.3g} times V_D × dt: references seem to be spaced {spacing:.3g} ms, and "
    "the controller's period is {dt:.3g} ms; space them by controller.dt, or give V_D in m/s and "
    "rad/s",
    SPACING_DOUBTFUL,
    SPACING_REFUSED,
)
def spacing(task: Task) -> Values:
    """Logarithm (absolute value) of the ratio of the rate of X_WD and V_D, if it is constant.

    A constant ratio other than 1 means that references are spaced by another period than dt, or
    that V_D has another unit.

    Args:
        task: task to be checked.

    Yields:
        Value that the rule compares with its limits, and the words of its sentence.
    """
    dt = 1e3 * task.dt
    for _, share in _moving_parts(task, _A_FACTOR):
        yield abs(np.log(share)), {"share": share, "spacing": share * dt, "dt": dt}


@rule(
    "V_D is up to {off:.3g} {unit} off the rate of X_WD, which reaches {speed:.3g} {unit}: "
    "it would lead the object {value:.3g} {length} off; give V_D as the time derivative of X_WD, "
    "and A_D as that of V_D",
    LAG_DOUBTFUL,
    LAG_REFUSED,
)
def contradiction(task: Task) -> Values:
    """Deviation (m, rad) of the object from X_WD by a V_D that is another motion."""
    return _deviations_by_rate(task, _ANOTHER)


@doubt(
    "V_D is zero while X_WD moves at up to {speed:.3g} {unit}: the object follows {value:.3g} "
    "{length} behind; give V_D as the time derivative of X_WD, and A_D as that of V_D",
    LAG_DOUBTFUL,
)
def lag(task: Task) -> Values:
    """Lag (m, rad) of the object behind X_WD if V_D is zero."""
    return _deviations_by_rate(task, _LEFT_OUT)


def _deviations_by_rate(task: Task, relation: str) -> Values:
    """Deviations K_d/K_p |rate − V_D| (m, rad) of the parts of V_D with a relation to the rate.

    The motion law a_u = … + K_d (V_D − V) + K_p e balances a wrong V_D by this error e. The largest
    `JUMPS` values are left out, because X_WD may jump there.

    Args:
        task: task whose references are judged.
        relation: `_LEFT_OUT`, `_A_FACTOR` or `_ANOTHER`, the relation of V_D and the rate of X_WD.
    """
    motion = task.gains.motion
    for part, _ in _moving_parts(task, relation):
        rates = task.rates[:, part]
        differences = np.linalg.norm(rates - task.twists[:, part], axis=1)
        if motion.stiffness == 0.0 or len(differences) <= JUMPS:
            continue
        difference = float(np.sort(differences)[-JUMPS - 1])
        speed = float(np.sort(np.linalg.norm(rates, axis=1))[-JUMPS - 1])
        is_linear = part.start == 0
        words = {
            "unit": "m/s" if is_linear else "rad/s",
            "length": "m" if is_linear else "rad",
            "off": difference,
            "speed": speed,
        }
        yield difference * motion.damping / motion.stiffness, words


def _moving_parts(task: Task, relation: str) -> Iterator[tuple[slice, float]]:
    """Yield the moving parts (linear, angular) in which V_D and the rate of X_WD have a relation.

    Args:
        task: task whose references are judged.
        relation: relation that is searched for: `_LEFT_OUT`, `_A_FACTOR` or `_ANOTHER`.

    Yields:
        Slice of (6,), and the factor s of rate = s V_D by least squares over all checked
        references; 0 if V_D is zero, or is at right angles to the rate, which is another motion.
    """
    for part in (slice(0, 3), slice(3, 6)):
        rates = task.rates[:, part]
        V = task.twists[:, part]
        size = norm(rates)
        if size <= 1e-9 * len(rates) or not np.isfinite(size):
            continue
        factor = float((rates * V).sum() / (V * V).sum()) if V.any() else 0.0
        if not V.any():
            own_relation = _LEFT_OUT
        elif factor > 0.0 and norm(rates - factor * V) < SAME_RATE * size:
            own_relation = _A_FACTOR
        else:
            own_relation = _ANOTHER
        if own_relation == relation:
            yield part, factor
