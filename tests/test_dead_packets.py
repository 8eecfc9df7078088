"""Packets of encoders without noise that repeat themselves; arms that come to rest are sound."""

from typing import NamedTuple

import numpy as np
from numpy.random import default_rng
from rigs import vector
from samples import first, parametrize

import osc_contact as osc
from benchmarks.fault_injection import Case, Run, Verdict
from osc_contact.interface import Measurement, Stamps
from osc_contact.sensing.dead_packets import DeadPackets
from osc_contact.sensing.joint_readings import Encoders, JointReadings

DEAD = "encoders stuck, speeds too"
UNKNOWN = 0.8  # rad/s², rms unmodelled acceleration


def readings(bits, dt, n):
    """Checked readings of n joints with encoders of so many bits, without noise."""
    encoders = Encoders(
        noise=np.zeros(n),
        resolution=np.full(n, 2.0 * np.pi / 2**bits),
        unknown=np.full(n, UNKNOWN),
        sample=dt,
    )
    return JointReadings(encoders, np.full(n, np.inf), 20.0, dt)


def completed(joints, positions, bits, dt, accelerations=None):
    """Positions (ticks, n) as they are read, and as the controller receives them."""
    step = 2.0 * np.pi / 2**bits
    none = np.full(positions.shape[1], np.nan)
    received = []
    for k, q in enumerate(step * np.round(positions / step)):
        stamps = Stamps(k * dt, k * dt, k * dt, k * dt)
        known = 0.0 if accelerations is None else accelerations[k]
        measured = Measurement(q, none, np.zeros((1, 6)), stamps=stamps)
        received.append(joints.complete(measured, known).q)
    return np.array(received)


@parametrize("seed", range(20))
def test_a_packet_that_repeats_itself_in_motion_is_dead(seed):
    """Within 10 ms and three readings, or a reading more."""
    rng = default_rng(seed)
    bits, dt = int(rng.integers(14, 23)), float(rng.choice([1e-3, 2e-3, 4e-3]))
    step = 2.0 * np.pi / 2**bits
    speeds = rng.choice([-1.0, 1.0], 4) * rng.uniform(1.5, 5.0, 4) * np.sqrt(20.0 * UNKNOWN * step)
    frozen = int(rng.integers(150, 250))
    t = dt * np.minimum(np.arange(frozen + 100), frozen)
    received = completed(
        readings(bits, dt, 4), rng.uniform(-1, 1, 4) + np.outer(t, speeds), bits, dt
    )
    dead = np.isnan(received).any(axis=1)
    assert not dead[:frozen].any()
    # readings of slow joints change up to a step before the packets repeat themselves
    longest = max(round(10e-3 / dt), 3) + 1 + 1
    assert dead[frozen + longest :].all() and np.isnan(received[-1]).all()


@parametrize("seed", range(40))
def test_joints_that_friction_stops_are_not_dead(seed):
    """All at once, as suddenly as three times the rms unmodelled acceleration; then they rest."""
    rng = default_rng(seed)
    bits, dt = int(rng.integers(14, 23)), float(rng.choice([5e-4, 1e-3, 2e-3]))
    speeds = rng.choice([-1.0, 1.0], 5) * rng.uniform(0.0, 0.3, 5)
    slows = UNKNOWN * rng.uniform(0.3, 3.0, 5)
    ends = 0.2 + np.abs(speeds) / slows
    t = dt * np.arange(round((ends.max() + 0.3) / dt))[:, np.newaxis]
    since = np.clip(t - 0.2, 0.0, np.abs(speeds) / slows)
    q = speeds * np.minimum(t, 0.2) + speeds * since - 0.5 * np.sign(speeds) * slows * since**2
    assert np.isfinite(completed(readings(bits, dt, 5), q, bits, dt)).all()


def test_one_joint_that_stops_suddenly_proves_nothing():
    """A brake of one joint engages."""
    packets = DeadPackets(np.full(3, 1e-5), np.full(3, UNKNOWN), 1e-3)
    fast = vector(0.5, 0.0, 0.0)
    for k in range(50):
        assert not packets.update(vector(1e-3 * k, 0.2, 0.3), fast)
    assert not any(packets.update(vector(0.049, 0.2, 0.3), fast) for _ in range(500))


@parametrize("changes, dead", [(False, True), (True, False)])
def test_arms_that_rest_are_found_dead_once_a_stop_has_released_them(changes, dead):
    """Where no reading changes for 50 ms after the stop; before, nothing shows it."""
    packets = DeadPackets(np.full(2, 1e-5), np.full(2, UNKNOWN), 1e-3)
    rest = vector(0.1, 0.2)
    assert not any(packets.update(rest, np.zeros(2)) for _ in range(300))
    found = []
    for k in range(1, 100):
        moved = rest + (1e-5 if changes and k > 20 else 0.0)
        found.append(packets.update(moved, np.zeros(2), released_for=1e-3 * k))
    assert any(found) == dead
    if dead:
        assert found.index(True) == 49


class Stuck(NamedTuple):
    """A run in which all encoders, without noise, stand still from a drawn moment on."""

    scenario: str
    bits: int
    friction: float  # of the joints, share of the smallest motor's limit
    seed: int


#: moments in motion: found by the velocities before
WITHIN = 0.035  # s: 10 ms of repetitions, then 20 ticks without readings until the stop
MOVING = (
    Stuck("ur5_wipe", 18, 0.02, 709),
    Stuck("two_contact_rod", 16, 0.01, 715),
    Stuck("dual_panda_rod", 20, 0.0, 702),
    Stuck("scara_peg", 20, 0.02, 706),
    Stuck("panda_edge", 20, 0.0, 725),
)
#: at rest, or nearly: found once the arms are stopped
RESTING = (Stuck("panda_dome", 18, 0.01, 705), Stuck("approach_and_slide", 18, 0.02, 700))


def stuck(how):
    """Verdict on a run that goes on for 3 s after the fault, and 2 s after a stop."""
    step = 2.0 * np.pi / 2**how.bits
    encoders = (
        f"{{rate: 1 kHz, angle: {{resolution: {step} rad}}, length: {{resolution: {step} m}}}}"
    )
    changes = [f"sensors.encoder={encoders}", f"plant.joint_friction={how.friction}"]
    scenario = osc.load_scenario(how.scenario, changes)
    run = Run(Case(scenario=how.scenario, seed=how.seed), DEAD, scenario=scenario)
    before = Verdict("no fault", run.case)
    while run.k < run.first:
        run.step(before)
    assert not before.wrong and run.estimated
    return run.judge(DEAD, 3.0, 2.0)


@parametrize("how", [*first(MOVING, 2), *RESTING], ids=str)
def test_brakes_are_requested_where_noiseless_encoders_stand_still(how):
    """Arms without encoders are not braked by motors: joints went to 27 rad/s, forces to 919 N."""
    verdict = stuck(how)
    assert not verdict.wrong, verdict
    assert verdict.unbraked
    assert verdict.stopped < (WITHIN if how in MOVING else 1.0)
