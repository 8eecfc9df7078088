"""Ceilings: absolute limits of contact forces, wrist forces and tip speeds.

Ceilings do not depend on the present command, unlike the limits of `safety`. The ceiling of a
contact limits its measured force; that of a wrist limits its measured force less weight and inertia
of the bodies outboard of it and of the arm's share of the object; that of a tip limits its speed.
If the largest commands are not known in advance, ceilings of forces rise with them: they are
`contact_headroom` or `wrist_headroom` times the largest command so far.

The wrist of a single arm with contacts of which none is active bears nothing but weight and
inertia. Above its ceiling it has met a body where the model has none, or a contact was released
that still presses; an arm that moves on presses harder with each millisecond, and is stopped after
`SURE`. Several arms have all of `ceiling_time`: they also bear what they squeeze, and what errors
of their closed chain press.
"""

from __future__ import annotations

from math import sqrt

from osc_contact.law.arm_motion import place_point
from osc_contact.law.jit import inner, leaf
from osc_contact.law.joint_friction import LAG
from osc_contact.law.phases import SURE, collect
from osc_contact.law.reasons import NO_REASON, declare_reason
from osc_contact.law.records import WRISTS
from osc_contact.law.vectors import (
    add3,
    dot3,
    fill3,
    linear,
    minus3,
    scaled3,
    velocity_at,
)

CONTACT_ABOVE_CEILING = declare_reason(
    "CONTACT_ABOVE_CEILING",
    70,
    "{contact}: {reached:.3g} N was read, above the ceiling of {ceiling:.4g} N (contact_ceiling) "
    "for longer than ceiling_time = {safety.ceiling_time:g} s",
)
WRIST_ABOVE_CEILING = declare_reason(
    "WRIST_ABOVE_CEILING",
    71,
    "the wrist of arm '{arm}' bears {reached:.3g} N beside weight and inertia, above the ceiling "
    "of {ceiling:.4g} N (wrist_ceiling) for longer than ceiling_time = {safety.ceiling_time:g} s",
)
FREE_WRIST_ABOVE_CEILING = declare_reason(
    "FREE_WRIST_ABOVE_CEILING",
    73,
    "the wrist of arm '{arm}' bears {reached:.3g} N beside weight and inertia while no contact is "
    "active, above the ceiling of {ceiling:.4g} N (wrist_ceiling): a body that the model does not "
    "have there, or a contact that was released too early",
)
TIP_ABOVE_CEILING = declare_reason(
    "TIP_ABOVE_CEILING",
    72,
    "the tip of arm '{arm}' moves at {reached:.3g} m/s, above the ceiling of {ceiling:.4g} m/s "
    "(speed_ceiling) for longer than ceiling_time = {safety.ceiling_time:g} s",
)


@inner
def watch_ceilings(t):
    """Return a reason if a contact, a wrist or a tip has been above its ceiling for too long.

    A ceiling is an absolute limit of a contact force or wrist force (N), or of the speed of a tip
    (m/s); too long is more than `ceiling_time` (s), of the wrist of a single arm more than `SURE`
    (s) while no contact is active (`_is_pressed_while_free`). Time below a ceiling is subtracted
    from the time above it, as for the limits of `safety`. If wrists were not read in this tick,
    their time does not change. Updates in MEMORY `over_contact`, `over_wrist`, `over_free`,
    `over_tip` (s), the largest commands `largest_force`, `largest_sum` (N), and the fields of
    `_follow_centre`; fills `culprit` (column or arm concerned), `reached` and `ceiling` (N, m/s). A
    ceiling of force is `contact_ceiling` or `wrist_ceiling` (N), at least the headroom times the
    largest command so far.

    Args:
        t: Tick after `command`.

    Returns:
        `NO_REASON`, `CONTACT_ABOVE_CEILING`, `WRIST_ABOVE_CEILING`, `FREE_WRIST_ABOVE_CEILING` or
        `TIP_ABOVE_CEILING`.
    """
    model = t.model
    memory = t.memory
    _note_commands(t)
    ceiling = max(model.contact_ceiling, model.contact_headroom * memory.largest_force)
    column, force = _largest_force(t)
    memory.over_contact = collect(memory.over_contact, t.work.dt, force > ceiling)
    if force > ceiling and memory.over_contact > model.ceiling_time:
        return _stop(memory, CONTACT_ABOVE_CEILING, column, force, ceiling)
    rate = _follow_centre(t)  # acceleration of the object's centre of mass
    if memory.wrench_missing == 0 and memory.balanced > 0:
        ceiling = max(model.wrist_ceiling, model.wrist_headroom * memory.largest_sum)
        arm, force = _largest_load(t, rate)
        memory.over_wrist = collect(memory.over_wrist, t.work.dt, force > ceiling)
        if force > ceiling and memory.over_wrist > model.ceiling_time:
            return _stop(memory, WRIST_ABOVE_CEILING, arm, force, ceiling)
        if _is_pressed_while_free(t, force > ceiling):
            return _stop(memory, FREE_WRIST_ABOVE_CEILING, arm, force, ceiling)
    arm, speed = _fastest_tip(t)
    memory.over_tip = collect(memory.over_tip, t.work.dt, speed > model.speed_ceiling)
    if speed > model.speed_ceiling and memory.over_tip > model.ceiling_time:
        return _stop(memory, TIP_ABOVE_CEILING, arm, speed, model.speed_ceiling)
    return NO_REASON


@leaf
def _is_pressed_while_free(t, is_above):
    """Test whether the wrist of a single free arm has been above its ceiling for more than `SURE`.

    Only new readings of the time without an active contact count, each for one period at most:
    forces of a contact that ends are no evidence, and after lost ticks a single reading is not
    enough.

    Args:
        t: Tick, of which `over_free` of MEMORY (s) is updated.
        is_above: whether the wrist is above its ceiling in this tick.
    """
    model = t.model
    memory = t.memory
    is_free = model.n_arms == 1 and model.n_columns > 0 and t.work.rank == 0
    if memory.repeated & WRISTS == 0:
        dt = min(t.work.dt, model.period)
        memory.over_free = collect(memory.over_free, dt, is_above)
    if not is_free:
        memory.over_free = 0.0
    return is_above and memory.over_free > max(SURE, 1.5 * model.period)


@leaf
def _stop(memory, reason, culprit, reached, ceiling):
    """Store culprit and values for the sentence of a reason in MEMORY; return the reason.

    Args:
        memory: MEMORY.
        reason: code of the reason to stop.
        culprit: index of the column of N or of the arm that is above its ceiling.
        reached: measured value above the ceiling (N or m/s).
        ceiling: the ceiling (N or m/s).
    """
    memory.culprit = culprit
    memory.reached = reached
    memory.ceiling = ceiling
    return reason


@leaf
def _note_commands(t):
    """Update `largest_force` and `largest_sum` (N) of MEMORY, the largest commands so far.

    The first is of one contact or squeeze, the second of the sum of all; ceilings rise with them.

    Args:
        t: Tick, of which `alpha_d` of the columns and the desired `squeeze` are read.
    """
    memory = t.memory
    total = 0.0
    for j in range(t.model.n_columns):
        force = abs(t.work.columns[j].alpha_d)
        memory.largest_force = max(memory.largest_force, force)
        total += force
    for bar in range(t.model.n_bars):
        force = abs(memory.squeeze[bar])
        memory.largest_force = max(memory.largest_force, force)
        total += force
    memory.largest_sum = max(memory.largest_sum, total)


@leaf
def _largest_force(t):
    """Find the column of N with the largest magnitude of its measured force `alpha_meas`.

    Args:
        t: Tick.

    Returns:
        Index of the column among all columns of the model, and the magnitude (N); 0 and 0 if no
        contact is active.
    """
    column = 0
    largest = 0.0
    for a in range(t.work.rank):
        force = abs(t.work.alpha_meas[a])
        if force > largest:
            column = t.work.kept[a]
            largest = force
    return column, largest


@leaf
def _follow_centre(t):
    """Acceleration (three numbers, m/s²) of the object's centre of mass, low-passed.

    It is the difference quotient of the velocity, with the low-pass of the joint accelerations in
    `joint_friction`. Updates in MEMORY `centre_rate` (the result) and `centre_speed` (velocity of
    this tick, m/s).

    Args:
        t: Tick.
    """
    memory = t.memory
    velocity = linear(t.work.V_C)
    dt = t.model.period * (1 + memory.gap)
    k = 0.0 if memory.balanced <= 1 else dt / (LAG + dt)
    acceleration = scaled3(1.0 / dt, minus3(velocity, memory.centre_speed))
    rate = add3(memory.centre_rate, k, minus3(acceleration, memory.centre_rate))
    fill3(memory.centre_rate, rate)
    fill3(memory.centre_speed, velocity)
    return rate


@leaf
def carried_force(t, acceleration):
    """Force (three numbers, N) by which each arm carries and accelerates its share of the object.

    Each arm is assumed to bear an equal share of the object's weight and inertia, and of the tare.

    Args:
        t: Tick.
        acceleration: (3,) acceleration of the object's centre of mass (m/s²).
    """
    model = t.model
    mass = model.principal[0] / model.n_arms if model.held else 0.0
    force = scaled3(mass, minus3(acceleration, model.gravity))
    return add3(force, 1.0 / model.n_arms, t.memory.f_tare)


@leaf
def _largest_load(t, acceleration):
    """Find the wrist with the largest force, less that by which it carries the object.

    Of each wrist an equal share of the object's weight and inertial force is subtracted. Reads
    `net` of the arms, the reading of the wrist less weight and inertia of the bodies between it and
    the object.

    Args:
        t: Tick.
        acceleration: (3,) acceleration of the object's centre of mass (m/s²).

    Returns:
        Index of the arm, and the force (N).
    """
    model = t.model
    weight_and_inertia = carried_force(t, acceleration)
    arm = 0
    largest = 0.0
    for k in range(model.n_arms):
        if model.arms[k].sensor_joint < 0:
            continue
        force = minus3(t.work.arms[k].net, weight_and_inertia)
        size = sqrt(dot3(force, force))
        if size > largest:
            arm = k
            largest = size
    return arm, largest


@leaf
def _fastest_tip(t):
    """Find the arm with the fastest tip.

    Reads V of the arms (twists at C), `p_C`, and R and p of the joints.

    Args:
        t: Tick.

    Returns:
        Index of the arm, and the speed of its tip (m/s).
    """
    work = t.work
    arm = 0
    fastest = 0.0
    for k in range(t.model.n_arms):
        arm_row = t.model.arms[k]
        tip = place_point(work.joints[arm_row.tip_joint], arm_row.tip[9:])
        velocity = velocity_at(work.arms[k].V, minus3(tip, work.p_C))
        speed = sqrt(dot3(velocity, velocity))
        if speed > fastest:
            arm = k
            fastest = speed
    return arm, fastest
