"""References at time t, from the signals of a scenario."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, combinations
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from osc_contact.contacts.feet import contact_at, feet
from osc_contact.contacts.pairs.pair import ContactPair, knows_where_it_slides
from osc_contact.contacts.pairs.sphere_on_surface import SphereOnSurface
from osc_contact.dynamics.chain_state import ChainState
from osc_contact.errors import InvalidInputError, ScenarioError, brief
from osc_contact.interface import Reference
from osc_contact.jerk_limits import rise
from osc_contact.lab.scenarios.contact_keys import magnitude_names
from osc_contact.lab.scenarios.schema import MotionSpec, Scenario, SurfaceMove
from osc_contact.lab.scenarios.signals import Sine, Step, product, total
from osc_contact.settings.control import Dither
from osc_contact.settings.quantities import Length
from osc_contact.spatial import Array, Poses, as_array, axial, cross, norm, rotated, rotations


def common_tangent(pairs: Sequence[ContactPair], X_WO: pin.SE3) -> Array:
    """The one direction (3,) of translation that every contact permits at X_WO.

    Raises:
        ScenarioError: the contacts leave none, or more than one.
    """
    _, s, Vh = np.linalg.svd(contact_at(pairs, X_WO).N[:3].T)
    rank = np.count_nonzero(s > 1e-6)
    if rank != 2:
        raise ScenarioError(
            f"direction: common_tangent needs contact forces that span a plane; {len(pairs)} "
            f"contacts span {rank} dimension(s). Give the direction as [x, y, z] instead."
        )
    direction = Vh[2]
    return direction * np.sign(direction[np.abs(direction).argmax()])


def force_names(scenario: Scenario) -> list[str]:
    """Names of all force magnitudes, in the order of alpha: ``tip``, ``pad.1``, ``pad.2``, …"""
    return magnitude_names({contact.name: contact.forces for contact in scenario.contacts})


def force_steps(scenario: Scenario) -> list[float]:
    """Times at which a desired contact force jumps (s); forces are not judged just after them.

    Contacts that engage after a tare are such steps, too.
    """
    signals = chain.from_iterable(scenario.force.values())
    steps = {signal.start for signal in signals if isinstance(signal, Step)}
    if scenario.tare is not None and scenario.control.life is None:
        steps.add(scenario.tare.duration + scenario.tare.approach)
    return sorted(steps)


_WHOLE = np.array([[1.0], [0.0], [0.0]])  #: the constant 1, with its derivatives
_AT_ONCE = 1000  #: references that are worked out together
_COMPARED = 100_000  #: ticks whose forces are compared together
_BEGINNING = 3.0  #: times the approach after a tare, until the motion is that of the signals


@dataclass(frozen=True)
class References:
    """Reference signals of one run.

    Attributes:
        scenario: source of the signals.
        X_start: pose of the object in contact at t = 0.
        ways: of each move its direction (3,), or the `SurfaceMotion` that it follows.
        standoff: (6,) displacement off the contacts during the tare phase (zero: none).
        showing: (6,) motion of `control.dither`, at its origin, for each metre along the line.
    """

    scenario: Scenario
    X_start: pin.SE3
    ways: tuple[Any, ...]
    standoff: Array
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
        """Resolve `common_tangent`, and what moves follow.

        Args:
            scenario: scenario with the signals. X_start: pose of the object at the start.
            pairs: the contacts. standoff: (contacts,) gaps at the start (m).
            showing: as an attribute; None: zero.

        Raises:
            ScenarioError: see `common_tangent`; or a move names no contact on a surface.
        """
        ways = tuple(_way(move, pairs, X_start) for move in scenario.motion)
        showing = np.zeros(6) if showing is None else showing
        return cls(scenario, X_start, ways, standoff, showing)

    @property
    def engage_at(self) -> float:
        """Time at which contacts engage (s): after the tare, and after the approach of the motion.

        With contact phases (`control.life`) the controller makes the approach by itself, so that
        contacts engage directly after the tare.
        """
        tare = self.scenario.tare
        if tare is None:
            return 0.0
        if self.scenario.control.life is not None:
            return tare.duration
        return tare.duration + tare.approach

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
        return np.reshape([total(signals[name], t)[0] for name in names], (len(names), len(t)))

    def commands(self, t: Array) -> Array:
        """(r, k) desired magnitudes at times t (k,), 0 of contacts that are not active."""
        forces = self.forces(t)
        active = self.active(t)
        if active is None:
            return forces
        counts = [contact.forces for contact in self.scenario.contacts]
        return forces * np.repeat(active.T, counts, axis=0)

    @cached_property
    def stages(self) -> list[tuple[float, Array]]:
        """Named sets in their order: time (s) from which each is active, and (contacts,) 1 or 0.

        Empty if none are named.
        """
        spans = chain.from_iterable(self.scenario.active.values())
        ends = {end for end in chain.from_iterable(spans) if 0.0 < end < self.scenario.duration}
        times = np.array(sorted({0.0, *ends}))
        active = self.active(times)
        if active is None:
            return []
        changes = np.any(np.diff(active, axis=0), axis=1)
        new = np.flatnonzero(np.concatenate(([True], changes)))
        return [(float(times[k]), active[k]) for k in new]

    def active(self, t: Array) -> Array | None:
        """(k, contacts) which contacts are active at times t (k,), 1 or 0; None: none are named."""
        spans = self.scenario.active
        if not spans:
            return None
        always = ((-np.inf, np.inf),)
        named = [spans.get(contact.name, always) for contact in self.scenario.contacts]
        return np.column_stack(
            [np.any([(t >= begin) & (t < end) for begin, end in own], axis=0) for own in named]
        ).astype(float)

    @cached_property
    def largest_commands(self) -> tuple[float, float]:
        """Largest command of one contact or squeeze in the run, and largest sum of all (N)."""
        arms = len(self.scenario.arms)
        squeezes = abs(self.scenario.squeeze) * np.ones(arms * (arms - 1) // 2)
        ticks = round(self.scenario.duration * self.scenario.control.rate) + 1
        largest = total = 0.0
        for start in range(0, ticks, _COMPARED):
            t = np.arange(start, min(start + _COMPARED, ticks)) / self.scenario.control.rate
            forces = np.abs(self.commands(t))
            largest = max(largest, float(forces.max(initial=0.0)))
            total = max(total, float(forces.sum(axis=0).max()))
        return max(largest, squeezes.max(initial=0.0)), total + squeezes.sum()

    @cached_property
    def overview(self) -> tuple[Array, Plan]:
        """Times (2000,) through the whole run, and the references there."""
        t = np.linspace(0.0, self.scenario.duration, 2000)
        return t, self.over(t)

    def over(self, t: Array) -> Plan:
        """The references at many times t (k,), worked out together."""
        x = np.zeros((3, 3, len(t)))  # displacement, velocity, acceleration by linear moves
        place = np.zeros((3, 3, len(t)))  # of the origin without them
        place[0] = self.X_start.translation[:, None]
        turn = _Turn.start(len(t))
        tare = self.scenario.tare
        begun = _WHOLE  # share of the motion
        twists = []
        if tare is not None:
            begun = np.array(rise(t, self.engage_at, _BEGINNING * tare.approach))
            near = np.array(rise(t, tare.duration, tare.approach))
            twists.append((self.standoff, _WHOLE - near))
        slid = [
            (on, np.einsum("ij,djk->dik", on.axes, product(begun, move.over(t))))
            for on, move in zip(self.ways, self.scenario.motion, strict=True)
            if isinstance(move, SurfaceMove)
        ]
        if slid:
            on = slid[0][0]
            place, turn = on.over(np.einsum("ij,dik->djk", on.axes, sum(x for _, x in slid)))
        for move, direction in zip(self.scenario.motion, self.ways, strict=True):
            if isinstance(move, SurfaceMove):
                continue
            s = product(begun, total(move.signals, t))
            if move.kind == "linear":
                x += direction[:, None] * s[:, None]
            else:
                turn = turn.then(direction, s)
                if move.through is not None:
                    place = _swung(place, direction, np.array(move.through), s)
        if self.scenario.control.dither is not None:
            shown = slides(self.scenario.control.dither, self.engage_at, t)
            twists.append((self.showing, shown))
        for twist, s in twists:
            x += twist[:3, None] * s[:, None]
            turn = turn.then(twist[3:], s)
        plan = Plan.of(place + x, turn, self.X_start, self.forces(t), self.scenario.squeeze)
        return replace(plan, active=self.active(t), commands=self.commands(t).T)


def _way(move: MotionSpec, pairs: Sequence[ContactPair], X_start: pin.SE3) -> Array | SurfaceMotion:
    """The direction (3,) of a move, or the surface that it follows.

    Raises:
        ScenarioError: see `common_tangent`; or it names no contact on a surface.
    """
    if move.direction == "common_tangent":
        return common_tangent(pairs, X_start)
    if not isinstance(move, SurfaceMove):
        return np.array(move.direction)
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
        active: (k, contacts) which contacts are active, 1 or 0; None: none are named.
        commands: (k, r) alpha_d of active contacts, 0 of the others.
    """

    X_WD: Array
    V_D: Array
    A_D: Array
    alpha_d: Array
    squeeze_d: float
    active: Array | None
    commands: Array

    @classmethod
    def of(
        cls, place: Array, turn: _Turn, X_start: pin.SE3, alpha: Array, squeeze: float = 0.0
    ) -> Plan:
        """Make a plan without named contacts from the motion of the object's origin and its turn.

        Args:
            place: (3, 3, k) position, velocity and acceleration of the origin (m, s).
            turn: rotation from X_start. X_start: pose of the object at the start.
            alpha: (r, k) desired forces (N). squeeze: desired internal force (N).
        """
        p, v, a = place
        R = rotated(turn.R, X_start.rotation[:, :, None])
        desired = alpha.T.copy()
        return cls(
            X_WD=Poses(R, p).coordinates(p.shape[1]),
            V_D=np.concatenate((v, turn.omega)).T.copy(),
            A_D=np.concatenate((a, turn.omega_dot)).T.copy(),
            alpha_d=desired,
            squeeze_d=squeeze,
            active=None,
            commands=desired,
        )

    def __iter__(self) -> Iterator[Reference]:
        active = [None] * len(self.X_WD) if self.active is None else self.active
        fields = (self.X_WD, self.V_D, self.A_D, self.alpha_d, active)
        for X, V, A, alpha, here in zip(*fields, strict=True):
            yield Reference(pin.XYZQUATToSE3(X), V, A, alpha, self.squeeze_d, here)


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
        angle, rate, second = axis[:, None] * s[:, None]
        E = rotations(angle)
        omega = rotated(E, self.omega)
        omega_dot = second + rotated(E, self.omega_dot) + cross(rate, omega)
        return _Turn(rotated(E, self.R), rate + omega, omega_dot)


def _swung(place: Array, axis: Array, through: Array, s: Array) -> Array:
    """A point's (3, 3, k) position, velocity, acceleration once turned by s (3, k) about an axis
    (3,) through a point (3,) of the world."""
    angle, w, w_dot = axis[:, None] * s[:, None]
    c = through[:, None]
    E = rotations(angle)
    p, v, a = place
    arm = rotated(E, p - c)
    carried = rotated(E, v)
    velocity = cross(w, arm)
    second = cross(w_dot, arm) + cross(w, velocity) + 2.0 * cross(w, carried) + rotated(E, a)
    return np.array([c + arm, velocity + carried, second])


# The tool follows a surface: references for a ball that moves on it, turned with its normal.


# Fourth-order central differences at the steps −2 … 2.
_STEPS = np.arange(-2.0, 3.0)
_FIRST = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12.0
_SECOND = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / 12.0
_STEP = 2e-3  #: s


class SurfaceMotion:
    """Motion of the object while its ball moves on a surface at rest.

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

    def over(self, u: Array) -> tuple[Array, _Turn]:
        """Position, velocity, acceleration (3, 3, k) of the origin; the turn from the start.

        Derivatives are differences along the path itself.

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
        return place, _Turn(turn, _odd(first, turn), _odd(second, turn))


def surface_references(
    pair: ContactPair,
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
        ValueError: keys of the path that do not fit. InvalidInputError: a pair without a curved
            face; see `SurfaceMotion`.
    """
    if not isinstance(pair, SphereOnSurface):
        raise InvalidInputError(
            f"surface_references follows a curved face, and {brief(pair)} has none; give an "
            "osc.SphereOnSurface"
        )
    motion = SurfaceMotion(pair, X_start, direction)
    move = SurfaceMove(contact=pair.name, direction=direction, **path)
    t = np.arange(0.0, move.duration if duration is None else duration, period)
    alpha = np.broadcast_to(np.asarray(force, dtype=float), (1, len(t)))
    yield from Plan.of(*motion.over(move.over(t)), X_start, alpha)


def _derivatives(x: Array) -> Array:
    """(3, …, k) values, first and second derivatives from (…, 5, k) values at the steps."""
    first = np.einsum("s,...sk->...k", _FIRST, x) / _STEP
    second = np.einsum("s,...sk->...k", _SECOND, x) / _STEP**2
    return np.array([x[..., 2, :], first, second])


def _odd(rate: Array, R: Array) -> Array:
    """(3, k) the vector of the odd part of rate Rᵀ: ω of Ṙ, ω̇ of R̈."""
    return 0.5 * axial(np.einsum("ijk,ljk->ilk", rate, R))


def _shortest(start: Array, n: Array) -> Array:
    """(3, 3, k) the shortest turns from a unit vector (3,) to others (3, k)."""
    a = cross(start[:, None], n)
    c = start @ n
    R = np.einsum("ik,jk->ijk", a, a) / (1.0 + c) + c * np.eye(3)[:, :, None]
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        R[i, j] -= a[k]
        R[j, i] += a[k]
    return R


# A bounded motion that shows the normals of contacts, and how well forces are known without it.
#
# The force ±s u between two points of contact, u the line through both, adds nothing to what wrists
# read. Only the normals distinguish it from the commanded forces: errors of these along u, of the
# standard deviation σ each, leave s uncertain by ασ/√(τ_1² + τ_2²), τ_j the part of u along face j,
# and the force on j by |u·n_j| of that. A normal shows where its point slides (`law.normals`).

SHOWN_TO = np.deg2rad(0.5)  #: rad, of normals after a dither, under all errors of a workcell


def slides(dither: Dither, start: float, t: Array) -> Array:
    """(3, k) way along the line (m) at times t (k,), its rate and second derivative.

    A sine that rises within a quarter of the time and fades in the last one.

    Args:
        dither: its settings. start: when it begins (s). t: (k,) times (s).
    """
    quarter = 0.25 * dither.duration
    sine = Sine[Length](
        amplitude=dither.amplitude, frequency=dither.frequency, start=start, ramp=quarter
    )
    return product(sine.at(t), _WHOLE - rise(t, start + 3.0 * quarter, quarter))


def opposed(pairs: Sequence[ContactPair], state: ChainState) -> tuple[Array, Array, Array] | None:
    """Line u (3,) between the two points furthest apart, the points (2, 3), normals (2, 3).

    Only contacts of one point count; None: there are not two of them.
    """
    single = [pair for pair in pairs if knows_where_it_slides(pair)]
    found = [(p[0], n[0]) for p, n in (feet(pair, state.X_WO) for pair in single) if len(p) == 1]
    if len(found) < 2:
        return None
    a, b = max(combinations(found, 2), key=lambda two: norm(two[1][0] - two[0][0]))
    line = b[0] - a[0]
    if norm(line) < 1e-6:
        return None
    return line / norm(line), np.array((a[0], b[0])), np.array((a[1], b[1]))


def showing_twist(pairs: Sequence[ContactPair], state: ChainState, N: Array) -> Array:
    """(6,) the motion of least energy that arms and contacts permit along the line, 1 m/s there.

    Zero where there is no line between two points, or where nothing can slide along it.

    Args:
        pairs: the contacts. state: state of the arms. N: (6, r) of all contacts at O.
    """
    found = opposed(pairs, state)
    if found is None:
        return np.zeros(6)
    u, points, _ = found
    along = np.concatenate((u, np.cross(points.mean(axis=0) - state.X_WO.translation, u)))
    V = least_motion(state, np.column_stack((N, along)), np.append(np.zeros(N.shape[1]), 1.0))
    return V if abs(along @ V - 1.0) < 1e-6 else np.zeros(6)


def least_motion(state: ChainState, F: Array, power: Array) -> Array:
    """(6,) the motion of least kinetic energy that the arms permit with Fᵀ × it = power.

    Args:
        state: state of the arms. F: (6, k) wrenches. power: (k,) of each; least squares where no
            motion has them all.
    """
    rows = F.T @ state.S
    mobile = np.linalg.solve(state.S.T @ state.metric @ state.S, rows.T)
    multipliers = np.linalg.lstsq(rows @ mobile, power, rcond=1e-9)[0]
    return state.S @ (mobile @ multipliers)


def known_to(pairs: Sequence[ContactPair], state: ChainState, std: float) -> float:
    """Standard deviation of the forces of two points on one another, as a share of their size.

    Args:
        pairs: the contacts. state: state of the arms. std: of their normals along the line (rad).
    """
    found = opposed(pairs, state)
    if found is None:
        return 0.0
    u, _, normals = found
    along = np.abs(normals @ u)
    left = np.sqrt(np.maximum(1.0 - along**2, 0.0))
    return float(along.max() * std / max(norm(left), 1e-3))


def gain_in_words(share: float, std: float) -> str:
    """What a dither would bring; empty where it is not worth it.

    Args:
        share: of the forces, for each rad of the normals, see `known_to`. std: of the normals now.
    """
    if not share * std > 0.01 or std < 2.0 * SHOWN_TO:
        return ""
    return (
        f"two points push on one another, and their forces are known to {share * std:.1%} only; "
        f"control.dither={{}} would show the normals to about {np.rad2deg(SHOWN_TO):.1f} deg, the "
        f"forces to {share * SHOWN_TO:.1%}"
    )
