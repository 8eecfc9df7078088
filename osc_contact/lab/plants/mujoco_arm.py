"""One arm of a MuJoCo simulation that the caller, or an environment of others, steps."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from osc_contact.dynamics.arm import Arm
from osc_contact.dynamics.chain_state import RigidObject
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.errors import InvalidInputError, PlantError, missing
from osc_contact.interface import Measurement
from osc_contact.lab.plants.mujoco_io import (
    TorqueInputs,
    geoms_beyond,
    loose_joints,
    moving_geoms,
    require_name,
    sensor_rows,
)
from osc_contact.lab.plants.own_mujoco import MujocoScene, require_whole_steps
from osc_contact.robots.mjcf import joint_name
from osc_contact.spatial import Array, as_array

if TYPE_CHECKING:
    from mujoco import MjData, MjModel

_log = logging.getLogger(__name__)


class MujocoArm:
    """One arm of a MuJoCo simulation: its model, its readings and its torques.

    The simulation belongs to the caller: `measure` reads its data, `apply` writes torques into
    them, and the caller calls `mj_step`. If an environment hides this call, `driven` applies the
    torques from within each of its steps.

    Joints with exactly one plain motor are driven by it. Actuators of other joints (position
    servos) and the compensation of gravity are switched off in `model` for the links of the arm.

    Args:
        model, data: `mujoco.MjModel` and `mujoco.MjData` of the simulation. Gymnasium's
            environments keep them as attributes of the same names of the unwrapped environment.
        tip: body or site at the operational point.
        tip_offset: pose of the operational point in the frame of `tip`; None: `tip` itself.
        wrist_sensor: site or body at which the wrench on it and all links beyond it is read. The
            <force> and <torque> sensors of a site are used where it has both; otherwise the wrench
            is computed from MuJoCo's internal forces, at the cost of one `mj_forward` for each
            measurement. None: no sensor, and so no contacts.
        payload: object held by the tip, beyond the links of the model; None: nothing.
        name: name of the arm.
        locked: positions of other joints of its tree (m, rad), fingers for example; default: where
            they are now.

    Attributes:
        chain: model of the arm with its payload.
        model, data: as given.

    Raises:
        PlantError: MuJoCo is not installed, or no site or body is named as `tip` or `wrist_sensor`.
        ModelError: the arm has joints that the toolkit does not support.

    Example:
        >>> import mujoco
        >>> SCENE = '''<mujoco><worldbody><body>
        ...   <joint name="hinge" axis="0 1 0"/><geom size="0.05"/>
        ...   <body pos="0.5 0 0"><geom size="0.02"/><site name="tip"/></body>
        ... </body></worldbody><actuator><position joint="hinge" kp="9"/></actuator></mujoco>'''
        >>> model = mujoco.MjModel.from_xml_string(SCENE)
        >>> data = mujoco.MjData(model)
        >>> arm = osc.MujocoArm(model, data, tip="tip", wrist_sensor="tip")
        >>> arm.apply([1.0])
        >>> mujoco.mj_step(model, data)
        >>> print(arm.measure().wrenches.shape)
        (1, 6)
    """

    def __init__(
        self,
        model: MjModel,
        data: MjData,
        *,
        tip: str,
        tip_offset: pin.SE3 | None = None,
        wrist_sensor: str | None = None,
        payload: RigidObject | None = None,
        name: str = "arm",
        locked: Mapping[str, float] | None = None,
    ) -> None:
        """Read the model of the arm, find its joints, motors and sensor, and let it be held.

        The class describes the arguments. Joints of the file that the arm does not have are locked
        at their present positions, unless `locked` gives others.

        Raises:
            PlantError: MuJoCo is not installed, or no site or body is named as `tip` or
                `wrist_sensor`.
            ModelError: the arm has joints that are not supported.
        """
        try:
            import mujoco
        except ImportError as error:
            raise PlantError(missing(error)) from error
        self._mj: ModuleType = mujoco  #: module `mujoco`
        self.model = model
        self.data = data
        #: index of the body with the wrist sensor, of the tip without a sensor
        self._body, _ = self._find_frame("tip", tip)
        _stop_gravity_compensation(model, self._body)
        if wrist_sensor is not None:
            self._find_sensor(wrist_sensor)
        index_of = {joint_name(model, j): j for j in range(model.njnt)}
        read_arm = partial(
            Arm.from_mjcf,
            model,
            name=name,
            tip=tip,
            tip_offset=tip_offset,
            wrist_sensor=wrist_sensor,
        )
        arm = read_arm(locked=locked)
        if arm.locked:  # at their present positions, unless others are given
            present = {
                joint: float(data.qpos[model.jnt_qposadr[index_of[joint]]]) for joint in arm.locked
            }
            arm = read_arm(locked={**present, **(locked or {})})
        self.chain = ClosedChain([arm], payload=payload)
        joints = np.array([index_of[joint] for joint in list(arm.model.names)[1:]])
        self._q = model.jnt_qposadr[joints]  #: (n,) indices of the joints in qpos
        self._v = model.jnt_dofadr[joints]  #: (n,) indices of the joints in qvel
        #: actuators that exert the torques of the motors
        self._inputs = TorqueInputs(model, joints[self.chain.actuated])
        self.hold()

    def hold(self) -> None:
        """Apply the torques that carry the arm at rest, and compute the readings under them.

        Call it after each reset of the simulation: the checks before the first torques compare the
        reading of the wrist with the weight of an arm at rest.
        """
        chain = self.chain
        model = chain.model
        q = self.data.qpos[self._q]
        weight = pin.computeGeneralizedGravity(model, model.createData(), q)
        self.apply(weight[chain.actuated])
        self._mj.mj_forward(self.model, self.data)

    def _find_frame(self, argument: str, name: str) -> tuple[int, int | None]:
        """Find a body, or a site and its body, by name.

        Args:
            argument: argument of the constructor, for the message.
            name: name of a body or site.

        Returns:
            Index of the body; index of the site, or None if the name is that of a body.

        Raises:
            PlantError: there is neither such a body nor such a site.
        """
        model = self.model
        bodies = [model.body(b).name for b in range(model.nbody)]
        if name in bodies:
            return bodies.index(name), None
        sites = [model.site(s).name for s in range(model.nsite)]
        require_name(f"body or site for {argument}", name, [*bodies, *sites])
        site = sites.index(name)
        return int(model.site_bodyid[site]), site

    def _find_sensor(self, name: str) -> None:
        """Find the body of the wrist sensor, and its rows in the sensor data if it has any.

        Args:
            name: name of the site or body of the sensor.
        """
        self._body, site = self._find_frame("wrist_sensor", name)
        #: (6,) indices of the wrench in the sensor data; None: it is computed
        self._wrench_rows: Array | None = None
        self._site = site  #: index of the site of the sensor; None: it is a body
        if site is not None:
            try:
                self._wrench_rows = sensor_rows(self.model, name)
            except PlantError:
                _log.info("site %r has no force and torque sensor; its wrench is computed", name)
        if self._wrench_rows is None:
            self._scratch = self._mj.MjData(self.model)  #: state in which the wrench is computed

    def measure(self) -> Measurement:
        """Read encoders and wrist sensor; sensors of a site are those of the last step's start."""
        data = self.data
        wrench = np.zeros((1, 6))
        if self.chain.arms[0].wrist_sensor is not None:
            rows = self._wrench_rows
            wrench[0] = self._internal_wrench() if rows is None else data.sensordata[rows]
        return Measurement(data.qpos[self._q], data.qvel[self._v], wrench, None, self._tau.copy())

    def _internal_wrench(self) -> Array:
        """Wrench (6,) between the sensor's body and its parent, at the sensor and in its axes.

        It is computed from a copy of the present state: within a step the data of the simulation
        have new contacts, but the forces of the old ones. MuJoCo's `cfrc_int` is at the centre of
        mass of the tree, in world axes, torque first.
        """
        data = self._scratch
        self._mj.mj_copyData(data, self.model, self.data)
        self._mj.mj_forward(self.model, data)
        self._mj.mj_rnePostConstraint(self.model, data)
        if self._site is None:
            p = data.xpos[self._body]
            R = data.xmat[self._body].reshape(3, 3)
        else:
            p = data.site_xpos[self._site]
            R = data.site_xmat[self._site].reshape(3, 3)
        torque, force = data.cfrc_int[self._body].reshape(2, 3)
        lever = p - data.subtree_com[self.model.body_rootid[self._body]]
        return np.concatenate((R.T @ force, R.T @ (torque - np.cross(lever, force))))

    def apply(self, tau: ArrayLike) -> None:
        """Write motor torques (n_a,) (N m; N) into the simulation; they act in its next steps.

        Raises:
            InvalidInputError: torques of the wrong number, or not finite.
        """
        self.note(tau)
        self._inputs.send(self.data, self._tau)

    def note(self, tau: ArrayLike) -> None:
        """Remember motor torques (n_a,) that the caller applies, for the next measurement.

        Raises:
            InvalidInputError: torques of the wrong number, or not finite.
        """
        self._tau = as_array("tau", tau, (self.chain.n_a,))  #: (n_a,) torques that act (N m, N)

    @contextmanager
    def driven(self, law: Callable[[Measurement], Array], dt: float) -> Iterator[None]:
        """Apply the torques of a law from within the steps of the simulation.

        MuJoCo calls the law before it computes the actuation of a step, in any code that makes a
        step. It has one such hook for all simulations of a process: other simulations are not
        affected, and blocks cannot be nested. After an exception of the law the last torques are
        held; the exception is raised at the end of the block.

        Args:
            law: function that returns torques (n_a,) for a measurement, for example by
                `SteppedLoop.step`.
            dt: control period (s), a whole number of the simulation's steps, for which torques are
                held.

        Raises:
            InvalidInputError: another hook is installed.
            PlantError: the period is not a whole number of steps.
        """
        step = float(self.model.opt.timestep)
        require_whole_steps(dt, step)
        if self._mj.get_mjcb_control() is not None:
            raise InvalidInputError(
                "MuJoCo's control callback is in use; end the other block, or call "
                "mujoco.set_mjcb_control(None), before driven()"
            )
        next_tick = -np.inf
        failure: Exception | None = None

        def control(model: MjModel, data: MjData) -> None:
            """Apply the law once for each control period; MuJoCo calls this in each of its steps.

            Args:
                model, data: simulation that makes the step; other simulations are ignored.
            """
            nonlocal next_tick, failure
            if model is not self.model or data is not self.data or failure is not None:
                return
            if data.time < next_tick - dt:  # the simulation was reset
                next_tick = -np.inf
            if data.time > next_tick - 0.5 * step:
                next_tick = data.time + dt
                try:
                    self.apply(law(self.measure()))
                except Exception as error:  # MuJoCo would end the process in some of its calls
                    failure = error

        self._mj.set_mjcb_control(control)
        try:
            yield
        finally:
            self._mj.set_mjcb_control(None)
        if failure is not None:
            raise failure

    def scene(self) -> MujocoScene:
        """Distances from the geoms that the tool can touch in the present state, and masses."""
        model = self.model
        tool = geoms_beyond(model, self._body)
        tree = moving_geoms(model, self._body)
        other_geoms = np.setdiff1d(np.flatnonzero(~tree), tool)
        loose = loose_joints(model, self._body, self._v)
        return MujocoScene(
            model, self.data, tool.tolist(), other_geoms.tolist(), chain=self.chain, loose=loose
        )


def _stop_gravity_compensation(model: MjModel, body: int) -> None:
    """Switch MuJoCo's compensation of gravity off for all bodies of an arm's tree.

    Args:
        model: `mujoco.MjModel`, changed.
        body: index of a body of the arm.
    """
    tree = model.body_rootid == model.body_rootid[body]
    if np.any(model.body_gravcomp[tree] != 0.0):
        model.body_gravcomp[tree] = 0.0
        _log.info("MuJoCo's compensation of gravity is off: the controller carries the arm")
