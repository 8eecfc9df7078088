"""What the controller is asked to do at time t, from a scenario's signals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from osc_contact.contacts.pairs import ContactPair
from osc_contact.contacts.unilateral import pushes_only
from osc_contact.errors import ScenarioError
from osc_contact.interface import Reference
from osc_contact.scenarios.schema import Scenario, TareSpec
from osc_contact.scenarios.signals import MinimumJerk, Step, total
from osc_contact.scenarios.touching import MAGNITUDES, magnitude_names
from osc_contact.spatial import Array, cross

__all__ = ["References", "common_tangent", "force_names", "force_owners", "force_steps"]


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
    return magnitude_names({c.name: MAGNITUDES[c.type] for c in scenario.contacts})


def force_owners(scenario: Scenario) -> tuple[int, ...]:
    """The contact of each force magnitude."""
    owners = [i for i, c in enumerate(scenario.contacts) for _ in range(MAGNITUDES[c.type])]
    return tuple(owners)


def force_steps(scenario: Scenario) -> list[float]:
    """Times at which a desired contact force jumps (s); forces are not judged just after them."""
    steps = {
        float(signal.start)
        for signals in scenario.force.values()
        for signal in signals
        if isinstance(signal, Step)
    }
    return sorted(steps)


@dataclass(frozen=True)
class References:
    """Reference signals of one run.

    Attributes:
        scenario: source of the signals.
        X_start: pose of the object in contact at t = 0.
        directions: (3,) of each move, resolved.
        standoff: (6,) displacement off the contacts during the tare phase (zero: none).
    """

    scenario: Scenario
    X_start: pin.SE3
    directions: tuple[Array, ...]
    standoff: Array

    @classmethod
    def of(
        cls,
        scenario: Scenario,
        X_start: pin.SE3,
        pairs: Sequence[ContactPair],
        standoff: Array,
    ) -> References:
        """Resolve `common_tangent` and check that no face is asked to pull.

        Raises:
            ScenarioError: see `common_tangent`; or a desired force is negative at some time.
        """
        directions = tuple(
            common_tangent(pairs, X_start) if move.direction == "common_tangent"
            else np.array(move.direction, dtype=float)
            for move in scenario.motion
        )  # fmt: skip
        names = force_names(scenario)
        references = cls(scenario, X_start, directions, standoff)
        pushes = [pushes_only(p) for p, c in zip(pairs, scenario.contacts, strict=True)
                  for _ in range(MAGNITUDES[c.type])]  # fmt: skip
        for t in np.linspace(0.0, scenario.duration, 2000):
            for name, pushing, force in zip(names, pushes, references._forces(t), strict=True):
                if pushing and force < 0.0:
                    raise ScenarioError(
                        f"force.{name} asks for {force:.3g} N at t = {t:.3g} s; this contact "
                        "cannot pull. Raise the constant part or lower the amplitude."
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
        p, v, a = np.zeros(3), np.zeros(3), np.zeros(3)
        turn = _Turn()
        for move, direction in zip(self.scenario.motion, self.directions, strict=True):
            s, ds, dds = total(move.signals, t)
            if move.kind == "linear":
                p, v, a = p + direction * s, v + direction * ds, a + direction * dds
            else:
                turn = turn.then(direction, s, ds, dds)
        if self.scenario.tare is not None:
            s, ds, dds = _away(self.scenario.tare, t)
            shift = self.standoff[:3]
            p, v, a = p + shift * s, v + shift * ds, a + shift * dds
            turn = turn.then(self.standoff[3:], s, ds, dds)
        X = pin.SE3(turn.R @ self.X_start.rotation, self.X_start.translation + p)
        return Reference(
            X_WD=X,
            V_D=np.concatenate((v, turn.omega)),
            A_D=np.concatenate((a, turn.omega_dot)),
            alpha_d=self._forces(t),
            squeeze_d=float(self.scenario.squeeze),
        )

    def _forces(self, t: float) -> Array:
        signals = self.scenario.force
        return np.array([total(signals[name], t)[0] for name in force_names(self.scenario)])


@dataclass(frozen=True)
class _Turn:
    """A rotation with its angular velocity and acceleration, world axes."""

    R: Array = field(default_factory=lambda: np.eye(3))
    omega: Array = field(default_factory=lambda: np.zeros(3))
    omega_dot: Array = field(default_factory=lambda: np.zeros(3))

    def then(self, axis: Array, s: float, ds: float, dds: float) -> _Turn:
        """Followed by a turn of s·axis about a direction fixed in the world."""
        E = pin.exp3(axis * s)
        omega = E @ self.omega
        return _Turn(
            E @ self.R,
            axis * ds + omega,
            axis * dds + E @ self.omega_dot + cross(axis * ds, omega),
        )


def _away(tare: TareSpec, t: float) -> tuple[float, float, float]:
    """How far off the contacts, 1 → 0, with derivatives."""
    came = MinimumJerk(value=1.0, start=tare.duration, duration=tare.approach).at(t)
    return 1.0 - came[0], -came[1], -came[2]
