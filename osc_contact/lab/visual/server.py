"""The server of a live page: one address on 127.0.0.1, drawing commands over a websocket.

meshcat's own server listens on all interfaces, writes into a pipe that is not read, and answers a
client that waits; nothing of it is used. Here the newest tick comes over a socket from the run's
process, is drawn into meshcat commands, and goes to every browser that has taken the one before.
"""

import contextlib
import json
import os
import pickle
import socket
import sys
from collections.abc import Iterable

from tornado.httpserver import HTTPServer
from tornado.ioloop import IOLoop, PeriodicCallback
from tornado.netutil import bind_sockets
from tornado.web import Application, RequestHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from osc_contact.files import Json
from osc_contact.lab.visual.messages import packed
from osc_contact.lab.visual.page import CommandSink, page_text
from osc_contact.lab.visual.parts import Content, Frames, Samples, changes
from osc_contact.lab.visual.scene import Scene, rounded, samples_at, values

LOOPBACK = "127.0.0.1"
PICTURES_MS = 1000.0 / 60.0
TRAIL_EVERY = 15  # pictures
WINDOW_S = 10.0
MOST_BROWSERS = 16
WAITING = (
    '<!DOCTYPE html><meta charset="utf-8"><meta http-equiv="refresh" content="0.4">'
    "<title>waiting</title><p style='font: 16px sans-serif; margin: 3em'>The run has not begun.</p>"
)


class LivePage:
    """The scene as it is now, and the browsers that show it."""

    def __init__(self, link: socket.socket, content: Content) -> None:
        """Begin without a scene, which is made at the first tick.

        Args:
            link: socket to the process of the run.
            content: bodies and contacts to draw.
        """
        self.link = link
        self.content = content
        self.scene: Scene | None = None
        self.drawn = CommandSink()
        self.trails: dict[str, Json] = {}
        self.browsers: set[BrowserLink] = set()
        self.frame: Frames = {}
        self.numbers = ""
        self.pictures = 0
        self.parent = os.getppid()
        self.error: Exception | None = None

    def text(self) -> str:
        """HTML of the page; before the first tick a page that reloads itself."""
        if self.scene is None:
            return WAITING
        lines = self.scene.lines
        config = self.scene.config(
            live=True, window=WINDOW_S, curves={"t": [], "y": [[] for _ in lines]}
        )
        return page_text(self.drawn, self.content.title, config)

    def update(self) -> None:
        """Draw the newest tick; an error ends the process, and is reported to the run's process.

        tornado would log an exception of a callback and continue: `serve` raises it after the loop.
        """
        try:
            newest = self._newest()
            if newest is not None:
                self._show(newest)
        except Exception as error:
            self.error = error
            self._report({"error": f"{type(error).__name__}: {error}"[:1000]})
            IOLoop.current().stop()

    def _newest(self) -> Samples | None:
        """Read all ticks that have arrived; return the channels of the last one, None without one.

        The loop of the page ends if the process of the run has ended or closed the connection.
        """
        newest = None
        with contextlib.suppress(ConnectionError):
            try:
                while message := self.link.recv(1 << 20):
                    newest = message
            except BlockingIOError:
                if os.getppid() == self.parent:
                    return samples_at(pickle.loads(newest), None) if newest else None
        IOLoop.current().stop()
        return None

    def _show(self, newest: Samples) -> None:
        """Draw a tick and send it to all browsers; the first tick makes the scene.

        Args:
            newest: channels of the newest tick.
        """
        if self.scene is None:
            self.scene = Scene(self.content, newest)
            self.scene.draw(self.drawn.visualizer())
            self.scene.look(self.drawn.visualizer(), newest)
        scene = self.scene
        self.frame = scene.states(newest)
        scene.trails.extend(newest)
        fresh = CommandSink()
        if self.pictures % TRAIL_EVERY == 0:
            scene.trails.draw(fresh.visualizer())
            self.trails |= {command["path"]: command for command in fresh.commands}
        self.pictures += 1
        curves = rounded(values(scene.lines, newest)[:, 0])
        self.numbers = json.dumps({"t": float(newest["t"][0]), "y": curves})
        for browser in list(self.browsers):
            browser.send(fresh.commands)

    def count(self) -> None:
        """Report to the run's process how many browsers there are."""
        self._report({"browsers": len(self.browsers)})

    def _report(self, news: dict[str, int | str]) -> None:
        """Send a message to the run's process, which may have ended or may not read."""
        with contextlib.suppress(OSError):
            self.link.send(json.dumps(news).encode())


class BrowserLink(WebSocketHandler):
    """Connection to a browser, which gets the next picture after it has drawn the last one."""

    def initialize(self) -> None:
        """Prepare a connection; tornado calls this for every request."""
        self.page: LivePage = self.settings["page"]
        self.busy = False
        self.shown: Frames = {}
        self.late: dict[str, Json] = {}

    def open(self, *_: str, **__: str) -> None:
        """Handle a new connection: send the drawing that is not part of the page's text."""
        if len(self.page.browsers) >= MOST_BROWSERS:
            self.close(1013, "too many browsers")
            return
        self.page.browsers.add(self)
        self.page.count()
        self.send(self.page.trails.values())

    def on_message(self, message: str | bytes) -> None:
        """Handle a message of any content, by which the browser confirms the last picture."""
        self.busy = False
        if self.shown is not self.page.frame:
            self.send()

    def on_close(self) -> None:
        """Handle the end of the connection."""
        self.page.browsers.discard(self)
        self.page.count()

    def send(self, trails: Iterable[Json] = ()) -> None:
        """Send the changes that this browser does not show yet, unless it is still drawing.

        Args:
            trails: commands that draw the additions to the trails.
        """
        self.late |= {command["path"]: command for command in trails}
        if self.busy or not self.page.frame:
            return
        sink = CommandSink()
        changes(sink.visualizer(), self.shown, self.page.frame)
        try:
            for command in (*sink.commands, *self.late.values()):
                self.write_message(packed(command), binary=True)
            self.write_message(self.page.numbers)  # last: the browser answers when all is drawn
        except WebSocketClosedError:
            self.page.browsers.discard(self)
            return
        self.shown = self.page.frame
        self.late = {}
        self.busy = True


class Page(RequestHandler):
    """The page itself."""

    def get(self) -> None:
        """The page of the scene, never from a cache."""
        self.set_header("Cache-Control", "no-store")
        self.set_header("X-Frame-Options", "DENY")
        self.finish(self.settings["page"].text())


def serve(link: socket.socket, content: Content) -> None:
    """Serve until the link closes; the address is sent back over it.

    Requests are answered only if they name this machine's own address: a foreign page whose name
    is made to point here gets 404, and its websocket 403.

    Args:
        link: to the process that runs the loop.
        content: bodies and contacts of the page.
    """
    link.setblocking(False)
    page = LivePage(link, content)
    application = Application(
        page=page, websocket_max_message_size=1024, log_function=lambda _: None
    )
    application.add_handlers(r"(127\.0\.0\.1|localhost)", [("/", Page), ("/frames", BrowserLink)])
    sockets = bind_sockets(0, LOOPBACK)
    HTTPServer(application, max_body_size=1024, idle_connection_timeout=30.0).add_sockets(sockets)
    link.send(json.dumps({"url": f"http://{LOOPBACK}:{sockets[0].getsockname()[1]}/"}).encode())
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    PeriodicCallback(page.update, PICTURES_MS).start()
    IOLoop.current().start()
    if page.error is not None:
        raise page.error


if __name__ == "__main__":  # until the inherited socket closes; the scene stands on the input
    serve(socket.socket(fileno=int(sys.argv[1])), pickle.load(sys.stdin.buffer))
