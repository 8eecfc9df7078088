"""Which readings are believed, before a tick and after it.

Before: a rotation that is none, wrenches beyond what the sensors measure, joints that jump,
wrenches too old. Such a tick is not computed, see `safety`; the next one may be.
During: speeds of an approach, which may read too little.
After: encoders that stand still though their joints are pushed, speeds that are not those of the
positions or do not add up to them, wrists and packets that repeat themselves. The arms are stopped.
"""

from __future__ import annotations

from osc_contact.law.jit import inner, leaf
from osc_contact.law.phases import APPROACHING
from osc_contact.law.six import dot6
from osc_contact.law.tables import (
    DISAGREE,
    FROZEN,
    JUMPED,
    NO_REASON,
    NO_ROTATION,
    OUT_OF_RANGE,
    STUCK,
    WRENCH_TIMEOUT,
    WRIST_FROZEN,
)

__all__ = ["check_readings", "check_sensors", "compare_speeds", "jumped"]

_ROUND = 1e-4  #: by how much the rows of a rotation may differ from orthonormal ones
_GAIN = 0.21  #: share of `stuck_speed` that one tick can tell: slow encoders repeat readings
_LAG = 0.02  #: s, of the low-pass of speeds that disagree
_NOISE = 0.02  #: rad, m: joints may jump by as much, whatever their speed limits
_FORGET = 0.5  #: s in which a drift between positions and speeds is forgotten
_SCALE = 0.05  #: share of a speed by which it may be wrong
_LATE = 0.01  #: s by which speeds may be late
_GONE = 0.25  #: of `position_drift`; joints must show so much of a speed that lasts
_AGREE = 0.2  #: of the speed of an approach, by which speeds may read less than positions show


@inner
def check_readings(chain, arms, table, memory, kept, q, v, wrenches, X_WD):
    """Whether readings and reference are credible; a reason.

    Args:
        kept: readings of the last tick. q, v: (n,) positions and speeds.
        wrenches: (arms, 6) readings (N, N m). X_WD: (4, 4) desired pose.
    """
    if not _is_rotation(X_WD):
        return NO_ROTATION
    if memory.wrench_missing != 0:
        if memory.has_wrench == 0 or (memory.wrench_age + 1) * chain.period > chain.wrench_timeout:
            return WRENCH_TIMEOUT
    else:
        for k in range(chain.n_arms):
            for i in range(6):
                most = chain.force_range if i < 3 else chain.torque_range
                if abs(wrenches[k, i]) > most and arms[k].sensor_joint >= 0:
                    memory.culprit = k
                    return OUT_OF_RANGE
    for j in range(chain.n_joints):
        fast = abs(v[j]) > chain.plausible_speed * table[j].speed_max
        if fast or (memory.compared != 0 and jumped(chain, table[j], memory, kept[j], q[j])):
            memory.culprit = j
            return JUMPED
    return NO_REASON


@leaf
def jumped(chain, row, memory, before, now):
    """Whether a joint has moved faster than it can since it was read last.

    Args:
        row: JOINT row. before, now: its position at the last tick and at this one (m, rad).
    """
    room = chain.plausible_speed * row.speed_max * chain.period
    return abs(now - before) > _NOISE + room * (1 + memory.faults)


@leaf
def _is_rotation(X):
    """R Rᵀ = 1 and det R = 1, but for `_ROUND`."""
    worst = 0.0
    for i in range(3):
        for j in range(i + 1):
            s = X[i, 0] * X[j, 0] + X[i, 1] * X[j, 1] + X[i, 2] * X[j, 2]
            worst = max(worst, abs(s - (1.0 if i == j else 0.0)))
    x = X[0, 1] * X[1, 2] - X[0, 2] * X[1, 1]
    y = X[0, 2] * X[1, 0] - X[0, 0] * X[1, 2]
    z = X[0, 0] * X[1, 1] - X[0, 1] * X[1, 0]
    return worst < _ROUND and x * X[2, 0] + y * X[2, 1] + z * X[2, 2] > 0.0


@inner
def compare_speeds(chain, memory, owners, contacts, columns, column_memory, work):
    """Approaches believe positions, low-passed, where NᵀV_rel is less than they show.

    Speeds that read too little would drive an object into its face ever faster. The twist that
    positions show is that from the last tick's X_WO to this one's.

    Args:
        chain, memory, work: records; `work.speed` (r,) may be raised. owners: (n,) COLUMN.
        contacts: (contacts,) CONTACT_MEMORY. columns: (n,) COLUMN_WORK. column_memory: (n,)
            COLUMN_MEMORY; shown and told follow NᵀV_rel of positions and of speeds.
    """
    dt, V, X, last = chain.period, work.y, work.X_WO, memory.X_WO
    k = dt / (_LAG + dt)
    for i in range(3):
        V[i], V[3 + i] = (X[i, 3] - last[i, 3]) / dt, 0.0
        a, b = (i + 1) % 3, (i + 2) % 3
        for j in range(3):  # half of R Rᵀ of the last tick less its transpose
            V[3 + i] += 0.5 * (X[b, j] * last[a, j] - X[a, j] * last[b, j]) / dt
    for a in range(work.rank):
        j = columns[int(work.keep[a])].chosen
        row, speed = column_memory[j], work.speed[a]
        if row.known == 0 or memory.fresh == 0:
            row.shown = row.told = speed
            continue
        row.shown += k * (dot6(columns[j].N, V) - work.V_N[a] - row.shown)
        row.told += k * (speed - row.told)
        short = row.shown - row.told > _AGREE * chain.approach_speed
        if short and contacts[owners[j].contact].phase == APPROACHING:
            work.speed[a] = row.shown


@leaf
def check_sensors(chain, arms, table, work, memory, joints, kept, last_wrenches, q, v, wrenches):
    """What a computed tick shows of its sensors; a reason to stop.

    `kept` and `last_wrenches` take the readings.

    A joint whose encoder reads the very same while it is told to gain more than a share of its
    speed limit is stuck. Speeds disagree with positions where q̇ − Δq/Δt, low-passed, is more than
    a share of the limit. Wrists in contact that read the same for too long are frozen; where all
    readings do, a packet repeats itself. What both add up to drifts apart,

        d ← d + (q̇ − Δq/Δt − d/T) Δt,

    where |d| is more than `position_drift` and what a small error of scale and delay of q̇ explain.

    Args:
        kept, last_wrenches: readings of the last tick. q, v: (n,) positions and speeds.
        wrenches: (arms, 6) readings (N, N m).
    """
    n, reason, dt = chain.n_joints, NO_REASON, chain.period
    known = memory.compared != 0 and memory.faults == 0  # readings of the last tick are there
    same, late = known, memory.frozen * dt > chain.frozen_time
    still = known
    for k in range(chain.n_arms):
        alike = known
        for i in range(6):
            alike = alike and last_wrenches[6 * k + i] == wrenches[k, i]
            last_wrenches[6 * k + i] = wrenches[k, i]
        same = same and alike
        count = 6 * chain.n_arms + k
        last_wrenches[count] = last_wrenches[count] + dt if alike else 0.0
        if last_wrenches[count] > chain.frozen_time and work.rank > 0 and arms[k].sensor_joint >= 0:
            reason, memory.culprit = WRIST_FROZEN, k
    for j in range(n):
        step, row = q[j] - kept[j], table[j]
        still = still and step == 0.0 and v[j] == kept[2 * n + j]
        gained = min(abs(joints[j].acceleration) * dt, _GAIN * chain.stuck_speed * row.speed_max)
        kept[3 * n + j] = kept[3 * n + j] + gained if step == 0.0 and known else 0.0
        most = 2.0 * row.speed_max
        error = min(max(v[j] - step / dt, -most), most) if known else 0.0
        if memory.compared == 0:
            kept[4 * n + j] = kept[5 * n + j] = 0.0
        kept[4 * n + j] += (error - kept[4 * n + j]) * dt / (_LAG + dt)
        if kept[3 * n + j] > chain.stuck_speed * row.speed_max:
            reason, memory.culprit = STUCK, j
        elif abs(kept[4 * n + j]) > chain.speed_error * row.speed_max:
            reason, memory.culprit = DISAGREE, j
        drift = (kept[5 * n + j] + error * dt) * (1.0 - dt / _FORGET)
        explained = _SCALE * dt * abs(v[j])
        drift = max(drift - explained, 0.0) if drift > 0.0 else min(drift + explained, 0.0)
        kept[5 * n + j] = drift
        if abs(drift) > chain.position_drift + _LATE * abs(v[j]):
            reason, memory.culprit = DISAGREE, j
        kept[j], kept[2 * n + j] = q[j], v[j]
    memory.compared = memory.has_wrench = 1
    memory.still = memory.still + 1 if still else 0
    for j in range(n if memory.still * dt > chain.frozen_time else 0):
        if abs(v[j]) * memory.still * dt > _GONE * chain.position_drift:
            reason, memory.culprit = DISAGREE, j
    memory.frozen = memory.frozen + 1 if still and same else 0
    return FROZEN if still and same and late else reason
