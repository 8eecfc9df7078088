"""A headless Chromium driven over pipes (DevTools protocol): no port, nothing to install."""

from __future__ import annotations

import base64
import io
import json
import os
import select
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from osc_contact.visual.browser import FLAGS, find_browser, sandbox_flags


class Browser:
    """One page; `with Browser(address) as page: page.run("1 + 1")`."""

    def __init__(
        self,
        address: str,
        size: tuple[int, int] = (1280, 860),
        ready: str = "typeof player === 'object' && player.ready",
    ) -> None:
        self.folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
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
        self.number, self.rest, self.session = 0, b"", None
        self.errors: list[str] = []
        targets = self.ask("Target.getTargets")["targetInfos"]
        (target,) = [t["targetId"] for t in targets if t["type"] == "page"]
        self.session = self.ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        metrics = {"width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": False}
        self.ask("Emulation.setDeviceMetricsOverride", **metrics)
        for domain in ("Page", "Runtime", "Log"):
            self.ask(f"{domain}.enable")
        self.ask("Page.navigate", url=address)
        self.until(f"document.readyState === 'complete' && {ready}")

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()
        os.close(self.commands)
        os.close(self.answers)
        self.folder.cleanup()

    def ask(self, method: str, timeout: float = 60.0, **params: Any) -> dict[str, Any]:
        """Send a command, wait for its answer; complaints of the page go to `errors`."""
        self.number += 1
        message: dict[str, Any] = {"id": self.number, "method": method, "params": params}
        if self.session:
            message["sessionId"] = self.session
        os.write(self.commands, json.dumps(message).encode() + b"\0")
        deadline = time.monotonic() + timeout
        while True:
            while b"\0" in self.rest:
                text, self.rest = self.rest.split(b"\0", 1)
                answer = json.loads(text)
                self.errors += complaints(answer)
                if answer.get("id") == self.number:
                    assert "error" not in answer, answer["error"]
                    return answer["result"]
            ready, _, _ = select.select(
                [self.answers], [], [], max(0.0, deadline - time.monotonic())
            )
            assert ready, f"no answer to {method} within {timeout} s"
            part = os.read(self.answers, 1 << 16)
            assert part, "the browser has ended"
            self.rest += part

    def run(self, script: str) -> Any:
        """Value of a JavaScript expression in the page."""
        answer = self.ask("Runtime.evaluate", expression=script, returnByValue=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def until(self, script: str, timeout: float = 30.0) -> None:
        """Wait until a JavaScript expression is true."""
        deadline = time.monotonic() + timeout
        while not self.run(script):
            assert time.monotonic() < deadline, f"still not true after {timeout} s: {script}"
            time.sleep(0.05)

    def picture(self, file: Path | None = None) -> np.ndarray:
        """Pixels (height, width, 3) of the page, after two more of its frames."""
        from PIL import Image

        frames = "new Promise(d => requestAnimationFrame(() => requestAnimationFrame(() => d(1))))"
        self.ask("Runtime.evaluate", expression=frames, awaitPromise=True)
        png = base64.b64decode(self.ask("Page.captureScreenshot", format="png")["data"])
        if file is not None:
            file.write_bytes(png)
        return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)


def complaints(answer: dict[str, Any]) -> list[str]:
    """Errors of scripts and of the console in one event."""
    params = answer.get("params", {})
    if answer.get("method") == "Runtime.exceptionThrown":
        return [str(params["exceptionDetails"])]
    if answer.get("method") == "Log.entryAdded" and params["entry"]["level"] == "error":
        return [params["entry"]["text"]]
    return []


def near(pixels: np.ndarray, colour: str, tolerance: int = 24) -> int:
    """How many pixels have about this colour ``#RRGGBB``."""
    wanted = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
    return int((np.abs(pixels - wanted).max(axis=2) <= tolerance).sum())
