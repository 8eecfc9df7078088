"""Faults in closed loop on the MuJoCo plant; see benchmarks/fault_injection.py."""

import numpy as np
from samples import first, parametrize

from benchmarks.fault_injection import (
    FAULTS,
    PHASES,
    cases,
    stay_quiet,
    try_fault,
    try_faults,
)

#: those of other phases than contact that once went wrong
ELSEWHERE = (
    ("encoder stuck", "approach"),
    ("encoders stuck, speeds too", "near singular"),
    ("wrists read zero", "after a hold"),
    ("speeds mirrored", "saturated"),
    ("packet repeats for ever", "start"),
    ("speeds zero", "approach"),
    ("speeds mirrored", "approach"),
    ("speed noise of 0.05 rad/s", "approach"),
    ("encoders stuck, speeds too", "approach"),
    ("encoders stuck, speeds zero", "approach"),
    ("one wrist mirrored", "approach"),
    ("wrists times 0.3", "approach"),
)


@parametrize("name", FAULTS)
def test_every_kind_of_fault_in_contact(name):
    verdict = try_fault(name, "contact")
    assert not verdict.wrong, verdict


@parametrize("where", first(ELSEWHERE, 5))
def test_faults_in_other_phases(where):
    name, phase = where
    assert phase in PHASES
    verdict = try_fault(name, phase)
    assert not verdict.wrong, verdict


def _drawn(count, seed):
    """Cases with lost ticks, and three faults for each, of all packaged scenarios."""
    rng = np.random.default_rng(seed)
    some = [case for case in cases(1) if case.every and case.phase == "contact"]
    chosen = rng.choice(len(some), count, replace=False)
    return [(some[i], sorted(rng.choice(sorted(FAULTS), 3, replace=False))) for i in chosen]


@parametrize("drawn", first(_drawn(8, 25), 1), ids=lambda x: str(x)[:60])
def test_faults_while_ticks_are_lost_in_packaged_scenarios(drawn):
    case, names = drawn
    verdicts = try_faults(case, names)
    assert not [v.wrong for v in verdicts if v.wrong], verdicts


@parametrize("scenario", ["two_contact_rod", "panda_edge"])
def test_noise_and_delay_stop_nothing(scenario):
    assert stay_quiet(scenario, 3.0) == ""


def test_a_fault_is_found_wrong_where_the_limits_are_off(monkeypatch):
    """The judge sees what it is there to see."""
    import osc_contact as osc
    from benchmarks import fault_injection

    real = fault_injection.start

    def bare(rig, seed):
        plant, controller = real(rig, seed)
        return plant, controller.with_safety(osc.SafetySettings.motors_only())

    monkeypatch.setattr(fault_injection, "start", bare)
    assert try_fault("speeds mirrored", "contact").wrong
