"""A bounded motion by which two points show their normals, and what forces are known to without."""

import numpy as np
from pytest import approx, mark
from rigs import assert_near, largest, rig_of, unit, vector
from scenario_runs import closed_force, verdict_of

from benchmarks.combined_errors import ERRORS
from osc_contact.contacts.feet import feet
from osc_contact.lab.checks.inspection import inspect_rig
from osc_contact.lab.reports.report import verdict_table
from osc_contact.lab.rig.dither import known_to, showing_twist, slides
from osc_contact.settings.control import Dither

H = 1e-5


def test_it_is_bounded_smooth_and_ends():
    dither = Dither(amplitude=0.004, frequency=2.0, duration=2.5)
    t = np.linspace(0.0, 4.0, 4001)
    s, s_1, s_2 = slides(dither, 0.5, t)
    outside = (t <= 0.5) | (t >= 3.0)
    assert largest(s) == approx(0.004, rel=0.01)
    for x in (s, s_1, s_2):
        assert largest(x[outside]) < 1e-9
    later, before = (np.array(slides(dither, 0.5, t + h)) for h in (H, -H))
    assert_near((later[0] - before[0]) / (2 * H), s_1, atol=1e-7)
    assert_near((later[1] - before[1]) / (2 * H), s_2, atol=2e-5)


@mark.parametrize("name", ["two_contact_rod", "dual_panda_rod", "hinge_ball_rod"])
def test_arms_and_contacts_permit_it_and_both_points_slide_along_their_line(name):
    rig = rig_of(name, "control.dither={}")
    state = rig.state
    N = rig.contact.N
    V = showing_twist(rig.pairs, state, N)
    assert largest(N.T @ V) < 1e-9 and largest(state.C.T @ V) < 1e-9
    points = [feet(pair, state.X_WO)[0][0] for pair in rig.pairs]
    u = unit(points[1] - points[0])
    for point in points:
        assert (V[:3] + np.cross(V[3:], point - state.X_WO.translation)) @ u == approx(1.0)
    t = 1.1
    now, plain = (rig_of(name, f"control.dither={how}").references.at(t) for how in ("{}", "null"))
    s = slides(Dither(), rig.references.engage_at, vector(t))
    assert_near(now.V_D - plain.V_D, V * s[1], atol=2e-3)
    assert largest(now.V_D - plain.V_D) > 1e-3


def test_nothing_is_shown_where_there_are_no_two_points():
    for name in ("panda_edge", "ur5_wipe"):
        rig = rig_of(name, "control.dither={}")
        assert not showing_twist(rig.pairs, rig.state, rig.contact.N).any()
        assert known_to(rig.pairs, rig.state, 1.0) == 0.0


def test_what_a_wrong_normal_costs_two_points():
    """Least squares over forces ±s u and the pushes along both faces that then are left."""
    rig = rig_of("two_contact_rod")
    state = rig.state
    n = np.array([pair.normal for pair in rig.pairs])
    points = [state.X_WO.act(pair.vertex) for pair in rig.pairs]
    u = unit(points[1] - points[0])
    along = u - (n @ u)[:, None] * n  # in each face
    pushes = 10.0 * 0.05 * np.random.default_rng(0).standard_normal((4000, 2, 1))
    left = pushes * along / np.linalg.norm(along, axis=1)[:, None]  # beside the assumed normals
    s = np.sum(left * along, axis=(1, 2)) / np.sum(along**2)
    expected = np.sqrt(np.mean(s**2)) * largest(n @ u) / 10.0
    assert known_to(rig.pairs, state, 0.05) == approx(expected, rel=0.05)


def test_inspect_and_the_verdict_suggest_it_with_its_gain():
    changes = ["gains={}", "duration=1.2 s"]
    rig = rig_of("two_contact_rod", *changes)
    found = [line for line in inspect_rig(rig).lines if "control.dither={}" in line]
    assert len(found) == 1 and "known to 5 deg" in found[0]
    without = rig_of("two_contact_rod", *changes, "control.dither={}")
    assert not any("control.dither" in line for line in inspect_rig(without).lines)
    standing = rig_of("two_contact_rod", *changes, "motion=[]")
    found = [line for line in inspect_rig(standing).lines if "cannot be observed" in line]
    assert len(found) == 2
    verdict = verdict_of(standing.scenario)
    assert set(verdict["normals"]) == {"left_end", "right_end"}
    rows = [str(cell) for column in verdict_table(verdict).columns for cell in column.cells]
    assert any("known to 5 deg" in cell for cell in rows)
    assert any("control.dither={} would" in cell for cell in rows)


def test_under_all_errors_it_brings_two_points_to_three_per_cent():
    masses = ["model_error.arm_mass=1.2", "model_error.object_mass=1.2"]
    error = []
    for dither in ("null", "{}"):
        changes = [*ERRORS, *masses, f"control.dither={dither}", "duration=4 s"]
        error.append(closed_force(verdict_of("two_contact_rod", *changes)))
    assert error[1] < 0.031 and error[1] < 0.8 * error[0], error
