"""The user's MuJoCo scene as robot and judge: arm, tool and sensor are found by name."""

from __future__ import annotations

import copy
import logging
from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Self

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from osc_contact.contacts.pairs import ContactPair
from osc_contact.contacts.pairs.keys import require_object_fits
from osc_contact.dynamics.arm import Arm, stretched_length
from osc_contact.dynamics.assembly import close, require_in_range
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.dynamics.environment import Rail
from osc_contact.errors import InvalidInputError, ModelError, PlantError
from osc_contact.files import Json
from osc_contact.lab.plants.faces import Faces
from osc_contact.lab.plants.mujoco import MujocoPlant, quieten
from osc_contact.lab.plants.mujoco_io import (
    TorqueInputs,
    geoms_beyond,
    loose_joints,
    moving_geoms,
    require_name,
    sensor_rows,
)
from osc_contact.lab.plants.mujoco_truth import OBJECT, OTHER
from osc_contact.robots.mjcf import compile_mjcf, joint_name, pose
from osc_contact.robots.pictures import scene_picture
from osc_contact.spatial import Array, as_array

if TYPE_CHECKING:
    from mujoco import MjData, MjModel

# --- Distances of points and of the tool from what the tool can touch -----------------------------

FAR_M = 10.0  #: largest distance that is searched (m)
_POINT_M = 1e-6  #: radius of the sphere that represents a point (m)
_SPHERE = 2  #: MuJoCo's number of the type of spheres


class MujocoScene:
    """Distances and masses of a scene at one instant, see `osc_contact.interface.Scene`.

    In a copy of the scene one geom of the tool is replaced by a point, whose distances from other
    geoms MuJoCo computes.

    Attributes:
        moved_mass: mass of all moving links (kg).
        carried_mass: mass beyond the wrist sensor (kg).
        loose: mass (kg) beyond joints that nothing holds, by the name of the joint.
        pairs: geoms of the tool and of the scene that can touch.
        tool_touches: True if there are such geoms.
    """

    def __init__(
        self,
        model: MjModel,
        data: MjData,
        tool: Sequence[int],
        others: Sequence[int],
        *,
        chain: ClosedChain,
        loose: Mapping[str, float],
    ) -> None:
        """Copy the present state of a scene.

        Args:
            model, data: MuJoCo's model and state.
            tool: indices of the tool's geoms.
            others: indices of the geoms that are not the arm's.
            chain: model of the arm, as it is in the scene.
            loose: mass (kg) beyond joints that nothing holds, by the name of the joint.
        """
        self.moved_mass = chain.moved_mass
        self.carried_mass = chain.outboard_mass
        self.loose = loose
        self._step = float(model.opt.timestep)  #: time step (s)
        self._model = model  #: MuJoCo's model
        self._data = copy.copy(data)  #: copy of the state
        self.pairs = [(a, b) for a in tool for b in others if _can_touch(model, a, b)]
        self.tool_touches = bool(self.pairs)
        self._others = sorted({b for _, b in self.pairs})  #: geoms that the tool can touch
        # a copy of the model in which a geom of the tool is a small sphere, to measure distances
        if self.pairs:
            #: geom of the tool that is a small sphere in `_probe`
            self._point = point = self.pairs[0][0]
            self._probe = copy.copy(model)  #: model in which this geom measures distances
            self._probe_data = copy.copy(data)  #: state of `_probe`
            self._probe.geom_type[point] = _SPHERE
            self._probe.geom_size[point] = self._probe.geom_rbound[point] = _POINT_M

    def require_period(self, duration: float) -> None:
        """Refuse a control period (s) that is not a whole number of MuJoCo's steps.

        Raises:
            PlantError: the period is not such a number.
        """
        require_whole_steps(duration, self._step)

    def distance(self, point: Array) -> tuple[float, str]:
        """Distance (m) of a point (3,) in the world from the nearest geom, and the geom's name.

        The distance is negative within the geom, and inf if no geom is within 10 m.
        """
        self._probe_data.geom_xpos[self._point] = point
        pairs = [(self._point, other) for other in self._others]
        return _nearest(self._probe, self._probe_data, pairs)

    def clearance(self) -> tuple[float, str]:
        """Distance (m) of the tool from the nearest geom, and the geom's name.

        The distance is negative if the tool penetrates the geom.
        """
        return _nearest(self._model, self._data, self.pairs)


def require_whole_steps(duration: float, step: float) -> None:
    """Refuse a control period that is not a whole number of MuJoCo's steps.

    Args:
        duration: control period (s).
        step: step of MuJoCo (s).

    Raises:
        PlantError: the period is not such a number.
    """
    steps = duration / step
    if abs(steps - max(1, round(steps))) > 1e-6 * steps:
        raise PlantError(
            f"the control period {1e3 * duration:g} ms is no whole number of MuJoCo's steps of "
            f"{1e3 * step:g} ms; set opt.timestep to a part of it, such as {duration / 4:g} s, "
            "before from_model, or the controller's dt to a multiple"
        )


def _nearest(model: MjModel, data: MjData, pairs: list[tuple[int, int]]) -> tuple[float, str]:
    """Least distance between pairs of geoms in the present state.

    Args:
        model, data: MuJoCo's model and state.
        pairs: indices of two geoms each.

    Returns:
        The distance (m; inf beyond `FAR_M`), and the name of the second geom of the nearest pair.
    """
    from mujoco import mj_geomDistance

    ends = np.zeros(6)  # nearest points, which MuJoCo writes
    distances = [
        (mj_geomDistance(model, data, first, second, FAR_M, ends), second)
        for first, second in pairs
    ]
    distance, geom = min(distances)
    return (distance if distance < FAR_M else np.inf), model.geom(geom).name or f"geom {geom}"


def _can_touch(model: MjModel, a: int, b: int) -> bool:
    """Return whether MuJoCo detects contacts between two geoms, by their masks of bits.

    Args:
        model: MuJoCo's model.
        a, b: indices of the geoms.
    """
    types = model.geom_contype
    affinities = model.geom_conaffinity
    return bool((types[a] & affinities[b]) | (types[b] & affinities[a]))


# --- The robot ------------------------------------------------------------------------------------

MUCH_FRICTION = 0.5  #: coefficient of friction from which on a warning is logged
_log = logging.getLogger(__name__)


class MujocoRobot(MujocoPlant):
    """Arm of a MuJoCo scene, controlled by torques; its tool touches the other geoms of the scene.

    Attributes:
        chain: model of the arm without an object; its tip is the operational point.
        contacts: contact pairs.
        model, data: copies of MuJoCo's model and state.

    Example:
        >>> import mujoco
        >>> SCENE = '''<mujoco><worldbody><body>
        ...   <joint name="hinge" axis="0 1 0"/><geom size="0.05"/>
        ...   <body pos="0.5 0 0"><geom size="0.02"/><site name="tip"/></body>
        ... </body></worldbody><actuator><motor joint="hinge"/></actuator></mujoco>'''
        >>> robot = osc.MujocoRobot.from_model(mujoco.MjModel.from_xml_string(SCENE), tip="tip")
        >>> robot.reset([0.3])
        >>> print(robot.measure().q)
        [0.3]
    """

    #: index of the keyframe at which the scene begins; None: the initial state of the file
    _keyframe: int | None

    @classmethod
    def from_model(
        cls,
        mjmodel: MjModel,
        *,
        tip: str,
        wrist_sensor: str | None = None,
        contacts: Sequence[ContactPair] = (),
        name: str = "arm",
        locked: Mapping[str, float] | None = None,
        passive_joints: Sequence[str] = (),
        keyframe: str | None = None,
    ) -> Self:
        """Make a robot of an arm in a scene.

        Torques are applied by the joints' motors. For a joint with a position servo, several motors
        or none, they are applied to the joint itself, and its actuators are switched off. Friction
        cones are set to elliptic ones, in which normal forces can be read.

        Args:
            mjmodel: `mujoco.MjModel`, `MjSpec` or the path of an MJCF file; it is not changed.
            tip: body or site at the operational point. The sensor's body and all bodies beyond it
                are the tool; without a sensor the tip's body.
            wrist_sensor: site with a <force> and a <torque> sensor; contact forces need one.
            contacts: contact pairs between tool and scene, in world axes.
            name: name of the arm.
            locked: positions of locked joints.
            passive_joints: joints without a motor.
            keyframe: keyframe of the initial state of the scene; None: initial state of the file.

        Raises:
            InvalidInputError: lengths of a contact are not in m.
            ModelError: there is no such tip or joint, or `robots.load_mjcf` refuses the model.
            PlantError: there is no such keyframe or site, or the site has no sensors.
        """
        mj = copy.copy(compile_mjcf(mjmodel))
        import mujoco  # installed, because the model has been compiled

        if wrist_sensor is not None:
            require_name("site", wrist_sensor, [mj.site(i).name for i in range(mj.nsite)])
        if keyframe is not None:
            require_name("keyframe", keyframe, [mj.key(i).name for i in range(mj.nkey)])
        quieten(mujoco)
        mj.opt.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        arm = Arm.from_mjcf(
            mj,
            name=name,
            tip=tip,
            wrist_sensor=wrist_sensor,
            locked=locked,
            passive_joints=passive_joints,
        )
        robot = cls.__new__(cls)
        robot._set_up(mj, ClosedChain([arm]), contacts)
        robot._keyframe = None if keyframe is None else mj.key(keyframe).id
        robot._place(np.array(robot._qpos[robot._q]))
        return robot

    def _set_up(self, mj: MjModel, chain: ClosedChain, contacts: Sequence[ContactPair]) -> None:
        """Find joints, motors, sensor and geoms of the arm in a compiled model.

        Args:
            mj: model of the scene; actuators other than plain motors are switched off in it.
            chain: model of the arm.
            contacts: contact pairs.

        Raises:
            InvalidInputError: lengths of a contact are not in m.
            PlantError: the site of the sensor has no sensors.
        """
        for pair in contacts:
            require_object_fits(pair, stretched_length(chain.arms[0]))
        self._connect(mj, chain, contacts, Faces([Rail()], (0,) * len(contacts)))
        arm = chain.arms[0]
        index_of = {joint_name(mj, j): j for j in range(mj.njnt)}
        joints = np.array([index_of[name] for name in list(arm.model.names)[1:]])
        self._q = mj.jnt_qposadr[joints]  #: (n,) indices of the joints in qpos
        self._v = mj.jnt_dofadr[joints]  #: (n,) indices of the joints in qvel
        #: positions of locked joints by their index in qpos (rad, m)
        self._locked = {
            mj.jnt_qposadr[index_of[joint]]: position for joint, position in arm.locked.items()
        }
        #: actuators that exert the torques of the motors
        self._inputs = TorqueInputs(mj, joints[chain.actuated])
        if arm.tip in [mj.body(b).name for b in range(mj.nbody)]:
            self.object_body = mj.body(arm.tip).id
        else:
            site = mj.site(arm.tip)
            self.object_body = int(site.bodyid[0])
            self.place = pose(site.pos, site.quat)
        #: bodies whose poses are the truth: object, then tip, which are one
        self._posed_bodies = [self.object_body] * 2
        self._sensed_arms = []  #: [0] with a wrist sensor, else empty
        #: (1, 6) indices of the wrench in the sensor data, (0, 6) without a sensor
        self._wrench_indices = np.zeros((0, 6), dtype=int)
        tool = self.object_body
        if arm.wrist_sensor is not None:
            self._sensed_arms = [0]
            self._wrench_indices = sensor_rows(mj, arm.wrist_sensor)[None]
            tool = int(mj.site(arm.wrist_sensor).bodyid[0])
        # the tool, other moving links of the arm, and all other geoms as one body
        self.body_of = np.where(moving_geoms(mj, tool), OTHER, 0)
        self.body_of[geoms_beyond(mj, tool)] = OBJECT
        tree = mj.body_rootid[mj.geom_bodyid] == mj.body_rootid[tool]
        self._warn_of_friction(np.flatnonzero(~tree))

    def _warn_of_friction(self, other_geoms: Array) -> None:
        """Log a warning about large friction between tool and scene, such as MuJoCo's default.

        Args:
            other_geoms: indices of the geoms that are not the arm's.
        """
        mj = self.model
        largest = 0.0
        for tool_geom in np.flatnonzero(self.body_of == OBJECT).tolist():
            for other in other_geoms.tolist():
                geoms = np.array([tool_geom, other])
                # MuJoCo takes the properties of the geom with the higher priority
                geoms = geoms[mj.geom_priority[geoms] == mj.geom_priority[geoms].max()]
                if _can_touch(mj, tool_geom, other) and mj.geom_condim[geoms].max() > 1:
                    largest = max(largest, float(mj.geom_friction[geoms, 0].max()))
        if largest >= MUCH_FRICTION:
            _log.warning(
                "friction of tool and scene has a coefficient of %g (MuJoCo's default: 1): "
                "sliding contacts chatter, and forces are read wrongly; give "
                'friction= and priority= of the touched geom, or condim="1" for none',
                largest,
            )

    def reset(self, q: ArrayLike) -> None:
        """Start at rest at joint positions q (n,), with the scene in its initial state.

        Motors carry the arm from the beginning, as far as their limits permit, so that the first
        reading of the wrist is that of an arm at rest.

        Raises:
            InvalidInputError: q is outside the limits of the joints.
        """
        q = as_array("q", q, (self.chain.nq,))
        require_in_range("reset", self.chain, q)
        self._place(q)

    def _place(self, q: Array) -> None:
        """Set the scene to its initial state or keyframe, and the arm to a posture.

        The motors hold the arm against gravity; locked joints are at their positions.

        Args:
            q: (n,) joint positions (rad, m).
        """
        if self._keyframe is None:
            self._mj.mj_resetData(self.model, self.data)
        else:
            self._mj.mj_resetDataKeyframe(self.model, self.data, self._keyframe)
            self._qvel[:] = 0.0
        for index, position in self._locked.items():
            self._qpos[index] = position
        self._qpos[self._q] = q
        self.time = 0.0
        model = self.chain.model
        self.hold(pin.computeGeneralizedGravity(model, model.createData(), q)[self.chain.actuated])

    def touching(self, q: ArrayLike) -> Array:
        """Joint positions (n,) next to q at which all contacts touch.

        Args:
            q: (n,) joint positions from which the search starts (m, rad).

        Raises:
            InvalidInputError: q is outside the limits of the joints.
            ModelError: there are no such positions near q, or only outside the limits.
        """
        q = as_array("q", q, (self.chain.nq,))
        require_in_range("touching", self.chain, q)
        q_contact = close(self.chain, q, partial(self.faces.gaps, self.contacts))
        try:
            require_in_range("touching", self.chain, q_contact)
        except InvalidInputError as error:
            raise ModelError(f"{error}. Begin nearer to the contacts, or move them") from error
        return q_contact

    def command(self, tau: Array, duration: float) -> None:
        """Hold torques for a control period.

        Args:
            tau: (n_a,) motor torques (N m, N).
            duration: period (s), a whole number of MuJoCo's steps.

        Raises:
            PlantError: the period is not such a number, or MuJoCo diverged.
        """
        require_whole_steps(duration, self._step)
        super().command(tau, duration)

    def picture(self) -> Json:
        """Visible shapes of the scene as data for JSON, for recordings (`robots.pictures`)."""
        model = self.chain.model
        mj = self.model
        joint_at = {address: j for j, address in enumerate(mj.jnt_qposadr)}
        # by MuJoCo's index the index in Pinocchio, whose joint 0 is the universe
        joints = {joint_at[address]: k + 1 for k, address in enumerate(self._q)}
        return scene_picture(mj, self.data, model, np.array(self._qpos[self._q]), joints)

    def scene(self) -> MujocoScene:
        """Scene around the arm at present: distances from the geoms near the tool, and masses."""
        tool = np.flatnonzero(self.body_of == OBJECT).tolist()
        other_geoms = np.flatnonzero(self.body_of == 0).tolist()
        loose = loose_joints(self.model, self.object_body, self._v)
        return MujocoScene(self.model, self.data, tool, other_geoms, chain=self.chain, loose=loose)

    def _send(self, tau: Array) -> None:
        """Write motor torques tau (n_a,) into MuJoCo's data (N m, N)."""
        self._tau = as_array("tau", tau, (self.chain.n_a,))  #: (n_a,) torques that act (N m, N)
        self._inputs.send(self.data, self._tau)

    def _joint_torques(self) -> Array:
        """Readings (n_a,) of the joint torque sensors: the torques commanded last (N m, N)."""
        return self._tau.copy()
