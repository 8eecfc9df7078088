"""Packaged scenarios with changes, of the two-contact rod unless another is named: rigs, runs."""

from numpy.testing import assert_array_equal

import osc_contact as osc


def rig_of(name="two_contact_rod", *changes):
    """What a scenario describes."""
    return osc.build_rig(osc.load_scenario(name, changes))


def run_of(name="two_contact_rod", *changes, **how):
    """The recording of its run."""
    return osc.run(osc.load_scenario(name, changes), **how)


def verdict_of(name="two_contact_rod", *changes, **how):
    """What a run of it is judged to be."""
    return osc.metrics(run_of(name, *changes, **how))


def worst_force(verdict):
    """Largest rms error of a contact force, relative to its command."""
    return max(force["rms_error_rel"] for force in verdict["force"].values())


def assert_same_run(one, other):
    """All channels to the last bit but the time that each tick took."""
    assert one.channels.keys() == other.channels.keys()
    for name in set(one.channels) - {"tick_s"}:
        assert_array_equal(other[name], one[name], name)
