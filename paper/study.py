"""Options and results of a study: figures, a table and its numbers."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import pinocchio as pin
from matplotlib.figure import Figure
from rich.table import Table

import osc_contact as osc
from osc_contact.loop.judge import Plant, Truth
from paper.statements import Answer

Data = dict[str, Any]  #: numbers for JSON
T = TypeVar("T")
PANDA: Data = {
    "name": "panda",
    "urdf": "example-robot-data:panda",
    "tip": "panda_hand_tcp",
    "wrist_sensor": "panda_hand",
}
"""An arm of a scenario, but for its posture."""


@dataclass(frozen=True)
class Study:
    """Results of a study.

    Attributes:
        figures: figures by file name, without suffix.
        table: table to print; None of a figure of the paper.
        data: numbers, for JSON.
        answers: answers to the statements of the paper, by their keys in `PAPER`, if the study has
            the name of a figure.
        pages: functions that write a page to a path, by file name without suffix.
        files: files that have been written.
    """

    figures: Mapping[str, Figure]
    table: Table | None = None
    data: Data | None = None
    answers: Mapping[str, Answer] = field(default_factory=dict)
    pages: Mapping[str, Callable[[Path], Path]] = field(default_factory=dict)
    files: Sequence[Path] = ()

    @property
    def drawn(self) -> bool:
        """True if a picture is among the files; fig. 3 has none without a browser."""
        return any(path.suffix in (".png", ".svg") for path in self.files)


def silent(step: str) -> None:
    """Show no step of a study."""


@dataclass(frozen=True)
class Ask:
    """Options of a study.

    Attributes:
        seed: seed of everything random.
        duration: duration of simulated runs (s); default: the study's own.
        changes: "key=value" of its scenario, where it has one.
        samples: of what varies, where something does; default: the study's own.
        folder: for what a study keeps while it runs.
        tell: called with the next step.
        made: results of runs of the study that have been made before, by their names.
    """

    seed: int = 0
    duration: float | None = None
    changes: Sequence[str] = ()
    samples: int | None = None
    folder: Path = Path()
    tell: Callable[[str], None] = silent
    made: Mapping[str, Any] = field(default_factory=dict)

    def results(self, runs: Mapping[str, Callable[[], T]]) -> dict[str, T]:
        """The results of all runs of a study, by name; those not made yet are made one by one.

        Args:
            runs: runs by name, independent of each other.
        """
        found = {}
        for name, run in runs.items():
            self.tell(name)
            found[name] = self.made[name] if name in self.made else run()
        return found

    def lasting(self, usual: float) -> float:
        """The duration of its runs (s).

        Args:
            usual: duration if none is given (s).
        """
        return usual if self.duration is None else self.duration

    def all_changes(self) -> list[str]:
        """The changes of its scenario, with the duration among them."""
        lasts = [] if self.duration is None else [f"duration={self.duration!r}"]
        return [*self.changes, *lasts]


def table_of(title: str, heads: str, rows: Iterable[str | Iterable[object]]) -> Table:
    """A table to print.

    Args:
        title: above it.
        heads: heads of the columns, separated by "; ".
        rows: rows of cells, or one text of cells that are separated like the heads.
    """
    table = Table(*heads.split("; "), title=title)
    for row in rows:
        table.add_row(*(row.split("; ") if isinstance(row, str) else map(str, row)))
    return table


def with_object(chain: osc.ClosedChain) -> tuple[pin.Model, int]:
    """Pinocchio's model of the arms, the object on the first one's last link, and O's frame."""
    assert chain.payload is not None
    model = chain.model.copy()
    tip = model.frames[chain.tips[0]]
    X = tip.placement * chain.grasps[0].X_TO
    model.appendBodyToJoint(tip.parentJoint, chain.payload.inertia, X)
    return model, model.addFrame(pin.Frame("O", tip.parentJoint, X, pin.FrameType.OP_FRAME))


def ticks(
    plant: Plant, controller: osc.Controller, references: Iterable[osc.Reference]
) -> Iterator[tuple[osc.Measurement, osc.Reference, Truth]]:
    """A run: of every tick what is measured and desired, and the truth at its torques.

    Rigid contacts answer torques at once; a `Recorder` notes what was true just before.

    Args:
        plant: plant to be moved.
        controller: its controller, which is at the tick.
        references: one for each tick.
    """
    for reference in references:
        measurement = plant.measure()
        tau = controller.tick(measurement, reference)
        plant.hold(tau)
        yield measurement, reference, plant.truth()
        plant.command(tau, controller.dt)
