"""Plants and controllers that advance together, as rows of two batches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from osc_contact.control.batch import BatchController
from osc_contact.control.controller import Controller
from osc_contact.errors import InvalidInputError, PlantError
from osc_contact.lab.checks.preflight import require_ready
from osc_contact.lab.plants.mujoco import MujocoPlant
from osc_contact.lab.rig.rig import Rig
from osc_contact.lab.runs.run import start
from osc_contact.spatial import Array


@dataclass(frozen=True)
class Start:
    """Start of a row: plant and controller of a rig, at rest in contact.

    Attributes:
        rig: the rig.
        plant: its plant, with the model.
        state: state of MuJoCo.
        controller: its controller, which rows copy.
    """

    rig: Rig
    plant: MujocoPlant
    state: Array
    controller: Controller

    @classmethod
    def of(cls, rig: Rig) -> Start:
        """Start of a rig, see `lab.runs.run.start`.

        Raises:
            ScenarioError: the rig cannot run.
            InvalidInputError: its ticks contain Python code, so that it cannot be part of a batch.
        """
        import mujoco

        require_ready(rig)
        plant, controller = start(rig)
        scenario = rig.scenario
        # MuJoCo advances the plants of a batch without calling Python, so nothing may need it
        obstacles = {
            "plant.type is not mujoco, or sensors have errors": type(plant) is not MujocoPlant,
            "faces move, motors have errors, or arms are pushed": (
                isinstance(plant, MujocoPlant) and not plant.steps_alone
            ),
            "a tare": scenario.tare is not None,
            "a joint torque loop": scenario.control.joint_torque is not None,
            "pairs, bodies or laws written in Python": controller.needs_python,
        }
        why = [obstacle for obstacle, present in obstacles.items() if present]
        if why:
            raise InvalidInputError(
                f"plants that advance together are plain ones, and {scenario.name} has: "
                f"{'; '.join(why)}. Change that with overrides, or run it by itself with osc.run"
            )
        assert isinstance(plant, MujocoPlant)
        # the whole state of the integrator, to which every episode returns
        kind = mujoco.mjtState.mjSTATE_INTEGRATION
        state = np.zeros(mujoco.mj_stateSize(plant.model, kind))
        mujoco.mj_getState(plant.model, plant.data, state, kind)
        return cls(rig, plant, state, controller)


class Fleet:
    """Plants of equal structure and their controllers; each row equals the single run of its rig.

    Attributes:
        rows: number B of plants.
        dt: control period (s).
        control: the controllers.
    """

    def __init__(self, starts: Sequence[Start], threads: int = 1) -> None:
        """Put every row at its start.

        Args:
            starts: start of each row; rows may share one.
            threads: number of threads of plants, and of controllers.

        Raises:
            InvalidInputError: rigs of different structures.
            PlantError: this version of MuJoCo has no batches.
        """
        try:
            from mujoco.batch import Batch
        except ImportError as error:
            raise PlantError(
                "plants advance together with mujoco.batch, of MuJoCo 4: pip install 'mujoco>=4'"
            ) from error
        first = starts[0]
        self.rows = len(starts)
        self.dt = first.controller.dt
        self._plant = first.plant  #: plant of the first row, whose structure all have
        #: steps of physics in a control period
        self._steps_per_tick = first.plant.steps_in(self.dt)
        self.control = BatchController([row_start.controller for row_start in starts], threads)
        self._models = [row_start.plant.model for row_start in starts]  #: model of each row
        self._plants: Any = Batch(first.plant.model, self.rows, nthread=threads)  #: MuJoCo's batch
        names = ("qpos", "qvel", "sensordata", "ctrl", "xpos", "xmat")
        #: arrays of all rows: positions, velocities, sensor data; motor torques; poses of bodies
        *self._sensed_arrays, self._ctrl, self._xpos, self._xmat = map(self._plants.bind, names)
        self.begin(dict(enumerate(starts)))

    def begin(self, starts: dict[int, Start]) -> None:
        """Put some rows at their starts: controller, model and state of the integrator.

        Args:
            starts: start of each row, by the number of the row.
        """
        rows = np.array(sorted(starts))
        for row, row_start in starts.items():
            self.control.replace(row, row_start.controller)
            self._plants.state[row] = row_start.state
            self._models[row] = row_start.plant.model
        self._plants.warning[rows] = 0
        self._plants.set_models(self._models)
        self._plants.forward(rows)

    def measure(self) -> tuple[Array, Array, Array]:
        """Readings of all rows, see `MujocoPlant.measure`: q, v (B, n), wrenches (B, arms, 6)."""
        return self._plant.readings(*self._sensed_arrays)

    def tick(
        self,
        X_WD: Array,
        V_D: Array,
        A_D: Array,
        alpha_d: Array,
        squeeze_d: Array | None = None,
        active: Array | None = None,
    ) -> Array:
        """Advance all rows by one control period; return their torques (B, n_a) (N m, N).

        Args:
            X_WD: (B, 4, 4) desired pose of the object in the world.
            V_D, A_D: (B, 6) its desired twist and classical acceleration at O, world axes.
            alpha_d: (B, r) desired contact forces (N).
            squeeze_d: (B,) or (B, bars) desired internal forces (N); None: see
                `BatchController.tick`.
            active: (B, contacts) active contacts; None: those with a force.
        """
        tau = self.control.tick(
            *self.measure(),
            X_WD,
            V_D=V_D,
            A_D=A_D,
            alpha_d=alpha_d,
            squeeze_d=squeeze_d,
            active=active,
        )
        self._ctrl[:] = tau
        self._plants.step(nstep=self._steps_per_tick)
        return tau

    def objects(self) -> tuple[Array, Array]:
        """Positions (B, 3) and rotations (B, 3, 3) of the objects, a plant step ago."""
        body = self._plant.object_body
        return (self._xpos[:, body], self._xmat[:, body].reshape(-1, 3, 3))

    def diverged(self) -> Array:
        """Flags (B,) of rows in which MuJoCo has warned since their start."""
        return np.any(np.reshape(self._plants.warning, (self.rows, -1)), axis=1)
