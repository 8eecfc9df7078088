"""The report on a contact state and the references of a run, against numbers found another way."""

import json
import re
from dataclasses import replace

import numpy as np
import pinocchio as pin
from complaints import scenario_error
from numpy.linalg import lstsq, matrix_rank, norm
from pytest import approx
from rigs import (
    assert_derivatives,
    assert_near,
    largest,
    object_poses,
    placed,
    rotated,
    shift,
    vector,
)
from samples import aligned, module_fixture, parametrize
from scenario_runs import rig_of

import osc_contact as osc
from osc_contact.lab.checks.inspection import inspect_rig
from osc_contact.lab.rig.references import References, common_tangent


@module_fixture
def rig():
    return rig_of()


@module_fixture
def found(rig):
    return inspect_rig(rig)


def pressed(rig, left, right):
    """The report with other push directions at the two ends of the rod."""
    pairs = tuple(
        osc.VertexOnFace([x, 0, 0], [x, 0, 0.2], -np.array(push), name=name)
        for name, x, push in (("left_end", -0.29, left), ("right_end", 0.29, right))
    )
    return inspect_rig(replace(rig, pairs=pairs))


def sentence(found, *words):
    (line,) = [line for line in found.lines if all(word in line for word in words)]
    return line


def numbers(text):
    """The numbers of the first [x, y, z] in a text."""
    return np.array(re.search(r"\[([^\]]*)\]", text)[1].split(","), dtype=float)


def test_dimensions(found, rig):
    state = rig.state
    assert (found.d, found.r) == (5, 2) and found.free.shape == (6, 3)
    assert matrix_rank(state.Phi, tol=1e-9 * norm(state.Phi)) == found.d
    assert "2 arm(s), 10 joints, 8 motors" in found.lines[0] and "d = 5" in found.lines[0]
    assert sentence(found, "3 motions stay free", "2 contact forces can be controlled")
    assert sentence(found, "3 internal force(s)"), "8 motors, 5 motions"
    assert largest(found.N.T @ found.T) < 1e-12
    assert matrix_rank(np.hstack([found.N, found.T])) == 6


def test_sets_of_contacts_are_listed_with_known_ones(found):
    """N is that of the set at the start; a stage has the motions that its own contacts leave."""
    spans = ("active.left_end=[[1 s, 1.5 s], [2 s, 99 s]]", "active.right_end=[[0 s, 2 s]]")
    sets = inspect_rig(rig_of("two_contact_rod", *spans))
    assert [line for line in sets.lines if line.startswith("active from")] == [
        "active from 0 s to 1 s: 'right_end' (r = 1, 4 motions free); known, not active: "
        "'left_end'.",
        "active from 1 s to 1.5 s: 'left_end', 'right_end' (r = 2, 3 motions free).",
        "active from 1.5 s to 2 s: 'right_end' (r = 1, 4 motions free); known, not active: "
        "'left_end'.",
        "active from 2 s to 10 s: 'left_end' (r = 1, 4 motions free); known, not active: "
        "'right_end'.",
    ]
    assert sets.contacts == ("right_end",) and sets.free.shape == (6, 4)
    assert_near(sets.N, found.N[:, 1:])
    sentence(sets, "1 contact(s) constrain r = 1", "4 motions stay free")
    sentence(sets, "contact 'left_end': force along")
    none = inspect_rig(rig_of("two_contact_rod", "active.left_end=[]", "active.right_end=[]"))
    assert none.r == 0 and none.N.shape == (6, 0) and none.conditioning == 1.0
    sentence(none, "active from 0 s to 10 s: none (r = 0, 5 motions free)")


def test_free_motions_keep_loops_and_contacts_closed(found, rig):
    """A small step along each: every arm can follow it, and no gap opens to first order."""
    chain = rig.chain
    state = rig.state
    for twist in found.free.T:
        eta, *_ = lstsq(state.S, twist, rcond=None)
        pin.forwardKinematics(chain.model, chain.data, rig.q_contact + 1e-6 * (state.W @ eta))
        first, second = object_poses(chain)
        assert largest((first.inverse() * second).homogeneous - np.eye(4)) < 1e-9
        for pair in rig.pairs:
            assert abs(pair.gaps(first) - pair.gaps(state.X_WO)) < 1e-10 * norm(twist)


def test_the_words_of_a_free_motion_are_its_twist(found):
    for i, twist in enumerate(found.free.T):
        line = sentence(found, f"free motion {i + 1}:")
        if "translation" in line:
            shown = np.append(numbers(line), np.zeros(3))
        else:
            axis = numbers(line)
            point = numbers(line.split("through", 1)[1])
            pitch = re.search(r"advancing (-?[0-9.]+) mm/rad", line)
            slide = 1e-3 * float(pitch[1]) if pitch else 0.0
            shown = np.append(slide * axis + np.cross(point, axis), axis)
        cosine = shown @ twist / (norm(shown) * norm(twist))
        assert cosine == approx(1.0, abs=1e-5), line
    assert sum("translation along" in line for line in found.lines) == 1, "the common tangent"
    tangent = np.cross(*found.N[:3].T)
    shown = numbers(sentence(found, "translation along"))
    assert largest(np.cross(tangent / norm(tangent), shown)) < 2e-3


def test_skew_lines_are_described(found):
    """Their angle and distance are those of figure 1: tests/test_raibert_craig.py."""
    line = sentence(found, "lines of force")
    assert "enclose 62.0° and pass 279.6 mm apart" in line
    assert "skew: no single frame's axes hold both" in line


def test_what_the_structure_carries(found):
    """Vertical SCARA axes and hinges about the rod's y axis: no arm can turn the rod about x."""
    line = sentence(found, "the arms' structure carries")
    assert "couple about" in line and np.allclose(np.abs(numbers(line)), [1, 0, 0], atol=1e-3)


def test_contact_lines_state_direction_and_point(found, rig):
    for i, pair in enumerate(rig.pairs):
        line = sentence(found, f"contact '{pair.name}'")
        direction = numbers(line)
        point = numbers(line.split("through", 1)[1])
        assert_near(direction, found.N[:3, i], atol=6e-4)
        moment = np.cross(point - rig.state.X_WO.translation, direction)
        assert_near(moment, found.N[3:, i], atol=2e-3)


def test_conditioning_does_not_depend_on_units_of_force(found, rig):
    mobility = found.N.T @ rig.state.Phi @ found.N
    rho = abs(mobility[0, 1]) / np.sqrt(mobility[0, 0] * mobility[1, 1])
    assert found.conditioning == approx((1 + rho) / (1 - rho), rel=1e-9)
    assert f"{found.conditioning:.3g}" in sentence(found, "conditioning")


def test_json_form_is_plain(found):
    data = found.as_dict()
    assert data["free_motions"] == 3 and data["lines"] == list(found.lines)
    assert json.loads(json.dumps(data)) == data
    assert np.allclose(data["free"], found.free) and np.allclose(data["N"], found.N)


@parametrize(
    "left, right, words",
    [
        ([0, 0, -1], [0, 0, -1], "press along parallel lines, 580.0 mm apart."),
        ([0, 0, 1], [0, 0, -1], "580.0 mm apart"),
        ([-1, 0, -1], [1, 0, -1], "enclose 90.0° and pass 0.0 mm apart (they meet in a point)"),
        ([-2, 0, -1], [2, 0, -1], f"enclose {np.degrees(2 * np.arctan(0.5)):.1f}°"),
    ],
)
def test_lines_that_are_parallel_or_meet(rig, left, right, words):
    found = pressed(rig, left, right)
    assert words in sentence(found, "lines"), "the angle of lines, not of arrows"


# References: twists and accelerations are the derivatives of the pose, steps and standoffs too.


CENTRES = ([0.3, -0.2, 0.1], [-0.1, 0.4, 0.5])  # of two turns


def two_turns(centres=(None, None)):
    """Two angular moves about different directions, and a standoff that turns the rod."""

    def move(kind, direction, changes, **through):
        sine = {"type": "sine", "amplitude": 0.3, "frequency": 0.7, "phase": 0.4}
        return {"kind": kind, "direction": direction, "signals": [sine | changes]} | through

    motion = [
        move("angular", [0, 0, 1], {}, through=centres[0]),
        move("angular", [0, 1, 0], {"frequency": 1.1}, through=centres[1]),
        move("linear", [1, 0, 0], {"amplitude": 0.1}),
    ]
    scenario = osc.load_scenario("two_contact_rod_mismatch").replaced(motion=motion)
    X = placed(0.1, 0.2, 0.3, (0.1, 0.2, 0.3))
    return References.of(scenario, X, rig_of().pairs, vector(0.01, 0.0, 0.02, 0.1, -0.2, 0.05))


@parametrize("centres", [(None, None), CENTRES])
@parametrize("t", [0.2, 0.45, 0.55, 1.3, 2.7])
def test_twist_and_classical_acceleration_are_derivatives_of_the_pose(t, centres):
    assert_derivatives(two_turns(centres).at, t, 1e-5, 1e-7, 1e-6)


def test_turns_about_points_are_products_of_poses():
    references = two_turns(CENTRES)
    t = 2.7  # after the standoff
    angles = [move.signals[0].at(t)[0] for move in references.scenario.motion[:2]]
    X = references.X_start
    for centre, axis, angle in aligned(CENTRES, np.eye(3)[[2, 1]], angles):
        to = shift(centre)
        X = to * rotated(pin.exp3(angle * axis)) * to.inverse() * X
    X.translation += [references.scenario.motion[2].signals[0].at(t)[0], 0, 0]
    assert_near(references.at(t).X_WD.homogeneous, X.homogeneous, atol=1e-12)
    assert norm(X.translation - references.X_start.translation) > 0.02


def test_the_object_rests_off_the_contacts_while_wrists_are_tared():
    """Inertial forces would enter the tare as an error of the wrists."""
    references = two_turns()
    assert any(signal.at(0.1)[2] for move in references.scenario.motion for signal in move.signals)
    plan = references.over(np.linspace(0.0, references.scenario.tare.duration, 9))
    assert not plan.V_D.any() and not plan.A_D.any()
    assert_near(plan.X_WD, np.tile(plan.X_WD[0], (9, 1)), atol=1e-12)


@parametrize("life, after", {"off": 0.0, "{}": 0.2})
def test_the_run_begins_at_the_standoff_and_ends_it_when_it_engages(life, after):
    """Or 0.2 s later, while contacts are approached."""
    references = rig_of("two_contact_rod_mismatch", f"control.life={life}").references
    engaged = references.at(references.engage_at + after).X_WD
    assert references.engage_at == approx(0.6 - after)
    assert norm(references.at(0.0).X_WD.translation - references.X_start.translation) > 3e-3
    assert_near(engaged.translation, references.X_start.translation, atol=1e-12)


def test_common_tangent_lies_in_every_face_and_must_be_unique():
    rig = rig_of()
    pairs = rig.pairs
    X = rig.state.X_WO
    u = common_tangent(pairs, X)
    assert norm(u) == approx(1.0)
    for pair in pairs:
        assert abs(u @ pair.normal) < 1e-12
    with scenario_error("span 1"):
        common_tangent(pairs[:1], X)
