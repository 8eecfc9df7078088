"""Rigs and runs of packaged scenarios with changes; the default is the two-contact rod."""

from numpy.testing import assert_allclose

import osc_contact as osc


def scenario_of(given, changes):
    """Scenario by its name or file, with changes; a scenario is returned unchanged."""
    return given if isinstance(given, osc.Scenario) else osc.load_scenario(given, changes)


def rig_of(given="two_contact_rod", *changes):
    """Rig of a scenario, given as in `scenario_of`."""
    return osc.build_rig(scenario_of(given, changes))


def first_inputs(rig):
    """Measurement and reference of the first tick of a rig."""
    return (rig.plant().measure(), rig.references.at(0.0))


def run_of(given="two_contact_rod", *changes, **how):
    """Recording of a run of a scenario; `how` has arguments of `osc.run`."""
    return osc.run(scenario_of(given, changes), **how)


def verdict_of(given="two_contact_rod", *changes, **how):
    """Verdict on a run of a scenario; `how` has arguments of `osc.run`."""
    return osc.metrics(run_of(given, *changes, **how))


def worst_force(verdict):
    """Largest rms error of a contact force, relative to its command."""
    return max(force["rms_error_rel"] for force in verdict["force"].values())


def always_closed(verdict):
    """True if all contacts were closed throughout a run."""
    return set(verdict["contact_fraction"].values()) == {1.0}


def closed_force(verdict):
    """Largest relative rms error of a contact force in a run whose contacts were always closed."""
    assert always_closed(verdict)
    return worst_force(verdict)


def assert_accurate(verdict, forces=True):
    """Assert errors of forces within 1 % rms and 5 % peak, of the pose within 0.5 mm and 2 mrad.

    Contacts have to be closed, and all ticks OK. `forces`: False leaves the forces out.
    """
    for force in verdict["force"].values() if forces else ():
        assert force["rms_error_rel"] <= 0.01
        assert force["peak_error_rel"] <= 0.05
        assert force["sensing_rms_rel"] <= 0.01
    assert verdict["motion"]["rms_error_m"] <= 0.5e-3
    assert verdict["motion"]["rms_error_rad"] <= 2e-3
    assert always_closed(verdict)
    others = dict.fromkeys(("saturated", "held", "degraded", "hopping"), 0)
    assert verdict["status"] == {"ok": verdict["ticks"]} | others


def assert_same_run(one, other, atol=0.0):
    """Assert that two recordings have equal channels, except the computing time of each tick.

    Args:
        one, other: recordings.
        atol: tolerance; 0: equal to the bit.
    """
    assert one.channels.keys() == other.channels.keys()
    for name in set(one.channels) - {"tick_s"}:
        assert_allclose(other[name], one[name], rtol=0, atol=atol, err_msg=name)


def judged(scenario, key="rms_error_rel", *more, install=None):
    """Largest error of all forces in a run of 3 s, relative to the mean command, always in contact.

    Args:
        scenario: scenario, or its name.
        key: name of the error in the verdict.
        *more: names of further errors; a tuple is returned then.
        install: see `osc.run`.
    """
    verdict = verdict_of(scenario, duration=3.0, install=install)
    assert always_closed(verdict)
    keys = (key, *more)
    errors = tuple(max(force[one] for force in verdict["force"].values()) for one in keys)
    return errors if more else errors[0]
