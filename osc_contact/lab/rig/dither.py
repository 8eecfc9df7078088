"""Dither: a bounded motion by which normals of contacts are learned, and its benefit.

Forces ±s u at two contact points, u the unit vector of the line through both, balance: wrists do
not measure s. Only the normals distinguish these forces from the commanded ones. Errors of the
normals along u, with standard deviation σ each, leave s uncertain by ασ/√(τ_1² + τ_2²), where τ_j
is the part of u along face j, and the force on face j by |u·n_j| times that. A normal is
estimated while its contact point slides (`law.normals`).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from osc_contact.contacts.feet import feet
from osc_contact.contacts.pairs.pair import ContactPair, has_known_points
from osc_contact.dynamics.chain_state import ChainState
from osc_contact.jerk_limits import rise
from osc_contact.lab.scenarios.signals import Sine, product
from osc_contact.settings.control import Dither
from osc_contact.settings.quantities import Length
from osc_contact.spatial import Array, norm

_CONSTANT_ONE = np.array([[1.0], [0.0], [0.0]])  #: the constant 1 with its derivatives, (3, 1)
SHOWN_TO = np.deg2rad(0.5)  #: error of normals after a dither with all errors of a workcell (rad)


def slides(dither: Dither, start: float, t: Array) -> Array:
    """Displacement along the line (m) at k times, with its first two derivatives, (3, k).

    The displacement is a sine that rises in the first quarter of the time and fades in the last.

    Args:
        dither: amplitude, frequency and duration.
        start: time of its beginning (s).
        t: (k,) times (s).
    """
    quarter = 0.25 * dither.duration
    sine = Sine[Length](
        amplitude=dither.amplitude, frequency=dither.frequency, start=start, ramp=quarter
    )
    return product(sine.at(t), _CONSTANT_ONE - rise(t, start + 3.0 * quarter, quarter))


def opposed(pairs: Sequence[ContactPair], state: ChainState) -> tuple[Array, Array, Array] | None:
    """Line between the two contact points that are furthest apart.

    Only contacts of one point count.

    Args:
        pairs: contacts.
        state: state of the arms, with the pose of the object.

    Returns:
        Unit vector u (3,) of the line, the two points (2, 3) (m), and their directions of force (2,
        3), in world axes; None: there are no two such points, or they coincide.
    """
    lines_of_force = []  # point and direction of force of each contact with one point
    for pair in pairs:
        if has_known_points(pair):
            points, directions = feet(pair, state.X_WO)
            if len(points) == 1:
                lines_of_force.append((points[0], directions[0]))
    if len(lines_of_force) < 2:
        return None

    def distance(two: tuple[tuple[Array, Array], tuple[Array, Array]]) -> float:
        """Distance of the points of two contacts (m)."""
        (first_point, _), (second_point, _) = two
        return norm(second_point - first_point)

    (first, first_normal), (second, second_normal) = max(
        combinations(lines_of_force, 2), key=distance
    )
    line = second - first
    if norm(line) < 1e-6:
        return None
    u = line / norm(line)
    return u, np.array((first, second)), np.array((first_normal, second_normal))


def showing_twist(pairs: Sequence[ContactPair], state: ChainState, N: Array) -> Array:
    """Twist (6,) of least energy that arms and contacts permit with 1 m/s along a line.

    The line is that between the two contact points furthest apart; the speed is that of the point
    in its middle. The twist is zero if there are no two points, or no motion along the line.

    Args:
        pairs: contacts.
        state: state of the arms.
        N: (6, r) directions of force of all contacts, at O in world axes.
    """
    line = opposed(pairs, state)
    if line is None:
        return np.zeros(6)
    u, points, _ = line
    force = np.concatenate((u, np.cross(points.mean(axis=0) - state.X_WO.translation, u)))
    V = least_motion(state, np.column_stack((N, force)), np.append(np.zeros(N.shape[1]), 1.0))
    return V if abs(force @ V - 1.0) < 1e-6 else np.zeros(6)


def least_motion(state: ChainState, F: Array, power: Array) -> Array:
    """Twist V (6,) of least kinetic energy that the arms permit with FᵀV = power.

    Args:
        state: state of the arms, with S and the metric of the kinetic energy.
        F: (6, k) wrenches.
        power: (k,) power of each wrench (W); least squares if no motion has all of them.
    """
    rows = F.T @ state.S
    mobility = np.linalg.solve(state.S.T @ state.metric @ state.S, rows.T)
    multipliers = np.linalg.lstsq(rows @ mobility, power, rcond=1e-9)[0]
    return state.S @ (mobility @ multipliers)


def known_to(pairs: Sequence[ContactPair], state: ChainState, std: float) -> float:
    """Standard deviation of the forces of two opposed contacts, as a share of these forces.

    It is 0 where `opposed` finds no line.

    Args:
        pairs: contacts.
        state: state of the arms.
        std: standard deviation of their normals along the line between them (rad).
    """
    line = opposed(pairs, state)
    if line is None:
        return 0.0
    u, _, normals = line
    normal_parts = np.abs(normals @ u)
    tangential_parts = np.sqrt(np.maximum(1.0 - normal_parts**2, 0.0))
    return float(normal_parts.max() * std / max(norm(tangential_parts), 1e-3))


def gain_in_words(share: float, std: float) -> str:
    """Sentence on the benefit of a dither; empty if the benefit is small.

    Args:
        share: relative error of the forces for each radian of the normals' error, see `known_to`
            (1/rad).
        std: standard deviation of the normals without a dither (rad).
    """
    if not share * std > 0.01 or std < 2.0 * SHOWN_TO:
        return ""
    return (
        f"two points push on one another, and their forces are known to {share * std:.1%} only; "
        f"control.dither={{}} would show the normals to about {np.rad2deg(SHOWN_TO):.1f} deg, the "
        f"forces to {share * SHOWN_TO:.1%}"
    )
