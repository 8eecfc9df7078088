"""Collision shapes from URDF files, and what detection refuses."""

import coal
import numpy as np
import pinocchio as pin
from complaints import invalid_input, model_error
from detection_bodies import BOX, CORNERS, TABLE, only, standing
from numpy.testing import assert_allclose
from pytest import approx, mark
from rigs import shift

from osc_contact import robots
from osc_contact.contacts.detection import CollisionShape, collision_shapes, detect
from osc_contact.contacts.detection.features import nearest


def test_shapes_of_a_urdf_have_the_names_and_places_of_the_file():
    shapes = {s.name: s for s in collision_shapes(robots.urdf_path("rod.urdf"))}
    assert list(shapes) == ["shaft", "left_end", "right_end"]
    assert_allclose(shapes["left_end"].placement.translation, [-0.29, 0, 0])
    assert shapes["right_end"].shape.radius == 0.01
    assert shapes["shaft"].shape.halfLength == 0.29
    assert_allclose(shapes["shaft"].solid.axis, [1, 0, 0], atol=1e-9)


def urdf(tmp_path, collision, joint=""):
    link = f'<link name="a">{collision}</link>'
    tail = '<link name="b"/>' + joint if joint else ""
    path = tmp_path / "body.urdf"
    path.write_text(f'<robot name="body">{link}{tail}</robot>')
    return path


BLOCK = '<collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision>'
MESH = '<collision><geometry><mesh filename="{}" scale="2 2 2"/></geometry></collision>'


def stl(path, corners, faces):
    lines = ["solid s"]
    for face in faces:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += [f"vertex {x} {y} {z}" for x, y, z in corners[list(map(int, face))]]
        lines += ["endloop", "endfacet"]
    path.write_text("\n".join([*lines, "endsolid s"]))


CUBE_FACES = ["013", "032", "467", "475", "045", "051", "237", "276", "026", "064", "157", "173"]


def test_a_convex_mesh_touches_like_the_box_it_is(tmp_path):
    stl(tmp_path / "box.stl", CORNERS / 2, CUBE_FACES)  # the URDF doubles it
    mesh = collision_shapes(urdf(tmp_path, MESH.format("box.stl")))
    assert mesh[0].name == "a_0"
    assert mesh[0].solid.corners.shape == (8, 3)
    for roll, pitch, r in ((0, 0, 3), (0.4, 0, 2), (0.4, 0.6, 1)):
        X = standing(pin.rpy.rpyToMatrix(roll, pitch, 0), CORNERS, np.random.default_rng(r))
        as_mesh = only(detect(mesh, X, TABLE))
        as_box = only(detect(BOX, X, TABLE))
        assert as_mesh.r == as_box.r == r
        assert as_mesh.kind == as_box.kind
        for point in as_box.points:
            assert np.linalg.norm(as_mesh.points - point, axis=1).min() < 1e-7  # STL: float32


@mark.parametrize("faces", [["021", "013", "032", "123"], ["012", "013", "023", "132"]])
def test_a_convex_mesh_that_is_no_mirror_image_of_itself(tmp_path, faces):
    """A tetrahedron on its face: outward normals are outward whatever the order of corners."""
    corners = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])
    stl(tmp_path / "wedge.stl", corners / 2, faces)
    mesh = collision_shapes(urdf(tmp_path, MESH.format("wedge.stl")))
    found = only(detect(mesh, pin.SE3.Identity(), TABLE))
    assert (found.kind, found.r) == ("face on face", 3)
    assert found.distance == approx(0.0, abs=1e-9)
    assert_allclose(found.normal, [0, 0, 1], atol=1e-9)
    assert detect(mesh, shift([0, 0, 0.01]), TABLE) == []


def test_a_distance_that_is_no_number_counts_as_touching(monkeypatch):
    """The shapes have the last word, see `separation`."""
    monkeypatch.setattr(coal, "distance", lambda *_: np.finfo(float).max)
    X = shift([0, 0, 0.03])
    assert nearest(BOX[0].shape, X, TABLE[0].shape, X).distance == 0.0
    assert only(detect(BOX, X, TABLE)).kind == "face on face"


SWING = '<joint name="swing" type="continuous"><parent link="a"/><child link="b"/></joint>'
DENTED = [*(f for f in CUBE_FACES if f not in ("467", "475")), "468", "678", "758", "548"]


@mark.parametrize(
    "collision, joint, message",
    [
        ("", "", "no link has a <collision>"),
        (BLOCK, SWING, "swing"),
        (MESH.format("absent.stl"), "", "absent.stl"),
        (MESH.format("dent.stl"), "", "not convex"),
    ],
)
def test_files_that_are_no_body_are_refused(tmp_path, collision, joint, message):
    stl(tmp_path / "dent.stl", np.vstack((CORNERS, [[0.01, 0.0, 0.0]])), DENTED)
    with model_error(message):
        collision_shapes(urdf(tmp_path, collision, joint))
    with model_error(r"nowhere\.urdf"):
        collision_shapes("nowhere.urdf")


def test_bad_input_is_refused_at_the_door():
    X = pin.SE3.Identity()
    for options in ({"margin": 0.0}, {"margin": np.nan}, {"angle": 0.0}, {"angle": 0.5}):
        with invalid_input(next(iter(options))):
            detect(BOX, X, TABLE, **options)
    with invalid_input("Ellipsoid"):
        CollisionShape("egg", coal.Ellipsoid(1, 2, 3))
    puffed = coal.Box(1, 1, 1)
    puffed.setSweptSphereRadius(0.01)
    with invalid_input("swept"):
        CollisionShape("puffed", puffed)
