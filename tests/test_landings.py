"""A contact that lands beside closed ones: their forces stay what is commanded."""

import numpy as np
from law_calls import landing, records, write
from numpy.linalg import solve
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx
from samples import parametrize
from test_active_sets import vertices

import osc_contact as osc
from osc_contact.law.phases import APPROACHING, CLOSED

RISE = 0.05


def landings(rng, phase, since=np.inf, locked=0, **work):
    """Records of contacts with one column each, random lines of force, inertia and forces."""
    r = len(phase)
    t = records(1, 1, contacts=r, columns=r, phased=1, rise=RISE)
    A = rng.standard_normal((6, 6))
    given = {
        "rank": r,
        "count": r,
        "kept": range(r),
        "locked": locked,
        "Lambda": A @ A.T + np.eye(6),
        "N_t": rng.standard_normal((6, 6)),
        "pushed_t": rng.standard_normal((6, 6)),
        "alpha_d": np.full(r, 1e6),
        "alpha_u": rng.uniform(5.0, 15.0, r),
        "alpha_meas": rng.uniform(5.0, 15.0, r),
    }
    write(t.work, **given | work)
    t.model.columns.contact = range(r)
    t.memory.contacts.phase = phase
    t.memory.contacts.since = since
    return t


def pressed(t, closed):
    """Forces of the closed contacts, if those of the others are what was measured.

    The commands cause no other acceleration than that along the contacts that are not closed.
    """
    m, r = int(t.work.locked), int(t.work.rank)
    N, pushed = (rows[:r, m:].T for rows in (t.work.N_t, t.work.pushed_t))
    N = N[:, closed]
    D = N.T @ solve(t.work.Lambda[m:, m:], pushed)
    excess = t.work.alpha_u[:r] + t.work.reaction[:r] - np.where(closed, 0.0, t.work.alpha_meas[:r])
    return solve(D[:, closed], D @ excess)


@parametrize("locked", [0, 1])
@parametrize(
    "phase",
    [[CLOSED, APPROACHING], [APPROACHING, CLOSED, CLOSED, APPROACHING], [CLOSED] * 3 + [1]],
)
def test_closed_contacts_press_as_commanded_while_others_land(phase, locked):
    closed = np.array(phase) == CLOSED
    for seed in range(10):
        t = landings(default_rng(seed), phase, locked=locked)
        commanded = t.work.alpha_u[: len(phase)][closed].copy()
        assert abs(pressed(t, closed) - commanded).max() > 1e-3
        landing.oppose_landings(t)
        assert_allclose(pressed(t, closed), commanded)
        assert_array_equal(t.work.reaction[: len(phase)][~closed], 0.0)


def test_what_is_added_fades_once_the_contact_has_touched():
    added = []
    for since in (0.0, RISE, 2.0 * RISE, 3.0 * RISE, np.inf):
        t = landings(default_rng(1), [CLOSED, CLOSED], since=[np.inf, since])
        landing.oppose_landings(t)
        added.append(float(t.work.reaction[0]))
    assert added[0] != 0.0 and np.array(added) / added[0] == approx([1.0, 1.0, 0.5, 0.0, 0.0])


def test_additions_are_limited_and_there_are_none_of_dependent_or_lone_contacts():
    t = landings(default_rng(1), [CLOSED, APPROACHING], alpha_d=[0.02, 1.0])
    landing.oppose_landings(t)
    assert abs(t.work.reaction[0]) == approx(0.01)
    for phase, change in (
        ([APPROACHING] * 2, {}),
        ([CLOSED] * 2, {}),
        ([CLOSED, APPROACHING], {"count": 3}),
        ([CLOSED, APPROACHING], {"locked": 6}),
    ):
        t = landings(default_rng(1), phase, **change)
        landing.oppose_landings(t)
        assert_array_equal(t.work.reaction[:2], 0.0)


@parametrize("named", [False, True])
def test_landings_are_opposed_where_active_contacts_are_named(named):
    controller, measured, X = vertices(3, osc.PhaseSettings(), reading="filter")
    records = controller.records
    seen = []
    for phase in ([CLOSED, CLOSED, APPROACHING], [CLOSED] * 3):
        records.memory.contacts.phase = phase
        records.memory.contacts.since = 9.0
        records.memory.fresh = 0  # phases are not judged
        active = np.ones(3) if named else None
        controller.tick(measured, osc.Reference(X, alpha_d=np.full(3, 8.0), active=active))
        assert controller.status is not osc.Status.HELD, controller.reason
        seen.append(records.work.reaction[:3].copy())
    assert_array_equal(np.abs(seen[0]) > 1e-3, [named, named, False])
    assert_array_equal(seen[1], 0.0)
