"""Parts of a control loop beside the robot, as the loop uses them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Protocol, runtime_checkable

from osc_contact.interface import Measurement, Reference
from osc_contact.spatial import Array


class Controls(Protocol):
    """Controller, as the loop uses it."""

    @property
    def dt(self) -> float:
        """Control period (s)."""

    def tick(self, measurement: Measurement, reference: Reference) -> Array:
        """Motor torques (n_a,) for one period (N m, N)."""


@runtime_checkable
class Leads(Protocol):
    """Source of references that depend on the course of the run, as the loop uses a `Plan`."""

    @property
    def ended(self) -> bool:
        """Whether there are no more references, so that the loop ends."""

    def begin(
        self, controller: Any, measurement: Measurement, log: Callable[..., None] | None = None
    ) -> None:
        """Check that the controller can follow the references, and begin with the first one.

        Args:
            controller: controller of the loop.
            measurement: reading of the robot at rest.
            log: function that records an event of the loop with its facts; None: no record.

        Raises:
            InvalidInputError: the controller cannot follow these references.
        """

    def step(self) -> Reference:
        """Reference of the next tick, from the controller's results in the last tick."""

    def placed(self, measurement: Measurement) -> Measurement:
        """Measurement of a tick with the poses of touched bodies that were found in the run.

        Args:
            measurement: reading of the robot, which is not changed.
        """


def references_of(lead: Leads) -> Iterator[Reference]:
    """Yield the references of a plan, one for each tick, until the plan has ended."""
    while not lead.ended:
        yield lead.step()


class Measures(Protocol):
    """Robot at rest, as the checks before the first torques use it.

    Its current `Scene` is compared, too, where it has a method `scene`.
    """

    def measure(self) -> Measurement:
        """Read all sensors."""


class Records(Protocol):
    """Recorder, as the loop uses it."""

    def append(
        self, measurement: Measurement, reference: Reference, tau: Array, seconds: float
    ) -> None:
        """Record a tick before its torques act.

        Args:
            measurement: readings of the tick.
            reference: desired motion and forces of the tick.
            tau: (n_a,) motor torques of the tick (N m, N).
            seconds: computing time of the tick (s).
        """

    def latest(self) -> Mapping[str, Any]:
        """Channels of the last tick, for a viewer; empty by default."""
        return {}

    def log(self, event: str, **facts: Any) -> None:
        """Record an event of the loop, for example "stop" with its reason; ignored by default."""


class Shows(Protocol):
    """Viewer, as the loop uses it."""

    def show(self, tick: Mapping[str, Any]) -> None:
        """Draw the channels of one tick; returns at once. An error ends the view, not the run."""
