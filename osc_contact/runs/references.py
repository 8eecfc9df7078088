"""What is desired at time t, from a scenario's signals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from osc_contact.contacts.pairs.pair import ContactPair, pushes_only
from osc_contact.contacts.pairs.sphere_on_surface import SphereOnSurface
from osc_contact.errors import ScenarioError
from osc_contact.interface import Reference
from osc_contact.runs.contacts import force_owners
from osc_contact.runs.surface_motion import SurfaceMotion
from osc_contact.scenarios.bodies import forces_of, magnitude_names
from osc_contact.scenarios.control_schema import TareSpec
from osc_contact.scenarios.schema import MotionSpec, Scenario, SurfaceMove
from osc_contact.scenarios.signals import MinimumJerk, Step, total_over
from osc_contact.spatial import Array, Poses, cross, rotated, rotations


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
    """

    scenario: Scenario
    X_start: pin.SE3
    directions: tuple[Array, ...]
    standoff: Array
    surfaces: tuple[SurfaceMotion | None, ...]

    @classmethod
    def of(
        cls,
        scenario: Scenario,
        X_start: pin.SE3,
        pairs: Sequence[ContactPair],
        standoff: Array,
    ) -> References:
        """Resolve `common_tangent` and check that no face is to pull.

        Args:
            scenario: with the signals. X_start: pose of the object at the start.
            pairs: the contacts. standoff: (contacts,) gaps at the start (m).

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
        references = cls(scenario, X_start, directions, standoff, surfaces)
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
