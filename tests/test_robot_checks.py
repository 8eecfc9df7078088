"""Every kind of bad URDF is refused with file, line, element and reason, at once and alive."""

import re
from pathlib import Path

from pytest import mark, raises
from urdf_corpus import CORPUS, GOOD, SOUND

from osc_contact import robots
from osc_contact.errors import ModelError


def write(folder, text):
    file = folder / "arm.urdf"
    file.write_bytes(text.encode() if isinstance(text, str) else text)
    return file


def test_the_corpus_is_large_and_every_entry_differs():
    assert len({bad.text for bad in CORPUS.values()}) == len(CORPUS) >= 60


@mark.parametrize("name", CORPUS)
def test_bad_file_is_refused_with_place_and_reason(name, tmp_path):
    bad = CORPUS[name]
    file = write(tmp_path, bad.text)
    with raises(ModelError) as caught:
        robots.load_model(file)
    first = caught.value.findings[0]
    assert re.search(bad.reason, str(first)), str(first)
    assert (first.check, first.file, first.line) == (bad.check, file, bad.line), str(first)
    assert str(caught.value).startswith(f"{file}:{bad.line}:" if bad.line else f"{file}: ")
    assert first.element.startswith(bad.element)


@mark.parametrize("name", SOUND)
def test_sound_variant_is_accepted_and_both_readers_agree(name, tmp_path):
    file = write(tmp_path, SOUND[name](GOOD))
    assert robots.load_model(file).nv == 4
    assert robots.cross_check(file) < 1e-12


def test_every_check_has_a_row_on_the_page_on_robots():
    page = (Path(__file__).parent.parent / "docs" / "robots.md").read_text()
    rows = re.findall(r"^\| ([a-z ]+) \|", page.split("| check |")[1].split("\n\n")[0], re.M)
    assert {bad.check for bad in CORPUS.values()} | {"second reader"} == set(rows)
