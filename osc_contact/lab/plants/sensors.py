"""Imperfect sensors: a rate, a delay, noise, bias, resolution, lost samples.

`SensedPlant` wraps any plant and is one: it replaces ideal readings by sensed ones, which
changes neither plant nor controller. Every random number comes from one seed.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache, partial
from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact.interface import Measurement, Seen, Stamps, Touched
from osc_contact.lab.scenarios.hardware import Clock, Errors, VisionSpec
from osc_contact.loop.judge import Plant, Truth, TruthLog
from osc_contact.spatial import Array

Reading = dict[str, Any]  #: parts of a `Measurement` by their names

_ON_TIME = 1e-9  # s, rounding of sums of steps
#: Of each sensor but vision, by the name of its stamp, what of a measurement it reads.
_READ = {"encoders": "q", "joint_torques": "joint_torques", "wrists": "wrenches"}


@dataclass(frozen=True)
class SensorErrors:
    """Errors of a reading, of its shape or broadcast to it, in its units.

    Attributes:
        noise: standard deviation of each sample. bias: drawn once, uniform within ±bias.
        resolution: resolution of the quantisation, after bias and noise; 0: none.
    """

    noise: Array | float = 0.0
    bias: Array | float = 0.0
    resolution: Array | float = 0.0


@dataclass
class Sensor:
    """One sensor: samples on its own clock, errs, delivers late.

    Attributes:
        clock: when. sample: what it reads of a value, as parts of a measurement by their names.
        rng: random generator for lost samples.
    """

    clock: Clock
    sample: Callable[[Array], Reading]
    rng: np.random.Generator
    _samples: deque[tuple[float, Reading]] = field(init=False)
    _count: int = field(init=False)

    def begin(self, t: float, value: Array) -> None:
        """Forget everything; the first sample is there at once and never lost."""
        self._samples = deque([(t, self.sample(value))])
        self._count = round(t * self.clock.rate) + 1

    def observe(self, t: float, value: Callable[[], Array]) -> None:
        """Let it see the value at time t; it samples when one is due."""
        if t < self._count / self.clock.rate - _ON_TIME:
            return
        self._count = int((t + _ON_TIME) * self.clock.rate) + 1
        if self.rng.random() >= self.clock.dropout:
            self._samples.append((t, self.sample(value())))

    def read(self, t: float) -> tuple[float, Reading]:
        """(time of the sample, reading) that has arrived by time t."""
        while len(self._samples) > 1 and self._samples[1][0] + self.clock.delay <= t + _ON_TIME:
            self._samples.popleft()
        return self._samples[0]


@dataclass(frozen=True)
class Sensors:
    """Errors of each kind of sensor; None: an ideal sensor.

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
    ends of steps: a rate above that of the steps is theirs. The plant inside is moved by this one's
    methods only: what it measures is taken once an instant.
    """

    def __init__(self, plant: Plant, sensors: Sensors, seed: int = 0) -> None:
        """Wrap a plant; the same seed gives the same readings of the same motion."""
        self.plant = plant
        self.sensors = sensors
        self.seed = seed
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
        self._look()
        for name, sensor in self._sensor.items():
            sensor.observe(self.time, partial(self._value, name))

    def stop(self, reason: str = "") -> None:
        """Nothing to do."""

    def truth(self) -> Truth:
        """Truth of the plant, which the sensors do not affect."""
        return self.plant.truth()

    def poses(self) -> Array:
        """Of the plant inside."""
        return self.plant.poses()

    def log(self) -> TruthLog:
        """Of the plant inside."""
        return self.plant.log()

    def measure(self) -> Measurement:
        """Measurement of the samples that have arrived, with their times."""
        stamps = dict.fromkeys((*_READ, "vision"), self.time)
        read: Reading = {}
        for name, sensor in self._sensor.items():
            stamps[name], reading = sensor.read(self.time)
            read |= reading
        return replace(self._ideal(), stamps=Stamps(**stamps), **read)

    def _look(self) -> None:
        """A new instant: the plant is measured when the first of its readings is used, once."""
        self.time = self.plant.time
        self._ideal = cache(self.plant.measure)

    def _begin(self) -> None:
        self._look()
        self._robots = len(self.plant.poses())  # object and arms come before the bodies
        self._sensor: dict[str, Sensor] = {}
        streams = np.random.default_rng([self.seed, 1]).spawn(4)
        for name, rng in zip((*_READ, "vision"), streams, strict=True):
            spec = getattr(self.sensors, name)
            value = None if spec is None else self._value(name)
            if value is None:
                continue
            if name == "vision":
                clock = spec
                corrupt = _pictures(spec, len(value), rng)
            else:
                clock, errors = spec
                corrupt = _noisy(errors, value.shape, rng)
            self._sensor[name] = Sensor(clock, partial(self._sample, name, corrupt), rng)
            self._sensor[name].begin(self.time, value)

    def _value(self, name: str) -> Any:
        """The ideal reading behind a sensor, by the name of its stamp; None: there is none."""
        if name != "vision":
            return getattr(self._ideal(), _READ[name])
        poses = self.plant.poses()
        touched = self._ideal().touched
        if touched is None:
            return poses
        markers = np.eye(4) if self.sensors.markers is None else self.sensors.markers
        return np.concatenate((poses, touched.X_WE @ markers))

    def _sample(self, name: str, corrupt: Callable[[Array], Array], value: Array) -> Reading:
        """The reading of a sensor for a value, with the errors of `corrupt`."""
        reading = corrupt(value)
        if name == "vision":
            return self._pictured(reading)
        if name == "encoders":
            return {"q": reading, "v": np.full_like(reading, np.nan)}
        return {_READ[name]: reading}

    def _pictured(self, poses: Array) -> Reading:
        """Seen object and robots, and touched bodies, as fields of a measurement.

        Args:
            poses: (bodies, 4, 4) poses in a picture: object, robots, touched bodies.
        """
        read: Reading = {"seen": Seen(poses[0], poses[1 : self._robots])}
        bodies = poses[self._robots :]
        if len(bodies):
            if self.sensors.markers is not None:
                bodies = bodies @ np.linalg.inv(self.sensors.markers)
            unknown = np.full((len(bodies), 6), np.nan)
            read["touched"] = Touched(bodies, unknown, np.zeros_like(unknown))
        return read


def _noisy(
    errors: SensorErrors | Errors[float], shape: tuple[int, ...], rng: np.random.Generator
) -> Callable[[Array], Array]:
    """The errors of one sensor, its bias fixed, as a function of values of that shape."""
    bias = errors.bias * rng.uniform(-1.0, 1.0, shape)
    steps = errors.resolution > 0.0
    step = np.where(steps, errors.resolution, 1.0)

    def corrupt(value: Array) -> Array:
        read = value + bias + errors.noise * rng.standard_normal(shape)
        return np.where(steps, np.round(read / step) * step, read)

    return corrupt


def _pictures(vision: VisionSpec, n: int, rng: np.random.Generator) -> Callable[[Array], Array]:
    """All poses displaced alike by the camera's frame, each by its own bias and noise."""
    shifted = _noisy(vision.position, (n, 3), rng)
    turned = _noisy(vision.orientation, (n, 3), rng)
    offset = vision.frame_position * rng.uniform(-1.0, 1.0, 3)
    R_CW = pin.exp3(vision.frame_orientation * rng.uniform(-1.0, 1.0, 3))

    def corrupt(X: Array) -> Array:
        read = X.copy()
        read[:, :3, 3] = shifted(X[:, :3, 3] @ R_CW.T + offset)
        for i, error in enumerate(turned(np.zeros((n, 3)))):
            read[i, :3, :3] = pin.exp3(error) @ R_CW @ X[i, :3, :3]
        return read

    return corrupt
