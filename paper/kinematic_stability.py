"""Kinematic stability: where the selection matrix of classic hybrid control makes an arm diverge.

The classic scheme turns the filtered position error back into joint errors, τ = K_q J⁻¹S J q_e,
with S picking the position-controlled axes of a frame. Its loop closes over M⁻¹K_q J⁻¹S J, a
definite matrix times an *oblique* projection, whose eigenvalues can have negative real parts (An
and Hollerbach, "Kinematic stability issues in force control of manipulators", 1987; Fisher and
Mujtaba, "Hybrid position/force control: a correct formulation", 1992). Filtered by Ω_m(B), eq. 7,
the error is seen through (TᵀB⁻¹T)⁻¹TᵀB⁻¹K T instead; with K = B K′, K′ symmetric positive definite
(scalar gains are K′ = k B⁻¹), its eigenvalues are real and positive in every posture.

As in those references the position part is judged alone: nothing holds the arm in the
force-controlled direction. For ours this is no restriction: the eigenvalues of Ω_m(B)K that are
not zero are those above. With damping of d times stiffness an eigenvalue λ gives the poles of
z² + dλz + λ, whose sum is −dλ: Re λ < 0 is unstable for every such damping.
"""

from functools import cache

import numpy as np
import pinocchio as pin
from matplotlib.figure import Figure

import osc_contact as osc
from osc_contact import robots
from osc_contact.lab.visual.plots import style
from osc_contact.projections import left_inverse
from osc_contact.spatial import Array
from paper.study import Ask, Data, Study, table_of, with_object


def study(ask: Ask) -> Study:
    """Both schemes on a UR5, in many postures."""
    _, data = search(ask.seed)
    table = table_of(
        "kinematic stability of a UR5",
        "postures; classic unstable; classic least λ (1/s²); ours least λ (1/s²)",
        [
            f"{data['postures']}; {data['classic_unstable']}; "
            f"{data['classic_eigenvalues'][0][0]:.4g}; {data['ours_least_eigenvalue']:.4g}"
        ],
    )
    return Study({"kinematic_stability": draw(data)}, table, data)


FORCE = 2  #: axis of the tool's twist, world axes at the tool, whose force is controlled
SELECTION = (np.arange(6) != FORCE).astype(float)  #: of the position-controlled ones
K_Q = np.diag([400.0, 400.0, 200.0, 20.0, 20.0, 20.0])  #: joint stiffness, classic (N m/rad)
K_PRIME = np.diag([300.0, 300.0, 300.0, 3.0, 3.0, 3.0])  #: stiffness of ours (N/m, N m/rad)
HELD = pin.Inertia(1.2, np.array([0.03, 0.0, 0.02]), np.diag([4e-3, 6e-3, 5e-3]))


@cache
def ur5() -> tuple[pin.Model, int]:
    """A UR5 with the object on its last joint, and the frame of its tool."""
    arm = osc.Arm.from_urdf(robots.find_robot("ur5")[0], name="ur5", tip="tool0")
    return with_object(osc.ClosedChain([arm], payload=osc.RigidObject(HELD)))


def terms(q: Array) -> tuple[Array, Array, Array]:
    """M (6, 6) with the object, the tool's Jacobian (6, 6) and the inverse inertia B (6, 6) of the
    object there, world axes."""
    model, tool = ur5()
    data = model.createData()
    M = np.array(pin.crba(model, data, q))
    J = pin.computeFrameJacobian(model, data, q, tool, pin.LOCAL_WORLD_ALIGNED)
    R = pin.updateFramePlacement(model, data, tool).rotation
    return M, J, np.linalg.inv(pin.SE3(R, np.zeros(3)).act(HELD).matrix())


def classic_eigenvalues(M: Array, J: Array, selection: Array, K_q: Array) -> Array:
    """The s eigenvalues of M⁻¹K_q J⁻¹S J that position control owns, s = number selected.

    The n − s others are zero: nothing in this scheme stiffens the force-controlled directions.

    Args:
        M: (n, n) joint-space inertia.
        J: (n, n) Jacobian of the task coordinates.
        selection: (n,) 1 where the coordinate is position-controlled, else 0.
        K_q: (n, n) joint stiffness (N m/rad).

    Returns:
        (s,) complex (1/s²), by ascending real part.
    """
    S = np.diag(selection)
    loop = np.linalg.solve(M, K_q @ np.linalg.solve(J, S @ J))
    values = np.linalg.eigvals(loop).astype(complex)
    owned = np.argsort(np.abs(values))[len(M) - int(np.count_nonzero(S)) :]
    return np.sort_complex(values[owned])


def our_eigenvalues(T: Array, B: Array, K_prime: Array) -> Array:
    """Eigenvalues of the stiffness seen along T, (TᵀB⁻¹T)⁻¹TᵀB⁻¹K T with K = B K′.

    Real and positive is what comes out, not what is put in: the matrix is not symmetric and is
    not treated as if it were similar to one.

    Args:
        T: (6, s) permitted motions.
        B: (6, 6) symmetric positive definite metric of eq. 24.
        K_prime: (6, 6) symmetric positive definite stiffness (N/m, N m/rad); scalar gains k are
            K′ = k B⁻¹.

    Returns:
        (s,) complex (1/s²), by ascending real part.
    """
    along = left_inverse(T, np.linalg.inv(B), "stiffness along T")
    return np.sort_complex(np.linalg.eigvals(along @ (B @ K_prime) @ T)).astype(complex)


def search(seed: int = 0, postures: int = 2000, regular: float = 0.5) -> tuple[Array, Data]:
    """Draw uniformly random postures and examine the most regular of them.

    Args:
        seed: seed of the draw.
        postures: number of postures to draw, each joint from −π to π.
        regular: share of them that is examined, the most regular first (`regularity`): an
            instability next to a singularity would prove little.

    Returns:
        (6,) the one in which the classic scheme is least stable. For JSON: how many were drawn and
        examined, in how many an eigenvalue had a negative real part, the least real part of ours
        (1/s²) and of both in each posture, and the eigenvalues of both in that one as
        [real, imaginary].
    """
    drawn = np.random.default_rng(seed).uniform(-np.pi, np.pi, (postures, 6))
    order = np.argsort([-regularity(q) for q in drawn])
    examined = drawn[order[: round(regular * postures)]]
    values = [eigenvalues(q) for q in examined]
    classic, ours = np.array([[one[0].real for one in both] for both in values]).T
    worst = int(classic.argmin())
    spectra = zip(("classic_eigenvalues", "ours_eigenvalues"), values[worst], strict=True)
    found = {
        "seed": seed,
        "postures_drawn": postures,
        "postures": len(examined),
        "classic_unstable": int((classic < 0.0).sum()),
        "ours_unstable": int((ours < 0.0).sum()),
        "ours_least_eigenvalue": float(ours.min()),
        "least_eigenvalues": {"classic": classic.tolist(), "ours": ours.tolist()},
        "posture_rad": examined[worst].tolist(),
        **{name: np.column_stack((z.real, z.imag)).tolist() for name, z in spectra},
    }
    return examined[worst], found


def eigenvalues(q: Array) -> tuple[Array, Array]:
    """`classic_eigenvalues` and `our_eigenvalues` in a posture (6,)."""
    M, J, B = terms(q)
    permitted = np.delete(np.eye(6), FORCE, axis=1)
    return classic_eigenvalues(M, J, SELECTION, K_Q), our_eigenvalues(permitted, B, K_PRIME)


def regularity(q: Array) -> float:
    """Least share of the object in the inertia met at the tool, over all directions (0: singular).

    The least eigenvalue of LᵀJM⁻¹JᵀL with LLᵀ the object's inertia: no units, no frame.
    """
    M, J, B = terms(q)
    L = np.linalg.cholesky(np.linalg.inv(B))
    return float(np.linalg.eigvalsh(L.T @ J @ np.linalg.solve(M, J.T) @ L)[0])


def draw(found: Data) -> Figure:
    """The least real part of both schemes in each posture examined, the smallest first.

    Args:
        found: result of `search`.
    """
    with style():
        figure = Figure(figsize=(8.0, 3.6))
        ax = figure.subplots()
        for scheme, least in found["least_eigenvalues"].items():
            ax.plot(range(1, len(least) + 1), sorted(least), label=scheme)
        ax.axhline(0.0, color="black", lw=0.7)
        ax.set(
            title="UR5: the classic scheme is unstable in {classic_unstable}, ours in "
            "{ours_unstable} of {postures} postures".format(**found),
            xlabel="postures, each scheme from its least stable one",
            ylabel=r"least real part of $\lambda$ (1/s²)",
            yscale="symlog",
        )
        ax.legend()
    return figure
