"""Simulated FR3 of `franka_server.py` for tests: its process, a model of the arm, and a task."""

import json
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from time import sleep

import franky_sim
import numpy as np
from samples import module_fixture

import osc_contact as osc
from osc_contact.drivers.franka import FrankaRobot
from osc_contact.jerk_limits import rise

URDF = Path(franky_sim.__file__).parent / "assets" / "fr3_clean.urdf"
HAND = """
<link name="hand"><inertial><origin xyz="-0.01 0 0.03"/><mass value="0.73"/>
 <inertia ixx="0.001" iyy="0.0025" izz="0.0017" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="hand_joint" type="fixed"><parent link="link8"/><child link="hand"/>
 <origin rpy="0 0 -0.7853981633974483"/></joint>
<link name="tcp"/><joint name="tcp_joint" type="fixed"><parent link="hand"/><child link="tcp"/>
 <origin xyz="0 0 0.1034"/></joint></robot>"""
PROBE = 0.125 - 0.1034  #: distance of the probe from the tool centre along its z axis (m)
RADIUS = 0.015  #: radius of the probe (m)
TIP = 0.28454 - RADIUS  #: height of the probe's end at the start (m)
SLID = 2.2  #: time after landing at which the contact is released (s)


class FrankaServer:
    """Process of the simulated robot, controlled by lines of JSON.

    Attributes:
        folder: folder of files.
        urdf: the robot with a hand.
        process: the process.
        host: address.
    """

    def __init__(self, folder):
        """Write the URDF into a folder and start the process."""
        self.folder = folder
        self.urdf = folder / "fr3.urdf"
        self.urdf.write_text(URDF.read_text().replace("</robot>", HAND))
        self.start()

    def start(self):
        """Start the process and wait for its address."""
        program = [sys.executable, Path(__file__).with_name("franka_server.py")]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        self.process = subprocess.Popen(program, **pipes, text=True)
        self.host = self._answer()["host"]

    def _answer(self):
        """Next line of the process as an object of JSON."""
        line = self.process.stdout.readline()
        assert line, "the simulated robot has ended"
        return json.loads(line)

    def send(self, **order):
        """Send an order and return the answer of the process."""
        self.process.stdin.write(json.dumps(order) + "\n")
        self.process.stdin.flush()
        return self._answer()

    def wait(self, steps):
        """Wait until the robot, which holds its posture by itself, has made a number of steps."""
        end = self.send()["steps"] + steps
        while self.send()["steps"] < end:
            sleep(0.01)

    def begin(self, *, faults=None, **scene):
        """Reset the simulation with a scene and faults; start the process again if it has ended."""
        if self.process.poll() is not None:
            self.end()
            self.start()
        self.send(scene=scene, faults=faults or {})

    def truth(self):
        """True signals (steps, 11): normal force (N), probe's position (m), v (rad/s)."""
        file = self.folder / "truth.npy"
        self.send(truth=str(file))
        return np.load(file)

    def end(self):
        """End the process."""
        with suppress(BrokenPipeError):
            self.process.stdin.close()
        self.process.stdout.close()
        self.process.wait(10)

    def arm(self, sensor="tcp"):
        """Model of the arm with a wrist sensor frame, without rotors and without joint friction."""
        known = {"tip": "tcp", "wrist_sensor": sensor, "friction_factor": 0.0}
        return osc.Arm.from_urdf(self.urdf, name="fr3", **known)


@module_fixture
def franka(tmp_path_factory):
    """Process of the simulated robot for all tests of a module."""
    server = FrankaServer(tmp_path_factory.mktemp("franka"))
    yield server
    server.end()


@dataclass
class Press:
    """Task: approach a plate, press for 0.7 s, slide 40 mm in 1.3 s, release and retreat.

    Attributes:
        server: process of the robot.
        force: desired force (N).
        gap, modelled: gap to the plate at the start, true and in the controller's model (m).
        slide: length of the slide (m).
        ticks: largest number of ticks.
        hold: time from landing to the end (s).
        scene, faults: arguments of `FrankaServer.begin`.
        check: True: checks before the first command.
    """

    server: FrankaServer
    force: float = 10.0
    gap: float = 0.004
    modelled: float = 0.004
    slide: float = 0.04
    ticks: int = 11000
    hold: float = 2.75
    scene: dict = field(default_factory=dict)
    faults: dict = field(default_factory=dict)
    check: bool = True

    def prepare(self, **driver):
        """Reset the simulation, connect the driver (with arguments `driver`), make a controller."""
        self.server.begin(height=TIP - self.gap, faults=self.faults, **self.scene)
        self.chain = osc.ClosedChain([self.server.arm(sensor=driver.pop("sensor", "tcp"))])
        self.robot = FrankaRobot(self.server.host, self.chain, **driver)
        q = self.robot.measure().q
        self.start = self.chain.state(q).X_WO
        table = osc.VertexOnFace(
            [0, 0, PROBE], point=[0.5, 0, TIP - self.modelled], normal=[0, 0, 1], radius=RADIUS
        )
        life = osc.PhaseSettings(travel=max(osc.PhaseSettings().travel, self.gap + 0.03))
        self.controller = osc.Controller(self.chain, [table], dt=1e-3, posture=q, life=life)
        self.status = []
        self.state = []
        self.landed = self.released = 0
        self.normal = np.zeros(1)

    def run(self):
        """Run the task, and store the true forces and positions from its first tick on."""
        try:
            osc.run_loop(self.robot, self.controller, self.references(), check=self.check)
        finally:
            if not self.faults.get("kill"):
                rows = self.server.truth()[-len(self.status) :]
                self.normal = rows[:, 0]
                self.probe = rows[:, 1:4]

    def references(self):
        """Yield the reference of each tick; times count from landing."""
        x = self.start.translation
        away = np.zeros(3)
        for k in range(self.ticks):
            if k:
                self.status.append(self.controller.status)
                self.state.append(self.controller.state)
            if not self.landed and k > 50 and self.controller.phases()[0] == 2:
                self.landed = k
            t = 1e-3 * (k - self.landed) if self.landed else 0.0
            if t > self.hold or self.state[-100:] == [osc.SafetyState.SAFE_STOP] * 100:
                return
            if t >= SLID and not self.released:
                self.released = k
                away = self.chain.state(np.array(self.robot.state.q)).X_WO.translation
                away = away - x - [0.0, self.slide, 0.0]
            force = self.force * (k > 50 and not self.released)
            sides = np.outer(rise(t, 0.7, 1.3), [0.0, self.slide, 0.0])
            p, v, a = sides + np.outer(rise(t, SLID, 0.5), [0.0, 0.0, 0.02])
            yield osc.pose_reference(x + away + p, self.start.rotation, v, a, alpha_d=[force])

    def error(self):
        """Relative rms error of the force from half a second after landing until the release."""
        part = self.normal[self.landed + 500 : self.released]
        return np.sqrt(np.mean((part / self.force - 1.0) ** 2))
