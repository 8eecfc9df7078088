"""An evolution strategy in plain NumPy: it sees what each policy is worth, and nothing else."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from osc_contact.spatial import Array

__all__ = ["learn"]

_BEST = 0.25  #: of a generation, from which the next is drawn
_KEPT = 0.3  #: of the spread, at each generation


def learn(
    cost: Callable[[Array, int], Array],
    start: Array,
    spread: float,
    rows: int,
    generations: int,
    seed: int,
    told: Callable[[int, float], None] = lambda generation, cost: None,
) -> tuple[Array, Array]:
    """The cross-entropy method: draw policies, keep the best quarter, draw around them.

    Args:
        cost: of policies (rows, m), in episodes of a seed.
        start: (m,) the first mean. spread: the first standard deviation of each number.
        rows: policies of a generation; the first is the mean itself.
        generations: how many. seed: of the draws and of the episodes.
        told: called with the number of a generation and what its mean costs.

    Returns:
        (m,) the last mean; (generations,) what each mean cost.
    """
    draws = np.random.default_rng(seed)
    mean, deviation, curve = start.copy(), np.full(len(start), spread), []
    for generation in range(generations):
        policies = mean + deviation * draws.standard_normal((rows, len(start)))
        policies[0] = mean
        costs = cost(policies, int(draws.integers(2**31)))
        curve.append(float(costs[0]))
        told(generation, curve[-1])
        best = policies[np.argsort(costs)[: max(2, round(_BEST * rows))]]
        mean = best.mean(axis=0)
        deviation = _KEPT * deviation + (1.0 - _KEPT) * best.std(axis=0)
    return mean, np.array(curve)
