"""Colours of COLLADA meshes: by material, in the order of the file's triangles."""

import numpy as np
import pinocchio as pin
from numpy.testing import assert_allclose
from pytest import mark

from osc_contact import robots
from osc_contact.visual.shapes import triangle_colours, vertex_colours

DAE = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<library_effects>
 <effect id="r-fx"><profile_COMMON><technique sid="t"><phong>
  <diffuse><color>1 0 0 1</color></diffuse></phong></technique></profile_COMMON></effect>
 <effect id="b-fx"><profile_COMMON><technique sid="t"><phong>
  <diffuse><color>0 0 1 1</color></diffuse></phong></technique></profile_COMMON></effect>
</library_effects>
<library_materials>
 <material id="red"><instance_effect url="#r-fx"/></material>
 <material id="blue"><instance_effect url="#b-fx"/></material>
</library_materials>
<library_geometries>
 <geometry id="g"><mesh>
  <triangles material="one" count="2"/><triangles material="two" count="1"/>
 </mesh></geometry>
</library_geometries>
<library_visual_scenes><visual_scene id="s"><node><instance_geometry url="#g">
 <bind_material><technique_common>
  <instance_material symbol="one" target="#red"/><instance_material symbol="two" target="#blue"/>
 </technique_common></bind_material>
</instance_geometry></node></visual_scene></library_visual_scenes>
</COLLADA>
"""
RED = (0.88, 0.14, 0.14)
BLUE = (0.14, 0.14, 0.88)


def test_triangles_have_the_colours_of_their_materials(tmp_path):
    file = tmp_path / "two.dae"
    file.write_text(DAE)
    assert_allclose(triangle_colours(file, 3), [RED, RED, BLUE], atol=1e-12)
    found = vertex_colours(file, np.array([[0, 1, 2], [2, 1, 3], [4, 5, 6]]), 7)
    assert_allclose(found, [RED] * 4 + [BLUE] * 3, atol=1e-6)


@mark.parametrize(
    "name, text, count",
    [
        ("two.stl", DAE, 3),
        ("two.dae", DAE, 4),
        ("two.dae", "<COLLADA", 3),
        ("two.dae", DAE.replace('count="2"', 'count="many"'), 3),
        ("two.dae", '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema"/>', 0),
    ],
)
def test_what_is_not_told_is_not_guessed(name, text, count, tmp_path):
    (tmp_path / name).write_text(text)
    assert triangle_colours(tmp_path / name, count) is None


def test_the_pandas_hand_is_white_with_dark_parts():
    """Its DAE tells 1 1 1 and 0.25 0.25 0.25 among others; read with Pinocchio's triangles."""
    path, folders = robots.locate("panda")
    _, geometry, _ = robots.load_geometry(path, pin.GeometryType.VISUAL, folders)
    (hand,) = [shape for shape in geometry.geometryObjects if shape.name == "panda_hand_0"]
    colours = triangle_colours(hand.meshPath, hand.geometry.num_tris)
    assert colours is not None and len(colours) == hand.geometry.num_tris
    grey = np.ptp(colours, axis=1) < 0.03
    assert grey.mean() > 0.9, "no colour but grey"
    assert 0.3 < (colours[:, 0] < 0.4).mean() < 0.6, "the dark parts: 2798 of 7078 triangles"
