"""Faults, lost packets, lost contacts in closed loop on MuJoCo: benchmarks/fault_injection.py."""

from dataclasses import replace

import numpy as np
from pytest import approx, mark
from rigs import assert_near, largest, rig_of, unit, vector, with_motors
from samples import chosen, first, parametrize
from scenario_runs import run_of

import osc_contact as osc
from benchmarks import fault_injection
from benchmarks.fault_injection import (
    Case,
    Run,
    Verdict,
    Watch,
    least_load,
    read_verdict,
    runs,
    try_fault,
)
from benchmarks.fault_judge import growth_to
from benchmarks.faults import FAULTS, NAN
from benchmarks.kept import Kept
from benchmarks.pushes import push_arm
from osc_contact.control.status import Phase
from osc_contact.lab.runs.run import start
from osc_contact.law.phases import CLOSED

RUN, DEGRADED, HOLD, SAFE_STOP = osc.SafetyState

#: where they once went wrong, by the moment (s); wrists that fail look like friction
IN_CONTACT = 0.8
ELSEWHERE = (
    ("wrists read zero", Case(scenario="panda_edge"), IN_CONTACT),
    ("wrists times 0.3", Case(scenario="ur5_wipe"), IN_CONTACT),
    ("encoder stuck", Case("approach"), 0.6),
    ("encoders stuck, speeds too", Case("near singular"), 1.5),
    ("wrists read zero", Case("after a hold"), 0.5),
    ("speeds mirrored", Case("saturated"), 2.05),
    ("packet repeats for ever", Case("start"), None),
    ("speeds zero", Case("approach"), 0.6),
    ("speeds mirrored", Case("approach"), 0.6),
    ("speed noise of 0.05 rad/s", Case("approach"), 0.6),
    ("encoders stuck, speeds too", Case("approach"), 0.6),
    ("encoders stuck, speeds zero", Case("approach"), 0.6),
    ("one wrist mirrored", Case("approach"), 0.6),
    ("wrists times 0.3", Case("approach"), 0.6),
)
LET_GO = (
    (Case(), IN_CONTACT),
    (Case(scenario="limited_rod"), IN_CONTACT),  # the first arm sinks: its motors are too weak
    (Case(scenario="workcell", every=3, seed=3), IN_CONTACT),  # its gripper swung at 12.6 rad/s
    (Case(scenario="three_arm_plate"), IN_CONTACT),  # 56 N where arms had to be 20 mm apart
    (Case(scenario="dual_panda_rod"), 1.2),
    (Case(scenario="two_contact_rod", every=3), 2.3),
    (Case(scenario="three_arm_plate"), 1.7),
    (Case(scenario="workcell", every=3), 1.1),
)
#: s that these are looked at; the benchmark's own durations are ten times as long
SHORT = {"fault_for": 0.6, "stopped_for": 0.6}


@parametrize(
    "where", [*((name, Case(), IN_CONTACT) for name in FAULTS), *first(ELSEWHERE, 7)], ids=str
)
def test_every_kind_of_fault_in_contact_and_some_elsewhere(where):
    verdict = try_fault(*where, **SHORT)
    assert not verdict.wrong, verdict


@parametrize(
    "name, case",
    [
        ("encoders stuck, speeds zero", Case(scenario="panda_wrist", seed=1129)),
        ("encoder stuck", Case("approach", every=2, seed=1129)),
        ("encoder stuck", Case(scenario="collisions", every=2, seed=1129)),
        ("one wrist mirrored", Case(scenario="ur5_wipe", every=3, seed=1131)),
        ("a post at the forearm", Case(scenario="three_arm_plate", every=3, seed=1129)),
        ("a brake engages", Case(scenario="three_arm_plate", every=10, seed=276252386)),
        ("speeds swapped", Case(scenario="hinge_ball_rod", every=10, seed=212555030)),
        ("speeds swapped", Case(scenario="dual_panda_rod", seed=78633083)),
    ],
    ids=str,
)
def test_drawn_moments_that_were_once_found_wrong(name, case):
    """A quiet arm; speeds of a stuck encoder; growth until the stop; joints of nearly one axis."""
    verdict = try_fault(name, case, fault_for=2.0, stopped_for=0.6)
    assert not verdict.wrong, verdict
    assert verdict.state is SAFE_STOP


def test_a_packet_that_is_lost_outdates_none():
    """Every second packet is newer than the next one; these are lost, and the rest is in order."""
    verdict = try_fault("packets out of order", Case(every=2), 0.3, **SHORT)
    assert not verdict.wrong and verdict.stopped is None, verdict


@parametrize("every", first([3, 2], 1))
def test_wrists_that_motors_contradict_do_not_show_that_an_arm_has_let_go(every):
    """Their readings are limited; one arm alone is too weak to carry the object, and sinks."""
    case = Case("saturated", every=every, seed=2911)
    verdict = try_fault("wrists saturate", case, fault_for=1.0, stopped_for=5.0)
    assert verdict.state is SAFE_STOP and "contradict its wrist" in verdict.reason
    assert not verdict.wrong, verdict


SATURATED = [Case(scenario="dual_panda_rod", every=every, seed=6211) for every in (3, 0)]


@parametrize("case", first(SATURATED, 1), ids=str)
def test_wrists_at_the_end_of_their_range_are_found_before_the_contact_is_lost(case):
    """Motors do not contradict them: forces of 92 and 74 N, and a contact open for 0.65 s."""
    verdict = try_fault("wrists saturate", case, fault_for=3.5, stopped_for=1.0)
    assert verdict.state is SAFE_STOP and not verdict.wrong, verdict
    assert "end of its range" in verdict.reason


NOISY = [Case("approach", every=every, seed=6211) for every in (0, 3)]


@parametrize("case", first(NOISY, 1), ids=str)
def test_encoders_that_become_noisy_before_contact_is_made_stop_the_arms_at_rest(case):
    """Speeds that the noise had made lasted for 80 ms: 156 N, and 0.2 rad/s in the stop."""
    verdict = try_fault("encoder noise of 5 mrad", case, stopped_for=3.0)
    assert verdict.state is SAFE_STOP and verdict.stopped < 0.01, verdict
    assert not verdict.wrong, verdict


def test_an_arm_with_encoders_far_noisier_than_expected_is_held_at_rest():
    """Speeds are estimated from them; with the gains of quiet encoders it moved at 2.6 rad/s."""
    case = Case(scenario="panda_wrist", every=3, seed=2911)
    verdict = try_fault("encoder noise of 5 mrad", case, fault_for=1.0, stopped_for=5.0)
    assert verdict.state is SAFE_STOP and not verdict.wrong, verdict


@parametrize("every, seed", [(0, 5), (3, 177370)])
def test_a_face_does_not_rest_on_the_weight_that_is_left_by_wrists_that_read_zero(every, seed):
    """It kept its contact, and its integral rose to 15 N at each corner: 38 N of 33."""
    case = Case(scenario="ur5_wipe", every=every, seed=seed)
    assert try_fault("wrists read zero", case, fault_for=0.5, stopped_for=0.5).wrong == []


def test_an_arm_whose_posture_motors_and_wrist_both_contradict_asks_for_brakes():
    """It followed its drifting encoder for ever: speeds are estimated from it."""
    case = Case(scenario="panda_wrist", every=3, seed=2911)
    verdict = try_fault("encoder drifts by 0.2 rad/s", case, stopped_for=1.0)
    assert verdict.state is SAFE_STOP and verdict.unbraked and not verdict.wrong, verdict


@parametrize("name", first(["wrists times 0.3", "wrists mirrored", "wrist offset of 20 N"], 1))
def test_an_arm_whose_wrist_alone_is_wrong_keeps_its_encoders(name):
    case = Case(scenario="panda_wrist", every=3, seed=2911)
    verdict = try_fault(name, case, 0.6, stopped_for=1.0)
    assert verdict.state is SAFE_STOP and not verdict.unbraked and not verdict.wrong, verdict


FIGHT = (("collisions", 0), ("approach_and_slide", 0), ("collisions", 3))


@parametrize("where", first(FIGHT, 1), ids=str)
def test_arms_that_fight_by_a_drifting_encoder_ask_for_brakes(where):
    """Speeds are estimated from encoders; arms that hold one object moved at 0.9 rad/s."""
    scenario, every = where
    case = Case(scenario=scenario, every=every, seed=2911)
    verdict = try_fault("encoder drifts by 0.2 rad/s", case, fault_for=1.0, stopped_for=1.0)
    assert verdict.state is SAFE_STOP and verdict.unbraked and not verdict.wrong, verdict


def test_the_other_arm_shows_that_an_encoder_of_a_vertical_axis_drifts():
    """It turns the object about its own grasp point, which stays where it was."""
    name = "encoder drifts by 0.2 rad/s"
    run = Run(Case(scenario="collisions", seed=2911), name, begin=1.5)
    run.trial.kept[f"pick{len(run.act)}"] = len(run.act) - 1
    verdict = Verdict(name, run.case)
    while run.k < run.first:
        run.step(verdict)
    verdict = run.judge(name, fault_for=1.0, stopped_for=0.3)
    assert verdict.stopped is not None and verdict.stopped < 0.5, verdict
    assert "away from where the others hold" in verdict.reason and verdict.unbraked
    assert not verdict.wrong, verdict


def test_arms_that_are_stopped_ask_for_brakes_once_an_encoder_makes_them_fight():
    """They are stopped by bad references; half a second later an encoder drifts."""
    run = Run(Case(scenario="collisions", seed=2911), "encoder drifts by 0.2 rad/s", begin=1.5)
    run.trial.kept[f"pick{len(run.act)}"] = len(run.act) - 2
    seen = Verdict("no fault", run.case)
    drift, bad = FAULTS["encoder drifts by 0.2 rad/s"], FAULTS["X_WD no rotation"]
    while run.k < run.first + 2000 and run.controller.unbraked is None:
        run.step(seen, None if run.k < run.first - 500 else bad if run.k < run.first else drift)
    assert "is not a rotation matrix" in run.controller.reason
    assert run.controller.unbraked is not None, run.k - run.first


def test_arms_of_which_one_has_let_go_are_not_taken_for_arms_that_fight():
    """Encoders place them apart, too, and rightly so; the wrist of one shows no load."""
    name = "encoder drifts by 0.2 rad/s"
    run = Run(Case(scenario="collisions", seed=2911), name)
    seen = Verdict(name, run.case)
    stopped = 0
    while stopped < 300:
        run.step(seen, FAULTS[name] if run.k >= run.first else None)
        stopped += run.controller.state is SAFE_STOP
        if stopped:
            run.controller.records.memory.arms.let_go[1] = 1
    assert "away from where the others hold" in run.controller.reason
    assert run.controller.unbraked is None


@parametrize("where", first(LET_GO, 4), ids=str)
def test_arms_of_which_one_has_let_go_of_the_object_come_to_rest(where):
    """The one that holds it carries all of it, the other one nothing."""
    verdict = try_fault("a grasp lets go", *where, stopped_for=3.0)
    assert not verdict.wrong, verdict
    assert verdict.state is SAFE_STOP and not verdict.unbraked


def _drawn(count, seed):
    """Cases with lost ticks, and three faults for each, of all packaged scenarios."""
    rng = np.random.default_rng(seed)
    some = [(name, case) for name, case in runs(seed) if case.every and case.phase == "run"]
    cases = list(dict.fromkeys(case for _, case in some))
    chosen = [cases[i] for i in rng.choice(len(cases), count, replace=False)]
    names = {case: [name for name, other in some if other == case] for case in chosen}
    return [(case, sorted(rng.choice(names[case], 3, replace=False))) for case in chosen]


@parametrize("drawn", first(_drawn(8, 25), 1), ids=lambda x: str(x)[:60])
def test_faults_while_ticks_are_lost_in_packaged_scenarios(drawn):
    case, names = drawn
    verdicts = [try_fault(name, case, IN_CONTACT, **SHORT) for name in names]
    assert not [v.wrong for v in verdicts if v.wrong], verdicts


@parametrize("scenario", ["two_contact_rod", "panda_edge"])
def test_noise_and_delay_stop_nothing(scenario):
    errors = "{rate: 1 kHz, delay: 3 ms, force: {noise: 0.5 N}, torque: {noise: 0.05 Nm}}"
    meta = run_of(scenario, f"sensors.wrist={errors}", duration=3.0).meta
    assert meta["end_state"] != "SAFE_STOP", meta["end_reason"]


def test_a_fault_is_found_wrong_where_the_limits_are_off(monkeypatch):
    """The judge finds what it is there to find."""
    real = fault_injection.start

    def bare(rig, seed):
        plant, controller = real(rig, seed)
        return (plant, controller.with_safety(osc.SafetySettings.motors_only()))

    monkeypatch.setattr(fault_injection, "start", bare)
    assert try_fault("speeds mirrored", Case(), IN_CONTACT).wrong
    closed = np.full(2, Phase.CLOSED)
    monkeypatch.setattr(osc.Controller, "phases", lambda self: closed)
    found = try_fault("faces vanish", Case(), IN_CONTACT, **SHORT).wrong
    assert any("open for" in one for one in found), found


def test_the_limit_of_a_post_is_that_of_the_speed_at_which_it_is_met():
    """Arms that are at rest when the post appears meet it later."""
    run = Run(Case(scenario="three_arm_plate", every=3, seed=1129), "a post at the forearm")
    seen = Verdict("no fault", run.case)
    speeds = []
    while run.k < 450:
        run.step(seen, FAULTS["a post at the forearm"] if run.k >= run.first else None)
        speeds.append(run.trial.kept.get("speed", 0.0))
    assert speeds[run.first] < 1e-3 < speeds[-1]
    assert (np.diff(speeds) >= 0.0).all()


def test_speeds_are_estimated_from_readings_that_a_fault_has_changed():
    """The speed of a stuck encoder ends, too; a fault of speeds alone is one of the estimate."""
    for name, still in (("encoder stuck", True), ("speed noise of 0.05 rad/s", False)):
        run = Run(Case(scenario="approach_and_slide"), name, begin=2.0)
        seen = Verdict("no fault", run.case)
        joint = run.act[0]
        run.trial.kept[f"pick{len(run.act)}"] = 0
        while run.k < run.first + 40:
            run.step(seen, FAULTS[name] if run.k >= run.first else None)
        speed = run.controller.records.memory.joints.v[joint]
        assert abs(run.true.measure().v[joint]) > 0.02
        assert (abs(speed) < 0.005) == still, (name, speed)


def test_the_limit_of_a_weak_motor_has_the_impact_of_a_landing():
    """From the true speed at which the face is met; none where contacts stay closed."""
    fault = "torque constant of 50 %"
    for case, begin, lands in ((Case("approach"), 0.43, True), (Case(), IN_CONTACT, False)):
        run = Run(case, fault, begin)
        seen = Verdict(fault, case)
        watch = None
        run.trial.kept[f"pick{len(run.act)}"] = 2  # of the left quill
        while run.k < run.first + 150:
            at_fault = run.k >= run.first
            if at_fault and watch is None:
                watch = Watch(run, seen, False)
            reference = run.step(seen, FAULTS[fault] if at_fault else None)
            if watch is not None:
                watch.look(reference)
        watch.contacts.evaluate()
        impacts = watch.contacts.impacts
        assert (impacts > 5.0).any() == lands, impacts
        assert impacts.max() < 200.0


@parametrize("looks, growth", [(1, 3.0), (3, 9.0), (8, 23.0)])
def test_a_force_may_grow_above_its_ceiling_as_in_the_same_time_before(looks, growth):
    """The ceiling of 33 N is exceeded at the fifth look."""
    forces = [10.0, 24.0, 26.0, 30.0, 34.0, 38.0]
    assert_near(growth_to(33.0, forces, looks), growth)
    assert growth_to(40.0, forces, looks) == 0.0
    assert growth_to(33.0, [50.0, 10.0], looks) == 0.0, "it was above from the beginning on"


@parametrize("locked", first([False, True], 1))
def test_a_peg_that_a_dead_motor_lets_swing_may_meet_the_wall_behind(locked):
    """Its joint is free: it swings on although the others are locked from the stop on."""
    case = Case(scenario="scara_peg", every=3, seed=695647045)
    run = Run(case, "a motor is dead")
    seen = Verdict("no fault", case)
    while run.k < run.first:
        run.step(seen)
    step = run.step

    def step_and_lock(verdict, fault=None):
        reference = step(verdict, fault)
        if locked and run.controller.state is SAFE_STOP:
            free = run.trial.pick(len(run.act))
            for joint in np.delete(run.act, free):
                dof = run.true.model.joint(run.rig.model.joint_names[joint]).dofadr
                run.true.model.dof_frictionloss[dof] = 1e4
        return reference

    run.step = step_and_lock
    verdict = run.judge("a motor is dead", stopped_for=0.3)
    assert verdict.state is SAFE_STOP and verdict.force > 55.6, "beyond the limit without impact"
    assert not verdict.wrong, verdict


def test_rest_is_judged_of_a_drifting_encoder():
    """Where speeds are estimated from it, too: the arm follows the drift, which is not mended."""
    name = "encoder drifts by 0.2 rad/s"
    run = Run(Case())
    for run.estimated in (True, False):
        verdict = Verdict(name, run.case, state=SAFE_STOP, rest_speed=1.0)
        run._judge_end(verdict, FAULTS[name], 100.0, False)
        assert len(verdict.wrong) == 1 and "rad/s" in verdict.wrong[0]


def test_a_joint_whose_estimated_speed_ends_with_its_encoder_may_need_the_brakes():
    """Not where its speed is read apart."""
    run = Run(Case())
    for name in ("encoder mirrored", "encoder NaN for ever", "encoder jumps by 1 rad"):
        for run.estimated in (True, False):
            verdict = Verdict(name, run.case, state=SAFE_STOP, unbraked=True)
            run._judge_end(verdict, FAULTS[name], 100.0, False)
            assert bool(verdict.wrong) != run.estimated, verdict.wrong


def test_moments_are_drawn_from_the_whole_run_and_are_the_same_again():
    some = [case for name, case in runs(5) if name == "encoder stuck"]
    first_ones = [Run(case, "encoder stuck") for case in some[:12]]
    moments = [run.first * run.dt for run in first_ones]
    assert moments == [Run(run.case, "encoder stuck").first * run.dt for run in first_ones]
    assert len(set(moments)) > 8
    by_run = [run for run in first_ones if run.case.phase == "run"]
    assert all(0.0 < run.first * run.dt <= run.rig.scenario.duration for run in by_run)


def test_every_fault_occurs_in_every_scenario_that_has_the_arms_for_it():
    found = runs(3)
    places = {(name, case.scenario) for name, case in found if case.phase == "run"}
    two_arms = {name for name, _ in found if FAULTS[name].arms == 2}
    assert two_arms == {"arms swapped", "a grasp lets go"}
    for scenario in osc.list_scenarios():
        for name in FAULTS:
            assert (name, scenario) in places or name in two_arms or FAULTS[name].world
    assert ("arms swapped", "panda_edge") not in places
    every = {name: {case.every for other, case in found if other == name} for name in FAULTS}
    assert sorted(map(len, every.values())) == [2] * (len(FAULTS) - len(FAULTS) // 4) + [4] * (
        len(FAULTS) // 4
    )


def test_verdicts_are_kept_and_a_line_that_was_cut_is_not_read(tmp_path):
    verdict = Verdict("encoder stuck", Case("approach", every=3), 0.5, SAFE_STOP, 0.1, wrong=["a"])
    kept = Kept(tmp_path, read_verdict)
    kept.add(verdict)
    kept.add(replace(verdict, fault="speeds zero"))
    [file] = tmp_path.iterdir()
    file.write_text(file.read_text()[:-5])
    assert Kept(tmp_path, read_verdict).found == {("encoder stuck", verdict.case): verdict}


# Packets that are lost, repeated or late


def driven(change, ticks):
    """Main job's rod with changed measurements, and the status of each tick."""
    run = Run(Case())
    status = []
    seen = Verdict("no fault", run.case)
    measure = run.robot.measure
    run.robot.measure = lambda: change(measure(), run.k)
    for _ in range(ticks):
        run.step(seen)
        status.append(int(run.controller.status))
    assert not seen.wrong, seen.wrong
    return (run, status)


def lost(m):
    return replace(m, q=m.q * NAN, v=m.v * NAN, wrenches=m.wrenches * NAN)


def test_a_sensor_at_half_the_rate_makes_no_tick_a_fault():
    kept = {}

    def half_rate(m, k):
        if k % 2 == 0:
            kept["packet"] = replace(m, sequence=k // 2)
        return kept["packet"]

    run, status = driven(half_rate, 1500)
    assert set(status) == {int(osc.Status.OK)}
    assert run.controller.state is RUN and run.controller.state_age == 1500
    assert run.controller.repeated == 1, "the last packet came twice"
    assert_near(run.plant.truth().alpha, run.rig.references.at(1.5).alpha_d, rtol=0.05)


@parametrize("lost_of, within", {(1, 2): 1000, (2, 3): 100, (19, 20): 50, (1, 3): None})
def test_a_run_stops_where_many_ticks_are_lost_for_good(lost_of, within):
    """Every second one within a second, of every third one none."""
    n, m = lost_of

    def change(measurement, k):
        return lost(measurement) if k >= 100 and k % m < n else measurement

    run, _ = driven(change, 100 + (within or 2500))
    assert (run.controller.state is SAFE_STOP) == (within is not None), run.controller.reason
    if lost_of == (1, 2):
        assert "more than missed_share = 0.4 of the ticks" in run.controller.reason


def test_the_share_of_lost_ticks_that_stops_a_run_is_a_setting():
    def change(measurement, k):
        return lost(measurement) if k % 10 == 9 else measurement

    for share, stops in ((0.08, True), (0.12, False)):
        run = Run(Case())
        safety = osc.SafetySettings(missed_share=share)
        controller = run.controller.with_safety(safety)
        run.controller, run.tick = controller, controller.tick
        measure = run.robot.measure
        run.robot.measure = lambda run=run, measure=measure: change(measure(), run.k)
        seen = Verdict("no fault", run.case)
        while run.k < 1500:
            run.step(seen)
        assert (controller.state is SAFE_STOP) == stops


def test_arms_whose_wrist_is_frozen_are_held_where_they_are():
    """Gravity is 5° off the controller's model, so that without their encoders arms creep."""
    run = Run(Case())
    seen = Verdict("no fault", Case())
    down = run.plant.model.opt.gravity
    down[:] = 9.81 * vector(np.sin(np.deg2rad(5.0)), 0.0, -np.cos(np.deg2rad(5.0)))
    measure = run.robot.measure
    kept = {}

    def frozen():
        m = measure()
        if run.k >= 300:
            return replace(m, wrenches=kept["wrenches"])
        kept["wrenches"] = m.wrenches
        return m

    run.robot.measure = frozen
    where = {}
    for _ in range(2100):
        run.step(seen)
        where[run.k] = run.plant.measure().q
    assert run.controller.state is SAFE_STOP
    assert "reads the very same" in run.controller.reason
    assert largest(where[2100] - where[1100]) < 5e-3, "held, while the load settles"
    assert largest(where[2100] - where[1900]) < 2e-4, "and not creeping"


def test_speeds_estimated_from_encoders_are_no_second_reading_of_them():
    """Masses × 0.8 bias an estimate that trusts the model; no sensor is faulty."""
    scenario = osc.load_scenario(
        "panda_edge",
        [
            "control.estimate.joint_angular=0.5 rad/s²",
            "model_error.arm_mass=0.8",
            "model_error.object_mass=0.8",
            "sensors.encoder={rate: 500 Hz, angle: {noise: 0.02 mrad}, length: {noise: 10 um}}",
            "tare={}",
        ],
    )
    recording = run_of(scenario, duration=1.0)
    assert recording.meta["end_state"] != "SAFE_STOP", recording.meta["end_reason"]


def test_contact_is_made_although_every_second_tick_is_lost():
    """Phases advance with what the last computed tick measured."""
    run = Run(Case("approach", "approach_and_slide", every=2))
    seen = Verdict("no fault", Case())
    while run.k < 1500:
        run.step(seen)
    assert not seen.wrong, seen.wrong
    assert set(run.controller.phases()) == {CLOSED}
    assert_near(run.plant.truth().alpha, 10.0, rtol=0.2)


@parametrize(
    "fault, scenario, every",
    [
        ("speeds mirrored", "limited_rod", 0),  # hardly carries its weight, and brakes all the same
        ("encoder stuck", "hinge_ball_rod", 0),  # held 0.3 s after the stop, not creeping
        ("encoders stuck, speeds too", "panda_wrist", 0),  # at 2 mrad/s
        ("encoders stuck, speeds zero", "limited_rod", 2),  # commanded between two readings
    ],
)
def test_arms_rest_after_a_fault_that_is_hard_to_find(fault, scenario, every):
    verdict = try_fault(fault, Case("run", scenario, every), IN_CONTACT, **SHORT)
    assert verdict.state is SAFE_STOP and not verdict.wrong, verdict


# Faces pulled away: nothing runs away; pushes: back in contact


WITH_CONTACTS = [name for name in osc.list_scenarios() if osc.load_scenario(name).contacts]

#: what came out worst in `benchmarks/pushes.py`
WORST = (
    ("panda_dome", "off", 200.0, 0.1),
    ("dual_panda_rod", "off", 200.0, 0.1),
    ("ur5_wipe", "off", 60.0, 0.1),
    ("two_contact_rod", "along", 200.0, 0.1),
    ("panda_edge", "along", 200.0, 0.05),
    ("three_arm_plate", "into", 200.0, 0.05),
    ("moving_face", "into", 60.0, 0.05),
    ("workcell", "off", 120.0, 0.05),
)


def pull_away(name, by):
    """Take every face `by` (m) away from the object in contact, and continue for a second.

    Returns:
        The controller, joint speeds as shares of their limits, share of ticks that some contact was
        known to be lost.
    """
    loop = Run(Case(scenario=name))
    rig = loop.rig
    controller = loop.controller
    dt = loop.dt
    verdict = Verdict("no fault", loop.case)
    held = 0
    last = None
    lost = 0
    seen = []
    while last is None or loop.k < last:
        reference = loop.step(verdict)
        closed = (controller.phases() == Phase.CLOSED).all() and controller.engaged
        held = held + 1 if closed and (np.asarray(reference.alpha_d) > 1.0).any() else 0
        if last is None and held * dt > 0.5:
            last = loop.k + round(1.0 / dt)
            lines = rig.contact.N[:3]
            for i in range(len(rig.bodies)):
                into = lines[:, [rig.on[o] == i for o in rig.owners]].sum(axis=1)
                model = loop.true.model
                model.body_pos[model.body(f"face{i}/root").id] += by * unit(into)
        elif last is not None:
            lost += not closed
            seen.append(largest(loop.true.measure().v[loop.act] / loop.fastest))
        assert loop.k * dt < rig.scenario.duration, "it never was in contact"
    return (controller, seen, lost / len(seen))


@parametrize("name", chosen(WITH_CONTACTS, "two_contact_rod", "ur5_wipe", "hinge_ball_rod"))
def test_a_face_that_is_pulled_away_is_looked_for_or_the_arms_stop(name):
    controller, speeds, lost = pull_away(name, 0.2)
    assert max(speeds) < 1.0
    assert controller.state is SAFE_STOP or lost > 0.7, (lost, controller.reason)


@parametrize("name", ["two_contact_rod", "dual_panda_rod"])
def test_a_face_that_is_near_is_found_again(name):
    controller, speeds, lost = pull_away(name, 0.005)
    assert max(speeds) < 0.5 and 0.05 < lost < 0.9
    assert (controller.phases() == Phase.CLOSED).all()


def test_a_contact_that_is_not_found_again_stops_the_arms_until_a_reset():
    rig = rig_of("two_contact_rod")
    plant, controller = start(rig, 0)
    rows = controller.records
    for k in range(30):
        if k == 20:
            rows.memory.contacts.since[:] = 0.0
            rows.memory.columns.time_since_loss[0] = 0.99
        plant.command(controller.tick(plant.measure(), rig.references.at(0.001 * k)), 0.001)
        assert controller.state is not SAFE_STOP
    rows.memory.columns.time_since_loss[0] = 1.01
    for _ in range(2):
        controller.tick(plant.measure(), rig.references.at(0.03))
    assert controller.state is SAFE_STOP
    assert "not held again 1 s after it was lost" in controller.reason
    controller.reset()
    assert (rows.memory.columns.time_since_loss == 0.0).all()
    controller.tick(plant.measure(), rig.references.at(0.03))
    assert controller.state is RUN


@parametrize("name, load", {"limited_rod": 1.0014, "panda_edge": 0.37, "two_contact_rod": 0.12})
def test_the_least_load_of_the_motors_is_that_of_the_weight(name, load):
    """`limited_rod` has motors for 48.0 N of 48.07 N: stopped, it sinks back onto its faces."""
    rig = rig_of(name)
    assert least_load(rig) == approx(load, rel=0.02 if load < 1.0 else 1e-4)
    stronger = replace(rig, model=with_motors(rig.model, 2.0 * rig.model.tau_max))
    assert least_load(stronger) == approx(0.5 * least_load(rig), rel=1e-9)


@parametrize("push", first(WORST, 3))
def test_pushes_end_in_contact_or_in_a_stop(push):
    found = push_arm(*push)
    assert not found["wrong"], found


@mark.slow
def test_a_push_without_limits_and_phases_is_found_wrong():
    """The judge finds what it is there to find."""
    off = [f"control.safety.{key}=100 s" for key in ("contact_loss_time", "overspeed_time")]
    off += ["control.life=off", "control.safety.contact_power=1e9", "control.safety.brake_time=0"]
    assert push_arm("dual_panda_rod", "off", 1000.0, 0.1, off)["wrong"]
