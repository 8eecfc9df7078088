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

FAR_M = 10.0  #: m; distances are looked for up to here
_POINT_M = 1e-6  #: m, radius of the sphere that stands for a point
_SPHERE = 2  #: MuJoCo's number of the type


class MujocoScene:
    """A copy of a scene, as it is at one instant, in which one geom of the tool becomes a point.

    Attributes:
        moved_mass, carried_mass, loose: see `osc_contact.interface.Scene`.
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
        """Take the copy.

        Args:
            model, data: MuJoCo's. tool: its geoms. others: geoms that are not the arm's.
            chain: model of the arm, as it is in the scene. loose: kg beyond joints that nothing
                holds.
        """
        self.moved_mass = chain.moved_mass
        self.carried_mass = chain.outboard_mass
        self.loose = loose
        self._step = float(model.opt.timestep)
        self._model = model
        self._data = copy.copy(data)
        self.pairs = [(a, b) for a in tool for b in others if _can_touch(model, a, b)]
        self.tool_touches = bool(self.pairs)
        self._others = sorted({b for _, b in self.pairs})
        if self.pairs:
            self._point = point = self.pairs[0][0]
            self._probe = copy.copy(model)
            self._at = copy.copy(data)
            self._probe.geom_type[point] = _SPHERE
            self._probe.geom_size[point] = self._probe.geom_rbound[point] = _POINT_M

    def require_period(self, duration: float) -> None:
        """Refuse a control period (s) that is no whole number of MuJoCo's steps.

        Raises:
            PlantError: it is none.
        """
        require_whole_steps(duration, self._step)

    def distance(self, point: Array) -> tuple[float, str]:
        """Distance (m) of a point (3,) in the world from the nearest geom, and the geom's name.

        The distance is negative within the geom, and inf if no geom is within 10 m.
        """
        self._at.geom_xpos[self._point] = point
        return _nearest(self._probe, self._at, [(self._point, b) for b in self._others])

    def clearance(self) -> tuple[float, str]:
        """Distance (m) of the tool from the nearest geom, and the geom's name.

        The distance is negative if the tool penetrates the geom.
        """
        return _nearest(self._model, self._data, self.pairs)


def require_whole_steps(duration: float, step: float) -> None:
    """Refuse a control period (s) that is no whole number of MuJoCo's steps (s).

    Raises:
        PlantError: it is none.
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

    Returns:
        The distance (m; inf beyond `FAR_M`), and the name of the second geom of the nearest pair.
    """
    from mujoco import mj_geomDistance

    ends = np.zeros(6)
    least, geom = min((mj_geomDistance(model, data, *ab, FAR_M, ends), ab[1]) for ab in pairs)
    return (least if least < FAR_M else np.inf), model.geom(geom).name or f"geom {geom}"


def _can_touch(model: MjModel, a: int, b: int) -> bool:
    """Whether MuJoCo lets two geoms touch."""
    kinds = model.geom_contype
    others = model.geom_conaffinity
    return bool((kinds[a] & others[b]) | (kinds[b] & others[a]))


# --- The robot ------------------------------------------------------------------------------------

MUCH_FRICTION = 0.5  #: a coefficient that is reported
_log = logging.getLogger(__name__)


class MujocoRobot(MujocoPlant):
    """One arm of a MuJoCo scene, torque-controlled; what it touches is whatever stands in its way.

    Attributes:
        chain: model of the arm, nothing held: its tip is the operational point. contacts: pairs.
        model, data: MuJoCo's, the robot's own copies.

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
        """Take an arm out of a scene.

        Torques go to the joints' motors; where a joint has a position servo, several motors or
        none, they act on the joint itself and its actuators are off. Contacts get elliptic cones:
        these give normal forces.

        Args:
            mjmodel: `mujoco.MjModel`, `MjSpec` or the path of an MJCF file; it is not changed.
            tip: body or site at the operational point. The sensor's body and all beyond it are
                the tool; without a sensor the tip's body.
            wrist_sensor: site with a <force> and a <torque> sensor; contact forces need one.
            contacts: in world axes, where the tool touches what is not the arm. name: name of the
                arm.
            locked, passive_joints: see `Arm.from_urdf`.
            keyframe: where the rest of the scene starts; default: where the file puts it.

        Raises:
            InvalidInputError: contacts whose lengths are not in m.
            ModelError: no such tip or joint, or what `robots.load_mjcf` refuses.
            PlantError: no such keyframe or site, or no sensors on that site.
        """
        mj = copy.copy(compile_mjcf(mjmodel))
        import mujoco  # it is there: the model has been compiled

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
        robot._take(mj, ClosedChain([arm]), contacts)
        robot._keyframe = None if keyframe is None else mj.key(keyframe).id
        robot._place(np.array(robot._qpos[robot._q]))
        return robot

    def _take(self, mj: MjModel, chain: ClosedChain, contacts: Sequence[ContactPair]) -> None:
        for pair in contacts:
            require_object_fits(pair, stretched_length(chain.arms[0]))
        self._connect(mj, chain, contacts, Faces([Rail()], (0,) * len(contacts)))
        arm = chain.arms[0]
        number = {joint_name(mj, j): j for j in range(mj.njnt)}
        joints = np.array([number[name] for name in list(arm.model.names)[1:]])
        self._q = mj.jnt_qposadr[joints]
        self._v = mj.jnt_dofadr[joints]
        self._held = {mj.jnt_qposadr[number[j]]: at for j, at in arm.locked.items()}
        self._inputs = TorqueInputs(mj, joints[chain.actuated])
        if arm.tip in [mj.body(b).name for b in range(mj.nbody)]:
            self.object_body = mj.body(arm.tip).id
        else:
            site = mj.site(arm.tip)
            self.object_body = int(site.bodyid[0])
            self.place = pose(site.pos, site.quat)
        self._seen = [self.object_body] * 2
        self._sensed = []
        self._readings = np.zeros((0, 6), dtype=int)
        tool = self.object_body
        if arm.wrist_sensor is not None:
            self._sensed = [0]
            self._readings = sensor_rows(mj, arm.wrist_sensor)[None]
            tool = int(mj.site(arm.wrist_sensor).bodyid[0])
        # the tool, other links of the arm that move, and everything else, which is one body
        self.body_of = np.where(moving_geoms(mj, tool), OTHER, 0)
        self.body_of[geoms_beyond(mj, tool)] = OBJECT
        tree = mj.body_rootid[mj.geom_bodyid] == mj.body_rootid[tool]
        self._warn_of_friction(np.flatnonzero(~tree))

    def _warn_of_friction(self, others: Array) -> None:
        """Warn of friction that MuJoCo gives what has none named, and that few surfaces have."""
        mj = self.model
        most = 0.0
        for one in np.flatnonzero(self.body_of == OBJECT).tolist():
            for other in others.tolist():
                both = np.array([one, other])
                both = both[mj.geom_priority[both] == mj.geom_priority[both].max()]
                if _can_touch(mj, one, other) and mj.geom_condim[both].max() > 1:
                    most = max(most, float(mj.geom_friction[both, 0].max()))
        if most >= MUCH_FRICTION:
            _log.warning(
                "friction of tool and scene has a coefficient of %g (MuJoCo's default: 1): "
                "sliding contacts chatter, and forces are read wrongly; give "
                'friction= and priority= of the touched geom, or condim="1" for none',
                most,
            )

    def reset(self, q: ArrayLike) -> None:
        """Start at rest at joint positions q (n,), the rest of the scene where it starts.

        Motors carry the arm from the beginning, as far as their limits permit, so that the first
        reading of the wrist is that of an arm that rests.

        Raises:
            InvalidInputError: q is outside the limits of the joints.
        """
        q = as_array("q", q, (self.chain.nq,))
        require_in_range("reset", self.chain, q)
        self._place(q)

    def _place(self, q: Array) -> None:
        if self._keyframe is None:
            self._mj.mj_resetData(self.model, self.data)
        else:
            self._mj.mj_resetDataKeyframe(self.model, self.data, self._keyframe)
            self._qvel[:] = 0.0
        for at, held in self._held.items():
            self._qpos[at] = held
        self._qpos[self._q] = q
        self.time = 0.0
        model = self.chain.model
        self.hold(pin.computeGeneralizedGravity(model, model.createData(), q)[self.chain.actuated])

    def touching(self, q: ArrayLike) -> Array:
        """(n,) joint positions next to q at which every contact touches.

        Raises:
            InvalidInputError: q is outside the limits of the joints.
            ModelError: there are none near, or none within the limits.
        """
        q = as_array("q", q, (self.chain.nq,))
        require_in_range("touching", self.chain, q)
        found = close(self.chain, q, partial(self.faces.gaps, self.contacts))
        try:
            require_in_range("touching", self.chain, found)
        except InvalidInputError as error:
            raise ModelError(f"{error}. Begin nearer to the contacts, or move them") from error
        return found

    def command(self, tau: Array, duration: float) -> None:
        """Hold the torques for `duration` (s), a whole number of MuJoCo's steps.

        Raises:
            PlantError: it is none, or MuJoCo diverged.
        """
        require_whole_steps(duration, self._step)
        super().command(tau, duration)

    def picture(self) -> Json:
        """Visible shapes of the scene as data for JSON, for recordings (`robots.pictures`)."""
        model = self.chain.model
        mj = self.model
        number = {adr: j for j, adr in enumerate(mj.jnt_qposadr)}
        joints = {number[at]: k + 1 for k, at in enumerate(self._q)}
        return scene_picture(mj, self.data, model, np.array(self._qpos[self._q]), joints)

    def scene(self) -> MujocoScene:
        """Scene around the arm at present: distances from the geoms near the tool, and masses."""
        tool, others = (np.flatnonzero(self.body_of == which).tolist() for which in (OBJECT, 0))
        loose = loose_joints(self.model, self.object_body, self._v)
        return MujocoScene(self.model, self.data, tool, others, chain=self.chain, loose=loose)

    def _send(self, tau: Array) -> None:
        self._tau = as_array("tau", tau, (self.chain.n_a,))
        self._inputs.send(self.data, self._tau)

    def _joint_torques(self) -> Array:
        return self._tau.copy()
