"""State of a closed chain at one (q, v), the result of `ClosedChain.state`."""

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
    """Terms of Λ_o a + μ_o + p_o = wrench on the object, at O in world axes (eq. 13)."""

    Lambda: Array  #: (6, 6) spatial inertia
    mu: Array  #: (6,) velocity-product wrench V ×* Λ_o V
    p: Array  #: (6,) gravity wrench


@dataclass(frozen=True)
class RigidObject:
    """Rigid body held by the arms; the origin of its frame is the operational point.

    Attributes:
        inertia: spatial inertia in the object frame (kg, m, kg m²).

    Raises:
        ModelError: mass or a principal inertia not positive or not finite, or the largest principal
            inertia exceeds the sum of the others.

    Example:
        >>> ball = osc.RigidObject(pin.Inertia.FromSphere(0.3, 0.02))  # 0.3 kg, 20 mm
        >>> print(ball.scaled(2.0).inertia.mass)
        0.6
    """

    inertia: pin.Inertia

    def __post_init__(self) -> None:
        """Refuse an inertia that no rigid body has.

        Raises:
            ModelError: a NaN or inf, mass or a principal inertia not positive, or triangle
                inequality violated.
        """
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
        """Inertia, velocity-product wrench and gravity wrench of the object at O.

        Args:
            X_WO: pose of the object.
            V_O: (6,) twist of the object at O (m/s, rad/s).
            gravity: (3,) gravitational acceleration (m/s²).
        """
        at_O = SE3(X_WO.rotation, np.zeros(3))
        Lambda: Array = at_O.act(self.inertia).matrix()
        mu = cross_wrench(V_O, Lambda @ V_O)
        p = -Lambda[:, :3] @ gravity
        return ObjectTerms(Lambda, mu, p)

    def scaled(self, factor: float) -> RigidObject:
        """Body with mass and inertia times `factor` (to study model error).

        Raises:
            ModelError: the factor is not a positive number.
        """
        if not (np.isfinite(factor) and factor > 0.0):
            raise ModelError(
                f"object mass factor {factor}: give a positive number, 1 = as modelled"
            )
        return RigidObject(scaled_inertia(self.inertia, factor))


def scaled_inertia(inertia: pin.Inertia, factor: float) -> pin.Inertia:
    """Inertia with mass and moments times `factor`, and the same centre of mass."""
    return pin.Inertia(inertia.mass * factor, inertia.lever, inertia.inertia * factor)


@dataclass(frozen=True)
class ArmTerms:
    """Operational-space terms of one arm at the operational point, world axes (eq. 13).

    For arms with fewer than six joints (or in a singular posture) Λ, J̄, μ and p are defined only
    on range(J): the arm is a *structural constraint* with wrenches C in the other directions.
    Any generalised inverse may extend them, as they are used only in Λ(a − γ) with a − γ in
    range(J), and in products with Sᵀ, S in range(J).

    For a grasp that permits motions, with wrenches N, NᵀJ replaces J: Λ = NΨNᵀ with Ψ = (NᵀΦN)⁺,
    J̄ = M⁻¹JᵀΛ, and C, γ such that Cᵀ(a − γ) = 0 holds for the *object*.
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
    """Direction in which an arm near a singular posture hardly moves the object.

    The arm is compared with Λ_ref = LLᵀ, the inertia of the object and, at its centre of mass, of a
    ball as heavy as the heaviest arm (radius of gyration 0.1 m). With M = KKᵀ,

        LᵀJK⁻ᵀ = U diag(χ) Vᵀ

    is dimensionless, and 1/χ² is the arm's apparent inertia in the direction u over that of Λ_ref.
    q̈ = mode moves the object by χ L⁻ᵀu. At the start of every packaged scenario χ is at least 0.5;
    in a singular posture it is zero, and commands are reduced if it is below 0.3.

    Attributes:
        arm: index of the arm.
        chi: χ.
        share: remaining share of the command, 1 … 0.
        wrench: (6,) L u at O, world axes: wrenchᵀ(a − γ) is the acceleration along it.
        twist: (6,) L⁻ᵀu, the lost motion, scaled so that Λ_ref has a kinetic energy of ½ J.
        mode: (n,) K⁻ᵀv of the arm's joints, with a kinetic energy of ½ J.
        locked: True if the chain counts the direction as lost (`ClosedChain.rank_tolerance`).
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
    """State of the closed chain at one (q, v), at the operational point O in world axes.

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
    G: Array  #: (d, n_a) generalised force on the object from motor torques, f_S = G τ
    W: Array  #: (n, d) matrix of joint accelerations q̈ = W η̇ + w
    w: Array  #: (n,) joint accelerations at η̇ = 0
    h: Array  #: (n,) joint nonlinear effects C v + g
    M: Array  #: (n, n) joint-space inertia of all arms
    arms: tuple[ArmTerms, ...]  #: for each arm J, Φ, Λ, J̄, μ, p, …
    payload: ObjectTerms  #: Λ_o, μ_o, p_o
    metric: Array  #: (6, 6) Λ_o, or the reference inertia when nothing is held
    grasp_points: Array  #: (arms, 3) world
    sensors: tuple[SE3 | None, ...]  #: placement of each wrist sensor in the world
    filters: tuple[Array | None, ...]  #: (6, 6) factor F_i at O of each wrist reading; None: 1
    Lambda_out: Array  #: (6, 6) inertia beyond all wrist sensors together (not symmetric)
    bias_out: Array  #: (6,) gravity and velocity-product wrench beyond the sensors at a = 0
    unactuated: Array  #: (6, u) motions of the object that no motor drives
    reference: Array  #: (6, 6) Λ_ref, with which arms near singular postures are compared
    full_ranks: tuple[int, ...]  #: motions each arm makes, on the range of N, in regular postures
    #: directions in which arms near a singular posture hardly move the object
    singular_directions: tuple[SingularDirection, ...]

    @property
    def d(self) -> int:
        """Number of motions the object can make."""
        return int(self.S.shape[1])

    @property
    def b_S(self) -> Array:
        """Bias b_S = μ_S + p_S (d,)."""
        return self.mu_S + self.p_S

    @property
    def Lambda(self) -> Array:
        """Inertia Λ = ΣΛ_i + Λ_o (6, 6) of all arms and the object, the paper's Λ₀, world axes.

        Λ a + μ + p is the wrench that moves arms and object with a permitted a = S η̇ + σ. If d = 6,
        it is unique, and Λ = Φ⁻¹. If d < 6, the structure of the arms carries the wrenches C
        without motors, and the wrench is unique only up to these: the sum over all `ArmTerms` is
        one choice. Then Φ is not the inverse of Λ, and Λ is meaningful for permitted motions only.
        """
        return self._sum_of_terms("Lambda")

    @property
    def mu(self) -> Array:
        """Velocity-product wrench μ = Σμ_i + μ_o (6,), world axes; it belongs to `Lambda`."""
        return self._sum_of_terms("mu")

    @property
    def p(self) -> Array:
        """Gravity wrench p = Σp_i + p_o (6,), world axes, which holds arms and object at rest.

        If d < 6, it is unique only up to the wrenches C, see `Lambda`.
        """
        return self._sum_of_terms("p")

    def _sum_of_terms(self, name: str) -> Array:
        """Sum of a term, given by its name, over the object and all arms."""
        return sum(getattr(part, name) for part in (self.payload, *self.arms))


# Inertias at the joints of a rig, and its natural frequencies on elastic joints with held motors.


def joint_inertias(state: ChainState, actuated: Array) -> Array:
    """Inertia (n_a,) that each motor moves: diag(M + JᵀΛ_oJ / arms) (kg m²; kg if it slides).

    It is the inertia of the motor's arm with an equal share of the object.

    Args:
        state: state of the chain.
        actuated: (n_a,) indices of the motor joints.
    """
    Lambda = state.payload.Lambda / len(state.arms)
    inertias = [np.diag(arm.M + arm.J.T @ Lambda @ arm.J) for arm in state.arms]
    return np.concatenate(inertias)[actuated]


def modes(state: ChainState, actuated: Array, stiffness: Array) -> Array:
    """Compute natural frequencies (d,) of the chain without contact, motors fixed, ascending (Hz).

    They are the roots of det(WᵀK W − ω² Λ_S) = 0, in the motions S that the closed loops permit.

    Args:
        state: state of the chain.
        actuated: (n_a,) indices of the motor joints.
        stiffness: (n_a,) stiffness of the joints, the diagonal of K (N m/rad, N/m).
    """
    W = state.W[actuated]
    L = np.linalg.cholesky(state.Lambda_S)
    whitened = np.linalg.solve(L, np.linalg.solve(L, W.T @ (stiffness[:, None] * W)).T)
    return np.sqrt(np.maximum(np.linalg.eigvalsh(whitened), 0.0)) / (2 * np.pi)


def stiffness_for(state: ChainState, actuated: Array, frequency: float) -> Array:
    """Compute the joint stiffness (n_a,) that gives the first mode a frequency (N m/rad, N/m).

    It is proportional to `joint_inertias`.

    Args:
        state: state of the chain.
        actuated: (n_a,) indices of the motor joints.
        frequency: frequency of the first mode (Hz).

    Raises:
        ModelError: some motion of the object moves no motor, so that its frequency is zero.
    """
    unit = joint_inertias(state, actuated)
    first = float(modes(state, actuated, unit)[0])
    if not first > 0.0:
        raise ModelError(
            "the object can move while every motor stands still: no stiffness gives the rig a "
            "first mode. Give plant.flexible_joints.stiffness for each motor instead."
        )
    return unit * (frequency / first) ** 2
