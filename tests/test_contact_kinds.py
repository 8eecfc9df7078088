"""Contacts of every kind in a scenario file: what is accepted, refused, documented and built."""

import re
from types import SimpleNamespace
from typing import get_args

import numpy as np
import pinocchio as pin
from complaints import scenario_error
from numpy.linalg import lstsq, norm
from numpy.random import default_rng
from pair_kinds import snake
from processes import python
from pytest import approx
from rigs import STILL, assert_near, placed, pose_of, vector
from samples import ROOT, parametrize

from osc_contact.contacts.feet import feet, force_owners
from osc_contact.contacts.pairs.pair import axes_are_chosen
from osc_contact.lab.rig.contacts import build_pairs, environment_bodies
from osc_contact.lab.rig.references import References, force_names
from osc_contact.lab.scenarios.contact_keys import (
    OnBodySpec,
    contact_types,
    magnitude_names,
    make_pair,
)
from osc_contact.lab.scenarios.loader import parse_scenario
from osc_contact.loop.reference_rules import pulls
from osc_contact.loop.rules import findings
from osc_contact.settings.quantities import Dimension

HEAD = """\
name: kinds
arms:
  - {name: arm, urdf: arm.urdf, tip: tool, posture: [0]}
object: {urdf: rod.urdf}
grasps: {arm: {}}
gains: {motion: {stiffness: 400, damping: 40}, force: {integral: 30}}
control: {rate: 1 kHz}
plant: {type: rigid, step: 1 ms}
duration: 2 s
environment:
  - name: table
    urdf: face.urdf
    pose: {xyz: [100 mm, -0.2, 0.3], rpy: [20 deg, -0.3, 50 deg]}
contacts:
"""
#: Kinds on a body of `environment`.
KINDS = [kind for kind, spec in contact_types().items() if issubclass(spec, OnBodySpec)]
VALUES = {"a length": "[{0} cm, -{1} mm, {0} mm]", "a plain number": "[{0}, -{1}, 0.{0}]"}


def keys_of(kind):
    """Every key of a kind with a value of its own."""
    keys = []
    for i, (key, field) in enumerate(contact_types()[kind].model_fields.items(), start=1):
        if field.annotation is float:
            (dimension,) = (mark for mark in field.metadata if isinstance(mark, Dimension))
            keys.append(f"{key}: {40 + i} {'deg' if dimension.kind == 'an angle' else 'mm'}")
        elif key == "surface":
            keys.append("surface: {type: cylinder, radius: 300 mm}")
        elif key not in ("name", "type", "body"):
            dimension = get_args(get_args(field.annotation)[0])[1]
            keys.append(f"{key}: {VALUES[dimension.kind].format(i, 10 - i)}")
    return ", ".join(keys)


def text(kind, forces=None):
    """A scenario with one contact `pad` of a kind."""
    names = magnitude_names({"pad": contact_types()[kind].forces}) if forces is None else forces
    entries = "".join(f"  {name}: [{{type: constant, value: 3 N}}]\n" for name in names)
    contact = f"  - {{name: pad, type: {kind}, body: table, {keys_of(kind)}}}\n"
    return f"{HEAD}{contact}force:\n{entries}"


@parametrize("kind", KINDS)
def test_each_kind_is_the_pair_of_its_name_seen_in_the_world(kind):
    """N at a random pose: the pair of the Python class, given in the body's frame at its pose."""
    scenario = parse_scenario(text(kind))
    (pair,) = build_pairs(scenario)
    assert snake(type(pair).__name__) == kind
    assert pair.name == "pad"
    own = make_pair(scenario.contacts[0], placed())
    X_WB = pin.SE3(
        pin.rpy.rpyToMatrix(np.deg2rad(20), -0.3, np.deg2rad(50)), vector(0.1, -0.2, 0.3)
    )
    rng = default_rng(3)
    for _ in range(5):
        X = pose_of(rng)
        V = rng.standard_normal(6)
        ours = pair.contact(X, V)
        theirs = own.contact(X, V, X_WB)
        assert ours.r == contact_types()[kind].forces == len(force_names(scenario))
        if axes_are_chosen(pair):  # compare spaces
            projected = theirs.N @ lstsq(theirs.N, ours.N, rcond=None)[0]
            assert_near(projected, ours.N, atol=1e-9)
            continue
        assert_near(ours.N, theirs.N, atol=1e-12)
        assert_near(ours.n_gamma, theirs.n_gamma, atol=1e-9)
        assert_near(pair.gaps(X), own.gaps(X, X_WB), atol=1e-12)


@parametrize("kind", KINDS)
def test_feet_lie_on_the_lines_of_force_and_on_the_touched_surface(kind):
    scenario = parse_scenario(text(kind))
    (pair,) = build_pairs(scenario)
    rng = default_rng(8)
    X = pin.SE3(pin.exp3(0.3 * rng.standard_normal(3)), 0.1 * rng.standard_normal(3))
    E = placed(0.02, -0.03, 0.01)  # the body has slid
    points, directions = feet(pair, X, E)
    N = pair.contact(X, STILL, E).N
    assert_near(norm(directions, axis=1), 1.0, atol=1e-12)
    moments = np.cross(points - X.translation, directions)
    assert_near(np.vstack((directions.T, moments.T)), N, atol=1e-12)
    on_body = E * environment_bodies(scenario)[0].placement
    local = np.array([on_body.actInv(p) for p in points])
    spec = scenario.contacts[0]
    if hasattr(spec, "face_point"):
        assert_near((local - spec.face_point) @ spec.face_normal, 0.0, atol=1e-12)
    if kind == "face_on_vertex":
        assert norm(local[0] - spec.body_vertex) == approx(spec.radius, abs=1e-12)
    if kind == "edge_on_edge":
        n = on_body.rotation.T @ directions[0]
        across = np.cross(spec.edge_direction, n)  # the line of force crosses the body's edge
        assert abs((local[0] - spec.edge_point) @ across) < 1e-12
        assert abs((local[0] - spec.edge_point) @ n) < 1e-12


def changed(kind, pattern, new):
    """The scenario with part of it replaced."""
    found, count = re.subn(pattern, new, text(kind))
    assert count == 1
    return found


REFUSED = {
    "unknown kind": (text("face_on_face").replace("face_on_face", "face_onface"), "'face_on_face'"),
    "no kind": (
        text("face_on_face").replace("type: face_on_face, ", ""),
        "for a contact cylinder_in_hole",
    ),
    "missing key": (
        changed("edge_on_edge", r", edge_outward: \[.*?\]", ""),
        "contacts.pad: the key 'edge_outward' is missing: a direction roughly out of the body",
    ),
    "key of another kind": (
        changed("edge_on_face", "length: ", "size: "),
        "contacts.pad.size: unknown key; known: name, body, type, point",
    ),
    "no such body": (
        text("edge_on_face").replace("body: table", "body: tabel"),
        "contacts.pad.body: no body of environment has this name; did you mean 'table'?",
    ),
    "body of nobody": (
        text("edge_on_face").replace("contacts:", "  - {name: lamp, urdf: face.urdf}\ncontacts:"),
        "environment.lamp: no contact is on the body 'lamp'",
    ),
    "two bodies of one name": (
        text("edge_on_face").replace("contacts:", "  - {name: table, urdf: face.urdf}\ncontacts:"),
        "environment.table.name: the name 'table' is taken",
    ),
    "one force for three": (
        text("face_on_face", forces=["pad"]),
        "force.pad: this contact has 3 forces; give each its own entry, pad.1 to pad.3",
    ),
    "a force too few": (
        text("face_on_face", forces=["pad.1", "pad.3"]),
        "the contact 'pad.2' has no entry",
    ),
    "a force too many": (
        text("edge_on_edge", forces=["pad", "pad.1"]),
        "force.pad.1: no contact has this name",
    ),
}


@parametrize("case", REFUSED)
def test_what_does_not_fit_is_refused_with_line_key_and_cure(case):
    source, message = REFUSED[case]
    with scenario_error(rf"(?s)f\.yaml:\d+:.*{re.escape(message)}"):
        parse_scenario(source, "f.yaml")


def test_force_of_one_magnitude_can_be_overridden():
    scenario = parse_scenario(text("face_on_face"), None, ["force.pad.2.0.value=7 N"])
    assert scenario.force["pad.2"][0].value == 7.0
    assert scenario.force["pad.1"][0].value == 3.0
    assert type(scenario).model_validate(scenario.as_dict()) == scenario


def test_only_contacts_that_push_are_kept_from_pulling():
    def found(kind):
        scenario = parse_scenario(text(kind), None, ["force.pad.2.0.value=-1 N"])
        pairs = build_pairs(scenario)
        times = vector(0.0, 1.0)
        plan = References.of(scenario, placed(), pairs, STILL).over(times)
        task = SimpleNamespace(
            pairs=pairs,
            owners=force_owners(pairs),
            force_names=force_names(scenario),
            times=times,
            forces=plan.alpha_d,
        )
        return [one.text for one in findings((pulls,), task) if one.refused]

    assert not found("cylinder_in_hole")
    assert "pad.2 is −1 N at t = 0 s; this contact cannot pull" in found("edge_on_face")[0]


def test_a_new_pair_whose_axes_are_a_choice_passes_the_tests_of_all_pairs():
    """Runs tests/test_pairs.py and this file on the pair of tests/scratch_pair.py."""
    files = [str(ROOT / "tests" / name) for name in ("test_pairs.py", "test_contact_kinds.py")]
    plugins = ("-p", "scratch_pair", "-p", "no:cacheprovider")
    done = python("-m", "pytest", "-q", *plugins, "-k", "ball_in_tube", *files, cwd=ROOT)
    passed = int(re.search(r"(\d+) passed", done.stdout)[1])
    assert passed >= 18, done.stdout
