"""Pages that run tasks in a browser, made once for all workers."""

from shutil import copytree

from samples import made_once

from benchmarks.web_pages import EXTENSION, REPORTED


def made_page(tmp_path_factory, name):
    """Folder with the page of a task of docs/try_it.md."""
    return made_once(
        tmp_path_factory, f"page_{name}", lambda folder: EXTENSION["write_page"](name, folder)
    )


def made_pages(tmp_path_factory):
    """Folder with the pages of all tasks of docs/try_it.md, each in a folder of its name."""

    def gather(folder):
        for name in EXTENSION["TASKS"]:
            copytree(made_page(tmp_path_factory, name), folder / name)

    return made_once(tmp_path_factory, "try_pages", gather)


def opened(page, address, **how):
    """Visit a page and stop its task after the first pictures."""
    page.visit(address, ready=f"{REPORTED}.pictures > 0", **how)
    page.run("task.postMessage({ kind: 'run', on: false })")
