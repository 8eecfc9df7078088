"""The live view: what its browsers get, what is open to whom, and that the loop never waits."""

import asyncio
import json
import logging
import signal
import socket
import time
from dataclasses import replace
from http.client import HTTPConnection

import numpy as np
import pinocchio as pin
import processes
import umsgpack
from complaints import invalid_input, viewer_error
from headless import Browser
from processes import alive, sockets, wait_until
from pytest import approx, fixture, raises
from samples import module_fixture
from scenario_runs import assert_same_run, run_of
from scene_samples import BODIES, CONTENT, RECORDING, links
from tornado.websocket import websocket_connect

import osc_contact as osc

TICKS = [{k: v[i] for k, v in RECORDING.channels.items()} for i in range(len(RECORDING))]
TICK_S = 1e-3


@module_fixture
def lasting():
    """For tests that leave it as it was."""
    with opened() as viewer:
        assert "has not begun" in get(viewer)[1], "the page before the first tick"
        viewer.show(TICKS[0])
        yield viewer


def opened(content=CONTENT, rate=60.0):
    return osc.Viewer(content, rate=rate)


@fixture
def viewer():
    with opened() as viewer:
        yield viewer


def port(viewer):
    return int(viewer.url.rsplit(":", 1)[1].strip("/"))


def get(viewer, path="/", **headers):
    connection = HTTPConnection("127.0.0.1", port(viewer), timeout=20)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    text = answer.read().decode()
    connection.close()
    return (answer.status, text)


def feed(viewer, seconds):
    """Show ticks at about 1 kHz; no call waits for the viewer's process.

    The bound separates a wait, which has no end if that is stopped, from a pause by the operating
    system.
    """
    calls = 0
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        start = time.perf_counter()
        viewer.show(TICKS[calls % len(TICKS)])
        spent = time.perf_counter() - start
        assert spent < 1.0, f"a call took {1e3 * spent:.0f} ms: it waited"
        calls += 1
        time.sleep(TICK_S)


class Client:
    """A browser without a screen: takes messages, reports when it has drawn them."""

    def __init__(self, socket):
        self.socket = socket
        self.matrices = {}
        self.visible = {}

    async def picture(self, timeout=10.0):
        """Everything up to the numbers that end a picture."""
        while True:
            message = await asyncio.wait_for(self.socket.read_message(), timeout)
            assert message is not None, "the server has gone"
            if isinstance(message, str):
                return json.loads(message)
            command = umsgpack.unpackb(message)
            if command["type"] == "set_transform":
                self.matrices[command["path"]] = np.reshape(command["matrix"], (4, 4)).T
            elif command["type"] != "set_object":
                assert command["property"] == "visible"
                self.visible[command["path"]] = command["value"]

    async def ready(self):
        await self.socket.write_message(".")

    async def leave(self):
        self.socket.close()
        while await self.socket.read_message() is not None:
            continue


async def connect(viewer):
    return Client(await websocket_connect(viewer.url.replace("http", "ws") + "frames"))


def expected(tick):
    """Placements that the picture of a tick must have, by Pinocchio alone."""
    arm = {f"/meshcat/arms/left/{name}": X.homogeneous for name, X in links(tick["q"]).items()}
    return arm | {"/meshcat/bodies/rod/base": pin.XYZQUATToSE3(tick["pose"]).homogeneous}


def test_browsers_get_the_newest_tick_and_only_when_they_have_drawn_the_last(lasting):
    lasting.show(TICKS[0])

    async def watch():
        client = await connect(lasting)
        picture = await client.picture()
        for tick in (45, 100):
            newest = TICKS[tick]
            while picture["t"] != newest["t"]:
                await asyncio.sleep(0.02)
                lasting.show(newest)
                await client.ready()
                picture = await client.picture()
            for path, placed in expected(newest).items():
                assert np.allclose(client.matrices[path], placed, atol=1e-5), path
            shaft = client.matrices["/meshcat/contacts/left_end/true/shaft"]
            length = np.linalg.norm(shaft[:3, 1]) - shaft[1, 3]
            assert length == approx(0.01 * newest["alpha_true"][0], abs=1e-5)
            assert client.visible["/meshcat/contacts/left_end/lost"] == (tick == 45)
            assert picture["y"][2:4] == approx(newest["alpha_true"], rel=1e-3)
        for i in range(40):  # it has not reported that it is ready
            lasting.show(TICKS[i])
            await asyncio.sleep(0.02)
        with raises(TimeoutError):
            await client.picture(0.3)
        await client.ready()
        assert (await client.picture())["t"] == TICKS[39]["t"], "what lies between is left out"
        late = await connect(lasting)
        await late.picture()
        assert late.matrices.keys() >= expected(TICKS[0]).keys(), "a late one gets everything"
        await client.leave()
        await late.leave()

    asyncio.run(watch())
    wait_until(lambda: not lasting.count_browsers(), 5.0)


def test_the_page_holds_the_scene_after_the_first_tick(lasting):
    wait_until(lambda: "CONFIG" in get(lasting)[1], 20.0)
    status, text = get(lasting)
    assert status == 200
    assert '"live": true' in text and "new WebSocket" in text
    assert "connect-src data: blob: 'self'" in text


def python(*lines, **how):
    """Run lines of Python in a separate process, beside this file."""
    return processes.python(
        "-c", "\n".join(("import os, sys; import test_live as t", *lines)), **how
    )


def test_the_runs_own_process_opens_no_network_socket():
    done = python(
        "with t.opened() as viewer:",
        "    t.feed(viewer, 0.3)",
        "    print(t.sockets(os.getpid()), len(t.sockets(viewer._process.pid)[1]))",
    )
    assert done.stdout.strip() == "([], []) 1"


def test_only_a_loopback_socket_is_open(lasting):
    opened, listening = sockets(lasting._process.pid)
    assert set(opened) == {"127.0.0.1"}
    assert listening == [("127.0.0.1", port(lasting))]
    others = {info[4][0] for info in socket.getaddrinfo(socket.gethostname(), None)}
    for address in others - {"127.0.0.1", "::1"}:
        with raises(OSError):
            socket.create_connection((address, port(lasting)), timeout=2.0).close()


def test_foreign_names_and_foreign_pages_get_nothing(lasting):
    lasting.show(TICKS[0])
    assert get(lasting, Host="evil.example")[0] == 404
    assert get(lasting, Host=f"localhost:{port(lasting)}")[0] == 200
    long = "/no/such/page" + "x" * 5000
    for path in ("/static/../etc/passwd", "//etc/passwd", "/%2e%2e/%2e%2e/etc/passwd", long):
        assert get(lasting, path)[0] in (400, 404)
    with socket.create_connection(("127.0.0.1", port(lasting))) as raw:
        raw.sendall(b"\0\xff garbage " * 500)
    upgrade = {
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
    }
    assert get(lasting, "/frames", **upgrade, Origin="http://evil.example")[0] == 403
    named = {"Host": "evil.example", "Origin": "http://evil.example"}
    assert get(lasting, "/frames", **upgrade, **named)[0] == 404


def test_a_dead_viewer_is_reported_once_and_never_waited_for(viewer, caplog):
    with caplog.at_level(logging.INFO, "osc_contact.viewer"):
        feed(viewer, 0.5)
        viewer._process.send_signal(signal.SIGKILL)
        feed(viewer, 2.5)
        assert isinstance(viewer.error, osc.ViewerError)
        (record,) = caplog.records
    message = record.getMessage()
    assert "has ended" in message and "the run continues" in message
    viewer.close()
    assert viewer._process.poll() is not None


def test_a_viewer_that_takes_nothing_for_a_while_continues_afterwards(viewer, caplog):
    """On a loaded machine nothing waits for the viewer, and it is not closed."""
    with caplog.at_level(logging.INFO, "osc_contact.viewer"):
        feed(viewer, 0.5)
        viewer._process.send_signal(signal.SIGSTOP)
        feed(viewer, 2.5)
        assert viewer.error is None and viewer.stalled
        (record,) = caplog.records
        assert "has taken nothing for 1 s" in record.getMessage()
        viewer._process.send_signal(signal.SIGCONT)
        wait_until(lambda: viewer.show(TICKS[45]) or not viewer.stalled, 20.0)

        async def newest():
            client = await connect(viewer)
            t = (await client.picture())["t"]
            await client.leave()
            return t

        wait_until(lambda: asyncio.run(newest()) == TICKS[45]["t"], 20.0)
    assert [record.levelname for record in caplog.records] == ["WARNING", "INFO"]


def test_the_page_shows_whether_it_is_live(viewer):
    shown = "document.getElementById('live').textContent"
    feed(viewer, 0.5)
    with Browser(viewer.url) as page:

        def wait_for(word, feeding=True):
            def seen():
                if feeding:
                    viewer.show(TICKS[0])
                return page.run(shown) == word

            wait_until(seen, 30.0)

        wait_for("LIVE")
        wait_for("WAITING", feeding=False)
        wait_for("LIVE")
        page.run("LIVE.socket.close()")
        wait_for("RECONNECTING", feeding=False)
        wait_for("LIVE")
        viewer.close()
        wait_for("ENDED", feeding=False)


def test_a_run_is_the_same_with_a_viewer_that_dies_in_it(caplog):
    scenario = osc.load_scenario("two_contact_rod", ["plant.type=rigid", "plant.step=1 ms"])
    plain = run_of(scenario, duration=0.6)
    with osc.open_viewer(scenario, rate=60.0) as viewer:
        how = {"progress": lambda t: viewer._process.kill() if t > 0.05 else None}
        watched = run_of(scenario, duration=0.6, viewer=viewer, **how)
        assert viewer.error is not None and len(caplog.records) == 1
    assert_same_run(plain, watched)


def test_nothing_that_is_shown_can_raise(viewer, caplog):
    viewer.show(TICKS[0])
    viewer._next_send = 0.0
    viewer.show({"t": 0.0, "q": "no numbers"})
    assert "does not hold numbers" in str(viewer.error) and len(caplog.records) == 1
    viewer.show(TICKS[1])
    assert len(caplog.records) == 1


def test_at_most_so_many_ticks_per_second_are_sent():
    with opened(rate=20.0) as viewer:
        sent = 0
        end = time.monotonic() + 1.0
        while time.monotonic() < end:
            due = viewer._next_send
            viewer.show(TICKS[0])
            sent += viewer._next_send != due
            time.sleep(TICK_S)
        assert 2 <= sent <= 21
    for rate in (0.0, 61.0, float("nan")):
        with invalid_input("1 to 60"):
            osc.Viewer((), rate=rate)


def test_the_server_ends_with_the_program_however_that_ends():
    done = python(
        "viewer = t.opened()", "print(viewer._process.pid, flush=True); os._exit(7)", code=7
    )
    wait_until(lambda: not alive(int(done.stdout)), 10.0)


def test_a_viewer_that_cannot_start_gives_the_reason(monkeypatch, tmp_path):
    (tmp_path / "tornado.py").write_text("raise RuntimeError('no tornado here')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with viewer_error("does not start: .*no tornado"):
        osc.Viewer(CONTENT)


def test_no_part_of_meshcat_that_opens_sockets_is_imported():
    done = python(
        "from osc_contact.lab.visual.page import CommandSink",
        "CommandSink().visualizer()",
        "print([m for m in sys.modules if 'ngrok' in m])",
    )
    assert done.stdout.strip() == "[]"


def test_a_viewer_that_cannot_draw_ends_and_is_reported(caplog):
    broken = replace(CONTENT, bodies=(BODIES[0]._replace(urdf="/no/such/file.urdf"), *BODIES[1:]))
    with opened(broken) as viewer:
        feed(viewer, 1.5)
        message = str(viewer.error)
        assert "has ended (exit code" in message and len(caplog.records) == 1
        assert "/no/such/file.urdf" in message, "the cause is missing"
        viewer.close()
        assert viewer._process.poll() == 1
