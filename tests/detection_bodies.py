"""Bodies and exact poses for the tests of detection."""

from itertools import product

import coal
import numpy as np
import pinocchio as pin
from numpy.testing import assert_allclose
from rigs import shift

from osc_contact.contacts.detection import CollisionShape

SIZE = np.array([0.10, 0.08, 0.06])
BOX = [CollisionShape("box", coal.Box(*SIZE))]
TABLE = [CollisionShape("table", coal.Box(1.0, 0.8, 0.1), shift([0, 0, -0.05]))]
"""Its top is z = 0."""
CORNERS = np.array(list(product((-0.5, 0.5), repeat=3))) * SIZE
DEPTHS = (0.0, 5e-4, -5e-4)
"""Just touching, overlapping, a little apart (m); taken in turn."""
UP = np.array([0.0, 0.0, 1.0])


def moved(X, points):
    return np.asarray(points) @ X.rotation.T + X.translation


def standing(rotation, points, rng, lift=0.0):
    """A pose with this tilt (and random yaw) whose lowest of `points` is at z = lift."""
    R = pin.rpy.rpyToMatrix(0, 0, rng.uniform(-np.pi, np.pi)) @ rotation
    x, y = rng.uniform(-0.2, 0.2, 2)
    return pin.SE3(R, np.array([x, y, lift - (points @ R.T)[:, 2].min()]))


def pushes(points, directions, X_WO):
    """(6, k) wrenches at O of unit forces along `directions` at world `points`."""
    arms = np.asarray(points) - X_WO.translation
    directions = np.broadcast_to(directions, arms.shape)
    return np.hstack((directions, np.cross(arms, directions))).T


def assert_same_range(N, expected, tolerance=1e-9):
    """Equal spans, whatever the bases (moments in units of 0.1 m)."""
    scale = np.array([1, 1, 1, 10, 10, 10.0])[:, None]
    bases = [np.linalg.svd(scale * M, full_matrices=False) for M in (N, expected)]
    first, second = (svd.U[:, svd.S / svd.S[0] > 1e-6] for svd in bases)
    assert first.shape[1] == N.shape[1] == second.shape[1]
    assert_allclose(first @ first.T, second @ second.T, atol=tolerance)


def assert_kept_by_its_pair(found, X_WO, X_WE, expected, gap=0.0):
    """`.pair()`: N spans what it should, the gaps vanish and n_γ follows from its N alone."""
    pair = found.pair()
    contact = pair.contact(X_WO, np.zeros(6), X_WE, np.zeros(6))
    assert contact.r == found.r
    assert_same_range(contact.N, expected)
    assert_allclose(contact.n_gamma, 0.0, atol=1e-12)
    gaps = pair.gaps(X_WO, X_WE)
    assert gaps.shape == (found.r,)
    assert_allclose(gaps, gap, atol=1e-9)
    assert (contact.N[:3].T @ found.normal < 0.0).all()  # into the environment


def only(found):
    assert len(found) == 1, [(d.name, d.kind, d.distance) for d in found]
    return found[0]


def assert_only(found, kind, points, normal, X_WO, X_WE=None, gap=0.0):
    """One contact of this kind, whose normal is given, held by pushes in these points."""
    found = only(found)
    assert found.kind == kind
    assert_allclose(found.normal, normal, atol=1e-9)
    push = pushes(points, -np.asarray(normal), X_WO)
    assert_kept_by_its_pair(found, X_WO, pin.SE3.Identity() if X_WE is None else X_WE, push, gap)
    return found


BALL = [CollisionShape("ball", coal.Sphere(0.03), shift([0.01, 0.02, 0.0]))]
CAN = [CollisionShape("can", coal.Cylinder(0.03, 0.12))]
PILL = [CollisionShape("pill", coal.Capsule(0.03, 0.12))]
AXIS = np.array([[0, 0, -0.06], [0, 0, 0.06]])
AROUND = np.array([0, 0, 0, 0, 0, 0.7])
"""A turn of the can about its own axis."""
