"""Mistakes in Python and at the command line that are told in a sentence with its cure."""

from typing import ClassVar

import numpy as np
from command_line import done, refused
from complaints import invalid_input, model_error, scenario_error
from pytest import mark, raises
from scenario_runs import rig_of, run_of

import osc_contact as osc


class Floor:
    """A pair of one's own: the object's origin on the floor, with N of the wrong sign."""

    name: ClassVar[str] = "floor"
    pushes: ClassVar[bool] = True

    def contact(self, X_WO, V_O, X_WE=None, V_E=None):
        return osc.Contact(np.array([[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]]).T, np.zeros(1))

    def gaps(self, X_WO, X_WE=None):
        return np.array([X_WO.translation[2] - 0.3])


class Gapless:
    name: ClassVar[str] = "floor"
    contact = Floor.contact


class TwoGaps(Floor):
    def gaps(self, X_WO, X_WE=None):
        return np.zeros(2)


def on_the_table(pair, *names):
    scenario = osc.load_scenario("panda_edge")
    force = {name: [{"type": "constant", "value": 10.0}] for name in names or ("floor",)}
    return scenario.replaced(contacts=[{"pair": pair, "body": "table"}], force=force)


def test_pairs_of_ones_own_that_do_not_fit():
    with scenario_error(r"Gapless has no gaps; a custom pair has"):
        on_the_table(Gapless())
    with scenario_error("reverse the sign of N or of gaps"):
        osc.build_rig(on_the_table(Floor()))
    with scenario_error("one column of N"):
        osc.build_rig(on_the_table(TwoGaps(), "floor.1", "floor.2"))


@mark.parametrize(
    "install, words",
    [
        (5, "got 5"),
        (lambda: None, "takes 0 positional arguments"),
        (lambda controller: None, "which has no tick"),
        (osc.Controller, "missing 1 required positional argument"),
    ],
)
def test_what_install_takes(install, words):
    scenario = osc.load_scenario("panda_edge", ["duration=1.1 s"])
    with invalid_input(f"install= takes a function.*{words}"):
        osc.run(scenario, install=install)


def test_mistakes_of_an_install_are_its_own():
    def install(controller):
        return controller + 1

    with raises(TypeError, match="unsupported operand"):
        run_of("panda_edge", install=install)


def test_one_force_for_two_contacts():
    rig = rig_of()
    controller = rig.controller()
    at = rig.references.at(0.0)
    controller.tick(rig.plant().measure(), osc.Reference(at.X_WD, alpha_d=10.0))
    assert controller.status is osc.Status.HELD
    assert "1 forces for 2 columns of N; give one for each degree" in controller.reason


def test_robots_that_are_nearly_called_so():
    with model_error("Did you mean ur10 "):
        osc.robots.find_robot("ur10e")


def test_a_posture_that_does_not_serve_is_called_so(tmp_path):
    line = "new --robot panda --tip panda_hand_tcp --press Z=10 --posture '0, 0, 0' --out"
    said = refused(line, tmp_path / "my.yaml")
    assert "in the posture given" in said and "or none to have one sought" in said


def test_seeds_find_other_postures():
    line = "pose panda --tip panda_hand_tcp --xyz '0.4, 0.1, 0.4'"
    assert len({done(f"{line} {seed}").stdout for seed in ("", "--seed 1", "--seed 2")}) == 3
    assert "give --xyz or --rpy" in refused("pose panda --tip panda_hand_tcp --seed 1")


def test_inspect_prints_motions_of_a_light_object_in_small_numbers():
    rig = rig_of("panda_edge")
    rows = done("inspect panda_edge").stdout.splitlines()
    numbers = [
        float(x) for row in rows if "(m/s)" in row or "(rad/s)" in row for x in row.split("│")[2:-1]
    ]
    assert len(numbers) == 30 and max(map(abs, numbers)) == 1.0
    assert np.abs(rig.contact().T).max() > 1.5  # as they are
