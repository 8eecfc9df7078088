"""The closed chain at one (q, v), as values: what `ClosedChain.state` gives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from pinocchio import SE3

from osc_contact.errors import ModelError
from osc_contact.spatial import Array, cross_wrench

# The held object: its inertia, and its equation of motion at the operational point.


@dataclass(frozen=True)
class ObjectTerms:
    """Λ_o a + μ_o + p_o = wrench on the object, at O in world axes (eq. 13 for the bare object)."""

    Lambda: Array  #: (6, 6) spatial inertia
    mu: Array  #: (6,) velocity-product wrench V ×* Λ_o V
    p: Array  #: (6,) gravity wrench


@dataclass(frozen=True)
class RigidObject:
    """A rigid body held by the arms; the origin of its frame is the operational point.

    Attributes:
        inertia: spatial inertia in the object frame (kg, m).

    Raises:
        ModelError: mass or rotational inertia not positive, or not finite.

    Example:
        >>> ball = osc.RigidObject(pin.Inertia.FromSphere(0.3, 0.02))  # 0.3 kg, 20 mm
        >>> print(ball.scaled(2.0).inertia.mass)
        0.6
    """

    inertia: pin.Inertia

    def __post_init__(self) -> None:
        matrix = self.inertia.matrix()
        if not np.isfinite(matrix).all():
            raise ModelError("object inertia holds a NaN or inf; check mass, lever and inertia")
        principal = np.linalg.eigvalsh(self.inertia.inertia)
        if self.inertia.mass <= 0.0 or principal[0] <= 1e-12 * principal[2]:  # 0 up to rounding
            raise ModelError(
                f"object of mass {self.inertia.mass:g} kg, principal inertias {principal} kg m²: "
                "all must be positive; give a real body, however light"
            )
        if principal[2] > (principal[0] + principal[1]) * (1 + 1e-9):
            raise ModelError(
                f"object with principal inertias {principal} kg m² cannot exist: the largest must "
                "not exceed the sum of the other two"
            )

    def terms(self, X_WO: SE3, V_O: Array, gravity: Array) -> ObjectTerms:
        """Inertia, velocity and gravity wrenches at O; gravity (3,) in m/s².

        Args:
            X_WO: pose of the object. V_O: (6,) its twist at O. gravity: (3,) m/s².
        """
        at_O = SE3(X_WO.rotation, np.zeros(3))
        Lambda: Array = at_O.act(self.inertia).matrix()
        mu = cross_wrench(V_O, Lambda @ V_O)
        p = -Lambda[:, :3] @ gravity
        return ObjectTerms(Lambda, mu, p)

    def scaled(self, factor: float) -> RigidObject:
        """The same body with mass and inertia times `factor` (to study model error).

        Raises:
            ModelError: the factor is not a positive number.
        """
        if not (np.isfinite(factor) and factor > 0.0):
            raise ModelError(
                f"object mass factor {factor}: give a positive number, 1 = as modelled"
            )
        return RigidObject(scaled_inertia(self.inertia, factor))


def scaled_inertia(inertia: pin.Inertia, factor: float) -> pin.Inertia:
    """Mass and rotational inertia times `factor`, the centre of mass in its place."""
    return pin.Inertia(inertia.mass * factor, inertia.lever, inertia.inertia * factor)


@dataclass(frozen=True)
class ArmTerms:
    """Operational-space terms of one arm at the operational point, world axes (eq. 13).

    For arms with fewer than six joints (or in a singular posture) Λ, J̄, μ and p are defined only
    on range(J): the arm is a *structural constraint* with wrenches C in the other directions.
    Which generalised inverse extends them is irrelevant: they are only used as Λ(a − γ) with
    a − γ in range(J), and through Sᵀ with S in range(J).

    A grasp that permits motions, with wrenches N, puts NᵀJ in place of J: Λ = NΨNᵀ with
    Ψ = (NᵀΦN)⁺, J̄ = M⁻¹JᵀΛ, and C, γ such that Cᵀ(a − γ) = 0 still holds for the *object*.
    """

    J: Array  #: (6, n) Jacobian
    gamma: Array  #: (6,) spatial drift: acceleration of the object at q̈ = 0, on the range of N
    M: Array  #: (n, n) joint-space inertia
    Phi: Array  #: (6, 6) inverse inertia J M⁻¹ Jᵀ, rank ≤ n
    Lambda: Array  #: (6, 6) inertia Φ⁺ on range(J)
    J_bar: Array  #: (n, 6) dynamically consistent inverse M⁻¹JᵀΛ
    mu: Array  #: (6,) velocity-product wrench J̄ᵀ C v − Λ γ
    p: Array  #: (6,) gravity wrench J̄ᵀ g
    C: Array  #: (6, m−rank) wrenches the arm's structure resists: CᵀJ = 0, C in range(N)
    N: Array  #: (6, 6) identity for a rigid grasp, else (6, rank) the wrenches it can exert
    rank: int  #: motions of the object, on the range of N, that the joints can make


@dataclass(frozen=True)
class SingularDirection:
    """One direction an arm is losing: q̈ = mode moves the object by χ L⁻ᵀu.

    The arm is measured against Λ_ref = LLᵀ, the object and, at its centre of mass, a ball as heavy
    as the heaviest arm (radius of gyration 0.1 m). With M = KKᵀ,

        LᵀJK⁻ᵀ = U diag(χ) Vᵀ

    is free of units, and 1/χ² is the arm's apparent inertia in the direction u beside that of
    Λ_ref. At the start of every packaged scenario χ is at least 0.5; it goes to zero in a singular
    posture, and commands are reduced where it is below 0.3.

    Attributes:
        arm: its number. chi: χ. share: of the command that is left, 1 … 0.
        wrench: (6,) L u at O, world axes: wrenchᵀ(a − γ) is the acceleration along it.
        twist: (6,) L⁻ᵀu: the motion that is lost, its scale that of 1 J of Λ_ref.
        mode: (n,) K⁻ᵀv of the arm's joints, of unit kinetic energy (times two).
        locked: the chain counts the direction as lost (`ClosedChain.rank_tolerance`).
    """

    arm: int
    chi: float
    share: float
    wrench: Array
    twist: Array
    mode: Array
    locked: bool


@dataclass(frozen=True)
class ChainState:
    """The closed chain at one (q, v), at the operational point O in world axes.

    d motions of the object, n joints (passive ones included), n_a motors. Λ, μ, p and Φ are in
    world axes. Λ_S, μ_S, p_S, G and W have coordinates η of the motions S, an arbitrary basis.

        Sᵀ(Λ a + μ + p + f_c) = Λ_S η̇ + μ_S + p_S + Sᵀf_c = G τ,    a = S η̇ + σ

    Example:
        >>> state = osc.build_rig(osc.load_scenario("two_contact_rod")).state
        >>> print(state.d, state.Lambda.shape, state.G.shape)
        5 (6, 6) (5, 8)
    """

    X_WO: SE3  #: pose of the object
    V_O: Array  #: (6,) its twist
    S: Array  #: (6, d) basis of the motions every arm permits
    C: Array  #: (6, 6−d) the wrenches they resist, CᵀS = 0
    Lambda_S: Array  #: (d, d) inertia along S: Sᵀ Λ S
    Phi: Array  #: (6, 6) Φ₀ = S Λ_S⁻¹ Sᵀ, eq. 13's Λ₀⁻¹
    mu_S: Array  #: (d,) velocity-product terms along S: Sᵀ(μ + Λ σ)
    p_S: Array  #: (d,) gravity terms along S: Sᵀ p
    sigma: Array  #: (6,) structural velocity product: a = S η̇ + σ
    G: Array  #: (d, n_a) what the motors do to the object
    W: Array  #: (n, d) joint accelerations q̈ = W η̇ + w
    w: Array  #: (n,)
    h: Array  #: (n,) joint nonlinear effects C v + g
    M: Array  #: (n, n) joint-space inertia of all arms
    arms: tuple[ArmTerms, ...]  #: per arm: J, Φ, Λ, J̄, μ, p, …
    payload: ObjectTerms  #: Λ_o, μ_o, p_o
    metric: Array  #: (6, 6) Λ_o, or the reference inertia when nothing is held
    grasp_points: Array  #: (arms, 3) world
    sensors: tuple[SE3 | None, ...]  #: placement of each wrist sensor in the world
    filters: tuple[Array | None, ...]  #: (6, 6) F_i at O for each wrist reading; None: as it is
    Lambda_out: Array  #: (6, 6) inertia seen by the wrist sensors together (not symmetric)
    bias_out: Array  #: (6,) gravity and velocity wrench they see at a = 0
    unactuated: Array  #: (6, u) motions of the object that no motor drives
    reference: Array  #: (6, 6) object and heaviest arm, which singular postures are judged by
    full_ranks: tuple[int, ...]  #: motions each arm makes, on the range of N, in ordinary postures
    #: directions that arms near a singular posture are losing
    singular_directions: tuple[SingularDirection, ...]

    @property
    def d(self) -> int:
        """Number of motions the object can make."""
        return int(self.S.shape[1])

    @property
    def b_S(self) -> Array:
        """(d,) b_S = μ_S + p_S."""
        return self.mu_S + self.p_S

    @property
    def Lambda(self) -> Array:
        """(6, 6) Λ = ΣΛ_i + Λ_o of all arms and the object, the paper's Λ₀, world axes.

        Λ a + μ + p is the wrench that moves arms and object with a permitted a = S η̇ + σ. With
        d = 6 it is unique, and Λ = Φ⁻¹. With d < 6 the structure of the arms carries the wrenches C
        without motors, and the wrench is known up to these only: the sum over all
        `ArmTerms` is one of them. Then Φ is not the inverse of Λ, and Λ of a motion that is not
        permitted means nothing.
        """
        return self._sum("Lambda")

    @property
    def mu(self) -> Array:
        """(6,) velocity-product wrench μ = Σμ_i + μ_o, world axes; it goes with `Lambda`."""
        return self._sum("mu")

    @property
    def p(self) -> Array:
        """(6,) gravity wrench p = Σp_i + p_o, world axes; it holds arms and object at rest.

        With d < 6 it is known up to the wrenches C, see `Lambda`.
        """
        return self._sum("p")

    def _sum(self, name: str) -> Array:
        """Of the object and all arms."""
        return sum(getattr(part, name) for part in (self.payload, *self.arms))


# What the joints of a rig feel and how the rig swings on sprung joints with its motors held.


def joint_inertias(state: ChainState, actuated: Array) -> Array:
    """(n_a,) inertia each motor moves: of its arm, with an equal share of the object.

    diag(M + JᵀΛ_oJ / arms), kg m² (kg for sliding joints).
    """
    Lambda = state.payload.Lambda / len(state.arms)
    felt = [np.diag(arm.M + arm.J.T @ Lambda @ arm.J) for arm in state.arms]
    return np.concatenate(felt)[actuated]


def modes(state: ChainState, actuated: Array, stiffness: Array) -> Array:
    """(d,) natural frequencies (Hz), ascending, of the closed chain out of contact, motors held.

    det(WᵀK W − ω² Λ_S) = 0: the motions S are the only ones the closed loops leave.

    Args:
        state: where. actuated: (n_a,) motor joints. stiffness: (n_a,) of their springs.
    """
    W = state.W[actuated]
    L = np.linalg.cholesky(state.Lambda_S)
    whitened = np.linalg.solve(L, np.linalg.solve(L, W.T @ (stiffness[:, None] * W)).T)
    return np.sqrt(np.maximum(np.linalg.eigvalsh(whitened), 0.0)) / (2 * np.pi)


def stiffness_for(state: ChainState, actuated: Array, frequency: float) -> Array:
    """(n_a,) springs proportional to `joint_inertias` that put the first mode at a frequency (Hz).

    Args:
        state: of the chain. actuated: (n,) True for motor joints. frequency: Hz.

    Raises:
        ModelError: no spring can, because some motion moves no motor.
    """
    unit = joint_inertias(state, actuated)
    first = float(modes(state, actuated, unit)[0])
    if not first > 0.0:
        raise ModelError(
            "the object can move while every motor stands still: no stiffness gives the rig a "
            "first mode. Give plant.flexible_joints.stiffness for each motor instead."
        )
    return unit * (frequency / first) ** 2
