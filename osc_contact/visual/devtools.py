"""A headless Chromium driven over pipes (its DevTools protocol): no port, nothing to install."""

from __future__ import annotations

import base64
import json
import os
import select
import subprocess
import tempfile
import time
from typing import Any

from osc_contact.errors import ViewerError
from osc_contact.visual.browser import FLAGS, find_browser, sandbox_flags

__all__ = ["READY", "Browser"]

READY = "typeof player === 'object' && player.ready"
"""True once a page of `write_page` has drawn its first picture."""
FRAMES = "new Promise(d => requestAnimationFrame(() => requestAnimationFrame(() => d(1))))"
ANSWER_S, OPEN_S = 60.0, 120.0


class Browser:
    """One page; `with Browser(address) as page: page.run("1 + 1")`.

    Args:
        address: of the page, such as ``file:///…#t=1``.
        size: of the window, CSS pixels.
        ready: JavaScript that is true once the page can be used.
        density: picture pixels per CSS pixel.

    Raises:
        ViewerError: no browser, or it does not answer.
    """

    def __init__(
        self,
        address: str,
        size: tuple[int, int] = (1280, 860),
        ready: str = READY,
        density: float = 1.0,
    ) -> None:
        self.folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        self.number, self.rest, self.session = 0, b"", None
        self.errors: list[str] = []
        self._launch(size)
        try:
            targets = self.ask("Target.getTargets")["targetInfos"]
            (target,) = [t["targetId"] for t in targets if t["type"] == "page"]
            attached = self.ask("Target.attachToTarget", targetId=target, flatten=True)
            self.session = attached["sessionId"]
            metrics = {"width": size[0], "height": size[1], "mobile": False}
            self.ask("Emulation.setDeviceMetricsOverride", deviceScaleFactor=density, **metrics)
            for domain in ("Page", "Runtime", "Log"):
                self.ask(f"{domain}.enable")
            self.ask("Page.navigate", url=address)
            self.until(f"document.readyState === 'complete' && {ready}", OPEN_S)
        except BaseException:
            self.close()
            raise

    def _launch(self, size: tuple[int, int]) -> None:
        commands, self.commands = os.pipe()
        self.answers, answers = os.pipe()

        def wire() -> None:
            for wanted, given in ((13, commands), (14, answers)):
                os.dup2(given, wanted)
            os.dup2(13, 3)
            os.dup2(14, 4)

        flags = [*FLAGS, *sandbox_flags(), f"--user-data-dir={self.folder.name}",
                 f"--window-size={size[0]},{size[1]}", "--remote-debugging-pipe"]  # fmt: skip
        self.process = subprocess.Popen(
            [find_browser(), *flags, "about:blank"],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            close_fds=False, preexec_fn=wire, start_new_session=True,
        )  # fmt: skip
        os.close(commands)
        os.close(answers)

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the browser and remove its profile."""
        self.process.kill()
        self.process.wait()
        os.close(self.commands)
        os.close(self.answers)
        self.folder.cleanup()

    def ask(self, method: str, timeout: float = ANSWER_S, **params: Any) -> dict[str, Any]:
        """Send a command, wait for its answer; complaints of the page go to `errors`.

        Raises:
            ViewerError: a refusal, no answer in time (s), or the browser has ended.
        """
        self.number += 1
        message: dict[str, Any] = {"id": self.number, "method": method, "params": params}
        if self.session:
            message["sessionId"] = self.session
        try:
            os.write(self.commands, json.dumps(message).encode() + b"\0")
        except BrokenPipeError as error:
            raise ViewerError(f"the browser ended before {method}") from error
        deadline = time.monotonic() + timeout
        while True:
            while b"\0" in self.rest:
                text, self.rest = self.rest.split(b"\0", 1)
                answer = json.loads(text)
                self.errors += complaints(answer)
                if answer.get("id") == self.number:
                    if "error" in answer:
                        raise ViewerError(f"the browser refused {method}: {answer['error']}")
                    return dict(answer["result"])
            left = max(0.0, deadline - time.monotonic())
            if not select.select([self.answers], [], [], left)[0]:
                raise ViewerError(f"no answer of the browser to {method} within {timeout:g} s")
            part = os.read(self.answers, 1 << 16)
            if not part:
                raise ViewerError(f"the browser ended while it was asked for {method}")
            self.rest += part

    def run(self, script: str) -> Any:
        """Value of a JavaScript expression in the page; of a promise, what it resolves to.

        Raises:
            ViewerError: the script threw.
        """
        answer = self.ask(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        if "exceptionDetails" in answer:
            raise ViewerError(f"a script of the page failed: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    def until(self, script: str, timeout: float = 30.0) -> None:
        """Wait until a JavaScript expression is true.

        Raises:
            ViewerError: it is not within `timeout` (s).
        """
        deadline = time.monotonic() + timeout
        while not self.run(script):
            if time.monotonic() >= deadline:
                raise ViewerError(f"the page is not there after {timeout:g} s: {script}")
            time.sleep(0.05)

    def png(self) -> bytes:
        """The page as a PNG, after two more of its frames."""
        self.run(FRAMES)
        return base64.b64decode(self.ask("Page.captureScreenshot", format="png")["data"])


def complaints(answer: dict[str, Any]) -> list[str]:
    """Errors of scripts and of the console in one event."""
    params = answer.get("params", {})
    if answer.get("method") == "Runtime.exceptionThrown":
        return [str(params["exceptionDetails"])]
    if answer.get("method") == "Log.entryAdded" and params["entry"]["level"] == "error":
        return [params["entry"]["text"]]
    return []
