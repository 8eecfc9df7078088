"""Composite controller for robosuite: contact forces and motion of each arm, decoupled.

Importing the module registers the controller under the name "OSC_CONTACT". robosuite is not a
dependency of the package; nothing else imports this module.

`OscContact._config` are the settings made by `osc_contact_config`. robosuite's attributes used
here: `sim`, the simulation; `arms`, names of the arms; `part_controllers` and `grippers` by name;
`_action_split_indexes`, first index and end of each part in an action.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
from robosuite.controllers import load_composite_controller_config
from robosuite.controllers.composite.composite_controller import (
    CompositeController,
    register_composite_controller,
)

from osc_contact.contacts.feet import force_owners
from osc_contact.contacts.pairs import ContactPair
from osc_contact.control.controller import Controller
from osc_contact.control.goals import GoalFollower
from osc_contact.errors import InvalidInputError
from osc_contact.lab.plants.mujoco_arm import MujocoArm
from osc_contact.loop.recorder import Recorder
from osc_contact.loop.stepped import SteppedLoop
from osc_contact.recorder import Recording
from osc_contact.settings.control import PhaseSettings
from osc_contact.spatial import Array

_log = logging.getLogger(__name__)

MOVE = (0.05, 0.5)  #: largest displacement of one action, along and about each axis (m, rad)
MOST_FORCE = 50.0  #: largest force of a contact that an action commands (N)

#: Pairs of an arm, or a function that makes them from robosuite's simulation after each reset.
Contacts = Sequence[ContactPair] | Callable[[Any], Sequence[ContactPair]]


def osc_contact_config(
    robot: str,
    contacts: Mapping[str, Contacts] | Contacts,
    *,
    action: str = "pose",
    most_force: float = MOST_FORCE,
    move: tuple[float, float] = MOVE,
    check: bool = True,
    record: bool = False,
    **options: Any,
) -> dict[str, Any]:
    """Configuration of the controller for `robosuite.make(controller_configs=…)`.

    Args:
        robot: robosuite's name of the robot, for example "Panda".
        contacts: pairs of each arm by its name ("right", "left"), or of the right arm. The vertex
            of a pair is given in the frame of the gripper's grip site, its face in the world.
        action: "pose": position (m), rotation vector (rad) of the grip site in the world and the
            force of each contact (N); "displacement": numbers from −1 to 1 in units of `move`, and
            for each contact from −1 (no force) to 1 (`most_force`).
        most_force: largest force of a contact (N).
        move: largest displacement of one action, along and about each axis (m, rad).
        check: whether each episode begins with the checks of `SteppedLoop`.
        record: whether every period is recorded, see `OscContact.recording`.
        options: further arguments of `Controller`, for example `gains` or `friction`.

    Raises:
        InvalidInputError: `action` is neither "pose" nor "displacement".
    """
    if action not in ("pose", "displacement"):
        raise InvalidInputError(f'action is {action!r}; give "pose" or "displacement"')
    config: dict[str, Any] = load_composite_controller_config(robot=robot)
    config["type"] = OscContact.name
    config["composite_controller_specific_configs"] = {
        "contacts": dict(contacts) if isinstance(contacts, Mapping) else {"right": contacts},
        "action": action,
        "most_force": most_force,
        "move": move,
        "check": check,
        "record": record,
        "options": options,
    }
    return config


class _ArmLoop:
    """Control loop of one arm: its model, its goals and its torques.

    Attributes:
        loop: the stepped loop.
        goals: references of the loop.
        recorder: records of every period; None: not recorded.
    """

    def __init__(
        self, arm: MujocoArm, contacts: Sequence[ContactPair], config: Mapping[str, Any]
    ) -> None:
        """Make the controller of an arm and its loop, which has not begun.

        Args:
            arm: arm of the simulation.
            contacts: contact pairs of the arm.
            config: settings of the controller.
        """
        self.arm = arm
        self.names = [pair.name for pair in contacts]
        dt = float(arm.model.opt.timestep)
        q = arm.measure().q
        usual = {"life": PhaseSettings(), "in_contact": False, "posture": q}
        options = {**usual, **config["options"]}
        controller = Controller(arm.chain, contacts, dt=dt, **options)
        self.goal: pin.SE3 = arm.chain.state(q).X_WO
        self.goals = GoalFollower(contacts, self.goal, dt)
        self.recorder = Recorder(controller) if config["record"] else None
        self.loop = SteppedLoop(
            controller,
            stop=_report_stop,
            recorder=self.recorder,
            check=config["check"],
        )

    def aim(self, action: Array, config: Mapping[str, Any]) -> None:
        """Set the goals of pose and contact forces from the part of an action for this arm.

        Args:
            action: (6 + contacts,): displacement of the last goal in units of `move`, or pose of
                the goal as position (m) and rotation vector (rad), in the world; then the forces,
                −1 … 1 up to `most_force`, or in N.
            config: options of the controller.
        """
        displacement, rotation, forces = np.split(np.asarray(action, dtype=float), [3, 6])
        if config["action"] == "displacement":
            move_limit, turn_limit = config["move"]
            X = self.goal
            self.goal = pin.SE3(
                pin.exp3(turn_limit * rotation) @ X.rotation,
                X.translation + move_limit * displacement,
            )
            forces = config["most_force"] * (forces + 1.0) / 2.0
        else:
            self.goal = pin.SE3(pin.exp3(rotation), displacement)
        self.goals.aim(self.goal, dict(zip(self.names, forces.tolist(), strict=True)))

    def torques(self) -> Array:
        """Compute the torques (n_a,) of one physics step (N m)."""
        tau = self.loop.step(self.arm.measure(), self.goals.step())
        self.arm.note(tau)
        return tau


def _blind_sensors() -> bool:
    """Return whether force sensors are wrong after mj_step1 and mj_step2.

    They are in MuJoCo 3.5, and robosuite's light physics steps so: forces are computed then.
    """
    major, minor = mujoco.mj_versionString().split(".")[:2]
    return (int(major), int(minor)) < (3, 7)


def _report_stop(reason: str) -> None:
    """Log a stop with its reason; the torques brake the arm."""
    _log.warning("the arm stops: %s", reason)


@register_composite_controller
class OscContact(CompositeController):  # type: ignore[misc]
    """Contact forces and motion of each arm with contacts; all other parts as in "BASIC".

    Make its configuration with `osc_contact_config`. The part of an action that belongs to an arm
    has 6 + contacts numbers. The law runs once for each physics step.

    Attributes:
        loops: control loop of each arm, by its name; made at the first action of an episode.
    """

    name = "OSC_CONTACT"

    def __init__(self, sim: Any, robot_model: Any, grippers: dict[str, Any]) -> None:
        super().__init__(sim, robot_model, grippers)
        self.loops: dict[str, _ArmLoop] = {}

    def _validate_composite_controller_specific_config(self) -> None:
        """Refuse contacts of arms that the robot does not have.

        Raises:
            InvalidInputError: the message names the arms.
        """
        unknown = set(self._config["contacts"]) - set(self.arms)
        if unknown:
            raise InvalidInputError(f"the robot has no arm {unknown}; its arms: {self.arms}")

    @property
    def _config(self) -> dict[str, Any]:
        """Settings made by `osc_contact_config`.

        Raises:
            InvalidInputError: the configuration was not made by it.
        """
        config: dict[str, Any] = self.composite_controller_specific_config
        if "contacts" not in config:
            raise InvalidInputError(
                'the controller "OSC_CONTACT" has no contacts; make its configuration with '
                'osc_contact_config("Panda", contacts=[…])'
            )
        return config

    def _action_size(self, arm: str) -> int:
        """Count the numbers of an action that belong to an arm."""
        return 6 + len(self._contacts(arm))

    def _contacts(self, arm: str) -> Sequence[ContactPair]:
        """Make the pairs of an arm."""
        contacts = self._config["contacts"][arm]
        return tuple(contacts(self.sim) if callable(contacts) else contacts)

    def setup_action_split_idx(self) -> None:
        """Divide actions among the parts of the robot: first index and end of each part.

        The parts keep their order (`_action_split_indexes`, filled by robosuite); those of arms
        with contacts get 6 + contacts numbers, so that all following parts move.
        """
        super().setup_action_split_idx()
        first = 0
        for part, (start, end) in self._action_split_indexes.items():
            size = self._action_size(part) if part in self._config["contacts"] else end - start
            self._action_split_indexes[part] = (first, first + size)
            first += size

    @property
    def action_limits(self) -> tuple[Array, Array]:
        """Smallest and largest actions, one number for each entry of the action of the whole robot.

        An arm with contacts has six entries of motion, −1 … 1 or, for poses, without limits, then
        its contact forces, −1 … 1 or 0 … `most_force` (N). Other arms have the limits of their own
        controllers.
        """
        config = self._config
        low, high = [], []
        for part, (start, end) in self._action_split_indexes.items():
            if part in config["contacts"] and config["action"] == "pose":
                forces = end - start - 6
                low += [-np.inf] * 6 + [0.0] * forces
                high += [np.inf] * 6 + [config["most_force"]] * forces
            elif part in config["contacts"] or part not in self.arms:
                low += [-1.0] * (end - start)
                high += [1.0] * (end - start)
            else:
                part_low, part_high = self.part_controllers[part].control_limits
                low += list(part_low)
                high += list(part_high)
        return np.array(low), np.array(high)

    def reset(self) -> None:
        """Begin an episode: the arms' controllers are made anew at the next action."""
        super().reset()
        for loop in self.loops.values():
            loop.loop.end("the environment was reset")
        self.loops = {}

    def set_goal(self, all_action: Array) -> None:
        """Set the goals of all parts from one action of the environment.

        Args:
            all_action: action of the whole robot.
        """
        self._make_loops()
        for part, controller in self.part_controllers.items():
            action = all_action[slice(*self._action_split_indexes[part])]
            if part in self.loops:
                self.loops[part].aim(action, self._config)
                controller.update()  # robosuite's observations of the end effector
            elif part in self.grippers:
                controller.set_goal(self.grippers[part].format_action(action))
            else:
                controller.set_goal(action)

    def run_controller(self, enabled_parts: Mapping[str, bool]) -> dict[str, Array]:
        """Compute torques of all enabled parts for one physics step (N m).

        Args:
            enabled_parts: True by the name of each part that is controlled.
        """
        self._make_loops()
        self.update_state()
        return {
            part: self.loops[part].torques() if part in self.loops else other.run_controller()
            for part, other in self.part_controllers.items()
            if enabled_parts.get(part, False)
        }

    def pose(self, arm: str) -> Array:
        """Return position (m) and rotation vector (rad) of an arm's grip site.

        Raises:
            InvalidInputError: the arm has no contacts.
        """
        self._make_loops()
        if arm not in self.loops:
            raise InvalidInputError(
                f"{arm!r} has no contacts; arms with contacts: {set(self.loops)}"
            )
        model = self.loops[arm].arm
        X = model.chain.state(model.measure().q).X_WO
        return np.concatenate((X.translation, pin.log3(X.rotation)))

    def forces(self, arm: str) -> dict[str, float]:
        """Return the measured force of each contact of an arm (N), by the name of the contact.

        It is NaN where the last period computed none, see the `reason` of the controller.

        Raises:
            InvalidInputError: the arm has no contacts, or has not moved yet.
        """
        if arm not in self.loops:
            raise InvalidInputError(f"{arm!r} has not moved, or has no contacts")
        controller = self.loops[arm].loop.controller
        owners = force_owners(controller.settings.contacts)
        alpha = controller.signals.alpha_meas
        if alpha.shape != owners.shape:
            alpha = np.full(owners.shape, np.nan)
        return {
            pair.name: float(alpha[owners == k].sum())
            for k, pair in enumerate(controller.settings.contacts)
        }

    def recording(self, arm: str) -> Recording:
        """Return the recording of the present episode of an arm, see `osc_contact_config`.

        Raises:
            InvalidInputError: nothing was recorded.
        """
        recorder = self.loops[arm].recorder if arm in self.loops else None
        if recorder is None:
            raise InvalidInputError(
                f"nothing of {arm!r} was recorded; give osc_contact_config(record=True), and act"
            )
        return recorder.recording()

    def _require_standing_base(self, arm: str, model: MujocoArm) -> None:
        """Refuse an arm on a base or a torso that moves.

        Args:
            arm: name of the arm's part in robosuite.
            model: arm read from the MuJoCo model, with all joints between the world and its tip.

        Raises:
            InvalidInputError: the message names the joints between the world and the arm.
        """
        arm_joints = [
            self.sim.model.joint_id2name(j) for j in self.part_controllers[arm].joint_index
        ]
        joint_names = list(model.chain.arms[0].model.names)[1:]
        foreign = [name for name in joint_names if name not in arm_joints]
        if foreign:
            raise InvalidInputError(
                f"between the world and arm {arm!r} there are {len(foreign)} more joints "
                f"({', '.join(foreign)}); its base has to stand: take a robot with a fixed base, "
                'for example "Panda"'
            )

    def _make_loops(self) -> None:
        """Make the loops of all arms with contacts, at the present state of the simulation.

        The tip of an arm is the grip site of its gripper; its wrist sensor is robosuite's force and
        torque sensor there, or, where MuJoCo's readings are wrong, the body that carries it.
        Nothing is done if the loops exist.
        """
        for arm in self._config["contacts"] if not self.loops else ():
            gripper = self.grippers[f"{arm}_gripper"]
            sensor = f"{gripper.naming_prefix}ft_frame"
            if _blind_sensors():
                _log.warning(
                    "force sensors of MuJoCo %s are wrong in robosuite's default stepping "
                    "(lite_physics=True): the wrench of arm %r is computed, which is slower; "
                    "install mujoco>=3.7",
                    mujoco.mj_versionString(),
                    arm,
                )
                site = self.sim.model.site_name2id(sensor)
                sensor = self.sim.model.body_id2name(self.sim.model.site_bodyid[site])
            model = MujocoArm(
                self.sim.model._model,
                self.sim.data._data,
                tip=gripper.important_sites["grip_site"],
                wrist_sensor=sensor,
                name=arm,
            )
            self._require_standing_base(arm, model)
            self.loops[arm] = _ArmLoop(model, self._contacts(arm), self._config)
