"""Pages that run tasks in a browser, made once for all workers."""

from samples import made_once

from benchmarks.web_pages import EXTENSION, REPORTED


def made_pages(tmp_path_factory):
    """Folder with a page for each task of docs/try_it.md."""
    return made_once(tmp_path_factory, "try_pages", EXTENSION["write_pages"])


def opened(page, address, **how):
    """Visit a page and stop its task after the first pictures."""
    page.visit(address, ready=f"{REPORTED}.pictures > 0", **how)
    page.run("task.postMessage({ kind: 'run', on: false })")
