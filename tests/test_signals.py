"""Signals: values, exact derivatives, sums; quantities: units and their refusals."""

import math
import re

import numpy as np
import yaml
from numpy.linalg import norm
from numpy.random import default_rng
from pydantic import TypeAdapter, ValidationError
from pytest import approx, raises
from rigs import assert_near, largest
from samples import aligned, parametrize

from osc_contact.errors import InvalidInputError
from osc_contact.lab.scenarios.signals import (
    AngleSignal,
    Constant,
    ForceSignal,
    JerkLimited,
    LengthSignal,
    MinimumJerk,
    Points,
    Sine,
    Step,
    total,
)
from osc_contact.settings.quantities import (
    Angle,
    Force,
    Frequency,
    JointValue,
    Length,
    Mass,
    Number,
    Time,
    UnitVec3,
    Vec3,
)

SMOOTH = [
    Constant(value=3.0),
    Sine(amplitude=4.0, frequency=0.5, phase=0.3, start=0.2, ramp=0.5),
    Sine(amplitude=0.05, frequency=1.3, start=-0.4),
    MinimumJerk(value=-10.0, start=0.1, duration=0.3),
    JerkLimited(via=(0.4, -0.2), value=0.1, start=0.1, velocity=2.5, acceleration=40.0, jerk=900.0),
    Points(points=((0.1, 3.0), (0.3, 4.0), (0.5, 3.5), (0.9, 3.0))),
]


@parametrize("signal", SMOOTH, ids=repr)
def test_derivatives_match_central_differences(signal):
    h = 1e-5
    for t in np.linspace(0.005, 1.2, 241) + 1.23e-3:
        rates = np.subtract(signal.at(t + h), signal.at(t - h)) / (2 * h)
        _, x_dot, x_ddot = signal.at(t)
        assert x_dot == approx(rates[0], abs=2e-5)
        assert x_ddot == approx(rates[1], abs=2e-3)


def test_many_times_at_once_are_those_times_one_by_one():
    signals = [*SMOOTH, Step(value=5.0, start=0.7), Sine(amplitude=1.0, frequency=2.0, start=0.3)]
    t = np.sort(np.append(default_rng(0).uniform(-0.5, 2.0, 200), [0.1, 0.3, 0.4, 0.7]))
    for chosen in ([], *([one] for one in signals), signals):
        summed = np.array([np.sum([one.at(x) for one in chosen], axis=0) * np.ones(3) for x in t])
        assert_near(total(chosen, t).T, summed, atol=1e-12)
        assert_near([total(chosen, x) for x in t], summed, atol=1e-12)


def test_step_rises_at_its_start_with_zero_derivatives():
    step = Step(value=5.0, start=1.0)
    assert step.at(math.nextafter(1.0, 0.0)) == (0.0, 0.0, 0.0)
    assert step.at(1.0) == step.at(9.0) == (5.0, 0.0, 0.0)


def test_sine_is_silent_before_start_and_pure_after_the_ramp():
    sine = Sine(amplitude=4.0, frequency=0.5, phase=0.3, start=1.0, ramp=0.5)
    assert tuple(sine.at(0.999)) == (0.0, 0.0, 0.0)
    w = math.pi
    angle = w + 0.3
    expected = (4 * math.sin(angle), 4 * w * math.cos(angle), -4 * w * w * math.sin(angle))
    assert sine.at(2.0) == approx(expected, rel=1e-13)


def rest_to_rest(distance, v, a, j):
    """Least time (s) by the textbook's cases (Biagiotti & Melchiorri 2008, section 3.4)."""
    ramp = v / a + a / j if v * j >= a * a else 2.0 * math.sqrt(v / j)
    if distance >= v * ramp:
        return distance / v + ramp
    if distance >= 2.0 * a**3 / j**2:
        return a / j + math.sqrt((a / j) ** 2 + 4.0 * distance / a)
    return 4.0 * (distance / (2.0 * j)) ** (1.0 / 3.0)


def test_jerk_limited_takes_the_least_time_and_keeps_its_limits():
    rng = default_rng(1)
    for _ in range(300):
        v, a, j, size = (10.0 ** rng.uniform(-3, 3, 4)).tolist()
        way = (size * rng.uniform(-1, 1, 3)).tolist()
        limits = {"velocity": v, "acceleration": a, "jerk": j}
        signal = JerkLimited(via=way[:2], value=way[2], start=0.3, **limits)
        least = [rest_to_rest(d, v, a, j) for d in np.abs(np.diff([0.0, *way]))]
        assert signal.duration == approx(sum(least), rel=1e-9)
        t = 0.3 + np.linspace(-0.05, 1.05, 4001) * signal.duration
        x, x_dot, x_ddot = signal.at(t)
        assert largest(x_dot) <= v * (1 + 1e-9) and largest(x_ddot) <= a * (1 + 1e-9)
        assert largest(np.diff(x_ddot) / np.diff(t)) <= j * (1 + 1e-6)
        for reached, when in aligned(way, 0.3 + np.cumsum(least)):
            x, x_dot, x_ddot = signal.at(when)
            assert x == approx(reached, abs=1e-8 * size)
            assert abs(x_dot) <= 1e-6 * v and abs(x_ddot) <= 1e-3 * a + j * 1e-6 * sum(least)
        assert signal.at(math.inf) == (way[2], 0.0, 0.0) and signal.at(0.3) == (0.0, 0.0, 0.0)
    still = JerkLimited(value=0.0, velocity=1.0, acceleration=1.0, jerk=1.0)
    assert still.at(0.5) == still.at(2.0) == (0.0, 0.0, 0.0), "nowhere to go"


def test_points_are_met_by_the_curve_of_least_jerk():
    """∫ x⃛ η⃛ dt = 0 for every η that vanishes at the points and rests at the ends."""
    rng = default_rng(2)
    for _ in range(20):
        times = np.cumsum(rng.uniform(0.2, 1.0, rng.integers(2, 8)))
        values = rng.standard_normal(len(times))
        signal = Points(points=np.column_stack((times, values)).tolist())
        assert_near(signal.at(times)[0], values, atol=1e-10)
        assert_near(signal.at(times[[0, -1]] + [1e-9, -1e-9])[1:], 0.0, atol=1e-4)
        assert signal.at(-1.0) == (values[0], 0.0, 0.0)
        assert signal.at(math.inf) == (values[-1], 0.0, 0.0)
        t = np.linspace(times[0], times[-1], 40_001)
        a = signal.at(t)[2]
        ends = (t - t[0]) ** 3 * (t - t[-1]) ** 3 / (t[-1] - t[0]) ** 6
        eta = ends * np.prod([t - x for x in times[1:-1]], axis=0) * np.cos(3.0 * t)
        eta_ddot = np.gradient(np.gradient(eta, t), t)
        jerk = np.gradient(a, t)[5:-5]
        eta_jerk = np.gradient(eta_ddot, t)[5:-5]
        assert abs(jerk @ eta_jerk) <= 2e-3 * norm(jerk) * norm(eta_jerk)


def test_a_value_given_twice_is_held_and_parts_the_curve():
    t = np.linspace(-0.2, 8.0, 2000)
    first = [(0.0, 3.0), (0.4, 5.0), (0.9, 4.0)]
    last = [(6.0, 4.0), (6.3, 1.0), (7.0, 2.0)]
    both, before, after = (np.array(Points(points=p).at(t)) for p in (first + last, first, last))
    assert_near(both, np.where(t < 3.0, before, after), atol=1e-9)
    held = (t >= 0.9) & (t <= 6.0)
    assert_near(both[:, held], np.outer([4, 0, 0], np.ones(held.sum())), atol=1e-12)


@parametrize(
    "kind, text, si, bad",
    [
        (LengthSignal, "50 mm", 0.05, "8 N"),
        (AngleSignal, "30 deg", math.radians(30), "50 mm"),
        (ForceSignal, "0.5 kN", 500.0, "30 deg"),
    ],
)
def test_the_same_signals_hold_lengths_angles_or_forces(kind, text, si, bad):
    read = TypeAdapter(kind).validate_python
    for type_, name, more in (
        ("constant", "value", {}),
        ("step", "value", {"start": 1}),
        ("sine", "amplitude", {"frequency": "2 Hz"}),
        ("minimum_jerk", "value", {"duration": 1}),
        ("jerk_limited", "value", {"velocity": 1, "acceleration": 1, "jerk": 1}),
    ):
        data = {"type": type_, name: text, **more}
        assert getattr(read(data), name) == approx(si, rel=1e-15)
        with raises(ValidationError, match="which is a"):
            read(data | {name: bad})
    data = {"type": "jerk_limited", "value": 1, "velocity": f"{text}/s"}
    for two, three in {"²": "³", "^2": "^3", "2": "3"}.items():
        data |= {"acceleration": f"{text}/s{two}", "jerk": f"{text}/s{three}"}
        found = read(data)
        assert (found.velocity, found.acceleration, found.jerk) == approx((si,) * 3, rel=1e-15)
        with raises(ValidationError, match=r"per s²?; got|per s² in .*² per|per s²"):
            read(data | {"acceleration": f"{text}/s"})


@parametrize(
    "bad",
    [
        "{type: sine, amplitude: 1, frequency: 0}",
        "{type: sine, amplitude: 1, frequency: 1, ramp: -0.1}",
        "{type: minimum_jerk, value: 1, duration: 0}",
        "{type: constant, value: .nan}",
        "{type: step, value: 1}",
        "{type: constant, value: 1, start: 2}",
        "{type: jerk_limited, value: 1, velocity: 1, acceleration: 0, jerk: 1}",
        "{type: jerk_limited, value: 1, velocity: .inf, acceleration: 1, jerk: 1}",
        "{type: jerk_limited, value: 1, via: [.nan], velocity: 1, acceleration: 1, jerk: 1}",
        "{type: points, points: [[0, 1]]}",
        "{type: points, points: [[0, 1], [1, 2], [1, 3]]}",
        "{type: points, points: [[0, 1], [1, .nan]]}",
        "{type: points, points: [[0, 1], [1.0e-300, 2], [1, 3]]}",
        "{type: points, points: [[0, 1], [10.1, 2], [11.1, 3]]}",
    ],
)
def test_impossible_signals_are_refused(bad):
    with raises(ValidationError):
        TypeAdapter(ForceSignal).validate_python(yaml.safe_load(bad))
    with raises(InvalidInputError):  # in Python
        Sine(amplitude=1.0, frequency=0.0)


@parametrize(
    "kind, text, si",
    [
        (Length, "50 mm", 0.05),
        (Length, "3µm", 3e-6),
        (Length, "3 um", 3e-6),
        (Length, 2, 2.0),
        (Length, "-1.5e2 cm", -1.5),
        (Length, "0.7", 0.7),
        (Angle, "90 deg", math.pi / 2),
        (Time, "0.25 ms", 0.00025),
        (Time, "2 min", 120.0),
        (Frequency, "1 kHz", 1000.0),
        (Force, "8 N", 8.0),
        (Mass, "250 g", 0.25),
        (JointValue, "9.3 mm", 0.0093),
        (JointValue, "180 deg", math.pi),
        (Number, 1.5, 1.5),
        (Number, np.float32(0.5), 0.5),
    ],
)
def test_units_are_converted_to_the_nearest_float(kind, text, si):
    assert TypeAdapter(kind).validate_python(text) == si


@parametrize(
    "kind, value, message",
    [
        (Length, "8 N", "expected a length in m, mm, cm, µm; got '8 N', which is a force"),
        (Length, "8 ell", "got '8 ell', and 'ell' is not a known unit"),
        (Time, "5 Hz", "expected a time in s, ms, µs, min; got '5 Hz', which is a frequency"),
        (Force, "N", "got 'N', which is no number"),
        (Force, True, "got True"),
        (Force, None, "got None"),
        (Mass, math.inf, "which is not finite"),
        (Mass, "nan", "which is no number"),
        (Mass, "1e999 kg", "which is not finite"),
        (Mass, "1e99999999999999999999 kg", "which is not finite"),
        (Mass, 10**400, "which is not finite"),
        (Number, "4 N", "expected a plain number; got '4 N', which is a force"),
    ],
)
def test_wrong_quantities_say_what_would_be_right(kind, value, message):
    with raises(ValidationError, match=re.escape(message)):
        TypeAdapter(kind).validate_python(value)


def test_vectors():
    vec3, unit = (TypeAdapter(kind).validate_python for kind in (Vec3, UnitVec3))
    assert vec3([0, "50 mm", 1.0]) == (0.0, 0.05, 1.0)
    loaded = unit([0.4, 0.3, -0.87])
    assert math.hypot(*loaded) == approx(1.0, abs=4e-16)
    assert np.cross(loaded, [0.4, 0.3, -0.87]) == approx(np.zeros(3), abs=1e-16)
    for read, bad in ((vec3, [1, 2]), (vec3, "abc"), (vec3, [1, 2, "3 N"]), (unit, [0, 0, 0])):
        with raises(ValidationError, match="expected"):
            read(bad)
    for vector in default_rng(0).standard_normal((2000, 3)).tolist():
        once = unit(vector)
        assert unit(once) == once, "normalised twice: no bit changes"
