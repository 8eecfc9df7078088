"""Wrist calibration of a scenario's arms: static postures, sensed readings, what is found."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact import robots
from osc_contact.dynamics.closed_chain import ClosedChain, outboard_links
from osc_contact.errors import InvalidInputError
from osc_contact.plants.rigid import RigidPlant
from osc_contact.plants.sensors import SensedPlant
from osc_contact.robots.model import position_limits
from osc_contact.runs import hardware
from osc_contact.runs.rig import build_chain
from osc_contact.scenarios.schema import Scenario
from osc_contact.sensing.calibration import WristLoad, calibrate_wrist
from osc_contact.spatial import Array, norm

STEP = 1e-3
SETTLE = 0.05  #: s, left out of each average: the readings in it may be older than the posture
SPREAD = 0.6  #: rad, the largest distance of a joint from the scenario's posture
LEAST_NOISE = (1e-6, 1e-8)  # N, N m: weighs forces against torques where the sensors are ideal


@dataclass(frozen=True)
class WristCalibration:
    """What was found of one arm's wrist, and what is true."""

    arm: str
    found: WristLoad
    mass: float  #: true (kg)
    com: Array  #: (3,) true, sensor axes (m)

    def as_dict(self) -> dict[str, Any]:
        """JSON-able."""
        return {
            "mass_kg": self.found.mass,
            "true_mass_kg": self.mass,
            "com_m": self.found.com.tolist(),
            "true_com_m": self.com.tolist(),
            "bias": self.found.bias.tolist(),
            "mass_error_rel": abs(self.found.mass / self.mass - 1.0),
            "com_error_m": norm(self.found.com - self.com),
        }


def calibrate(
    scenario: Scenario, postures: int = 8, average: float = 0.25, seed: int = 0
) -> list[WristCalibration]:
    """Calibrate every wrist: the arm alone holds the object at rest in random postures.

    The readings come from the exact plant through the scenario's sensors; posture and orientation
    from its encoders.

    Args:
        scenario: arms, object and sensors. postures: how many. average: s of readings in each.
        seed: of postures and sensors.

    Raises:
        InvalidInputError: no arm has a wrist sensor, or nothing to average.
        ModelError: weight and bias are the same in these postures (arms that never tilt the wrist).
    """
    if not average > 0.0:
        raise InvalidInputError(f"average = {average} s; give a time > 0 for each posture")
    whole = build_chain(scenario)
    start = np.concatenate([arm.posture for arm in scenario.arms])
    found = []
    for i, s in enumerate(whole.slices):
        if whole.arms[i].wrist_sensor is not None:
            chain = ClosedChain([whole.arms[i]], [whole.grasps[i]], whole.payload)
            found.append(_one(scenario, chain, start[s], postures, average, seed + i))
    if not found:
        raise InvalidInputError("no arm has a wrist_sensor to calibrate")
    return found


def _one(
    scenario: Scenario, chain: ClosedChain, start: Array, postures: int, average: float, seed: int
) -> WristCalibration:
    arm = chain.arms[0]
    rng = np.random.default_rng([seed, 3])
    sensor = robots.frame_id(chain.model, f"{arm.name}/{arm.wrist_sensor}")
    plant = RigidPlant(chain, [], STEP)
    sensed = SensedPlant(plant, hardware.sensors(scenario.sensors, chain), seed)
    away = rng.uniform(-SPREAD, SPREAD, (postures, chain.nq))
    limits = position_limits(chain.model)
    rotations = []
    readings = []
    for q in np.clip(start + away, *limits):
        encoders, wrenches = _averages(sensed, plant, q, average)
        rotations.append(_placement(chain, encoders, sensor).rotation)
        readings.append(wrenches)
    wrist = scenario.sensors.wrist
    sizes = LEAST_NOISE if wrist is None else (wrist.force.noise, wrist.torque.noise)
    noise = np.repeat(np.maximum(sizes, LEAST_NOISE), 3) / np.sqrt(average / STEP)
    load = calibrate_wrist(rotations, np.array(readings), noise)
    true = _outboard(chain, start, sensor)
    return WristCalibration(arm.name, load, true.mass, np.array(true.lever))


def _averages(
    sensed: SensedPlant, plant: RigidPlant, q: Array, average: float
) -> tuple[Array, Array]:
    """Mean joint positions (n,) and wrist reading (6,) at rest at q."""
    now = plant.time
    plant.reset(q)
    plant.time = now  # the sensors' clocks continue
    gravity = pin.computeGeneralizedGravity(plant.model, plant.data, plant.q)
    readings = []
    for k in range(round((SETTLE + average) / STEP)):
        sensed.command(gravity[plant.chain.actuated], STEP)
        if k * STEP >= SETTLE:
            read = sensed.measure()
            readings.append(np.concatenate((read.q, read.wrenches[0])))
    q_read, wrench = np.split(np.mean(readings, axis=0), [len(q)])
    return q_read, wrench


def _placement(chain: ClosedChain, q: Array, frame: int) -> pin.SE3:
    pin.forwardKinematics(chain.model, chain.data, q)
    return pin.updateFramePlacement(chain.model, chain.data, frame).copy()


def _outboard(chain: ClosedChain, q: Array, sensor: int) -> pin.Inertia:
    """What truly hangs on the sensor, in its axes: gripper and object."""
    X_SW = _placement(chain, q, sensor).inverse()
    tip = robots.frame_id(chain.model, f"{chain.arms[0].name}/{chain.arms[0].tip}")
    total = pin.Inertia.Zero()
    for link in outboard_links(chain.model, sensor, tip):
        total = total + (X_SW * chain.data.oMi[link.joint]).act(link.inertia)
    if chain.payload is not None:
        total = total + (X_SW * chain.object_poses()[0]).act(chain.payload.inertia)
    return total
