"""What is desired at time t, from a scenario's signals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from osc_contact.contacts.pairs.pair import ContactPair, pushes_only
from osc_contact.contacts.pairs.sphere_on_surface import SphereOnSurface
from osc_contact.errors import InvalidInputError, ScenarioError
from osc_contact.interface import Reference
from osc_contact.runs.contacts import force_owners
from osc_contact.runs.dither import slides
from osc_contact.scenarios.bodies import forces_of, magnitude_names
from osc_contact.scenarios.control_schema import TareSpec
from osc_contact.scenarios.schema import MotionSpec, Scenario, SurfaceMove
from osc_contact.scenarios.signals import MinimumJerk, Step, total_over
from osc_contact.spatial import Array, Poses, as_array, cross, norm, rotated, rotations


def common_tangent(pairs: Sequence[ContactPair], X_WO: pin.SE3) -> Array:
    """The one direction (3,) of translation that every contact permits at X_WO.

    Raises:
        ScenarioError: the contacts leave none, or more than one.
    """
    pushes = [pair.contact(X_WO, np.zeros(6)).N[:3].T for pair in pairs]
    _, s, Vh = np.linalg.svd(np.vstack([np.zeros((0, 3)), *pushes]), full_matrices=True)
    rank = int(np.count_nonzero(s > 1e-6))
    if rank != 2:
        raise ScenarioError(
            f"direction: common_tangent needs contact forces that span a plane; {len(pairs)} "
            f"contacts span {rank} dimension(s). Give the direction as [x, y, z] instead."
        )
    direction: Array = Vh[2]
    return direction * np.sign(direction[np.abs(direction).argmax()])


def force_names(scenario: Scenario) -> list[str]:
    """Names of all force magnitudes, in the order of alpha: ``tip``, ``pad.1``, ``pad.2``, …"""
    return magnitude_names(forces_of(scenario.contacts))


def force_steps(scenario: Scenario) -> list[float]:
    """Times at which a desired contact force jumps (s); forces are not judged just after them.

    Contacts that engage after a tare are such steps, too.
    """
    steps = {
        float(signal.start)
        for signals in scenario.force.values()
        for signal in signals
        if isinstance(signal, Step)
    }
    if (tare := scenario.tare) is not None and scenario.control.life is None:
        steps.add(float(tare.duration + tare.approach))
    return sorted(steps)


_AT_ONCE = 1000  #: references that are worked out together


@dataclass(frozen=True)
class References:
    """Reference signals of one run.

    Attributes:
        scenario: source of the signals.
        X_start: pose of the object in contact at t = 0.
        directions: (3,) of each move, resolved.
        standoff: (6,) displacement off the contacts during the tare phase (zero: none).
        surfaces: what each move follows; None: nothing.
        showing: (6,) motion of `control.dither`, at its origin, for each metre along the line.
    """

    scenario: Scenario
    X_start: pin.SE3
    directions: tuple[Array, ...]
    standoff: Array
    surfaces: tuple[SurfaceMotion | None, ...]
    showing: Array

    @classmethod
    def of(
        cls,
        scenario: Scenario,
        X_start: pin.SE3,
        pairs: Sequence[ContactPair],
        standoff: Array,
        showing: Array | None = None,
    ) -> References:
        """Resolve `common_tangent` and check that no face is to pull.

        Args:
            scenario: with the signals. X_start: pose of the object at the start.
            pairs: the contacts. standoff: (contacts,) gaps at the start (m).
            showing: as an attribute; None: zero.

        Raises:
            ScenarioError: see `common_tangent`; or a desired force is negative at some time.
        """
        directions = tuple(
            common_tangent(pairs, X_start)
            if move.direction == "common_tangent"
            else np.array(move.direction, dtype=float)
            for move in scenario.motion
        )
        surfaces = tuple(_followed(move, pairs, X_start) for move in scenario.motion)
        showing = np.zeros(6) if showing is None else showing
        references = cls(scenario, X_start, directions, standoff, surfaces, showing)
        t = np.linspace(0.0, scenario.duration, 2000)
        owners = force_owners(pairs)
        for name, i, force in zip(force_names(scenario), owners, references.forces(t), strict=True):
            if pushes_only(pairs[i]) and (force < 0.0).any():
                first = int(np.argmax(force < 0.0))
                raise ScenarioError(
                    f"force.{name} is {force[first]:.3g} N at t = {t[first]:.3g} s; this "
                    "contact cannot pull. Raise the constant part or lower the amplitude."
                )
        return references

    @property
    def engage_at(self) -> float:
        """When the contacts enter the controller's model (s): after tare and approach, which is
        the controller's own business where `control.life` is set."""
        tare = self.scenario.tare
        if tare is None:
            return 0.0
        by_life = self.scenario.control.life is not None
        return float(tare.duration) if by_life else float(tare.duration + tare.approach)

    def at(self, t: float) -> Reference:
        """The reference at time t (s); accelerations are classical."""
        return next(iter(self.over(np.array([t]))))

    def each(self, ticks: int, period: float) -> Iterator[Reference]:
        """The references of so many ticks, one after the other."""
        for start in range(0, ticks, _AT_ONCE):
            yield from self.over(np.arange(start, min(start + _AT_ONCE, ticks)) * period)

    def forces(self, t: Array) -> Array:
        """(r, k) desired magnitudes at times t (k,)."""
        names = force_names(self.scenario)
        signals = self.scenario.force
        return np.reshape([total_over(signals[name], t)[0] for name in names], (len(names), len(t)))

    @cached_property
    def overview(self) -> tuple[Array, Plan]:
        """Times (400,) through the whole run, and the references there."""
        t = np.linspace(0.0, self.scenario.duration, 400)
        return t, self.over(t)

    def over(self, t: Array) -> Plan:
        """The references at many times t (k,), worked out together."""
        x = np.zeros((3, 3, len(t)))  # displacement, velocity, acceleration
        place = np.zeros((3, 3, len(t)))  # of the origin without linear moves
        place[0] = self.X_start.translation[:, None]
        turn = None
        ways = [
            (one, np.einsum("ij,djk->dik", one.axes, move.over(t)))
            for one, move in zip(self.surfaces, self.scenario.motion, strict=True)
            if one is not None and isinstance(move, SurfaceMove)
        ]
        if ways:
            on = ways[0][0]
            u = np.einsum("ij,dik->djk", on.axes, sum(way for _, way in ways))
            place, rotation = on.over(u)
            turn = _Turn(*rotation)
        for move, direction in zip(self.scenario.motion, self.directions, strict=True):
            if isinstance(move, SurfaceMove):
                continue
            s = total_over(move.signals, t)
            if move.kind == "linear":
                x += direction[:, None] * s[:, None]
            else:
                turn = _Turn.start(len(t)) if turn is None else turn
                turn = turn.then(direction, s)
                if move.through is not None:
                    place = _swung(place, direction, np.array(move.through), s)
        if self.scenario.control.dither is not None:
            s = np.array(slides(self.scenario.control.dither, self.engage_at, t))
            x += self.showing[:3, None] * s[:, None]
            turn = (_Turn.start(len(t)) if turn is None else turn).then(self.showing[3:], s)
        x[1:] += place[1:]
        if self.scenario.tare is not None:
            away = _away(self.scenario.tare, t)
            x += self.standoff[:3, None] * away[:, None]
            turn = (_Turn.start(len(t)) if turn is None else turn).then(self.standoff[3:], away)
        R = self.X_start.rotation[:, :, None]
        spin = np.zeros((2, 3, len(t)))
        if turn is not None:
            R = rotated(turn.R, R)
            spin = np.stack((turn.omega, turn.omega_dot))
        return Plan(
            X_WD=Poses(R, place[0] + x[0]).coordinates(len(t)),
            V_D=np.concatenate((x[1], spin[0])).T.copy(),
            A_D=np.concatenate((x[2], spin[1])).T.copy(),
            alpha_d=self.forces(t).T.copy(),
            squeeze_d=float(self.scenario.squeeze),
        )


def _followed(
    move: MotionSpec, pairs: Sequence[ContactPair], X_start: pin.SE3
) -> SurfaceMotion | None:
    """What a move follows; None: nothing.

    Raises:
        ScenarioError: it names no contact on a surface.
    """
    if not isinstance(move, SurfaceMove):
        return None
    for pair in pairs:
        if pair.name == move.contact and isinstance(pair, SphereOnSurface):
            return SurfaceMotion(pair, X_start, move.direction)
    known = [pair.name for pair in pairs if isinstance(pair, SphereOnSurface)]
    raise ScenarioError(
        f"motion: '{move.contact}' is no contact of type sphere_on_surface; there are {known}"
    )


@dataclass(frozen=True)
class Plan:
    """References at k times, one after the other.

    Attributes:
        X_WD: (k, 7) desired poses: position and quaternion x, y, z, w.
        V_D, A_D: (k, 6) their derivatives, as in `Reference`.
        alpha_d: (k, r) desired magnitudes. squeeze_d: the same at all times.
    """

    X_WD: Array
    V_D: Array
    A_D: Array
    alpha_d: Array
    squeeze_d: float

    def __iter__(self) -> Iterator[Reference]:
        fields = (self.X_WD, self.V_D, self.A_D, self.alpha_d)
        for X, V, A, alpha in zip(*fields, strict=True):
            yield Reference(pin.XYZQUATToSE3(X), V, A, alpha, self.squeeze_d)


@dataclass(frozen=True)
class _Turn:
    """Rotations (3, 3, k) with angular velocities and accelerations (3, k), world axes."""

    R: Array
    omega: Array
    omega_dot: Array

    @classmethod
    def start(cls, count: int) -> _Turn:
        zero = np.zeros((3, count))
        return cls(np.repeat(np.eye(3)[:, :, None], count, axis=2), zero, zero)

    def then(self, axis: Array, s: Array) -> _Turn:
        """Followed by a turn of s[0]·axis about a direction fixed in the world; s (3, k)."""
        along = axis[:, None]
        E = rotations(along * s[0])
        omega = rotated(E, self.omega)
        return _Turn(
            rotated(E, self.R),
            along * s[1] + omega,
            along * s[2] + rotated(E, self.omega_dot) + cross(along * s[1], omega),
        )


def _swung(place: Array, axis: Array, through: Array, s: Array) -> Array:
    """A point's (3, 3, k) position, velocity, acceleration once turned by s (3, k) about an axis
    (3,) through a point (3,) of the world."""
    along = axis[:, None]
    c = through[:, None]
    E = rotations(along * s[0])
    w = along * s[1]
    w_dot = along * s[2]
    arm = rotated(E, place[0] - c)
    rate = rotated(E, place[1])
    bend = rotated(E, place[2])
    velocity = cross(w, arm)
    second = cross(w_dot, arm) + cross(w, velocity) + 2.0 * cross(w, rate) + bend
    return np.array([c + arm, velocity + rate, second])


def _away(tare: TareSpec, t: Array) -> Array:
    """How far off the contacts, 1 → 0, with derivatives: (3, k)."""
    came = total_over([MinimumJerk(value=1.0, start=tare.duration, duration=tare.approach)], t)
    return np.array([[1.0], [0.0], [0.0]]) - came


# The tool follows a surface: references for a ball that moves on it, turned with its normal.


# Fourth-order central differences at the steps −2 … 2.
_STEPS = np.arange(-2.0, 3.0)
_FIRST = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12.0
_SECOND = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / 12.0
_STEP = 2e-3  #: s


class SurfaceMotion:
    """Where the object is while its ball moves on a surface that rests.

    From the start pose the object is turned by the shortest way from the normal there to the normal
    at the foot; its ball touches.

    Attributes:
        axes: (3, 2) of the plane that touches the surface at the start, world.
    """

    def __init__(self, pair: SphereOnSurface, X_start: pin.SE3, direction: npt.ArrayLike) -> None:
        """Take the start.

        Args:
            pair: the contact, its environment frame where the world's is.
            X_start: pose of the object in contact. direction: (3,) roughly the first axis.

        Raises:
            InvalidInputError: the direction is along the normal.
        """
        self._pair = pair
        self._X = X_start
        self._ball = X_start.act(pair.centre)
        _, _, n = pair.nearest(self._ball[:, None])
        self._n = n[:, 0]
        along = as_array("direction", direction, (3,))
        first = along - (along @ self._n) * self._n
        size = norm(first)
        if size < 1e-3 * norm(along) or size == 0.0:
            raise InvalidInputError(
                f"direction = {along} is along the normal of the surface, {self._n.round(4)}; give "
                "one across it"
            )
        self.axes = np.column_stack((first / size, cross(self._n, first / size)))

    def over(self, u: Array) -> tuple[Array, tuple[Array, Array, Array]]:
        """Of the object's origin (3, 3, k) position, velocity, acceleration; of its turn from the

        start R (3, 3, k), ω and ω̇ (3, k). Derivatives are differences along the path itself.

        Args:
            u: (3, 2, k) displacement along the axes, velocity and acceleration (m, s).
        """
        k = u.shape[2]
        s = _STEP * _STEPS[:, None, None]
        path = u[0] + s * u[1] + 0.5 * s * s * u[2]
        path = np.einsum("ij,sjk->isk", self.axes, path).reshape(3, -1)
        _, foot, n = self._pair.nearest(self._ball[:, None] + path)
        R = _shortest(self._n, n)
        arm = self._ball - self._X.translation
        origin = foot + self._pair.radius * n - np.einsum("ijk,j->ik", R, arm)
        place = _derivatives(origin.reshape(3, 5, k))
        turn, first, second = _derivatives(R.reshape(3, 3, 5, k))
        return place, (turn, _odd(first, turn), _odd(second, turn))


def surface_references(
    pair: SphereOnSurface,
    X_start: pin.SE3,
    period: float,
    *,
    direction: npt.ArrayLike,
    force: float | npt.ArrayLike,
    duration: float | None = None,
    **path: Any,
) -> Iterator[Reference]:
    """References for `run_loop`: one each period, the tool following a surface that rests.

    Args:
        pair, X_start: see `SurfaceMotion`. period: of the references (s).
        direction: (3,) roughly the first axis of the path's plane, world.
        force: desired (N), or one for each reference.
        duration: s; default: until the path ends.
        path: keys of a move of kind `surface`: points, raster, signals, feed, dwell, …

    Raises:
        ValueError: keys of the path that do not fit. InvalidInputError: see `SurfaceMotion`.
    """
    motion = SurfaceMotion(pair, X_start, direction)
    move = SurfaceMove(contact=pair.name, direction=direction, **path)
    t = np.arange(0.0, move.duration if duration is None else duration, period)
    place, (R, omega, omega_dot) = motion.over(move.over(t))
    alpha = np.broadcast_to(np.asarray(force, dtype=float), t.shape)
    R = rotated(R, np.repeat(X_start.rotation[:, :, None], len(t), axis=2))
    for i in range(len(t)):
        V = np.concatenate((place[1, :, i], omega[:, i]))
        A = np.concatenate((place[2, :, i], omega_dot[:, i]))
        yield Reference(pin.SE3(R[:, :, i], place[0, :, i]), V, A, alpha[i : i + 1])


def _derivatives(x: Array) -> Array:
    """(3, …, k) values, first and second derivatives from (…, 5, k) values at the steps."""
    first = np.einsum("s,...sk->...k", _FIRST, x) / _STEP
    second = np.einsum("s,...sk->...k", _SECOND, x) / _STEP**2
    return np.array([x[..., 2, :], first, second])


def _odd(rate: Array, R: Array) -> Array:
    """(3, k) the vector of the odd part of rate Rᵀ: ω of Ṙ, ω̇ of R̈."""
    A = np.einsum("ijk,ljk->ilk", rate, R)
    return 0.5 * np.array([A[2, 1] - A[1, 2], A[0, 2] - A[2, 0], A[1, 0] - A[0, 1]])


def _shortest(start: Array, n: Array) -> Array:
    """(3, 3, k) the shortest turns from a unit vector (3,) to others (3, k)."""
    a = cross(start[:, None], n)
    c = start @ n
    R = np.einsum("ik,jk->ijk", a, a) / (1.0 + c) + c * np.eye(3)[:, :, None]
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        R[i, j] -= a[k]
        R[j, i] += a[k]
    return R
