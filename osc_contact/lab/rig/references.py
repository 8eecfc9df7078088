"""References of a run at any time, from the signals of a scenario."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from osc_contact.contacts.feet import contact_at
from osc_contact.contacts.pairs.pair import ContactPair
from osc_contact.contacts.pairs.sphere_on_surface import SphereOnSurface
from osc_contact.errors import InvalidInputError, ScenarioError, brief
from osc_contact.interface import Reference
from osc_contact.jerk_limits import rise
from osc_contact.lab.rig.dither import slides
from osc_contact.lab.scenarios.contact_keys import magnitude_names
from osc_contact.lab.scenarios.schema import MotionSpec, Scenario, SurfaceMove
from osc_contact.lab.scenarios.signals import Step, product, total
from osc_contact.plan.sensed import forces_of
from osc_contact.spatial import Array, Poses, as_array, axial, cross, norm, rotated, rotations


def common_tangent(pairs: Sequence[ContactPair], X_WO: pin.SE3) -> Array:
    """Direction (3,) of the only translation that all contacts permit, a unit vector.

    The largest component of the direction is positive.

    Args:
        pairs: contacts.
        X_WO: pose of the object in contact.

    Raises:
        ScenarioError: the contacts permit no translation, or several.
    """
    _, singular_values, Vh = np.linalg.svd(contact_at(pairs, X_WO).N[:3].T)
    rank = np.count_nonzero(singular_values > 1e-6)
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
    """Times at which a desired contact force jumps (s), in order; forces settle after them.

    Without contact phases (`control.life`) the engagement of contacts after a tare is such a step,
    too: all desired forces begin at once. With phases a force begins when its contact closes, which
    the run decides.

    Args:
        scenario: scenario with the signals of its forces.
    """
    signals = chain.from_iterable(scenario.force.values())
    steps = {signal.start for signal in signals if isinstance(signal, Step)}
    if scenario.tare is not None and scenario.control.life is None:
        steps.add(scenario.tare.duration + scenario.tare.approach)
    return sorted(steps)


def require_known_times(scenario: Scenario, use: str) -> None:
    """Refuse a plan where the references of all times are needed before a run.

    Args:
        scenario: scenario of the run.
        use: purpose that needs them, such as "a page", for the message.

    Raises:
        ScenarioError: the scenario has a plan.
    """
    if scenario.plan is not None:
        raise ScenarioError(
            f"plan: {use} needs the references of all times, which a plan gives in the run only; "
            "run the scenario, or give force and motion in place of plan"
        )


_CONSTANT_ONE = np.array([[1.0], [0.0], [0.0]])  #: the constant 1 with its derivatives, (3, 1)
_CHUNK_OF_REFERENCES = 1000  #: number of references that are computed together
_COMPARED = 100_000  #: number of ticks whose forces are compared together
#: Time in which the motion rises to that of the signals after a tare, over the approach's time.
_RISE_OVER_APPROACH = 3.0


@dataclass(frozen=True)
class References:
    """Reference signals of one run.

    Attributes:
        scenario: source of the signals.
        X_start: pose of the object in contact at t = 0.
        ways: for each move its direction (3,), or the `SurfaceMotion` that it follows.
        standoff: (6,) displacement of the object off the contacts during the tare (m, rad), at O in
            world axes; zero without a tare.
        showing: (6,) twist of `control.dither` at O for a speed of 1 m/s along the line between two
            contacts (1, rad/m).
    """

    scenario: Scenario
    X_start: pin.SE3
    ways: tuple[Array | SurfaceMotion, ...]
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
        """Make the references of a scenario; resolve directions and surfaces of its moves.

        Args:
            scenario: scenario with the signals.
            X_start: pose of the object in contact.
            pairs: contacts.
            standoff: (6,) displacement off the contacts during the tare (m, rad).
            showing: (6,) twist of `control.dither`; None: zero.

        Raises:
            ScenarioError: `common_tangent` is not unique, or a move names no contact on a surface.
        """
        ways = tuple(_way_of_move(move, pairs, X_start) for move in scenario.motion)
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
        """Reference at time t (s); its accelerations are classical."""
        return next(iter(self.over(np.array([t]))))

    def each(self, ticks: int, period: float) -> Iterator[Reference]:
        """Yield the references of successive ticks, from t = 0 on.

        Args:
            ticks: number of references.
            period: time between them (s).
        """
        for start in range(0, ticks, _CHUNK_OF_REFERENCES):
            yield from self.over(
                np.arange(start, min(start + _CHUNK_OF_REFERENCES, ticks)) * period
            )

    def forces(self, t: Array) -> Array:
        """Desired forces (r, k) at times t (k,) (s), in N; with a plan those of its stages."""
        if self.planned is not None:
            return self.planned[0][self._stage_at(t)].T
        names = force_names(self.scenario)
        signals = self.scenario.force
        magnitudes = [total(signals[name], t)[0] for name in names]
        return np.reshape(magnitudes, (len(names), len(t)))

    @cached_property
    def planned(self) -> tuple[Array, Array] | None:
        """Forces (k, r) of the stages of a plan (N), and their active contacts (k, contacts).

        For the checks before a run, the k stages share its duration evenly.
        """
        plan = self.scenario.plan
        if plan is None:
            return None
        contacts = self.scenario.contacts
        names = [contact.name for contact in contacts]
        owners = np.repeat(np.arange(len(contacts)), [contact.forces for contact in contacts])
        rows = [forces_of(stage.forces, names, owners) for stage in plan.made().stages]
        alpha_d, active = zip(*rows, strict=True)
        return np.array(alpha_d), np.array(active)

    def _stage_at(self, t: Array) -> npt.NDArray[np.intp]:
        """Indices (k,) of the stages of the plan at times t (k,) (s), which share the duration."""
        assert self.planned is not None
        count = len(self.planned[0])
        return np.clip((t * count / self.scenario.duration).astype(np.intp), 0, count - 1)

    def commands(self, t: Array) -> Array:
        """Desired force magnitudes (r, k) at times t (k,) (s), 0 for inactive contacts (N)."""
        forces = self.forces(t)
        active = self.active(t)
        if active is None:
            return forces
        counts = [contact.forces for contact in self.scenario.contacts]
        return forces * np.repeat(active.T, counts, axis=0)

    @cached_property
    def stages(self) -> list[tuple[float, Array]]:
        """Sets of active contacts in the order of time: of the key `active`, or of a plan's stages.

        Returns:
            For each set the time (s) from which it is active, and (contacts,) 1 for an active
            contact, else 0. Empty if the scenario does not name active contacts.
        """
        if self.planned is not None:
            active_sets = self.planned[1]
            length = self.scenario.duration / len(active_sets)
            return [(k * length, active) for k, active in enumerate(active_sets)]
        spans = chain.from_iterable(self.scenario.active.values())
        ends = {end for end in chain.from_iterable(spans) if 0.0 < end < self.scenario.duration}
        times = np.array(sorted({0.0, *ends}))
        active = self.active(times)
        if active is None:
            return []
        changes = np.any(np.diff(active, axis=0), axis=1)
        beginnings = np.flatnonzero(np.concatenate(([True], changes)))
        return [(float(times[k]), active[k]) for k in beginnings]

    def active(self, t: Array) -> Array | None:
        """Matrix (k, contacts) with 1 for contacts that are active at times t (k,) (s), else 0.

        With a plan they are those of its stages (`planned`). None: the scenario has no plan and
        states no times, so that all contacts are active.
        """
        if self.planned is not None:  # active sets (stages, contacts) of the plan's stages
            return self.planned[1][self._stage_at(t)]
        spans = self.scenario.active
        if not spans:
            return None
        always = ((-np.inf, np.inf),)
        columns = []
        for contact in self.scenario.contacts:
            contact_spans = spans.get(contact.name, always)
            in_spans = [(t >= begin) & (t < end) for begin, end in contact_spans]
            columns.append(np.any(in_spans, axis=0))
        return np.column_stack(columns).astype(float)

    @cached_property
    def largest_commands(self) -> tuple[float, float]:
        """Largest commanded force of one contact or squeeze, and largest sum of all of them (N).

        The commands of all ticks of the run are compared, in pieces of `_COMPARED` ticks.
        """
        arms = len(self.scenario.arms)
        pairs_of_arms = arms * (arms - 1) // 2
        squeezes = abs(self.scenario.squeeze) * np.ones(pairs_of_arms)
        ticks = round(self.scenario.duration * self.scenario.control.rate) + 1
        largest = 0.0
        largest_sum = 0.0
        for start in range(0, ticks, _COMPARED):
            t = np.arange(start, min(start + _COMPARED, ticks)) / self.scenario.control.rate
            forces = np.abs(self.commands(t))
            largest = max(largest, float(forces.max(initial=0.0)))
            largest_sum = max(largest_sum, float(forces.sum(axis=0).max()))
        return max(largest, squeezes.max(initial=0.0)), largest_sum + squeezes.sum()

    @cached_property
    def overview(self) -> tuple[Array, Plan]:
        """Times (2000,) through the whole run (s), and the references at these times."""
        t = np.linspace(0.0, self.scenario.duration, 2000)
        return t, self.over(t)

    def over(self, t: Array) -> Plan:
        """References at many times, computed together.

        Signals s are (3, k): values, first and second derivatives at the k times. The motion begins
        smoothly after a tare; moves on a surface come first, then rotations in the scenario's
        order, then displacements off the contacts and by a dither.

        Args:
            t: (k,) times (s).
        """
        tare = self.scenario.tare
        dither = self.scenario.control.dither
        share = _CONSTANT_ONE  # share of the motion that has begun
        twists = []  # displacements (6,) with their signals (3, k)
        if tare is not None:
            share = np.array(rise(t, self.engage_at, _RISE_OVER_APPROACH * tare.approach))
            nearness = np.array(rise(t, tare.duration, tare.approach))
            twists.append((self.standoff, _CONSTANT_ONE - nearness))
        if dither is not None:
            twists.append((self.showing, slides(dither, self.engage_at, t)))
        origin, turn = self._on_surface(t, share)
        displacement = np.zeros((3, 3, len(t)))  # of the origin by linear moves, as `origin`
        for move, direction in zip(self.scenario.motion, self.ways, strict=True):
            if isinstance(move, SurfaceMove) or isinstance(direction, SurfaceMotion):
                continue
            s = product(share, total(move.signals, t))
            if move.kind == "linear":
                displacement += direction[:, None] * s[:, None]
            else:
                turn = turn.then(direction, s)
                if move.through is not None:
                    origin = _carried_by_rotation(origin, direction, np.array(move.through), s)
        for twist, s in twists:
            displacement += twist[:3, None] * s[:, None]
            turn = turn.then(twist[3:], s)
        place = origin + displacement
        plan = Plan.of(place, turn, self.X_start, self.forces(t), self.scenario.squeeze)
        return replace(plan, active=self.active(t), commands=self.commands(t).T)

    def _on_surface(self, t: Array, share: Array) -> tuple[Array, _Turn]:
        """Motion of the origin and rotation of the object by the moves on a surface.

        The displacements of all such moves are added in the tangential plane at the start.

        Args:
            t: (k,) times (s).
            share: (3, k) or (3, 1) share of the motion that has begun, with its derivatives.

        Returns:
            Position, velocity and acceleration (3, 3, k) of the origin (m, s), and the rotation
            from the start; at rest if there are no moves on a surface.
        """
        surface: SurfaceMotion | None = None
        displacements = []  # (3, 3, k) derivative, axis of the world, time
        for motion, move in zip(self.ways, self.scenario.motion, strict=True):
            if isinstance(move, SurfaceMove) and isinstance(motion, SurfaceMotion):
                u = product(share, move.over(t))
                displacements.append(np.einsum("ij,djk->dik", motion.axes, u))
                surface = motion if surface is None else surface
        if surface is not None:
            return surface.over(np.einsum("ij,dik->djk", surface.axes, sum(displacements)))
        at_rest = np.zeros((3, 3, len(t)))
        at_rest[0] = self.X_start.translation[:, None]
        return at_rest, _Turn.start(len(t))


def _way_of_move(
    move: MotionSpec, pairs: Sequence[ContactPair], X_start: pin.SE3
) -> Array | SurfaceMotion:
    """Direction (3,) of a move, or the surface that it follows.

    Args:
        move: move of a scenario.
        pairs: contacts.
        X_start: pose of the object in contact.

    Raises:
        ScenarioError: `common_tangent` is not unique, or the move names no contact on a surface.
    """
    if move.direction == "common_tangent":
        return common_tangent(pairs, X_start)
    if not isinstance(move, SurfaceMove):
        return np.array(move.direction)
    for pair in pairs:
        if pair.name == move.contact and isinstance(pair, SphereOnSurface):
            return SurfaceMotion(pair, X_start, move.direction)
    surfaces = [pair.name for pair in pairs if isinstance(pair, SphereOnSurface)]
    raise ScenarioError(
        f"motion: '{move.contact}' is no contact of type sphere_on_surface; there are {surfaces}"
    )


@dataclass(frozen=True)
class Plan:
    """References at k successive times.

    Attributes:
        X_WD: (k, 7) desired poses: position (m) and quaternion x, y, z, w.
        V_D, A_D: (k, 6) desired twists and classical accelerations at O, world axes (m, rad, s).
        alpha_d: (k, r) desired force magnitudes (N).
        squeeze_d: desired internal force at all times (N).
        active: (k, contacts) 1 for active contacts, else 0; None: the scenario names none.
        commands: (k, r) alpha_d of active contacts, 0 of the others (N).
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
            turn: rotation from the start, with its derivatives.
            X_start: pose of the object at the start.
            alpha: (r, k) desired forces (N).
            squeeze: desired internal force (N).
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
        """Yield the references in the order of their times."""
        active = [None] * len(self.X_WD) if self.active is None else self.active
        fields = (self.X_WD, self.V_D, self.A_D, self.alpha_d, active)
        for X, V, A, alpha, active_now in zip(*fields, strict=True):
            yield Reference(pin.XYZQUATToSE3(X), V, A, alpha, self.squeeze_d, active_now)


@dataclass(frozen=True)
class _Turn:
    """Rotation of the object from the start at k times.

    Attributes:
        R: (3, 3, k) rotation matrices, world axes.
        omega: (3, k) angular velocities (rad/s).
        omega_dot: (3, k) angular accelerations (rad/s²).
    """

    R: Array
    omega: Array
    omega_dot: Array

    @classmethod
    def start(cls, count: int) -> _Turn:
        """Make the rotation of an object at rest in its initial orientation, at some times."""
        zero = np.zeros((3, count))
        return cls(np.repeat(np.eye(3)[:, :, None], count, axis=2), zero, zero)

    def then(self, axis: Array, s: Array) -> _Turn:
        """Compose this rotation with a later one about an axis that is fixed in the world.

        R = E R₁, ω = ω₂ + E ω₁, ω̇ = ω̇₂ + E ω̇₁ + ω₂ × E ω₁.

        Args:
            axis: (3,) axis in world axes, times the angle for s[0] = 1 (rad).
            s: (3, k) factor of the angle, with first and second derivative (s).
        """
        angle, rate, acceleration = axis[:, None] * s[:, None]
        E = rotations(angle)
        omega = rotated(E, self.omega)
        omega_dot = acceleration + rotated(E, self.omega_dot) + cross(rate, omega)
        return _Turn(rotated(E, self.R), rate + omega, omega_dot)


def _carried_by_rotation(place: Array, axis: Array, through: Array, s: Array) -> Array:
    """Motion of a point that is carried by a rotation about an axis fixed in the world.

    Args:
        place: (3, 3, k) position, velocity and acceleration of the point without the rotation (m,
            s).
        axis: (3,) axis of unit length, world axes.
        through: (3,) point on the axis (m).
        s: (3, k) angle about the axis with first and second derivative (rad, s).

    Returns:
        (3, 3, k) position, velocity and acceleration of the point (m, s).
    """
    angle, w, w_dot = axis[:, None] * s[:, None]
    centre = through[:, None]
    E = rotations(angle)
    p, v, a = place
    lever = rotated(E, p - centre)
    relative = rotated(E, v)
    velocity = cross(w, lever)
    coriolis = 2.0 * cross(w, relative)
    acceleration = cross(w_dot, lever) + cross(w, velocity) + coriolis + rotated(E, a)
    return np.array([centre + lever, velocity + relative, acceleration])


# The tool follows a surface: references for a ball that moves on it, rotated with its normal.


# Fourth-order central differences at the steps −2 … 2.
_DIFFERENCE_PLACES = np.arange(-2.0, 3.0)
_FIRST_WEIGHTS = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12.0  #: weights of the first derivative
#: Weights of the second derivative.
_SECOND_WEIGHTS = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / 12.0
_DIFFERENCE_STEP = 2e-3  #: length of a step (s)


class SurfaceMotion:
    """Motion of the object while its ball moves on a surface at rest.

    The ball touches the surface, and the object is rotated from its pose at the start by the
    shortest rotation from the normal at the start to the normal at the contact point.

    Attributes:
        axes: (3, 2) unit vectors of the tangential plane at the start, world axes.
    """

    def __init__(self, pair: SphereOnSurface, X_start: pin.SE3, direction: npt.ArrayLike) -> None:
        """Set the surface and the pose at the start, and choose the axes of the tangential plane.

        Args:
            pair: contact of a ball with the surface; its environment frame coincides with the
                world.
            X_start: pose of the object in contact.
            direction: (3,) vector whose tangential part is the first axis.

        Raises:
            InvalidInputError: the direction is along the normal.
        """
        self._pair = pair  #: contact of the ball with the surface
        self._X = X_start  #: pose of the object at the start
        self._ball = X_start.act(pair.centre)  #: (3,) centre of the ball at the start, world (m)
        _, _, normals = pair.nearest(self._ball[:, None])
        self._normal = normals[:, 0]  #: (3,) normal of the surface there, world
        requested = as_array("direction", direction, (3,))
        tangent = requested - (requested @ self._normal) * self._normal
        size = norm(tangent)
        if size < 1e-3 * norm(requested) or size == 0.0:
            raise InvalidInputError(
                f"direction = {requested} is along the normal of the surface, "
                f"{self._normal.round(4)}; give one across it"
            )
        self.axes = np.column_stack((tangent / size, cross(self._normal, tangent / size)))

    def over(self, u: Array) -> tuple[Array, _Turn]:
        """Motion of the object's origin and rotation of the object at k times.

        Derivatives are differences of five poses along the path, at times around each of the k
        times.

        Args:
            u: (3, 2, k) displacement of the ball along the axes, velocity, acceleration (m, s).

        Returns:
            Position, velocity and acceleration (3, 3, k) of the origin (m, s), and the rotation
            from the start.
        """
        k = u.shape[2]
        step = _DIFFERENCE_STEP * _DIFFERENCE_PLACES[:, None, None]
        path = u[0] + step * u[1] + 0.5 * step * step * u[2]  # (5, 2, k)
        displacement = np.einsum("ij,sjk->isk", self.axes, path).reshape(3, -1)
        _, foot, normals = self._pair.nearest(self._ball[:, None] + displacement)
        R = _shortest_rotations(self._normal, normals)
        lever = self._ball - self._X.translation
        origin = foot + self._pair.radius * normals - np.einsum("ijk,j->ik", R, lever)
        place = _derivatives(origin.reshape(3, 5, k))
        turn, R_dot, R_ddot = _derivatives(R.reshape(3, 3, 5, k))
        return place, _Turn(turn, _axial_of_rate(R_dot, turn), _axial_of_rate(R_ddot, turn))


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
    """Yield references for `run_loop`, by which the tool follows a surface at rest.

    Args:
        pair: contact of a ball with the surface; its environment frame coincides with the world.
        X_start: pose of the object in contact.
        period: time between references (s).
        direction: (3,) vector whose tangential part is the first axis of the path's plane, world
            axes.
        force: desired contact force (N), or one for each reference.
        duration: duration of the references (s); None: until the path ends.
        path: keys of a move of kind `surface`: points, raster, signals, feed, dwell, …

    Raises:
        ValueError: keys of the path contradict one another.
        InvalidInputError: a pair without a curved face, or a direction along the normal.
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
    """Values x, first and second time derivatives at t, by central differences of fourth order.

    Args:
        x: (…, 5, k) values at five times around each of k times t: t − 2δ, t − δ, t, t + δ and t +
            2δ, with δ = `_DIFFERENCE_STEP` (s).

    Returns:
        (3, …, k): x, ẋ, ẍ.
    """
    first = np.einsum("s,...sk->...k", _FIRST_WEIGHTS, x) / _DIFFERENCE_STEP
    second = np.einsum("s,...sk->...k", _SECOND_WEIGHTS, x) / _DIFFERENCE_STEP**2
    return np.array([x[..., 2, :], first, second])


def _axial_of_rate(rate: Array, R: Array) -> Array:
    """Vector (3, k) of the skew-symmetric part of Ṙ Rᵀ, which is ω, or of R̈ Rᵀ, which is ω̇.

    Args:
        rate: (3, 3, k) first or second derivative of R.
        R: (3, 3, k) rotation matrices.
    """
    return 0.5 * axial(np.einsum("ijk,ljk->ilk", rate, R))


def _shortest_rotations(start: Array, n: Array) -> Array:
    """Matrices (3, 3, k) of the shortest rotations from a unit vector to others.

    R = c 1 + [a]× + a aᵀ/(1 + c) with a = start × n and c = startᵀn.

    Args:
        start: (3,) unit vector.
        n: (3, k) unit vectors, none opposite to it.
    """
    a = cross(start[:, None], n)
    c = start @ n
    R = np.einsum("ik,jk->ijk", a, a) / (1.0 + c) + c * np.eye(3)[:, :, None]
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):  # the matrix [a]×
        R[i, j] -= a[k]
        R[j, i] += a[k]
    return R
