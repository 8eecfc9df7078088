"""Limit cycles: oscillations of a force that last and that nobody commanded, and what is none."""

import numpy as np
from pytest import approx
from samples import parametrize
from scenario_runs import verdict_of

import osc_contact as osc
from osc_contact.lab.runs.limit_cycles import find_cycle, worst_cycles

DT = 1e-3
T = np.arange(4000) * DT
RNG = np.random.default_rng(1)


def sine(frequency, amplitude=1.0):
    return amplitude * np.sin(2 * np.pi * frequency * T)


def rings(every):
    """An oscillation that is struck again and again, as by friction at reversals."""
    since = T % every
    return np.exp(-8.0 * since) * np.sin(20.0 * np.pi * since)


def band_noise(low, high):
    spectrum = np.fft.rfft(RNG.standard_normal(len(T)))
    f = np.fft.rfftfreq(len(T), DT)
    return np.fft.irfft(np.where((f > low) & (f < high), spectrum, 0.0), len(T))


CYCLES = {
    "constant": sine(9.3),
    "slow": sine(3.6),
    "growing": np.exp(0.5 * T) * sine(7.0),
    "grown to its bound": np.minimum(np.exp(2.0 * (T - 1.0)), 1.0) * sine(12.0),
    "cut off where the contact opens": np.maximum(sine(9.0, 12.0), -10.0),
    "under noise": sine(9.0) + 0.3 * RNG.standard_normal(len(T)),
    "drifting with the posture": np.sin(2 * np.pi * (9.0 * T + 0.15 * T**2)),
    "beside an error that follows the command": sine(9.0) + 2.0 * sine(0.5),
}
OTHERS = {
    "noise": RNG.standard_normal(len(T)),
    "noise through a narrow filter": band_noise(8.0, 12.0),
    "one that rings down": np.exp(-2.0 * T) * sine(8.0),
    "struck at every reversal of 0.5 Hz": rings(1.0),
    "friction that turns with the motion": np.sign(np.sin(np.pi * T + 0.1)),
    "at rest": np.zeros(len(T)),
    "a drift": 0.3 * T,
    "a step": np.where(T > 2.0, 1.0, 0.0),
}


@parametrize("name", CYCLES)
def test_oscillations_that_last_are_found(name):
    found = find_cycle(CYCLES[name], DT, [10.0 + sine(0.5)])
    assert found is not None
    amplitude, frequency = found
    assert amplitude == approx(np.median(np.abs(CYCLES[name])) * 1.4, rel=0.6)
    if name == "constant":
        assert amplitude == approx(1.0, rel=0.05)
        assert frequency == approx(9.3, abs=0.2)


@parametrize("name", OTHERS)
def test_what_does_not_last_is_none(name):
    assert find_cycle(OTHERS[name], DT, [10.0 + sine(0.5)]) is None


def test_what_is_commanded_is_none():
    """A commanded force, a motion along the contact, a driven face, and their harmonics."""
    error = sine(4.0)
    assert find_cycle(error, DT) is not None
    assert find_cycle(error, DT, [10.0 + sine(4.0, 3.0)]) is None
    assert find_cycle(sine(8.0), DT, [10.0 + sine(4.0, 3.0)]) is None  # as the square of it
    assert find_cycle(error, DT, driven_Hz=[4.0]) is None
    along = np.zeros((len(T), 6))
    into = sine(4.0, 1e-4)
    along[:, 1] = sine(4.0, 0.1)
    assert find_cycle(error, DT, along=along, across=into) is None
    jumps = 1e-3 * along  # the object swings with the force: nobody moves it
    assert find_cycle(error, DT, along=jumps, across=sine(4.0, 0.05)) is not None


def test_stretches_that_are_not_judged_are_not_joined():
    """A gap ends a window."""
    command = np.full((4000, 1), 10.0)
    channels = {"alpha_cmd": command, "alpha_true": command + sine(9.0)[:, None]}
    recording = osc.Recording({"control_rate_hz": 1000.0, "scenario": {}}, channels)
    judged = np.ones((4000, 1), dtype=bool)
    (whole,) = worst_cycles(recording, judged, 0.05)
    assert whole is not None and whole.relative == approx(0.1, rel=0.05)
    gaps = judged.copy()
    gaps[500::900] = False
    assert worst_cycles(recording, gaps, 0.05) == [None]  # less than a second each
    assert worst_cycles(recording, judged, 0.2) == [None]  # smaller than is looked for
    last = judged.copy()
    last[:2900] = False
    (late,) = worst_cycles(recording, last, 0.05)
    assert late is not None and late.frequency == approx(9.0, abs=1.0)


#: A part in a soft jig: 10 kN/m along the normal, seen to move, its spring not known.
JIG = (
    "contacts.left_end.face.motion={type: cart, direction: [0.501104, 0.200441, 0.841854], "
    "mass: 1 kg, stiffness: 10000, damping: 10}"
)


def test_a_part_in_a_soft_jig_swings_and_a_stiff_one_does_not():
    changes = [JIG, "model_error.environment=ignored", "duration=4 s"]
    soft = verdict_of("two_contact_rod", *changes)
    force = soft["force"]["left_end"]
    assert soft["task"]["failed"] and force["rms_error_rel"] > 0.4
    assert 6.0 < force["limit_cycle_Hz"] < 14.0 and force["limit_cycle_rel"] > 0.4
    omega = 2.0 * np.pi * force["limit_cycle_Hz"]
    assert force["limit_cycle_m_per_N"] == approx(1.0 / (1e4 - 1.0 * omega**2), rel=0.1)
    assert any("a limit cycle" in why and "compliance" in why for why in soft["task"]["why"])
    stiff = verdict_of("two_contact_rod", duration=4.0)
    assert stiff["task"]["word"] == "OK" and stiff["force"]["left_end"]["limit_cycle_rel"] is None
