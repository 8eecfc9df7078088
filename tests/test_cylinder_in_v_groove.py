"""A cylinder in a V-groove: its kind for the tests of all pairs, its walls, and a task."""

import numpy as np
from pair_kinds import about, carrying, in_plane, kind, placed, two_lines
from rigs import STILL, assert_near, refused, shift, vector
from samples import parametrize
from scenario_runs import verdict_of

import osc_contact as osc


@kind
def cylinder_in_v_groove(rng, c):
    point, e, foot, g = two_lines(rng)
    rho = 0.15
    angle = rng.uniform(0.6, 2.2)
    out = in_plane(g)[0]
    R0 = carrying(e, g)
    seat = foot + rho / np.sin(angle / 2) * out
    pair = osc.CylinderInVGroove(
        c.A(point),
        e,
        rho * c.per_metre,
        c.E(foot),
        c.along_E(2.0 * g),
        c.along_E(out + 0.4 * g),
        angle,
        0.4 * c.per_metre,
    )
    return (pair, lambda q: placed(about(g, q[0]) @ R0, point, seat + q[1] * g), 4)


def test_each_wall_is_pushed_at_right_angles_from_inside():
    """A square groove along y that opens upwards, its walls 45° to each side."""
    pair = osc.CylinderInVGroove([0, 0, 0], [0, 1, 0], 0.1, [0, 0, 0], [0, 1, 0], [0, 0, 1])
    X = shift([0.0, 0.3, 0.1 * np.sqrt(2)])
    assert_near(pair.gaps(X), 0.0, atol=1e-15)
    forces = pair.contact(X, STILL).N[:3]
    right = vector(1.0, 0.0, -1.0) / np.sqrt(2)
    left = vector(-1.0, 0.0, -1.0) / np.sqrt(2)
    assert_near(forces.T, [right, left, right, left], atol=1e-15)
    assert_near(pair.gaps(shift(X.translation + [0, 0, 0.01])), 0.01 / np.sqrt(2), atol=1e-15)


@parametrize("wrong", [{"groove_angle": 3.2}, {"groove_outward": [0, 2, 0]}])
def test_a_groove_without_walls_is_refused(wrong):
    good = {"groove_direction": [0, 1, 0], "groove_outward": [0, 0, 1]}
    with refused("rod: the walls enclose"):
        osc.CylinderInVGroove([0, 0, 0], [0, 1, 0], 0.1, [0, 0, 0], **{**good, **wrong}, name="rod")


def test_four_forces_are_held_while_the_cylinder_slides_and_rolls():
    along = "[0.69282, 0.5, 0.519615]"
    contact = (
        f"{{name: rod, type: cylinder_in_v_groove, body: table, point: [0, 0, 0], "
        f"direction: [1, 0, 0], radius: 30 mm, length: 60 mm, groove_point: [-26 mm, 0, 0], "
        f"groove_direction: {along}, groove_outward: [-1, 0, 1], groove_angle: 80 deg}}"
    )
    wave = "{type: sine, amplitude: 2 N, frequency: 1 Hz, ramp: 0.5 s}"
    forces = ", ".join(f"rod.{k}: [{{type: constant, value: 8 N}}, {wave}]" for k in (1, 2, 3, 4))
    slide = "{type: sine, amplitude: 20 mm, frequency: 1 Hz, ramp: 0.5 s}"
    roll = "{type: sine, amplitude: 10 deg, frequency: 1 Hz, ramp: 0.5 s}"
    scenario = osc.load_scenario(
        "panda_edge",
        [
            f"contacts=[{contact}]",
            f"force={{{forces}}}",
            "plant.type=rigid",
            "plant.step=1 ms",
            f"motion=[{{kind: linear, direction: common_tangent, signals: [{slide}]}}, "
            f"{{kind: angular, direction: {along}, signals: [{roll}]}}]",
        ],
    )
    found = verdict_of(scenario, duration=1.2)
    for k in (1, 2, 3, 4):
        assert found["force"][f"rod.{k}"]["rms_error_rel"] < 2e-3
    assert found["motion"]["rms_error_m"] < 2e-5 and found["motion"]["rms_error_rad"] < 2e-4
    assert found["contact_fraction"] == {"rod": 1.0}
