"""The velocity estimate against the Riccati equation and against what it has to see."""

import numpy as np
from complaints import invalid_input
from numpy.testing import assert_allclose
from pytest import mark
from rigs import largest

from osc_contact.sensing.velocity_estimate import VelocityEstimate

DT = 1e-3


def white(acceleration, dt):
    """(2, 2) what white acceleration of power acceleration² dt does to [x, v] in one period."""
    power = acceleration**2 * dt
    return power * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])


def riccati(noise, acceleration, dt):
    """Stationary gain (2,) and covariance after the update, by iterating the filter equations."""
    F = np.array([[1.0, dt], [0.0, 1.0]])
    P = np.eye(2)
    for _ in range(20_000):
        P = F @ P @ F.T + white(acceleration, dt)
        K = P[:, 0] / (P[0, 0] + noise**2)
        P = P - np.outer(K, P[0])
    return K, P


@mark.parametrize("noise, acceleration", [(2e-5, 2.0), (1e-4, 0.5), (1e-6, 50.0), (1e-9, 2.0)])
def test_gains_are_those_of_the_riccati_equation(noise, acceleration):
    estimate = VelocityEstimate.optimal(noise, acceleration, DT)
    K, _ = riccati(noise, acceleration, DT)
    assert_allclose([estimate.alpha[0], estimate.beta[0] / DT], K, rtol=1e-6)


@mark.parametrize("noise", np.geomspace(1e-15, 1e-2, 14))
@mark.parametrize("dt", [1e-3, 2e-3, 4e-3, 1 / 60])
def test_errors_of_velocity_never_alternate_for_long_however_good_the_sensor(noise, dt):
    """Eigenvalues of the error from sample to sample: at worst 0.27 from one to the next."""
    estimate = VelocityEstimate.optimal(noise, 2.0, dt)
    K = np.array([estimate.alpha[0], estimate.beta[0] / dt])
    F = np.array([[1.0, dt], [0.0, 1.0]])
    poles = np.linalg.eigvals((np.eye(2) - np.outer(K, [1.0, 0.0])) @ F)
    assert largest(poles) < 1.0 and poles.real.min() > -0.27


def test_exact_positions_give_the_velocity_at_once():
    """From a wrong velocity on; an unknown acceleration errs by less than half a period of it."""
    estimate = VelocityEstimate.optimal(1e-9, 2.0, DT)
    a = 3.0
    estimate.update(np.zeros(1))
    estimate.v = np.array([0.5])
    for t in DT * np.arange(1, 13):
        _, v = estimate.update(np.array([0.5 * a * t**2]))
    assert abs(v - a * t) < 0.5 * a * DT


def test_errors_are_as_large_as_the_riccati_equation_says():
    rng = np.random.default_rng(0)
    noise = 2e-5
    unknown = 2.0
    estimate = VelocityEstimate.optimal(np.full(20, noise), np.full(20, unknown), DT)
    F = np.array([[1.0, DT], [0.0, 1.0]])
    x = np.zeros((2, 20))  # and speeds
    errors = []
    root = np.linalg.cholesky(white(unknown, DT))
    for _ in range(4000):
        x = F @ x + root @ rng.standard_normal((2, 20))
        errors.append(estimate.update(x[0] + noise * rng.standard_normal(20)) - x)
    _, P = riccati(noise, unknown, DT)
    assert_allclose(
        np.mean(np.square(errors[501:]), axis=(0, 2)), np.diag(P), rtol=0.0975
    )  # 5 % of the errors


def test_a_reading_that_is_not_fresh_only_predicts():
    estimate = VelocityEstimate(np.array([0.5]), np.array([0.1]), DT)
    estimate.update(np.array([1.0]))
    estimate.v = np.array([2.0])
    x, v = estimate.update(np.array([99.0]), np.array([10.0]), fresh=False)
    assert_allclose([x[0], v[0]], [1.0 + 2e-3 + 5e-6, 2.01], rtol=1e-12)


def test_a_slow_sensor_is_followed_between_its_samples():
    """60 Hz readings of a ramp, estimates every millisecond: smooth and right."""
    estimate = VelocityEstimate.optimal(1e-3, 0.05, DT, sample=1 / 60)
    found = []
    for t in DT * np.arange(6000):
        fresh = int(t * 60) != int((t - DT) * 60)
        found.append(estimate.update(np.array([0.02 * t]), 0.0, fresh))
    x, v = np.array(found[4000:])[..., 0].T
    assert_allclose(v, 0.02, rtol=0.01)
    assert largest(np.diff(x)) < 1e-3  # no jumps at the samples


@mark.parametrize("alpha, beta, dt", [(0.5, 3.5, DT), (-0.1, 0.1, DT), (0.5, 0.1, 0.0)])
def test_unstable_gains_are_refused(alpha, beta, dt):
    with invalid_input("stable"):
        VelocityEstimate(np.array([alpha]), np.array([beta]), dt)


def test_a_sensor_without_any_error_is_refused():
    with invalid_input("resolution"):
        VelocityEstimate.optimal(0.0, 1.0, DT)


def test_it_does_not_lag_along_a_known_acceleration():
    """0.5 Hz sine of 0.3 rad, 20 µrad of noise: the joints of a sliding rod."""
    rng = np.random.default_rng(1)
    w = np.pi
    t = DT * np.arange(8000)
    x, v, a = 0.3 * np.array([np.sin(w * t), w * np.cos(w * t), -(w**2) * np.sin(w * t)])[..., None]
    read = x[1:] + 2e-5 * rng.standard_normal((7999, 1))
    known = VelocityEstimate.optimal(2e-5, 0.2, DT)
    got = [known.update(*given)[1] for given in zip(read, a[:-1], strict=True)]
    assert np.mean((got - v[1:])[2000:] ** 2) < 1e-6
