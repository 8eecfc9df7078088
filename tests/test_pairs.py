"""Contact pairs: N, T, n_γ and the gaps against finite differences with both bodies moving.

First the vertex on a face: both bodies follow smooth random paths whose twist and acceleration at
t = 0 are known in closed form; everything else (Ṅ, gap rates) comes from positions at neighbouring
instants. Then every pair: the object moves on the pair's own free coordinates, written down here
without N or T, while the environment moves at will. Such a motion keeps the contact, so its
differentiated poses must satisfy NᵀV_rel = 0 and Nᵀa_rel = n_γ.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.pairs import (
    ConeInGroove,
    ContactPair,
    CylinderInHole,
    CylinderOnPlane,
    EdgeOnEdge,
    EdgeOnFace,
    FaceOnFace,
    FaceOnVertex,
    Fixed,
    Free,
    GapFunctions,
    Prismatic,
    Revolute,
    Screw,
    SphereOnPlane,
    VertexOnFace,
)
from osc_contact.errors import ContactError, InvalidInputError

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


# Every pair ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Coordinates:
    """How the geometry is written: object frame A′ in A, environment frame E′ in E, 1/metre."""

    X_A: pin.SE3 = field(default_factory=pin.SE3.Identity)
    X_E: pin.SE3 = field(default_factory=pin.SE3.Identity)
    per_metre: float = 1.0

    def A(self, point: np.ndarray) -> np.ndarray:
        return self.per_metre * self.X_A.actInv(point)

    def E(self, point: np.ndarray) -> np.ndarray:
        return self.per_metre * self.X_E.actInv(point)

    def along_A(self, direction: np.ndarray) -> np.ndarray:
        return self.X_A.rotation.T @ direction

    def along_E(self, direction: np.ndarray) -> np.ndarray:
        return self.X_E.rotation.T @ direction

    def pose(self, X_EA: pin.SE3) -> pin.SE3:
        X = self.X_E.actInv(X_EA * self.X_A)
        return pin.SE3(X.rotation, self.per_metre * X.translation)

    def gap(self, gap: Callable[[pin.SE3], np.ndarray]) -> Callable[[pin.SE3], np.ndarray]:
        def rewritten(X: pin.SE3) -> np.ndarray:
            X_EA = self.X_E * pin.SE3(X.rotation, X.translation / self.per_metre)
            return self.per_metre * gap(X_EA * self.X_A.inverse())

        return rewritten


PLAIN = Coordinates()
Poses = Callable[[np.ndarray], pin.SE3]
Kind = Callable[[np.random.Generator, Coordinates], tuple[ContactPair, Poses, int]]
KINDS: dict[str, Kind] = {}


def kind(make: Kind) -> Kind:
    """Register: rng, coordinates → pair, (6−r,) free coordinates ↦ X_EA in contact, r."""
    KINDS[make.__name__] = make
    return make


def unit(rng: np.random.Generator) -> np.ndarray:
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


def about(axis: np.ndarray, angle: float) -> np.ndarray:
    return pin.exp3(angle * axis)


def carrying(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """A rotation that turns one unit vector into another."""
    axis = np.cross(start, end)
    sine = np.linalg.norm(axis)
    return pin.exp3(np.arctan2(sine, start @ end) * axis / sine)


def placed(R: np.ndarray, of_A: np.ndarray, at_E: np.ndarray) -> pin.SE3:
    """The pose X_EA of orientation R that puts a point of A at a point of E."""
    return pin.SE3(R, at_E - R @ of_A)


def in_plane(normal: np.ndarray) -> np.ndarray:
    return np.linalg.svd(normal[None, :])[2][1:]


def pose_of(rng: np.random.Generator) -> pin.SE3:
    return pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))


@kind
def vertex_on_face(rng, c):
    vertex, point, n, rho = rng.normal(size=3), rng.normal(size=3), unit(rng), 0.2
    plane = in_plane(n)
    pair = VertexOnFace(c.A(vertex), c.E(point), c.along_E(n), rho * c.per_metre)
    return pair, lambda q: placed(pin.exp3(q[:3]), vertex, point + q[3:] @ plane + rho * n), 1


@kind
def sphere_on_plane(rng, c):
    centre, point, n, rho = rng.normal(size=3), rng.normal(size=3), unit(rng), 0.3
    plane = in_plane(n)
    pair = SphereOnPlane(c.A(centre), rho * c.per_metre, c.E(point), c.along_E(n))
    return pair, lambda q: placed(pin.exp3(q[:3]), centre, point + q[3:] @ plane + rho * n), 1


@kind
def face_on_vertex(rng, c):
    point, n, vertex, rho = rng.normal(size=3), unit(rng), rng.normal(size=3), 0.2
    plane = in_plane(n)
    pair = FaceOnVertex(c.A(point), c.along_A(n), c.E(vertex), rho * c.per_metre)
    return pair, lambda q: placed(pin.exp3(q[:3]), point + q[3:] @ plane + rho * n, vertex), 1


def crossed_edges(rng, c, hint: bool):
    a, b = rng.normal(size=(2, 3))
    e, f = unit(rng), unit(rng)
    # turned by at most about 1 rad from perpendicular, so that the edges never become parallel
    R0 = carrying(e, np.cross(f, in_plane(f)[0]))
    side = c.along_E(-np.cross(R0 @ e, f)) if hint else -1.0
    pair = EdgeOnEdge(c.A(a), 2 * c.along_A(e), c.E(b), 3 * c.along_E(f), side)
    return pair, lambda q: placed(pin.exp3(0.3 * q[:3]) @ R0, a + q[3] * e, b + q[4] * f), 1


@kind
def edge_on_edge(rng, c):
    return crossed_edges(rng, c, hint=False)


@kind
def edge_on_edge_with_hint(rng, c):
    return crossed_edges(rng, c, hint=True)


def line_on_plane(rng, make, rho: float):
    point, e, face, n = rng.normal(size=3), unit(rng), rng.normal(size=3), unit(rng)
    plane = in_plane(n)
    R0 = carrying(e, plane[0])

    def pose(q: np.ndarray) -> pin.SE3:
        return placed(about(n, q[0]) @ R0 @ about(e, q[1]), point, face + q[2:] @ plane + rho * n)

    return make(point, e, face, n), pose, 2


@kind
def edge_on_face(rng, c):
    def make(point, e, face, n):
        length = 0.3 * c.per_metre
        return EdgeOnFace(c.A(point), c.along_A(e), c.E(face), c.along_E(n), length)

    return line_on_plane(rng, make, 0.0)


@kind
def cylinder_on_plane(rng, c):
    def make(point, e, face, n):
        rho, length = 0.15 * c.per_metre, 0.4 * c.per_metre
        return CylinderOnPlane(c.A(point), c.along_A(e), rho, c.E(face), c.along_E(n), length)

    return line_on_plane(rng, make, 0.15)


@kind
def face_on_face(rng, c):
    point, n, face, m = rng.normal(size=3), unit(rng), rng.normal(size=3), unit(rng)
    R0, plane = carrying(n, -m), in_plane(m)
    pair = FaceOnFace(c.A(point), c.along_A(n), c.E(face), c.along_E(m), 0.2 * c.per_metre)
    return pair, lambda q: placed(about(m, q[0]) @ R0, point, face + q[1:] @ plane), 3


@kind
def cylinder_in_hole(rng, c):
    point, e, hole, h = rng.normal(size=3), unit(rng), rng.normal(size=3), unit(rng)
    R0 = carrying(e, h)
    pair = CylinderInHole(c.A(point), c.along_A(e), c.E(hole), c.along_E(h), 0.2 * c.per_metre)
    return pair, lambda q: placed(about(h, q[0]) @ R0, point, hole + q[1] * h), 4


@kind
def cone_in_groove(rng, c):
    apex, axis, point, groove, seat = (
        rng.normal(size=3),
        unit(rng),
        rng.normal(size=3),
        *(unit(rng) for _ in range(2)),
    )
    R0 = carrying(axis, seat)
    pair = ConeInGroove(c.A(apex), c.along_A(axis), c.E(point), c.along_E(groove), c.along_E(seat))
    return pair, lambda q: placed(about(seat, q[0]) @ R0, apex, point + q[1] * groove), 4


@kind
def revolute(rng, c):
    point, e, X = rng.normal(size=3), unit(rng), pose_of(rng)
    pair = Revolute(c.A(point), c.along_A(e), c.pose(X))
    return pair, lambda q: X * placed(about(e, q[0]), point, point), 5


@kind
def prismatic(rng, c):
    point, e, X = rng.normal(size=3), unit(rng), pose_of(rng)
    pair = Prismatic(c.A(point), c.along_A(e), c.pose(X))
    return pair, lambda q: X * pin.SE3(np.eye(3), q[0] * e), 5


@kind
def screw(rng, c):
    point, e, X, pitch = rng.normal(size=3), unit(rng), pose_of(rng), rng.normal()
    pair = Screw(c.A(point), c.along_A(e), pitch * c.per_metre, c.pose(X))
    return pair, lambda q: X * placed(about(e, q[0]), point, point + pitch * q[0] * e), 5


@kind
def fixed(rng, c):
    X = pose_of(rng)
    return Fixed(c.pose(X)), lambda q: X, 6


@kind
def free(rng, c):
    return Free(), lambda q: pin.SE3(pin.exp3(q[:3]), q[3:]), 0


@kind
def point_on_a_saddle(rng, c):
    vertex, (k, m), X = rng.normal(size=3), rng.normal(size=2), pose_of(rng)

    def gap(X_EA: pin.SE3) -> np.ndarray:
        x, y, z = X.actInv(X_EA.act(vertex))
        return np.array([z - k * x * x - m * y * y * y])

    def pose(q: np.ndarray) -> pin.SE3:
        x, y = 0.5 * q[3:]
        return placed(pin.exp3(q[:3]), vertex, X.act(np.array([x, y, k * x * x + m * y**3])))

    return GapFunctions(c.gap(gap), length=0.5 * c.per_metre), pose, 1


@kind
def bead_on_a_wire(rng, c):
    bead, X = rng.normal(size=3), pose_of(rng)

    def gap(X_EA: pin.SE3) -> np.ndarray:
        x, y, z = X.actInv(X_EA.act(bead))
        return np.array([y - np.sin(x), z - 0.5 * x * x])

    def pose(q: np.ndarray) -> pin.SE3:
        return placed(pin.exp3(q[:3]), bead, X.act(np.array([q[3], np.sin(q[3]), 0.5 * q[3] ** 2])))

    return GapFunctions(c.gap(gap), length=0.5 * c.per_metre), pose, 2


ALL = sorted(KINDS)
#: n_γ from T and β: it presumes that V_rel is a permitted motion.
BY_T = {"cone_in_groove", "revolute", "prismatic", "screw", "fixed", "free"}
TURNS = range(6)


def steps(order: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes −4 … 4 and weights of the eighth-order central difference."""
    k = np.arange(-4.0, 5.0)
    wanted = np.zeros(9)
    wanted[order] = order
    return k, np.linalg.solve(np.vander(k, increasing=True).T, wanted)


def rate(f: Callable[[float], np.ndarray], order: int = 1, h: float = 5e-3) -> np.ndarray:
    k, weights = steps(order)
    return np.tensordot(weights, np.array([f(x * h) for x in k]), 1) / h**order


def kinematics(X: Callable[[float], pin.SE3]) -> tuple[np.ndarray, np.ndarray]:
    """Twist and spatial acceleration at the body's origin, from poses: [ω̇]× is the odd part of
    R̈Rᵀ, and the spatial acceleration is p̈ − ω × ṗ."""
    R = X(0.0).rotation

    def odd(A: np.ndarray) -> np.ndarray:
        return 0.5 * np.array([A[2, 1] - A[1, 2], A[0, 2] - A[2, 0], A[1, 0] - A[0, 1]])

    p_dot, p_ddot = (rate(lambda t: X(t).translation, order) for order in (1, 2))
    w, w_dot = (odd(rate(lambda t: X(t).rotation, order) @ R.T) for order in (1, 2))
    return np.concatenate((p_dot, w)), np.concatenate((p_ddot - np.cross(w, p_dot), w_dot))


@dataclass(frozen=True)
class Motion:
    """A pair, and both bodies moving."""

    pair: ContactPair
    body: Callable[[float], pin.SE3]
    env: Callable[[float], pin.SE3]

    @classmethod
    def keeping(cls, name: str, turn: int) -> Motion:
        """Both bodies move, the object on the free coordinates of the pair."""
        rng = np.random.default_rng([turn, 7])
        pair, pose, r = KINDS[name](rng, PLAIN)
        env, q = Path.random(rng), 0.7 * rng.normal(size=(3, 6 - r))
        return cls(pair, lambda t: env(t) * pose(q[0] + q[1] * t + q[2] * t * t), env)

    @classmethod
    def breaking(cls, name: str, turn: int, open_by: float = 0.0) -> Motion:
        """Both bodies move at will, at t = 0 in contact or `open_by` (m, rad) away from it."""
        rng = np.random.default_rng([turn, 8])
        pair, pose, r = KINDS[name](rng, PLAIN)
        env, away = Path.random(rng), open_by * rng.normal(size=6)
        start = env(0.0) * pose(0.7 * rng.normal(size=6 - r))
        path = Path.random(rng)
        p = np.vstack((start.translation + away[:3], path.p[1:]))
        return cls(pair, Path(pin.exp3(away[3:]) @ start.rotation, p, path.w), env)

    @property
    def relative(self) -> tuple[np.ndarray, np.ndarray]:
        """V_rel and a_rel at O, from differentiated poses, carried by Pinocchio."""
        at_O = pin.SE3(np.eye(3), self.env(0.0).translation - self.body(0.0).translation)
        return tuple(
            a - at_O.act(pin.Motion(e)).vector
            for a, e in zip(kinematics(self.body), kinematics(self.env), strict=True)
        )

    def contact(self) -> Contact:
        X_WO, X_WE = self.body(0.0), self.env(0.0)
        return self.pair.contact(X_WO, kinematics(self.body)[0], X_WE, kinematics(self.env)[0])

    def gaps(self, t: float) -> np.ndarray:
        return self.pair.gaps(self.body(t), self.env(t))

    def N_at(self, t: float) -> np.ndarray:
        """(6, r) N at time t, written at the operational point of t = 0."""
        N = self.pair.contact(self.body(t), STILL, self.env(t)).N
        away = pin.SE3(np.eye(3), self.body(t).translation - self.body(0.0).translation)
        return away.toActionMatrixInverse().T @ N


def near(value: np.ndarray, expected: np.ndarray, scale: np.ndarray, tolerance: float) -> None:
    """Against the size of the summands, both bodies moving at about 1 m/s and 1 rad/s."""
    assert value.shape == expected.shape
    scale = scale + 0.1
    assert (np.abs(value - expected) <= tolerance * scale).all(), (value, expected, scale)


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("name", ALL)
def test_motions_that_keep_the_contact(name: str, turn: int) -> None:
    motion = Motion.keeping(name, turn)
    contact, (V_rel, a_rel) = motion.contact(), motion.relative
    for t in (0.0, -0.3, 0.2):
        np.testing.assert_allclose(motion.gaps(t), 0.0, atol=1e-12)
    size = np.abs(contact.N).T
    near(contact.N.T @ V_rel, np.zeros(contact.r), size @ np.abs(V_rel), 1e-10)
    near(contact.n_gamma, contact.N.T @ a_rel, size @ np.abs(a_rel), 1e-8)
    if contact.r not in (0, 6):
        assert np.abs(contact.n_gamma).max() > 1e-4  # n_γ = 0 would not do


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("name", ALL)
def test_n_gamma_is_minus_the_rate_of_N_on_the_motion(name: str, turn: int) -> None:
    motion = Motion.keeping(name, turn) if name in BY_T else Motion.breaking(name, turn, 0.2)
    contact, (V_rel, _) = motion.contact(), motion.relative
    np.testing.assert_allclose(motion.N_at(0.0), contact.N, atol=1e-15)
    N_dot = rate(motion.N_at)
    near(contact.n_gamma, -N_dot.T @ V_rel, np.abs(N_dot).T @ np.abs(V_rel), 1e-7)


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("open_by", [0.0, 0.2])
@pytest.mark.parametrize("name", ALL)
def test_gaps_shrink_along_the_columns_of_N(name: str, open_by: float, turn: int) -> None:
    """In contact for every pair, and for all but the screw with the gaps open too."""
    if name == "screw":
        open_by = 0.0
    motion = Motion.breaking(name, turn, open_by)
    contact, (V_rel, a_rel) = motion.contact(), motion.relative
    size = np.abs(contact.N).T
    near(rate(motion.gaps), -contact.N.T @ V_rel, size @ np.abs(V_rel), 1e-8)
    if name not in BY_T:
        expected = contact.n_gamma - contact.N.T @ a_rel
        scale = size @ np.abs(a_rel) + np.abs(contact.n_gamma)
        near(rate(motion.gaps, 2), expected, scale, 1e-7)


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("open_by", [0.0, 0.2])
@pytest.mark.parametrize("name", ALL)
def test_N_and_T_do_no_work_on_one_another(name: str, open_by: float, turn: int) -> None:
    motion = Motion.breaking(name, turn, open_by)
    contact = motion.contact()
    r = KINDS[name](np.random.default_rng(turn), PLAIN)[2]
    assert contact.r == r and contact.T.shape == (6, 6 - r) and contact.name == motion.pair.name
    power = np.abs(contact.N.T @ contact.T)
    assert (power <= 1e-12 * (np.abs(contact.N).T @ np.abs(contact.T))).all()
    assert motion.gaps(0.0).shape == (r,)
    if r:
        assert np.linalg.svd(contact.N / np.linalg.norm(contact.N, axis=0))[1][-1] > 1e-3


@pytest.mark.parametrize("turn", range(3))
@pytest.mark.parametrize("name", ALL)
def test_every_pair_from_its_gaps_alone(name: str, turn: int) -> None:
    """`GapFunctions` on the gaps of the others finds their N and n_γ."""
    motion = Motion.keeping(name, turn)
    contact = motion.contact()
    other = Motion(
        GapFunctions(lambda X: motion.pair.gaps(X), length=1.0), motion.body, motion.env
    ).contact()
    np.testing.assert_allclose(
        other.N, contact.N, atol=1e-9 * (1 + np.abs(contact.N).max(initial=0))
    )
    scale = 1.0 + np.abs(contact.n_gamma).max(initial=0.0)
    np.testing.assert_allclose(other.n_gamma, contact.n_gamma, atol=1e-7 * scale)


@pytest.mark.parametrize("name", ALL)
def test_the_environment_defaults_to_the_world_at_rest(name: str) -> None:
    pair, pose, r = KINDS[name](np.random.default_rng(5), PLAIN)
    X_WO = pose(np.full(6 - r, 0.3))
    V_O, V_E, here = np.arange(6.0), np.arange(6.0)[::-1].copy(), pin.SE3.Identity()
    for one, other in (
        (pair.contact(X_WO, V_O), pair.contact(X_WO, V_O, here, STILL)),
        (pair.contact(X_WO, V_O, V_E=V_E), pair.contact(X_WO, V_O, here, V_E)),
    ):
        np.testing.assert_allclose(one.N, other.N, atol=1e-14)
        np.testing.assert_allclose(one.n_gamma, other.n_gamma, atol=1e-11)
    np.testing.assert_allclose(pair.gaps(X_WO), pair.gaps(X_WO, here), atol=1e-14)
    assert isinstance(pair, ContactPair)


def answer(contact: Contact, Phi: np.ndarray, f: np.ndarray, a_E: np.ndarray) -> np.ndarray:
    """f_c of a free body of inverse inertia Φ under the wrench f: Nᵀ(Φ(f − Nα) − a_E) = n_γ."""
    N = contact.N
    D = N.T @ Phi @ N
    d = 1 / np.sqrt(np.diag(D))
    alpha = d * np.linalg.solve(D * np.outer(d, d), d * (N.T @ (Phi @ f - a_E) - contact.n_gamma))
    return N @ alpha


@pytest.mark.parametrize("turn", range(13))
@pytest.mark.parametrize("name", ALL)
def test_the_contact_force_knows_no_frame_origin_basis_or_unit(name: str, turn: int) -> None:
    """13 changes of every pair, 247 in all: other frames W, A, E, another basis; mm and g."""
    rng = np.random.default_rng([turn, 9])
    Y, X_A, X_E = pose_of(rng), pose_of(rng), pose_of(rng)
    X_A.translation *= 0.2  # about the size of the object
    q, env = 0.5 * rng.normal(size=6), Path.random(rng)
    pair, pose, r = KINDS[name](np.random.default_rng(turn), PLAIN)
    moved, _, _ = KINDS[name](np.random.default_rng(turn), Coordinates(X_A, X_E, 1e3))
    X_WE = env(0.0)
    X_WO, (f, a_E, V_O, V_E) = X_WE * pose(q[: 6 - r]), rng.normal(size=(4, 6))
    inertia = pin.Inertia(2.0, 0.2 * rng.normal(size=3), np.diag(rng.uniform(0.06, 0.1, size=3)))
    Phi = np.linalg.inv(inertia.matrix())
    plain = pair.contact(X_WO, V_O, X_WE, V_E)
    f_c = answer(plain, Phi, f, a_E)

    def mm(X: pin.SE3) -> pin.SE3:
        return pin.SE3(X.rotation, 1e3 * X.translation)

    def carried(X_old: pin.SE3, X_new: pin.SE3) -> np.ndarray:
        """(6, 6) twists at one body-fixed origin, W axes (m) → another origin, W′ axes (mm)."""
        away = pin.SE3(np.eye(3), X_new.translation - X_old.translation)
        turned = pin.SE3(Y.rotation, np.zeros(3))
        return np.diag([1e3] * 3 + [1.0] * 3) @ (turned * away.inverse()).toActionMatrix()

    to_O, to_E = carried(X_WO, X_WO * X_A), carried(X_WE, X_WE * X_E)
    forces = 1e9 * np.linalg.inv(to_O).T  # power: g mm²/s³ = 1e-9 W
    changed = moved.contact(mm(Y * X_WO * X_A), to_O @ V_O, mm(Y * X_WE * X_E), to_E @ V_E)
    f_changed = answer(changed, to_O @ Phi @ to_O.T / 1e9, forces @ f, to_O @ a_E)
    M = np.linalg.qr(rng.normal(size=(r, r)))[0] * rng.uniform(0.3, 3.0, size=r)
    f_basis = answer(Contact(plain.N @ M, plain.n_gamma @ M), Phi, f, a_E)
    scale = np.abs(f_c).max() + np.abs(f).max()
    for other in (np.linalg.solve(forces, f_changed), f_basis):
        np.testing.assert_allclose(other, f_c, rtol=0, atol=1e-9 * scale)


@pytest.mark.parametrize("turn", range(4))
@pytest.mark.parametrize("name", ["sphere_on_plane", "edge_on_face", "face_on_face"])
def test_lifted_objects_have_open_gaps(name: str, turn: int) -> None:
    """Outward normals: an object moved along the face's normal is that far away from it."""
    pair, pose, r = KINDS[name](np.random.default_rng(turn), PLAIN)
    normal = pair.normal if name == "sphere_on_plane" else pair.face_normal
    X = pose(np.full(6 - r, 0.2))
    lifted = pin.SE3(X.rotation, X.translation + 0.05 * normal)
    np.testing.assert_allclose(pair.gaps(lifted), np.full(r, 0.05), atol=1e-13)
    np.testing.assert_allclose(pair.contact(X, STILL).N[:3], np.tile(-normal[:, None], r))


def test_a_face_of_the_object_pushes_along_its_own_outward_normal() -> None:
    pair = FaceOnVertex([0.0, 0, -0.1], [0.0, 0, -2.0], [0.3, 0.2, 0.0])
    X = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.15]))
    np.testing.assert_allclose(pair.gaps(X), [0.05])
    np.testing.assert_allclose(pair.contact(X, STILL).N[:, 0], [0, 0, -1, -0.2, 0.3, 0])


@pytest.mark.parametrize(("side", "down"), [(1.0, 1), (-1.0, -1), ([0.1, 0.3, 2.0], 1)])
def test_edges_cross_with_the_environment_on_the_stated_side(side: object, down: int) -> None:
    """e_A × e_E = y × x = −z."""
    pair = EdgeOnEdge([0.0, 5, 0.02], [0.0, 1, 0], [7.0, 0, 0], [1.0, 0, 0], side)
    here = pin.SE3.Identity()
    np.testing.assert_allclose(pair.gaps(here), [down * 0.02], atol=1e-15)
    np.testing.assert_allclose(pair.contact(here, STILL).N[:, 0], [0, 0, -down, 0, 0, 0])
    along_x = pin.SE3(np.eye(3), np.array([0.4, 0, 0]))  # the crossing point follows the object
    np.testing.assert_allclose(pair.contact(along_x, STILL).N[:, 0], [0, 0, -down, 0, 0, 0])


def test_the_cone_has_the_two_motions_of_figure_2() -> None:
    rng = np.random.default_rng(2)
    pair, pose, _ = KINDS["cone_in_groove"](rng, PLAIN)
    X = pose(np.array([0.4, -0.3]))
    apex, axis = X.rotation @ pair.apex, X.rotation @ pair.axis
    t_1 = np.concatenate((np.cross(apex, axis), axis))
    t_2 = np.concatenate((pair.groove_direction, np.zeros(3)))
    np.testing.assert_allclose(pair.contact(X, STILL).T, np.column_stack((t_1, t_2)), atol=1e-14)


def test_a_screw_is_closed_again_after_every_turn_and_open_in_between() -> None:
    pair = Screw(np.zeros(3), [0.0, 0, 1], 0.002)
    for turns in (1, -2, 7):
        lifted = pin.SE3(np.eye(3), np.array([0, 0, 0.002 * 2 * np.pi * turns]))
        np.testing.assert_allclose(pair.gaps(lifted), 0.0, atol=1e-15)
    low = pin.SE3(about(np.array([0.0, 0, 1]), 0.5), np.zeros(3))
    np.testing.assert_allclose(pair.gaps(low), [0, 0, 0, 0, 0.001], atol=1e-15)


def test_a_joint_angle_error_is_a_gap_in_radians() -> None:
    """Couples push against rotations about the axes of the environment: −θ for a turn by θ."""
    for axis in range(3):
        gaps = Fixed().gaps(pin.SE3(about(np.eye(3)[axis], 1e-4), np.zeros(3)))
        np.testing.assert_allclose(gaps, -1e-4 * np.eye(6)[3 + axis], atol=2e-8)
    np.testing.assert_allclose(Fixed().contact(pin.SE3.Identity(), STILL).N, np.eye(6))


@pytest.mark.parametrize("name", ALL)
def test_pairs_are_frozen_and_comparable(name: str) -> None:
    pair, _, _ = KINDS[name](np.random.default_rng(1), PLAIN)
    with pytest.raises(AttributeError):
        pair.name = "other"
    assert pair == pair and pair in {pair}
    assert "name" in {f.name for f in fields(pair)} and pair.name in repr(pair)


Z, O3 = [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SphereOnPlane(O3, -1.0, O3, Z, name="ball"), "ball.radius = -1.0"),
        (lambda: SphereOnPlane(O3, 1.0, O3, O3, name="ball"), "ball.normal is zero"),
        (lambda: FaceOnVertex(O3, O3, O3, name="lid"), "lid.normal is zero"),
        (lambda: FaceOnVertex(O3, Z, O3, np.nan, name="lid"), "lid.radius = nan"),
        (lambda: EdgeOnEdge(O3, O3, O3, Z), "edge_on_edge.direction_A is zero"),
        (lambda: EdgeOnEdge(O3, Z, O3, [1.0]), r"edge_on_edge.direction_E: expected shape \(3\)"),
        (lambda: EdgeOnEdge(O3, Z, O3, Z, side=0.5), r"edge_on_edge.side = 0.5; give \+1 or −1"),
        (lambda: EdgeOnEdge(O3, Z, O3, Z, side=O3), "edge_on_edge.side is zero"),
        (lambda: EdgeOnFace(O3, Z, O3, Z, length=0.0), "edge_on_face.length = 0.0"),
        (lambda: CylinderOnPlane(O3, Z, -0.1, O3, Z), "cylinder_on_plane.radius = -0.1"),
        (lambda: CylinderOnPlane(O3, Z, 0.1, O3, Z, np.inf), "cylinder_on_plane.length = inf"),
        (lambda: FaceOnFace(O3, Z, O3, Z, size=-1.0), "face_on_face.size = -1.0"),
        (lambda: CylinderInHole(O3, Z, O3, O3), "cylinder_in_hole.hole_direction is zero"),
        (lambda: CylinderInHole(O3, Z, O3, Z, 0.0), "cylinder_in_hole.length = 0.0"),
        (lambda: ConeInGroove(O3, Z, O3, Z, O3), "cone_in_groove.seat is zero"),
        (lambda: Revolute(O3, O3), "revolute.axis is zero"),
        (lambda: Prismatic([0.0], Z), r"prismatic.point: expected shape \(3\)"),
        (lambda: Screw(O3, Z, 0.0), "screw.pitch = 0.0"),
        (lambda: Screw(O3, Z, np.nan), "screw.pitch = nan"),
        (lambda: GapFunctions(lambda X: X.translation, length=0.0), "gap_functions.length = 0.0"),
        (lambda: GapFunctions(lambda X: X.translation, step=1.0), "gap_functions.step = 1.0"),
    ],
)
def test_impossible_geometry_is_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        make()


def test_contacts_that_do_not_exist_are_refused() -> None:
    here = pin.SE3.Identity()
    parallel = EdgeOnEdge(O3, Z, [0.1, 0, 0], Z, name="rails")
    for ask in (lambda: parallel.contact(here, STILL), lambda: parallel.gaps(here)):
        with pytest.raises(ContactError, match="rails: the edges are parallel"):
            ask()
    flat = GapFunctions(lambda X: [1.0])  # a gap that no motion changes
    with pytest.raises(ContactError, match="column 0 is zero"):
        flat.contact(here, STILL)
    with pytest.raises(InvalidInputError, match=r"broken.gap\(X_EA\): element \(0,\) is nan"):
        GapFunctions(lambda X: [np.nan], name="broken").gaps(here)
