"""Environments, the bodies that the object touches: a_e = Φ_e f_c + b_e (eq. 14).

An `Environment` holds for one instant, at the operational point O in world axes, and is made anew
at each tick. The motion of a body is given by its pose, its twist and its *classical* acceleration
at its own origin (readings of a tracker or an encoder), and is converted to spatial vectors at O.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt
import pinocchio as pin
from pinocchio import SE3

from osc_contact import robots
from osc_contact.errors import InvalidInputError, ModelError
from osc_contact.projections import left_inverse, unit_diagonal
from osc_contact.spatial import (
    Array,
    Coordinates,
    Poses,
    as_array,
    carry_twist,
    classical_to_spatial,
    columns_of,
    cross,
    cross_wrench,
    geometry,
    rotated,
    rotations,
    unit_vector,
)


def symmetric(matrix: Array) -> Array:
    """Symmetric part ½ (A + Aᵀ) of a matrix (n, n), to remove rounding errors."""
    return 0.5 * (matrix + matrix.T)


def inverse(matrix: Array, name: str) -> Array:
    """Invert a positive definite matrix (n, n) after scaling it to unit diagonal.

    Args:
        matrix: (n, n).
        name: name of the matrix, for messages.

    Raises:
        ModelError: the matrix is singular up to rounding, asymmetric, or not finite.
    """
    expected = "every body a mass and inertia, and independent axes"
    scaled, size = unit_diagonal(matrix, name, expected, ModelError)
    return np.linalg.inv(symmetric(scaled)) / np.outer(size, size)


def require_inverse_inertia(name: str, scaled: Array) -> None:
    """Refuse a matrix that is not the inverse inertia of a passive mechanism.

    Args:
        name: name of the matrix, for messages.
        scaled: (n, n) dimensionless, with a largest element near 1.

    Raises:
        InvalidInputError: the matrix is not symmetric positive semidefinite.
    """
    if np.abs(scaled - scaled.T).max(initial=0.0) > 1e-9:
        raise InvalidInputError(f"{name} is not symmetric; an inverse inertia is")
    smallest = np.linalg.eigvalsh(scaled).min(initial=0.0)
    if smallest < -1e-9:
        raise InvalidInputError(
            f"{name} is not positive semidefinite (scaled eigenvalue {smallest:.3g}); "
            "no passive body accelerates against the force on it"
        )


def element_sizes(Phi: Array) -> Array:
    """Units (6, 6) of the elements of Φ_e, by its most mobile linear and angular axis.

    There is one scale for the linear and one for the angular axes, so that rounding errors in a
    locked direction (for example of an inverse inertia carried from another point) are not
    amplified. Linear mobilities below 1 mm/rad times the angular mobility count as rounding errors,
    too, such as those of an axis through O.

    Args:
        Phi: Φ_e (6, 6).
    """
    largest = np.sqrt(np.diag(Phi).reshape(2, 3).max(axis=1, initial=0.0))
    largest = np.maximum(largest, 1e-3 * largest[::-1])
    largest[largest == 0.0] = 1.0
    scale = np.repeat(largest, 3)
    return np.outer(scale, scale)


_ZERO = np.zeros(3)


class _HasNormals(Protocol):
    """State of contact with its normals N (6, r)."""

    N: Array


@dataclass(frozen=True)
class Environment:
    """Environment at one instant, at the operational point in world axes (eq. 14).

    Attributes:
        Phi_e: (6, 6) inverse inertia, positive semidefinite: acceleration per contact force.
        b_e: (6,) spatial acceleration without contact (m/s², rad/s²).
        V_e: (6,) twist (m/s, rad/s).

    Raises:
        InvalidInputError: wrong shapes, or Φ_e not symmetric positive semidefinite.

    Example:
        >>> cart = dict(X_WE=pin.SE3.Identity(), axes=[1, 0, 0, 0, 0, 0], rates=[0.1], O=[0, 0, 0])
        >>> environment = osc.Environment.rail(pin.Inertia.FromSphere(20.0, 0.1), **cart)
        >>> print(environment.Phi_e[0, 0], environment.V_e[:3])
        0.05 [0.1 0.  0. ]
    """

    Phi_e: Array = field(default_factory=lambda: np.zeros((6, 6)))
    b_e: Array = field(default_factory=lambda: np.zeros(6))
    V_e: Array = field(default_factory=lambda: np.zeros(6))

    def __post_init__(self) -> None:
        """Convert the attributes to arrays.

        Raises:
            InvalidInputError: see the class.
        """
        for name, shape in {"Phi_e": (6, 6), "b_e": (6,), "V_e": (6,)}.items():
            object.__setattr__(self, name, as_array(name, getattr(self, name), shape))
        require_inverse_inertia("Phi_e", self.Phi_e / element_sizes(self.Phi_e))

    @classmethod
    def fixed(cls) -> Environment:
        """Environment at rest that does not yield: Φ_e = 0, b_e = 0."""
        return cls()

    @classmethod
    def moving(
        cls,
        *,
        X_WE: SE3,
        V_E: npt.ArrayLike,
        A_E: npt.ArrayLike,
        O: npt.ArrayLike,  # noqa: E741 - the operational point
    ) -> Environment:
        """Environment of a body with prescribed motion, which does not yield: Φ_e = 0.

        Args:
            X_WE: pose of the body in the world.
            V_E: (6,) twist [ṗ; ω] at the body's origin, world axes (m/s, rad/s).
            A_E: (6,) *classical* acceleration [p̈; ω̇] of its origin, world axes (m/s², rad/s²).
            O: (3,) operational point in the world (m).

        Raises:
            InvalidInputError: wrong shapes or non-finite numbers.
        """
        V = as_array("V_E", V_E, (6,))
        A = classical_to_spatial(as_array("A_E", A_E, (6,)), V)
        p = X_WE.translation
        point = as_array("O", O, (3,))
        return cls(b_e=carry_twist(A, p, point), V_e=carry_twist(V, p, point))

    @classmethod
    def rail(
        cls,
        inertia: pin.Inertia,
        *,
        X_WE: SE3,
        axes: npt.ArrayLike,
        rates: npt.ArrayLike,
        O: npt.ArrayLike,  # noqa: E741 - the operational point
        gravity: npt.ArrayLike = _ZERO,
        force: npt.ArrayLike | None = None,
    ) -> Environment:
        """Environment of a rigid body that moves along given twists: Φ_e = A(AᵀIA)⁻¹Aᵀ, rank k.

        The equation of motion at its origin is AᵀIA s̈ = Q + Aᵀ(weight − V ×* IV). It has no drift:
        Ȧ is zero for motions fixed in the world, and Ȧṡ = V × V = 0 for those fixed in the body.

        A cart on a rail along `x`: `axes=[*x, 0, 0, 0]`, `rates=[speed]`,
        `force=[−k·s − c·speed]`. A door: axes=[ω × (p − hinge), ω] with ω a unit vector along the
        hinge. A free body: axes=np.eye(6), and the wrench on it as force. The space that the axes
        span must stay fixed in the world or in the body (slides, a hinge, a ball joint, motion in a
        plane); for a chain with moving joints in between use `articulated`.

        Args:
            inertia: inertia in the body's own frame (kg, m); for sliding axes only the mass
                matters.
            X_WE: pose of the body in the world.
            axes: (6,) or (6, k) independent twists per unit rate, at the body's own origin in
                world axes.
            rates: (k,) rates along the axes (m/s or rad/s).
            O: (3,) operational point in the world (m).
            gravity: (3,) gravitational acceleration (m/s²); default: none.
            force: (k,) other forces along the axes (springs, dampers, drives; N or N m).

        Raises:
            InvalidInputError: wrong shapes or non-finite numbers.
            ModelError: dependent axes, or no inertia along one of them.
        """
        columns = np.array(axes, dtype=object)
        A = as_array("axes", columns[:, None] if columns.ndim == 1 else columns, (6, None))
        k = A.shape[1]
        Q = np.zeros(k) if force is None else as_array("force", force, (k,))
        V = A @ as_array("rates", rates, (k,))
        p = X_WE.translation
        point = as_array("O", O, (3,))
        I: Array = SE3(X_WE.rotation, _ZERO).act(inertia).matrix()  # noqa: E741
        acting = I[:, :3] @ as_array("gravity", gravity, (3,)) - cross_wrench(V, I @ V)
        M_inv = inverse(A.T @ I @ A, "the body's inertia along its axes")
        at_O = carry_twist(A, p, point)
        b_e = at_O @ (M_inv @ (Q + A.T @ acting))
        return cls(symmetric(at_O @ M_inv @ at_O.T), b_e, carry_twist(V, p, point))

    @classmethod
    def articulated(
        cls,
        model: pin.Model,
        q: npt.ArrayLike,
        v: npt.ArrayLike,
        tau: npt.ArrayLike,
        frame: str,
        O: npt.ArrayLike,  # noqa: E741 - the operational point
        data: pin.Data | None = None,
    ) -> Environment:
        """Environment of a link of any mechanism: Φ_e = J M⁻¹Jᵀ, b_e = J M⁻¹(τ − h) + drift.

        Args:
            model: model of the mechanism, with its base placed in the world; its own gravity acts.
            q: (nq,) configuration.
            v: (nv,) velocity (m/s, rad/s).
            tau: (nv,) generalised forces without gravity (motors, springs, dampers; N or N m).
            frame: name of a frame or joint that moves with the touched link.
            O: (3,) operational point in the world (m).
            data: memory of Pinocchio; None: new data.

        Raises:
            InvalidInputError: wrong shapes or non-finite numbers.
            ModelError: no such frame, or links without inertia.
        """
        q = as_array("q", q, (model.nq,))
        v = as_array("v", v, (model.nv,))
        tau = as_array("tau", tau, (model.nv,))
        point = as_array("O", O, (3,))
        if model.existJointName(frame):
            joint = model.getJointId(frame)
        else:
            joint = model.frames[robots.frame_id(model, frame)].parentJoint
        if data is None:
            data = model.createData()
        pin.computeAllTerms(model, data, q, v)
        free = tau - data.nle
        M_inv = inverse(np.array(data.M), "the environment's joint-space inertia")
        world = pin.ReferenceFrame.WORLD
        J = carry_twist(columns_of(pin.getJointJacobian(model, data, joint, world)), _ZERO, point)
        pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
        drift = data.oMi[joint].act(data.a[joint]).vector
        b_e = J @ M_inv @ free + carry_twist(drift, _ZERO, point)
        return cls(symmetric(J @ M_inv @ J.T), b_e, J @ v)

    @classmethod
    def of_contacts(
        cls,
        N: npt.ArrayLike,
        Phi_N: npt.ArrayLike,
        b_N: npt.ArrayLike,
        V_N: npt.ArrayLike,
        metric: npt.ArrayLike,
    ) -> Environment:
        """Environment that is equivalent to different bodies at r contacts.

        The equations of contact contain only NᵀΦ_eN, Nᵀb_e and NᵀV_e, so any K with NᵀK = 1 gives
        an environment with the same contact forces and the same motion of the object:

            Φ_e = K Φ_N Kᵀ,   b_e = K b_N,   V_e = K V_N,   K = Λ⁻¹N(NᵀΛ⁻¹N)⁻¹

        It does not contain the bodies' motions tangential to their contacts: only Nᵀa_e (of each
        touched body along its own normal) is meaningful, not `a_e`. n_γ of a contact is computed
        with the twist of its body, not with the combined V_e.

        Args:
            N: (6, r) contact normals at O, the columns of all bodies.
            Phi_N: (r, r) normal acceleration of the bodies per unit contact magnitude.
            b_N: (r,) normal (spatial) accelerations without contact, each nᵀb of its body.
            V_N: (r,) normal velocities, each nᵀV of its body.
            metric: (6, 6) inertia Λ of the held object at O, for independence of units and frames.

        Raises:
            InvalidInputError: wrong shapes, or Φ_N not symmetric positive semidefinite.
            ContactError: dependent columns of N.
            ModelError: the metric is not positive definite.
        """
        N = as_array("N", N, (6, None))
        r = N.shape[1]
        Phi_N = as_array("Phi_N", Phi_N, (r, r))
        b_N = as_array("b_N", b_N, (r,))
        V_N = as_array("V_N", V_N, (r,))
        mobility = inverse(as_array("metric", metric, (6, 6)), "the metric (object inertia)")
        K = left_inverse(N, mobility, "environment of several contacts").T
        # scaled by the mobility of the held object along each normal, nᵀΛ⁻¹n
        size = np.sqrt((N * (mobility @ N)).sum(axis=0))
        scaled = Phi_N / np.outer(size, size)
        require_inverse_inertia("Phi_N", scaled / (np.abs(scaled).max(initial=0.0) or 1.0))
        return cls(symmetric(K @ Phi_N @ K.T), K @ b_N, K @ V_N)

    @classmethod
    def combine(
        cls,
        contacts: Sequence[_HasNormals],
        environments: Sequence[Environment],
        metric: npt.ArrayLike,
    ) -> Environment:
        """Environment of several contacts, from the environment of each.

        Contacts with the *same* `Environment` object are on one body, which couples them; different
        objects are bodies without mutual forces. (Two links of one mechanism have such forces:
        compute Φ_N = NᵀJM⁻¹JᵀN and use `of_contacts`.) If all contacts are on one body, or on
        bodies that share a prescribed motion, the first environment is returned. Dependent
        contacts must be on one such body; if there are other bodies, combine them to one contact
        first.

        Args:
            contacts: contacts in the order in which they are stacked.
            environments: environment of each contact, all at the same O.
            metric: (6, 6) inertia of the held object at O (`ChainState.metric`).

        Raises:
            InvalidInputError: not one environment for each contact.
            ContactError: dependent contacts on different bodies.
        """
        if len(contacts) != len(environments):
            raise InvalidInputError(
                f"{len(contacts)} contacts but {len(environments)} environments; give one for "
                "each contact (the same object again for contacts on one body)"
            )
        if not environments:
            return cls.fixed()
        if all(_move_as_one(env, environments[0]) for env in environments):
            return environments[0]
        pairs = [
            (contact.N, environment)
            for contact, environment in zip(contacts, environments, strict=True)
        ]
        return cls.of_contacts(
            N=np.hstack([N for N, _ in pairs]),
            Phi_N=_normal_mobility(pairs),
            b_N=np.concatenate([N.T @ environment.b_e for N, environment in pairs]),
            V_N=np.concatenate([N.T @ environment.V_e for N, environment in pairs]),
            metric=metric,
        )


def _normal_mobility(pairs: Sequence[tuple[Array, Environment]]) -> Array:
    """Normal accelerations (r, r) of the touched bodies at all contacts per unit of contact force.

    The block of two contacts is N₁ᵀΦ_e N₂ (1/kg for forces) if they are on one body, whose inverse
    inertia is Φ_e (6, 6), else zero.

    Args:
        pairs: normals N (6, r_i) and environment of each contact; one object for contacts on one
            body.
    """
    blocks = []
    for N, environment in pairs:
        row = []
        for other_N, other in pairs:
            if other is environment:
                row.append(N.T @ environment.Phi_e @ other_N)
            else:
                row.append(np.zeros((N.shape[1], other_N.shape[1])))
        blocks.append(row)
    return np.block(blocks)


def _move_as_one(a: Environment, b: Environment) -> bool:
    """True if two environments are one object, or have equal motions and do not yield.

    Args:
        a: first body.
        b: second body.
    """
    if a is b:
        return True
    if a.Phi_e.any() or b.Phi_e.any():
        return False
    return np.array_equal(a.b_e, b.b_e) and np.array_equal(a.V_e, b.V_e)


# Motions of bodies: at rest, driven, or free on a slide or about a hinge.


#: Function of the time (s) that returns s, ṡ, s̈ of a `Rail`, each (2,) (m, rad).
Motion = Callable[[float], tuple[Array, Array, Array]]


@geometry
class Rail:
    """Slide along u and, on it, a hinge about a; without both the body is at rest.

    The coordinates s = (travel (m), angle (rad)) are zero in the assembled pose. A point that was
    at x then is at c + u s₁ + R(a, s₂)(x − c); the hinge's axis keeps its direction.

    Attributes:
        direction: (3,) u in the world, normalised; zero: no slide.
        axis: (3,) a in the world, normalised; zero: no hinge.
        through: (3,) c, a point of the hinge's axis at s = 0 (m).
        motion: function of the time that returns s, ṡ, s̈ of a driven body; plants evaluate it once
            for each instant. None: the body is free along its single joint,
            I s̈ = (force or moment along it) + preload − k s − c ṡ.
        inertia: I of a free body, kg on a slide, kg m² about a hinge.
        stiffness, damping, preload: k, c and preload of a free body (N/m, N s/m, N on a slide;
            N m/rad, N m s/rad, N m about a hinge).

    Raises:
        InvalidInputError: impossible numbers, such as a mass that is not positive.

    Example:
        >>> cart = osc.Rail(direction=[1, 0, 0], inertia=20.0, stiffness=5e3, damping=50.0)
        >>> print(cart.pose(np.array([0.1, 0.0])).translation)
        [0.1 0.  0. ]
    """

    direction: Coordinates = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    axis: Coordinates = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    through: Coordinates = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    motion: Motion | None = None
    inertia: float = 1.0
    stiffness: float = 0.0
    damping: float = 0.0
    preload: float = 0.0

    def __post_init__(self) -> None:
        """Convert the vectors to arrays and normalise direction and axis.

        Raises:
            InvalidInputError: inertia not positive, stiffness or damping negative, or NaN.
        """
        for name in ("direction", "axis", "through"):
            value = as_array(f"rail.{name}", getattr(self, name), (3,))
            if name != "through" and value.any():
                value = unit_vector(name, value)
            object.__setattr__(self, name, value)
        for name, number, is_valid in (
            ("inertia", self.inertia, self.inertia > 0.0),
            ("stiffness", self.stiffness, self.stiffness >= 0.0),
            ("damping", self.damping, self.damping >= 0.0),
            ("preload", self.preload, True),
        ):
            if not (np.isfinite(number) and is_valid):
                raise InvalidInputError(f"rail.{name} = {number}; give a number a body can have")

    @property
    def descent(self) -> float:
        """Gravitational acceleration along the slide, u·g (m/s²)."""
        return -9.81 * float(self.direction[2])

    @property
    def joints(self) -> list[int]:
        """Indices in s of the joints: 0 of a slide, 1 of a hinge."""
        return [k for k, u in enumerate((self.direction, self.axis)) if u.any()]

    def pose(self, s: Array) -> pin.SE3:
        """Pose X_WE of the body at the coordinates s (2,), the identity at s = 0."""
        R = pin.exp3(self.axis * s[1])
        return pin.SE3(R, self.through + self.direction * s[0] - R @ self.through)

    def over(self, travel: Array, angle: Array) -> Poses:
        """Poses X_WE of the body at k instants, for travel (k,) (m) and angle (k,) (rad)."""
        R = rotations(self.axis[:, None] * angle)
        c = np.repeat(self.through[:, None], len(travel), axis=1)
        return Poses(R, c + self.direction[:, None] * travel - rotated(R, c))

    def twist(self, s: Array, rates: Array, point: Array) -> Array:
        """Twist (6,) of the body at a point of the world, world axes; it is linear in the rates.

        Args:
            s: (2,) coordinates (m, rad).
            rates: (2,) their rates (m/s, rad/s).
            point: (3,) point of the world (m).
        """
        arm = point - self.through - self.direction * s[0]
        spin = self.axis * rates[1]
        return np.concatenate((self.direction * rates[0] + cross(spin, arm), spin))

    def acceleration(self, s: Array, rates: Array, second: Array, point: Array) -> Array:
        """Classical acceleration (6,) of the body's point that is at a point of the world now.

        Args:
            s: (2,) coordinates (m, rad).
            rates: (2,) ṡ (m/s, rad/s).
            second: (2,) s̈ (m/s², rad/s²).
            point: (3,) point of the world (m).
        """
        acceleration = self.twist(s, second, point)
        spin = self.axis * rates[1]
        arm = point - self.through - self.direction * s[0]
        acceleration[:3] += cross(spin, cross(spin, arm))  # centripetal
        return acceleration


# Touched bodies: driven, or free to follow the contact force on a slide or about a hinge.


class Body(Protocol):
    """Model of a touched body, which gives its environment at each tick."""

    def environment(self, X_WE: SE3, V_E: Array, A_E: Array, O: Array) -> Environment:  # noqa: E741
        """Environment of the body, with Φ_e, b_e and V_e at O.

        Args:
            X_WE: measured pose of the body's frame E.
            V_E: (6,) measured twist at E's origin, world axes (m/s, rad/s).
            A_E: (6,) known part of its classical acceleration, see `interface.Touched`.
            O: (3,) operational point (m).
        """


@dataclass(frozen=True, eq=False)
class Conveyor:
    """Body with a prescribed motion, which does not yield: Φ_e = 0, b_e as commanded."""

    def environment(self, X_WE: SE3, V_E: Array, A_E: Array, O: Array) -> Environment:  # noqa: E741
        """Environment with the measured motion: Φ_e = 0, b_e from A_E.

        Args:
            X_WE: measured pose of the body's frame E.
            V_E: (6,) measured twist at E's origin, world axes (m/s, rad/s).
            A_E: (6,) commanded classical acceleration of E (m/s², rad/s²).
            O: (3,) operational point (m).
        """
        return Environment.moving(X_WE=X_WE, V_E=V_E, A_E=A_E, O=O)


@dataclass(frozen=True, eq=False)
class Yielding:
    """Body on an unknown elastic support, such as a part in a soft jig: Φ_e = 0, b_e = 0.

    With it the force loop stays passive also at slow motion of the contact, and motion of the
    contact by commanded forces is expected.

    Attributes:
        compliance: initial estimate of the compliance along the contact normal (m/N); a value too
            small is better than one too large.

    Raises:
        InvalidInputError: a compliance that is not positive.
    """

    compliance: float = 4e-4

    def __post_init__(self) -> None:
        """Refuse a compliance that is not positive."""
        if not 0.0 < self.compliance < np.inf:
            raise InvalidInputError(f"yielding: compliance = {self.compliance:g} m/N; give > 0")

    def environment(self, X_WE: SE3, V_E: Array, A_E: Array, O: Array) -> Environment:  # noqa: E741
        """Environment with the measured twist, which is assumed to be constant: Φ_e = 0.

        Args:
            X_WE: measured pose of the body's frame E.
            V_E: (6,) measured twist at E's origin, world axes (m/s, rad/s).
            A_E: not used.
            O: (3,) operational point (m).
        """
        return Environment.moving(X_WE=X_WE, V_E=V_E, A_E=np.zeros(6), O=O)


@dataclass(frozen=True, eq=False)
class Guided:
    """Body that follows the contact force along its rail: I s̈ = f + preload − k s − c ṡ.

    s is the travel of E along u from the world's origin, or the angle about a from the start, at
    most half a turn in each direction; f is the contact force along u and the body's weight, or
    the moment of the contact force about a. Φ_e has rank 1.

    Attributes:
        rail: a slide or a hinge.

    Raises:
        InvalidInputError: the rail has both joints or none, or is driven.
    """

    rail: Rail

    def __post_init__(self) -> None:
        """Refuse a rail with both joints or none, or with a prescribed motion."""
        if len(self.rail.joints) != 1 or self.rail.motion is not None:
            raise InvalidInputError("a guided body has a slide or a hinge, and no motion; give one")

    def environment(self, X_WE: SE3, V_E: Array, A_E: Array, O: Array) -> Environment:  # noqa: E741
        """Environment with the motion along the rail, with the unit twist u at O.

        Φ_e = u uᵀ/I, b_e = u (weight + preload − k s − c ṡ)/I, V_e = u ṡ.

        Args:
            X_WE: measured pose of the body's frame E, from which s follows.
            V_E: (6,) measured twist at E's origin, world axes (m/s, rad/s), from which ṡ follows.
            A_E: not used, as the acceleration follows from the force.
            O: (3,) operational point (m).
        """
        rail = self.rail
        if rail.joints == [1]:
            s = float(rail.axis @ pin.log3(X_WE.rotation))
            rate = float(rail.axis @ V_E[3:])
        else:
            s = float(rail.direction @ X_WE.translation)
            rate = float(rail.direction @ V_E[:3])
        force = (
            rail.inertia * rail.descent + rail.preload - rail.stiffness * s - rail.damping * rate
        )
        axis = rail.twist(np.zeros(2), np.ones(2), O)
        return Environment(
            np.outer(axis, axis) / rail.inertia, axis * force / rail.inertia, axis * rate
        )
