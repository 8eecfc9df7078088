"""Imperfect sensors: a rate, a delay, noise, bias, resolution, lost samples.

`SensedPlant` is a plant around another plant: it replaces ideal readings by those of sensors with
errors. All random numbers follow from one seed.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact.interface import Measurement, Seen, Stamps, Touched, with_readings
from osc_contact.lab.scenarios.hardware import Clock, Errors, VisionSpec
from osc_contact.loop.judge import Plant, Truth, TruthLog
from osc_contact.spatial import Array

Reading = dict[str, Any]  #: parts of a `Measurement` by their names

_TIME_ROUNDING = 1e-9  #: rounding errors of sums of steps (s)
#: Part of a `Measurement` that a sensor reads, by the name of the sensor's stamp; not for vision.
_READ = {"encoders": "q", "joint_torques": "joint_torques", "wrists": "wrenches"}


@dataclass(frozen=True)
class SensorErrors:
    """Errors of a reading, of its shape or broadcast to it, in its units.

    Attributes:
        noise: standard deviation of each sample.
        bias: drawn once, uniform within ±bias.
        resolution: resolution of the quantisation, after bias and noise; 0: none.
    """

    noise: Array | float = 0.0
    bias: Array | float = 0.0
    resolution: Array | float = 0.0


@dataclass
class Sensor:
    """Sensor with its own clock, errors and delay.

    Attributes:
        clock: rate, delay and losses.
        ideal: function that returns the ideal value at present; called if a sample is taken.
        sample: function that makes a reading with errors from an ideal value.
        rng: random generator for lost samples.
        _queue: samples (time in s, reading), the oldest first: the one that was read last, then
            those that have not arrived yet.
        _due: time from which on the next sample is taken (s).
    """

    clock: Clock
    ideal: Callable[[], Array]
    sample: Callable[[Array], Reading]
    rng: np.random.Generator
    _queue: deque[tuple[float, Reading]] = field(init=False)
    _due: float = field(init=False)

    def begin(self, t: float, value: Array) -> None:
        """Delete all samples, and take the first one, which arrives at once and is never lost.

        Args:
            t: time (s).
            value: ideal value at this time.
        """
        self._queue = deque([(t, self.sample(value))])
        self._set_due(round(t * self.clock.rate) + 1)

    def observe(self, t: float) -> None:
        """Take a sample if one is due at the time t (s)."""
        if t < self._due:
            return
        # all samples that became due since the last call count as one
        self._set_due(int((t + _TIME_ROUNDING) * self.clock.rate) + 1)
        if self.rng.random() >= self.clock.dropout:
            self._queue.append((t, self.sample(self.ideal())))

    def _set_due(self, n: int) -> None:
        """Set the time of the next sample, that of number n, which is due at n / rate."""
        self._due = n / self.clock.rate - _TIME_ROUNDING

    def read(self, t: float) -> tuple[float, Reading]:
        """Latest sample that has arrived.

        Args:
            t: time (s).

        Returns:
            Time at which the sample was taken (s), and reading.
        """
        while len(self._queue) > 1 and self._queue[1][0] + self.clock.delay <= t + _TIME_ROUNDING:
            self._queue.popleft()
        return self._queue[0]


@dataclass(frozen=True)
class Sensors:
    """Errors of each kind of sensor; None: an ideal sensor.

    Attributes:
        encoders: joint positions (n,).
        joint_torques: (n_a,).
        wrists: (arms, 6).
        vision: poses of the object, the arms' tips and the touched bodies, each with its errors at
            the origin of its frame, about world axes.
        markers: (contacts, 4, 4) in E, the frame of each touched body that is seen; None: E itself.
    """

    encoders: tuple[Clock, SensorErrors] | None = None
    joint_torques: tuple[Clock, SensorErrors] | None = None
    wrists: tuple[Clock, SensorErrors] | None = None
    vision: VisionSpec | None = None
    markers: Array | None = None


class SensedPlant:
    """Plant whose measurements are made by sensors with errors.

    Joint velocities are NaN if encoders are modelled, twists of touched bodies NaN if vision is
    modelled, because these sensors do not measure them. Poses by vision are in the camera's frame.
    Sensors sample at the ends of commands, so that a higher rate has no effect.

    Attributes:
        plant: plant inside, which is moved by the methods of this one only.
        sensors: errors of the sensors.
        seed: seed of all random numbers.
        time: time since the last reset (s).
    """

    def __init__(self, plant: Plant, sensors: Sensors, seed: int = 0) -> None:
        """Put sensors around a plant; the same seed gives the same readings of the same motion."""
        self.plant = plant
        self.sensors = sensors
        self.seed = seed
        self._make_sensors()

    def reset(self, q: Array) -> None:
        """Start plant and sensors again at joint positions q (n,), with the same random errors."""
        self.plant.reset(q)
        self._make_sensors()

    def hold(self, tau: Array) -> None:
        """Apply torques tau (n_a,) without letting time pass; the sensors begin again."""
        self.plant.hold(tau)
        self._make_sensors()

    def command(self, tau: Array, duration: float) -> None:
        """Hold torques for a period; sensors that are due take a sample at its end.

        Args:
            tau: (n_a,) motor torques (N m, N).
            duration: period (s).
        """
        self.plant.command(tau, duration)
        self._update_time()
        for sensor in self._sensors_by_name.values():
            sensor.observe(self.time)

    def stop(self, reason: str = "") -> None:
        """Accept a stop; a simulation needs no action."""

    def truth(self) -> Truth:
        """True state of the plant, without errors of sensors."""
        return self.plant.truth()

    def poses(self) -> Array:
        """True poses (1 + arms, 4, 4) of object and tips, without errors of sensors."""
        return self.plant.poses()

    def log(self) -> TruthLog:
        """New, empty record of the plant's truth."""
        return self.plant.log()

    def measure(self) -> Measurement:
        """Measurement of the samples that have arrived, with their times."""
        stamps = dict.fromkeys((*_READ, "vision"), self.time)
        readings: Reading = {}
        for name, sensor in self._sensors_by_name.items():
            stamps[name], reading = sensor.read(self.time)
            readings |= reading
        return with_readings(self._ideal_measurement(), stamps=Stamps(**stamps), **readings)

    def torque_reading(self) -> tuple[float, Array | None]:
        """Time (s) and reading (n_a,) of the joint torque sensors, as `measure` has them."""
        sensor = self._sensors_by_name.get("joint_torques")
        if sensor is None:
            return self.time, self._ideal_value("joint_torques")
        stamp, reading = sensor.read(self.time)
        return stamp, reading["joint_torques"]

    def _update_time(self) -> None:
        """Update the time; the plant is measured once, when the first reading is used."""
        self.time = self.plant.time
        #: measurement of the plant at this instant; None: it was not needed yet
        self._measured: Measurement | None = None

    def _ideal_measurement(self) -> Measurement:
        """Measurement of the plant at this instant, which is made once."""
        if self._measured is None:
            self._measured = self.plant.measure()
        return self._measured

    def _make_sensors(self) -> None:
        """Make the sensors with their random errors, and take their first samples.

        Encoders, joint torque sensors, wrists and camera have random numbers of their own, so that
        leaving one out does not change the errors of the others.
        """
        self._update_time()
        #: function that reads one part of the plant's measurement by its name; None: there is none
        self._read_part = _part_reader(self.plant)
        self._robot_poses = len(self.plant.poses())  # object and arms come before the bodies
        self._sensors_by_name: dict[str, Sensor] = {}  #: sensors by the name of their quantity
        streams = np.random.default_rng([self.seed, 1]).spawn(4)
        for name, rng in zip((*_READ, "vision"), streams, strict=True):
            spec = getattr(self.sensors, name)
            value = None if spec is None else self._ideal_value(name)
            if value is None:
                continue
            if name == "vision":
                clock = spec
                corrupt = _vision_errors(spec, len(value), rng)
            else:
                clock, errors = spec
                corrupt = _reading_errors(errors, value.shape, rng)
            self._sensors_by_name[name] = Sensor(
                clock,
                partial(self._ideal_value, name),
                partial(self._make_reading, name, corrupt),
                rng,
            )
            self._sensors_by_name[name].begin(self.time, value)

    def _ideal_value(self, name: str) -> Any:
        """Ideal value that a sensor samples, without errors.

        Args:
            name: name of the sensor's stamp: "encoders", "joint_torques", "wrists" or "vision".

        Returns:
            encoders: positions (n,) of the joints (rad, m).
            joint_torques: torques (n_a,) of the motors (N m, N).
            wrists: wrenches (arms, 6) at the sensors' frames, as in `Measurement.wrenches`.
            vision: poses (bodies, 4, 4) in the world of the object, the arms' tips and, if the
                plant measures touched bodies, the marker of each.
            None if the plant measures no joint torques or no wrenches; it then has no such sensor.
        """
        if name != "vision":
            part = _READ[name]
            if self._read_part is not None:
                return self._read_part(part)
            return getattr(self._ideal_measurement(), part)
        poses = self.plant.poses()
        touched = self._ideal_measurement().touched
        if touched is None:
            return poses
        markers = np.eye(4) if self.sensors.markers is None else self.sensors.markers
        return np.concatenate((poses, touched.X_WE @ markers))

    def _make_reading(self, name: str, corrupt: Callable[[Array], Array], value: Array) -> Reading:
        """Make the reading of a sensor.

        Args:
            name: name of the sensor's stamp: "encoders", "joint_torques", "wrists" or "vision".
            corrupt: function that adds errors to a value.
            value: ideal value, of the shape that `_ideal_value` states for this name.

        Returns:
            Fields of a `Measurement` by their names. Encoders measure no velocities: v is NaN.
        """
        reading = corrupt(value)
        if name == "vision":
            return self._vision_reading(reading)
        if name == "encoders":
            return {"q": reading, "v": np.full_like(reading, np.nan)}
        return {_READ[name]: reading}

    def _vision_reading(self, poses: Array) -> Reading:
        """Convert measured poses to the fields of a measurement that vision provides.

        Args:
            poses: (bodies, 4, 4) measured poses of the object, the arms' tips and the markers of
                the touched bodies, in the camera's frame.

        Returns:
            Field `seen` with the poses of object and tips; with touched bodies also `touched`, with
            their poses, twists of NaN (vision does not measure them) and zero accelerations.
        """
        reading: Reading = {"seen": Seen(poses[0], poses[1 : self._robot_poses])}
        bodies = poses[self._robot_poses :]
        if len(bodies):
            if self.sensors.markers is not None:
                bodies = bodies @ np.linalg.inv(self.sensors.markers)
            unknown = np.full((len(bodies), 6), np.nan)
            reading["touched"] = Touched(bodies, unknown, np.zeros_like(unknown))
        return reading


def _part_reader(plant: Plant) -> Callable[[str], Array] | None:
    """Method `reading` of a plant, which reads one part of its measurement without the others.

    Args:
        plant: plant that may have the method.

    Returns:
        The method; None if the plant has none, or if its `measure` is not that of the class which
        defines `reading`, because its measurements then may have other values.
    """
    for kind in type(plant).__mro__:
        if "reading" in vars(kind):
            is_same = getattr(plant.measure, "__func__", None) is vars(kind).get("measure")
            return partial(vars(kind)["reading"], plant) if is_same else None
    return None


def _reading_errors(
    errors: SensorErrors | Errors[float], shape: tuple[int, ...], rng: np.random.Generator
) -> Callable[[Array], Array]:
    """Make the function that adds the errors of a sensor to a value; the bias is drawn once.

    Args:
        errors: noise, bias and resolution, in the unit of the values.
        shape: shape of the values.
        rng: random generator of the bias and of the noise.
    """
    bias = errors.bias * rng.uniform(-1.0, 1.0, shape)
    is_rounded = np.asarray(errors.resolution > 0.0)
    step = np.where(is_rounded, errors.resolution, 1.0)
    are_all_rounded = bool(is_rounded.all())

    def corrupt(value: Array) -> Array:
        """Add bias and noise to a value of the shape `shape`, and round it to the resolution."""
        reading = value + bias + errors.noise * rng.standard_normal(shape)
        rounded = np.round(reading / step) * step
        return rounded if are_all_rounded else np.where(is_rounded, rounded, reading)

    return corrupt


def _vision_errors(
    vision: VisionSpec, n: int, rng: np.random.Generator
) -> Callable[[Array], Array]:
    """Make the function that adds the errors of vision to n poses.

    All poses are displaced together by the error of the camera's frame, and each by its own bias
    and noise.

    Args:
        vision: errors of vision.
        n: number of poses.
        rng: random generator of biases and noise.
    """
    add_position_errors = _reading_errors(vision.position, (n, 3), rng)
    add_rotation_errors = _reading_errors(vision.orientation, (n, 3), rng)
    offset = vision.frame_position * rng.uniform(-1.0, 1.0, 3)
    R_CW = pin.exp3(vision.frame_orientation * rng.uniform(-1.0, 1.0, 3))

    def corrupt(X: Array) -> Array:
        """Measured poses (n, 4, 4) in the camera's frame, of true poses X (n, 4, 4)."""
        poses = X.copy()
        poses[:, :3, 3] = add_position_errors(X[:, :3, 3] @ R_CW.T + offset)
        for i, error in enumerate(add_rotation_errors(np.zeros((n, 3)))):
            poses[i, :3, :3] = pin.exp3(error) @ R_CW @ X[i, :3, :3]
        return poses

    return corrupt
