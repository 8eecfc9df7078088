"""Imperfect sensors: a rate, a delay, noise, bias, resolution, lost samples.

`SensedPlant` wraps any plant and is one: it turns ideal readings into sensed ones, so that neither
the plant inside nor the controller outside knows. Every draw comes from one seed.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import pinocchio as pin

from osc_contact.interface import Measurement, Seen, Stamps, Touched
from osc_contact.plants.judge import Plant, Truth, TruthLog
from osc_contact.scenarios.hardware import Clock, Errors, VisionSpec
from osc_contact.spatial import Array

__all__ = ["SensorErrors", "SensedPlant", "Sensor", "Sensors"]

_ON_TIME = 1e-9  # s, rounding of sums of steps


@dataclass(frozen=True)
class SensorErrors:
    """Errors of a reading, of its shape or broadcast to it, in its units.

    Attributes:
        noise: standard deviation of each sample. bias: drawn once, uniform within ±bias.
        resolution: of the quantisation, after bias and noise; 0: none.
    """

    noise: Array | float = 0.0
    bias: Array | float = 0.0
    resolution: Array | float = 0.0


@dataclass(frozen=True)
class _Drawn:
    noise: Array
    bias: Array
    resolution: Array

    def applied(self, value: Array, rng: np.random.Generator) -> Array:
        read = value + self.bias + self.noise * rng.standard_normal(value.shape)
        step = np.where(self.resolution > 0.0, self.resolution, 1.0)
        return np.where(self.resolution > 0.0, np.round(read / step) * step, read)


@dataclass
class Sensor:
    """One sensor: samples on its own clock, errs, delivers late.

    Attributes:
        clock: when. corrupt: what a sample of a value reads. rng: for lost samples.
    """

    clock: Clock
    corrupt: Callable[[Array], Array]
    rng: np.random.Generator
    _samples: deque[tuple[float, Array]] = field(default_factory=deque, init=False)
    _count: int = field(default=0, init=False)

    def begin(self, t: float, value: Array) -> None:
        """Forget everything; the first sample is there at once and never lost."""
        self._samples = deque([(t, self.corrupt(value))])
        self._count = round(t * self.clock.rate) + 1

    def observe(self, t: float, value: Callable[[], Array]) -> None:
        """Let it see the value at time t; it samples when one is due."""
        if t < self._count / self.clock.rate - _ON_TIME:
            return
        self._count = int((t + _ON_TIME) * self.clock.rate) + 1
        if self.rng.random() >= self.clock.dropout:
            self._samples.append((t, self.corrupt(value())))

    def read(self, t: float) -> tuple[float, Array]:
        """(time of the sample, reading) that has arrived by time t."""
        while len(self._samples) > 1 and self._samples[1][0] + self.clock.delay <= t + _ON_TIME:
            self._samples.popleft()
        return self._samples[0]


@dataclass(frozen=True)
class Sensors:
    """What each kind of sensor does to its readings; None: it is ideal.

    Attributes:
        encoders: joint positions (n,). joint_torques: (n_a,). wrists: (arms, 6).
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
    """A plant seen through its sensors.

    Joint velocities are NaN where encoders are modelled, twists of touched bodies NaN where vision
    is: neither sensor gives them. What vision sees is in the camera's frame. Sensors sample at the
    ends of steps: a rate above that of the steps is theirs.
    """

    def __init__(self, plant: Plant, sensors: Sensors, seed: int = 0) -> None:
        """Wrap a plant; the same seed gives the same readings of the same motion."""
        self.plant = plant
        self.sensors = sensors
        self.seed = seed
        self.time = plant.time
        self._begin()

    def reset(self, q: Array) -> None:
        """Start again, sensors included: same seed, same biases and noise."""
        self.plant.reset(q)
        self._begin()

    def hold(self, tau: Array) -> None:
        """Apply torques from now on; the sensors forget what they read before."""
        self.plant.hold(tau)
        self._begin()

    def command(self, tau: Array, duration: float) -> None:
        """Hold the torques; the sensors look at the end."""
        self.plant.command(tau, duration)
        self.time = self.plant.time
        ideal = self.plant.measure()
        for name, sensor in self._sensor.items():
            sensor.observe(self.time, partial(self._value, name, ideal))

    def stop(self, reason: str = "") -> None:
        """Nothing to do."""

    def truth(self) -> Truth:
        """Of the plant inside: sensors do not touch it."""
        return self.plant.truth()

    def poses(self) -> Array:
        """Of the plant inside."""
        return self.plant.poses()

    def log(self) -> TruthLog:
        """Of the plant inside."""
        return self.plant.log()

    def measure(self) -> Measurement:
        """What has arrived by now, and when it was sampled."""
        measurement = self.plant.measure()
        stamps = Stamps(*[self.time] * 4)
        for name, sensor in self._sensor.items():
            at, reading = sensor.read(self.time)
            stamps = replace(stamps, **{name: at})
            if name == "encoders":
                measurement = replace(measurement, q=reading, v=np.full(len(reading), np.nan))
            elif name == "joint_torques":
                measurement = replace(measurement, joint_torques=reading)
            elif name == "wrists":
                measurement = replace(measurement, wrenches=reading)
            else:
                measurement = self._pictured(measurement, reading)
        return replace(measurement, stamps=stamps)

    def _begin(self) -> None:
        self.time = self.plant.time
        ideal = self.plant.measure()
        streams = iter(np.random.default_rng([self.seed, 1]).spawn(4))
        self._sensor: dict[str, Sensor] = {}
        for name in ("encoders", "joint_torques", "wrists"):
            rng = next(streams)
            spec = getattr(self.sensors, name)
            value = None if spec is None else self._value(name, ideal)
            if spec is not None and value is not None:
                clock, errors = spec
                self._sensor[name] = Sensor(clock, _noisy(errors, value.shape, rng), rng)
        rng = next(streams)
        vision = self.sensors.vision
        if vision is not None:
            poses = self._value("vision", ideal)
            self._robots = len(self.plant.poses())  # object and arms come before the bodies
            self._sensor["vision"] = Sensor(vision, _pictures(vision, len(poses), rng), rng)
        for name, sensor in self._sensor.items():
            sensor.begin(self.time, self._value(name, ideal))

    def _value(self, name: str, ideal: Measurement) -> Array:
        """The ideal reading behind a sensor, by the name of its stamp."""
        if name == "vision":
            poses = self.plant.poses()
            touched = ideal.touched
            if touched is None:
                return poses
            markers = self.sensors.markers
            bodies = touched.X_WE if markers is None else touched.X_WE @ markers
            return np.concatenate((poses, bodies))
        attribute = {"encoders": "q", "joint_torques": "joint_torques", "wrists": "wrenches"}[name]
        value: Array = getattr(ideal, attribute)
        return value

    def _pictured(self, measurement: Measurement, poses: Array) -> Measurement:
        """The measurement with what a picture shows."""
        measurement = replace(measurement, seen=Seen(poses[0], poses[1 : self._robots]))
        bodies = poses[self._robots :]
        markers = self.sensors.markers
        if not len(bodies):
            return measurement
        if markers is not None:
            bodies = bodies @ np.linalg.inv(markers)
        unknown = np.full((len(bodies), 6), np.nan)
        return replace(measurement, touched=Touched(bodies, unknown, np.zeros_like(unknown)))


def _draw(
    errors: SensorErrors | Errors[float], shape: tuple[int, ...], rng: np.random.Generator
) -> _Drawn:
    """The errors of one sensor, its bias fixed."""
    return _Drawn(
        np.broadcast_to(errors.noise, shape),
        np.broadcast_to(errors.bias, shape) * rng.uniform(-1.0, 1.0, shape),
        np.broadcast_to(errors.resolution, shape),
    )


def _noisy(
    errors: SensorErrors, shape: tuple[int, ...], rng: np.random.Generator
) -> Callable[[Array], Array]:
    drawn = _draw(errors, shape, rng)
    return lambda value: drawn.applied(value, rng)


def _pictures(vision: VisionSpec, n: int, rng: np.random.Generator) -> Callable[[Array], Array]:
    """All poses displaced alike by the camera's frame, each by its own bias and noise."""
    shift = _draw(vision.position, (n, 3), rng)
    turn = _draw(vision.orientation, (n, 3), rng)
    offset = vision.frame_position * rng.uniform(-1.0, 1.0, 3)
    R_CW = pin.exp3(vision.frame_orientation * rng.uniform(-1.0, 1.0, 3))

    def corrupt(X: Array) -> Array:
        read = X.copy()
        read[:, :3, 3] = shift.applied(X[:, :3, 3] @ R_CW.T + offset, rng)
        for i, error in enumerate(turn.applied(np.zeros((n, 3)), rng)):
            read[i, :3, :3] = pin.exp3(error) @ R_CW @ X[i, :3, :3]
        return read

    return corrupt
