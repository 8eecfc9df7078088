"""Arguments of Reference, ClosedChain and Controller: converted, or refused with a cure."""

from dataclasses import replace

import numpy as np
from complaints import invalid_input, refusals
from numpy.testing import assert_array_equal
from rigs import placed, ticked
from samples import module_fixture, parametrize
from scenario_runs import rig_of

import osc_contact as osc
from osc_contact.control.records import TickRecords

X = placed(0.4, 0.1, 0.3, (0.1, 0.2, 0.3))
MATRIX = X.homogeneous


# --- references -----------------------------------------------------------------------------------


def test_a_plain_number_of_force_is_an_array_of_one():
    """A plain number used to run, with NaN in recordings."""
    reference = osc.Reference(X, alpha_d=10.0)
    assert_array_equal(reference.alpha_d, [10.0])
    rig = rig_of("panda_edge")
    recorder = osc.Recorder(controller := rig.controller())
    at = osc.Reference(rig.state.X_WO, alpha_d=10.0)
    osc.run_loop(rig.plant(), controller, [at] * 3, recorder=recorder)
    assert_array_equal(np.isfinite(recorder.recording()["alpha_cmd"]), np.full((3, 1), True))


def test_a_matrix_is_the_pose_that_it_describes():
    for given in (MATRIX, MATRIX.tolist(), np.asfortranarray(MATRIX)):
        assert osc.Reference(given).X_WD.isApprox(X, 1e-12)
    single = osc.Reference(MATRIX.astype(np.float32))
    assert single.X_WD.isApprox(X, 1e-6)


@parametrize("kind", [list, np.float32, np.int64], ids=["list", "float32", "int64"])
def test_other_numbers_become_doubles(kind):
    numbers = np.arange(6.0)
    given = numbers.tolist() if kind is list else numbers.astype(kind)
    reference = osc.Reference(X, given, given, given[:2], given[:3])
    assert_array_equal(reference.V_D, numbers)
    for array in (reference.V_D, reference.A_D, reference.alpha_d, reference.squeeze_d):
        assert array.dtype == np.float64
    for number in (3, np.float32(3.0), np.array(3.0)):
        squeeze = osc.Reference(X, squeeze_d=number).squeeze_d
        assert squeeze == 3.0 and type(squeeze) is float


def test_what_is_left_out_of_a_reference_is_zero():
    reference = osc.Reference(X)
    assert_array_equal(reference.V_D, np.zeros(6))
    assert_array_equal(reference.A_D, np.zeros(6))
    assert reference.alpha_d.shape == (0,) and reference.squeeze_d == 0.0


def test_a_reference_without_forces_reaches_the_law_as_any_other(monkeypatch):
    """Read-only arrays are of another type to numba, which would hold every tick of theirs."""
    taken = []
    tick = TickRecords.tick

    def watched(records, given, switches=0):
        taken.append(given)
        return tick(records, given, switches)

    monkeypatch.setattr(TickRecords, "tick", watched)
    rig = rig_of("panda_edge")
    controller = osc.Controller(rig.chain, [], posture=rig.q_start)
    readings, goal = rig.plant().measure(), osc.Reference(rig.state.X_WO)
    while not controller.start.done:
        controller.tick(readings, goal)
    first = len(taken)
    controller.tick(readings, goal)
    assert first > 0 and len(taken) == first + 1
    assert all(array.flags.writeable for given in taken for array in given)
    assert controller.status is osc.Status.OK


def reference_of(**fields):
    return lambda: osc.Reference(**{"X_WD": X} | fields)


test_no_reference = refusals(
    invalid_input,
    {
        r"X_WD: expected a pin.SE3 .* got shape \(3,\); give pin.SE3\(R, p\)": reference_of(
            X_WD=[0.4, 0.1, 0.3]
        ),
        "X_WD: expected a pin.SE3 .* got None": reference_of(X_WD=None),
        r"X_WD: the last row is \[0.4, 0.1, 0.3, 1.0\].* p in its last column": reference_of(
            X_WD=MATRIX.T
        ),
        "X_WD rotation: .* give a rotation matrix": reference_of(X_WD=np.diag([2.0, 1, 1, 1])),
        r"V_D: expected shape \(6,\), got \(3,\); give the linear part, then": reference_of(
            V_D=[0, 0, 0.1]
        ),
        r"A_D: expected shape \(6,\), got \(1, 6\)": reference_of(A_D=np.zeros((1, 6))),
        "alpha_d: expected a list of numbers, got '10 N'": reference_of(alpha_d="10 N"),
        r"alpha_d: expected shape \(r,\), got \(1, 2\); give one number for each": reference_of(
            alpha_d=[[1.0, 2.0]]
        ),
        "squeeze_d: expected a list of numbers, got {}": reference_of(squeeze_d={}),
    },
)


def test_numbers_that_are_not_finite_are_held_in_their_tick():
    """They may come from a sensor while the loop runs: no error may end it."""
    rig = rig_of("panda_edge")
    measurement = rig.plant().measure()
    good = osc.Reference(rig.state.X_WO, alpha_d=[5.0])
    holed = MATRIX.copy()
    holed[0, 3] = np.nan
    for bad in (
        osc.Reference(holed),
        replace(good, V_D=np.full(6, np.nan)),
        replace(good, alpha_d=np.nan),
        replace(good, squeeze_d=np.inf),
    ):
        controller = rig.controller()
        ticked(controller, measurement, good)
        assert np.isfinite(controller.tick(measurement, bad)).all()
        assert controller.status is osc.Status.HELD


# --- chains and controllers -----------------------------------------------------------------------


@module_fixture
def rig():
    return rig_of("panda_edge")


def test_one_arm_one_pair_and_an_inertia_need_no_list(rig):
    (arm,) = rig.chain.arms
    (grasp,) = rig.chain.grasps
    (pair,) = rig.pairs
    chain = osc.ClosedChain(arm, grasp, rig.chain.payload.inertia)
    assert chain.arms == (arm,) and chain.grasps == (grasp,)
    assert chain.payload.inertia.isApprox(rig.chain.payload.inertia)
    made = osc.Controller(chain, pair, rig.gains, posture=rig.q_contact)
    assert made.contacts == (pair,)
    assert osc.ClosedChain(arm, grasp.X_TO).grasps[0].X_TO.isApprox(grasp.X_TO)


CHAINS = {
    "ClosedChain takes an Arm, got 'panda.urdf'": lambda arm: osc.ClosedChain(["panda.urdf"]),
    r"arms is 'panda.urdf'; give a list, such as \[arm\]": lambda arm: osc.ClosedChain(
        "panda.urdf"
    ),
    "ClosedChain takes an Arm, got Nb joints = 8 .*give osc.Arm.from_urdf": lambda arm: (
        osc.ClosedChain([arm.model])
    ),
    "payload= takes a RigidObject, got 0.3; give osc.RigidObject": lambda arm: osc.ClosedChain(
        arm, payload=0.3
    ),
    r"grasps is 3.0; give a list, such as \[pin.SE3": lambda arm: osc.ClosedChain(arm, 3.0),
    "X_TO: expected a pin.SE3, got ndarray": lambda arm: osc.ClosedChain(arm, [np.eye(4)]),
}


@parametrize("words", CHAINS)
def test_a_chain_of_other_things_is_refused(rig, words):
    with invalid_input(words):
        CHAINS[words](rig.chain.arms[0])


def law(alpha_d, alpha_meas):
    return alpha_d


FACE = ([0, 0, 0], [0, 0, 0], [0, 0, 1])
KEYWORDS = {
    r"laws= takes a Laws, got <function law .* give osc.Laws\(force=function\)": {"laws": law},
    r"life= takes a PhaseSettings, got True; give osc.PhaseSettings\(\)": {"life": True},
    r"friction= takes a Friction, got 0.3; give osc.Friction\(mu=0.2\)": {"friction": 0.3},
    r"gains= takes a Gains, got {'motion'.* give osc.Gains\(osc.MotionGains": {
        "gains": {"motion": {"frequency": 3.0}}
    },
    "safety= takes a SafetySettings, got 20": {"safety": 20},
    "joint_friction= takes a JointFriction, got 0.5; .* or True or False": {"joint_friction": 0.5},
    "dt = 1 s, longer than 0.1 s; .*: 0.001 for 1 ms, 1 for a rate of 1 Hz": {"dt": 1},
    "dt = 1000 s, .* 0.001 for a rate of 1000 Hz": {"dt": 1000},
    "dt = '1 ms'; give the control period in seconds": {"dt": "1 ms"},
    "dt = nan; give": {"dt": np.nan},
    "contacts has 'wall', which is no contact pair": {"contacts": ["wall"]},
    "contacts is 'wall'; give a list": {"contacts": "wall"},
    "'vertex_on_face': radius is 20 m .* stretched arm is 1.42 m long; .* 0.02 for 20 mm": {
        "contacts": osc.VertexOnFace(*FACE, radius=20.0)
    },
    "'vertex_on_face': vertex is 200 m .* 0.2 for 200 mm": {
        "contacts": [osc.VertexOnFace([200, 0, 0], *FACE[1:])]
    },
    r"bodies is 1; give a list, such as \[None": {"bodies": 1},
}


@parametrize("words", KEYWORDS)
def test_a_controller_of_other_things_is_refused(rig, words):
    how = {"contacts": rig.pairs} | KEYWORDS[words]
    with invalid_input(words):
        osc.Controller(rig.chain, **how)


def test_swapped_arguments_are_refused(rig):
    with invalid_input(r"takes a ClosedChain, got .*give osc.ClosedChain\("):
        osc.Controller(rig.pairs, rig.chain)


def test_a_face_may_be_described_by_a_point_far_away(rig):
    """Any point of an endless plane describes it."""
    far = osc.VertexOnFace([0, 0, 0], [300.0, 0, 0.1], [0, 0, 1], radius=0.01)
    assert osc.Controller(rig.chain, far).contacts == (far,)
