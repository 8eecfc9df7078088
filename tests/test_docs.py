"""README and docs: programs run and print what is shown, commands parse, keys and links exist."""

import re
import runpy
import shlex
from itertools import pairwise
from pathlib import Path

import typer
import yaml
from pytest import fixture, mark, param
from scenario_runs import rig_of, run_of
from test_paper_map import complaint

import osc_contact as osc
from osc_contact.cli import app
from osc_contact.contacts.pairs import PAIRS
from osc_contact.runs import rig as plants
from osc_contact.scenarios import Scenario
from osc_contact.scenarios.bodies import CONTACT_TYPES

ROOT = Path(__file__).resolve().parent.parent
PAGES = [
    *(ROOT / f"{name}.md" for name in ("README", "CONTRIBUTING", "SECURITY", "CODE_OF_CONDUCT")),
    *sorted((ROOT / "docs").glob("*.md")),
]
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
TICKED = re.compile(r"`([^`\n]+)`")
SHORT = ["control.rate=250 Hz"]  # few ticks: only the keys matter


def text_of(page):
    """Of a page, or of one in docs/ by its name."""
    return (ROOT / "docs" / page).read_text()


def blocks(language):
    """(page, code, text) of every block; text: the ```text block that follows, if one does."""
    found = []
    for page in PAGES:
        fences = list(FENCE.finditer(text_of(page)))
        for i, fence in enumerate(fences):
            if fence[1] != language:
                continue
            after = fences[i + 1] if i + 1 < len(fences) else None
            between = text_of(page)[fence.end() : after.start()] if after else "no"
            shown = after[2] if after and after[1] == "text" and not between.strip() else None
            name = f"{page.relative_to(ROOT)}-{i}"
            found.append(param(page, fence[2], shown, id=name))
    return found


def table_rows(page, heading):
    """Cells of the tables below a heading, without their first two lines."""
    section = text_of(page).split(f"\n## {heading}\n")[1].split("\n## ")[0]
    lines = [line for line in section.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def programs():
    """All but those that need mjlab, which `make peers` runs."""
    return [b for b in blocks("python") if "osc_contact.learn" not in b.values[1]]


@mark.parametrize("page, code, shown", programs())
def test_program_runs_and_prints_what_is_shown(page, code, shown, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for register in (plants.PLANTS, plants.PLANT_TYPES):  # a page enters a plant: taken out again
        monkeypatch.setitem(register, "halved", None)
    exec(compile(code, str(page), "exec"), {"__name__": "__main__"})
    if shown is not None:
        assert capsys.readouterr().out == shown


def command_lines():
    """Every osc-contact command in code blocks and between backticks."""
    found = []
    for page in PAGES:
        text = text_of(page)
        found += TICKED.findall(FENCE.sub("", text))
        found += [line for fence in FENCE.finditer(text) for line in fence[2].splitlines()]
        found += re.findall(r"^ {4}(.*)$", text, re.MULTILINE)
    return sorted({line for line in found if line.startswith("osc-contact ")})


@mark.parametrize("line", command_lines())
def test_command_exists_and_parses(line):
    group = typer.main.get_command(app)
    _, name, *arguments = shlex.split(line, comments=True)
    assert name in group.commands, f"{name} is no command of osc-contact"
    group.commands[name].make_context(name, list(arguments))  # raises on unknown options
    made_there = "my_rod.yaml"  # tests/test_first_hour.py runs these
    if name in ("run", "inspect") and arguments[0] not in ("SCENARIO", made_there):
        changes = [value for option, value in pairwise(arguments) if option == "--set"]
        osc.load_scenario(arguments[0], changes)


@mark.parametrize("page, code, shown", blocks("yaml"))
def test_yaml_is_a_piece_of_a_scenario(page, code, shown):
    scenario = osc.load_scenario("two_contact_rod").as_dict()
    names = {contact["name"] for contact in scenario["contacts"]}
    for key, value in yaml.safe_load(code).items():
        if key == "contacts":  # those not shown stay
            shown_names = {contact["name"] for contact in value}
            assert shown_names <= names
            value = [*value, *(c for c in scenario[key] if c["name"] not in shown_names)]
        scenario[key] = value
    Scenario.model_validate(scenario)


@mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_and_pictures_exist(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", text_of(page)):
        if not target.startswith("https://"):
            file = page.parent / target.partition("#")[0]
            assert file.is_file(), f"{page.name} points at {target}, which is not there"


def program(name):
    return runpy.run_path(f"{ROOT}/docs/{name}")


def test_the_picture_of_the_rooms_is_that_of_the_imports():
    """After a change of the imports: python docs/draw_rooms.py."""
    script = program("draw_rooms.py")
    assert script["PICTURE"].read_text() == script["drawing"]()


def test_pictures_are_small_and_all_shown():
    shown = {
        (page.parent / target).resolve()
        for page in PAGES
        for target in re.findall(r"!\[[^\]]*\]\(([^)\s]+)\)", text_of(page))
    }
    assert shown == {p.resolve() for p in (ROOT / "docs" / "images").rglob("*.*")}
    for picture in shown:
        card = picture.parent.name == "gallery"
        most = (1_500_000 if card else 3_000_000) if picture.suffix == ".gif" else 300_000
        assert picture.stat().st_size <= most, picture


@mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_files_named_in_backticks_exist(page):
    for name in TICKED.findall(FENCE.sub("", text_of(page))):
        if re.fullmatch(r"(osc_contact|urdf|docs|tests|notebooks|paper|benchmarks)/[\w./]*", name):
            assert (ROOT / name).exists(), f"{page.name} names {name}, which is not there"
        if re.fullmatch(r"(osc_contact|urdf|paper|benchmarks)/[\w./]+::[\w.]+", name):
            assert not complaint(name, test=False), f"{page.name}: {complaint(name, test=False)}"


def test_every_section_of_the_theory_says_where_it_is_computed():
    for section in text_of("theory.md").split("\n## ")[1:]:
        assert re.search(r"^In code: `osc_contact/\S+::\S+`", section, re.M), section.split("\n")[0]


# Tables of keys ------------------------------------------------------------------------------


def test_tables_of_keys_are_those_of_the_declarations():
    """After a change of a setting: python docs/_ext/scenario_keys.py."""
    page = text_of("scenario.md")
    assert program("_ext/scenario_keys.py")["updated"](page) == page
    keys = {row[0].strip("`") for row in table_rows("scenario.md", "Control and plant")}
    assert {"gains.motion.frequency", "control.safety.wrist_error", "plant.solref"} <= keys


def test_every_pair_has_a_row_with_its_r_and_its_keys():
    rows = {TICKED.findall(row[0])[0]: row for row in table_rows("contacts.md", "Pairs")}
    assert set(rows) == set(PAIRS)
    told = {}
    for name, row in rows.items():
        if TICKED.search(row[-1]):
            kind = re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower()
            told[kind] = (int(row[1]), set(TICKED.findall(row[-1])))
    assert told == {
        kind: (spec.forces, set(spec.model_fields) - {"name", "type", "body"})
        for kind, spec in CONTACT_TYPES.items()
    }


@fixture(scope="module")
def recording():
    return run_of("two_contact_rod", *SHORT, duration=1.1)


def leaves(data, prefix, contacts):
    if not isinstance(data, dict):
        return {prefix[1:]}
    found = set()
    for key, value in data.items():
        found |= leaves(value, f"{prefix}.{'NAME' if key in contacts else key}", contacts)
    return found


def test_every_metric_is_documented(recording):
    names = recording.meta["contact_names"]
    rows = table_rows("metrics.md", "metrics.json")
    assert {name for row in rows for name in TICKED.findall(row[0])} == leaves(
        osc.metrics(recording), "", names
    )


def test_every_channel_is_documented_with_its_shape(recording):
    sizes = {"T": len(recording), "n": 10, "n_a": 8, "r": 2, "c": 2}
    told = {}
    for row in table_rows("metrics.md", "The recording"):
        shape = tuple(int(sizes.get(part, part)) for part in re.findall(r"\w+", row[1]))
        told |= {name: shape for name in TICKED.findall(row[0])}
    assert told == {name: array.shape for name, array in recording.channels.items()}


def test_every_entry_of_the_meta_is_named(recording):
    told = text_of("metrics.md").split("`Recording.meta` holds")[1].split("```")[0]
    assert set(TICKED.findall(told)) == set(recording.meta)


# Gallery and glossary --------------------------------------------------------------------------


def test_every_packaged_scenario_has_a_card_and_studies_follow():
    """Made by `make gallery`: a picture, the command and the verdict of its run."""
    cards = text_of("gallery.md").split("\n## ")[1:]
    scenarios = list(osc.list_scenarios())
    studies = ["fig2", "fig3", "kinematic_stability"]  # others are scenarios or figures of pages
    names = [card.split("\n")[0] for card in cards]
    assert names[: len(scenarios)] == scenarios
    assert names[len(scenarios) :] == studies
    for card in cards:
        name = card.split("\n")[0]
        verb, kind = ("run", "gif") if name in scenarios else ("reproduce", "png")
        assert f"](images/gallery/{name}.{kind})" in card and f"osc-contact {verb} {name}" in card
        assert re.search(r"^\*\*[A-Z ]+\*\*; ", card, re.MULTILINE), "a verdict"


def test_names_in_the_glossary_exist():
    rig = rig_of("two_contact_rod", *SHORT)
    state = rig.state()
    owners = {"state": state, "arm": state.arms[0], "contact": rig.contact(), "chain": rig.chain}
    owners["osc"] = osc
    named = 0
    for line in text_of("glossary.md").splitlines():
        cells = line.split("|")
        for owner, name in re.findall(r"`(\w+)\.(\w+)`", cells[2] if len(cells) > 3 else ""):
            assert hasattr(owners[owner], name), f"{owner}.{name}"
            named += 1
    assert named >= 15


def test_each_of_the_thirty_bad_inputs_has_a_test():
    rows = table_rows("reliability.md", "Thirty bad inputs")
    assert [row[0] for row in rows] == [str(i) for i in range(1, 31)]
    for row in rows:
        (cited,) = TICKED.findall(row[-1])
        file, name = cited.split("::")
        assert re.search(rf"^def {name}\(", text_of(ROOT / file), re.MULTILINE), cited


def test_the_readme_is_short_and_shows_a_picture_and_a_program_with_its_output_first():
    text = text_of(ROOT / "README.md")
    assert len(text.split()) <= 900
    (program,) = [b.values for b in blocks("python") if b.values[0].name == "README.md"]
    assert program[2] and 10 <= len([x for x in program[1].splitlines() if x.strip()]) <= 15
    start = text.index("```python")
    assert "|---" not in text[:start] and ".gif" in text[:start], "a moving picture comes first"
