"""Force laws of one's own: installed where they belong, without shared memory, refused if bad."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import pytest

import osc_contact as osc
from osc_contact.control.own_laws import force_law


@pytest.fixture(scope="module")
def rig() -> osc.Rig:
    changes = ["plant.type=rigid", "plant.step=2 ms", "control.rate=500 Hz"]
    return osc.build_rig(osc.load_scenario("two_contact_rod", changes))


class Seen:
    """Feed-forward plus a constant; counts its calls."""

    made: ClassVar[list[Seen]] = []

    def __init__(self) -> None:
        self.calls: list[tuple[np.ndarray, np.ndarray]] = []
        Seen.made.append(self)

    def __call__(self, desired: np.ndarray, measured: np.ndarray) -> np.ndarray:
        self.calls.append((desired, measured))
        return desired + [1.0, -2.0]


def test_the_plant_answers_what_the_law_commands(rig: osc.Rig) -> None:
    """eq. 25: with a sound model the true contact force is what was commanded, whatever the law."""
    controllers = [force_law(Seen)(rig.controller()) for _ in range(2)]
    plant = rig.plant()
    reference = rig.references.at(0.0)
    tau = controllers[0].tick(plant.measure(), reference)
    plant.hold(tau)
    np.testing.assert_allclose(
        plant.truth().alpha, np.asarray(reference.alpha_d) + [1.0, -2.0], atol=1e-6
    )
    first, second = Seen.made[-2:]
    assert len(first.calls) == 1 and not second.calls, "every controller has its own law"
    np.testing.assert_allclose(first.calls[0][0], reference.alpha_d)
    assert [b.name for b in controllers[0].wiring(plant.measure(), reference)].count(
        "own force law"
    ) == 1
    built_in = rig.controller()
    assert "own force law" not in [b.name for b in built_in.wiring(plant.measure(), reference)]


@pytest.mark.parametrize("bad", [[1.0], [1.0, np.nan], [[1.0, 2.0]]])
def test_a_law_that_returns_nonsense_holds_the_torques(rig: osc.Rig, bad: list[float]) -> None:
    plant, reference = rig.plant(), rig.references.at(0.0)
    controller = force_law(lambda: lambda desired, measured: bad)(rig.controller())
    tau = controller.tick(plant.measure(), reference)
    assert np.isfinite(tau).all() and controller.status is osc.Status.HELD
    assert "return 2 finite numbers" in controller.reason
