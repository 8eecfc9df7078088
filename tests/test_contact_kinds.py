"""Contacts of every kind in a scenario file: what is accepted, refused, documented and built."""

from __future__ import annotations

import re

import numpy as np
import pinocchio as pin
import pytest

from osc_contact.contacts import pairs as kinds
from osc_contact.errors import ScenarioError
from osc_contact.runs.contacts import build_pairs, environment_bodies, feet
from osc_contact.runs.references import force_names
from osc_contact.scenarios import parse_scenario
from osc_contact.scenarios.contact_types import CONTACT_TYPES, magnitude_names

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
KEYS = {
    "sphere_on_plane": "centre: [1 cm, 2 cm, 3 cm], radius: 12 mm, {plane}",
    "face_on_vertex": "point: [1 cm, 0, 0], normal: [1, 1, 0], body_vertex: [0, 1 cm, 0], "
    "radius: 3 mm",
    "edge_on_edge": "point: [1 cm, 0, 0], direction: [2, 0, 1], edge_point: [0, 1 cm, 0], "
    "edge_direction: [0, 1, 0.2], edge_outward: [-1, 0, 1]",
    "edge_on_face": "point: [1 cm, 0, 0], direction: [0, 2, 0], length: 6 cm, {plane}",
    "cylinder_on_plane": "point: [1 cm, 0, 0], direction: [0, 2, 0], radius: 1 cm, {plane}",
    "face_on_face": "point: [1 cm, 0, 0], normal: [0, 0, -1], size: 40 mm, {plane}",
    "cylinder_in_hole": "point: [1 cm, 0, 0], direction: [0, 0, 1], hole_point: [0, 0, 1 cm], "
    "hole_direction: [0, 0, 3], length: 5 cm",
}  # fmt: skip
PLANE = "face_point: [0, 1 cm, 0], face_normal: [0, 0.1, 2]"


def text(kind, keys=None, forces=None):
    """A scenario with one contact `pad` of a kind."""
    keys = KEYS[kind].format(plane=PLANE) if keys is None else keys
    names = magnitude_names({"pad": CONTACT_TYPES[kind].forces}) if forces is None else forces
    entries = "".join(f"  {name}: [{{type: constant, value: 3 N}}]\n" for name in names)
    contact = f"  - {{name: pad, type: {kind}, body: table, {keys}}}\n"
    return f"{HEAD}{contact}force:\n{entries}"


def complaints(source):
    with pytest.raises(ScenarioError) as caught:
        parse_scenario(source, "f.yaml")
    return str(caught.value)


@pytest.mark.parametrize("kind", KEYS)
def test_each_kind_is_the_pair_of_its_name_seen_in_the_world(kind):
    """N at a random pose: the pair of the Python class, given in the body's frame at its pose."""
    scenario = parse_scenario(text(kind))
    (pair,) = build_pairs(scenario)
    assert re.sub(r"(?<!^)(?=[A-Z])", "_", type(pair).__name__).lower() == kind
    assert pair.name == "pad"
    own = in_body_frame(kind)
    X_WB = pin.SE3(
        pin.rpy.rpyToMatrix(np.deg2rad(20), -0.3, np.deg2rad(50)), np.array([0.1, -0.2, 0.3])
    )
    rng = np.random.default_rng(3)
    for _ in range(5):
        X = pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))
        V = rng.normal(size=6)
        ours, theirs = pair.contact(X, V), own.contact(X, V, X_WB)
        assert ours.r == CONTACT_TYPES[kind].forces == len(force_names(scenario))
        # the cross axes of a hole are a choice: compare spaces there
        if kind == "cylinder_in_hole":
            projected = theirs.N @ np.linalg.lstsq(theirs.N, ours.N, rcond=None)[0]
            np.testing.assert_allclose(projected, ours.N, atol=1e-9)
            continue
        np.testing.assert_allclose(ours.N, theirs.N, atol=1e-12)
        np.testing.assert_allclose(ours.n_gamma, theirs.n_gamma, atol=1e-9)
        np.testing.assert_allclose(pair.gaps(X), own.gaps(X, X_WB), atol=1e-12)


def in_body_frame(kind):
    plane = {"face_point": np.array([0, 0.01, 0]), "face_normal": np.array([0, 0.1, 2.0])}
    e = np.eye(3)
    point = 0.01 * e[0]
    return {
        "sphere_on_plane": lambda: kinds.SphereOnPlane(
            [0.01, 0.02, 0.03], 0.012, plane["face_point"], plane["face_normal"]
        ),
        "face_on_vertex": lambda: kinds.FaceOnVertex(point, [1, 1, 0], 0.01 * e[1], 0.003),
        "edge_on_edge": lambda: kinds.EdgeOnEdge(
            point, [2, 0, 1], 0.01 * e[1], [0, 1, 0.2], np.array([-1.0, 0, 1])
        ),
        "edge_on_face": lambda: kinds.EdgeOnFace(point, e[1], *plane.values(), 0.06),
        "cylinder_on_plane": lambda: kinds.CylinderOnPlane(point, e[1], 0.01, *plane.values()),
        "face_on_face": lambda: kinds.FaceOnFace(point, -e[2], *plane.values(), 0.04),
        "cylinder_in_hole": lambda: kinds.CylinderInHole(point, e[2], 0.01 * e[2], e[2], 0.05),
    }[kind]()


@pytest.mark.parametrize("kind", KEYS)
def test_feet_lie_on_the_lines_of_force_and_on_the_touched_surface(kind):
    scenario = parse_scenario(text(kind))
    (pair,) = build_pairs(scenario)
    rng = np.random.default_rng(8)
    X = pin.SE3(pin.exp3(0.3 * rng.normal(size=3)), 0.1 * rng.normal(size=3))
    E = pin.SE3(np.eye(3), np.array([0.02, -0.03, 0.01]))  # the body has slid
    points, directions = feet(pair, X, E)
    N = pair.contact(X, np.zeros(6), E).N
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, atol=1e-12)
    moments = np.cross(points - X.translation, directions)
    np.testing.assert_allclose(np.vstack((directions.T, moments.T)), N, atol=1e-12)
    bodies = environment_bodies(scenario)
    on_body = E * bodies[0].placement
    local = np.array([on_body.actInv(p) for p in points])
    if "face_point" in KEYS[kind].format(plane="face_point"):
        n = np.array([0, 0.1, 2.0]) / np.linalg.norm([0, 0.1, 2.0])
        np.testing.assert_allclose((local - [0, 0.01, 0]) @ n, 0.0, atol=1e-12)
    if kind == "face_on_vertex":
        assert np.linalg.norm(local[0] - [0, 0.01, 0]) == pytest.approx(0.003, abs=1e-12)
    if kind == "edge_on_edge":
        along = np.array([0, 1, 0.2]) / np.linalg.norm([0, 1, 0.2])
        n = on_body.rotation.T @ directions[0]
        across = np.cross(along, n)  # the line of force crosses the body's edge
        assert abs((local[0] - [0, 0.01, 0]) @ across) < 1e-12
        assert abs((local[0] - [0, 0.01, 0]) @ n) < 1e-12


REFUSED = {
    "unknown kind": (text("face_on_face").replace("face_on_face", "face_onface"), "'face_on_face'"),
    "no kind": (text("face_on_face").replace("type: face_on_face, ", ""), "for a contact cyl"),
    "missing key": (
        text("edge_on_edge").replace(", edge_outward: [-1, 0, 1]", ""),
        "contacts.pad: the key 'edge_outward' is missing: roughly out of the body",
    ),
    "key of another kind": (
        text("edge_on_face").replace("length: 6 cm", "size: 6 cm"),
        "contacts.pad.size: unknown key; known: name, body, face_point",
    ),
    "wrong unit": (
        text("face_on_face").replace("40 mm", "40 N"), "contacts.pad.size: expected a length"
    ),
    "length of nothing": (
        text("edge_on_face").replace("6 cm", "0 cm"), "contacts.pad.length: must be > 0"
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
        text("face_on_face", forces=["pad.1", "pad.3"]), "the contact 'pad.2' has no entry"
    ),
    "a force too many": (
        text("edge_on_edge", forces=["pad", "pad.1"]), "force.pad.1: no contact has this name"
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_does_not_fit_is_refused_with_line_key_and_cure(case):
    source, message = REFUSED[case]
    found = complaints(source)
    assert message in found, found
    assert re.search(r"f\.yaml:\d+:", found)


def test_force_of_one_magnitude_can_be_overridden():
    scenario = parse_scenario(text("face_on_face"), None, ["force.pad.2.0.value=7 N"])
    assert scenario.force["pad.2"][0].value == 7.0
    assert scenario.force["pad.1"][0].value == 3.0
    again = type(scenario).model_validate(scenario.as_dict())
    assert again == scenario


def test_only_contacts_that_push_are_kept_from_pulling():
    from osc_contact.runs.references import References

    for kind, pulls in (("edge_on_face", False), ("cylinder_in_hole", True)):
        scenario = parse_scenario(text(kind), None, ["force.pad.2.0.value=-1 N"])
        pairs = build_pairs(scenario)
        if pulls:
            References.of(scenario, pin.SE3.Identity(), pairs, np.zeros(6))
            continue
        with pytest.raises(ScenarioError, match=r"force\.pad\.2 asks for -1 N.*cannot pull"):
            References.of(scenario, pin.SE3.Identity(), pairs, np.zeros(6))
