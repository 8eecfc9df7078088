"""A simulated FR3 for the tests: franky-sim's server of libfranka's protocol, with what it lacks.

The external wrench is that of the true contact, with noise. Lost commands are counted: after 20 of
them the motion ends by a reflex, as on the robot. In step with the client (`clock` false) the
simulation waits for each command, so that no busy machine changes a figure.

`python tests/franka_server.py` prints the address, then reads one JSON object a line: {"scene":
{...}} begins anew, {"faults": {...}} sets what the wire does, {"truth": FILE} writes what was true.
"""

import json
import os
import select
import struct
import sys
import time
import xml.etree.ElementTree as ET
from contextlib import suppress

import franky_sim.mujoco_simulator as simulator
import mujoco
import numpy as np
import pinocchio as pin
from franky_sim.franka_robot_protocol import (
    AutomaticErrorRecoveryCommand,
    BaseCommand,
    MoveStatus,
    RobotCommand,
    RobotMode,
)
from franky_sim.franka_robot_server import FrankaRobotServer
from franky_sim.franka_robot_state import FrankaRobotState
from franky_sim.simulation_server import LocalHostnames

HOME = (0.0, 0.1, 0.0, -2.0, 0.0, 2.1, 0.785)
#: m along the hand's z: tool centre, probe, its radius
TCP = 0.1034
PROBE = 0.125
RADIUS = 0.015
#: of the plate's damping, critical with the arm's mass at the probe; 1/s of its friction
DAMPING = 0.3
STICKING = 20.0
LOST = 20  #: commands in a row
COMMUNICATION = 25  #: communication_constraints_violation among libfranka's errors
PERIOD = 1e-3  #: s
#: s; the client gives up after 1 s without a packet
PATIENCE = 0.9
IDLE = 0.02  #: s, from step to step without a client
NOTHING = ("clock", "tilt", "friction", "mass", "push", "rest", "tcp_off")
SCENE = dict.fromkeys(NOTHING, 0) | {
    "height": 0.2,
    "stiffness": 7e4,
    "joint_friction": 1.0,
    "noise": 0.05,
    "sign": 1.0,
}
FAULTS = dict.fromkeys(("at", "kill", "drop", "repeat", "swap", "away", "reflex"), 0)
FAULTS["freeze"] = {}


class Robot(simulator.FrankaMujocoRobot):
    """Publishes the wrench on its environment, and the reflex that ended its motion."""

    wrench = np.zeros(6)
    error = None
    success = 1.0
    tcp_off = 0.0
    torques = np.zeros(7)
    tool = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, -np.pi / 4), np.array([0.0, 0.0, TCP]))

    @property
    def state(self):
        """State at the last step, without fields that no test reads: four times as fast."""
        errors = tuple(k == self.error for k in range(41))
        inner = self._get_state()
        X = self.kinematics(np.array(inner.q)).homogeneous
        X[:3, 3] += self.tcp_off * X[:3, 2]
        return FrankaRobotState(
            q=inner.q,
            q_d=inner.q,  # where it holds when a motion has ended
            dq=inner.dq,
            tau_J=inner.tau_j,
            tau_J_d=self.torques,
            O_T_EE=X.ravel(order="F"),
            F_T_EE=self.tool.homogeneous.ravel(order="F"),
            m_load=self.m_load,
            F_x_Cload=self.F_x_Cload,
            O_F_ext_hat_K=self.wrench,
            errors=errors,
            reflex_reason=errors,
            control_command_success_rate=self.success,
        )

    def torque_control(self, torques, has_new_command=True):
        self.torques = np.clip(torques, self.torque_limit_low, self.torque_limit_high)
        model = self._BaseRobot__model
        data = self._BaseRobot__data
        q = np.array(self._get_state().q)
        self._torque_control(self.torques + pin.computeGeneralizedGravity(model, data, q))

    def joint_position_control(self, target_q, has_new_command=True):
        self._joint_position_control(target_q)

    def _post_step(self):
        """Skip derivatives, which are not part of a state."""


class Server(FrankaRobotServer):
    """Drops, repeats and swaps packets, freezes; ends the motion where commands stay away."""

    clock = True
    faults = FAULTS
    count = 0  #: of all packets
    lost = 0
    sent = 0  #: packets since a motion began
    begun = False  #: whether a command of this motion came
    owed = False  #: whether the client got the last packet, and has to reply
    reflex = False
    kept = []  # noqa: RUF012

    def begin(self, faults, clock):
        self.faults = FAULTS | faults
        self.clock = clock
        self.reflex = False
        self.sent = 0
        self.reset_state()

    @property
    def moving(self):
        return self.udp_connected and self.current_motion_id > 0

    @property
    def awaited(self):
        """Sockets on which a command has to come before the next step."""
        due = self.owed and self.moving and not self.clock
        return [self._FrankaServer__udp_socket] * due

    def _post_process_commands(self):
        fresh = self._FrankaRobotServer__has_new_command
        robot = self.robot
        if not self.moving:
            self.lost = self.sent = 0
            self.begun = False
        elif self.begun:
            self.lost = 0 if fresh else self.lost + 1
            robot.success += 0.01 * (fresh - robot.success)
        faulty = self.faults["reflex"] and self.sent > self.faults["at"]
        if self.moving and (self.lost >= LOST or faulty):
            robot.error = COMMUNICATION
            self.reflex = True
            number = self.current_motion_id
            self.stop_motion(send_preemption_signal=False)
            self.reset_current_motion_id()
            self.send_state()
            reply = (self._tcp_socket, RobotCommand.kMove, number)
            BaseCommand.send_response(*reply, MoveStatus.kReflexAborted)
        super()._post_process_commands()

    @property
    def robot_state(self):
        state = super().robot_state
        return state.replace(robot_mode=RobotMode.kReflex) if self.reflex else state

    def _handle_udp_command(self, data):
        super()._handle_udp_command(data)
        self.begun = self.moving

    def send_state(self):
        if not self.udp_connected:
            return
        self.count += 1
        self.sent += self.moving
        packets = [struct.pack("<Q", self.count) + self._get_state_bytes()]
        k = self.sent - self.faults["at"]
        if self.moving and k > 0:
            packets = self.spoil(packets, k)
        for packet in packets:
            address = (self._FrankaServer__client_address, self._FrankaServer__client_udp_port)
            self._FrankaServer__udp_socket.sendto(packet, address)
        self.owed = self.begun and bool(packets)

    def spoil(self, packets, k):
        """Bytes sent in place of packet k since the faults began."""
        faults = self.faults
        hit = {name: k % (faults[name] or k + 1) == 0 for name in ("drop", "repeat", "swap")}
        if str(k) in faults["freeze"]:  # a sleep of 0 s gives the processor away, too
            time.sleep(faults["freeze"][str(k)])
        if faults["kill"]:
            os._exit(1)
        if k <= faults["away"]:  # a client that neither reads nor writes
            return []
        self.kept += packets * hit["swap"]
        if hit["swap"] or hit["drop"]:
            return []
        packets = packets + self.kept + packets * hit["repeat"]
        self.kept.clear()
        return packets


class Simulation(simulator.MujocoSimulator):
    """An FR3 with a probe, above a plate."""

    def __init__(self):
        super().__init__()
        simulator.FrankaMujocoRobot = Robot
        self.robot = self.add_robot(
            initial_q=HOME, kp=(600.0,) * 4 + (250.0,) * 3, kv=(50.0,) * 4 + (20.0,) * 3
        )
        hand = next(b for b in self.worldbody.iter("body") if b.get("name") == "robot0_hand")
        hand.extend(
            ET.fromstring(f"""<x>
            <geom name="probe" size="{RADIUS}" pos="0 0 {PROBE}" mass="0"/>
            <body name="load" pos="0 0 {TCP}">
              <inertial pos="0 0 0" mass="1e-6" diaginertia="1e-9 1e-9 1e-9"/> </body> </x>""")
        )
        self.worldbody.append(
            ET.fromstring("""<body name="plate">
            <geom name="plate" type="box" size="0.4 0.4 0.05" pos="0 0 -0.05"/> </body>""")
        )
        for geom in self.worldbody.iter("geom"):  # no others than this pair touch
            geom.attrib |= {"contype": "0", "conaffinity": "0"}
        ET.SubElement(self._contact_e, "pair", geom1="probe", geom2="plate")

    def begin(self, given):
        """Arm at rest at home, and the scene as given."""
        self.given = given = SCENE | given
        model = self.model
        data = self.data
        robot = self.robot
        if not hasattr(self, "losses"):
            self.losses = model.dof_frictionloss.copy()
            self.tip = model.geom("probe").id
            self.hand, self.plate = (model.body(name).id for name in ("robot0_hand", "plate"))
        model.dof_frictionloss[:] = given["joint_friction"] * self.losses
        model.body("load").mass[:] = max(given["mass"], 1e-6)
        mujoco.mj_setConst(model, data)
        mujoco.mj_resetData(model, data)
        data.qpos[robot._qpos_addrs] = HOME
        mujoco.mj_forward(model, data)
        tilt = 0.5 * given["tilt"]
        model.body_quat[self.plate] = (np.cos(tilt), np.sin(tilt), 0.0, 0.0)
        model.body_pos[self.plate] = (*data.geom_xpos[self.tip][:2], given["height"])
        self.touch(given["stiffness"], given["friction"])
        mujoco.mj_forward(model, data)
        self.random = np.random.default_rng(0)
        self.log = []
        self.nudge = np.zeros(3)  #: N, of a hand at the tool centre
        self.since = 0
        fresh = {"wrench": np.zeros(6), "error": None, "success": 1.0}
        vars(robot).update(fresh, tcp_off=given["tcp_off"], _applied_torques=np.zeros(7))

    def touch(self, stiffness, friction):
        """A linear spring and damper, and dry friction that does not lift the probe.

        MuJoCo's cone couples both: a probe that slides with v rests higher by μ b v / k, k and b
        the reference stiffness (1/s²) and damping (1/s) of the contact. With the b of the normal
        direction that exceeds the depth of light contacts, which then open for single steps. So
        friction gets a separate, smaller b; impratio compensates for this where the probe sticks.
        """
        model = self.model
        model.opt.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        model.opt.impratio = 10.0
        share = model.body_invweight0[self.hand][0]  # 1/kg, as MuJoCo weighs the contact
        damping = 2.0 * DAMPING * np.sqrt(2.0 * stiffness / share)
        half = 0.5  # impedance: reference values are then twice those of solref
        model.pair_dim[:] = 3 if friction else 1
        model.pair_friction[:, :2] = friction
        model.pair_solimp[:, :2] = half
        model.pair_solref[:] = -half * share * np.array([stiffness, damping])
        model.pair_solreffriction[:] = (-1e-9, -half * STICKING)

    def _step(self):
        self.pushed = np.array([*self.nudge, 0.0, 0.0, 0.0])
        t = PERIOD * (len(self.log) - self.since) - self.given["rest"]
        if self.given["push"] and t >= 0.0:  # by hand: to and fro, and the hand turned
            amount, rate = self.given["push"]
            shares = np.array([1.0, 1.0, 0.3, 0.0, 0.0, 0.05])
            self.pushed = shares * amount * np.cos(rate * t * np.array([1, 1.3, 0.7, 1, 1, 0.9]))
        applied = moved(self.pushed, self.tool() - self.data.xipos[self.hand])
        self.data.xfrc_applied[self.hand] = applied
        super()._step()
        self.note()

    def tool(self):
        return self.data.geom_xpos[self.tip] + self.data.geom_xmat[self.tip][2::3] * (TCP - PROBE)

    def note(self):
        """The wrench that the robot exerts on its environment, at its tool centre."""
        true = np.zeros(6)
        force = np.zeros(6)
        data = self.data
        for i in range(data.ncon):
            mujoco.mj_contactForce(self.model, data, i, force)
            in_world = force[:3] @ data.contact.frame[i].reshape(3, 3)
            true += moved([*in_world, 0.0, 0.0, 0.0], data.contact.pos[i] - self.tool())
        normal = data.xmat[self.plate][2::3]
        self.log.append([-true[:3] @ normal, *data.geom_xpos[self.tip], *data.qvel[:7]])
        true -= self.pushed
        true[2] -= 9.81 * self.given["mass"]  # what the robot does not know that it carries
        noise = self.given["noise"] * np.repeat([1.0, 0.1], 3) * self.random.standard_normal(6)
        self.robot.wrench = self.given["sign"] * true + noise


def moved(wrench, lever):
    """A wrench about the origin of its lever."""
    return pin.SE3(np.eye(3), lever).act(pin.Force(np.array(wrench))).vector


def recover(command, server):
    server.reflex = False
    server.robot.error = None
    command.reply(0)


def main():
    AutomaticErrorRecoveryCommand.handle = recover
    with Simulation() as sim:
        server = Server(sim.robot, LocalHostnames())
        server.init()
        sim.start()
        sim.begin({})
        print(json.dumps({"host": server.hostname}), flush=True)
        while True:
            awaited = server.awaited
            wait = 0.0 if server.tcp_connected else IDLE
            wait = PATIENCE if awaited else wait
            if sys.stdin in select.select([sys.stdin, *awaited], [], [], wait)[0]:
                if not (line := sys.stdin.readline()):
                    return
                print(json.dumps(obey(json.loads(line), sim, server)), flush=True)
                continue
            start = time.perf_counter()
            server.process_commands()
            sim.step()
            server.send_state()
            if server.clock or not server.begun:
                time.sleep(max(0.0, start + PERIOD - time.perf_counter()))


def obey(order, sim, server):
    if "scene" in order:
        sim.begin(order["scene"])
        server.begin(order["faults"], sim.given["clock"])
        if server.clock:
            with suppress(OSError):
                os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(70))
    if "push" in order:
        sim.given |= {"push": order["push"], "rest": 0.5}
        sim.since = len(sim.log)
    if "plate" in order:  # below the probe, where that is now
        depth = [0.0, 0.0, order["plate"] + RADIUS]
        sim.model.body_pos[sim.plate] = sim.data.geom_xpos[sim.tip] - depth
    if "nudge" in order:
        sim.nudge = np.array(order["nudge"])
    if "truth" in order:
        np.save(order["truth"], sim.log)
    return {"steps": len(sim.log)}


if __name__ == "__main__":
    main()
