"""Commissioning of a robot up to its first contact, in steps that are confirmed one by one."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import repeat
from pathlib import Path

import numpy as np
import pinocchio as pin

from osc_contact.contacts.pairs.points_on_planes import VertexOnFace
from osc_contact.control.controller import Controller
from osc_contact.drivers.franka import FrankaRobot
from osc_contact.errors import OscContactError, PlantError
from osc_contact.files import write_whole
from osc_contact.interface import Reference, pose_reference
from osc_contact.jerk_limits import rise
from osc_contact.loop.loop import run_loop
from osc_contact.loop.realtime import latency
from osc_contact.loop.recorder import Recorder
from osc_contact.loop.testing import mean_outside, require_nudge
from osc_contact.recorder import Recording
from osc_contact.settings.control import PhaseSettings
from osc_contact.spatial import Array

MASS_ERROR = 0.15  #: of the largest element, by which mass matrices may differ
TORQUE_ERROR = 0.05  #: of the motors' limits, by which torques at rest may differ
FORCES = 5.0, 8.0  #: N, of the approach and of the step
SLIDE = 0.02  #: m
ERROR = 0.1  #: of the force, rms
NUDGE = 0.0, 1.0, 0.0  #: direction of the push at the tool, in axes of the base
PATIENCE = 10.0  #: s, until it comes


@dataclass
class Commissioning:
    """The steps on one Franka.

    Attributes:
        robot: connected. folder: of the report.
        gap: m, from the tip down to a level plate.
        confirm: called with what comes next; False ends the commissioning.
        shadow_time: s, in which somebody leads the arm by the hand.
        realtime: as of `run_loop`.
        draw: makes a picture of the forces of a recording in a folder, and returns its file's name;
            None: there is no picture.
        lines: the report so far.
    """

    robot: FrankaRobot
    folder: Path
    gap: float
    confirm: Callable[[str], bool]
    shadow_time: float = 10.0
    realtime: bool = True
    draw: Callable[[Recording, Path], str] | None = None
    lines: list[str] = field(default_factory=list)

    def run(self) -> bool:
        """Run the steps until one fails or is not confirmed; write report.md with its pictures.

        Returns:
            True if all steps were completed.
        """
        steps = {
            "model: nothing moves": self._model,
            f"wrench: push the tool along {list(NUDGE)}, in axes of the base": self._nudge,
            "shadow: lead the arm by the hand, at the tool, after a moment of rest": self._shadow,
            f"contact: presses with {FORCES[0]:g} and {FORCES[1]:g} N, slides": self._press,
        }
        done = 0
        for what, step in steps.items():
            if not self.confirm(what):
                self.lines.append(f"- {what}: left out")
                break
            try:
                self.lines += [f"- {what}", *(f"  - {line}" for line in step())]
            except OscContactError as error:
                self.lines += [f"- {what}: failed", f"  - {error}"]
                break
            done += 1
        self.robot.stop()
        text = "\n".join(["# Commissioning", "", *self.lines, ""])
        write_whole(text, self.folder / "report.md")
        return done == len(steps)

    def _model(self) -> Iterator[str]:
        """Mass matrix and weight, against the robot's own; bias and noise of the wrist."""
        robot = self.robot
        model = robot.chain.model
        read = [robot.measure() for _ in range(300)]
        q = read[-1].q
        data = model.createData()
        M = np.array(pin.crba(model, data, q))
        theirs = robot.mass_matrix()
        worst = np.abs(M - theirs).max() / np.abs(theirs).max()
        if worst > MASS_ERROR:
            raise PlantError(
                f"the mass matrices of model and robot differ by {100 * worst:.3g} % of the "
                "largest element; is this the URDF of the robot, with its hand?"
            )
        yield f"mass matrices differ by {100 * worst:.2g} %"
        torques = np.mean([np.asarray(m.joint_torques) for m in read], axis=0)
        left = torques - pin.computeGeneralizedGravity(model, data, q)
        share = np.abs(left) / robot.chain.tau_max
        if share.max() > TORQUE_ERROR:
            j = share.argmax()
            raise PlantError(
                f"at rest joint '{robot.chain.joint_names[j]}' carries {torques[j]:.3g} N m, "
                f"{left[j]:.3g} N m more than the model's weight; correct masses, hand or payload"
            )
        yield f"torques at rest differ by {100 * share.max():.2g} % of the limits"
        wrenches = np.array([m.wrenches[0] for m in read])
        mean = wrenches.mean(axis=0).round(2).tolist()
        noise = wrenches.std(axis=0).round(3).tolist()
        yield f"wrist: {mean}, noise {noise} N, N m"

    def _nudge(self) -> Iterator[str]:
        """Sign and axes of the wrench, while the robot holds by itself."""
        chain = self.robot.chain

        def outside() -> Array:
            return mean_outside(chain, self.robot.measure)

        require_nudge(outside, chain.arms[0].base.rotation @ NUDGE, PATIENCE, 1e-3)
        yield "the wrist reads the push in its direction"

    def _shadow(self) -> Iterator[str]:
        """See `loop.shadow`."""
        q, X = self._stands()
        controller = Controller(self.robot.chain, [], dt=1e-3, posture=q)
        ticks = round(1e3 * self.shadow_time)
        hold = repeat(pose_reference(X.translation, X.rotation), ticks)
        found = run_loop(self.robot, controller, hold, shadow=True, realtime=self.realtime).shadow
        assert found is not None
        yield from found.lines()
        if not found.forces:
            raise PlantError("; ".join(found.findings))
        self.robot.recover()

    def _stands(self) -> tuple[Array, pin.SE3]:
        q = self.robot.measure().q
        return q, self.robot.chain.state(q).X_WO

    def _press(self) -> Iterator[str]:
        """Approach, two forces, a slide, a retreat."""
        q, X = self._stands()
        below = X.translation - [0.0, 0.0, self.gap]
        plate = VertexOnFace(np.zeros(3), point=below, normal=np.array([0.0, 0.0, 1.0]))
        life = PhaseSettings(travel=self.gap + 0.03)
        controller = Controller(self.robot.chain, [plate], dt=1e-3, posture=q, life=life)
        recorder = Recorder(controller)
        motion = _Motion(controller, X)
        loop = run_loop(
            self.robot, controller, motion.each(), recorder=recorder, realtime=self.realtime
        )
        recording = recorder.recording()
        if not motion.landed:
            raise PlantError(f"no plate was found within {1e3 * life.travel:.0f} mm below the tip")
        yield f"from state to torques: {latency(loop.as_dict())}"
        shown = "" if self.draw is None else f"; ![forces]({self.draw(recording, self.folder)})"
        yield f"landed after {motion.landed / 1e3:.2f} s{shown}"
        read, commanded = (recording[key][:, 0] for key in ("alpha_meas", "alpha_cmd"))
        for k, force in zip(motion.judged, FORCES, strict=True):
            part = slice(k - 500, k)
            error = np.sqrt(np.mean((read[part] / commanded[part] - 1.0) ** 2))
            yield f"{force:g} N: {100 * error:.2g} % rms"
            if error > ERROR:
                raise PlantError(
                    f"the wrist reads {100 * error:.2g} % rms beside {force:g} N; is the plate "
                    "held, and the wrench filtered by the robot?"
                )


@dataclass
class _Motion:
    """References of the first contact."""

    controller: Controller
    X: pin.SE3
    landed: int = 0
    judged: tuple[int, int] = (0, 0)

    def each(self) -> Iterator[Reference]:
        for k in range(20_000):
            if not self.landed and k > 50 and self.controller.phases()[0] == 2:
                self.landed = k
                self.judged = k + 1200, k + 3900
            t = 1e-3 * (k - self.landed) if self.landed else 0.0
            if t > 5.0:
                return
            slid = rise(t, 2.0, 2.0)
            raised = rise(t, 4.0, 0.8)
            force = 0.0 if k < 50 or t > 4.0 else FORCES[t > 1.2]
            p, v, a = SLIDE * np.column_stack((np.zeros(3), slid, raised))
            yield pose_reference(self.X.translation + p, self.X.rotation, v, a, alpha_d=[force])
