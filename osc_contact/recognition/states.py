"""Contact states as candidates, and the likelihood of a wrench in each of them.

The object presses with the wrench f = N α + e, α ≥ α₀, if the pairs of a state with the columns N
are closed; each pair carries a least force, so that a state with more pairs explains a wrench
better only if they carry some. The error e has the covariance

    S(α) = S_f + J(α) P J(α)ᵀ + Σ ½ (μ αⱼ)² Bⱼ Bⱼᵀ

of the wrench reading (S_f), of the pose of the touched body relative to the object (P, with
J(α) = Σ αⱼ ∂Nⱼ/∂δ) and of friction, which is unknown in size and direction up to μ αⱼ; Bⱼ (6, 2)
are unit forces along the two tangents. Everything is weighted by these covariances, so that the
result depends neither on frame and units nor on the basis of N.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from osc_contact.contacts.feet import force_owners
from osc_contact.contacts.pairs.law_pair import normals_over
from osc_contact.contacts.pairs.pair import ContactPair, has_known_points, pushes_only
from osc_contact.errors import ContactError, InvalidInputError, did_you_mean
from osc_contact.recognition.cones import RIDGE, Cones
from osc_contact.spatial import Array, Poses, as_array, carry_wrench, rotations, skew

MOST_COLUMNS = 6  #: largest number of columns of N of a state
APART = 3.0  #: standard deviations of e by which wrenches of two states must differ
_STEP = 1e-6  #: displacement of the touched body for derivatives of N (m, rad)


@dataclass(frozen=True)
class WrenchErrors:
    """Standard deviations of the errors that make the wrench of a contact state uncertain.

    Attributes:
        force, torque: of the wrench reading at `sensor` (N, N m), with errors of masses and tare.
        sensor: (3,) place of the wrist sensor in the object's frame (m).
        position, angle: of the touched body's pose relative to the object, at the object's origin
            (m, rad), along and about each axis.
        friction: largest coefficient of friction.
        expected: usual size of a contact force (N); the larger it is, the better a state with more
            forces has to explain the wrench.
        least: least force of a pair that pushes (N), distributed evenly over its columns of N.

    Raises:
        InvalidInputError: a number that is not positive (friction and least: negative).

    Example:
        >>> errors = osc.WrenchErrors(force=0.2, torque=0.01, sensor=[0, 0, -0.2], friction=0.3)
        >>> print(errors.covariance(pin.SE3.Identity()).diagonal().round(5))
        [0.04   0.04   0.04   0.0017 0.0017 0.0001]
    """

    force: float = 0.2
    torque: float = 0.02
    sensor: ArrayLike = (0.0, 0.0, 0.0)
    position: float = 1e-3
    angle: float = 0.02
    friction: float = 0.3
    expected: float = 4.0
    least: float = 0.5

    def __post_init__(self) -> None:
        """Check the numbers."""
        as_array("sensor", self.sensor, (3,))
        for name in ("force", "torque", "position", "angle", "expected", "friction", "least"):
            value = getattr(self, name)
            may_be_zero = name in ("friction", "least")
            if not (np.isfinite(value) and (value > 0.0 or (may_be_zero and value == 0.0))):
                bound = "≥ 0" if may_be_zero else "> 0"
                raise InvalidInputError(f"{name} = {value!r}; give a number {bound} in SI units")

    def covariance(self, X_WO: pin.SE3) -> Array:
        """Covariance S_f (6, 6) of the wrench reading at O in world axes (N², N² m, N² m²).

        Args:
            X_WO: pose of the object.
        """
        place = X_WO.rotation @ np.asarray(self.sensor, dtype=np.float64)
        at_O = carry_wrench(np.eye(6), place, np.zeros(3))
        return at_O @ np.diag(np.repeat([self.force, self.torque], 3) ** 2) @ at_O.T

    def pose_covariance(self) -> Array:
        """Covariance P (6, 6) of the displacement of the touched body at O (m², rad²)."""
        return np.diag(np.repeat([self.position, self.angle], 3) ** 2)


@dataclass(frozen=True)
class Columns:
    """Columns of N of all pairs of the candidates, and the geometry on which their errors depend.

    Attributes:
        N: (6, r) columns at O in world axes.
        J: (r, 6, 6) derivatives of each column by a displacement of the touched body at O.
        F: (r, 6, 6) B Bᵀ of each column, for a force of size 1 along both tangents; zero where
            friction is unknown.
        exists: (r,) False for columns that do not exist in this pose, such as parallel edges.
    """

    N: Array
    J: Array
    F: Array
    exists: Array


class ContactStates:
    """Contact states that are distinguished by the wrench of the object on its environment.

    Args:
        states: names of the pairs of each state by its name; a state without pairs is free.
        pairs: the pairs by name, for example those of `pairs_between`.
        errors: errors of readings, poses and friction.

    Attributes:
        names: names of the n states.
        pairs: pairs that occur in them, by name; N has their r columns, in this order.
        members: names of the pairs of each state.
        sizes: (n,) number of columns of N of each state.
        errors: errors of readings, poses and friction.

    Raises:
        InvalidInputError: no states, a pair that does not exist, two states with the same pairs, or
            one with more than 6 columns of N.

    Example:
        >>> touch = {
        ...     "left": osc.VertexOnFace([-0.1, 0, 0], [0, 0, 0], [0, 0, 1]),
        ...     "right": osc.VertexOnFace([0.1, 0, 0], [0, 0, 0], [0, 0, 1]),
        ... }
        >>> states = osc.ContactStates(
        ...     {"free": [], "left": ["left"], "right": ["right"], "both": ["left", "right"]},
        ...     touch,
        ...     osc.WrenchErrors(),
        ... )
        >>> f = np.array([0.3, 0, -8.0, 0, -0.8, 0])  # presses down, 0.1 m to the left
        >>> print(states.names[int(states.log_likelihoods(pin.SE3.Identity(), f).argmax())])
        left
    """

    def __init__(
        self,
        states: Mapping[str, Sequence[str]],
        pairs: Mapping[str, ContactPair],
        errors: WrenchErrors | None = None,
    ) -> None:
        """Check the candidates, and number the columns of N of their pairs.

        Args:
            states: names of the pairs that touch in each state, by the name of the state.
            pairs: contact pairs by name, of which those in a state are used.
            errors: expected errors of the wrenches; None: the default ones.

        Raises:
            InvalidInputError: no states, an unknown pair, two states with the same pairs, or a
                state with too many columns.
        """
        _require_states(states, pairs)
        self.names = tuple(states)
        self.members = tuple(frozenset(states[name]) for name in states)
        self.errors = errors or WrenchErrors()

        # pairs of at least one state, in the order of their first occurrence, and their columns
        pair_names = dict.fromkeys(name for members in states.values() for name in members)
        self.pairs = {name: pairs[name] for name in pair_names}
        pair_list = list(self.pairs.values())
        owners = force_owners(pair_list) if pair_list else np.zeros(0, dtype=np.intp)
        order = list(self.pairs)
        columns = [
            [k for k, owner in enumerate(owners.tolist()) if order[owner] in members]
            for members in self.members
        ]
        for name, indices in zip(self.names, columns, strict=True):
            if len(indices) > MOST_COLUMNS:
                raise InvalidInputError(
                    f"state {name!r} has {len(indices)} columns of N; give at most {MOST_COLUMNS}"
                )
        self.sizes = np.array([len(indices) for indices in columns])
        self._owners = owners  #: (r,) index of the pair of each column of N
        pushes = np.array([pushes_only(pair) for pair in pair_list], dtype=bool)
        self._pushes = pushes[owners]  #: (r,) whether the force of a column must not be negative
        self._cones = Cones(columns, self._pushes)  #: cones of the states, for the fit

        # least force of each column in each state: that of a contact is shared by its columns
        counts = np.bincount(owners, minlength=len(pair_list))
        #: (n, r) least forces α₀ (N)
        self._least = np.zeros((len(columns), len(owners)))
        for i, indices in enumerate(columns):
            pressing = [k for k in indices if self._pushes[k]]
            self._least[i, pressing] = self.errors.least / counts[owners[pressing]]
        # a force of one sign has half of the values of a force of either sign: twice the density
        signs = [int(self._pushes[indices].sum()) for indices in columns]
        #: (n,) logarithm of the density's factor by forces of one sign
        self._one_sided = np.log(2.0) * np.array(signs)

    def columns(self, X_WO: pin.SE3, X_WE: pin.SE3 | None = None) -> Columns:
        """Compute the columns of N of all pairs, their derivatives, and their tangents.

        N (6, r) are the wrenches of unit contact forces at O in world axes; J (r, 6, 6) their
        derivatives by a displacement of the touched body at O, as difference quotients; F (r, 6, 6)
        the squares B Bᵀ of the wrenches of unit forces along both tangents, zero where points of
        contact are not known.

        Args:
            X_WO: pose of the object.
            X_WE: believed pose of the touched body; None: the world frame.
        """
        # the body at its pose, then displaced along each of six axes; the object stays
        near = _displace_body(X_WE or pin.SE3.Identity(), X_WO.translation)
        here = Poses(np.repeat(X_WO.rotation[:, :, None], 7, 2), X_WO.translation[:, None])
        here = Poses(here.R, np.repeat(here.p, 7, 1))
        r = len(self._owners)
        N = np.zeros((6, r))
        J = np.zeros((r, 6, 6))
        F = np.zeros((r, 6, 6))
        exists = np.zeros(r, dtype=bool)
        for i, pair in enumerate(self.pairs.values()):
            indices = self._owners == i
            try:
                all_columns = normals_over(pair, here, near)  # (6, own, 7)
            except ContactError:  # edges are parallel
                N[2, indices] = 1.0  # any column with which Gram matrices are regular
                continue
            exists[indices] = True
            N[:, indices] = all_columns[:, :, 0]
            change = (all_columns[:, :, 1:] - all_columns[:, :, :1]) / _STEP
            J[indices] = change.transpose(1, 0, 2)
            if has_known_points(pair):
                points = pair.points_of_contact(X_WO, X_WE) - X_WO.translation[:, None]
                F[indices] = [
                    _along_tangents(normal, point)
                    for normal, point in zip(all_columns[:3, :, 0].T, points.T, strict=True)
                ]
        return Columns(N, J, F, exists)

    def log_likelihoods(
        self, X_WO: pin.SE3, wrench: ArrayLike, X_WE: pin.SE3 | None = None
    ) -> Array:
        """Logarithm of the probability density of a wrench in each state, up to a constant (n,).

        It is −½ min (f − Nα)ᵀS⁻¹(f − Nα) − ½ log det S with α ≥ α₀, less ½ log det(1 + ρ² G_f⁻¹ G)
        for the freedom of α, with G = NᵀS⁻¹N, G_f = NᵀS_f⁻¹N and ρ the expected force over the
        standard deviation of its reading.

        Args:
            X_WO: pose of the object.
            wrench: (6,) wrench of the object on its environment at O, world axes (N, N m).
            X_WE: believed pose of the touched body; None: the world frame.

        Returns:
            Values (n,); −∞ for a state with a pair that does not exist in this pose.
        """
        f = as_array("wrench", wrench, (6,))
        return self.judge(self.columns(X_WO, X_WE), self.errors.covariance(X_WO), f)[0]

    def judge(self, columns: Columns, S_f: Array, f: Array) -> tuple[Array, Array, Array]:
        """Log-likelihoods, least squares and force magnitudes of a wrench in each of n states.

        Magnitudes α are at least α₀ (`_least`), so that α − α₀ ≥ 0 is fitted to f − Nα₀. A first
        fit with the errors of the reading alone gives the forces on which the other errors depend,
        by poses and friction; the second fit has the covariance of all errors.

        Args:
            columns: columns of N of all pairs.
            S_f: (6, 6) covariance of the wrench reading.
            f: (6,) wrench at O, world axes (N, N m).

        Returns:
            Log-likelihoods (n,), −∞ for a state with a pair that does not exist in this pose; least
            squares (n,), dimensionless; and α (n, k) (N).
        """
        cones = self._cones
        beyond = f - self._least @ columns.N.T
        least = np.take_along_axis(self._least, cones.index, axis=1) * cones.used
        first, _, G_f = cones.fit(columns.N, S_f, beyond)
        S = self._covariances(columns, S_f, first + least)
        alpha, squares, G = cones.fit(columns.N, S, beyond)
        alpha = alpha + least
        densities = -0.5 * squares - 0.5 * np.linalg.slogdet(S)[1]
        # a force of one sign has twice the density; free magnitudes reduce that of a state
        densities += self._one_sided - self._freedom(G, G_f)
        missing = (~columns.exists[cones.index] & (cones.used > 0.0)).any(axis=1)
        densities[missing] = -np.inf
        return densities, squares, alpha

    def forces(self, state: int, alpha: Array) -> dict[str, float]:
        """Force of each pair of a state by its name: the sum over its columns of N (N).

        Args:
            state: number of the state.
            alpha: (n, k) magnitudes of `judge`.
        """
        order = list(self.pairs)
        found = {name: 0.0 for name in order if name in self.members[state]}
        indices = self._cones.index[state, : self.sizes[state]]
        for column, magnitude in zip(indices.tolist(), alpha[state].tolist(), strict=False):
            found[order[self._owners[column]]] += magnitude
        return found

    def _covariances(self, columns: Columns, S_f: Array, alpha: Array) -> Array:
        """Covariances S(α) (n, 6, 6) of the wrench in each state.

        Args:
            columns: columns of N and their derivatives.
            S_f: (6, 6) covariance of the reading.
            alpha: (n, k) magnitudes.
        """
        cones = self._cones
        J = np.einsum("nk,nkab->nab", alpha, columns.J[cones.index])
        friction = 0.5 * (self.errors.friction * alpha) ** 2
        S = S_f + J @ self.errors.pose_covariance() @ J.transpose(0, 2, 1)
        return S + np.einsum("nk,nkab->nab", friction, columns.F[cones.index])

    def _freedom(self, G: Array, G_f: Array) -> Array:
        """Loss of log-likelihood (n,) of each state by the freedom of its force magnitudes.

        It is ½ log det(1 + ρ² G_f⁻¹ G), with ρ the expected force over the standard deviation of
        its reading. Columns are scaled to a unit diagonal of G_f, which does not change the value;
        places without a column (`used` = 0) get a 1 on the diagonal of the first matrix only, so
        that they add nothing.

        Args:
            G: (n, k, k) Gram matrices NᵀS⁻¹N of the states' columns, with the covariance of all
                errors.
            G_f: (n, k, k) Gram matrices with that of the reading alone.
        """
        most = G.shape[1]
        if most == 0:
            return np.zeros(len(G))
        ratio = (self.errors.expected / self.errors.force) ** 2
        sizes = np.sqrt(np.einsum("nkk->nk", G_f)) + (1.0 - self._cones.used)
        scale = sizes[:, :, None] * sizes[:, None]
        padding = np.einsum("nk,kl->nkl", 1.0 - self._cones.used, np.eye(most))
        reading = G_f / scale + padding + RIDGE * np.eye(most)
        whole = G / scale + RIDGE * np.eye(most) * self._cones.used[:, None]
        # log det(1 + ρ² A⁻¹B) = log det(A + ρ² B) − log det A
        each = np.linalg.slogdet(reading + ratio * whole)[1] - np.linalg.slogdet(reading)[1]
        return 0.5 * each

    def distances(
        self, X_WO: pin.SE3, X_WE: pin.SE3 | None = None, force: float | None = None
    ) -> Array:
        """Distances D (n, n) of contact states: the error with which state j explains state i.

        D[i, j]² is the least value of (f − Nα)ᵀS⁻¹(f − Nα) over the forces α that state j permits.
        f is the wrench of state i with the same force at each of its pairs, S the covariance of its
        errors.

        Args:
            X_WO: pose of the object.
            X_WE: pose of the touched body; None: the world frame.
            force: force of each pair (N); None: that expected.
        """
        columns = self.columns(X_WO, X_WE)
        S_f = self.errors.covariance(X_WO)
        size = self.errors.expected if force is None else force
        counts = np.bincount(self._owners, minlength=len(self.pairs)) if self.pairs else None
        rows = []
        for i in range(len(self.names)):
            indices = self._cones.index[i, : self.sizes[i]]  # columns of state i
            f = np.zeros(6)
            if counts is not None and len(indices):
                f = columns.N[:, indices] @ (size / counts[self._owners[indices]])
            rows.append(np.sqrt(self.judge(columns, S_f, f)[1]))
        return np.array(rows)

    def groups(
        self, X_WO: pin.SE3, X_WE: pin.SE3 | None = None, force: float | None = None
    ) -> tuple[tuple[str, ...], ...]:
        """Groups of states that sensors cannot distinguish in a pose, known before a run.

        Two states are in one group if a usual wrench of the first is within three standard
        deviations of the cone of the second, which has no more forces; and so are states that are
        connected by others. So a wall that carries less than the friction of the bottom is not
        distinguished from friction.

        Args:
            X_WO: pose of the object.
            X_WE: pose of the touched body; None: the world frame.
            force: force of each pair (N); None: that expected.
        """
        D = self.distances(X_WO, X_WE, force)
        near = (D < APART) & (self.sizes[:, None] >= self.sizes[None, :])
        near |= near.T
        number = list(range(len(self.names)))
        for i, j in np.argwhere(near).tolist():
            old = number[j]
            number = [number[i] if one == old else one for one in number]
        found: dict[int, list[str]] = {}
        for one, name in zip(number, self.names, strict=True):
            found.setdefault(one, []).append(name)
        return tuple(tuple(names) for names in found.values())


def _require_states(states: Mapping[str, Sequence[str]], pairs: Mapping[str, ContactPair]) -> None:
    """Refuse candidates that do not make a set of different contact states.

    Args:
        states: names of the pairs that touch in each state, by the name of the state.
        pairs: all contact pairs by name.

    Raises:
        InvalidInputError: no states, an unknown pair, or two states with the same pairs.
    """
    if not states:
        raise InvalidInputError("no contact states; give one at least, such as {'free': []}")
    state_of_members: dict[frozenset[str], str] = {}
    for name, members in states.items():
        if isinstance(members, str):
            raise InvalidInputError(f"state {name!r}: {members!r}; give a list of names of pairs")
        for member in members:
            if member not in pairs:
                raise InvalidInputError(
                    f"state {name!r}: there is no contact {member!r}; {did_you_mean(member, pairs)}"
                )
        first_state = state_of_members.setdefault(frozenset(members), name)
        if first_state != name:
            raise InvalidInputError(
                f"states {first_state!r} and {name!r} have the same pairs; drop one"
            )


def _displace_body(X_WE: pin.SE3, O: Array) -> Poses:  # noqa: E741
    """Seven poses of the touched body: the believed one, and with a step along and about each axis.

    Args:
        X_WE: believed pose of the body in the world.
        O: (3,) point about which the body is rotated, world (m).

    Returns:
        Poses in the world: the believed one, three translations and three rotations.
    """
    # columns of steps: none, then one of the six displacements each (m, rad)
    steps = _STEP * np.hstack((np.zeros((6, 1)), np.eye(6)))
    turns = rotations(steps[3:])
    arm = X_WE.translation - O
    positions = O[:, None] + np.einsum("ijk,j->ik", turns, arm) + steps[:3]
    return Poses(np.einsum("ijk,jl->ilk", turns, X_WE.rotation), positions)


def _along_tangents(normal: Array, point: Array) -> Array:
    """B Bᵀ (6, 6) of unit forces along the tangents at a point.

    Args:
        normal: (3,) force of one unit of α.
        point: (3,) point of contact from O (m).
    """
    tangential = (normal @ normal) * np.eye(3) - np.outer(normal, normal)
    B = np.vstack((np.eye(3), skew(point)))
    return B @ tangential @ B.T
