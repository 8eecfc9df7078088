"""Contact phases: which contacts are open, approached or closed, and what that means for the law.

    OPEN ── a force is desired ─▶ APPROACHING ── contact made ──▶ CLOSED
     ▲                             │      ▲                         │
     └──── no force is desired ────┘      └────── contact lost ─────┤
     └──────────────────── no force is desired ─────────────────────┘

An open contact is out of N: its column is free motion. A closed one is in N under the law of
fig. 5. An approaching one is in N too, but in place of the force law one of speeds moves it towards
its face, α_u = K_a (e + K ∫e dt) with e = v_a − NᵀV_rel: a guarded move, which meets the face with
K_a v_a beside what its integral has learned of the weight. This passes into the force law once
contact is made. One that was lost goes back faster to where it was: what it has moved away is
known. So N does not change at the moment of impact, and every magnitude of a contact to be made is
measured by the filter of fig. 5.

A tick ends with `low_pass`; the next begins with `advance_phases`, which judges what that left, and
`set_goals`; where no tick was computed since, only `set_goals` is called. Which contacts are active
may be given instead of following from desired forces, see `active_set`.
"""

from __future__ import annotations

from math import inf

from osc_contact.law.algebra import lu_solve
from osc_contact.law.jit import inner, leaf, local
from osc_contact.law.records import body_of, contact_of
from osc_contact.law.vectors import fill

#: Out of N; in N, in a guarded approach; in N under force control.
OPEN, APPROACHING, CLOSED = range(3)
_CHANGES = 0.1  #: s after a change of phase for which torques go gently
_GENTLER = 0.45  #: times the rate after that, where active contacts are named: they change often
APPROACH_GAIN = 10.0  #: 1/s; of the integral of an approach
_SLOW = 0.25  #: share of their speed limits below which joints are not fast
#: 1/s, m/s: the way back to where contact was lost
_RETURN = 5.0
_FASTEST = 0.1
#: of v_a: contact is made where an approach is slower; s of force after which also if it is not
_SLOWED = 0.5
_SOFT = 0.5
_FELT = 1.5  #: times what wrists alone read; no more of an impact counts
_NOISE = 0.05  #: s in which the noise of a force is learned, above which contact must be felt
_GENTLE = 0.5  #: of what counts as contact: with so much an approach at v_a pushes to gain speed


@inner
def low_pass(t, independent):
    """Take in what a tick has measured; `net` becomes what is known of the contact force alone.

    The filter of fig. 5 puts Nᵀa_rel = n_γ. An object that leaves its face, or flies towards it,
    has Nᵀa_rel = n_γ + d(NᵀV_rel)/dt, and shows a contact force that is none: that of the parts
    outboard of the sensors, D⁻¹ d(NᵀV_rel)/dt. It is taken away, both terms through the same first
    order low-pass, which makes the derivative one of measured speeds. Contacts do not pull: what
    seems to is noise, of half the size.

    Args:
        independent: whether these are all in N; if not, inertia counts as 0.
    """
    work = t.work
    columns = t.memory.columns
    r = work.rank if independent else 0
    dt = work.dt
    D = local(6, 6)
    b = local(1, 6)
    k = dt / (t.model.lag + dt)
    for a in range(r):
        j = work.chosen[a]
        row = columns[j]
        b[0, a] = k * (work.speeds[j] - row.filtered_speed) / dt if row.known else 0.0
        fill(D[a], work.mobility[a])
    solved = lu_solve(D, r, b, 1)
    for j in range(t.model.n_columns):
        row = columns[j]
        if row.known == 0:
            row.force = row.alpha
            row.filtered_speed = row.speed
        row.force += k * (row.alpha - row.force)
        row.filtered_speed += k * (row.speed - row.filtered_speed)
        touch = work.columns[j].touch if work.here[j] else 0.0
        explained = work.columns[j].explained if work.here[j] else 0.0
        row.touch = row.touch + k * (touch - row.touch) if row.known else touch
        row.explained = row.explained + k * (explained - row.explained) if row.known else explained
        row.known = 1 if work.here[j] else 0
        row.net = row.force if work.here[j] else 0.0
    if solved:
        for a in range(r):
            columns[work.chosen[a]].net -= b[0, a]
    for j in range(t.model.n_columns):
        row = columns[j]
        pulls = max(row.force - row.net - row.alpha, 0.0) if work.here[j] else 0.0
        row.noise += dt / (_NOISE + dt) * (2.0 * pulls - row.noise)


@inner
def predict_force(t, row, commanded, limited, dt):
    """What a contact should read: the force commanded of it `rise` ago, or now where that is less.

    Args:
        row: COLUMN_MEMORY of a column in N. commanded: the force command α_s of this tick
        (N). limited: whether motors were at their limits: then no more than an approach
        is expected. dt: s since the last tick.
    """
    model = t.model
    late = row.predicted + dt / (model.rise + dt) * (commanded - row.predicted)
    row.predicted = min(commanded, late)
    if limited:
        row.predicted = min(row.predicted, model.approach_damping * model.approach_speed)


@inner
def monitor(limits, row, force, speed, dt, dwell, more):
    """Contact or no contact, from the paper's own signal: projected force and power (figs. 6, 7).

    While a contact holds, the power of the projected force is zero: α_k (NᵀV_rel)_k = 0. A
    collision is a burst of it. Force is judged with hysteresis; power only around the moment when
    contact is made, so that noisy velocities raise no alarm while it lasts.

    Args:
        row: COLUMN_MEMORY; changed are low_for, high_for: s since the force went low, or high;
            burst: W, the most since then, or since contact was made; armed_for: s in which a
            collision may still be found; closed; and collision: whether one began at this tick.
        limits: force_on, force_off: N; made above the first, lost `more` (N) above the second or
            below. power: W; more than this (in size) is a collision. window: s after contact is
            made in which one is looked for. patience: s of low force until contact is lost.
            leaving: m/s; what leaves its face faster has no contact, whatever the force is.
        force: (N). speed: NᵀV_rel (m/s). dt: the tick (s). dwell: s of high force until contact is
            made.
    """
    away = speed < -limits.leaving
    low = away or force < limits.force_off + more
    high = force > limits.force_on and not away
    row.low_for = row.low_for + dt if low else 0.0
    row.high_for = row.high_for + dt if high else 0.0
    before = row.closed != 0
    lost = before and row.low_for > limits.patience
    closed = (before or row.high_for > dwell) and not lost
    row.armed_for = max(row.armed_for - dt, 0.0) if before else limits.window
    row.burst = max(row.burst, abs(force * speed)) if closed or row.high_for > 0.0 else 0.0
    collision = closed and row.armed_for > 0.0 and row.burst > limits.power
    if collision:
        row.armed_for = 0.0
    row.closed = closed
    row.collision = collision


@inner
def advance_phases(t):
    """The phases of a tick, from what the last one measured and what is desired now.

    Returns:
        Whether other contacts than in the last tick are in N.
    """
    model = t.model
    dt = t.work.dt
    changed = False
    push = model.approach_damping * model.approach_speed
    for c in range(model.n_contacts):
        contact = t.memory.contacts[c]
        pushes = model.bodies[c].pushes != 0
        before = contact.phase
        desired = False
        some_closed = False
        all_closed = True
        for j in range(model.n_columns):
            if model.columns[j].contact != c:
                continue
            row = t.memory.columns[j]
            goal = t.work.goal[j]
            dwell = model.dwell
            more = -inf  # too little to be distinguished from nothing
            if row.predicted > model.force_on:
                more = model.lost_share * max(row.predicted - push, 0.0)
            force = row.net
            if row.closed == 0:  # sensors that fail look like an impact, to wrists or to speeds
                flies = row.speed > _SLOWED * model.approach_speed and row.high_for < _SOFT
                dwell = inf if flies else model.dwell
                force = min(row.net, _FELT * row.force) - row.noise
                if row.explained > 0.0:  # others are closed: more than their friction
                    force = min(force, row.touch - row.explained)
            monitor(model, row, force, row.speed, dt, dwell, more)
            if before == OPEN:
                row.closed = 0
                row.collision = 0
                contact.held = 0
            elif row.high_for > model.rise:
                contact.held = 1
            desired = desired or goal > 0.0
            some_closed = some_closed or row.closed != 0
            light = goal <= model.force_on  # too little to be distinguished from nothing
            all_closed = all_closed and (light or row.closed != 0)
        wanted = desired or not pushes
        if t.input.chosen_set:  # which `active_set` opens and takes in
            wanted = before != OPEN
        phase = CLOSED
        if not wanted:
            phase = OPEN
        elif pushes and not (some_closed and all_closed):
            phase = APPROACHING
        contact.since = contact.since + dt if phase == before else 0.0
        contact.phase = phase
        changed = changed or (phase != OPEN) != (contact.active != 0)
        known = before != OPEN and phase != OPEN
        known = known and not (phase == CLOSED and contact.since > model.rise)
        left = before == CLOSED and phase == APPROACHING and contact.held != 0
        for j in range(model.n_columns):
            if model.columns[j].contact == c:
                t.work.here[j] = before != OPEN and phase >= before
                row = t.memory.columns[j]
                row.gap = max(row.gap - dt * row.speed, 0.0) if known else 0.0
                lost = known and (row.time_since_loss > 0.0 or left)
                row.time_since_loss = row.time_since_loss + dt if lost else 0.0
    return changed


@inner
def set_goals(t):
    """How each contact takes part in a tick, and the goals of its forces."""
    model = t.model
    goal = t.work.goal
    for c in range(model.n_contacts):
        contact = t.memory.contacts[c]
        approaching = contact.phase == APPROACHING
        contact.active = contact.phase != OPEN
        contact.gain = 0.0 if approaching else model.force_gain
        contact.damping = model.approach_damping if approaching else model.force_damping
        contact.brake = 0.0 if approaching else model.force_brake
        pushes = model.bodies[c].pushes != 0
        contact.least = model.least_force if pushes and not approaching else -inf
    for j in range(model.n_columns):
        contact = contact_of(t, j)
        row = t.memory.columns[j]
        pushes = body_of(t, j).pushes != 0
        speed = model.approach_speed
        approaching = contact.phase == APPROACHING
        if approaching:
            speed = max(speed, min(speed + _RETURN * row.gap, _FASTEST))
        start = model.approach_damping * speed if pushes else goal[j]
        if approaching:
            gentle = _GENTLE * model.force_on * speed / model.approach_speed
            moving = min(abs(row.filtered_speed), abs(row.speed))
            start = min(start, gentle + model.approach_damping * moving)
            if contact.since * model.approach_speed >= model.travel:
                start = 0.0  # it has found nothing and stands still
        risen = 0.0
        if pushes and contact.phase == CLOSED:
            risen = min(contact.since / model.rise, 1.0)
        goal[j] = start + risen * (goal[j] - start)


@inner
def max_speed_ratio(t):
    """The largest share that a joint has of its speed limit."""
    most = 0.0
    for j in range(t.model.n_joints):
        most = max(most, abs(t.work.joints[j].v) / t.model.joints[j].speed_max)
    return most


@inner
def torque_rate(t, share):
    """1/s; no motor torque changes faster than its limit times this.

    Around a change of phase torques change slowly, except where joints are fast: there a late
    torque lets a joint leave its path.

    Args:
        share: as of `max_speed_ratio`.
    """
    model = t.model
    rate = model.torque_rate
    slow = min((1.0 - share) / (1.0 - _SLOW), 1.0)
    gently = model.phase_rate
    if t.memory.chosen_set:
        gently *= _GENTLER
    changes = model.phased or t.memory.chosen_set
    for c in range(model.n_contacts if changes and slow > 0.0 else 0):
        if t.memory.contacts[c].since < _CHANGES:
            rate = min(rate, gently / (slow * slow))
    return rate


@inner
def limit_changes(t, begun):
    """Give out `tau`, no further from the last torques than motors may change in a tick.

    Args:
        begun: whether there are last torques.
    """
    work = t.work
    model = t.model
    rate = torque_rate(t, max_speed_ratio(t))
    for j in range(model.n_joints):
        motor = model.joints[j].motor
        if motor >= 0:
            work.step[motor] = rate * model.period * model.joints[j].tau_max
    slew(work.tau, t.memory.torques, work.step, begun)


@inner
def slew(tau, last, step, begun):
    """Go straight from `last` to `tau`, no motor further than its `step`; both become that.

    Args:
        tau, last: desired torques, those of the last tick (N m, N). step: > 0, likewise.
        begun: whether there are last torques.
    """
    share = 0.0
    for i in range(len(tau) if begun else 0):
        share = max(share, abs(tau[i] - last[i]) / step[i])
    for i in range(len(tau)):
        if share > 1.0:
            tau[i] = last[i] + (tau[i] - last[i]) / share
        last[i] = tau[i]


@leaf
def collect(seconds, dt, violated):
    """Seconds of evidence after one tick more.

    Args:
        seconds: so far. dt: period (s). violated: whether this tick is evidence.
    """
    return seconds + dt if violated else max(seconds - dt, 0.0)
