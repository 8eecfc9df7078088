"""The first program of a user, with one mistake each: what it is told, and before which command."""

import re

from samples import ROOT, module_fixture, parametrize

import osc_contact as osc

PAGE = ROOT / "docs" / "mujoco_arm.md"
CONTROLLER = "osc.Controller(robot.chain, [wall], posture=start)"
GOAL = "osc.pose_reference(p, X.rotation, v, a, alpha_d=[10.0])"
HEAVY = """osc.ClosedChain(
    osc.Arm.from_mjcf(model, name="arm", tip="tip", wrist_sensor="wrist", mass_factor=1e3)
)"""
DEEPER = "osc.VertexOnFace([0, 0, 0], [0.45, 0, 0.5], out, radius=0.01)"

#: What is written, what is written instead, the cause and the cure in the message.
MISTAKES = {
    "the wall is modelled 20 mm too deep": (
        "Controller(robot.chain, [wall]",
        f"Controller(robot.chain, [{DEEPER}]",
        "that is 20 mm inside the nearest geom, 'wall'",
        "move the contact's face to the scene's",
    ),
    "masses in grams": (
        "Controller(robot.chain,",
        f"Controller({HEAVY},",
        "all that moves weighs 1.43e+04 kg in the controller's model, 14.3 kg in the scene",
        "are masses in kg",
    ),
    "a rate in place of the period": (
        CONTROLLER,
        CONTROLLER.replace(")", ", dt=1000)"),
        "dt = 1000 s, longer than 0.1 s",
        "0.001 for a rate of 1000 Hz",
    ),
    "a radius in millimetres": (
        "radius=0.01, name",
        "radius=10, name",
        "'wall': radius is 10 m",
        "give lengths in m: 0.01 for 10 mm",
    ),
    "positions in millimetres": (
        "p = X.translation",
        "p = 1e3 * X.translation",
        "the first reference puts the object 667 m away from where it is",
        "begin the motion at chain.state(q, v).X_WO",
    ),
    "chain and contacts swapped": (
        "Controller(robot.chain, [wall]",
        "Controller([wall], robot.chain",
        "Controller takes a ClosedChain, got [VertexOnFace",
        "give osc.ClosedChain([arm])",
    ),
    "robot and controller swapped": (
        "run_loop(robot, controller,",
        "run_loop(controller, robot,",
        "robot is <osc_contact.control.controller.Controller",
        "the order is run_loop(robot, controller, references)",
    ),
    "velocity and acceleration swapped": (
        "X.rotation, v, a,",
        "X.rotation, a, v,",
        "V_D is up to 0.518 m/s off the rate of X_WD",
        "give V_D as the time derivative of X_WD",
    ),
    "a position in place of a pose": (
        GOAL,
        "osc.Reference(p.tolist(), alpha_d=[10.0])",
        "X_WD: expected a pin.SE3 or its matrix (4, 4), got shape (3,)",
        "give pin.SE3(R, p)",
    ),
    "a normal that points into the wall": (
        "0.02 * out, out, radius",
        "0.02 * out, -out, radius",
        "out of the face, is 180 deg away from that of 'wall'",
        "it points out of the body, towards the tool: turn it",
    ),
    "a force that pulls": (
        "alpha_d=[10.0]",
        "alpha_d=[-10.0]",
        "alpha_d of wall is −10 N at t = 0 s; this contact cannot pull",
        "give forces ≥ 0",
    ),
    "references of another period": (
        CONTROLLER,
        CONTROLLER.replace(")", ", dt=1e-2)"),
        "references seem to be spaced 1 ms, and the controller's period is 10 ms",
        "space them by controller.dt",
    ),
    "a circle of 5 Hz": (
        "np.pi, 0.05",
        "10 * np.pi, 0.1",
        "need more than the motors give (desired torques: arm/turn 439.6 of ±150, arm/shoulder",
        "command a smaller or slower motion",
    ),
    "settings as a truth value": (
        CONTROLLER,
        CONTROLLER.replace(")", ", life=True)"),
        "life= takes a PhaseSettings, got True",
        "give osc.PhaseSettings()",
    ),
}


@module_fixture
def program():
    """The program of the page."""
    return re.search(r"^```python\n(.*?)^```", PAGE.read_text(), re.MULTILINE | re.DOTALL)[1]


def end_of(code, monkeypatch):
    """The message with which a program ends, and how many commands its robot got until then."""
    commands = []
    command = osc.MujocoRobot.command
    monkeypatch.setattr(
        osc.MujocoRobot, "command", lambda *given: (commands.append(given), command(*given))
    )
    try:
        exec(compile(code, str(PAGE), "exec"), {"__name__": "__main__"})
    except osc.OscContactError as error:
        return (str(error), len(commands))
    return ("", len(commands))


@parametrize("name", MISTAKES)
def test_a_mistake_is_named_with_its_cure_before_the_first_command(program, name, monkeypatch):
    right, wrong, cause, cure = MISTAKES[name]
    assert program.count(right) == 1
    message, commands = end_of(program.replace(right, wrong), monkeypatch)
    assert cause in message and cure in message, message
    assert commands == 0


def test_the_program_without_a_mistake_runs(program, monkeypatch):
    assert end_of(program, monkeypatch) == ("", 3000)
