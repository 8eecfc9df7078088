"""A drag on the arm inboard of its wrist sensor (a cable) is not joint friction."""

import mujoco
import numpy as np
from samples import parametrize
from scenario_runs import rig_of

import osc_contact as osc
from osc_contact.lab.runs.run import start

DRAG = 20.0  #: N
REGULAR = 0.02  #: m/s; slower motions are opposed by less
MOST = 30.0  #: N, of a task of 11 N, which allows three times its command


class Dragged:
    """A plant at whose first arm something drags, at the link behind its middle joint.

    The force is against the motion of that link at each moment (`always`), or as it was at first.
    """

    def __init__(self, plant, rig, begin, end, always):
        self.plant, self.begin, self.end, self.always = plant, begin, end, always
        names = rig.chain.joint_names
        own = [name for name in names if name.startswith(f"{rig.chain.arms[0].name}/")]
        self.body = int(plant.model.joint(own[(len(own) - 1) // 2]).bodyid[0])
        self.joints = [plant.model.joint(name).dofadr[0] for name in names]
        self.time, self.first = 0.0, None

    def measure(self):
        return self.plant.measure()

    def command(self, tau, duration):
        model, data = self.plant.model, self.plant.data
        torques = np.zeros(model.nv)
        if self.begin <= self.time < self.end:
            velocity = np.zeros(6)
            kind = mujoco.mjtObj.mjOBJ_BODY
            mujoco.mj_objectVelocity(model, data, kind, self.body, velocity, 0)
            along = velocity[3:] / max(np.linalg.norm(velocity[3:]), REGULAR)
            self.first = along if self.first is None or self.always else self.first
            place = data.xipos[self.body].copy()
            pull = -DRAG * self.first
            mujoco.mj_applyFT(model, data, pull, np.zeros(3), place, self.body, torques)
        data.qfrc_applied[self.joints] = torques[self.joints]
        self.time += duration
        self.plant.command(tau, duration)

    def stop(self, reason=""):
        pass


@parametrize("begin, always", [(1.3, True), (1.6, True), (1.3, False)])
def test_a_cable_that_drags_inboard_of_the_wrist_does_not_raise_the_force(begin, always):
    end = begin + 2.5
    rig = rig_of("ur5_wipe")
    plant, controller = start(rig)
    robot = Dragged(plant, rig, begin, end, always)
    rows = []
    for k, reference in enumerate(rig.references.each(round(1e3 * (end + 2.0)), controller.dt)):
        tau = controller.tick(robot.measure(), reference)
        if k % 2 == 0:
            rows.append((k * controller.dt, *plant.truth().alpha, *reference.alpha_d))
        robot.command(tau, controller.dt)
    assert controller.state is not osc.SafetyState.SAFE_STOP, controller.reason
    rows = np.array(rows)
    times, true, desired = rows[:, 0], rows[:, 1:4], rows[:, 4:]
    assert np.abs(true[times >= begin]).max() <= MOST
    later = times > end + 1.0
    assert (np.abs(true - desired) / desired)[later].max() <= 0.05
