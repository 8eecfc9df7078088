"""Contact pairs in motion for tests: geometry, free coordinates, and motions of both bodies.

A kind of pair is registered with its free coordinates, written without N or T, which give poses in
contact. Twists and accelerations follow from differentiated poses. A pair that is not here
registers its kind in its own test, tests/test_NAME.py, and so takes part in the tests of all pairs.

A kind is a function of random numbers and `Coordinates` that returns the pair, a function from the
free coordinates (6−r,) to a pose X_EA in contact, and r. A is the object, E the touched body.
"""

import re
import sys
from dataclasses import dataclass, field
from importlib import import_module

import numpy as np
import pinocchio as pin
from numpy.random import default_rng
from rigs import direction, pose_of, shift, vector

import osc_contact as osc
from osc_contact.contacts.pairs import PAIRS


@dataclass(frozen=True)
class Path:
    """Motion X(t) = (exp₃(w₁t + w₂t²) R₀, p₀ + p₁t + p₂t²), a function of the time.

    At t = 0, ω = w₁, ω̇ = 2w₂, v = p₁, p̈ = 2p₂.

    Attributes:
        R0: (3, 3).
        p: (3, 3) rows p₀, p₁, p₂.
        w: (2, 3) rows w₁, w₂.
    """

    R0: np.ndarray
    p: np.ndarray
    w: np.ndarray

    @classmethod
    def random(cls, rng):
        """Random motion."""
        return cls(pose_of(rng).rotation, rng.standard_normal((3, 3)), rng.standard_normal((2, 3)))

    def __call__(self, t):
        """Pose at the time t."""
        p0, p1, p2 = self.p
        return pin.SE3(
            pin.exp3(self.w[0] * t + self.w[1] * t * t) @ self.R0, p0 + t * (p1 + t * p2)
        )


def scaled(X, size):
    """Pose with `size` times the position of X."""
    return pin.SE3(X.rotation, size * X.translation)


@dataclass(frozen=True)
class Coordinates:
    """Coordinates to which the geometry of a pair is converted: other unit, other frame E′.

    Attributes:
        X_E: pose of E′ in the environment's frame E.
        per_metre: units of length per metre.
    """

    X_E: pin.SE3 = field(default_factory=pin.SE3.Identity)
    per_metre: float = 1.0

    def A(self, point):
        """Convert a point (3,) of the object."""
        return self.per_metre * point

    def E(self, point):
        """Convert a point (3,) of the environment from E to E′."""
        return self.per_metre * self.X_E.actInv(point)

    def along_E(self, direction):
        """Convert a direction (3,) of the environment from E to E′."""
        return self.X_E.rotation.T @ direction

    def pose(self, X_EA):
        """Convert a pose of the object from E to E′."""
        return scaled(self.X_E.actInv(X_EA), self.per_metre)

    def gap(self, gap):
        """Convert a gap function of X_EA (m) to a function of the pose in E′ in these units."""

        def rewritten(X):
            """Gaps (r,) at the pose X in E′."""
            return self.per_metre * gap(self.X_E * scaled(X, 1 / self.per_metre))

        return rewritten


PLAIN = Coordinates()
KINDS = {}  #: kinds of pairs by name; see `kind`


def kind(make):
    """Register a kind of pair, a function as described above, by its name; return it."""
    KINDS[make.__name__] = make
    return make


def about(axis, angle):
    """Rotation (3, 3) about a unit vector by an angle (rad)."""
    return pin.exp3(angle * axis)


def carrying(start, end):
    """Rotation (3, 3) by the least angle that turns a unit vector into another."""
    return pin.Quaternion.FromTwoVectors(start, end).matrix()


def placed(R, of_A, at_E):
    """Pose X_EA with the rotation R that puts a point of A at a point of E, (3,) each."""
    return pin.SE3(R, at_E - R @ of_A)


def in_plane(normal):
    """Two perpendicular unit vectors, rows (2, 3), in the plane with a unit normal (3,)."""
    return np.linalg.svd(normal[None, :])[2][1:]


def two_lines(rng):
    """Random point and direction of the object, then of the environment, (3,) each."""
    return (rng.standard_normal(3), direction(rng), rng.standard_normal(3), direction(rng))


def ball_on_plane(rng, make, rho):
    """Ball of radius rho on a plane, r = 1.

    Args:
        rng: random numbers.
        make: function from centre, point and normal of the plane to the pair.
        rho: radius (m).
    """
    centre, point = rng.standard_normal((2, 3))
    n = direction(rng)
    plane = in_plane(n)
    pair = make(centre, point, n)
    return (pair, lambda q: placed(pin.exp3(q[:3]), centre, point + q[3:] @ plane + rho * n), 1)


@kind
def vertex_on_face(rng, c):
    """`VertexOnFace` with a radius."""

    def make(vertex, point, n):
        """Pair of a vertex, a point of the face and its normal."""
        return osc.VertexOnFace(c.A(vertex), c.E(point), c.along_E(n), 0.2 * c.per_metre)

    return ball_on_plane(rng, make, 0.2)


@kind
def sphere_on_plane(rng, c):
    """`SphereOnPlane`."""

    def make(centre, point, n):
        """Pair of a centre, a point of the plane and its normal."""
        return osc.SphereOnPlane(c.A(centre), 0.3 * c.per_metre, c.E(point), c.along_E(n))

    return ball_on_plane(rng, make, 0.3)


@kind
def face_on_vertex(rng, c):
    """`FaceOnVertex` with a radius."""
    point, n, vertex, _ = two_lines(rng)
    rho = 0.2
    plane = in_plane(n)
    pair = osc.FaceOnVertex(c.A(point), n, c.E(vertex), rho * c.per_metre)
    return (pair, lambda q: placed(pin.exp3(q[:3]), point + q[3:] @ plane + rho * n, vertex), 1)


def crossed_edges(rng, c, hint):
    """`EdgeOnEdge`; the side of the material is given as a direction (`hint`) or as a sign."""
    a, b = rng.standard_normal((2, 3))
    e = direction(rng)
    f = direction(rng)
    # turned by at most about 1 rad from perpendicular, so that the edges never become parallel
    R0 = carrying(e, np.cross(f, in_plane(f)[0]))
    side = c.along_E(-np.cross(R0 @ e, f)) if hint else -1.0
    pair = osc.EdgeOnEdge(c.A(a), 2 * e, c.E(b), 3 * c.along_E(f), side)
    return (pair, lambda q: placed(pin.exp3(0.3 * q[:3]) @ R0, a + q[3] * e, b + q[4] * f), 1)


@kind
def edge_on_edge(rng, c):
    """`EdgeOnEdge` with a sign as its side."""
    return crossed_edges(rng, c, hint=False)


@kind
def edge_on_edge_with_hint(rng, c):
    """`EdgeOnEdge` with a direction as its side."""
    return crossed_edges(rng, c, hint=True)


def line_on_plane(rng, c, make, rho):
    """Line of the object at the distance rho (m) above a plane, r = 2.

    Args:
        rng: random numbers.
        c: coordinates.
        rho: distance (m).
        make: function from point and direction of the line, point and normal of the plane to the
            pair.
    """
    point, e, face, n = two_lines(rng)
    plane = in_plane(n)
    R0 = carrying(e, plane[0])

    def pose(q):
        """Pose of two turns and two shifts q (4,)."""
        return placed(about(n, q[0]) @ R0 @ about(e, q[1]), point, face + q[2:] @ plane + rho * n)

    return (make(c.A(point), e, c.E(face), c.along_E(n)), pose, 2)


@kind
def edge_on_face(rng, c):
    """`EdgeOnFace`."""

    def make(*lines):
        """Pair of a line and a plane."""
        return osc.EdgeOnFace(*lines, 0.3 * c.per_metre)

    return line_on_plane(rng, c, make, 0.0)


@kind
def cylinder_on_plane(rng, c):
    """`CylinderOnPlane`."""

    def make(point, e, *plane):
        """Pair of an axis and a plane."""
        return osc.CylinderOnPlane(point, e, 0.15 * c.per_metre, *plane, 0.4 * c.per_metre)

    return line_on_plane(rng, c, make, 0.15)


@kind
def face_on_face(rng, c):
    """`FaceOnFace`: a turn and two shifts are free."""
    point, n, face, m = two_lines(rng)
    R0 = carrying(n, -m)
    plane = in_plane(m)
    pair = osc.FaceOnFace(c.A(point), n, c.E(face), c.along_E(m), 0.2 * c.per_metre)
    return (pair, lambda q: placed(about(m, q[0]) @ R0, point, face + q[1:] @ plane), 3)


@kind
def cylinder_in_hole(rng, c):
    """`CylinderInHole`: a turn and a shift along the axis are free."""
    point, e, hole, h = two_lines(rng)
    R0 = carrying(e, h)
    pair = osc.CylinderInHole(c.A(point), e, c.E(hole), c.along_E(h), 0.2 * c.per_metre)
    return (pair, lambda q: placed(about(h, q[0]) @ R0, point, hole + q[1] * h), 4)


@kind
def cone_in_groove(rng, c):
    """`ConeInGroove`: a turn about the seat and a shift along the groove are free."""
    apex, axis, point, groove = two_lines(rng)
    seat = direction(rng)
    R0 = carrying(axis, seat)
    pair = osc.ConeInGroove(c.A(apex), axis, c.E(point), c.along_E(groove), c.along_E(seat))
    return (pair, lambda q: placed(about(seat, q[0]) @ R0, apex, point + q[1] * groove), 4)


def joint(rng, c, make, turns=0.0, slides=0.0):
    """Joint on a random axis of the object, r = 5.

    Args:
        rng: random numbers.
        c: coordinates.
        make: class of the pair.
        turns: turn for q = 1 (rad).
        slides: shift for q = 1 (m); None: random.
    """
    point = rng.standard_normal(3)
    e = direction(rng)
    X = pose_of(rng)
    along = slides if np.isscalar(slides) else rng.normal()

    def pose(q):
        """Pose of the coordinate q (1,)."""
        return X * placed(about(e, turns * q[0]), point, point + along * q[0] * e)

    pitch = (along * c.per_metre,) if turns and along else ()  # an argument of screws
    return (make(c.A(point), e, *pitch, c.pose(X)), pose, 5)


@kind
def revolute(rng, c):
    """`Revolute`."""
    return joint(rng, c, osc.Revolute, turns=1.0)


@kind
def prismatic(rng, c):
    """`Prismatic`."""
    return joint(rng, c, osc.Prismatic, slides=1.0)


@kind
def screw(rng, c):
    """`Screw` with a random pitch."""
    return joint(rng, c, osc.Screw, turns=1.0, slides=None)


@kind
def fixed(rng, c):
    """`Fixed`, r = 6."""
    X = pose_of(rng)
    return (osc.Fixed(c.pose(X)), lambda q: X, 6)


@kind
def free(rng, c):
    """`Free`, r = 0."""
    return (osc.Free(), lambda q: pin.SE3(pin.exp3(q[:3]), q[3:]), 0)


@kind
def point_on_a_saddle(rng, c):
    """`GapFunctions` of a point on the surface z = k x² + m y³."""
    vertex = rng.standard_normal(3)
    (k, m) = rng.standard_normal(2)
    X = pose_of(rng)

    def gap(X_EA):
        """Gap (1,) along z."""
        x, y, z = X.actInv(X_EA.act(vertex))
        return vector(z - k * x * x - m * y * y * y)

    def pose(q):
        """Pose of three turns and two shifts q (5,)."""
        x, y = 0.5 * q[3:]
        return placed(pin.exp3(q[:3]), vertex, X.act(vector(x, y, k * x * x + m * y**3)))

    return (osc.GapFunctions(c.gap(gap), length=0.5 * c.per_metre), pose, 1)


@kind
def bead_on_a_wire(rng, c):
    """`GapFunctions` of a point on the curve y = sin x, z = x²/2."""
    bead = rng.standard_normal(3)
    X = pose_of(rng)

    def gap(X_EA):
        """Gaps (2,) along y and z."""
        x, y, z = X.actInv(X_EA.act(bead))
        return vector(y - np.sin(x), z - 0.5 * x * x)

    def pose(q):
        """Pose of three turns and a shift along the curve q (4,)."""
        return placed(pin.exp3(q[:3]), bead, X.act(vector(q[3], np.sin(q[3]), 0.5 * q[3] ** 2)))

    return (osc.GapFunctions(c.gap(gap), length=0.5 * c.per_metre), pose, 2)


def steps(order, reach):
    """Nodes −reach … reach and weights of the central difference of order 1 or 2."""
    k = np.arange(1.0, reach + 1)
    weights = order * np.cumprod((k - 1 - reach) / (k + reach)) / -(k**order)
    sign = 1.0 if order == 2 else -1.0
    middle = -2.0 * weights.sum() if order == 2 else 0.0
    return (np.arange(-reach, reach + 1), np.concatenate((sign * weights[::-1], [middle], weights)))


def rate(f, order=1, h=5e-3, reach=4):
    """Derivative of f at 0 of order 1 or 2, by central differences with an error O(h^(2 reach)).

    Args:
        f: function of a number, which returns an array.
        order: 1 or 2.
        h: step.
        reach: number of steps to either side.
    """
    k, weights = steps(order, reach)
    return np.tensordot(weights, np.array([f(x * h) for x in k]), 1) / h**order


def kinematics(X):
    """Twist and spatial acceleration (6,) at the body's origin at t = 0, by differentiated poses.

    [ω]× and [ω̇]× are the odd parts of ṘRᵀ and R̈Rᵀ; the spatial acceleration is p̈ − ω × ṗ.

    Args:
        X: function from the time to the pose.
    """
    R = X(0.0).rotation

    def odd(A):
        """Vector (3,) of the odd part of a matrix (3, 3)."""
        return 0.5 * vector(A[2, 1] - A[1, 2], A[0, 2] - A[2, 0], A[1, 0] - A[0, 1])

    p_dot, p_ddot = (rate(lambda t: X(t).translation, order) for order in (1, 2))
    w, w_dot = (odd(rate(lambda t: X(t).rotation, order) @ R.T) for order in (1, 2))
    return (np.append(p_dot, w), np.append(p_ddot - np.cross(w, p_dot), w_dot))


@dataclass(frozen=True)
class Motion:
    """Pair with motions of both bodies.

    Attributes:
        pair: the pair.
        body, env: functions from the time to the poses of object and environment in the world.
    """

    pair: osc.ContactPair
    body: object
    env: object

    @classmethod
    def keeping(cls, name, turn, per_metre):
        """Motion of both bodies that keeps the contact.

        Args:
            name: kind of the pair.
            turn: seed.
            per_metre: units of length per metre.
        """
        rng = default_rng([turn, 7])
        pair, pose, r = KINDS[name](rng, Coordinates(per_metre=per_metre))
        env = Path.random(rng)
        q = 0.7 * rng.standard_normal((3, 6 - r))

        def body(t):
            """Pose of the object at the time t."""
            return scaled(env(t) * pose(q[0] + q[1] * t + q[2] * t * t), per_metre)

        return cls(pair, body, lambda t: scaled(env(t), per_metre))

    @classmethod
    def breaking(cls, name, turn, open_by):
        """Motion of both bodies that does not keep the contact.

        Args:
            name: kind of the pair.
            turn: seed.
            open_by: size of the displacement from contact at t = 0 (m, rad).
        """
        rng = default_rng([turn, 8])
        pair, pose, r = KINDS[name](rng, PLAIN)
        env = Path.random(rng)
        away = open_by * rng.standard_normal(6)
        start = env(0.0) * pose(0.7 * rng.standard_normal(6 - r))
        path = Path.random(rng)
        p = np.vstack((start.translation + away[:3], path.p[1:]))
        return cls(pair, Path(pin.exp3(away[3:]) @ start.rotation, p, path.w), env)

    @property
    def relative(self):
        """V_rel and a_rel (6,) at O at t = 0, from differentiated poses."""
        at_O = shift(self.env(0.0).translation - self.body(0.0).translation)
        return tuple(
            a - at_O.act(pin.Motion(e)).vector
            for a, e in zip(kinematics(self.body), kinematics(self.env), strict=True)
        )

    def contact(self):
        """Contact of the pair at t = 0."""
        X_WO = self.body(0.0)
        X_WE = self.env(0.0)
        return self.pair.contact(X_WO, kinematics(self.body)[0], X_WE, kinematics(self.env)[0])

    def gaps(self, t):
        """Gaps (r,) of the pair at the time t."""
        return self.pair.gaps(self.body(t), self.env(t))


def touching(name, X_WO, seed, per_metre=1.0):
    """Random pair of a kind that is in contact at the object's pose X_WO, fixed to the world.

    Args:
        name: kind of the pair.
        X_WO: pose of the object.
        seed: seed.
        per_metre: units of length per metre.
    """
    _, pose, r = KINDS[name](default_rng(seed), PLAIN)
    start = pose(0.3 * default_rng(seed).standard_normal(6 - r))
    X_E = start * scaled(X_WO, 1 / per_metre).inverse()
    return KINDS[name](default_rng(seed), Coordinates(X_E=X_E, per_metre=per_metre))[0]


def snake(name):
    """Convert the name of a class to that of a function: FaceOnFace to face_on_face."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower()


for _module in (f"test_{snake(name)}" for name in PAIRS if snake(name) not in KINDS):
    if _module not in sys.modules and _module != "test_gap_functions":
        import_module(_module)
