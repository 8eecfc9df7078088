"""A ball on curved surfaces: kinds for the tests of all pairs, detection, fits, the task."""

import coal
import numpy as np
import pinocchio as pin
from complaints import contact_error, model_error, scenario_error
from numpy.linalg import norm
from numpy.random import default_rng
from pair_kinds import kind, placed, pose_of
from pytest import approx, fixture
from rigs import (
    STILL,
    any_rotation,
    assert_derivatives,
    assert_near,
    direction,
    largest,
    one_panda,
    posed,
    refused,
    shift,
    unit,
    unloaded,
    vector,
)
from samples import first, parametrize
from scenario_runs import judged, rig_of

import osc_contact as osc
from benchmarks import curved_faces
from osc_contact.contacts.detection import CollisionShape


def ball_on(surface, height, slopes, axis=2):
    """A kind: the surface for a scale, its height over x and y, the gradient of that; its z."""

    def make(rng, c):
        ball = rng.standard_normal(3)
        rho = 0.2
        X = pose_of(rng)
        S = c.X_E.actInv(X)
        pair = osc.SphereOnSurface(
            c.A(ball),
            rho * c.per_metre,
            surface(c.per_metre),
            c.per_metre * S.translation,
            2.0 * S.rotation[:, axis],
            S.rotation[:, 0] + 0.3 * S.rotation[:, axis],
        )

        def pose(q):
            x, y = 0.4 * np.tanh(q[3:])
            n = np.append(-np.array(slopes(x, y)), 1.0)
            place = vector(x, y, height(x, y)) + rho * n / norm(n)
            return placed(pin.exp3(q[:3]), ball, X.act(place))

        return (pair, pose, 1)

    return make


def bump(x, y):
    return 0.03 * x * x - 0.02 * x * y + 0.0004 * y**3 - 0.0001 * x**3 * y * y


def patch(scale):
    x, y = (one.ravel() for one in np.meshgrid(*[np.linspace(-0.8, 0.8, 25)] * 2))
    return osc.Surface.fitted(scale * np.array([x, y, bump(x, y)]).T, (1, 2))


R = 20.0  #: m; for differences whose steps are 0.13 m (`kkt_oracle`)
KINDS = {
    "sphere_on_surface": (
        lambda s: osc.Surface.sphere(s * R),
        lambda x, y: np.sqrt(R * R - x * x - y * y),
        lambda x, y: -vector(x, y) / np.sqrt(R * R - x * x - y * y),
    ),
    "ball_in_a_pipe": (
        lambda s: osc.Surface.cylinder(-s * R),
        lambda x, y: -np.sqrt(R * R - x * x),
        lambda x, y: (x / np.sqrt(R * R - x * x), 0.0),
        1,
    ),
    "ball_on_a_saddle": (
        lambda s: osc.Surface.saddle(s * R, -2.0 * s * R),
        lambda x, y: (x * x - 0.5 * y * y) / (2 * R),
        lambda x, y: (x / R, -0.5 * y / R),
    ),
    "ball_on_a_fit": (
        patch,
        bump,
        lambda x, y: (
            0.06 * x - 0.02 * y - 0.0003 * x * x * y * y,
            -0.02 * x + 0.0012 * y * y - 0.0002 * x**3 * y,
        ),
    ),
}
for _name, _how in KINDS.items():
    _make = ball_on(*_how)
    _make.__name__ = _name
    kind(_make)


# --- by hand and by detection ---------------------------------------------------------------------


@parametrize("R", [0.03, 0.1, 1.0])
@parametrize("face", ["sphere", "cylinder"])
def test_normals_gaps_and_points_are_those_of_the_shapes_that_touch(face, R):
    """Results are compared with those by hand and by detection."""
    rng = default_rng(5)
    pair = osc.SphereOnSurface([0.1, 0.2, -0.3], 0.012, getattr(osc.Surface, face)(R))
    solid = coal.Sphere(R) if face == "sphere" else coal.Cylinder(R, 10.0)
    ball = [CollisionShape("a", coal.Sphere(0.012), shift(pair.centre))]
    for _ in range(20):
        X_WE = pose_of(rng)
        n = rng.standard_normal(3)
        n[2] *= face == "sphere"
        n = unit(n)
        deep = 0.004 * rng.random()
        place = (R + 0.012 - deep) * n
        X_WO = X_WE * placed(any_rotation(rng), pair.centre, place)
        ours = pair.contact(X_WO, np.ones(6), X_WE)
        assert_near(ours.N[:3, 0], -X_WE.rotation @ n, atol=1e-10)
        assert pair.gaps(X_WO, X_WE)[0] == approx(-deep, abs=1e-12)
        assert_near(
            pair.points_of_contact(X_WO, X_WE)[:, 0], X_WE.act(place - 0.012 * n), atol=1e-10
        )
        (found,) = osc.detect(ball, X_WO, [CollisionShape("e", solid)], X_WE)
        assert isinstance(found.pair(), osc.SphereOnSurface)
        other = found.pair().contact(X_WO, np.ones(6), X_WE)
        assert_near(other.N, ours.N, atol=1e-9)
        assert_near(other.n_gamma, ours.n_gamma, atol=1e-8)


def test_what_no_ball_can_touch_is_refused():
    pair = osc.SphereOnSurface(np.zeros(3), 0.012, osc.Surface.sphere(0.1))
    with contact_error("no one place of the surface is nearest"):
        pair.contact(pin.SE3.Identity(), STILL)
    with refused("x axis of the surface"):
        osc.SphereOnSurface(np.zeros(3), 0.0, osc.Surface.sphere(1.0), surface_axis=[1, 0, 0])


def test_a_fit_states_its_error_and_refuses_too_few_points(tmp_path):
    curved_faces.saddle_mesh(tmp_path / "saddle.obj", 0.1)
    fit = osc.Surface.of_mesh(tmp_path / "saddle.obj")
    assert fit.rms <= fit.worst < 5e-9  # of 32-bit numbers
    rng = default_rng(2)
    x, y = rng.uniform(-1, 1, (2, 3000))
    z = np.sin(3 * x) * np.cos(2 * y)
    rough = osc.Surface.fitted(np.array([x, y, z + 1e-3 * rng.standard_normal(3000)]).T)
    assert rough.rms == approx(1e-3, rel=0.1) and rough.worst > 3 * rough.rms
    ball = osc.SphereOnSurface(np.zeros(3), 0.0, rough)
    assert largest([ball.gaps(shift(p))[0] for p in np.array([x, y, z]).T[:50]]) < 2e-3
    with refused("do not determine a spline of 8 × 8 cells"):
        osc.Surface.fitted(rng.standard_normal((40, 3)))
    with model_error("no mesh is read"):
        osc.Surface.of_mesh(tmp_path / "none.stl")


def normal(pair, X_WO):
    """(3,) of the surface, into the part."""
    return pair.contact(X_WO, STILL).N[:3, 0]


class Own(osc.SphereOnSurface):
    """Equivalent pair that only Python evaluates."""

    def contact(self, *args):
        return super().contact(*args)


@parametrize("kind", [osc.SphereOnSurface, Own])
def test_a_misplaced_ball_is_turned_to_where_it_is(kind):
    """n + δ/d, normalised, is the normal of the ball moved by δ, d away; N is W(n, p) then."""
    chain = one_panda()
    rng = default_rng(4)
    q, v, X = posed(chain, rng)
    centre = 0.1 * rng.standard_normal(3)
    at = X.act(centre) + 0.112 * direction(rng)
    pair = kind(centre, 0.012, osc.Surface.sphere(0.1), at)
    controller = osc.Controller(chain, [pair])
    assert controller.reading == "least_squares"
    measurement = unloaded(q, v)
    reference = osc.Reference(X, 0.3 * rng.standard_normal(6), alpha_d=[10.0])
    controller.tick(measurement, reference)
    delta = 0.004 * rng.standard_normal(3)
    controller.records.memory.columns[0].turn[:] = delta / 0.112
    controller.tick(measurement, reference)
    n = normal(osc.SphereOnSurface(centre, 0.012, osc.Surface.sphere(0.1), at + delta), X)
    column = controller.records.work.columns[0]
    p = X.rotation @ centre + 0.012 * (normal(pair, X) if kind is Own else n)
    assert_near(column.point, p, atol=1e-12)
    assert_near(controller.signals.contact.N[:, 0], np.append(n, np.cross(p, n)), atol=1e-12)


# --- in a scenario --------------------------------------------------------------------------------


@fixture
def task(tmp_path, own_plants):
    osc.register_plant("tangent_plane")(curved_faces.tangent_plane)
    return lambda face="sphere", R=0.1, **changes: curved_faces.scenario(tmp_path, face, R, changes)


def test_references_touch_all_the_way_and_are_derivatives_of_one_another(task):
    raster = {"kind": "surface", "contact": "nose", "direction": [1, 0, 0], "dwell": 0.1}
    raster |= {"raster": [0.04, 0.02, 3], "feed": 0.1}
    for face, more in (("saddle", []), ("sphere", [raster])):
        scenario = task(face)
        scenario = scenario.replaced(motion=[*more, *([] if more else scenario.motion)])
        rig = rig_of(scenario)
        (pair,) = rig.pairs
        for t in (0.3, 1.3, 2.1):
            at = assert_derivatives(rig.references.at, t, 1e-4, 2e-6, 1e-4)
            assert abs(pair.gaps(at.X_WD)[0]) < 1e-15
            start = rig.references.at(0.0).X_WD
            turned = at.X_WD.rotation @ start.rotation.T @ normal(pair, start)
            assert_near(turned, normal(pair, at.X_WD), atol=1e-12)


def test_a_raster_rests_at_its_corners_and_a_loop_takes_it(task):
    rig = rig_of(task())
    (pair,) = rig.pairs
    how = {"direction": [1, 0, 0], "force": 8.0, "raster": [0.04, 0.02, 2], "feed": 0.1}
    all_of_it = list(osc.surface_references(pair, rig.state.X_WO, 2e-3, dwell=0.2, **how))
    speed = np.array([norm(one.V_D[:3]) for one in all_of_it])
    resting = np.flatnonzero(np.diff((speed < 1e-9).astype(int)) == 1)
    assert len(resting) >= 3 and speed.max() < 0.35 and all_of_it[-1].alpha_d == [8.0]
    with refused("along the normal"):
        next(osc.surface_references(pair, rig.state.X_WO, 1e-3, direction=[0, 0, 1], force=1.0))
    move = {"kind": "surface", "contact": "tip", "direction": [1, 0, 0]}
    with scenario_error("'tip' is no contact of type sphere_on_surface"):
        rig_of(task().replaced(motion=[move]))


def test_a_force_may_be_a_file(task, tmp_path):
    t = np.linspace(0.0, 3.0, 61)
    force = 10.0 + np.sin(3.0 * t)
    np.savetxt(tmp_path / "force.csv", np.column_stack((t, force)), delimiter=",")
    signal = {"type": "points", "points": "force.csv"}
    scenario = task().replaced(force={"nose": [signal]})
    assert_near(rig_of(scenario).references.forces(t)[0], force, atol=1e-12)
    assert type(scenario).from_dict(scenario.as_dict()) == scenario  # the points, not the name
    (tmp_path / "force.csv").write_text("0, 1\n1, a\n")
    with scenario_error("a CSV file with lines 'time, value'"):
        task().replaced(force={"nose": [signal]})


@parametrize("case", first(["custom pair", *list(curved_faces.CASES)[:3]]))
def test_a_tool_follows_a_curved_face(task, case):
    """The table of docs/polish_curved_part.md, its hardest rows."""
    own = case == "custom pair"
    scenario = task("sphere" if own else "saddle", **curved_faces.CASES.get(case, {}))
    if own:
        (pair,) = rig_of(scenario).pairs
        pair = Own(pair.centre, pair.radius, pair.surface, pair.surface_point, name="nose")
        scenario = scenario.replaced(contacts=[{"pair": pair, "body": "part"}])
        rubbing = {"plant": {**scenario.plant.model_dump(), "friction": 0.2}}
        packaged = judged(task().replaced(**rubbing))
        scenario = scenario.replaced(**rubbing)
    found = judged(scenario)
    assert not own or found == approx(packaged, rel=0.01)
    assert found < (5e-4 if case == "no friction" else 0.03 if "3 mm" in case else 0.01)
