"""An action term for mjlab: policies command set points of the motion and contact forces.

mjlab simulates many environments on one device and has no operational-space action. Here the law
of all environments is one call of a `BatchController` for each control period; it runs on the
processor, so states and torques are copied from and to the device.

mjlab and torch come with mjlab; nothing else in the package imports this module.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from mjlab.actuator import XmlActuatorCfg
from mjlab.entity import EntityArticulationInfoCfg, EntityCfg
from mjlab.managers.action_manager import ActionTerm, ActionTermCfg

from osc_contact.control.batch import BatchController
from osc_contact.control.controller import Controller
from osc_contact.control.status import SafetyState
from osc_contact.errors import InvalidInputError
from osc_contact.lab.plants.mujoco import MujocoPlant
from osc_contact.lab.rig.rig import Rig
from osc_contact.lab.runs.run import start
from osc_contact.settings.control import require_below_ceilings
from osc_contact.spatial import Array, moved


class Environments(Protocol):
    """Part of mjlab's environment class that an action term reads.

    Attributes:
        physics_dt: period of the physics (s).
        step_dt: period of the actions (s).
    """

    physics_dt: float
    step_dt: float


def begin(rig: Rig) -> tuple[EntityCfg, Controller]:
    """Entity of mjlab with the arms, object and surroundings of a rig, and its controller.

    The entity starts at the rig's first posture, and its actuators are the motors of the XML file.

    Args:
        rig: rig of a scenario, whose plant and controller are started.

    Raises:
        InvalidInputError: the plant of the rig is not MuJoCo with ideal sensors.
    """
    plant, controller = start(rig)
    if not isinstance(plant, MujocoPlant):
        raise InvalidInputError("mjlab takes rigs with plant.type=mujoco and ideal sensors")
    spec = plant.spec
    assert spec is not None
    joints = (name.split("/")[-1] for name in rig.chain.joint_names)
    positions = dict(zip(joints, rig.q_start.tolist(), strict=True))
    entity = EntityCfg(
        init_state=EntityCfg.InitialStateCfg(joint_pos=positions),
        spec_fn=lambda: spec.copy(),
        articulation=EntityArticulationInfoCfg(
            actuators=(XmlActuatorCfg(target_names_expr=(".*",)),)
        ),
    )
    # force ceilings that the scenario leaves out follow from the actions, not from its own forces
    return (entity, controller.with_safety(rig.scenario.control.safety))


@dataclass(kw_only=True)
class ContactActionCfg(ActionTermCfg):  # type: ignore[misc]
    """Configuration of a `ContactAction`.

    Attributes:
        controller: controller that every environment copies. Its period is a multiple of the
            physics' step and divides the environment's; it may have been ticked at the start.
        most_force: largest force of a contact (N).
        move: largest increments of the set point, along and about each axis (m, rad).
        joints: names of the controller's joints in the entity; None: the part of their names after
            the last "/".
        wrists: names of the force and the torque sensor of each arm in the scene; None: those of
            `begin`.
        threads: number of threads that share a tick.
    """

    controller: Controller
    most_force: float
    move: tuple[float, float] = (2e-3, 1e-2)
    joints: tuple[str, ...] | None = None
    wrists: tuple[tuple[str, str], ...] | None = None
    threads: int = 1

    def build(self, env: Environments) -> ContactAction:
        """Make the action term of the environments."""
        return ContactAction(self, env)


class ContactAction(ActionTerm):  # type: ignore[misc]
    """Action term: (6 + r,) numbers from −1 to 1 for each environment.

    The first six are increments of the set point's position and orientation in units of `move`, in
    world axes at the object; the others are contact forces, from 0 (−1) to `most_force` (1). Both
    change at a constant rate during the action. After a reset the set point of an environment is
    the pose of its object.

    Attributes:
        batch: controllers of all environments.
    """

    cfg: ContactActionCfg

    def __init__(self, cfg: ContactActionCfg, env: Environments) -> None:
        """Make a controller for each environment.

        Args:
            cfg: configuration of the action.
            env: environments, whose steps of physics, control and actions must be multiples of one
                another.
        """
        super().__init__(cfg=cfg, env=env)
        chain = cfg.controller.chain
        joints = cfg.joints or tuple(name.split("/")[-1] for name in chain.joint_names)
        # the simulator's numbers of the joints, in the chain's order, and of those with a motor
        ids, _ = self._entity.find_joints(joints, preserve_order=True)
        #: (n,) the simulator's indices of the joints, in the chain's order
        self._joints = torch.tensor(ids, device=self.device)
        #: (n_a,) those of the joints with a motor
        self._motors = self._joints[torch.tensor(chain.actuated, device=self.device)]
        #: names of the force and torque sensor of each arm
        self._wrists = cfg.wrists or tuple(
            (f"{cfg.entity_name}/{arm.name}/force", f"{cfg.entity_name}/{arm.name}/torque")
            for arm in chain.arms
        )
        # steps of physics in a control period, and control periods in an action: whole numbers
        ticks_per_step = cfg.controller.dt / env.physics_dt
        of_action = env.step_dt / cfg.controller.dt
        self._steps_per_tick = round(ticks_per_step)  #: steps of physics in a control period
        self._ticks_per_action = round(of_action)  #: control periods in an action
        if (
            max(abs(ticks_per_step - self._steps_per_tick), abs(of_action - self._ticks_per_action))
            > 1e-6
            or not self._steps_per_tick
        ):
            raise InvalidInputError(
                f"physics every {env.physics_dt:g} s, control every {cfg.controller.dt:g} s, "
                f"actions every {env.step_dt:g} s: each must be a multiple of the one before"
            )
        self.batch = BatchController([cfg.controller] * self.num_envs, cfg.threads)
        self._n_forces = self.batch.alpha_meas.shape[1]  #: r, number of contact forces
        require_below_ceilings(cfg.controller.settings.safety, cfg.most_force, self._n_forces)
        # last actions, targets and forces of all environments; `_was_reset` marks those to be reset
        #: (B, 6 + r) last actions
        self._raw_actions = torch.zeros(self.num_envs, 6 + self._n_forces, device=self.device)
        #: (B, 4, 4) desired poses of the objects at the end of the action
        self._target = np.tile(np.eye(4), (self.num_envs, 1, 1))
        #: (B, r) desired contact forces at the end of the action (N)
        self._forces = np.zeros((self.num_envs, self._n_forces))
        #: (B,) whether an environment begins anew in the next step
        self._was_reset = np.ones(self.num_envs, dtype=bool)
        self._step = 0  #: number of steps of physics since the last action began
        #: ways of references through the action; None before the first one
        self._action_course: tuple[Array, Array, Array] | None = None

    @property
    def action_dim(self) -> int:
        """Length of an action, 6 + r."""
        return 6 + self._n_forces

    @property
    def raw_action(self) -> torch.Tensor:
        """Actions (B, 6 + r) as given."""
        return self._raw_actions

    @property
    def force(self) -> torch.Tensor:
        """Measured contact forces (B, r) (N)."""
        return self._to_tensor(self.batch.alpha_meas)

    @property
    def stopped(self) -> torch.Tensor:
        """Flags (B,) of controllers in SAFE_STOP, which are to end the episode."""
        return torch.as_tensor(self.batch.state == SafetyState.SAFE_STOP, device=self.device)

    def _to_tensor(self, x: Array) -> torch.Tensor:
        """Array as single-precision numbers on the device of the environments."""
        return torch.as_tensor(x, dtype=torch.float32, device=self.device)

    def process_actions(self, actions: torch.Tensor) -> None:
        """Plan set points and forces of all control periods of an action.

        An action (6 + r,) of an environment has increments of the set point (three of translation,
        three of rotation, each −1 … 1 times `move`, m or rad) and r contact forces (−1 … 1 for 0 …
        `most_force`, N). Both are interpolated linearly over the control periods of the action.

        Args:
            actions: (environments, 6 + r) actions of the policy.
        """
        self._raw_actions[:] = actions
        clipped = np.clip(actions.detach().cpu().numpy().astype(float), -1.0, 1.0)
        forces = 0.5 * (clipped[:, 6:] + 1.0) * self.cfg.most_force
        self._begin_where_reset(forces)
        increment = clipped[:, :6] * np.repeat(self.cfg.move, 3)
        share = np.arange(1, self._ticks_per_action + 1)[:, None, None] / self._ticks_per_action
        X = moved(self._target, share * increment)
        alpha = self._forces + share * (forces - self._forces)
        self._action_course = (X, increment / self._env.step_dt, alpha)
        self._target = X[-1]
        self._forces = forces
        self._step = 0

    def _begin_where_reset(self, forces: Array) -> None:
        """Set the set points of environments that were reset to the poses of their objects.

        Args:
            forces: (B, r) N, from which those environments begin.
        """
        if not self._was_reset.any():  # reading joints waits for the simulation
            return
        chain = self.cfg.controller.chain
        q = self._to_array(self._entity.data.joint_pos[:, self._joints])
        for i in np.flatnonzero(self._was_reset):
            self._target[i] = chain.state(q[i]).X_WO.homogeneous
            self._forces[i] = forces[i]

    @staticmethod
    def _to_array(x: torch.Tensor) -> Array:
        """Tensor of the device as an array of doubles."""
        return x.cpu().numpy().astype(float)

    def apply_actions(self) -> None:
        """Tick the controllers at each control period, and command their torques.

        It is called in each step of the physics; only every `_steps_per_tick`-th call begins a
        control period. Reads joints and wrists of all environments, and the set points and forces
        of `process_actions`.
        """
        assert self._action_course is not None
        tick, remainder = divmod(self._step, self._steps_per_tick)
        self._step += 1
        if remainder:
            return
        X, V, alpha = self._action_course
        data = self._entity.data
        sensors = self._env.scene
        wrenches = [torch.cat([sensors[name].data for name in pair], 1) for pair in self._wrists]
        tau = self.batch.tick(
            self._to_array(data.joint_pos[:, self._joints]),
            self._to_array(data.joint_vel[:, self._joints]),
            self._to_array(torch.stack(wrenches, 1)),
            X[tick],
            V_D=V,
            alpha_d=alpha[tick],
            wrench_valid=~self._was_reset,  # readings after a reset are of arms without torques
        )
        self._was_reset[:] = False
        self._entity.set_joint_effort_target(self._to_tensor(tau), joint_ids=self._motors)

    def reset(self, env_ids: torch.Tensor | slice | None = None) -> None:
        """Reset the controllers of some environments; None: of all.

        Args:
            env_ids: numbers of the environments that begin again; None: all.
        """
        rows = env_ids.cpu().numpy() if isinstance(env_ids, torch.Tensor) else env_ids
        mask = np.zeros(self.num_envs, dtype=bool)
        mask[slice(None) if rows is None else rows] = True
        self._was_reset |= mask
        if mask.any():
            self.batch.reset(mask)
        self._raw_actions[torch.as_tensor(mask, device=self.device)] = 0.0
