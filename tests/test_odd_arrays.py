"""Lists, single precision and strided arrays: the numbers of a tick, whatever they come in."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_array_equal
from pytest import fixture, mark, raises
from rigs import rig_of, shift

import osc_contact as osc
from osc_contact.control.controller import Controller
from osc_contact.spatial import as_array

DT = 1e-3
KINDS = {
    "float32": lambda x: np.asarray(x, dtype=np.float32),
    "strided": lambda x: np.repeat(x, 2, axis=-1)[..., ::2],
    "fortran": np.asfortranarray,
    "lists": lambda x: np.asarray(x).tolist(),
    "read-only": lambda x: np.frombuffer(np.asarray(x).tobytes()).reshape(np.shape(x)),
}


@fixture(scope="module")
def rig():
    return rig_of("two_contact_rod", "plant.type=rigid")


def of_kind(kind, measurement, reference):
    """The same tick in arrays of another kind."""
    make = KINDS[kind]
    m = {name: make(getattr(measurement, name)) for name in ("q", "v", "wrenches")}
    r = {name: make(getattr(reference, name)) for name in ("V_D", "A_D", "alpha_d")}
    return replace(measurement, **m), replace(reference, **r)


def rounded(measurement, reference):
    """In numbers that single precision holds."""
    return [
        replace(whole, **{name: np.float64(np.float32(getattr(whole, name))) for name in names})
        for whole, names in (
            (measurement, ("q", "v", "wrenches")),
            (reference, ("V_D", "A_D", "alpha_d")),
        )
    ]


@mark.parametrize("kind", KINDS)
@mark.parametrize("sequence", [False, True])
def test_other_arrays_are_found_out_once_and_give_the_same_torques(
    rig, monkeypatch, kind, sequence
):
    """The refusal of arrays by the compiled law costs as much as dozens of ticks: it comes once."""
    plant = rig.plant()
    refused = []
    convert = Controller._convert
    monkeypatch.setattr(
        Controller, "_convert", lambda self, *args: (refused.append(args), convert(self, *args))[1]
    )
    usual = rig.controller()
    other = rig.controller()
    for k in range(20):
        measurement, reference = rounded(plant.measure(), rig.references.at(k * DT))
        if sequence:
            measurement = replace(measurement, sequence=k)
        want = usual.tick(measurement, reference)
        tau = other.tick(*of_kind(kind, measurement, reference))
        assert other.status is usual.status, other.reason
        assert_array_equal(tau, want)
        assert np.array_equal(usual.motion_integral, other.motion_integral)
        plant.command(want, DT)
    assert usual.status is osc.Status.OK
    assert len(refused) <= 1, f"{len(refused)} of 20 ticks were refused first"


def test_arrays_of_the_usual_kind_meet_no_conversion(rig):
    controller = rig.controller()
    plant = rig.plant()
    controller.tick(plant.measure(), rig.references.at(0.0))
    assert not controller._converting
    copy = controller.with_gains(rig.gains)
    other = of_kind("lists", plant.measure(), rig.references.at(0.0))
    controller.tick(*other)
    assert controller._converting and not copy._converting


def test_a_list_of_wrong_length_is_still_refused(rig):
    controller = rig.controller()
    plant = rig.plant()
    measurement, reference = of_kind("lists", plant.measure(), rig.references.at(0.0))
    controller.tick(measurement, reference)
    assert controller.status is osc.Status.OK
    for bad in (
        replace(measurement, q=measurement.q[1:]),
        replace(measurement, q=["a"] * len(measurement.q)),
        replace(measurement, wrenches=[[1.0], [2.0, 3.0]]),
        replace(measurement, v=[np.nan] * len(measurement.v)),
    ):
        tau = controller.tick(bad, reference)
        assert controller.status is osc.Status.HELD and controller.reason
        assert np.isfinite(tau).all()
    controller.tick(measurement, reference)
    assert controller.status is osc.Status.OK


def test_a_plain_number_is_the_force_of_the_only_contact():
    rig = rig_of("panda_edge")
    measurement = rig.plant().measure()
    at = rig.references.at(0.0)
    assert at.alpha_d.shape == (1,)
    want = rig.controller().tick(measurement, at)
    number = float(at.alpha_d[0])
    controller = rig.controller()
    tau = controller.tick(measurement, replace(at, alpha_d=number))
    assert controller.status is osc.Status.OK, controller.reason
    assert_array_equal(tau, want)
    X = at.X_WD
    made = osc.pose_reference(X.translation, X.rotation, alpha_d=number)
    assert_array_equal(made.alpha_d, at.alpha_d)


def test_the_gap_of_gap_functions_may_be_a_plain_number():
    X = shift([0.0, 0.0, 0.02])
    V = np.zeros(6)
    many = osc.GapFunctions(lambda X: X.translation[2:]).contact(X, V)
    one = osc.GapFunctions(lambda X: X.translation[2]).contact(X, V)
    assert_array_equal(one.N, many.N)
    assert one.N.shape == (6, 1)


def test_a_plain_number_is_no_vector_of_a_given_size():
    with raises(osc.InvalidInputError, match=r"V_D: expected shape \(6\), got \(\)"):
        as_array("V_D", 1.0, (6,))
