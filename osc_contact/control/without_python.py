"""The C library that runs controllers out of files without Python.

The header and the offsets of the C sources are written from the records and settings as they are
declared; `osc_controller.c` contains no offset.
"""

import json
import tarfile
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any

from osc_contact.control.controller import FORGOTTEN, FORGOTTEN_TABLES
from osc_contact.control.records import GAIN_FIELDS
from osc_contact.control.saving import FORMAT, HEAD, MAGIC
from osc_contact.control.status import SafetyState, Status
from osc_contact.files import write_whole
from osc_contact.law import records, tick
from osc_contact.law.c_object import object_file
from osc_contact.law.library import law_hash
from osc_contact.law.limits import PROGRAM
from osc_contact.law.reasons import CODES
from osc_contact.law.records import COUNTED
from osc_contact.scenarios.control_schema import Gains
from osc_contact.scenarios.quantities import meaning

#: enum osc_error, by its codes 0, −1, …
ERRORS = {
    "DONE": "no error",
    "NULL": "a pointer is null",
    "WRONG_SIZE": "a count is not that of osc_get_dimensions",
    "UNALIGNED": "numbers do not begin at a multiple of 8 bytes",
    "NO_FILE": "the file cannot be read",
    "NOT_A_CONTROLLER": "the file is no controller",
    "OTHER_FORMAT": "the file has another format",
    "OTHER_LAW": "the file was written with other sources of the law than law.o was made of",
    "DAMAGED": "the file is damaged: its checksum does not fit",
    "NO_MEMORY": "no memory left",
    "OUT_OF_RANGE": "a number is not finite, or negative",
    "UNKNOWN_NAME": "no gain has this name",
}
_RECORDS = {
    "JOB": records.JOB,
    "MODEL": records.MODEL,
    "MEMORY": records.MEMORY,
    "WORK": records.WORK,
    "INPUT": records.INPUT,
    "PROGRAM": PROGRAM,
}


# --- The C library --------------------------------------------------------------------------------


def write_library(folder: Path) -> None:
    """Write law.o, the C sources around it, daqp's, and what builds them.

    Args:
        folder: is made.
    """
    folder.mkdir(parents=True, exist_ok=True)
    contents: dict[str, str | bytes] = {"osc_layout.h": _layout(), "law.o": object_file()}
    for item in (files("osc_contact.control") / "c_files").iterdir():
        if item.name.endswith(".tar.xz"):
            with item.open("rb") as stream, tarfile.open(fileobj=stream) as archive:
                archive.extractall(folder, filter="data")
        elif item.name.endswith(".in"):
            contents[item.name.removesuffix(".in")] = _header(item.read_text("utf-8"))
        else:
            contents[item.name] = item.read_bytes()
    for name, content in contents.items():
        write_whole(content, folder / name)


def _enum(prefix: str, names: Any) -> str:
    return ",\n".join(f"    {prefix}{name} = {value}" for name, value in names)


def _header(text: str) -> str:
    """osc_controller.h from its frame."""
    values = {
        "VERSION": version("osc-contact"),
        "FILE_VERSION": str(FORMAT),
        "LAW": law_hash(),
        "ERRORS": ",\n".join(
            f"    OSC_{name} = {-code} /* {words} */"
            for code, (name, words) in enumerate(ERRORS.items())
        ),
        "STATUSES": _enum("OSC_STATUS_", Status.__members__.items()),
        "STATES": _enum("OSC_STATE_", SafetyState.__members__.items()),
        "REASONS": _enum("OSC_REASON_", CODES.items()),
        "GAINS": "\n".join(f" *   {name}: {words}" for name, _, _, words in _gains()),
    }
    for name, value in values.items():
        text = text.replace(f"@{name}@", value)
    return text


def _gains() -> list[tuple[str, int, int, str]]:
    """Gains that may change while a controller runs: name, offset in MODEL and in rows of
    MEMORY's contacts (−1: none), unit and meaning."""
    found = []
    for name, (field, of_contact) in GAIN_FIELDS.items():
        loop, key = name.split(".")
        kind = type(getattr(Gains(), loop))
        unit = " ".join(x for x in kind.model_fields[key].metadata if isinstance(x, str))
        offset = records.MODEL.dtype.fields[field][1]
        contact: Any = records.CONTACT_MEMORY.fields
        at = contact[of_contact][1] if of_contact else -1
        found.append((name, int(offset), int(at), f"{unit}; {meaning(kind, key)}"))
    return found


def _layout() -> str:
    """osc_layout.h: offsets of fields, slots of tables."""
    lines = ["/* Written with osc_controller.h: where fields and tables of the records are. */"]
    for name, kind in _RECORDS.items():
        fields: Any = kind.dtype.fields
        lines += [f"#define {name}_{field} {at}" for field, (_, at, *_) in fields.items()]
        lines += [f"#define {name}_{table} {kind.start(table)}" for table in kind.tables]
    words = len(records.MEMORY.tables) + len(records.MEMORY.counts)
    numbers = {
        "LOOK": tick.LOOK,
        "HAND_OVER": tick.HAND_OVER,
        "MOVING": tick.MOVING,
        "COMMANDED": tick.COMMANDED,
        "MEMORY_LAYOUT_WORDS": words,
        "CONTACT_BYTES": records.CONTACT_MEMORY.itemsize,
        "OSC_FILE_HEAD": HEAD,
    }
    lines += [f"#define {name} {value}" for name, value in numbers.items()]
    lines += [f'#define OSC_FILE_MAGIC "{MAGIC.decode()}"']
    lines += ["static const char *const ERROR_TEXTS[] = {"]
    lines += [f"    {json.dumps(text)}," for text in ERRORS.values()] + ["};"]
    lines += ["struct gain { const char *name; size_t offset; int of_contact; };"]
    lines += ["static const struct gain GAINS[] = {"]
    lines += [f'    {{"{name}", {at}, {of}}},' for name, at, of, _ in _gains()] + ["};"]
    lines += _structure()
    lines += ["/* What osc_reset sets to zero: of MEMORY (slot −1), and of rows of its tables. */"]
    lines += ["struct forgotten { int slot, count; size_t step, offset, bytes; };"]
    lines += ["static const struct forgotten FORGOTTEN[] = {"]
    lines += [f"    {{{', '.join(map(str, one))}}}," for one in _forgotten()] + ["};", ""]
    return "\n".join(lines)


def _structure() -> list[str]:
    """Heads of records, the tables behind them, and counts that stand in MODEL, too."""
    heads = ", ".join(str(kind.dtype.itemsize) for kind in _RECORDS.values())
    fields: Any = records.MODEL.dtype.fields
    tables = []
    same = []
    for name, kind in _RECORDS.items():
        for dtype, sizes in kind.tables.values():
            rows = [-1 - kind.slot(one) if isinstance(one, str) else one for one in (*sizes, 1)]
            tables.append(f"    {{{name}, {dtype.itemsize}, {rows[0]}, {rows[1]}}},")
        known = [one for one in kind.counts if one in (COUNTED if name != "PROGRAM" else "a")]
        same += [f"    {{{name}, {kind.slot(one)}, {fields[COUNTED[one]][1]}}}," for one in known]
    return [
        "/* Sizes of tables: numbers, or −1 − the slot of the layout that has them. */",
        f"enum {{ {', '.join(_RECORDS)}, RECORDS }};",
        f"static const size_t HEADS[] = {{{heads}}};",
        "static const struct { int record; size_t bytes; int rows, columns; } TABLES[] = {",
        *tables,
        "};",
        "static const struct { int record, slot; size_t field; } COUNTS[] = {",
        *same,
        "};",
    ]


def _forgotten() -> list[tuple[int, int, int, int, int]]:
    fields: Any = records.MEMORY.dtype.fields
    found = [(-1, 0, 0, fields[name][1], fields[name][0].itemsize) for name in FORGOTTEN]
    for table, names in FORGOTTEN_TABLES.items():
        dtype, sizes = records.MEMORY.tables[table]
        slot = records.MEMORY.start(table)
        count = records.MEMORY.slot(sizes[0])
        own: Any = dtype.fields
        whole = [(0, dtype.itemsize)]
        parts = [(own[one][1], own[one][0].itemsize) for one in names] or whole
        found += [(slot, count, dtype.itemsize, at, size) for at, size in parts]
    return found
