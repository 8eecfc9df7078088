"""Internal forces of three or more arms: what can be set, commands, limits, a run.

That each bar carries its command is judged in `test_law_kkt`.
"""

from dataclasses import replace

import numpy as np
from complaints import invalid_input
from grasp_rigs import KINDS, random_case
from law_calls import bars, records, write
from numpy.linalg import cholesky, pinv, qr, solve, svd
from numpy.random import default_rng
from rigs import assert_close, assert_near, held_tick, largest, rig_of, unit, vector, within
from samples import aligned, module_fixture, parametrize
from scenario_runs import run_of

import osc_contact as osc
from osc_contact.dynamics.arm import effort_scale
from osc_contact.lab.runs.run import start


def bars_of(points):
    """E (3k, bars): unit bar forces on the object, pushing each pair of grasps together."""
    k = len(points)
    columns = []
    for i in range(k):
        for j in range(i + 1, k):
            f = np.zeros((k, 3))
            f[i] = unit(points[j] - points[i])
            f[j] = -f[i]
            columns.append(f.ravel())
    return np.array(columns).T


def spans(A, tolerance, size=None):
    """Orthonormal columns: what A (m, n) spans, and what it takes to zero; `size` of its values."""
    U, s, Vh = svd(A)
    rank = np.count_nonzero(s > tolerance * (s.max(initial=0.0) if size is None else size))
    return (U[:, :rank], Vh[rank:].T)


def settable_bars(state, chain):
    """Levers (bars, n) of joint torques on bars, and the combinations (bars, s) that motors set.

    Left out are dependent bars, what the arms' structure carries, what no torques in null(G) make.
    """
    tolerance = chain.angle_tolerance
    root = np.sqrt(chain.reference.inertia.mass)
    with np.errstate(invalid="ignore"):
        E = np.nan_to_num(bars_of(state.grasp_points))  # no bar between grasps in one place
    share = np.split(pinv(E, rcond=tolerance), len(chain.arms), axis=1)
    levers = np.hstack([own @ arm.J_bar[:, :3].T for own, arm in aligned(share, state.arms)])
    carried = np.hstack([own @ arm.C[:3] / root for own, arm in aligned(share, state.arms)])
    basis = spans(E.T, tolerance)[0]
    basis = basis @ spans(carried.T @ basis, tolerance, 1.0)[1]
    known = np.isfinite(chain.tau_max)
    effort = np.where(known, chain.tau_max, chain.tau_max[known].max(initial=0.0) or 1.0)
    quiet = spans(state.G * effort, 1e-9)[1]
    U, size, Vh = svd(basis.T @ (levers[:, chain.actuated] * effort), full_matrices=False)
    some = size > 1e-9 * size.max(initial=0.0)
    # by the angle to null(G): an arm near a singular posture makes some forces all too easily
    apart = spans(Vh[some] @ quiet, tolerance, 1.0)[0]
    return (levers, basis @ qr((U[:, some] * size[some]) @ apart)[0])


@module_fixture
def plate():
    """Rig with gains for one mass."""
    gains = "gains={force: {integral: 10, damping: 3000}}"
    return rig_of("three_arm_plate", gains)


def test_commands_that_do_not_fit_the_bars_are_held(plate):
    measurement = plate.plant().measure()
    reference = plate.references.at(0.0)
    fast = plate.controller()
    pair = rig_of("two_contact_rod")
    desired = replace(pair.references.at(0.0), squeeze_d=vector(5.0, 5.0))
    held_tick(pair.controller(), "2 arms take a number", pair.plant().measure(), desired)
    for bad in (np.zeros(2), vector(1.0, np.nan, 0.0), np.nan, [1, 2]):
        held = held_tick(fast, "squeeze_d", measurement, replace(reference, squeeze_d=bad))
        assert np.isfinite(held).all()
    for bad in (np.zeros((3, 1)), "5 N"):
        with invalid_input("reference squeeze_d: expected"):
            replace(reference, squeeze_d=bad)


def test_motor_limits_take_it_first(plate):
    """4 kN cannot be had: forces and motion are hardly touched, the loss is reported by bar."""
    measurement = plate.plant().measure()
    reference = plate.references.at(0.0)
    controller = plate.controller()
    controller.tick(measurement, reference)
    squeeze = vector(4000.0, 100.0, 50.0)
    tau = controller.tick(measurement, replace(reference, squeeze_d=squeeze))
    assert controller.status is osc.Status.SATURATED
    assert within(tau, plate.chain.tau_max)
    lost = controller.given_up
    assert lost.squeeze.shape == (3,) and lost.squeeze[0] > 1000.0
    assert largest(lost.acceleration) < 0.1 and largest(lost.force) < 1.0
    assert_near(controller.result().squeeze, squeeze - lost.squeeze, rtol=1e-9)


def test_a_squeezed_plate_stays_within_its_limits():
    """On MuJoCo: 10 N in every side of the triangle while three contact forces are controlled."""
    recording = run_of("three_arm_plate", "squeeze=10 N", duration=1.5)
    for name, force in osc.metrics(recording)["force"].items():
        assert force["rms_error_rel"] <= 0.01, name
    assert recording["squeeze"].shape == (len(recording), 3)
    assert_near(recording["squeeze"], 10.0, atol=1e-6)
    # at first the gaps are zero up to rounding, and the forces rise from zero
    assert recording["closed"][10:].all()


@parametrize("name", ["two_contact_rod", "three_arm_plate"])
def test_a_step_of_the_squeeze_is_let_in_within_the_rise_time(name):
    rig = rig_of(name, "gains.force={rise: 50 ms}")
    plant, controller = start(rig)
    desired = rig.references.at(0.0)
    arms = len(rig.chain.arms)
    squeezes = []
    for k in range(120):
        step = np.full(3, 20.0 * (k >= 40)) if arms > 2 else 20.0 * (k >= 40)
        tau = controller.tick(plant.measure(), replace(desired, squeeze_d=step))
        plant.command(tau, controller.dt)
        assert controller.status is osc.Status.OK
        squeezes.append(controller.result().squeeze.copy())
    x = np.clip(np.arange(-40, 80) / 50, 0.0, 1.0)
    expected = 20.0 * (10.0 * x**3 - 15.0 * x**4 + 6.0 * x**5)
    assert_near(squeezes, np.broadcast_to(expected[:, None], np.shape(squeezes)), atol=1e-6)
    assert largest(np.diff(squeezes, axis=0)) < 0.8, "20 N in one tick without a rise"


# The law's own computation ------------------------------------------------------------------------


def answer(state, chain):
    """(levers, basis (bars, s)) of the law; NaN where answers and scratch stand before."""
    t = records(len(chain.arms), chain.nq, angle_tolerance=chain.angle_tolerance)
    of_arms = t.model.arms
    write(of_arms, first=[s.start for s in chain.slices], end=[s.stop for s in chain.slices])
    t.model.joints.effort[chain.actuated] = effort_scale(chain.tau_max) ** 2
    L = cholesky(state.metric)
    V, beta = qr(solve(L, state.C), mode="raw")
    reflectors = np.triu(V, 1) + np.eye(*V.shape)
    locked = np.hstack([arm.C[:3] for arm in state.arms]).T
    owners = np.repeat(np.arange(len(chain.arms)), [arm.C.shape[1] for arm in state.arms])
    t.work.joints.J_bar = np.vstack([solve(L, arm.J_bar.T).T for arm in state.arms])
    carried = locked / np.sqrt(chain.reference.inertia.mass)
    work = t.work
    write(work, points=state.grasp_points, carried=carried, owners=owners, locked=len(beta))
    write(work, reflectors=reflectors, beta=beta)
    work.axes[0] = L[:3, :3].T
    tables = (work.bar_inverse, work.bar_effects, work.bar_torques, work.moving_torques)
    for out in (work.levers, work.basis, *tables):
        out[:] = np.nan
    s = bars.settable_bars(t, len(locked))
    basis = work.basis[:, :s]
    assert_near(basis.T @ basis, np.eye(s), atol=1e-12)
    assert s < len(work.levers) or (work.basis == np.eye(s)).all()
    return (work.levers, basis)


def assert_same(got, expected):
    """Check for equal levers and bases with the same span."""
    assert_near(got[0], expected[0], atol=1e-10 * largest(expected[0]), rtol=0)
    assert got[1].shape == expected[1].shape
    assert_close(got[1] @ got[1].T, expected[1] @ expected[1].T, tolerance=1e-9)


def without_motors(case, rng, share):
    """A share of the joints of one arm lose theirs."""
    arms = list(case.chain.arms)
    i = int(rng.integers(len(arms)))
    names = list(arms[i].model.names)[1:]
    limp = tuple(name for name in names if name in arms[i].passive_joints or rng.random() < share)
    arms[i] = replace(arms[i], passive_joints=limp)
    parts = (arms, case.chain.grasps, case.chain.payload)
    return replace(case, chain=osc.ClosedChain(*parts, allow_unactuated=True))


def moved_points(points, how, rng):
    """Grasp points in a plane or nearly so, in a line, two in one place."""
    points = points.copy()
    if how == "plane":
        size = rng.choice([0.0, 10 ** rng.uniform(-5, -1)])
        points[:, 2] = points[0, 2] + size * rng.uniform(-1, 1, len(points))
    elif how == "line":
        points = points[0] + np.outer(rng.uniform(-1, 1, len(points)), rng.standard_normal(3))
    elif how == "same":
        points[1] = points[0]
    return points


def draw(how, rng):
    """A random chain of three to five arms, and its state."""
    k = int(rng.integers(3, 6))
    bends = None
    if how == "near singular":
        bends = rng.uniform(0.5, 1.5, k)
        bends[rng.integers(k)] = 10 ** rng.uniform(-6, -1)
    pool = ["scara", "2R", "3R"] if how == "structure" else ["ur5", "panda", "scara"]
    kinds = {"grasps": KINDS, "motors": KINDS[:3], "slides": KINDS[3:], "strong": KINDS[3:]}
    arms = rng.choice(pool, k)
    kinds = rng.choice(kinds.get(how, ["rigid"]), k)
    case = random_case(list(arms), list(kinds), rng, bends, upright=how == "structure")
    case = without_motors(case, rng, rng.choice([0.5, 1.0])) if how == "motors" else case
    if how == "strong":
        case.chain.tau_max[: case.chain.arms[0].model.nv - 1] *= 1e4
    state = case.at_rest()
    return (case, replace(state, grasp_points=moved_points(state.grasp_points, how, rng)))


@parametrize(
    "how, least, most",
    [
        ("rigid", 0, 0),
        ("grasps", 1, 24),
        ("slides", 10, 24),
        ("structure", 20, 25),
        ("near singular", 2, 24),
        ("motors", 5, 24),
        ("plane", 10, 24),
        ("line", 25, 25),
        ("same", 10, 25),
        ("strong", 10, 25),
    ],
)
def test_it_decides_as_singular_values_do(how, least, most):
    rng = default_rng(80)
    fewer = 0
    for _ in range(25):
        case, state = draw(how, rng)
        got = answer(state, case.chain)
        assert_same(got, settable_bars(state, case.chain))
        k = len(case.chain.arms)
        fewer += got[1].shape[1] < min(k * (k - 1) // 2, 3 * k - 6)
    assert least <= fewer <= most


def test_eight_arms_of_seven_joints():
    rng = default_rng(81)
    for kinds in (["rigid"] * 8, ["rigid", *["cylinder"] * 7]):
        case = random_case(["panda"] * 8, kinds, rng)
        state = case.at_rest()
        levers, basis = answer(state, case.chain)
        assert_same((levers, basis), settable_bars(state, case.chain))
        assert len(levers) == 28 and (basis.shape[1] == 18) == (kinds[1] == "rigid")
