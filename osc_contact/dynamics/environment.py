"""What the object presses on: a_e = Φ_e f_c + b_e (eq. 14), for bodies of every kind.

Everything here holds for one instant, at the operational point O in world axes: build it again
each tick. Bodies bring their own pose, their twist and their *classical* acceleration at their own
origin (readings of a tracker or an encoder), and leave as spatial vectors at O.
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
    """½ (A + Aᵀ), without the rounding errors that make a symmetric matrix none."""
    return 0.5 * (matrix + matrix.T)


def inverse(matrix: Array, what: str) -> Array:
    """Inverse of a positive definite matrix, judged and inverted with unit diagonal.

    Raises:
        ModelError: it is none (singular up to rounding, asymmetric, not finite).
    """
    cure = "every body a mass and inertia, and independent axes"
    scaled, size = unit_diagonal(matrix, what, cure, ModelError)
    return np.linalg.inv(symmetric(scaled)) / np.outer(size, size)


def require_inverse_inertia(name: str, scaled: Array) -> None:
    """Refuse what no passive mechanism can have; `scaled` is free of units, its largest near 1."""
    if np.abs(scaled - scaled.T).max(initial=0.0) > 1e-9:
        raise InvalidInputError(f"{name} is not symmetric; an inverse inertia is")
    smallest = np.linalg.eigvalsh(scaled).min(initial=0.0)
    if smallest < -1e-9:
        raise InvalidInputError(
            f"{name} is not positive semidefinite (scaled eigenvalue {smallest:.3g}); "
            "no passive body accelerates against the force on it"
        )


def element_sizes(Phi: Array) -> Array:
    """(6, 6) what the elements of Φ_e are measured against: its most mobile axis of each kind.

    One scale for the linear and one for the angular axes, so that rounding errors in a locked
    direction (of an inverse inertia carried from another point, say) are not blown up. An axis
    through O leaves linear noise only: mobilities below 1 mm/rad count as noise too.
    """
    largest = np.sqrt(np.diag(Phi).reshape(2, 3).max(axis=1, initial=0.0))
    largest = np.maximum(largest, 1e-3 * largest[::-1])
    largest[largest == 0.0] = 1.0
    scale = np.repeat(largest, 3)
    return np.outer(scale, scale)


_ZERO = np.zeros(3)


class _HasNormals(Protocol):
    """A state of contact, of which only the normals are needed here."""

    N: Array


@dataclass(frozen=True)
class Environment:
    """The environment at one instant, at the operational point in world axes (eq. 14).

    Attributes:
        Phi_e: (6, 6) inverse inertia, positive semidefinite: acceleration per contact force.
        b_e: (6,) spatial acceleration it would have without contact.
        V_e: (6,) its twist.

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
        for name, shape in {"Phi_e": (6, 6), "b_e": (6,), "V_e": (6,)}.items():
            object.__setattr__(self, name, as_array(name, getattr(self, name), shape))
        require_inverse_inertia("Phi_e", self.Phi_e / element_sizes(self.Phi_e))

    @classmethod
    def fixed(cls) -> Environment:
        """Does not move and does not yield: Φ_e = 0, b_e = 0."""
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
        """A body whose motion is prescribed and does not yield to contact: Φ_e = 0.

        Args:
            X_WE: pose of the body in the world.
            V_E: (6,) [ṗ; ω] at its own origin, world axes (m/s, rad/s).
            A_E: (6,) [p̈; ω̇], *classical* acceleration of its origin, world axes.
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
        """A rigid body that moves only along given twists: Φ_e = A(AᵀIA)⁻¹Aᵀ, of rank k.

        AᵀIA s̈ = Q + Aᵀ(weight − V ×* IV) at its origin. No drift: a space of motions fixed in the
        world has none, and one fixed in the body V × V.

        A cart on a rail along `x`: `axes=[*x, 0, 0, 0]`, `rates=[speed]`,
        `force=[−k·s − c·speed]`. A door: axes=[ω × (p − hinge), ω] with ω a unit vector along the
        hinge. A free body: axes=np.eye(6), and the wrench on it as force. The space that the axes
        span must stay fixed in the world or in the body (slides, a hinge, a ball joint, motion in a
        plane); for a chain with moving joints in between use `articulated`.

        Args:
            inertia: in the body's own frame (kg, m); for sliding axes only the mass counts.
            X_WE: pose of the body in the world.
            axes: (6,) or (6, k) independent twists per unit rate, at the body's own origin in
                world axes.
            rates: (k,) how fast it moves along each (m/s or rad/s).
            O: (3,) operational point in the world (m).
            gravity: (3,) m/s²; default none. Its part along the axes is worked out here.
            force: (k,) what else acts along each axis (springs, dampers, drives; N or N m).

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
        """A link of any mechanism: Φ_e = J M⁻¹Jᵀ, b_e = J M⁻¹(τ − h) + drift.

        Args:
            model: with its base placed in the world; its own gravity acts.
            q, v: (nq,), (nv,) its configuration and velocity.
            tau: (nv,) generalised forces besides gravity (motors, springs, dampers; N or N m).
            frame: name of a frame or joint that moves with the touched link.
            O: (3,) operational point in the world (m).
            data: to work in; default: new data each time.

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
        data = data or model.createData()
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
        """One environment that stands for different bodies at r contacts.

        The equations of contact see only NᵀΦ_eN, Nᵀb_e and NᵀV_e, so any K with NᵀK = 1 gives an
        environment with the same contact forces and the same object motion:

            Φ_e = K Φ_N Kᵀ,   b_e = K b_N,   V_e = K V_N,   K = Λ⁻¹N(NᵀΛ⁻¹N)⁻¹

        The bodies' motions tangential to their contacts are not in it: of `a_e` only Nᵀa_e (each
        touched body along its own normal) has a meaning. Each contact's n_γ is made with the twist
        of its body, never with the combined V_e.

        Args:
            N: (6, r) contact normals at O, columns of several bodies side by side.
            Phi_N: (r, r) normal acceleration of the bodies per unit contact magnitude.
            b_N: (r,) their normal (spatial) accelerations without contact, each nᵀb of its body.
            V_N: (r,) their normal velocities, each nᵀV of its body.
            metric: (6, 6) the held object's inertia Λ at O, so that nothing depends on units or
                frame.

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
        own = np.sqrt((N * (mobility @ N)).sum(axis=0))  # the held object yields along each normal
        scaled = Phi_N / np.outer(own, own)
        require_inverse_inertia("Phi_N", scaled / (np.abs(scaled).max(initial=0.0) or 1.0))
        return cls(symmetric(K @ Phi_N @ K.T), K @ b_N, K @ V_N)

    @classmethod
    def combine(
        cls,
        contacts: Sequence[_HasNormals],
        environments: Sequence[Environment],
        metric: npt.ArrayLike,
    ) -> Environment:
        """The environment of several contacts, given the environment of each.

        Contacts given the *same* `Environment` object are on one body, which couples them;
        different objects are bodies that do not act on one another. (Two links of one mechanism
        do: build Φ_N = NᵀJM⁻¹JᵀN across them and use `of_contacts`.) One body touched by all
        contacts is returned as it is, and so is one motion that all of them share and none yields
        to. Dependent contacts must be on one such body; next to other bodies, stack them first and
        give them as one contact.

        Args:
            contacts: in the order in which they are stacked.
            environments: one for each contact, all at the same O.
            metric: (6, 6) the held object's inertia at O (`ChainState.metric`).

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
        pairs = [(contact.N, e) for contact, e in zip(contacts, environments, strict=True)]
        # blocks nᵀΦ_e n where both contacts are on one body
        blocks = [[(e is g) * (n.T @ e.Phi_e @ f) for f, g in pairs] for n, e in pairs]
        return cls.of_contacts(
            np.hstack([n for n, _ in pairs]),
            np.block(blocks),
            np.concatenate([n.T @ e.b_e for n, e in pairs]),
            np.concatenate([n.T @ e.V_e for n, e in pairs]),
            metric,
        )


def _move_as_one(a: Environment, b: Environment) -> bool:
    rigid = not (a.Phi_e.any() or b.Phi_e.any())
    return a is b or (rigid and np.array_equal([a.b_e, a.V_e], [b.b_e, b.V_e]))


# How bodies can move: at rest, driven, or free on a slide or about a hinge.


Motion = Callable[[float], tuple[Array, Array, Array]]


@geometry
class Rail:
    """A slide along u, and on it a hinge about a; without either the body rests.

    s = (travel (m), angle (rad)) from the assembled pose. A point that was at x is at
    c + u s₁ + R(a, s₂)(x − c); the hinge's axis keeps its direction.

    Attributes:
        direction: (3,) u, world, normalised on entry; zero: no slide.
        axis: (3,) a, world, likewise; zero: no hinge. through: (3,) c, where the hinge is at s = 0.
        motion: t → (s, ṡ, s̈), each (2,), of a driven body; plants evaluate it once an instant.
            None: it is free along its one joint,
            I s̈ = (force or moment along it) + preload − k s − c ṡ.
        inertia: I of a free body, kg on a slide, kg m² about a hinge.
        stiffness, damping, preload: of a free body, per m and N or per rad and N m.

    Raises:
        InvalidInputError: numbers that no body has.

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
        for name in ("direction", "axis", "through"):
            value = as_array(f"rail.{name}", getattr(self, name), (3,))
            if name != "through" and value.any():
                value = unit_vector(name, value)
            object.__setattr__(self, name, value)
        for name in ("inertia", "stiffness", "damping", "preload"):
            value = getattr(self, name)
            sound = value > 0.0 if name == "inertia" else name == "preload" or value >= 0.0
            if not (np.isfinite(value) and sound):
                raise InvalidInputError(f"rail.{name} = {value}; give a number a body can have")

    @property
    def descent(self) -> float:
        """u·g (m/s²)."""
        return -9.81 * float(self.direction[2])

    @property
    def joints(self) -> list[int]:
        """Which of travel (0) and angle (1) there are."""
        return [k for k, u in enumerate((self.direction, self.axis)) if u.any()]

    def pose(self, s: Array) -> pin.SE3:
        """X_WE: identity at s = 0."""
        R = pin.exp3(self.axis * s[1])
        return pin.SE3(R, self.through + self.direction * s[0] - R @ self.through)

    def over(self, travel: Array, angle: Array) -> Poses:
        """`pose` at k times; travel and angle (k,)."""
        R = rotations(self.axis[:, None] * angle)
        c = np.repeat(self.through[:, None], len(travel), axis=1)
        return Poses(R, c + self.direction[:, None] * travel - rotated(R, c))

    def twist(self, s: Array, rates: Array, point: Array) -> Array:
        """(6,) of the body at a point (3,) of the world, world axes; linear in the rates (2,).

        Args:
            s, rates: (2,) coordinates and rates. point: (3,) m.
        """
        arm = point - self.through - self.direction * s[0]
        spin = self.axis * rates[1]
        return np.concatenate((self.direction * rates[0] + cross(spin, arm), spin))

    def acceleration(self, s: Array, rates: Array, second: Array, point: Array) -> Array:
        """(6,) classical, of the body's point that is at `point` now; second: (2,) s̈.

        Args:
            s, rates, second: (2,) coordinates and derivatives. point: (3,) m.
        """
        out = self.twist(s, second, point)
        spin = self.axis * rates[1]
        arm = point - self.through - self.direction * s[0]
        out[:3] += cross(spin, cross(spin, arm))
        return out


# Touched bodies: driven, or free to follow the contact force on a slide or about a hinge.


class Body(Protocol):
    """A body that answers contact forces; it returns how, each tick, at the operational point."""

    def environment(self, X_WE: SE3, V_E: Array, A_E: Array, O: Array) -> Environment:  # noqa: E741
        """Φ_e, b_e and V_e at O (3,), from the body's measured pose, twist and known acceleration
        (`interface.Touched`).

        Args:
            X_WE: pose of the body. V_E: (6,) its twist at E. A_E: (6,) its known acceleration.
            O: (3,) operational point (m).
        """


@dataclass(frozen=True, eq=False)
class Conveyor:
    """A body whose motion is prescribed and does not yield: Φ_e = 0, b_e as commanded."""

    def environment(self, X_WE: SE3, V_E: Array, A_E: Array, O: Array) -> Environment:  # noqa: E741
        """See `Body.environment`.

        Args:
            X_WE, V_E, A_E, O: as of `Body.environment`.
        """
        return Environment.moving(X_WE=X_WE, V_E=V_E, A_E=A_E, O=O)


@dataclass(frozen=True, eq=False)
class Yielding:
    """A body on an unknown elastic support, such as a part in a soft jig: Φ_e = 0, b_e = 0.

    The force loop then stays passive also where the contact moves slowly, and forces that are
    commanded are expected to move it.

    Attributes:
        compliance: along the contact normal (m/N), where its estimate begins; rather too small.

    Raises:
        InvalidInputError: a compliance that is not positive.
    """

    compliance: float = 4e-4

    def __post_init__(self) -> None:
        if not 0.0 < self.compliance < np.inf:
            raise InvalidInputError(f"yielding: compliance = {self.compliance:g} m/N; give > 0")

    def environment(self, X_WE: SE3, V_E: Array, A_E: Array, O: Array) -> Environment:  # noqa: E741
        """See `Body.environment`; `A_E` is not used.

        Args:
            X_WE, V_E, A_E, O: as of `Body.environment`.
        """
        return Environment.moving(X_WE=X_WE, V_E=V_E, A_E=np.zeros(6), O=O)


@dataclass(frozen=True, eq=False)
class Guided:
    """A body that follows the contact force along its rail: I s̈ = f + preload − k s − c ṡ.

    s is how far E has travelled along u from the world's origin, or turned about a since the start,
    at most half a turn either way; f the contact force along u, with the body's weight, or its
    moment about a. Φ_e has rank 1.

    Attributes:
        rail: a slide or a hinge.

    Raises:
        InvalidInputError: the rail is both or neither, or driven.
    """

    rail: Rail

    def __post_init__(self) -> None:
        if len(self.rail.joints) != 1 or self.rail.motion is not None:
            raise InvalidInputError("a guided body has a slide or a hinge, and no motion; give one")

    def environment(self, X_WE: SE3, V_E: Array, A_E: Array, O: Array) -> Environment:  # noqa: E741
        """See `Body.environment`; `A_E` is not used: the acceleration follows from f.

        Args:
            X_WE, V_E, A_E, O: as of `Body.environment`.
        """
        rail = self.rail
        along = np.concatenate((rail.direction, rail.axis))  # one of the two is zero
        s = along @ np.concatenate((X_WE.translation, pin.log3(X_WE.rotation)))
        rate = along @ V_E
        force = (
            rail.inertia * rail.descent + rail.preload - rail.stiffness * s - rail.damping * rate
        )
        axis = rail.twist(np.zeros(2), np.ones(2), O)
        return Environment(
            np.outer(axis, axis) / rail.inertia, axis * force / rail.inertia, axis * rate
        )
