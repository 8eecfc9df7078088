"""Contact phases: open, approaching or closed contacts, and their effect on the law.

    OPEN ── a force is desired ─▶ APPROACHING ── contact made ──▶ CLOSED
     ▲                             │      ▲                         │
     └──── no force is desired ────┘      └────── contact lost ─────┤
     └──────────────────── no force is desired ─────────────────────┘

The column of an open contact is not in N, so the object moves freely along it. A closed contact is
in N and controlled by the force law of fig. 5. An approaching contact is in N, too, but a speed law
moves it towards its face, α_u = K_a (e + K ∫e dt) with e = v_a − NᵀV_rel: a guarded move, which
touches the face with the force K_a v_a and the integral, which balances errors of the weight. The
force law follows once contact is made. A contact that was lost returns faster to the place where it
was lost, because the distance since then is measured. Hence N does not change at the moment of
impact, and the force of every contact that is about to close is measured by the filter of fig. 5.

A tick ends with `low_pass`. The next one begins with `advance_phases`, which evaluates the filtered
signals, and `set_goals`; after a tick that was not computed only `set_goals` is called. The user
may name the active contacts; otherwise they follow from the desired forces (`active_set`).
"""

from __future__ import annotations

from math import inf

from osc_contact.law.algebra import lu_solve
from osc_contact.law.jit import inner, leaf, local
from osc_contact.law.records import body_of, contact_of
from osc_contact.law.vectors import add, fill, minus

#: Phases: not in N; in N during a guarded approach; in N under force control.
OPEN, APPROACHING, CLOSED = range(3)
SURE = 0.0025  #: s, least duration of evidence; a single wrong sample does not last so long
_CHANGES = 0.1  #: s after a change of phase during which torques change more slowly
_GENTLER = 0.45  #: further factor of the rate of torques meanwhile, if the user names the contacts
APPROACH_GAIN = 10.0  #: 1/s, gain K of the integral of an approach
_SLOW = 0.25  #: share of the speed limits up to which the torque rate is reduced fully
_RETURN = 5.0  #: 1/s, additional speed of a return per distance since the contact was lost
_SLOWED = 0.5  #: share of v_a; a contact is made once its approach is slower than this
_SOFT = 0.5  #: s of force after which a contact is made even if its approach is not slower
_FACE_SHARE = 0.4  #: share of its predicted force below which a face does not rest on some columns
_FACE_TIME = 0.05  #: s of such a force until this contact is lost: time to find a mirrored wrist
_FELT = 1.5  #: largest net force of an impact, as a multiple of the measured force
_NOISE = 0.05  #: s, time constant of the estimate of a force's noise
_OVERCOME = 2.0  #: push of an approach at rest, as a multiple of the force that it certainly meets
_GENTLE = 0.5  #: share of `force_on` with which an approach at the speed v_a accelerates


@inner
def low_pass(t, independent):
    """Low-pass the measured forces and speeds of the columns; estimate `net` contact forces.

    The filter of fig. 5 assumes that the normal acceleration Nᵀa_rel is n_γ, that of a contact that
    holds. While an object leaves its face or moves freely towards it, d(NᵀV_rel)/dt is added, the
    rate of its normal speed, and the filter returns a spurious force, that of the inertia outboard
    of the sensors, D⁻¹ d(NᵀV_rel)/dt with `mobility` D. It is subtracted; both terms pass the same
    first-order low-pass, so that the derivative is computed from measured speeds. A contact cannot
    pull, so a negative remainder is attributed to noise, whose estimate is twice as large. A closed
    contact is not lost by a single wrong reading: of its columns a negative one counts as the
    opposite of the force expected, `predicted`, at most.

    Fills `filtered_twist` (of the object at O), and of the columns in MEMORY `force` (N) and
    `filtered_speed` (m/s), low-passed; `net`, the force less the spurious one (N); `noise` (N);
    `known` (1: the column is in N); and of an approached column `touch_read`, `touch` (force by the
    wrists alone, with and without the inertial force of the object; N) and `explained` (part of it
    that friction of other contacts may cause; N).

    Args:
        t: Tick, with `speeds` and `mobility` D in WORK.
        independent: whether all active columns are linearly independent; if not, `net` contains the
            inertial force.
    """
    work = t.work
    columns = t.memory.columns
    r = work.rank if independent else 0
    dt = work.dt
    D = local(6, 6)
    b = local(1, 6)  # d(NᵀV_rel)/dt of the kept columns, then the spurious forces D⁻¹ times it
    k = dt / (t.model.lag + dt)
    twist = t.memory.filtered_twist
    fill(twist, add(twist, k, minus(work.V_O, twist)))
    for a in range(r):
        j = work.chosen[a]
        row = columns[j]
        b[0, a] = k * (work.speeds[j] - row.filtered_speed) / dt if row.known else 0.0
        fill(D[a], work.mobility[a])
    is_solved = lu_solve(D, r, b, 1)
    # first-order low-passes of all columns; a column that was not in N begins without a past
    for j in range(t.model.n_columns):
        row = columns[j]
        if row.known == 0:
            row.force = row.alpha
            row.filtered_speed = row.speed
        read = max(row.alpha, -abs(row.predicted)) if row.closed else row.alpha
        row.force += k * (read - row.force)
        row.filtered_speed += k * (row.speed - row.filtered_speed)
        column = work.columns[j]
        touch = column.touch if work.here[j] else 0.0
        explained = column.explained if work.here[j] else 0.0
        row.touch_read = row.touch_read + k * (touch - row.touch_read) if row.known else 0.0
        row.touch = row.touch_read - (column.touch_inertia if work.here[j] else 0.0)
        row.explained = row.explained + k * (explained - row.explained) if row.known else explained
        row.known = 1 if work.here[j] else 0
        row.net = row.force if work.here[j] else 0.0
    if is_solved:
        for a in range(r):
            columns[work.chosen[a]].net -= b[0, a]
    # noise, from remainders that pull
    for j in range(t.model.n_columns):
        row = columns[j]
        pulls = max(row.force - row.net - row.alpha, 0.0) if work.here[j] else 0.0
        row.noise += dt / (_NOISE + dt) * (2.0 * pulls - row.noise)


@inner
def predict_force(t, row, commanded, limited, dt):
    """Update `predicted`, the force (N) expected of a contact.

    It is the smaller one of the commanded force and of that force after a first-order lag `rise`.

    Args:
        t: Tick.
        row: COLUMN_MEMORY of a column in N.
        commanded: α_s of this tick (N).
        limited: whether motors were at their limits; then no more than the force of an approach is
            expected.
        dt: time since the last tick (s).
    """
    model = t.model
    lagging_force = row.predicted + dt / (model.rise + dt) * (commanded - row.predicted)
    row.predicted = min(commanded, lagging_force)
    if limited:
        row.predicted = min(row.predicted, model.approach_damping * model.approach_speed)


@inner
def monitor(limits, row, force, speed, dt, dwell, margin):
    """Detect contact, its loss and collisions from projected force and power (figs. 6, 7).

    While a contact holds, its force α times its speed NᵀV_rel, the power of the projected force, is
    zero. A collision is a burst of power. The force is compared with two thresholds (hysteresis);
    the power is evaluated only shortly after contact is made, so that noisy velocities cause no
    false alarm later.

    Args:
        limits: MODEL, of which are read `force_on` and `force_off` (N): contact is made above the
            first and lost below the second plus `margin`; `power` (W): a larger magnitude is a
            collision; `window` (s): time after contact is made in which collisions are detected;
            `patience` (s): time of low force until contact is lost; `leaving` (m/s): a contact that
            separates faster is lost at any force.
        row: COLUMN_MEMORY, of which are changed `low_for` and `high_for` (s): time of low and of
            high force; `burst` (W): largest power of this contact; `armed_for` (s): remaining part
            of `window`; `closed`; `collision`: whether one begins in this tick.
        force: N.
        speed: NᵀV_rel (m/s).
        dt: time since the last tick (s).
        dwell: time of high force until contact is made (s).
        margin: N, added to `force_off`.
    """
    separates = speed < -limits.leaving
    is_low = separates or force < limits.force_off + margin
    is_high = force > limits.force_on and not separates
    row.low_for = row.low_for + dt if is_low else 0.0
    row.high_for = row.high_for + dt if is_high else 0.0
    was_closed = row.closed != 0
    is_lost = was_closed and row.low_for > limits.patience
    is_closed = (was_closed or row.high_for > dwell) and not is_lost
    row.armed_for = max(row.armed_for - dt, 0.0) if was_closed else limits.window
    row.burst = max(row.burst, abs(force * speed)) if is_closed or row.high_for > 0.0 else 0.0
    collision = is_closed and row.armed_for > 0.0 and row.burst > limits.power
    if collision:
        row.armed_for = 0.0
    row.closed = is_closed
    row.collision = collision


@inner
def advance_phases(t):
    """Update the phases of all contacts from the forces measured last and those desired now.

    A contact that can also pull is CLOSED. One that can only push (`pushes` of its body) is OPEN
    where no force is desired of it, APPROACHING until it is made, then CLOSED. Where the user
    chooses the active contacts (`chosen_set`), open ones stay open here. Columns of N are those of
    all contacts that are not open.

    Fills `phase` and `since` of the contacts, `here` of the columns in WORK, `gap` and
    `time_since_loss` of the columns in MEMORY, and the fields of `_monitor_contact`.

    Args:
        t: Tick.

    Returns:
        True if the set of contacts in N differs from that of the last tick.
    """
    set_changes = False
    for c in range(t.model.n_contacts):
        contact = t.memory.contacts[c]
        pushes = t.model.bodies[c].pushes != 0
        last_phase = contact.phase
        is_desired, is_made = _monitor_contact(t, c)
        takes_part = is_desired or not pushes
        if t.input.chosen_set:  # `active_set` opens and adds contacts
            takes_part = last_phase != OPEN
        phase = CLOSED
        if not takes_part:
            phase = OPEN
        elif pushes and not is_made:
            phase = APPROACHING
        contact.since = contact.since + t.work.dt if phase == last_phase else 0.0
        contact.phase = phase
        set_changes = set_changes or (phase != OPEN) != (contact.active != 0)
        _integrate_gap(t, c, last_phase, phase)
    return set_changes


@inner
def _monitor_contact(t, c):
    """Detect contact and its loss on all columns of one contact, from the forces measured last.

    A closed column is lost where its force `net` (N) stays below `force_off` plus the share
    `lost_share` of its predicted force beyond that of an approach; it cannot be lost while less
    than `force_on` is predicted. Of a column that is not closed, the force has to exceed its noise
    and the part that friction of other contacts explains (`_certain_force`); while it still moves
    fast it cannot be made.

    Reads `goal` (N), `predicted` (N), `speed` (NᵀV_rel, m/s), `high_for` (s of high force) and the
    fields of `_certain_force` of the columns; changes their fields of `monitor`, and of the contact
    `low_for` (s for which the sum of its forces is low) and `held`, which is 1 once a steady force
    was measured since it was OPEN. Of an OPEN contact `held`, and `closed` and `collision` of the
    columns, become 0.

    Args:
        t: Tick.
        c: index of the contact.

    Returns:
        Whether a force is desired of it; and whether contact is made: at least one column is
        closed, and all whose desired force can be distinguished from zero. A face or an edge
        (`face`) rests on any of its columns: one suffices where contact was made before, or while
        it has a steady force for `_SOFT`; but not where the sum of all forces has for `_FACE_TIME`
        been below `force_off` and `_FACE_SHARE` of the predicted ones beyond those of an approach.
    """
    model = t.model
    contact = t.memory.contacts[c]
    approach_force = model.approach_damping * model.approach_speed
    is_desired = False
    some_closed = False
    all_closed = True
    rests = model.bodies[c].face != 0 and contact.phase == CLOSED
    total = 0.0  # force of all columns
    least_total = model.force_off  # what it has to exceed
    for j in range(model.n_columns):
        if model.columns[j].contact != c:
            continue
        row = t.memory.columns[j]
        goal = t.work.goal[j]
        dwell = model.dwell
        margin = -inf  # a smaller force cannot be distinguished from zero, so it cannot be lost
        if row.predicted > model.force_on:
            margin = model.lost_share * max(row.predicted - approach_force, 0.0)
        least_total += _FACE_SHARE * max(row.predicted - approach_force, 0.0)
        total += row.net
        force = row.net
        if row.closed == 0:  # a failing sensor of wrists or speeds resembles an impact
            flies = row.speed > _SLOWED * model.approach_speed and row.high_for < _SOFT
            dwell = inf if flies else model.dwell
            force = _certain_force(row)
        monitor(model, row, force, row.speed, t.work.dt, dwell, margin)
        if contact.phase == OPEN:
            row.closed = 0
            row.collision = 0
            contact.held = 0
        elif row.high_for > model.rise:
            contact.held = 1
        is_desired = is_desired or goal > 0.0
        some_closed = some_closed or row.closed != 0
        if model.bodies[c].face and row.closed and row.high_for > _SOFT:
            rests = True
        is_light = goal <= model.force_on  # such a force cannot be distinguished from zero
        all_closed = all_closed and (is_light or row.closed != 0)
    is_low = contact.phase == CLOSED and total < least_total
    contact.low_for = contact.low_for + t.work.dt if is_low else 0.0
    rests = rests and contact.low_for <= _FACE_TIME
    return is_desired, some_closed and (all_closed or rests)


@leaf
def _certain_force(row):
    """Compute the force (N) that a column of an approached contact certainly has; may be negative.

    It is the force less its noise, without the inertial force of free flight (`net`), and at most
    `_FELT` times the measured one. Beside closed contacts whose friction may hold the object
    (`explained` > 0), it is also at most the force by the wrists alone less the part that this
    friction explains. Of the forces by the wrists with and without the inertial force of the object
    (`touch_read`, `touch`) the smaller one counts: for an object that sticks and slips the inertial
    force follows from speeds that are estimated with a lag.

    Args:
        row: COLUMN_MEMORY, of which `net`, `force`, `noise`, `touch_read`, `touch` and `explained`
            are read.
    """
    force = min(row.net, _FELT * row.force) - row.noise
    if row.explained > 0.0:
        force = min(force, min(row.touch, row.touch_read) - row.explained)
    return force


@inner
def _least_certain_force(t, contact):
    """Compute the least force (N) that certainly opposes the columns of an approached contact.

    It is that of `_certain_force` of the column with the smallest one, at least 0; and 0 unless
    friction of closed contacts may hold the object (`explained` > 0 of all columns).

    Args:
        t: Tick.
        contact: index of the contact.
    """
    least = inf
    for j in range(t.model.n_columns):
        if t.model.columns[j].contact == contact:
            row = t.memory.columns[j]
            least = min(least, _certain_force(row) if row.explained > 0.0 else 0.0)
    return max(least, 0.0)


@inner
def _integrate_gap(t, c, last_phase, phase):
    """Integrate the distance of a contact from its face, and the time since its loss.

    The distance is integrated from the measured speeds of separation while the contact is
    approached, and until `rise` (s) after it has closed; it is at least zero. The time counts from
    a change from CLOSED to APPROACHING of a contact that had a steady force (`held`). Both are zero
    for an open contact, and for one that has been closed for longer than `rise`. Fills, of the
    columns of the contact, `gap` (m) and `time_since_loss` (s) in MEMORY, and `here` in WORK: 1
    where the column remains in N without returning to an earlier phase.

    Args:
        t: Tick.
        c: index of the contact.
        last_phase: its phase in the last tick.
        phase: its phase now.
    """
    model = t.model
    contact = t.memory.contacts[c]
    dt = t.work.dt
    is_known = last_phase != OPEN and phase != OPEN
    is_known = is_known and not (phase == CLOSED and contact.since > model.rise)
    is_loss = last_phase == CLOSED and phase == APPROACHING and contact.held != 0
    for j in range(model.n_columns):
        if model.columns[j].contact == c:
            t.work.here[j] = last_phase != OPEN and phase >= last_phase
            row = t.memory.columns[j]
            row.gap = max(row.gap - dt * row.speed, 0.0) if is_known else 0.0
            is_lost = is_known and (row.time_since_loss > 0.0 or is_loss)
            row.time_since_loss = row.time_since_loss + dt if is_lost else 0.0


@inner
def set_goals(t):
    """Fill the force gains of each contact from its phase, and `goal` (N) of its columns.

    Fills of each contact in MEMORY `active` (1: in N) and the gains of the force law: `gain` K_i
    (1/s), `damping` (N s/m), `brake` κ (1/s), `least` (least command, N). The goal of an
    approaching contact is

        min(K_a v_r, K_a v + `_GENTLE` F_on v_r/v_a + `_OVERCOME` F_c),

    with K_a = `approach_damping` (N s/m) of the speed law, v_r (m/s) the speed at which it
    approaches (v_a = `approach_speed`, or more for a contact that returns over the distance `gap`),
    v its present speed (`slowest_column`), F_on = `force_on` and F_c the force that certainly
    opposes it (`_least_certain_force`): the second term limits its acceleration. The goal is 0 once
    the approach has lasted for `travel` (m) over v_a. That of a closed contact rises from K_a v_a
    to the desired force within `rise` (s). A contact that can also pull keeps its desired force.

    Args:
        t: Tick.
    """
    model = t.model
    goal = t.work.goal
    # gains of the contacts
    for c in range(model.n_contacts):
        contact = t.memory.contacts[c]
        is_approaching = contact.phase == APPROACHING
        contact.active = contact.phase != OPEN
        contact.gain = 0.0 if is_approaching else model.force_gain
        contact.damping = model.approach_damping if is_approaching else model.force_damping
        contact.brake = 0.0 if is_approaching else model.force_brake
        pushes = model.bodies[c].pushes != 0
        contact.least = model.least_force if pushes and not is_approaching else -inf
    # goals of the columns; `start` is the force of the approach
    for j in range(model.n_columns):
        contact = contact_of(t, j)
        row = t.memory.columns[j]
        pushes = body_of(t, j).pushes != 0
        speed = model.approach_speed
        is_approaching = contact.phase == APPROACHING
        if is_approaching:
            speed = max(speed, min(speed + _RETURN * row.gap, model.return_speed))
        start = model.approach_damping * speed if pushes else goal[j]
        if is_approaching:
            # a force little above that of the present speed limits the acceleration
            extra = _GENTLE * model.force_on * speed / model.approach_speed
            extra += _OVERCOME * _least_certain_force(t, model.columns[j].contact)
            present_speed = slowest_column(t, model.columns[j].contact)
            start = min(start, extra + model.approach_damping * present_speed)
            if contact.since * model.approach_speed >= model.travel:
                start = 0.0  # no face within `travel`: the approach ends
        risen_share = 0.0
        if pushes and contact.phase == CLOSED:
            risen_share = min(contact.since / model.rise, 1.0)
        goal[j] = start + risen_share * (goal[j] - start)


@inner
def slowest_column(t, contact):
    """Find the smallest speed |NᵀV_rel| of the columns of a contact (m/s).

    Of each column the smaller one of the low-passed and the last measured speed counts. The result
    determines the goal of all columns of an approached contact: if the goal of each rose with its
    own speed, faster columns would be pushed more, and the object would turn.

    Args:
        t: Tick.
        contact: index of the contact.
    """
    least_speed = inf
    for j in range(t.model.n_columns):
        if t.model.columns[j].contact == contact:
            row = t.memory.columns[j]
            least_speed = min(least_speed, min(abs(row.filtered_speed), abs(row.speed)))
    return least_speed


@inner
def max_speed_ratio(t):
    """Compute the largest ratio |v|/v_max of a joint's speed to its limit, over all joints.

    Args:
        t: Tick, of which v of the joints is read.
    """
    largest = 0.0
    for j in range(t.model.n_joints):
        largest = max(largest, abs(t.work.joints[j].v) / t.model.joints[j].speed_max)
    return largest


@inner
def torque_rate(t, share):
    """Compute the largest rate of the motor torques (1/s, as a multiple of the torque limits).

    It is `torque_rate`. With contact phases or named active contacts it is reduced, for `_CHANGES`
    (s) after a change of phase and while a contact is unloaded, to `phase_rate`, times `_GENTLER`
    if the user names the active contacts; each over x², but not more than `torque_rate`, where x
    falls from 1 at the share `_SLOW` of the speed limits to 0 at the limit: a delayed torque would
    make fast joints deviate from their paths.

    Args:
        t: Tick.
        share: largest ratio of a joint's speed to its limit, from `max_speed_ratio`.
    """
    model = t.model
    rate = model.torque_rate
    x = min((1.0 - share) / (1.0 - _SLOW), 1.0)
    reduced_rate = model.phase_rate
    if t.memory.chosen_set:
        reduced_rate *= _GENTLER
    has_phases = model.phased or t.memory.chosen_set
    if has_phases and x > 0.0:
        for c in range(model.n_contacts):
            contact = t.memory.contacts[c]
            if contact.since < _CHANGES or contact.unloading > 0.0:
                rate = min(rate, reduced_rate / (x * x))
    return rate


@inner
def limit_changes(t, has_last):
    """Limit the change of the motor torques since the last tick to the torque rate.

    The rate (1/s) of `torque_rate` is a multiple of each motor's torque limit. Changes `tau` (n_a,;
    N m, N) of WORK, and stores it as `torques` in MEMORY; fills `step` (n_a,; N m, N), the largest
    changes of the motors in this tick.

    Args:
        t: Tick.
        has_last: whether torques of a last tick exist; without them `tau` is stored unchanged.
    """
    work = t.work
    model = t.model
    rate = torque_rate(t, max_speed_ratio(t))
    for j in range(model.n_joints):
        motor = model.joints[j].motor
        if motor >= 0:
            work.step[motor] = rate * model.period * model.joints[j].tau_max
    slew(work.tau, t.memory.torques, work.step, has_last)


@inner
def slew(tau, last, step, has_last):
    """Move from `last` straight towards `tau` until a motor has changed by its `step`.

        tau ← last + (tau − last)/s,   s = max(1, max_i |tau_i − last_i|/step_i)

    Both `tau` and `last` become the result.

    Args:
        tau: (a,) desired torques (N m, N).
        last: (a,) torques of the last tick (N m, N).
        step: (a,) largest changes (N m, N), > 0.
        has_last: whether torques of a last tick exist; without them `tau` is not limited.
    """
    largest_ratio = 0.0  # of a change to its limit
    if has_last:
        for i in range(len(tau)):
            largest_ratio = max(largest_ratio, abs(tau[i] - last[i]) / step[i])
    for i in range(len(tau)):
        if largest_ratio > 1.0:
            tau[i] = last[i] + (tau[i] - last[i]) / largest_ratio
        last[i] = tau[i]


@leaf
def collect(seconds, dt, violated):
    """Count the time of evidence for a fault: it grows while a condition is violated, else shrinks.

    A short disturbance therefore causes no stop, but a repeated one does.

    Args:
        seconds: time of evidence before this tick (s).
        dt: time since the last tick (s).
        violated: whether the condition is violated in this tick.

    Returns:
        Time of evidence (s) after this tick, ≥ 0.
    """
    return seconds + dt if violated else max(seconds - dt, 0.0)
