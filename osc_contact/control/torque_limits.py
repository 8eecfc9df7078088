"""Torques of a saturated tick within the motor limits, and the losses of motion and force."""

import numpy as np

from osc_contact.control.controller_settings import Settings
from osc_contact.control.records import TickRecords
from osc_contact.control.status import LimitLoss
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.law.limits import TorqueLimits
from osc_contact.law.nested import View
from osc_contact.law.saturation import fill_program, settle


def apply_least_loss(program: TorqueLimits, rows: TickRecords) -> None:
    """Replace the torques of a saturated tick by those within the limits that lose least.

    Changes the fields of `settle`: torques and internal forces of WORK; torques, force integrals
    and counts of ticks that were not computed in MEMORY.

    Args:
        program: quadratic program of the controller, which is filled and solved.
        rows: records of the tick, whose status is SATURATED.

    Raises:
        SolverError: the program has no solution.
    """
    place = (rows.rows.raw, rows.at, rows.index, program.raw)
    fill_program(*place)
    program.solve()
    settle(*place)


#: Joint motions without motion of the object that a singular posture may add in a redundant arm.
NEAR_SINGULAR = 2


class MotorLimits:
    """Quadratic program of the motor limits of one controller, whose arrays are allocated once.

    Attributes:
        chain: model of the arms.
        program: the quadratic program.
    """

    def __init__(self, settings: Settings, model: View) -> None:
        """Allocate the quadratic program of the motor limits.

        Args:
            settings: settings of the controller.
            model: view of MODEL, whose sizes are read.
        """
        chain = settings.chain
        self.chain = chain
        self.program = TorqueLimits(
            chain.n_a, max(1, int(model.n_columns)), int(model.n_extra), _count_idle(chain)
        )
        self.program.program.mass = chain.reference.inertia.mass

    def given_up(self, rows: TickRecords) -> LimitLoss:
        """Compute the losses of the tick in which `apply_least_loss` was called last.

        They are the motors at their limits with their desired torques, and the commanded less the
        resulting contact forces (N), motion (6,; at O in world axes, m/s², rad/s²) and squeeze (N).

        Args:
            rows: records of this tick.
        """
        program = self.program
        chain = self.chain
        r = int(program.r)
        s = int(program.s)
        squeeze = rows.work.basis[:, :s] @ program.lost_squeeze[:s]
        motors = np.flatnonzero(program.at_limit)
        # forces of the independent columns of N, distributed among all active columns
        R = rows.shares()
        lost = R.T @ np.linalg.solve(R @ R.T, program.lost_force[:r])
        return LimitLoss(
            tuple(chain.joint_names[chain.actuated[i]] for i in motors),
            program.desired[motors],
            chain.tau_max[motors],
            lost,
            rows.motions() @ (rows.reflection().T @ program.lost_motion),
            squeeze,
            bool(program.short),
        )


def scale_torques(rows: TickRecords, chain: ClosedChain) -> LimitLoss:
    """Scale all torques by one factor, so that none exceeds its limit.

    For custom control structures, of which nothing is known. After the first tick the change of the
    torques is limited to `torque_rate`, too. Changes `torques`, `faults` and `lost` of MEMORY.

    Args:
        rows: records of the tick.
        chain: its motors.
    """
    memory = rows.memory
    desired = rows.work.joints.tau[chain.actuated]
    share = np.abs(desired) / chain.tau_max
    motor = np.argmax(share)  # the motor that exceeds its limit by the largest factor
    tau = desired / share[motor]
    if memory.ticked > 1:  # limited in its rate, too, as other torques are
        step = rows.model.torque_rate * rows.model.period * chain.tau_max
        change = tau - memory.torques
        tau = memory.torques + change / max(1.0, np.max(np.abs(change) / step))
    memory.torques[:] = tau
    memory.faults = 0  # computed after all
    memory.lost = max(int(memory.lost) - 1, 0)
    none = np.zeros(0)
    motors = [motor]
    names = (chain.joint_names[chain.actuated[motor]],)
    limits = chain.tau_max[motors]
    return LimitLoss(names, desired[motors], limits, none, np.zeros(6), none, False)


def _count_idle(chain: ClosedChain) -> int:
    """Largest number of independent joint motions that do not move the object, of all arms.

    A redundant arm has one for each joint more than its grasp transmits forces, and up to
    `NEAR_SINGULAR` more near singular postures. Arms without surplus joints have none: directions
    that they lose near singular postures count as locked (`osc_contact/law/singular.py`).

    Args:
        chain: chain of arms and object.
    """
    total = 0
    for arm, grasp in zip(chain.arms, chain.grasps, strict=True):
        surplus = arm.model.nv - grasp.N.shape[1]
        if surplus > 0:
            total += surplus + NEAR_SINGULAR
    return total
