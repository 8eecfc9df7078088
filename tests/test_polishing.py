"""The learning example: what it gauges, what it learns in a few generations, and the other law."""

import numpy as np
from pytest import approx, fixture, mark
from rigs import assert_near, vector
from samples import first

from benchmarks import polishing
from benchmarks.polishing import (
    EDGES,
    FAST,
    KNOTS,
    LAWS,
    MEAN,
    SLOW,
    best_forces,
    judge,
    learn,
    softness,
    teach,
)


@fixture(autouse=True)
def few_rows(monkeypatch):
    monkeypatch.setattr(polishing, "JUDGED", 6)


def test_the_strategy_finds_what_is_hidden():
    """The lowest point of a parabola, of which it gets noisy heights."""
    hidden = vector(3.0, -1.0, 0.5)
    noise = np.random.default_rng(0)

    def cost(policies, seed):
        assert policies.shape == (40, 3)
        return ((policies - hidden) ** 2).sum(axis=1) + 0.01 * noise.standard_normal(40)

    found, curve = learn(cost, np.zeros(3), 1.0, 40, 25, seed=1)
    assert_near(found, hidden, atol=0.1)
    assert curve[0] == approx(hidden @ hidden, abs=0.05) and len(curve) == 25


def test_an_even_force_wears_as_soft_as_the_edge_is():
    seen = judge("ours", np.full(len(KNOTS), MEAN), SLOW)
    fine = np.linspace(EDGES[:-1], EDGES[1:], 50)
    soft = softness(fine).mean(axis=0)
    assert soft.max() > 2.2 * soft.min()
    assert_near(seen.depth, np.tile(soft, (6, 1)), rtol=0.08)  # unknown masses
    assert seen.off.max() < 1e-3


@mark.slow
def test_a_few_generations_learn_the_hidden_hardness():
    policy, curve = teach("ours", 0, rows=32)
    assert curve[0] > 0.3
    assert judge("ours", policy, SLOW).uneven.mean() < 0.5 * curve[0]
    assert np.corrcoef(policy, best_forces(KNOTS))[0, 1] > 0.8


@mark.parametrize("law", first(LAWS))
def test_the_best_forces_wear_evenly_above_every_law(law):
    slow, fast = (judge(law, best_forces(KNOTS), seconds) for seconds in (SLOW, FAST))
    assert slow.uneven.mean() < 0.05 and fast.uneven.mean() < 0.08
    assert fast.off.mean() > slow.off.mean() and fast.off.max() < 5e-3
