"""A run's channels, worked out together at its end, against plain computations tick by tick."""

import mujoco
import numpy as np
import pinocchio as pin
from numpy.linalg import cholesky, inv, lstsq, norm, solve, svd
from numpy.random import default_rng
from numpy.testing import assert_array_equal
from pair_kinds import KINDS, PLAIN, pose_of
from rigs import STILL, assert_near, placed, unloaded
from samples import aligned, parametrize
from scenario_runs import rig_of
from test_moving_face import TURNING

import osc_contact as osc
from osc_contact.contacts import pairs
from osc_contact.contacts.pairs.law_pair import normals_over
from osc_contact.contacts.pairs.pair import pushes_only
from osc_contact.control.monitor import ContactMonitor
from osc_contact.dynamics.closed_chain import columns_at
from osc_contact.lab.plants.mujoco import MujocoPlant
from osc_contact.lab.runs.run import start
from osc_contact.spatial import Poses, rotated, rotations

ON_SURFACE = {
    pairs.VertexOnFace: "point",
    pairs.SphereOnPlane: "face_point",
    pairs.FaceOnVertex: "body_vertex",
    pairs.EdgeOnEdge: "edge_point",
    pairs.FaceOnFace: "face_point",
}
WORLD = placed()


def run_plainly(rig):
    """Channels of a run, each from its definition, tick by tick."""
    plant, controller = start(rig, 3)
    robot = rig.robot(plant, controller)
    tare = rig.scenario.tare
    period = 1.0 / rig.scenario.control.rate
    pushing = np.array([pushes_only(rig.pairs[i]) for i in rig.owners])
    zero = np.zeros(len(pushing))
    monitor = ContactMonitor(len(pushing), period)
    ticks = []
    samples = []
    times = np.arange(round(rig.scenario.duration / period)) * period
    for t, desired in aligned(times, rig.references.over(times)):
        read = plant.measure()
        truth = judged(plant)
        tau = controller.tick(read, desired)
        if tare is not None and not controller.engaged:
            if 2 * tare.duration / 3 <= t < tare.duration:
                samples.append(controller.residual_wrench())
            elif samples and t >= tare.duration:
                controller.f_tare = np.mean(samples, axis=0)
                samples = []
            if t >= tare.duration + tare.approach:
                controller.engage()
        found = controller.result()
        alpha = speed = zero
        if len(found.alpha_meas):
            contact = controller.signals.contact
            alpha = contact.magnitudes(found.alpha_meas)
            speed = found.normal_speed @ contact.R
        closed, collision = monitor.update(np.where(pushing, alpha, np.abs(alpha)), speed)
        wrench = found.f_meas - found.bias_out
        std = controller.normal_std
        given_up = controller.given_up
        ticks.append(
            {
                "t": t,
                "q": read.q,
                "v": read.v,
                "tau": tau,
                "alpha_cmd": desired.alpha_d,
                "alpha_meas": alpha,
                "contact_seen": closed,
                "collision_seen": collision,
                "wrench_meas": wrench,
                "squeeze": np.squeeze(found.squeeze),
                "squeeze_cmd": desired.squeeze_d,
                "friction": np.array(found.friction),
                "status": int(controller.status),
                "contact_phase": np.full(len(rig.pairs), 2 * controller.engaged),
                "contact_named": np.full(len(rig.pairs), True),
                "power_total": found.V_O @ (wrench - found.f_c) + alpha @ speed,
                "power_projected": alpha @ speed,
                **truth,
                **lines(rig, truth),
                "motion_error": error(controller, read.q),
                "normal_std": np.where(std > 0.0, std, np.nan),
                "alpha_given_up": zero if given_up is None else given_up.force,
            }
        )
        robot.command(tau, period)
    return {name: np.array([tick[name] for tick in ticks]) for name in ticks[0] if name != "E"}


def judged(plant):
    """Truth of the plant; for MuJoCo from its own functions, contact by contact."""
    if not isinstance(plant, MujocoPlant):
        truth = plant.truth()
        E = truth.X_WE or [WORLD] * len(plant.contacts)
        return truths(truth.X_WO, truth.V_O, E, truth.alpha, truth.closed)
    model = plant.model
    data = plant.data
    body = model.body("object/root").id
    V = np.zeros(6)
    force = np.zeros(6)
    X = pin.SE3(data.xmat[body].reshape(3, 3).copy(), data.xpos[body].copy())
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, V, 0)
    E = [moved(model, data, f"face{i}", rail) for i, rail in enumerate(plant.faces.rails)]
    roots = {model.body(f"face{i}/root").id: i for i in range(len(E))}
    pushed = np.zeros((len(E), 6))
    touched = np.zeros(len(E), dtype=bool)
    for k, contact in enumerate(data.contact):
        first, second = map(roots.get, model.body_rootid[model.geom_bodyid[contact.geom]])
        mujoco.mj_contactForce(model, data, k, force)
        n = force[0] * contact.frame[:3] * (1.0 if first is None else -1.0)
        at = second if first is None else first
        pushed[at] += np.concatenate((n, np.cross(contact.pos - X.translation, n)))
        touched[at] |= contact.efc_address >= 0
    alpha = []
    closed = []
    Phi = inv(plant.chain.reference_inertia(X))
    for at in range(len(E)):  # contacts on one body follow one another in every scenario below
        here = np.flatnonzero(np.equal(plant.faces.on, at))
        N = [plant.contacts[i].contact(X, STILL, E[at]).N for i in here]
        ends = np.cumsum([n.shape[1] for n in N])
        N = np.hstack(N)
        share = solve(N.T @ Phi @ N, N.T @ Phi @ pushed[at])
        # a face that bears nothing of what its body takes gets errors of either sign, 1e-17 … 1e-7
        size = np.abs(share) / np.abs(share).max(initial=1e-300)
        assert ((size <= 1e-6) | (size > 1e-4)).all()  # else: touch and go
        presses = touched[at] & (share > 0.0) & (size > 1e-6)
        closed += [part.all() for part in np.split(presses, ends[:-1])]
        alpha.append(share * touched[at])
    return truths(X, np.roll(V, 3), [E[on] for on in plant.faces.on], np.concatenate(alpha), closed)


def truths(X, V, E, alpha, closed):
    return {"pose": pin.SE3ToXYZQUAT(X), "twist": V, "E": E, "alpha_true": alpha, "closed": closed}


def moved(model, data, body, rail):
    """Displacement of a body by a slide and the hinge on it; identity without either."""
    if not rail.joints:
        return WORLD
    joints = {model.joint(j).name: data.qpos[model.jnt_qposadr[j]] for j in range(model.njnt)}
    s, turn = (joints.get(f"{body}/{kind}", 0.0) for kind in ("slide", "hinge"))
    R = pin.exp3(turn * rail.axis)
    return pin.SE3(R, rail.through + s * rail.direction - R @ rail.through)


def lines(rig, truth):
    """Unit columns of N at the true pose, where they meet the surface, poses of the faces."""
    X = pin.XYZQUATToSE3(truth["pose"])
    O = X.translation
    N = []
    found = {"contact_point": [], "contact_direction": [], "face_pose": []}
    for pair, on, E in aligned(rig.pairs, rig.on, truth["E"]):
        columns = pair.contact(X, STILL, E).N
        columns = columns / norm(columns[:3], axis=0)
        surface = E.act(getattr(pair, ON_SURFACE[type(pair)])) - O
        above = pair.radius if type(pair) is pairs.FaceOnVertex else 0.0
        d = columns[:3].T
        feet = np.cross(d, columns[3:].T)  # nearest to O on each line
        feet += (np.sum(d * (surface - feet), axis=1) - above)[:, None] * d
        assert len(pair.gaps(X, E)) == len(feet)
        N.append(columns)
        found["contact_point"].append(feet.mean(axis=0) + O)
        found["contact_direction"].append(d[0])
        found["face_pose"].append(pin.SE3ToXYZQUAT(E * rig.bodies[on].placement))
    return found | {"N": np.hstack(N)}


def free_part(chain, q, X_WO, N, x):
    """Part in range(S) ∩ T at one instant, by singular values in the object's metric."""
    L = cholesky(chain.reference_inertia(X_WO))
    pin.computeJointJacobians(chain.model, chain.data, q)
    J = L.T @ columns_at(chain.data.J, X_WO.translation)
    slips = [
        L.T @ grasp.motions_at(X_WT, X_WO.translation)
        for grasp, X_WT in aligned(chain.grasps, chain.tip_poses())
    ]
    locked = np.hstack(
        [outside(np.hstack((J[:, arm], T))) for arm, T in aligned(chain.slices, slips)]
    )
    # arms whose loops are open lock one direction, as for the law
    S = outside(locked, chain.angle_tolerance) if locked.shape[1] else np.eye(6)
    e = S.T @ (L.T @ x)
    N_S = S.T @ solve(L, N)
    e = e - N_S @ lstsq(N_S, e, rcond=None)[0]
    return solve(L.T, S @ e)


def outside(columns, least=1e-6):
    """Orthonormal complement of the range of (6, k)."""
    U, s, _ = svd(columns)
    return U[:, np.count_nonzero(s > least * s[0]) :]


def error(controller, q):
    """Part of the pose error that arms and active contacts permit."""
    found = controller.signals
    X_WO = pin.SE3(found.X_WO.copy())
    return free_part(controller.chain, q, X_WO, found.contact.N, found.error)


SOON = ["tare.duration=15 ms", "tare.approach=20 ms", "tare.standoff=0.3 mm"]
RUNS = {
    "two_contact_rod": ("mujoco", 0.06),
    "two_contact_rod, rigid": ("rigid", 0.006),
    "two_contact_rod, detected": ("mujoco", 0.01, "control.contacts=detected"),
    "two_contact_rod, one face twice": ("mujoco", 0.01),
    "two_contact_rod_mismatch": ("mujoco", 0.06, *SOON),
    "two_contact_rod_friction": ("mujoco", 0.006),
    "moving_face": ("mujoco", 0.04),
    "moving_face, rotated": ("mujoco", 0.02, *TURNING),
    "moving_face, rigid": ("rigid", 0.006),
    "panda_edge": ("mujoco", 0.02),
    "ur5_wipe": ("mujoco", 0.02),
    "three_arm_plate": ("mujoco", 0.02),
    "scara_peg": ("mujoco", 0.02),
    "hinge_ball_rod": ("mujoco", 0.01),
}


@parametrize("name", RUNS)
def test_channels_are_what_they_are_defined_to_be(name):
    plant, duration, *changes = RUNS[name]
    changes = [*changes, f"plant.type={plant}", f"duration={duration}", "control.life=off"]
    scenario = osc.load_scenario(name.partition(",")[0], changes)
    if name.endswith("one face twice"):  # three contact forces, two of them independent
        data = scenario.as_dict()
        data["contacts"].append(data["contacts"][0] | {"name": "again"})
        data["force"]["again"] = data["force"]["left_end"]
        scenario = type(scenario).model_validate(data).with_source(scenario.source)
    recording = osc.run(scenario, seed=3)
    plain = run_plainly(rig_of(scenario))
    assert set(recording.channels) == {*plain, "tick_s"}
    for channel, values in plain.items():
        found = recording[channel]
        if channel in ("q", "v", "tau", "closed", "contact_seen", "collision_seen", "status"):
            assert_array_equal(found, values, err_msg=channel)
        else:
            assert_near(found, values, atol=1e-13, rtol=1e-11, name=channel)


def test_poses_are_those_of_pinocchio():
    rng = default_rng(5)
    w = rng.standard_normal((3, 60))
    w[:, :20] *= np.pi / norm(w[:, :20], axis=0)  # half turns have two quaternions
    w[:, 20:22] = [[0.0, 1e-12]] * 3
    p, x = rng.standard_normal((2, 3, 60))
    poses = Poses(rotations(w), p)
    numbers = poses.coordinates(60)
    moved = poses.act(x)
    back = poses.rotate_back(x)
    for i in range(60):
        X = pin.SE3(pin.exp3(w[:, i]), p[:, i])
        for found, expected in (
            (poses[i].homogeneous, X.homogeneous),
            (numbers[i], pin.SE3ToXYZQUAT(X)),
            (moved[:, i], X.act(x[:, i])),
            (back[:, i], X.rotation.T @ x[:, i]),
        ):
            assert_near(found, expected, atol=1e-14)
    assert_array_equal(rotated(poses.R, x[:, None])[:, 0], poses.rotate(x))


def stacked(poses):
    H = np.stack([X.homogeneous for X in poses], -1)
    return Poses(H[:3, :3], H[:3, 3])


@parametrize("name", KINDS)
def test_lines_of_force_over_time_are_those_of_the_pair(name):
    rng = default_rng(6)
    pair, pose, r = KINDS[name](rng, PLAIN)
    touching = [pose(0.5 * rng.standard_normal(6 - r)) for _ in range(5)]
    faces = [pose_of(rng) for _ in range(5)]
    for E in ([WORLD] * 5, faces, faces[:1] * 5):
        X = [X_WE * X_EA for X_WE, X_EA in aligned(E, touching)]
        moving = None if E[0] is WORLD else stacked(E[:1] if E[1] is E[0] else E)
        found = normals_over(pair, stacked(X), moving)
        assert found.shape == (6, r, 5)
        for i in range(5):
            expected = pair.contact(X[i], STILL, moving and E[i]).N
            assert_near(found[:, :, i], expected, atol=1e-13)


@parametrize("name", ["two_contact_rod", "scara_peg", "ur5_wipe", "hinge_ball_rod"])
def test_the_permitted_error_is_what_arms_and_contacts_permit_in_postures_of_all_kinds(name):
    rng = default_rng(7)
    rig = rig_of(name)
    chain = rig.model
    still = np.zeros(chain.nq)
    spread = np.repeat([0.0, 1e-7, 3e-3], (1, 5, 5))  # loops open: d changes
    for q in rig.q_contact + spread[:, None] * rng.standard_normal((len(spread), chain.nq)):
        controller = osc.Controller(chain, rig.pairs, posture=rig.q_contact)
        X_WD = chain.state(q, still).X_WO * pin.exp6(0.01 * rng.standard_normal(6))
        controller.tick(
            unloaded(q, still, len(chain.arms)),
            osc.Reference(X_WD, alpha_d=np.zeros(rig.contact.r)),
        )
        assert controller.status.name in ("OK", "SATURATED"), controller.reason
        assert_near(controller.result().free_error, error(controller, q), atol=1e-9)
