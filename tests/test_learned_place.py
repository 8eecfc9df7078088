"""Place of a hole, learned from closed contacts, against least squares over all of them."""

import numpy as np
import pinocchio as pin
from complaints import invalid_input, refusals
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import approx
from samples import parametrize
from scipy.optimize import least_squares

import osc_contact as osc

POSE = pin.SE3(pin.exp3(np.array([3.0, 0.2, -0.1])), np.array([0.5, 0.1, 0.3]))  #: of the hole
AT = POSE.translation
TOUCH = osc.pairs_between(osc.Peg("square", 0.02), osc.Hole("square", 0.0202, 0.03, POSE))
FACE = ["corner +x+y on face", "corner -x+y on face", "corner -x-y on face"]
RIMS = ["side +x on rim +x", "side +y on rim +y", "side +y on rim +y, a"]
SIGMA = (1.2e-3, 0.02, 1e-4)  #: position, angle, gap


def displaced(d):
    """Pose of the body for a displacement (6,) at the mouth."""
    R = pin.exp3(d[3:])
    return pin.SE3(R, AT + d[:3] - R @ AT)


def touching(names, X_WE, rng):
    """Pose of the peg, somewhere near the mouth, at which some pairs are closed."""

    def pose(z):
        lean = pin.SE3(pin.exp3(z[3:]), z[:3])
        return POSE * lean

    start = np.concatenate((rng.normal(size=3) * 2e-3, rng.normal(size=3) * 0.1))
    scale = np.repeat([1e3, 1e1], 3)
    found = least_squares(
        lambda z: np.concatenate(
            [1e6 * TOUCH[name].gaps(pose(z), X_WE) for name in names] + [1e-3 * scale * (z - start)]
        ),
        start,
        xtol=1e-15,
        ftol=1e-15,
    )
    return pose(found.x)


@parametrize("seed", range(4))
def test_the_filter_is_the_least_squares_of_all_gaps(seed):
    rng = default_rng(seed)
    true = rng.normal(size=6) * np.repeat([1e-4, 1.5e-3], 3)  # small: the filter is linear
    visits = [(one, touching(one, displaced(true), rng)) for one in [FACE[:1], FACE[1:2], RIMS[:2]]]
    place = osc.LearnedPlace(AT, position=SIGMA[0], angle=SIGMA[1], gap=SIGMA[2])
    for names, X in visits:
        assert place.update([TOUCH[name] for name in names], X) == len(names)

    def residuals(d):
        X_WE = displaced(d)
        gaps = [TOUCH[name].gaps(X, X_WE)[0] / SIGMA[2] for names, X in visits for name in names]
        return np.concatenate((d / np.repeat(SIGMA[:2], 3), gaps))

    found = least_squares(residuals, np.zeros(6), x_scale=np.repeat([1e-3, 1e-2], 3), xtol=1e-14)
    sigmas = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))
    assert_allclose((place.displacement() - found.x) / sigmas, 0.0, atol=0.1)
    assert_allclose(np.sqrt(place.covariance.diagonal()), sigmas, rtol=0.05)


def test_what_was_not_touched_is_not_learned():
    """Three corners on the face show height and two tilts; x and y stay as they were."""
    rng = default_rng(7)
    true = np.array([1e-3, -1e-3, 0.5e-3, 0.01, -0.01, 0.01])
    body = displaced(true)
    place = osc.LearnedPlace(AT, position=SIGMA[0], angle=SIGMA[1], gap=1e-5)
    for name in FACE:
        assert place.update([TOUCH[name]], touching([name], body, rng)) == 1
    height = POSE.rotation[:, 2]
    along = np.concatenate((height, np.zeros(3)))
    assert along @ place.covariance @ along < (0.2e-3) ** 2
    across = np.concatenate((POSE.rotation[:, 0], np.zeros(3)))
    assert across @ place.covariance @ across == approx(SIGMA[0] ** 2, rel=0.05)
    assert set(place.learned()) <= {"z", "rx", "ry"} and "z" in place.learned()
    assert place.squares(true) < 20.0


def test_a_gap_that_is_too_large_is_another_contact():
    place = osc.LearnedPlace(AT, position=SIGMA[0], angle=SIGMA[1], gap=1e-4)
    far = POSE * pin.SE3(pin.exp3(np.array([0.1, 0.1, 0.0])), np.array([0.0, 0.0, -0.02]))
    assert place.update([TOUCH[FACE[0]]], far) == 0
    assert_allclose(place.displacement(), 0.0)


def test_the_covariance_is_that_of_the_error():
    """χ² of the true displacement over many draws."""
    values = []
    for seed in range(30):
        rng = default_rng([seed, 5])
        true = rng.normal(size=6) * np.repeat(SIGMA[:2], 3)
        place = osc.LearnedPlace(AT, position=SIGMA[0], angle=SIGMA[1], gap=SIGMA[2])
        for names in (FACE[:1], FACE[1:2], RIMS[:1], RIMS[1:2]):
            X = touching(names, displaced(true), rng)
            X = pin.SE3(X.rotation, X.translation + SIGMA[2] * rng.normal(size=3))
            place.update([TOUCH[name] for name in names], X)
        values.append(place.squares(true))
    assert 4.0 < np.mean(values) < 9.0


test_refusals = refusals(
    invalid_input,
    {
        "gap = 0": lambda: osc.LearnedPlace(AT, position=1e-3, angle=0.02, gap=0.0),
        "lasting = -1": lambda: osc.LearnedPlace(AT, position=1e-3, angle=0.02, gap=1, lasting=-1),
    },
)
