"""Vision fused with encoders: the camera's frame found, its delay undone, its noise believed."""

import re

import numpy as np
import pinocchio as pin
from complaints import invalid_input
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import approx, mark
from rigs import largest
from samples import first
from scenario_runs import rig_of
from test_moving_face import TURNING

import osc_contact as osc
from osc_contact.sensing.vision_fusion import History, Registration

NOISE = (1e-3, 5e-3)


def displaced(rng, size):
    """A pose, some (m, rad) away from the identity."""
    return pin.SE3(pin.exp3(size[1] * rng.normal(size=3)), size[0] * rng.normal(size=3))


def scattered(rng):
    return [displaced(rng, (0.4, 1.0)) for _ in range(3)]


def noisy(X, rng, noise=NOISE):
    """As the plant's camera errs: shifted, and turned about its own origin in world axes."""
    R = pin.exp3(noise[1] * rng.normal(size=3)) @ X.rotation
    return pin.SE3(R, X.translation + noise[0] * rng.normal(size=3))


def lacking(estimate, true):
    """ξ = [δ; θ] with true = (exp(θ), δ) ∘ estimate."""
    rest = true * estimate.inverse()
    return np.concatenate((rest.translation, pin.log3(rest.rotation)))


def test_without_noise_one_picture_finds_the_camera():
    rng = default_rng(0)
    for _ in range(20):
        X_WC = displaced(rng, (0.1, 0.3))
        known = scattered(rng)
        found = Registration(1e-9, 1e-9, prior=(1.0, 1.0))
        found.update(known, [X_WC.inverse() * X for X in known])
        assert_allclose(lacking(found.X, X_WC), 0.0, atol=1e-8)


def test_the_covariance_is_that_of_the_error():
    """Normalised squared error over 300 cameras: chi² with 6 degrees of freedom, mean 6 ± 0.2."""
    rng = default_rng(1)
    prior = (5e-3, 5e-3)
    squares = []
    spread = []
    for _ in range(300):
        X_WC = displaced(rng, prior)
        known = scattered(rng)
        found = Registration(*NOISE, prior=prior, drift=(0.0, 0.0))
        for _ in range(8):
            found.update(known, [noisy(X_WC.inverse() * X, rng) for X in known], 1 / 60)
        error = lacking(found.X, X_WC)
        squares.append(error @ np.linalg.solve(found.P, error))
        spread.append(error / np.sqrt(np.diag(found.P)))
    assert np.mean(squares) == approx(6.0, abs=4 * np.sqrt(12 / 300))
    assert_allclose(np.std(spread, axis=0), 1.0, atol=0.15)


def test_history_tells_what_was():
    history = History(0.1)
    with invalid_input("empty"):
        history.at(0.0)
    for k in range(301):
        history.add(1e-3 * k, np.array([1e-3 * k, 2.0]))
    assert_allclose(history.at(0.2345), [0.2345, 2.0], atol=1e-12)
    assert_allclose(history.at(9.0), [0.3, 2.0])
    assert history.at(0.0)[0] == approx(0.2, abs=2e-3)  # no further back than 0.1 s
    alone = History(1.0)
    alone.add(0.0, np.ones(1))
    assert alone.at(-1.0) == alone.at(5.0) == 1.0


@mark.parametrize("bad", [{"position": 0.0}, {"prior": (1.0, 0.0)}, {"drift": (-1.0, 0.0)}])
def test_impossible_noise_is_refused(bad):
    with invalid_input("registration"):
        Registration(**{"position": 1e-3, "orientation": 1e-3} | bad)


VISION = (
    "sensors.vision={rate: 60 Hz, delay: 30 ms, position: {noise: 1 mm}, "
    "orientation: {noise: 5 mrad}, frame_position: 5 mm, frame_orientation: 5 mrad}"
)


@mark.parametrize("plant", first(["mujoco", "rigid"], 1))
def test_N_follows_a_turning_face_although_camera_and_robots_disagree(plant):
    """Against the true N, with and without the fusion, while the face travels and tilts."""
    slow = [
        re.sub(": (0.7|1) Hz", ": 0.1 Hz", c).replace("ramp: 0.1 s", "ramp: 4 s") for c in TURNING
    ]
    step = {"mujoco": "0.25 ms", "rigid": "1 ms"}[plant]
    changes = f"plant.type={plant}", f"plant.step={step}", "control.rate=1 kHz"
    rig = rig_of("moving_face", *slow, VISION, *changes)
    sensed = rig.plant(2)
    controller = rig.controller()
    observer = rig.observer()
    pair = rig.pairs[0]
    squares = []
    for k in range(2500):
        read = sensed.measure()
        done = observer.complete(read, None)
        if k >= 1200 and k % 20 == 0:
            truth = sensed.truth()
            n = pair.direction(truth.X_WE[0])
            for touched in (done.touched, read.touched):
                X_WE = pin.SE3(touched.X_WE[0])
                off = np.cross(n, pair.direction(X_WE))
                squares.append([off @ off, *pair.gaps(truth.X_WO, X_WE) ** 2])
        sensed.command(controller.tick(done, rig.references.at(1e-3 * k)), 1e-3)
    fused, raw = np.sqrt(np.mean(np.reshape(squares, (-1, 2, 2)), axis=0))
    assert fused[0] < 4e-3 and fused[1] < 1.2e-3, fused  # rad; m from where it touches
    assert (fused < 0.6 * raw).all(), (fused, raw)
    assert controller.status is osc.Status.OK


def test_vision_tracks_rod_and_arms_where_they_are():
    rig = rig_of("moving_face", "plant.type=rigid", VISION)
    sensed = rig.plant(5)
    seen = sensed.measure().seen
    truth = sensed.truth()
    for X, Y in zip((seen.object, *seen.tips), sensed.plant.poses(), strict=True):
        assert 1e-4 < largest(X[:3, 3] - Y[:3, 3]) < 1.5e-2
        assert np.linalg.norm(pin.log3(X[:3, :3] @ Y[:3, :3].T)) < 0.04
    assert_allclose(sensed.plant.poses()[0], truth.X_WO.homogeneous, atol=1e-12)
    assert seen.tips.shape == (2, 4, 4)


def test_a_wandering_camera_is_followed():
    rng = default_rng(2)
    known = scattered(rng)
    moved = pin.SE3(pin.exp3(np.array([0, 0, 2e-3])), np.array([3e-3, 0, 0]))
    found = Registration(*NOISE, drift=(1e-3, 1e-3))
    for where in (pin.SE3.Identity(), moved):
        for _ in range(600):
            found.update(known, [noisy(where.inverse() * X, rng) for X in known], 1 / 60)
    assert largest(lacking(found.X, moved)) < 1.5e-3
