"""The simulated FR3 of `franka_server.py` for tests: a process, a model, a task."""

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
#: m from the tool centre, along its z
PROBE = 0.125 - 0.1034
RADIUS = 0.015
TIP = 0.28454 - RADIUS  #: m, height of the probe's end at the start
SLID = 2.2  #: s after landing, when it is released


class FrankaServer:
    """The server's process."""

    def __init__(self, folder):
        self.folder = folder
        self.urdf = folder / "fr3.urdf"
        self.urdf.write_text(URDF.read_text().replace("</robot>", HAND))
        self.start()

    def start(self):
        program = [sys.executable, Path(__file__).with_name("franka_server.py")]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        self.process = subprocess.Popen(program, **pipes, text=True)
        self.host = self._answer()["host"]

    def _answer(self):
        line = self.process.stdout.readline()
        assert line, "the simulated robot has ended"
        return json.loads(line)

    def send(self, **order):
        self.process.stdin.write(json.dumps(order) + "\n")
        self.process.stdin.flush()
        return self._answer()

    def wait(self, steps):
        """Until the robot, which holds by itself, has made so many."""
        end = self.send()["steps"] + steps
        while self.send()["steps"] < end:
            sleep(0.01)

    def begin(self, *, faults=None, **scene):
        if self.process.poll() is not None:
            self.end()
            self.start()
        self.send(scene=scene, faults=faults or {})

    def truth(self):
        """(steps, 11) normal force on the plate, place of the probe, joint speeds."""
        file = self.folder / "truth.npy"
        self.send(truth=str(file))
        return np.load(file)

    def end(self):
        with suppress(BrokenPipeError):
            self.process.stdin.close()
        self.process.stdout.close()
        self.process.wait(10)

    def arm(self, sensor="tcp"):
        """Nothing is known of its rotors and its joints' friction; the file has 0.2 N m."""
        known = {"tip": "tcp", "wrist_sensor": sensor, "friction_factor": 0.0}
        return osc.Arm.from_urdf(self.urdf, name="fr3", **known)


@module_fixture
def franka(tmp_path_factory):
    server = FrankaServer(tmp_path_factory.mktemp("franka"))
    yield server
    server.end()


@dataclass
class Press:
    """Approach, press for 0.7 s, slide 40 mm in 1.3 s, release and retreat."""

    server: FrankaServer
    force: float = 10.0
    gap: float = 0.004  #: of the plate
    modelled: float = 0.004  #: of the plate that the controller assumes
    slide: float = 0.04
    ticks: int = 11000
    hold: float = 2.75  #: s from landing to the end
    scene: dict = field(default_factory=dict)
    faults: dict = field(default_factory=dict)
    check: bool = True  #: before the first command

    def prepare(self, **driver):
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
        """Run it, and keep what was true from its first tick on."""
        try:
            osc.run_loop(self.robot, self.controller, self.references(), check=self.check)
        finally:
            if not self.faults.get("kill"):
                rows = self.server.truth()[-len(self.status) :]
                self.normal = rows[:, 0]
                self.probe = rows[:, 1:4]

    def references(self):
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
