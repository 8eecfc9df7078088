"""The controller without Python: its file, the C library, and a replay that is equal to the bit."""

import ctypes
import re
import signal
from dataclasses import replace
from pathlib import Path
from shutil import copytree

import numpy as np
import pinocchio as pin
from numpy.random import default_rng
from numpy.testing import assert_array_equal
from processes import completed
from pytest import mark
from rigs import STILL, assert_near, largest, panda_arm, refused, rig_of, ticked, vector
from samples import ROOT, made_once, module_fixture, parametrize

import osc_contact as osc
from benchmarks.cases import repeatable
from benchmarks.tick import ALL_CASES
from osc_contact.control.saving import controller_bytes
from osc_contact.control.without_python import ERRORS, write_library
from osc_contact.drivers.franka import TORQUE_STEP
from osc_contact.lab.runs.run import start
from osc_contact.lab.runs.tape import Tape, build
from osc_contact.law.jit import HAS_LIBRARY
from osc_contact.law.reasons import CODES, SENTENCES

pytestmark = mark.skipif(not HAS_LIBRARY, reason="no library of the law is used here")
#: packaged tasks: plain, redundant, two Pandas, bars, motor limits, bodies that move, phases
TASKS = (
    "two_contact_rod",
    "panda_edge",
    "dual_panda_rod",
    "three_arm_plate",
    "limited_rod",
    "moving_face",
    "approach_and_slide",
)


def run(*command, code=0):
    """Output of a command that ends with this code."""
    done = completed(*command, code=code)
    return done.stderr if code else done.stdout


def files(folder):
    return (folder / "controller.osc", folder / "recording.osc")


def sanitized(library, folder, name, *more):
    """A program of the tests, linked to the controller with all accesses checked."""
    flags = ["-std=gnu11", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-w"]
    sources = [library / part for part in ("osc_controller.c", "osc_daqp.c", "law.o")]
    include = ["-I", library, "-I", library / "daqp" / "include"]
    own = Path(__file__).parent / f"{name}.c"
    run("cc", *flags, *include, own, *sources, "-lm", *more, "-o", folder / name)
    return folder / name


@module_fixture
def library(tmp_path_factory):
    """Compiled once for all workers; a copy, as tests have parts of it compiled anew."""

    def make(folder):
        write_library(folder)
        run("make", "-C", folder)

    made = made_once(tmp_path_factory, "library", make)
    return copytree(made, tmp_path_factory.mktemp("library") / "own")


#: readings that ticks repeat; and that grow too old
SLOW, STALE = (
    ["control.safety.frozen_time=5 ms", f"sensors={{wrist: {{rate: {rate} Hz}}}}"]
    for rate in (100, 40)
)


@parametrize(
    "name, changes",
    [*((name, []) for name in TASKS), ("two_contact_rod", SLOW), ("two_contact_rod", STALE)],
)
def test_a_replay_in_c_is_equal_to_the_bit(library, tmp_path, name, changes):
    tape = build(rig_of(name, *changes), tmp_path, ticks=1500)
    printed = run(library / "replay", *files(tmp_path))
    assert (
        printed.startswith(f"{tape.count} of {tape.count} ticks bit-equal") and tape.count == 1500
    )
    assert (" 0 SATURATED" not in printed) == (name == "limited_rod")
    assert (" 0 HELD" not in printed) == (changes is STALE)
    path = files(tmp_path)[1]
    recording = bytearray(path.read_bytes())
    recording[-1] ^= 1  # of the last torque: the replay can fail
    path.write_bytes(recording)
    run(library / "replay", *files(tmp_path), code=1)


STRICT = ("-O2", "-Wall", "-Wextra", "-Werror")


def test_the_page_s_own_program_in_c_prints_what_python_prints(
    library, tmp_path, monkeypatch, capsys
):
    page = (ROOT / "docs" / "without_python.md").read_text().split("## A program of your own")[1]
    code, shown, c_code, commands = re.findall(r"^```\w+\n(.*?)^```$", page, re.M | re.S)[:4]
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "without_python.md", "exec"), {"__name__": "__main__"})
    assert capsys.readouterr().out == shown
    (tmp_path / "rod_in_c").symlink_to(library)
    (tmp_path / "my_loop.c").write_text(c_code)
    compiled, started = commands.splitlines()
    run(*compiled.removeprefix("$ ").split(), *STRICT)
    assert run(started.removeprefix("$ ")) == shown


@module_fixture
def rod(tmp_path_factory):
    """A controller and a recording, as words of a call."""
    folder = tmp_path_factory.mktemp("rod")
    build(rig_of("two_contact_rod"), folder, ticks=300)
    return files(folder)


@parametrize("rate", [1000, 4000])
def test_the_loop_in_real_time_counts_every_tick(library, rod, rate):
    run("make", "-B", "-C", library, f"CFLAGS={' '.join(STRICT)}", "loop.o", "recording.o")
    run("make", "-C", library, "loop")
    lines = run(library / "loop", rate, 0.2, *rod).splitlines()
    assert f"{rate // 5} ticks at {rate} Hz" in next(x for x in lines if "missed" in x)
    for name in ("tick", "latency"):
        line = next(x for x in lines if x.startswith(f"{name}:"))
        figures = [float(word) for word in re.findall(r"([\d.]+) µs", line)]
        assert len(figures) == 4 and figures == sorted(figures) and figures[0] > 0, line
    shown = [re.fullmatch(r"  below +(\d+) µs: (\d+)", x) for x in lines]
    assert sum(int(x[2]) for x in shown if x) == rate // 5
    run(library / "loop", "often", code=2)


@parametrize(
    "name", ["two_contact_rod", "near_singular", "saturated", "three_arms", "contact_phases"]
)
def test_every_way_a_tick_ends_is_replayed(library, tmp_path, name):
    """Also faulty ones, and after a reset."""
    case = ALL_CASES[name]()
    controller = case.controller()
    controller.save(tmp_path / "controller.osc")
    tape = Tape(controller)
    rng = default_rng(6)
    for k in range(400):
        m = case.measurement
        q = m.q + 1e-4 * rng.standard_normal(len(m.q)) * (np.nan if k % 50 > 44 else 1.0)
        wrenches = m.wrenches + rng.standard_normal(m.wrenches.shape)
        number = k - 3 * (k % 50 == 20)  # some come after newer ones
        read = replace(m, q=q, wrenches=wrenches, wrench_valid=k % 7 != 3, sequence=number)
        controller.tick(read, case.reference)
        assert k % 50 != 20 or controller.status is osc.Status.HELD
        if k == 200:
            controller.reset()
    (tmp_path / "recording.osc").write_bytes(tape.content())
    printed = run(library / "replay", *files(tmp_path))
    assert printed.startswith("400 of 400 ticks bit-equal") and " 0 HELD" not in printed
    assert f" 0 {case.status.name}" not in printed


def test_the_library_needs_libc_and_libm_only(library):
    linked = run("ldd", library / "libosc_controller.so").split()
    names = {word.split(".")[0] for word in linked if word.startswith("lib")}
    assert names <= {"libc", "libm"}, linked


def test_the_compiled_law_calls_few_functions_and_none_that_allocates_or_locks(library):
    called = {*run("nm", "-u", library / "law.o").split()[1::2]}
    copies = {"memcpy", "memmove", "memset"}  # which of them, LLVM chooses
    assert called - copies == {"atan2", "floor", "sincos"}


def test_no_tick_allocates(library, tmp_path):
    """Nor does the C around the law, also beyond the motors' limits; and the trap works."""
    tape = build(rig_of("limited_rod"), tmp_path, ticks=1500)
    names = ["malloc", "calloc", "realloc", "aligned_alloc", "free", "osc_tick"]
    wrap = [f"-Wl,--wrap={name}" for name in names]
    parts = [library / f"{name}.o" for name in ("replay", "recording", "osc_controller")]
    parts += [library / "osc_daqp.o", library / "law.o", "-lm"]
    trap = ["cc", "-O1", "-I", library, *wrap, Path(__file__).parent / "trap.c", *parts]
    run("make", "-C", library, "replay.o", "recording.o")
    run(*trap, "-o", tmp_path / "trapped")
    printed = run(tmp_path / "trapped", *files(tmp_path))
    assert printed.startswith(f"{tape.count} of {tape.count}") and " 0 SATURATED" not in printed
    run(*trap, "-DRED", "-o", tmp_path / "red")
    run(tmp_path / "red", *files(tmp_path), code=-signal.SIGABRT)


def test_careless_programs_end_in_error_codes(library, tmp_path):
    (tmp_path / "controller.osc").write_bytes(controller_bytes(start(rig_of("limited_rod"))[1]))
    program = sanitized(library, tmp_path, "hostile", "-lpthread")
    assert run(program, tmp_path / "controller.osc") == "every call ended as it should\n"


class Numbers(ctypes.Structure):
    _fields_ = [("data", ctypes.c_void_p), ("count", ctypes.c_size_t)]

    @classmethod
    def of(cls, x):
        return cls(x.ctypes.data, x.size)


class Measurement(ctypes.Structure):
    _fields_ = [(name, Numbers) for name in ("q", "v", "wrenches", "touched")] + [
        (name, ctypes.c_int32) for name in ("wrench_missing", "repeated", "estimated", "wrench_age")
    ]


class Reference(ctypes.Structure):
    _fields_ = [
        (name, Numbers) for name in ("X_WD", "V_D", "A_D", "alpha_d", "squeeze_d", "active")
    ]


class Command(ctypes.Structure):
    _fields_ = [("torques", ctypes.c_void_p), ("count", ctypes.c_size_t)] + [
        (name, ctypes.c_int32)
        for name in ("status", "reason", "state", "unbraked", "cause", "culprit")
    ]


def tick_in_both(c, handle, controller, m, r):
    """A tick in Python and in C: torques equal to the bit, and what is reported beside them."""
    expected = controller.tick(m, r)
    goal = (r.X_WD.homogeneous, r.V_D, r.A_D, r.alpha_d, [r.squeeze_d])
    goal = [np.array(x, dtype=float) for x in goal]
    tau = np.zeros(len(expected))
    measured = Measurement(*map(Numbers.of, (m.q, m.v, m.wrenches)))
    desired = Reference(*map(Numbers.of, goal))
    out = Command(tau.ctypes.data, len(expected))
    assert c.osc_tick(handle, *map(ctypes.byref, (measured, desired, out))) == 0
    assert_array_equal(tau, expected)
    assert (out.status, out.state) == (controller.status, controller.state)
    return out


def created(library, folder, controller):
    """The library, and a controller in it that was made of the file of this one."""
    controller.save(folder / "controller.osc")
    c = ctypes.CDLL(str(library / "libosc_controller.so"))
    handle = ctypes.c_void_p()
    assert c.osc_create(str(folder / "controller.osc").encode(), ctypes.byref(handle)) == 0
    return (c, handle)


def test_the_header_gives_the_unit_and_the_meaning_of_each_gain(library):
    text = (library / "osc_controller.h").read_text()
    assert " *   force.damping: N s/m; gain K_v of the normal velocity" in text
    comments = re.findall(r"/\*.*?\*/", text, re.DOTALL)
    assert [c for c in comments if re.search(r"\n(?! *\*)", c)] == [], "each line has its asterisk"


@parametrize("name, integral", {"two_contact_rod": 30.0, "limited_rod": 0.0})
def test_a_saved_controller_continues_and_takes_gains_tare_and_reset(
    library, tmp_path, name, integral
):
    rig = rig_of(name)
    plant, controller = start(rig)
    m = plant.measure()
    for k in range(20):
        controller.tick(m, rig.references.at(1e-3 * k))
    c, handle = created(library, tmp_path, controller)
    rng = default_rng(8)
    seen = set()
    for k in range(20, 130):
        if k == 50:
            gains = controller.gains
            motion = osc.MotionGains(stiffness=300.0, damping=40.0, integral=integral)
            forces = gains.force.replaced(integral=gains.force.integral / 2)
            controller = controller.with_gains(gains.replaced(motion=motion, force=forces))
            values = {
                "motion.stiffness": 300.0,
                "motion.damping": 40.0,
                "motion.integral": integral,
                "force.integral": forces.integral,
            }
            for key, value in values.items():
                assert c.osc_set_gain(handle, key.encode(), ctypes.c_double(value)) == 0
        if k == 70:
            tare = rng.standard_normal(6)
            controller.f_tare = tare
            assert c.osc_set_tare(handle, tare.ctypes.data_as(ctypes.c_void_p)) == 0
        if k == 90:
            controller.reset()
            assert c.osc_reset(handle) == 0
        noise = 1e-4 * rng.standard_normal(len(m.q)) * (np.nan if k > 120 else 1.0)
        tick_in_both(c, handle, controller, replace(m, q=m.q + noise), rig.references.at(1e-3 * k))
        seen.add(controller.status)
    assert osc.Status.HELD in seen and len(seen) > 1
    c.osc_destroy(handle)


@parametrize(
    "ceilings, cause",
    [
        ({}, "CONTACT_ABOVE_CEILING"),
        ({"contact_ceiling": np.inf}, "WRIST_ABOVE_CEILING"),
        ({"contact_ceiling": np.inf, "wrist_ceiling": np.inf}, "NO_REASON"),
    ],
)
def test_ceilings_stop_in_c_as_in_python(library, tmp_path, ceilings, cause):
    """If a program's commands are unknown, ceilings rise with the largest one in C, too."""
    rig = rig_of("two_contact_rod", "control.life=off")
    limits = osc.SafetySettings(overforce_time=np.inf, contact_power=np.inf, **ceilings)
    controller = repeatable(rig.controller().with_safety(limits))
    c, handle = created(library, tmp_path, controller)
    m, reference = rig.plant().measure(), rig.references.at(0.0)
    along = np.zeros((2, 6))
    along[0, :3] = (400.0, 300.0, 400.0)
    stopped = 0
    for k in range(60):
        seen = m if k < 20 else replace(m, wrenches=m.wrenches + along)
        out = tick_in_both(c, handle, controller, seen, reference)
        stopped = stopped or k * (out.state == osc.SafetyState.SAFE_STOP)
    assert out.cause == CODES[cause]
    assert (39 <= stopped <= 42) if cause != "NO_REASON" else stopped == 0
    assert out.culprit == (controller.records.memory.culprit if stopped else -1)
    c.osc_destroy(handle)


def code_of(name):
    """Error code of the C library."""
    return -list(ERRORS).index(name)


def numbers_of(c, handle, name, *counted, size, kind=ctypes.c_double):
    """Numbers that a getter of the C library returns."""
    out = (kind * size)()
    assert getattr(c, name)(handle, out, *counted) == 0
    return np.array(out)


def assert_reported_alike(c, handle, controller):
    """Measured forces, phases, integrals and learned friction, in Python and in C."""
    columns = controller.records.memory.columns
    r, contacts, joints = len(columns), len(controller.contacts), controller.chain.nq
    size = ctypes.c_size_t
    got = numbers_of(c, handle, "osc_get_forces", size(r), size=r)
    assert_array_equal(got, columns.alpha)
    phases = numbers_of(
        c, handle, "osc_get_phases", size(contacts), size=contacts, kind=ctypes.c_int32
    )
    assert_array_equal(phases, controller.phases())
    got = numbers_of(c, handle, "osc_get_motion_integral", size=6)
    assert_array_equal(got, controller.motion_integral)
    count = size()
    got = numbers_of(c, handle, "osc_get_force_integral", ctypes.byref(count), size=6)
    assert_array_equal(got[: count.value], controller.force_integral)
    got = numbers_of(c, handle, "osc_get_friction", size(2 * joints), size=2 * joints)
    assert_array_equal(got.reshape(-1, 2), controller.joint_friction)


@parametrize("changes", [["control.life={}"], ["control.life=off", "arms.left.friction=0.3"]])
def test_c_programs_engage_approach_and_read_what_python_reports(library, tmp_path, changes):
    rig = rig_of("two_contact_rod", "tare={standoff: 1.5 mm}", *changes)
    plant, controller = start(rig)
    phased = controller.life is not None
    c, handle = created(library, tmp_path, rig.controller())
    assert c.osc_engage(handle) == code_of("NO_TICK")
    c.osc_destroy(handle)
    reference = rig.references.at(0.0)
    for _ in range(5):
        plant.command(controller.tick(plant.measure(), reference), controller.dt)
    c, handle = created(library, tmp_path, controller)
    speed = ctypes.c_double()
    seen = set()
    for k in range(400):
        if k == 20:
            controller.engage()
            assert c.osc_engage(handle) == 0 == c.osc_engage(handle)
        if k == 60 and phased:
            assert c.osc_set_phase_setting(handle, b"speed", ctypes.c_double(0.02)) == 0
            assert c.osc_get_phase_setting(handle, b"speed", ctypes.byref(speed)) == 0
            assert speed.value == 0.02
            life = controller.life.replaced(speed=0.02)
            state = controller.__getstate__()
            settings = replace(controller.settings, life=life)
            parts = (settings, *state["parts"][1:])
            controller.__setstate__(state | {"parts": parts})
        m = plant.measure()
        tick_in_both(c, handle, controller, m, reference)
        assert_reported_alike(c, handle, controller)
        seen |= set(controller.phases().tolist())
        plant.command(controller.last_torques(), controller.dt)
    assert controller.result().alpha_meas.any() and seen == ({0, 1, 2} if phased else {0, 2})
    code = c.osc_set_phase_setting(handle, b"speed", ctypes.c_double(1e-3))
    why = "OUT_OF_RANGE" if phased else "NO_PHASES"  # it would push less than counts as contact
    assert code == code_of(why)
    c.osc_destroy(handle)


def test_every_reason_has_a_sentence(library):
    c = ctypes.CDLL(str(library / "libosc_controller.so"))
    c.osc_reason_text.restype = ctypes.c_char_p
    texts = {code: c.osc_reason_text(code).decode() for code in SENTENCES}
    assert not texts.pop(0) and all(len(text) > 20 for text in texts.values())
    assert (
        "stayed above its speed limit of <speed> rad/s or m/s for <overspeed_time> s" in texts[50]
    )
    assert not any("{" in text for text in texts.values())
    assert c.osc_reason_text(999) == b"unknown"


@parametrize("fault", ["joint", "wrist", "packet"])
def test_the_tick_of_a_stop_gives_its_cause_and_the_joint_that_needs_its_brake(
    library, tmp_path, fault
):
    """The tick is held: its torques are not those of the law."""
    rig = rig_of("two_contact_rod")
    plant, controller = start(rig)
    m, r = plant.measure(), rig.references.at(0.0)
    for _ in range(2):
        controller.tick(m, r)
    memory = controller.records.memory
    if fault == "wrist":
        memory.arms.same[1] = 1.0  # s for which it reads the very same
    else:
        memory.joints.gained[3] = 1e3  # though this joint was to move
        memory.still = 1.0 * (fault == "packet")
    c, handle = created(library, tmp_path, controller)
    first, later = (tick_in_both(c, handle, controller, m, r) for _ in range(2))
    assert (first.status, first.state) == (osc.Status.HELD, osc.SafetyState.SAFE_STOP)
    assert later.reason == CODES["STOPPED"]
    for out in (first, later):
        assert out.cause == CODES["WRIST_FROZEN" if fault == "wrist" else "STUCK"]
        assert out.culprit == (1 if fault == "wrist" else 3)
        assert (out.unbraked >= 0) == (fault == "packet")
    controller.reset()
    assert c.osc_reset(handle) == 0
    running = tick_in_both(c, handle, controller, m, r)
    assert (running.cause, running.culprit, running.unbraked) == (CODES["NO_REASON"], -1, -1)
    c.osc_destroy(handle)


def test_what_only_python_can_evaluate_is_refused():
    controller = start(rig_of("two_contact_rod"))[1]
    own = controller.with_laws(force=lambda alpha_d, alpha_meas: alpha_d)
    with refused("only Python can evaluate"):
        controller_bytes(own)


#: where a Franka starts in the tests
READY = vector(0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785)


def panda(weight):
    """A chain of one Panda, whose sensor is its tip, and a controller without contacts."""
    arm = panda_arm(
        wrist_sensor="panda_hand_tcp",
        locked={"panda_finger_joint1": 0.0, "panda_finger_joint2": 0.0},
        friction_factor=0.0,
    )
    chain = osc.ClosedChain([arm])
    if not weight:
        chain.model.gravity.linear = np.zeros(3)
    return (chain, osc.Controller(chain, [], dt=1e-3, posture=READY))


def link_cpp(library, program, *sources):
    stubs = Path(__file__).parent / "stubs"
    run("make", "-C", library)
    parts = [library / name for name in ("osc_controller.o", "osc_daqp.o", "law.o")]
    flags = ["-std=c++17", *STRICT, "-I", library, "-I", stubs]
    run("c++", *flags, *sources, *parts, "-lm", "-o", program)
    return program


def test_the_franka_loop_sends_what_the_driver_would(library, tmp_path):
    program = link_cpp(library, tmp_path / "franka_loop", library / "franka_loop.cpp")
    chain, heavy = panda(weight=True)
    panda(weight=False)[1].save(tmp_path / "light.osc")
    heavy.save(tmp_path / "heavy.osc")
    rng = default_rng(4)
    data = chain.model.createData()
    start = chain.state(READY).X_WO
    states, expected, last = [], [], np.zeros(7)
    for k in range(101):
        drift = 2e-3 * np.sin(0.05 * k) * np.ones(7)
        q, v = READY + drift, 0.1 * np.cos(0.05 * k) * np.ones(7)
        f = np.zeros(6) if k == 0 else 0.2 * rng.standard_normal(6)
        X = chain.state(q, v).X_WO.homogeneous
        states.append(np.concatenate([q, v, X.ravel(order="F"), f]))
        t, w, up = 1e-3 * k, 1.5708, vector(0, 0, 0.01)
        p = start.translation + (1 - np.cos(w * t)) * up
        rates = (w * np.sin(w * t) * up, w**2 * np.cos(w * t) * up)
        reference = osc.pose_reference(p, start.rotation, *rates)
        tau = ticked(heavy, osc.Measurement(q, v, f[None]), reference)
        step = tau - pin.computeGeneralizedGravity(chain.model, data, q) - last
        last = last + step * min(1.0, TORQUE_STEP / largest(step))
        expected.append(last)
    (tmp_path / "robot").write_bytes(np.array(states).tobytes())
    assert run(program, tmp_path / "robot", tmp_path / "light.osc", 0.1) == "0.100 s, done\n"
    sent = np.frombuffer((tmp_path / "robot.torques").read_bytes()).reshape(-1, 8)
    assert_array_equal(np.flatnonzero(sent[:, 7]), [100])
    assert_near(sent[:, :7], expected, atol=1e-9)
    assert largest(sent[:, :7]) > TORQUE_STEP
    refused_with = run(program, tmp_path / "robot", tmp_path / "heavy.osc", 0.1, code=1)
    assert "compensates weight" in refused_with


@module_fixture
def manager(library, tmp_path_factory):
    """The program that runs the plugin."""
    sources = (library / "ros2_controller.cpp", Path(__file__).parent / "ros2_manager.cpp")
    return link_cpp(library, tmp_path_factory.mktemp("ros2") / "manager", *sources)


@parametrize("name", ["panda_edge", "dual_panda_rod"])
def test_the_ros2_plugin_sends_what_the_controller_computes(manager, tmp_path, name):
    rig = rig_of(name)
    plant, controller = start(rig)
    controller.reset()  # as on_activate does
    controller.save(tmp_path / "controller.osc")
    m, reference = plant.measure(), rig.references.at(0.0)
    reference = replace(reference, V_D=STILL, A_D=STILL)
    alpha = np.ravel(reference.alpha_d).astype(float)
    bars = controller.records.model.n_bars
    squeeze = np.full(bars, reference.squeeze_d, dtype=float)
    arms, joints = len(m.wrenches), len(m.q)
    rng = default_rng(5)
    rows, expected, seen = [], [], set()
    for k in range(60):
        q = m.q + 1e-4 * rng.standard_normal(joints)
        q[1] = np.nan if k == 40 else q[1]
        given = replace(m, q=q, v=m.v + 1e-3 * rng.standard_normal(joints))
        rows.append(np.concatenate([q, given.v, m.wrenches.ravel()]))
        expected.append(controller.tick(given, reference))
        seen.add(controller.status)
    assert seen == {osc.Status.OK, osc.Status.HELD}
    content = np.concatenate([reference.X_WD.homogeneous.ravel(), alpha, squeeze, *rows]).tobytes()
    call = [
        manager,
        tmp_path / "controller.osc",
        round(1 / controller.dt),
        arms,
        joints // arms,
        len(alpha),
        bars,
    ]
    done = completed(*call, input=content, text=False)
    torques = np.frombuffer(done.stdout).reshape(-1, len(expected[0]))
    assert_array_equal(torques[:-1], expected)
    assert not torques[-1].any()  # deactivated
    names = done.stderr.decode().split()
    assert names[0] == "arm0_0/effort" and names[joints : joints + 1] == ["arm0_0/position"]
    assert names[-1] == f"wrist{arms - 1}/torque.z" and len(names) == 3 * joints + 6 * arms
    call[2] = 10
    assert b"update rate" in completed(*call, code=1, input=content, text=False).stderr
