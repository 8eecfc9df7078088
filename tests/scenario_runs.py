"""Packaged scenarios with changes, of the two-contact rod unless another is named: rigs, runs."""

from numpy.testing import assert_allclose

import osc_contact as osc


def scenario_of(given, changes):
    """A name or a file is loaded, a scenario is there already."""
    return given if isinstance(given, osc.Scenario) else osc.load_scenario(given, changes)


def rig_of(given="two_contact_rod", *changes):
    """Rig of a scenario."""
    return osc.build_rig(scenario_of(given, changes))


def first_inputs(rig):
    """Measurement and reference of its first tick."""
    return (rig.plant().measure(), rig.references.at(0.0))


def run_of(given="two_contact_rod", *changes, **how):
    """The recording of its run."""
    return osc.run(scenario_of(given, changes), **how)


def verdict_of(given="two_contact_rod", *changes, **how):
    """Verdict on a run of a scenario."""
    return osc.metrics(run_of(given, *changes, **how))


def worst_force(verdict):
    """Largest rms error of a contact force, relative to its command."""
    return max(force["rms_error_rel"] for force in verdict["force"].values())


def always_closed(verdict):
    return set(verdict["contact_fraction"].values()) == {1.0}


def closed_force(verdict):
    """The same of contacts that were closed throughout."""
    assert always_closed(verdict)
    return worst_force(verdict)


def assert_accurate(verdict, forces=True):
    """Forces within 1 % rms and 5 % peak, 0.5 mm and 2 mrad, closed and unsaturated throughout."""
    for force in verdict["force"].values() if forces else ():
        assert force["rms_error_rel"] <= 0.01
        assert force["peak_error_rel"] <= 0.05
        assert force["sensing_rms_rel"] <= 0.01
    assert verdict["motion"]["rms_error_m"] <= 0.5e-3
    assert verdict["motion"]["rms_error_rad"] <= 2e-3
    assert always_closed(verdict)
    assert verdict["status"] == {"ok": verdict["ticks"], "saturated": 0, "held": 0, "degraded": 0}


def assert_same_run(one, other, atol=0.0):
    """All channels, to the last bit unless a tolerance is given, but the time of each tick."""
    assert one.channels.keys() == other.channels.keys()
    for name in set(one.channels) - {"tick_s"}:
        assert_allclose(other[name], one[name], rtol=0, atol=atol, err_msg=name)


def judged(scenario, key="rms_error_rel", install=None):
    """The worst of all forces, relative to its mean command; contact all the time."""
    verdict = verdict_of(scenario, duration=3.0, install=install)
    assert always_closed(verdict)
    return max(force[key] for force in verdict["force"].values())
