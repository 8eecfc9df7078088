"""Commands about robots: checks, kinematics, a first task."""

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pinocchio as pin
import typer
from typer import Argument, Exit, Option

from osc_contact import robots
from osc_contact.dynamics.arm import Arm
from osc_contact.dynamics.assembly import object_pose, outside_limits
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.errors import InvalidInputError
from osc_contact.lab.cli.console import JsonOption, SetOption, load_task, out, say
from osc_contact.lab.reports.report import robot_tables, write_json
from osc_contact.lab.runs import poses
from osc_contact.lab.scenarios.loader import list_scenarios
from osc_contact.robots import second_reading
from osc_contact.robots.mjcf import is_mjcf


def check(
    robot: Annotated[
        str, Argument(help="a URDF, an MJCF file, or the name of a robot such as panda")
    ],
    tip: Annotated[str | None, Option(help="frame to describe (default: all ends)")] = None,
    limit: Annotated[
        list[str] | None,
        Option(help="JOINT:effort=…,velocity=…,lower=…,upper=…, any number"),
    ] = None,
    inertias: Annotated[
        robots.Inertias, Option(help="positive: for parameters that no body has exactly")
    ] = "possible",
    package_dir: Annotated[list[Path] | None, Option(help="folder that may hold meshes")] = None,
    json_file: JsonOption = None,
) -> None:
    """Check a robot's URDF or MJCF and describe the robot; exit code 1 if something is wrong."""
    path, folders = robots.resolve_urdf(robot)
    by_hand = dict(robots.JointLimits.parse(text) for text in limit or [])
    places = [*folders, *(package_dir or [])]
    report = robots.check_robot(
        path, limits=by_hand, inertias=inertias, package_dirs=places, tip=tip
    )
    say(*report.lines())
    results = report.as_dict()
    if report.sound and not is_mjcf(path):  # yourdfpy reads URDFs only
        differences = second_reading.differences(
            path, limits=by_hand, inertias=inertias, package_dirs=places
        )
        results["differences"] = differences
        say(*(differences or [second_reading.AGREE]))
    for table in robot_tables(report.summary) if report.summary else ():
        out.print(table)
    if json_file:
        write_json(results, json_file)
    if not report.sound:
        raise Exit(1)


def pose(
    what: Annotated[
        str, Argument(metavar="ROBOT|SCENARIO", help="a name, a URDF, an MJCF, a YAML file")
    ],
    tip: Annotated[str | None, Option(help="frame of a robot (default: its end)")] = None,
    posture: Annotated[
        str | None, Option(help='where the joints are: "0, -45 deg, …" (m, rad)')
    ] = None,
    xyz: Annotated[str | None, Option(help='put tip or object there: "0.4, 0, 30 cm" (m)')] = None,
    rpy: Annotated[
        str | None, Option(help='and turn it so: "180 deg, 0, 0" (rad); default: unchanged')
    ] = None,
    seed: Annotated[
        int | None, Option(min=0, help="begin from random postures, not from --posture")
    ] = None,
    set_: SetOption = None,
    json_file: JsonOption = None,
) -> None:
    """Show the pose of tip or object in a posture; with --xyz, --rpy the posture for a pose.

    Without --posture the joints are as the robot or scenario declares them. The pose is in world
    axes (m, rad); the posture has one number for each joint (m, rad).
    """
    chain, q, X = _chain_at_start(what, tip, set_)
    if posture is not None:
        q = poses.numbers("posture", posture)
        if q.shape != (chain.nq,):
            names = ", ".join(chain.joint_names)
            raise InvalidInputError(f"posture: {len(q)} numbers for {chain.nq} joints: {names}")
    X_now = X if posture is None and X is not None else object_pose(chain, q)
    reached = True
    if seed is not None and xyz is None and rpy is None:
        raise InvalidInputError("--seed is of the search for a posture; give --xyz or --rpy")
    if xyz is not None or rpy is not None:
        p = X_now.translation if xyz is None else poses.place(xyz)
        R = X_now.rotation if rpy is None else pin.rpy.rpyToMatrix(*poses.numbers("rpy", rpy))
        solution = poses.solve(chain, pin.SE3(R, p), q, seed)
        q = solution.q
        reached = solution.reached
        if not reached:
            shift, turn = solution.miss
            say(
                f"not reached within the joints' limits: {1e3 * shift:.3g} mm and "
                f"{np.rad2deg(turn):.3g} deg are left at the nearest posture; "
                "give another pose, or another --seed"
            )
    outside = outside_limits(chain, q)
    say(*poses.pose_lines(chain, q), *outside, *poses.degrees(chain, q))
    if json_file:
        write_json(poses.as_dict(chain, q), json_file)
    if outside or not reached:
        raise Exit(1)


def _chain_at_start(
    name: str, tip: str | None, changes: list[str] | None
) -> tuple[ClosedChain, np.ndarray, pin.SE3 | None]:
    """Chain of a scenario or a robot, its posture (n,) and the pose of a scenario's object.

    Args:
        name: a scenario, or a robot.
        tip: frame of a robot.
        changes: KEY=VALUE of a scenario.
    """
    if Path(name).suffix in (".yaml", ".yml") or name in list_scenarios():
        if tip is not None:
            raise InvalidInputError("--tip chooses a frame of a robot; a scenario names its own")
        return poses.chain_of(load_task(name, changes))
    if changes:
        raise InvalidInputError("--set changes scenarios; give --posture for a robot")
    chain = ClosedChain([poses.arm_of(name, tip)])
    return (chain, poses.rest(chain), None)


def new(
    robot: Annotated[str, Option(help="a name such as ur10, a URDF or an MJCF file")],
    press: Annotated[
        str, Option(help="axis of the tip and force: Z=15 presses along its z with 15 N")
    ] = "Z=10",
    tip: Annotated[
        str | None, Option(help="frame that carries the stylus (default: the robot's end)")
    ] = None,
    posture: Annotated[
        str | None, Option(help='where it starts (default: one is sought): "0, -45 deg, …"')
    ] = None,
    file: Annotated[
        Path | None, Option("--out", help="to write (default: ROBOT_press.yaml)")
    ] = None,
) -> None:
    """Write a scenario that runs: a robot presses a stylus on a plate and slides along it."""
    q = None if posture is None else poses.numbers("posture", posture)
    target = file or Path(f"{Path(robot).stem}_press.yaml")
    if target.exists():
        raise InvalidInputError(f"{target} exists; give another file with --out")
    text = poses.draft(robot, poses.arm_of(robot, tip), poses.Press.parse(press), q, target)
    target.write_text(text, encoding="utf-8")
    say(f"written: {target}")
    say(f"next: osc-contact inspect {target}; osc-contact run {target}")


def commission(
    robot: Annotated[Literal["franka"], Argument(help="the driver")],
    *,
    host: Annotated[str, Option(help="address of the robot")],
    urdf: Annotated[Path, Option(help="model of the arm with its hand")],
    tip: Annotated[str, Option(help="frame of the model at the end effector")],
    gap: Annotated[float, Option(help="m from the tip down to a level plate")] = 0.03,
    folder: Annotated[Path, Option("--out", help="of the report")] = Path("out/commission"),
    shadow_time: Annotated[float, Option(help="s of leading the arm by the hand")] = 10.0,
    yes: Annotated[bool, Option("--yes", help="confirm every step beforehand")] = False,
    realtime: Annotated[bool, Option(help="deadlines count, 20 missed in a row stop")] = True,
) -> None:
    """Commission a robot, from its first answer to its first contact; each step is confirmed."""
    from osc_contact.drivers.franka import FrankaRobot
    from osc_contact.lab.visual.plots import draw_forces
    from osc_contact.loop.commissioning import Commissioning

    def confirm(step: str) -> bool:
        """Print the next step and ask for it on the terminal, unless --yes confirms all steps."""
        say(step)
        return yes or typer.confirm("continue?")

    # the robot compensates the friction of its joints by itself
    arm = Arm.from_urdf(urdf, name=robot, tip=tip, wrist_sensor=tip, friction_factor=0.0)
    driver = FrankaRobot(host, ClosedChain([arm]))
    course = Commissioning(
        driver, folder, gap, confirm, shadow_time, realtime, draw_forces, holds_itself=True
    )
    completed = course.run()
    say(*course.lines)
    if not completed:
        raise Exit(1)
