"""The best constraint frame each selection law can be given, by the cross-talk it predicts.

What is minimised is ‖m G_f M⁻¹‖² + ‖G_m K⁻¹/m‖² (see `coupling`), over six frame parameters (nine
with two triads) and over all selections of r out of the six axes, by Levenberg–Marquardt steps
from the frame of `as_raibert_craig` and from seeded random ones. Frames with which control of
force or motion would be lost do not count.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import pinocchio as pin

from osc_contact.contacts.raibert_craig import Triple, as_raibert_craig
from osc_contact.errors import ContactError
from osc_contact.spatial import Array
from paper.baselines.coupling import Instant
from paper.baselines.laws import Baseline, SelectionLaw
from paper.baselines.selection import Selection

__all__ = ["best_frames", "best_selection", "random_selection"]

_STEPS = 40


def best_selection(
    instant: Instant, baseline: Baseline, *, restarts: int = 4, seed: int = 0
) -> SelectionLaw:
    """The law with the selection of least cost.

    Args:
        instant, baseline, restarts, seed: see `best_frames`.

    Raises:
        ContactError: with no selection does the law keep control of forces and motions.
    """
    found = best_frames(instant, baseline, restarts=restarts, seed=seed)
    return min(found, key=lambda law: instant.coupling(law).cost)


def best_frames(
    instant: Instant, baseline: Baseline, *, restarts: int = 4, seed: int = 0
) -> list[SelectionLaw]:
    """For each selection of r out of six axes with which control is kept, the law of least cost.

    Args:
        instant: for which it is optimal.
        baseline: family of laws.
        restarts: random starts for each selection of axes, besides that of `as_raibert_craig`.
        seed: of the random starts.

    Raises:
        ContactError: there is none.
    """
    rng = np.random.default_rng(seed)
    start = as_raibert_craig(instant.contact.N, instant.size).frame
    best = []
    for chosen in combinations(range(6), instant.contact.r):
        forces, couples = _flags(chosen)
        first = Selection.of_frame(start, forces, couples)
        others = [
            random_selection(instant, baseline, rng, forces, couples) for _ in range(restarts)
        ]
        found = [_descend(instant, SelectionLaw(baseline, one)) for one in (first, *others)]
        law, cost = min(found, key=lambda one: one[1])
        if np.isfinite(cost):
            best.append(law)
    if not best:
        raise ContactError("no constraint frame keeps control of all forces and motions")
    return best


def random_selection(
    instant: Instant, baseline: Baseline, rng: np.random.Generator, forces: Triple, couples: Triple
) -> Selection:
    """A frame anywhere on the object: uniform axes, a point within twice its size of O.

    Args:
        instant: the state, for the object's size.
        baseline: how many triads the frame has.
        rng: source of the random numbers.
        forces, couples: which of the frame's axes are force controlled.
    """
    triads = [pin.Quaternion(*_unit(rng.normal(size=4))).matrix() for _ in range(baseline.triads)]
    frame = pin.SE3(triads[0], rng.uniform(-2.0, 2.0, 3) * instant.size)
    return Selection(frame, triads[-1], forces, couples)


def _descend(instant: Instant, law: SelectionLaw) -> tuple[SelectionLaw, float]:
    """Levenberg–Marquardt on the residuals, finite differences of point and axes."""
    at = instant.coupling(law)
    cost, damping = at.cost, 1e-2
    if not np.isfinite(cost):
        return law, cost
    small = 1e-6
    count = 3 + 3 * law.baseline.triads
    for _ in range(_STEPS):
        r = at.residuals
        beside = [_moved(law, small * e, instant.size) for e in np.eye(count)]
        moved = [instant.coupling(x).residuals for x in beside]
        J = (np.array(moved) - r) / small  # (count, residuals)
        gradient, normal = J @ r, J @ J.T
        if np.linalg.norm(gradient) <= 1e-9 * max(cost, 1e-12):
            break
        step = -np.linalg.solve(normal + damping * np.eye(count), gradient)
        trial = _moved(law, step * min(1.0, 1.0 / float(np.linalg.norm(step))), instant.size)
        coupling = instant.coupling(trial)
        if coupling.cost < cost:
            done = cost - coupling.cost < 1e-7 * cost
            law, at, cost, damping = trial, coupling, coupling.cost, 0.2 * damping
            if done:
                break
        else:
            damping *= 10.0
            if damping > 1e8:
                break
    return law, cost


def _moved(law: SelectionLaw, step: Array, size: float) -> SelectionLaw:
    """The point moved by step[:3] sizes, the triads turned by step[3:6] (and step[6:])."""
    old = law.selection
    linear = pin.SE3(
        pin.exp3(step[3:6]) @ old.linear.rotation, old.linear.translation + size * step[:3]
    )
    if law.baseline.triads == 1:
        angular = np.array(linear.rotation)
    else:
        angular = pin.exp3(step[6:]) @ old.angular
    return SelectionLaw(law.baseline, Selection(linear, angular, old.forces, old.couples))


def _flags(chosen: Sequence[int]) -> tuple[Triple, Triple]:
    x, y, z, a, b, c = (i in chosen for i in range(6))
    return (x, y, z), (a, b, c)


def _unit(x: Array) -> Array:
    return np.asarray(x / np.linalg.norm(x))
