"""The control loop: a robot and its controller, tick by tick."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from time import perf_counter
from typing import Any, Protocol

from osc_contact.control.controller import Controller
from osc_contact.errors import InvalidInputError
from osc_contact.interface import Measurement, Reference, Robot
from osc_contact.plants.judge import Plant, Truth
from osc_contact.spatial import Array
from osc_contact.visual.live import Shows

__all__ = ["NEWS", "Controls", "Records", "Witness", "run_loop"]

NEWS = 100  #: ticks from one call of `progress` to the next


class Controls(Protocol):
    """What the loop asks of a controller."""

    @property
    def dt(self) -> float:
        """The control period (s)."""

    def tick(self, measurement: Measurement, reference: Reference) -> Array:
        """Motor torques (n_a,) for one period."""


class Records(Protocol):
    """What the loop asks of a recorder."""

    def append(
        self, measurement: Measurement, reference: Reference, tau: Array, seconds: float
    ) -> None:
        """Keep a tick before its torques act: what went in, what came out, what it took (s).

        Args:
            measurement, reference: of the tick. tau: (n_a,) its torques. seconds: spent on it.
        """

    def latest(self) -> Mapping[str, Any]:
        """The channels of the last tick, for a viewer; by default none."""
        return {}


class Witness(Records):
    """Keeps of every tick the truth just after its torques have changed.

    Rigid contacts answer torques at once; a `Recorder` notes what was true just before.

    Attributes:
        truths, status: of each tick.
    """

    def __init__(self, plant: Plant, controller: Controller) -> None:
        """Watch a plant and its controller."""
        self.plant, self.controller = plant, controller
        self.truths: list[Truth] = []
        self.status: list[int] = []

    def append(
        self, measurement: Measurement, reference: Reference, tau: Array, seconds: float
    ) -> None:
        """See `Records.append`.

        Args:
            measurement, reference, tau, seconds: as of `Records.append`.
        """
        self.plant.hold(tau)
        self.truths.append(self.plant.truth())
        self.status.append(int(self.controller.status))


def run_loop(
    robot: Robot,
    controller: Controls,
    references: Iterable[Reference],
    *,
    recorder: Records | None = None,
    viewer: Shows | None = None,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Measure, compute, record, command: once for each reference, then stop the robot.

    The robot keeps the time: `Robot.command` returns when the period is over. It is stopped in
    any case, also where the loop ends by an error or by Ctrl-C.

    Args:
        robot: hardware, or a plant.
        controller: a `Controller`, or anything with its `tick` and `dt`.
        references: one for each tick, of any length; a generator may go on for ever.
        recorder: notes every tick; a `Recorder` makes a recording of them, and asks the judge if
            it was given one.
        viewer: shows the run while it goes on; needs a recorder that gives it channels.
        progress: called with the time (s) now and then.

    Raises:
        InvalidInputError: a viewer without a recorder.
        PlantError: the simulation diverged, or what else the robot raises.
    """
    if viewer is not None and recorder is None:
        raise InvalidInputError("a viewer shows what is recorded; give the loop a recorder, too")
    period = controller.dt
    try:
        for k, reference in enumerate(references):
            measurement = robot.measure()
            start = perf_counter()
            tau = controller.tick(measurement, reference)
            seconds = perf_counter() - start
            if recorder is not None:
                recorder.append(measurement, reference, tau, seconds)
                if viewer is not None:
                    viewer.show(recorder.latest())
            robot.command(tau, period)
            if progress is not None and k % NEWS == NEWS - 1:
                progress((k + 1) * period)
    finally:
        robot.stop()
