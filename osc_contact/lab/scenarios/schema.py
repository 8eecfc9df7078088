"""The scenario: frozen models whose attribute names are the keys of the YAML file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    PlainValidator,
    TypeAdapter,
    ValidationError,
    model_validator,
)
from pydantic_core import InitErrorDetails

from osc_contact.errors import ScenarioError
from osc_contact.files import Json
from osc_contact.lab.scenarios.bodies import ArmSpec, BodySpec, GraspSpec, Name, ObjectSpec
from osc_contact.lab.scenarios.checks import has_one_force, problems_across
from osc_contact.lab.scenarios.contact_keys import AnyContact
from osc_contact.lab.scenarios.hardware import PlantSpec, SensorsSpec
from osc_contact.lab.scenarios.plan_keys import PlanKeys
from osc_contact.lab.scenarios.signals import (
    AngleSignal,
    ForceSignal,
    JerkLimited,
    LengthSignal,
    total,
)
from osc_contact.settings.control import ControlSpec, ModelErrorSpec, TareSpec, VerdictSpec
from osc_contact.settings.gains import Gains
from osc_contact.settings.quantities import (
    Acceleration,
    Force,
    Jerk,
    Length,
    NotEmpty,
    NotNegative,
    Positive,
    Spec,
    Time,
    UnitVec3,
    Vec3,
    Velocity,
    refuse,
)

_UNIT_VECTOR: TypeAdapter[tuple[float, float, float]] = TypeAdapter(UnitVec3)


def _forward(span: tuple[float, float]) -> tuple[float, float]:
    """Refuse a span of time that ends before it begins."""
    begin, end = span
    if not begin < end:
        raise refuse(f"expected [from, to] with to > from, got [{begin:g} s, {end:g} s]")
    return span


Span = Annotated[tuple[Time, Time], AfterValidator(_forward)]  #: a span of time, [from, to] (s)


def _direction(value: Any) -> Any:
    """Validate a direction [x, y, z] as a unit vector; the word common_tangent is left as it is.

    Args:
        value: value of the key in the file.
    """
    if value == "common_tangent":
        return value
    if isinstance(value, str):
        raise refuse(f"expected a direction [x, y, z] or common_tangent; got {value!r}")
    return _UNIT_VECTOR.validate_python(value)


def _no_common_tangent(value: Any) -> Any:
    """Refuse the word common_tangent, which is no axis of an angular move; return other values.

    Args:
        value: value of the key in the file.
    """
    if value == "common_tangent":
        raise refuse(
            "common_tangent is a direction of linear moves only; give the axis of an angular move "
            "as [x, y, z]"
        )
    return value


def _take_laws(value: Any) -> Any:
    """Accept None, a function or `osc.Laws`, which only scenarios made in Python can have."""
    if value is None or callable(value) or hasattr(value, "structure"):
        return value
    raise refuse(f"expected osc.Laws, or a function that makes them; got {value!r}; no file can")


def _plain(value: Any) -> Any:
    """Copy of nested values in which arrays and tuples are lists, as YAML and JSON write them.

    Args:
        value: value of the key in the file.
    """
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


class LinearMove(Spec):
    """A translation along a fixed world direction; signals in metres, summed."""

    kind: Literal["linear"] = "linear"
    direction: Annotated[Any, PlainValidator(_direction)]
    """a world direction [x, y, z] or common_tangent"""
    signals: NotEmpty[LengthSignal]
    """a list of signals in lengths"""


class AngularMove(Spec):
    """A rotation about a fixed world direction; signals in radians, summed.

    About the object's origin, or about a point that linear moves carry along."""

    kind: Literal["angular"] = "angular"
    direction: Annotated[UnitVec3, BeforeValidator(_no_common_tangent)]
    """a world axis [x, y, z]"""
    through: Vec3 | None = None
    """point of the axis, world, which linear moves carry along; null: the object's origin"""
    signals: NotEmpty[AngleSignal]
    """a list of signals in angles"""


class SurfaceMove(Spec):
    """A path on the curved surface of a contact, the tool turned as the normal turns.

    The path is drawn in the plane that touches the surface at the start, and projected onto it.
    With `points` or a `raster` it goes from one point to the next and rests at each; `signals` give
    the way along `direction` instead; the displacements of several such moves are summed."""

    kind: Literal["surface"] = "surface"
    contact: Name
    """the name of the contact, a `sphere_on_surface`"""
    direction: UnitVec3
    """roughly the first axis of that plane [x, y, z] in world; the second is normal × first"""
    signals: tuple[LengthSignal, ...] = ()
    """the way along the first axis over time, a list of signals in lengths"""
    points: Annotated[tuple[tuple[Length, Length], ...], Field(max_length=500)] = ()
    """places [along the first axis, along the second], from the start, which is [0, 0]"""
    raster: tuple[Length, Length, Annotated[int, Field(ge=1, le=200)]] | None = None
    """[length, width, lines]: lines to and fro along the first axis, the start in the middle"""
    feed: Positive[Velocity] = 0.05
    """greatest speed between points"""
    acceleration: Positive[Acceleration] = 0.5
    """greatest acceleration between points"""
    jerk: Positive[Jerk] = 10.0
    """greatest jerk between points"""
    dwell: NotNegative[Time] = 0.0
    """rest at each point"""
    start: NotNegative[Time] = 0.0
    """when the first point is left for"""

    @property
    def duration(self) -> float:
        """Time at which the last point is reached (s)."""
        return self._legs()[1]

    def over(self, t: Any) -> Any:
        """Displacement along the two axes, velocity and acceleration (3, 2, k) (m, s).

        Args:
            t: (k,) times (s).
        """
        u = np.zeros((3, 2, len(t)))
        u[:, 0] = total(self.signals, t)
        legs, _ = self._legs()
        for direction, signal in legs:
            u += np.array(signal.at(t))[:, None] * direction[:, None]
        return u

    def _legs(self) -> tuple[list[tuple[Any, _Leg]], float]:
        """Straight legs from point to point.

        Returns:
            Direction (2,), a unit vector, and length over time (m) of each leg; time at which the
            last leg has ended, with the rest at its end (s).
        """
        t = self.start
        last = np.zeros(2)
        legs = []
        for point in (*self._lines(), *np.reshape(self.points, (-1, 2))):
            length = float(np.linalg.norm(point - last))
            if length > 0.0:
                leg = _Leg(
                    value=length,
                    start=t,
                    velocity=self.feed,
                    acceleration=self.acceleration,
                    jerk=self.jerk,
                )
                legs.append(((point - last) / length, leg))
                t += leg.duration + self.dwell
            last = point
        return legs, t

    def _lines(self) -> Any:
        """Ends of the parallel lines of a raster, which the path follows to and fro.

        Returns:
            (2 lines, 2) coordinates along and across the lines, relative to the centre of the
            raster (m), in the order of the path; no rows without a raster.
        """
        if self.raster is None:
            return np.zeros((0, 2))
        length, width, count = self.raster
        x = np.tile([-0.5, 0.5, 0.5, -0.5], count)[: 2 * count] * length  # to and fro
        y = np.repeat(np.linspace(-0.5, 0.5, count) if count > 1 else np.zeros(1), 2) * width
        return np.column_stack((x, y))


_Leg = JerkLimited[Length, Velocity, Acceleration, Jerk]
MotionSpec = Annotated[LinearMove | AngularMove | SurfaceMove, Field(discriminator="kind")]


class Scenario(Spec):
    """One experiment: arms, object, contacts, commands, gains, plant and duration (s).

    Example:
        >>> scenario = osc.load_scenario("two_contact_rod", ["squeeze=5 N"])
        >>> print(scenario.squeeze, scenario.replaced(duration=2.0).duration)
        5.0 2.0
    """

    name: Name
    """a name of letters, digits, _ and -"""
    description: str = ""
    """free text"""
    arms: Annotated[tuple[ArmSpec, ...], Field(min_length=1, max_length=8)]
    """a list of 1 to 8 arms"""
    object: ObjectSpec
    """the held object: urdf and pose"""
    grasps: dict[str, GraspSpec]
    """by arm name, the pose of the object in the tip frame"""
    environment: tuple[BodySpec, ...] = ()
    """bodies that contacts are on, any number of contacts each"""
    contacts: tuple[AnyContact, ...] = ()
    """the [contact pairs](contacts.md#pairs)"""
    force: dict[str, NotEmpty[ForceSignal]] = Field(default_factory=dict)
    """by contact name, a list of signals that are summed; a contact with several forces has an
    entry for each: `pad.1`, `pad.2`, …"""
    active: dict[Name, tuple[Span, ...]] = Field(default_factory=dict)
    """by contact name, the times `[from, to]` in which it is
    [active](contact_phases.md#active-sets); others always are. Without any, contacts that push are
    active, with phases only while a force is desired of them"""
    motion: tuple[MotionSpec, ...] = ()
    """moves away from the start pose"""
    plan: PlanKeys | None = None
    """a [plan](plans.md#in-a-scenario) in place of `force`, `active` and `motion`, with which the
    run ends; at `duration` it is aborted"""
    squeeze: Force = 0.0
    """internal force along the line between two grasps, > 0 compresses; with three arms or more
    along every such line, 0 for [least effort](theory.md#torques)"""
    gains: Gains = Gains()
    """the gains of the motion and the force loop"""
    control: ControlSpec
    """the tick rate and the metric"""
    model_error: ModelErrorSpec = ModelErrorSpec()
    """what the controller's model has wrong"""
    tare: TareSpec | None = None
    """start off the faces, zero the wrist sensors, approach, engage"""
    sensors: SensorsSpec = SensorsSpec()
    """the sensors of the rig; one that is left out is ideal"""
    plant: PlantSpec
    """the plant: type and step"""
    duration: Annotated[Time, Field(gt=0, le=1e6)]
    """the simulated time, such as 10 s"""
    verdict: VerdictSpec = VerdictSpec()
    """[limits of the verdict](scenario.md#limits-of-the-verdict)"""
    laws: Annotated[Any, PlainValidator(_take_laws), Field(exclude=True)] = None
    """custom laws, in [scenarios made in Python](extend.md#a-scenario-made-in-python) only"""

    _source: Path | None = None  #: file of the scenario; None: made in Python

    @property
    def source(self) -> Path | None:
        """File of the scenario; relative URDF paths refer to its folder. None: unknown."""
        return self._source

    @property
    def folder(self) -> Path | None:
        """Folder of the scenario's file, to which relative URDF paths refer; None: unknown."""
        return None if self._source is None else self._source.parent

    @property
    def file_stem(self) -> str:
        """Name of files with results: that of the scenario's file, or of the scenario."""
        return self.name if self._source is None else self._source.stem

    def with_source(self, source: Path | None) -> Scenario:
        """Copy of the scenario with another file, to whose folder relative paths refer.

        Args:
            source: path of the file; None: no file.
        """
        copy = self.model_copy()
        copy._source = source
        return copy

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], source: Path | None = None) -> Scenario:
        """Make a scenario in Python.

        Args:
            data: keys as in a file, with numbers in SI units or text with units; arrays may be
                given for lists. Beyond a file: `{"pair": object, "body": name}` among contacts, a
                motion with a `rail`, and `laws`.
            source: file to whose folder relative URDF paths refer.

        Raises:
            ScenarioError: errors in the data (all of them).
        """
        plain = _plain(data)
        try:
            folder = source and source.parent
            return cls.model_validate(plain, context={"folder": folder}).with_source(source)
        except ValidationError as error:
            from osc_contact.lab.scenarios.document import complaints

            lines = dict.fromkeys(  # each once
                f"{'.'.join(map(str, key))}: {text}" for key, text in complaints(error, plain, cls)
            )
            raise ScenarioError("\n".join(f"scenario: {line}" for line in lines)) from error

    def replaced(self, **parts: Any) -> Scenario:
        """Copy of the scenario with some of its keys replaced, and checked.

        Args:
            parts: values of keys, as for `from_dict` or parts of another scenario.

        Raises:
            ScenarioError: the parts do not fit together.
        """
        return self.from_dict({**dict(self), **parts}, self.source)

    def as_dict(self) -> Json:
        """Scenario as JSON data in SI units, from which `from_dict` makes an equal scenario."""
        return self.model_dump(mode="json")

    def __eq__(self, other: Any) -> bool:
        """Compare all keys; the files of the scenarios may differ."""
        return isinstance(other, Scenario) and self.__dict__ == other.__dict__

    @model_validator(mode="before")
    @classmethod
    def _let_a_tare_engage(cls, data: Any) -> Any:
        """Switch phases of several forces off beside a tare, unless `control.life` is given.

        After a tare all contacts are approached slowly and engaged together: with phases they would
        be made one after the other, each disturbed by the landings of the others. A single force is
        made by the guarded approach: where friction leaves the arm some millimetres off the face,
        it would land at the speed that the commanded force has given it by then.
        """
        if isinstance(data, dict) and data.get("tare") is not None and not has_one_force(data):
            control = data.get("control")
            if isinstance(control, dict) and "life" not in control:
                return {**data, "control": {**control, "life": None}}
        return data

    @model_validator(mode="after")
    def _check_across(self) -> Scenario:
        """Refuse values of different keys that contradict each other, with the path of each."""
        errors = [
            InitErrorDetails(type=refuse(text), loc=key, input=None)
            for key, text in problems_across(dict(self))
        ]
        if errors:
            raise ValidationError.from_exception_data("Scenario", errors)
        return self
