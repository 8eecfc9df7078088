"""Pages that run tasks in a browser, made once for all workers, and a Chromium that plays them."""

import functools
import http.server
import json
import runpy
import threading
from contextlib import contextmanager

from samples import ROOT, made_once

EXTENSION = runpy.run_path(str(ROOT / "docs/_ext/try_it.py"))
TOLD = "typeof measured === 'object' && measured"


def made_pages(tmp_path_factory):
    """Folder with a page for each task of docs/try_it.md."""
    return made_once(tmp_path_factory, "try_pages", EXTENSION["write_pages"])


class Silent(http.server.SimpleHTTPRequestHandler):
    extensions_map = http.server.SimpleHTTPRequestHandler.extensions_map | {
        ".mjs": "text/javascript",
        ".wasm": "application/wasm",
    }

    policy = ""  #: of scripts

    def end_headers(self):
        if self.policy and self.path.endswith(".mjs"):
            self.send_header("Content-Security-Policy", self.policy)
        super().end_headers()

    def log_message(self, *words):
        pass


@contextmanager
def served(folder, policy=""):
    """Address of a folder's static files, whose scripts have this Content-Security-Policy."""
    kind = type("Handler", (Silent,), {"policy": policy})
    handler = functools.partial(kind, directory=folder)
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()


def opened(page, address, **how):
    """Visit a page and stop its task after the first pictures."""
    page.visit(address, ready=f"{TOLD}.pictures > 0", **how)
    page.run("task.postMessage({ kind: 'run', on: false })")


def tell(page, **order):
    page.run(f"task.postMessage({json.dumps(order)})")


def flat(page, ticks, **more):
    """Result of a number of ticks without pictures."""
    order = json.dumps(more | {"kind": "flat", "ticks": ticks})
    page.run(f"delete measured.flat; task.postMessage({order})")
    page.until(f"{TOLD}.flat", 300.0)
    return json.loads(page.run("JSON.stringify(measured.flat)"))


def newest(page):
    """The picture after one more tick."""
    before = page.run("measured.pictures")
    tell(page, kind="step", ticks=1)
    page.until(f"measured.pictures > {before}")
    return json.loads(page.run("JSON.stringify(measured.newest)"))


def set_slider(page, name, value):
    page.run(
        f"(() => {{ const x = document.querySelector('input[name={json.dumps(name)}]'); "
        f"x.value = {value}; x.dispatchEvent(new Event('input')); }})()"
    )
