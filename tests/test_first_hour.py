"""The newcomer's page: its commands run one after the other in a folder, and say what it says."""

import shlex
import shutil

from command_line import call
from test_docs import FENCE, ROOT

PAGE = ROOT / "docs" / "press_and_slide.md"


def run(line):
    """Output of one command of the page, in the working folder."""
    if line.startswith("cp "):
        _, source, target = shlex.split(line)
        shutil.copy(ROOT / source, target)
        return ""
    assert line.startswith("osc-contact "), f"no way to run {line!r}"
    result = call(line.removeprefix("osc-contact "))
    assert result.exit_code == (2 if "=-1 mm" in line else 0), result.output
    return result.output


def edit(patch, file):
    """Do what a patch of the page says: each line with a minus becomes the next one with a plus."""
    lines = patch.splitlines()
    old = [line[1:] for line in lines if line.startswith("-")]
    new = [line[1:] for line in lines if line.startswith("+")]
    text = file.read_text()
    for before, after in zip(old, new, strict=True):
        assert text.count(before) == 1, f"{before!r} is not in the file"
        text = text.replace(before, after)
    file.write_text(text)


def test_the_page_leads_from_the_packaged_scenario_to_a_tilted_face(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    said = ""
    kinds = []
    for fence in FENCE.finditer(PAGE.read_text()):
        kind = fence[1]
        text = fence[2]
        if kind == "sh":
            said = "".join(run(line) for line in text.splitlines())
        elif kind == "diff":
            edit(text, tmp_path / "my_rod.yaml")
        elif kind == "text" and kinds[-1] != "python":  # tests/test_docs.py runs the program
            assert text.strip() in said
        kinds.append(kind)
    programs = ["sh", "text", "diff", "sh", "text", "sh", "text", "python", "text", *3 * ["sh"]]
    assert kinds == programs
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"my_rod.html", "my_rod"}
    assert (tmp_path / "out" / "my_rod" / "metrics.json").exists()
    assert (tmp_path / "my_task.yaml").exists()
