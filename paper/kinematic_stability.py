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

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import osc_contact as osc
from osc_contact import robots
from osc_contact.projections import left_inverse
from osc_contact.spatial import Array
from osc_contact.visual.plots import style
from paper.study import Ask, Data, Study, table_of, with_object


def study(ask: Ask) -> Study:
    """Both schemes on a planar arm and on a UR5: searched and mapped."""
    found = []
    for arm, joints in ((planar_arm(), (0, 1)), (ur5_arm(), (1, 2))):
        worst = search(arm, ask.seed)
        found.append((worst, joints, posture_map(worst, joints)))
    data = [worst.as_dict() for worst, *_ in found]
    table = table_of(
        "kinematic stability",
        "arm; postures; classic unstable; classic least λ (1/s²); ours least λ (1/s²)",
        (
            f"{row['arm']}; {row['postures']}; {row['classic_unstable']}; "
            f"{row['classic_eigenvalues'][0][0]:.4g}; {row['ours_least_eigenvalue']:.4g}"
            for row in data
        ),
    )
    return Study({"kinematic_stability": draw(found)}, table, {"arms": data})


_WORLD_AXES = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
_HELD = pin.Inertia(1.2, np.array([0.03, 0.0, 0.02]), np.diag([4e-3, 6e-3, 5e-3]))


class HybridArm:
    """An arm of n joints that controls the force along one world axis and n − 1 motions.

    Attributes:
        name: in titles.
        chain: one arm and the held object, whose frame is the tip.
        plant: model of the arm with the object's inertia on its last joint; data: its scratch, from
            which nothing read outlives the next call; tip: index of the tip's frame.
        rows: the first n of the tip's twist (world axes at the tip), the task coordinates.
        force: which of them is force-controlled; selection: (n,) 0 there, else 1.
        K_q: (n, n) joint stiffness of the classic scheme (N m/rad).
        K_prime: (6, 6) stiffness of ours, world axes (N/m, N m/rad).
    """

    def __init__(self, name: str, arm: osc.Arm, force: int, K_q: Array) -> None:
        """Let the arm hold the object.

        Args:
            name, force, K_q: as the attributes. arm: without its object.
        """
        self.name = name
        self.chain = osc.ClosedChain([arm], payload=osc.RigidObject(_HELD))
        self.plant, self.tip = with_object(self.chain)
        self.data = self.plant.createData()
        n = self.chain.nq
        self.rows = slice(n)
        self.force = force
        self.selection = (np.arange(n) != force).astype(float)
        self.K_q = K_q
        self.K_prime = np.diag([300.0, 300.0, 300.0, 3.0, 3.0, 3.0])

    def terms(self, q: Array) -> tuple[Array, Array, pin.SE3]:
        """M (n, n) with the object, the tip's Jacobian (6, n), world axes, and its pose."""
        data = self.data
        M = np.array(pin.crba(self.plant, data, q))
        J = pin.computeFrameJacobian(self.plant, data, q, self.tip, _WORLD_AXES)
        pin.updateFramePlacement(self.plant, data, self.tip)
        return M, np.array(J), pin.SE3(data.oMf[self.tip])

    def tangents(self, J: Array) -> Array:
        """(6, n−1) what the contact permits and the arm can do, J (6, n) the tip's Jacobian."""
        if self.chain.nq == 6:  # the arm can do everything
            return np.delete(np.eye(6), self.force, axis=1)
        return J @ np.linalg.svd(J[[self.force]])[2][1:].T

    def metric(self, tip: pin.SE3) -> Array:
        """B (6, 6) at the tip, world axes: the inverse inertia of the held object."""
        return np.linalg.inv(pin.SE3(tip.rotation, np.zeros(3)).act(_HELD).matrix())


def planar_arm() -> HybridArm:
    """Two revolute joints in a horizontal plane; x of the tip is position-, y force-controlled."""
    model = pin.Model()
    parent = 0
    placement = pin.SE3.Identity()
    for name, length, mass in (("shoulder", 0.5, 6.0), ("elbow", 0.4, 4.0)):
        parent = model.addJoint(parent, pin.JointModelRZ(), placement, name)
        inertia = mass * length**2 / 12 * np.diag([0.02, 1.0, 1.0])
        placement = pin.SE3(np.eye(3), np.array([length, 0.0, 0.0]))
        link = pin.Inertia(mass, 0.5 * placement.translation, inertia)
        model.appendBodyToJoint(parent, link, pin.SE3.Identity())
    model.upperEffortLimit = np.full(2, 100.0)
    model.lowerEffortLimit = -model.upperEffortLimit
    model.addFrame(pin.Frame("tip", parent, placement, pin.FrameType.OP_FRAME))
    arm = osc.Arm.from_urdf(model, name="planar", tip="tip")
    return HybridArm("planar 2R arm", arm, 1, 120.0 * np.eye(2))


def ur5_arm() -> HybridArm:
    """A UR5 that controls the force along z and all other motions of its tool."""
    arm = osc.Arm.from_urdf(robots.find_robot("ur5")[0], name="ur5", tip="tool0")
    return HybridArm("UR5", arm, 2, np.diag([400.0, 400.0, 200.0, 20.0, 20.0, 20.0]))


def classic_eigenvalues(M: Array, J: Array, selection: Array, K_q: Array) -> Array:
    """The s eigenvalues of M⁻¹K_q J⁻¹S J that position control owns, s = number selected.

    The n − s others are zero: nothing in this scheme stiffens the force-controlled directions.

    Args:
        M: (n, n) joint-space inertia. J: (n, n) Jacobian of the task coordinates.
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


class WorstPosture(NamedTuple):
    """The posture in which the classic scheme is least stable, and both schemes there.

    Attributes:
        arm: and its posture q (n,).
        classic, ours: (s,) complex eigenvalues of both (1/s²).
        counts: arm and seed; how many postures were drawn and examined, in how many an eigenvalue
            had a negative real part, and the least real part of ours (1/s²), for JSON.
    """

    arm: HybridArm
    q: Array
    classic: Array
    ours: Array
    counts: Data

    def as_dict(self) -> Data:
        """For JSON; eigenvalues (1/s²) as [real, imaginary]."""
        spectra = {"classic_eigenvalues": self.classic, "ours_eigenvalues": self.ours}
        return self.counts | {
            "posture_rad": self.q.tolist(),
            **{name: np.column_stack((z.real, z.imag)).tolist() for name, z in spectra.items()},
        }


def search(
    arm: HybridArm, seed: int = 0, postures: int = 2000, regular: float = 0.5
) -> WorstPosture:
    """Draw uniformly random postures and examine the most regular of them.

    Args:
        arm: the joints go from −π to π.
        seed: of the draw.
        postures: how many to draw.
        regular: share of them that is examined, the most regular first (`regularity`): an
            instability next to a singularity would prove little.

    Raises:
        InvalidInputError: none of them is unstable.
    """
    drawn = np.random.default_rng(seed).uniform(-np.pi, np.pi, (postures, arm.chain.nq))
    order = np.argsort([-regularity(arm, q) for q in drawn])
    examined = drawn[order[: round(regular * postures)]]
    values = [eigenvalues(arm, q) for q in examined]
    classic, ours = np.array([[one[0].real for one in both] for both in values]).T
    worst = int(classic.argmin())
    if classic[worst] >= 0.0:
        raise osc.InvalidInputError(
            f"{arm.name}: none of {len(examined)} postures examined is unstable; draw more "
            "(postures=), or control the force along another axis"
        )
    counts = {
        "arm": arm.name,
        "seed": seed,
        "postures_drawn": postures,
        "postures": len(examined),
        "classic_unstable": int((classic < 0.0).sum()),
        "ours_unstable": int((ours < 0.0).sum()),
        "ours_least_eigenvalue": float(ours.min()),
    }
    return WorstPosture(arm, examined[worst], *values[worst], counts)


def eigenvalues(arm: HybridArm, q: Array) -> tuple[Array, Array]:
    """`classic_eigenvalues` and `our_eigenvalues` in a posture (n,)."""
    M, J, tip = arm.terms(q)
    classic = classic_eigenvalues(M, J[arm.rows], arm.selection, arm.K_q)
    return classic, our_eigenvalues(arm.tangents(J), arm.metric(tip), arm.K_prime)


def regularity(arm: HybridArm, q: Array) -> float:
    """Least share of the object in the inertia met at the tip, over all directions (0: singular).

    The least eigenvalue of LᵀJM⁻¹JᵀL with LLᵀ the object's inertia: no units, no frame.
    """
    M, J_tip, tip = arm.terms(q)
    J = J_tip[arm.rows]
    L = np.linalg.cholesky(np.linalg.inv(arm.metric(tip)[arm.rows, arm.rows]))
    return float(np.linalg.eigvalsh(L.T @ J @ np.linalg.solve(M, J.T) @ L)[0])


def posture_map(worst: WorstPosture, joints: tuple[int, int], count: int = 48) -> Array:
    """(2, k, k) least real part of both schemes' eigenvalues over two joints (1/s²), see `_grid`.

    Args:
        worst: arm and posture, in which the other joints stay.
        joints: indices of the two joints, the second by rows.
        count: positions of each, over the whole turn.

    Returns:
        Of the classic scheme, of ours.
    """
    least = np.empty((2, count, count))
    q = worst.q.copy()
    grid = _grid(count)
    for j, i in np.ndindex(count, count):
        q[list(joints)] = grid[[i, j]]
        least[:, j, i] = [values[0].real for values in eigenvalues(worst.arm, q)]
    return least


def _grid(count: int) -> Array:
    """Positions of a joint (rad), never exactly straight."""
    return (np.arange(count) + 0.5) / count * 2 * np.pi - np.pi


_LIMIT = 25.0  #: 1/s, where the colours of the maps end


def draw(found: Sequence[tuple[WorstPosture, tuple[int, int], Array]]) -> Figure:
    """A row per arm: maps of the least real parts of both schemes (unstable hatched)."""
    titles = (
        r"classic: $M^{-1}K_q J^{-1}SJ$",
        r"ours: $(T^TB^{-1}T)^{-1}T^TB^{-1}K\,T,\ K=BK'$",
    )
    with style():
        figure = Figure(figsize=(9.0, 4.2 * len(found)))
        rows = figure.subfigures(len(found), 1, squeeze=False)[:, 0]
        for row, (worst, joints, least) in zip(rows, found, strict=True):
            row.suptitle(
                "{arm}: the classic scheme is unstable in {classic_unstable}, ours in "
                "{ours_unstable} of {postures} postures".format(**worst.counts)
            )
            axes = row.subplots(1, 2)
            for ax, values, title in zip(axes, least, titles, strict=True):
                shade = _map(ax, values)
                ax.plot(*np.rad2deg(worst.q[list(joints)]), "X", color="black", mec="white", ms=11)
                x, y = (rf"$q_{joint + 1}$ (°)" for joint in joints)
                ax.set(title=title, xlabel=x, ylabel=y, aspect="equal")
            bar = row.colorbar(shade, ax=axes, shrink=0.9, extend="both")
            bar.set_label(r"least real part $\lambda$, as sign$(\lambda)\sqrt{|\lambda|}$ (1/s)")
    return figure


def _map(ax: Axes, values: Array) -> Any:
    rates = np.sign(values) * np.sqrt(np.abs(values))
    degrees = np.rad2deg(_grid(len(values)))
    look: Data = {"cmap": "RdBu", "vmin": -_LIMIT, "vmax": _LIMIT, "rasterized": True}
    shade = ax.pcolormesh(degrees, degrees, rates, **look)
    if values.min() < 0.0:
        ax.contourf(degrees, degrees, values, [-1e30, 0.0], colors="none", hatches=["////"])
    ax.grid(False)
    return shade
