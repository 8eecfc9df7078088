"""Commissioning of a robot up to its first contact, in steps that are confirmed one by one."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import repeat
from pathlib import Path

import numpy as np
import pinocchio as pin

from osc_contact.contacts.pairs.points_on_planes import VertexOnFace
from osc_contact.control.controller import Controller
from osc_contact.control.status import Phase
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.errors import OscContactError, PlantError
from osc_contact.files import write_whole
from osc_contact.interface import Measurement, Reference, Robot, pose_reference
from osc_contact.jerk_limits import rise
from osc_contact.loop.loop import run_loop
from osc_contact.loop.realtime import latency
from osc_contact.loop.recorder import Recorder
from osc_contact.loop.testing import HeldRobot, mean_outside, require_model, require_nudge
from osc_contact.recorder import Recording
from osc_contact.settings.control import PhaseSettings
from osc_contact.spatial import Array

MASS_ERROR = 0.15  #: largest difference of mass matrices, over the largest element
TORQUE_ERROR = 0.05  #: largest difference of torques at rest, over the motors' limits
FORCES = (5.0, 8.0)  #: desired forces (N): during the approach, and after the step
SLIDE = 0.02  #: distances of the slide along the plate and of the retreat from it (m)
ERROR = 0.1  #: largest rms error of the force, over the desired force
NUDGE = (0.0, 1.0, 0.0)  #: direction of the push at the tool, in axes of the base
PATIENCE = 10.0  #: longest time until the push comes (s)
READ_S = 0.3  #: time over which the readings of a robot at rest are averaged (s)
ENGAGE_S = 0.05  #: time at rest before the approach (s)
APPROACH_S = 15.0  #: longest time of the approach (s)
#: Ends of the intervals in which the two forces are judged, after landing (s).
JUDGED_S = (
    1.2,
    3.9,
)
JUDGE_S = 0.5  #: length of these intervals (s)


@dataclass
class Commissioning:
    """Course of the first steps of one arm that passes `check_robot`.

    A robot may have two methods beyond `Robot`: `mass_matrix()` returns its own mass matrix (n, n)
    at its last reading, which is compared with the model's; `recover()` permits commands again
    after `stop`. Without `recover`, commands have to be accepted after `stop`.

    Attributes:
        robot: driver of the robot, connected and at rest.
        folder: folder of the report.
        gap: distance from the tip down to a level plate (m).
        confirm: function that is called with a sentence on the next step; False ends the course.
        shadow_time: time in which somebody leads the arm by the hand (s).
        realtime: see `run_loop`.
        draw: function that draws the forces of a recording into a folder and returns the name of
            the file; None: there is no picture.
        chain: model of the arm, with a wrist sensor, all joints with motors; None: `robot.chain`.
        dt: control period of the robot (s).
        holds_itself: True: the robot holds its posture while no torques are commanded, and
            `measure` waits for the next reading, as `FrankaRobot`; False: torques of the model
            hold it, and it is stopped while a step is to be confirmed.
        lines: lines of the report so far.
    """

    robot: Robot
    folder: Path
    gap: float
    confirm: Callable[[str], bool]
    shadow_time: float = 10.0
    realtime: bool = True
    draw: Callable[[Recording, Path], str] | None = None
    chain: ClosedChain | None = None
    dt: float = 1e-3
    holds_itself: bool = False
    lines: list[str] = field(default_factory=list)

    def run(self) -> bool:
        """Take the steps until one fails or is not confirmed; write report.md and its pictures.

        Returns:
            Whether all steps were taken.

        Raises:
            InvalidInputError: there is no model of the robot, or it has joints without motors.
            PlantError: the first measurement has wrong sizes, or `robot.stop` fails.
        """
        self._chain = require_model(self.robot, self.chain)  #: chain of the arm
        self._model = self._chain.model  #: model of the arm
        #: robot that is held by a torque law
        self._holder = HeldRobot(self.robot, self._chain, self.dt)
        steps = {
            "model: nothing moves": self._compare_model,
            f"wrench: push the tool along {list(NUDGE)}, in axes of the base": self._check_push,
            "shadow: lead the arm by the hand, at the tool, after a moment of rest": self._lead_arm,
            f"contact: presses with {FORCES[0]:g} and {FORCES[1]:g} N, slides": self._press,
        }
        completed_steps = 0
        for title, step in steps.items():
            if not self.holds_itself:
                self.robot.stop("the next step is to be confirmed")
            if not self.confirm(title):
                self.lines.append(f"- {title}: left out")
                break
            try:
                if not self.holds_itself:
                    self._recover()
                self.lines += [f"- {title}", *(f"  - {line}" for line in step())]
            except OscContactError as error:
                self.lines += [f"- {title}: failed", f"  - {error}"]
                break
            completed_steps += 1
        self.robot.stop()
        text = "\n".join(["# Commissioning", "", *self.lines, ""])
        write_whole(text, self.folder / "report.md")
        return completed_steps == len(steps)

    def _next_measurement(self) -> Measurement:
        """Read the next measurement of the robot at rest.

        A robot that holds itself is only read; another one gets holding torques for one period.

        Raises:
            PlantError: a measurement that breaks the contract, or an arm that moves away.
        """
        if self.holds_itself:
            self._holder.last = self._holder.read()
        else:
            self._holder.settle(1)
        return self._holder.last

    def _compare_model(self) -> Iterator[str]:
        """Compare mass matrix and weight with the robot's own; measure bias and noise of the wrist.

        Yields:
            Lines of the report.

        Raises:
            PlantError: mass matrices differ by more than `MASS_ERROR`, or torques by more than
                `TORQUE_ERROR`.
        """
        measurements = [self._next_measurement() for _ in range(round(READ_S / self.dt))]
        data = self._model.createData()
        q = measurements[-1].q
        # mass matrix, if the robot's own model can be asked for it
        mass_matrix: Callable[[], Array] | None = getattr(self.robot, "mass_matrix", None)
        if mass_matrix is None:
            yield "mass matrices are not compared: the robot has no mass_matrix()"
        else:
            M = np.array(pin.crba(self._model, data, q))
            robot_M = mass_matrix()
            difference = np.abs(M - robot_M).max() / np.abs(robot_M).max()
            if difference > MASS_ERROR:
                raise PlantError(
                    f"the mass matrices of model and robot differ by {100 * difference:.3g} % of "
                    "the largest element; is this the model of the robot, with its hand?"
                )
            yield f"mass matrices differ by {100 * difference:.2g} %"
        # torques at rest: the mean of all readings is compared with the weight
        readings = [m.joint_torques for m in measurements if m.joint_torques is not None]
        if not readings:
            yield "torques at rest are not compared: the robot measures none"
        else:
            torques = np.mean(readings, axis=0)
            differences = torques - pin.computeGeneralizedGravity(self._model, data, q)
            shares = np.abs(differences) / self._chain.tau_max
            if shares.max() > TORQUE_ERROR:
                j = shares.argmax()
                raise PlantError(
                    f"at rest joint '{self._chain.joint_names[j]}' carries {torques[j]:.3g} N m, "
                    f"{differences[j]:.3g} N m more than the model's weight; correct masses, hand "
                    "or payload"
                )
            yield f"torques at rest differ by {100 * shares.max():.2g} % of the limits"
        # bias and noise of the wrist while nothing touches
        wrenches = np.array([m.wrenches[0] for m in measurements])
        mean = wrenches.mean(axis=0).round(2).tolist()
        noise = wrenches.std(axis=0).round(3).tolist()
        yield f"wrist: {mean}, noise {noise} N, N m"

    def _check_push(self) -> Iterator[str]:
        """Compare sign and axes of the wrench with a push of the tool while the arm is held.

        Yields:
            Lines of the report.

        Raises:
            PlantError: no push is measured, or one in another direction.
        """

        def outside() -> Array:
            """Mean wrench (6,) of the wrist over some ticks, in world axes (N, N m)."""
            return mean_outside(self._chain, self._next_measurement)

        base = self._chain.arms[0].base
        require_nudge(outside, base.rotation @ NUDGE, PATIENCE, self.dt)
        yield "the wrist reads the push in its direction"

    def _lead_arm(self) -> Iterator[str]:
        """Judge the model while somebody leads the arm, see `loop.shadow`.

        Yields:
            Lines of the report.

        Raises:
            PlantError: the model does not explain the torques, so that forces must not be
                commanded.
        """
        q, X = self._present_state()
        controller = Controller(self._chain, [], dt=self.dt, posture=q)
        ticks = round(self.shadow_time / self.dt)
        hold = repeat(pose_reference(X.translation, X.rotation), ticks)
        report = run_loop(self.robot, controller, hold, shadow=True, realtime=self.realtime).shadow
        assert report is not None
        yield from report.lines()
        if not report.forces:
            raise PlantError("; ".join(report.findings))
        if self.holds_itself:
            self._recover()

    def _recover(self) -> None:
        """Permit the next motion, which begins where the arm is now.

        Raises:
            PlantError: the robot does not recover, or breaks the contract of `Robot`.
        """
        recover: Callable[[], None] | None = getattr(self.robot, "recover", None)
        if recover is not None:
            recover()
        self._holder = HeldRobot(self.robot, self._chain, self.dt)
        if not self.holds_itself:
            self._holder.settle(round(READ_S / self.dt))

    def _present_state(self) -> tuple[Array, pin.SE3]:
        """Measure the joint positions (n,) and compute the pose of the tip from them."""
        q = np.asarray(self.robot.measure().q)
        return (q, self._chain.state(q).X_WO)

    def _press(self) -> Iterator[str]:
        """Approach a plate, press with two forces, slide and retreat.

        Yields:
            Lines of the report.

        Raises:
            PlantError: no plate is found, or the rms error of a force is larger than `ERROR`.
        """
        # a plate is assumed at the given distance below the tip, and approached until it is touched
        q, X = self._present_state()
        below = X.translation - [0.0, 0.0, self.gap]
        plate = VertexOnFace(np.zeros(3), point=below, normal=np.array([0.0, 0.0, 1.0]))
        life = PhaseSettings(travel=self.gap + 0.03)
        controller = Controller(self._chain, [plate], dt=self.dt, posture=q, life=life)
        recorder = Recorder(controller)
        motion = _Motion(controller, X)
        loop = run_loop(
            self.robot, controller, motion.each(), recorder=recorder, realtime=self.realtime
        )
        recording = recorder.recording()
        if not motion.landed:
            raise PlantError(f"no plate was found within {1e3 * life.travel:.0f} mm below the tip")
        yield f"from state to torques: {latency(loop.as_dict())}"
        picture = "" if self.draw is None else f"; ![forces]({self.draw(recording, self.folder)})"
        yield f"landed after {motion.landed * self.dt:.2f} s{picture}"
        # rms error of each commanded force over the last `JUDGE_S` before its end
        reading = recording["alpha_meas"][:, 0]
        command = recording["alpha_cmd"][:, 0]
        for k, force in zip(motion.judged, FORCES, strict=True):
            interval = slice(k - round(JUDGE_S / self.dt), k)
            error = np.sqrt(np.mean((reading[interval] / command[interval] - 1.0) ** 2))
            yield f"{force:g} N: {100 * error:.2g} % rms"
            if error > ERROR:
                raise PlantError(
                    f"the wrist reads {100 * error:.2g} % rms beside {force:g} N; is the plate "
                    "held, and the wrench filtered by the robot?"
                )


@dataclass
class _Motion:
    """References of the first contact: approach, two forces, slide and retreat.

    Attributes:
        controller: controller of the loop, whose contact phase shows the landing.
        X: pose of the tip at the start.
        landed: tick in which the contact was found closed; 0: not yet.
        judged: ticks at which the intervals end in which the two forces are judged.
    """

    controller: Controller
    X: pin.SE3
    landed: int = 0
    judged: tuple[int, int] = (0, 0)

    def each(self) -> Iterator[Reference]:
        """Yield the reference of each tick, until 5 s after the landing or the approach is over.

        The pose is held during the approach; from the landing on, two forces (N) are commanded one
        after the other, the tip slides (from 2 s) and retreats (from 4 s).
        """
        dt = self.controller.dt
        engaged = round(ENGAGE_S / dt)
        for k in range(round((APPROACH_S + 5.0) / dt)):
            if not self.landed and k > engaged and self.controller.phases()[0] == Phase.CLOSED:
                self.landed = k
                first, second = (k + round(t / dt) for t in JUDGED_S)
                self.judged = (first, second)
            t = dt * (k - self.landed) if self.landed else 0.0
            if t > 5.0:
                return
            slide = rise(t, 2.0, 2.0)  # share of the way, with its first and second derivative
            retreat = rise(t, 4.0, 0.8)
            if k < engaged or t > 4.0:
                force = 0.0
            elif t > JUDGED_S[0]:
                force = FORCES[1]
            else:
                force = FORCES[0]
            p, v, a = SLIDE * np.column_stack((np.zeros(3), slide, retreat))
            yield pose_reference(self.X.translation + p, self.X.rotation, v, a, alpha_d=[force])
