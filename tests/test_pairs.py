"""Vertex on face: N, n_γ and the gap against finite differences with both bodies moving.

Both bodies follow smooth random paths whose twist and acceleration at t = 0 are known in closed
form; everything else (Ṅ, gap rates) comes from positions at neighbouring instants.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.pairs import VertexOnFace
from osc_contact.errors import InvalidInputError

SEEDS = range(40)
STILL = np.zeros(6)


@dataclass(frozen=True)
class Path:
    """X(t) = (exp₃(w₁t + w₂t²) R₀, p₀ + p₁t + p₂t²): at t = 0, ω = w₁, ω̇ = 2w₂, v = p₁, p̈ = 2p₂."""

    R0: np.ndarray
    p: np.ndarray
    w: np.ndarray

    @classmethod
    def random(cls, rng: np.random.Generator) -> Path:
        q = rng.normal(size=4)
        R0 = pin.Quaternion(*(q / np.linalg.norm(q))).matrix()
        return cls(R0, rng.normal(size=(3, 3)), rng.normal(size=(2, 3)))

    def __call__(self, t: float) -> pin.SE3:
        p0, p1, p2 = self.p
        return pin.SE3(
            pin.exp3(self.w[0] * t + self.w[1] * t * t) @ self.R0, p0 + t * (p1 + t * p2)
        )

    @property
    def twist(self) -> np.ndarray:
        """(6,) at the body's own origin, world axes."""
        return np.concatenate((self.p[1], self.w[0]))

    @property
    def acceleration(self) -> np.ndarray:
        """(6,) spatial, at the body's origin at t = 0: p̈ − ω × v, ω̇."""
        return np.concatenate((2 * self.p[2] - np.cross(self.w[0], self.p[1]), 2 * self.w[1]))


@dataclass(frozen=True)
class Case:
    pair: VertexOnFace
    body: Path
    face: Path

    @classmethod
    def random(cls, seed: int, radius: float = 0.0) -> Case:
        rng = np.random.default_rng(seed)
        vertex, point, normal = rng.normal(size=(3, 3))
        pair = VertexOnFace(vertex, point, normal, radius)
        return cls(pair, Path.random(rng), Path.random(rng))

    @property
    def contact(self) -> Contact:
        return self.pair.contact(self.body(0.0), self.body.twist, self.face(0.0), self.face.twist)

    def at_O(self, motion: np.ndarray) -> np.ndarray:
        """A motion of the face's body carried from its origin to O, by Pinocchio."""
        away = self.face(0.0).translation - self.body(0.0).translation
        return pin.SE3(np.eye(3), away).act(pin.Motion(motion)).vector

    @property
    def V_rel(self) -> np.ndarray:
        return self.body.twist - self.at_O(self.face.twist)

    @property
    def a_rel(self) -> np.ndarray:
        return self.body.acceleration - self.at_O(self.face.acceleration)

    def gap(self, t: float) -> float:
        return self.pair.gap(self.body(t), self.face(t))

    def N_at(self, t: float) -> np.ndarray:
        """(6,) N at time t, written at the operational point of t = 0."""
        N = self.pair.contact(self.body(t), STILL, self.face(t)).N[:, 0]
        away = self.body(t).translation - self.body(0.0).translation
        return pin.SE3(np.eye(3), away).act(pin.Force(N)).vector


def first(f: Callable[[float], np.ndarray], h: float = 1e-3) -> np.ndarray:
    near, far = (f(h) - f(-h)) / (2 * h), (f(2 * h) - f(-2 * h)) / (4 * h)
    return (4 * near - far) / 3


def second(f: Callable[[float], float], h: float = 4e-3) -> float:
    near = (f(h) - 2 * f(0.0) + f(-h)) / h**2
    far = (f(2 * h) - 2 * f(0.0) + f(-2 * h)) / (4 * h**2)
    return (4 * near - far) / 3


def test_the_paths_have_the_twist_and_acceleration_they_claim() -> None:
    path = Path.random(np.random.default_rng(0))
    X0 = path(0.0)

    def body_velocity(t: float) -> pin.Motion:
        step = 1e-4
        return pin.log6(path(t - step).actInv(path(t + step))) * (0.5 / step)

    axes = pin.SE3(X0.rotation, np.zeros(3))
    np.testing.assert_allclose(axes.act(body_velocity(0.0)).vector, path.twist, atol=1e-6)
    rate = first(lambda t: (X0.inverse() * path(t)).act(body_velocity(t)).vector)
    # derivative of the twist in coordinates that stay at O(0): the spatial acceleration
    np.testing.assert_allclose(axes.act(pin.Motion(rate)).vector, path.acceleration, atol=1e-5)


@pytest.mark.parametrize("seed", SEEDS)
def test_N_is_a_unit_force_into_the_face_through_the_vertex(seed: int) -> None:
    case = Case.random(seed)
    X_WO, X_WE = case.body(0.0), case.face(0.0)
    n = -(X_WE.rotation @ case.pair.normal)
    p = X_WO.act(case.pair.vertex)
    at_vertex = pin.Force(n, np.zeros(3))
    expected = pin.SE3(np.eye(3), p - X_WO.translation).act(at_vertex).vector
    contact = case.contact
    assert contact.r == 1
    np.testing.assert_allclose(contact.N[:, 0], expected, atol=1e-13)
    np.testing.assert_allclose(case.pair.direction(X_WE), n, atol=1e-15)
    assert np.linalg.norm(contact.N[:3]) == pytest.approx(1.0, abs=1e-14)


@pytest.mark.parametrize("seed", SEEDS)
def test_n_gamma_is_minus_the_rate_of_N_on_the_relative_twist(seed: int) -> None:
    case = Case.random(seed)
    N_dot = first(case.N_at)
    scale = np.abs(N_dot) @ np.abs(case.V_rel)
    assert case.contact.n_gamma[0] == pytest.approx(-N_dot @ case.V_rel, abs=1e-6 * scale)


@pytest.mark.parametrize("radius", [0.0, 0.01])
@pytest.mark.parametrize("seed", SEEDS)
def test_gap_and_its_two_derivatives(seed: int, radius: float) -> None:
    case = Case.random(seed, radius)
    N, n_gamma = case.contact.N[:, 0], case.contact.n_gamma[0]
    speed = np.abs(N) @ np.abs(case.V_rel)
    assert first(case.gap) == pytest.approx(-N @ case.V_rel, abs=1e-7 * speed)
    acceleration = -(N @ case.a_rel - n_gamma)
    scale = 1.0 + np.abs(N) @ np.abs(case.a_rel) + abs(n_gamma)
    assert second(case.gap) == pytest.approx(acceleration, abs=1e-6 * scale)


@pytest.mark.parametrize("seed", SEEDS)
def test_gap_is_the_signed_distance_to_the_plane(seed: int) -> None:
    """Against the volume over the area of a triangle drawn in the face."""
    rng = np.random.default_rng(seed)
    case = Case.random(seed, radius=0.25)
    X_WO, X_WE = case.body(0.0), case.face(0.0)
    side = np.linalg.svd(case.pair.normal[None, :])[2][1:]
    if np.linalg.det(np.vstack((side, case.pair.normal))) < 0:
        side = side[::-1]
    corners = [X_WE.act(case.pair.point + c @ side) for c in rng.normal(size=(1, 2))]
    corners += [corners[0] + X_WE.rotation @ s for s in side]
    a, b = corners[1] - corners[0], corners[2] - corners[0]
    centre = X_WO.act(case.pair.vertex)
    distance = np.linalg.det([a, b, centre - corners[0]]) / np.linalg.norm(np.cross(a, b))
    assert case.gap(0.0) == pytest.approx(distance - 0.25, abs=1e-12)


@pytest.mark.parametrize("seed", SEEDS)
def test_point_on_face_is_where_the_line_of_force_meets_it(seed: int) -> None:
    radius = 0.07
    case = Case.random(seed, radius)
    X_WO, X_WE = case.body(0.0), case.face(0.0)
    on_face = case.pair.point_on_face(X_WO, X_WE)
    assert X_WE.actInv(on_face) @ case.pair.normal == pytest.approx(
        case.pair.point @ case.pair.normal, abs=1e-12
    )
    centre = X_WO.act(case.pair.vertex)
    reach = case.gap(0.0) + radius
    np.testing.assert_allclose(on_face, centre + reach * case.pair.direction(X_WE), atol=1e-12)


@pytest.mark.parametrize("seed", range(10))
def test_radius_moves_the_gap_and_nothing_else(seed: int) -> None:
    sharp, round_ = Case.random(seed), Case.random(seed, radius=0.03)
    assert round_.gap(0.0) == pytest.approx(sharp.gap(0.0) - 0.03, abs=1e-14)
    np.testing.assert_array_equal(round_.contact.N, sharp.contact.N)
    np.testing.assert_array_equal(round_.contact.n_gamma, sharp.contact.n_gamma)


@pytest.mark.parametrize("seed", range(10))
def test_bodies_that_move_as_one_keep_the_contact(seed: int) -> None:
    case = Case.random(seed)
    away = case.body(0.0).translation - case.face(0.0).translation
    V_O = pin.SE3(np.eye(3), -away).act(pin.Motion(case.face.twist)).vector
    contact = case.pair.contact(case.body(0.0), V_O, case.face(0.0), case.face.twist)
    assert abs(contact.n_gamma[0]) < 1e-13


def test_a_wheel_and_a_carousel() -> None:
    """Two textbook cases. A spinning body on a still face: n_γ is the centripetal acceleration of
    the vertex along n. A still vertex over a turning face: −ω² times its height lever, by hand."""
    pair = VertexOnFace([0.0, 0.0, -0.3], np.zeros(3), [0.0, 0.0, 1.0])
    X = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.3]))
    spin = np.array([0.0, 0, 0, 0, 2.0, 0])
    # the vertex is accelerated up, away from the face, by ω²R unless a_O makes up for it
    assert pair.contact(X, spin).n_gamma[0] == pytest.approx(4.0 * 0.3)
    # a face through the origin, tilting about y below a still vertex at x = 0.5: gap = x sin θ
    pair = VertexOnFace([0.5, 0.0, 0.0], np.zeros(3), [0.0, 0.0, 1.0])
    here = pin.SE3.Identity()
    contact = pair.contact(here, STILL, here, spin)
    assert contact.N[:, 0] @ (STILL - spin) == pytest.approx(-2.0 * 0.5)  # the gap opens at ω x
    assert contact.n_gamma[0] == pytest.approx(0.0)  # and its rate ω x cos θ is stationary
    lifted = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.1]))
    assert pair.contact(lifted, STILL, here, spin).n_gamma[0] == pytest.approx(-4.0 * 0.1)


@pytest.mark.parametrize("seed", range(10))
def test_the_world_is_the_default_environment(seed: int) -> None:
    case = Case.random(seed)
    X_WO, V_O, pair = case.body(0.0), case.body.twist, case.pair
    here = pin.SE3.Identity()
    for one, other in (
        (pair.contact(X_WO, V_O), pair.contact(X_WO, V_O, here, STILL)),
        (pair.contact(X_WO, V_O, case.face(0.0)), pair.contact(X_WO, V_O, case.face(0.0), STILL)),
        # a moving environment whose frame is the world's at this instant
        (
            pair.contact(X_WO, V_O, V_E=case.face.twist),
            pair.contact(X_WO, V_O, here, case.face.twist),
        ),
    ):
        np.testing.assert_allclose(one.N, other.N, atol=1e-14)
        np.testing.assert_allclose(one.n_gamma, other.n_gamma, atol=1e-13)
    assert pair.gap(X_WO) == pytest.approx(pair.gap(X_WO, here), abs=1e-14)
    np.testing.assert_allclose(pair.direction(), pair.direction(here), atol=1e-15)
    np.testing.assert_allclose(pair.point_on_face(X_WO), pair.point_on_face(X_WO, here), atol=1e-14)


@settings(derandomize=True, deadline=None, max_examples=100)
@given(
    direction=st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda n: np.linalg.norm(n) > 1e-3),
    length=st.floats(1e-3, 1e3),
)
def test_face_placement_is_a_right_handed_frame_on_the_face(
    direction: tuple[float, float, float], length: float
) -> None:
    normal = np.array(direction) * length
    pair = VertexOnFace(np.zeros(3), [0.1, 0.2, 0.3], normal)
    X = pair.face_placement()
    np.testing.assert_allclose(X.rotation.T @ X.rotation, np.eye(3), atol=1e-12)
    assert np.linalg.det(X.rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(X.rotation[:, 2], normal / np.linalg.norm(normal), atol=1e-12)
    np.testing.assert_array_equal(X.translation, [0.1, 0.2, 0.3])


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_face_placement_along_every_axis(axis: int, sign: float) -> None:
    normal = sign * np.eye(3)[axis]
    X = VertexOnFace(np.zeros(3), np.zeros(3), normal).face_placement()
    np.testing.assert_allclose(X.rotation @ X.rotation.T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(np.cross(X.rotation[:, 0], X.rotation[:, 1]), normal, atol=1e-15)


def test_normal_is_normalised_and_input_is_copied() -> None:
    vertex, normal = np.ones(3), np.array([0.0, 3.0, 4.0])
    pair = VertexOnFace(vertex, np.zeros(3), normal)
    np.testing.assert_allclose(pair.normal, [0.0, 0.6, 0.8], atol=1e-16)
    vertex[:] = 9.0
    np.testing.assert_array_equal(pair.vertex, np.ones(3))
    assert pair.radius == 0.0 and pair.name == "vertex_on_face"


GOOD = {"vertex": np.zeros(3), "point": np.zeros(3), "normal": np.array([0.0, 0.0, 1.0])}


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"normal": np.zeros(3)}, "rod_end.normal is zero"),
        ({"normal": [0.0, 1.0]}, r"rod_end.normal: expected shape \(3\), got \(2,\)"),
        ({"normal": [0.0, 0.0, np.nan]}, r"rod_end.normal: element \(2,\) is nan"),
        ({"vertex": [[0.0, 0.0, 0.0]]}, r"rod_end.vertex: expected shape \(3\), got \(1, 3\)"),
        ({"vertex": [np.inf, 0.0, 0.0]}, r"rod_end.vertex: element \(0,\) is inf"),
        ({"point": "corner"}, "rod_end.point: expected numbers"),
        ({"point": [0.0] * 4}, r"rod_end.point: expected shape \(3\), got \(4,\)"),
        ({"radius": -0.01}, "rod_end.radius = -0.01"),
        ({"radius": np.nan}, "rod_end.radius = nan"),
        ({"radius": np.inf}, "rod_end.radius = inf"),
    ],
)
def test_impossible_pairs_are_refused(wrong: dict[str, object], message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        VertexOnFace(**{**GOOD, **wrong}, name="rod_end")  # type: ignore[arg-type]
    VertexOnFace(**GOOD, name="rod_end")
