"""Test of the encoders of stopped joints by torques that dry friction cannot hold.

The reading of a joint that has been constant since before a stop is that of a joint which friction
or a contact holds, or of a dead encoder, whose joint nothing brakes. Nothing distinguishes them as
long as torques are constant. So each such joint gets an oscillating torque that grows until its
reading changes, at most until it exceeds what friction may hold and moves the joint by steps of an
encoder. An encoder that has read the same until then is dead if the wrist shows that the joint has
moved: it measures the share g of the torque, which accelerates the bodies beyond it,

    g = Σ s Jᵀw / Σ s τ ≈ J_jᵀ(I_out J_j)/M_jj,   τ = A s,

with the oscillation s, its amplitude A, the wrist's wrench w, the Jacobian's column J_j, the
inertia I_out of the bodies beyond the wrist, and the inertia M_jj of the joint. If a contact blocks
the joint, the wrist measures all of the torque (g = 1), if its brake is engaged, none (g = 0).
"""

from __future__ import annotations

from math import cos, pi, sin

from osc_contact.law.jit import inner, leaf
from osc_contact.law.reading import read_wrist
from osc_contact.law.records import ESTIMATED, FAULTY_POSITION, FAULTY_SPEED, SAFE_STOP
from osc_contact.law.sensors import dry_friction
from osc_contact.law.vectors import dot6

_DELAY = 0.02  #: s from the beginning of a stop until the test begins
_CONSTANT = 0.05  #: s of constant readings before the test of a joint, 30 ms of them before a stop
_PERIOD = 0.08  #: s, period of the oscillation
_FEWEST = 10.0  #: least number of ticks in a period
_RISE = 2.0  #: periods in which the torque rises to its largest amplitude A
#: periods after which the test ends; the wrist is compared with the last one, which begins a
#: quarter late: a drift of the wrist's wrench, at a constant rate, does not matter then
_LENGTH = 3.25
_BEYOND = 1.3  #: amplitude A as a multiple of the torque that dry friction may hold
_MOVES = 1.2e-4  #: rad, m, amplitude of the motion of a free joint, beside friction
_SILENT = 0.3  #: share of the free joint's g below which the wrist has measured nothing
_OVER = -1.0  #: `probed` of a joint whose test is over, or that needs none


@inner
def probe_joints(t, arm, k, world):
    """Add the torques that test the encoders of a stopped arm, and mark those that are dead.

    Tested are joints with a motor, up to the wrist sensor, whose speeds are estimated from
    positions, and whose positions have been constant since 30 ms before the stop, or have not
    followed a move of their holds (`sensors`). A joint whose position changes has passed; so has
    one whose motor cannot exert the torque.

    Reads of the joints `rested`, and M, `column` and `outboard` of WORK. Changes `tau` (carrying
    torque; N m, N) of the joints in WORK, and in MEMORY `probed`, `push`, `echo` and `faulty`.

    Args:
        t: Tick in which torques of a hold are computed.
        arm: ARM row.
        k: index of the arm.
        world: (3,) origin of the world, reference point of `column`.
    """
    memory = t.memory
    if memory.state != SAFE_STOP or memory.derived != ESTIMATED:
        return
    age = memory.age * t.model.period
    for j in range(arm.first, arm.sensor_joint + 1 if age > _DELAY else arm.first):
        row = memory.joints[j]
        if row.probed == 0.0:
            row.echo = row.push = 0.0
            is_suspect = row.rested > _CONSTANT and row.faulty & FAULTY_POSITION == 0
            row.probed = 0.0 if is_suspect and t.model.joints[j].motor >= 0 else _OVER
        if row.probed != _OVER:
            _probe_joint(t, arm, k, j, world)


@inner
def _probe_joint(t, arm, k, j, world):
    """Add the torque that tests the encoder of one joint; at the end of the test judge it.

    Args:
        t: Tick.
        arm: ARM row.
        k: index of the arm.
        j: index of the joint.
        world: (3,) origin of the world.
    """
    memory = t.memory
    model = t.model
    row = memory.joints[j]
    work = t.work.joints[j]
    period = max(_PERIOD, _FEWEST * model.period)
    row.probed += model.period
    turns = row.probed / period
    inertia = work.M[j - arm.first]
    rate = 2.0 * pi / period
    largest = _BEYOND * dry_friction(t, j) + inertia * _MOVES * rate * rate
    half_angle = pi * turns  # its sine and cosine are one call in machine code
    oscillation = 2.0 * sin(half_angle) * cos(half_angle)
    torque = largest * min(turns / _RISE, 1.0) * oscillation
    is_exerted = abs(work.tau + work.rest + torque) < model.joints[j].tau_max
    if row.rested < row.probed or not is_exerted:
        row.probed = _OVER
    elif turns > _LENGTH:
        row.probed = _OVER
        if _has_moved(row, dot6(work.column, work.outboard) / inertia):
            row.faulty |= FAULTY_POSITION | FAULTY_SPEED
    else:
        work.tau += torque
        if turns > _LENGTH - 1.0 and memory.wrench_age + memory.old_wrists == 0:
            sensor_joint = t.work.joints[arm.sensor_joint]
            wrench = read_wrist(memory.wrenches[k], sensor_joint, arm.sensor, world)
            row.echo += oscillation * dot6(work.column, wrench)
            row.push += oscillation * torque


@leaf
def _has_moved(row, free):
    """Determine whether the wrist's readings show that a tested joint has moved.

    Args:
        row: JOINT_MEMORY after the test, of which `echo` and `push` are read.
        free: share g of the torque that the wrist measures if the joint is free.
    """
    share = abs(row.echo)
    return _SILENT * free * row.push < share < 0.5 * (1.0 + free) * row.push
