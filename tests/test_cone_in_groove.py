"""Fig. 2 held by a Panda: geometry, references, decoupling and the continuity of N."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
from command_line import done, read_json
from numpy.linalg import inv, matrix_rank, norm
from pytest import approx, mark
from rigs import STILL, assert_derivatives, assert_near, largest, refused, rotated, shift, vector
from samples import aligned, names_in

import osc_contact as osc
from paper import cone_in_groove as cg
from paper.baselines import measured_coupling
from paper.selection_laws import Instant

SEAT = cg.Seat()


@cache
def rig():
    return osc.build_rig(cg.cone_scenario(SEAT))


@cache
def short_run():
    return cg.run(0.62, (0.51, 0.53, 0.55, 0.57))


def test_the_simulation_before_the_start_learns_no_joint_friction():
    """Its wrists read zero: taken for a rotor, this ended the motion of fig. 2 in a stop."""
    whole = osc.build_rig(cg.cone_scenario(SEAT, 5.0))
    assert osc.preflight(whole) == ()


def pose_at(turn, slide):
    """The cone turned about its axis and moved along the groove, by products of poses."""
    X = rig().state.X_WO
    about = rotated(pin.exp3(turn * SEAT.cone_axis))
    to_apex = shift(SEAT.apex)
    return shift(slide * SEAT.direction) * X * to_apex * about * to_apex.inverse()


# Geometry -----------------------------------------------------------------------------------------


def test_the_cone_lies_on_both_walls_and_in_neither():
    """The lowest line of its side, of all lines at the half angle to its axis."""
    X = rig().state.X_WO
    axis = X.rotation @ SEAT.cone_axis
    for wall, generator in aligned(SEAT.normals, SEAT.generators):
        assert (X.act(SEAT.apex) - SEAT.point) @ wall == approx(0.0, abs=1e-12)
        up = axis @ wall
        assert up - np.tan(SEAT.half_angle) * np.sqrt(1.0 - up**2) == approx(0.0, abs=1e-12)
        assert abs(generator @ wall) < 1e-12, "along a line of the wall"
        assert abs(norm(generator) - 1) < 1e-12
        assert np.arccos(generator @ SEAT.axis) == approx(SEAT.half_angle)
        assert wall[2] > 0.0 and abs(wall @ SEAT.direction) < 1e-12
    one, other = SEAT.normals
    assert one @ other == approx(np.cos(np.deg2rad(60.0)))


def test_inertia_is_that_of_a_stack_of_discs():
    inertia = rig().chain.payload.inertia
    n = 4000
    z = (np.arange(n) + 0.5) / n * SEAT.height
    radius = z * np.tan(SEAT.half_angle)
    m = radius**2 / (radius**2).sum() * inertia.mass
    centres = SEAT.apex + z[:, None] * SEAT.cone_axis
    whole = pin.Inertia.Zero()
    for mass, r, centre in aligned(m, radius, centres):
        disc = 0.25 * mass * r**2 * (np.eye(3) + np.outer(SEAT.cone_axis, SEAT.cone_axis))
        whole += pin.Inertia(mass, centre, disc)
    assert_near(inertia.lever, whole.lever, atol=1e-8)
    assert_near(inertia.inertia, whole.inertia, atol=1e-9, rtol=1e-5)


def test_N_is_spanned_by_pushes_on_the_walls_and_T_by_inspection():
    """t₁ = [axis × (O − apex)…], t₂ = [e; 0]; pushes normal to the walls do no work on either."""
    rng = np.random.default_rng(0)
    e = SEAT.direction
    for _ in range(20):
        X = pose_at(rng.uniform(-3, 3), rng.uniform(-0.1, 0.1))
        contact = SEAT.pair.contact(X, STILL)
        assert_near(SEAT.pair.gaps(X), 0.0, atol=1e-14)
        points, directions = SEAT.wall_forces(X)
        levers = points - X.translation[:, None]
        lines = np.vstack((directions, np.cross(levers, directions, axis=0)))
        axis = X.rotation @ SEAT.cone_axis
        T = np.array([[*np.cross(axis, X.translation - X.act(SEAT.apex)), *axis], [*e, 0, 0, 0]]).T
        assert largest(lines.T @ T) < 1e-14
        assert largest(contact.N.T @ T) < 1e-14
        assert matrix_rank(lines) == 4
        assert_near(contact.N @ SEAT.from_wall_forces, lines, atol=1e-13)


def test_references_move_as_their_derivatives_say_and_stay_in_contact():
    task = rig().references
    to_walls = inv(SEAT.from_wall_forces)
    for t in np.linspace(0.2, 4.5, 12):
        now = assert_derivatives(task.at, t, 1e-4, 1e-5, 1e-4)
        assert_near(SEAT.pair.gaps(now.X_WD), 0.0, atol=1e-9)
        turn, slide = SEAT.motion(now.X_WD)
        assert_near(now.X_WD.homogeneous, pose_at(turn, slide).homogeneous, atol=1e-9)
    whole = task.over(np.linspace(0, 5, 500))
    assert np.ptp([SEAT.motion(one.X_WD)[0] for one in whole]) > 1.0
    assert (whole.alpha_d @ to_walls.T)[30:].min() > 0.0


# Plant and controller -----------------------------------------------------------------------------


def test_forces_and_motions_are_controlled_at_once_and_do_not_couple():
    found = short_run().data
    assert found["force_step_to_motion"] <= 1e-9 and found["motion_step_to_force"] <= 1e-9
    assert found["wall_force_peak_error_N"] < 0.15 and max(found["wall_force_rms_N"]) < 0.05
    assert found["turn_rms_rad"] < 1e-4 and found["slide_rms_m"] < 1e-5
    assert found["turned_rad"] > 0.4 and found["slid_m"] > 0.02
    assert found["wall_force_least_N"] > 3.0, "the walls are pushed, never pulled"
    assert found["contact_power_W"] < 1e-12
    made = short_run().recording
    assert not made["status"].any()
    assert largest(np.einsum("tir,ti->tr", made["N"], made["twist"])) < 1e-9, "N has couples"
    assert largest(np.diff(made["N"], 2, axis=0)) < 0.02 * largest(np.diff(made["N"], axis=0))
    assert (np.abs(np.diff(short_run().walls["alpha_cmd"][500:], axis=0)).max(axis=0) > 2.0).all()


def test_a_controller_with_a_wrong_seat_couples():
    """The coupling measured is not zero by construction."""
    wrong = replace(SEAT.pair, axis=pin.exp3(vector(0.0, 0.1, 0.0)) @ SEAT.pair.axis)
    controller = osc.Controller(rig().chain, [wrong], posture=rig().q_start)
    law = SimpleNamespace(install=lambda _: controller.with_gains(rig().gains))
    instant = Instant(rig().state, rig().contact)
    assert min(measured_coupling(rig(), law, instant, t=1.5).norms) > 1e-4


@mark.parametrize("words", [{"duration": 0.5}, {"duration": np.nan}])
def test_a_run_that_cannot_be_judged_is_refused(words):
    with refused(r"judged from t = 0\.5 s"):
        cg.run(**words)


def test_reproduce_fig2_writes_pictures_and_numbers(tmp_path):
    result = done("reproduce fig2 --duration 0.52 --out", tmp_path)
    pictures = ("fig2", "fig2_forces", "fig2_motion")
    names = {f"{n}.{s}" for n in pictures for s in ("png", "svg", "pdf")} | {"fig2.json"}
    assert names_in(tmp_path) == names
    found = read_json(tmp_path / "fig2.json")
    assert found["r"] == 4 and found["raibert_craig"]["describes_it"] is False
    assert found["duration_s"] == 0.52 and found["force_step_to_motion"] < 1e-9
    assert "32° apart" in " ".join(result.stdout.split())
