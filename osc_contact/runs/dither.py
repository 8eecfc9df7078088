"""A bounded motion that shows the normals of contacts, and how well forces are known without it.

The force ±s u between two points of contact, u the line through both, adds nothing to what wrists
read. Only the normals distinguish it from the commanded forces: errors of these along u, of the
standard deviation σ each, leave s uncertain by ασ/√(τ_1² + τ_2²), τ_j the part of u along face j,
and the force on j by |u·n_j| of that. A normal shows where its point slides (`law.contact`).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from osc_contact.contacts.pairs.pair import ContactPair, knows_where_it_slides
from osc_contact.runs.contacts import feet
from osc_contact.scenarios.quantities import Length
from osc_contact.scenarios.signals import Sine, Values, rise
from osc_contact.spatial import Array, norm

if TYPE_CHECKING:
    from osc_contact.dynamics.chain_state import ChainState
    from osc_contact.scenarios.control_schema import Dither


SHOWN_TO = float(np.deg2rad(0.5))  #: rad, of normals after a dither, under all errors of a workcell


def slides(dither: Dither, start: float, t: Array) -> Values:
    """Way along the line (m) at times t (k,), its rate and second derivative.

    A sine that rises within a quarter of the time and fades in the last one.

    Args:
        dither: its settings. start: when it begins (s). t: (k,) times (s).
    """
    quarter = 0.25 * dither.duration
    how = {"amplitude": dither.amplitude, "frequency": dither.frequency}
    s, s_1, s_2 = Sine[Length](type="sine", **how, start=start, ramp=quarter).at(t)
    e, e_1, e_2 = rise(t, start + 3.0 * quarter, quarter)
    return s * (1.0 - e), s_1 * (1.0 - e) - s * e_1, s_2 * (1.0 - e) - 2.0 * s_1 * e_1 - s * e_2


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
        pairs: the contacts. state: of the arms. N: (6, r) of all contacts at O.
    """
    found = opposed(pairs, state)
    if found is None:
        return np.zeros(6)
    u, points, _ = found
    along = np.concatenate((u, np.cross(points.mean(axis=0) - state.X_WO.translation, u)))
    rows = np.column_stack((N, along)).T @ state.S
    mobile = np.linalg.solve(state.S.T @ state.metric @ state.S, rows.T)
    wanted = np.zeros(len(rows))
    wanted[-1] = 1.0
    multipliers = np.linalg.lstsq(rows @ mobile, wanted, rcond=1e-9)[0]
    V: Array = state.S @ (mobile @ multipliers)
    return V if abs(along @ V - 1.0) < 1e-6 else np.zeros(6)


def known_to(pairs: Sequence[ContactPair], state: ChainState, std: float) -> float:
    """Standard deviation of the forces of two points on one another, as a share of their size.

    Args:
        pairs: the contacts. state: of the arms. std: of their normals along the line (rad).
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
