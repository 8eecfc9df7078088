"""The C library that runs controllers out of files without Python.

The header and the offsets of the C sources are written from the records and settings as they are
declared; `osc_controller.c` contains no offset.
"""

import json
import math
import re
import tarfile
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

from osc_contact.control.packing import GAIN_FIELDS, PHASE_NAMES
from osc_contact.control.record_ranges import (
    ENDS,
    MOST_ROWS,
    NUMBERS,
    RECORDS,
    RELATIONS,
    Sum,
    number_ranges,
    read_relation,
)
from osc_contact.control.records import FORGOTTEN, FORGOTTEN_TABLES
from osc_contact.control.saving import FORMAT, HEAD, MAGIC
from osc_contact.control.status import Phase, SafetyState, Status
from osc_contact.files import write_whole
from osc_contact.law import records, tick
from osc_contact.law.c_object import object_file
from osc_contact.law.library import law_hash
from osc_contact.law.reasons import CODES, SENTENCES
from osc_contact.law.records import COUNTED
from osc_contact.law.tick import BAD_INPUT, STOPPED
from osc_contact.settings.control import Gains, PhaseSettings
from osc_contact.settings.quantities import Dimension, meaning

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
    "OUT_OF_RANGE": "a number is not finite, or out of its range",
    "UNKNOWN_NAME": "no gain, or no setting of phases, has this name",
    "NO_TICK": "no tick was computed yet",
    "NO_PHASES": "the controller was made without phases (life)",
}
#: Reasons whose sentences Python makes of what came in.
REASONS = {
    BAD_INPUT: "a number of the measurement or of the reference is not finite or out of range",
    STOPPED: "stopped, until osc_reset is called; field cause has the reason of the stop",
}
_VALUE = re.compile(r"\{(?:\w+\.)?(\w+)[^}]*\}")  #: of a sentence: {joint}, {safety.hold_rate:g}


# --- The C library --------------------------------------------------------------------------------


def write_library(folder: Path) -> None:
    """Write law.o, the C sources around it, daqp's, and what builds them.

    Args:
        folder: is made.
    """
    write_sources(folder)
    write_whole(object_file(), folder / "law.o")


def write_sources(folder: Path) -> None:
    """Write the C sources around the law, daqp's, and what builds them.

    Args:
        folder: is made.
    """
    folder.mkdir(parents=True, exist_ok=True)
    contents: dict[str, str | bytes] = {"osc_layout.h": _layout(), "osc_ranges.h": _ranges()}
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
    phases = (f" *   {one.name}: {one.words}" for one in _phase_settings())
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
        "REASONS": ",\n".join(
            f"    OSC_REASON_{name} = {code}{_culprit(code)}" for name, code in CODES.items()
        ),
        "GAINS": "\n".join(f" *   {name}: {words}" for name, _, _, words in _gains()),
        "PHASES": _enum("OSC_PHASE_", Phase.__members__.items()),
        "PHASE_SETTINGS": "\n".join(phases),
    }
    for name, value in values.items():
        text = text.replace(f"@{name}@", value)
    return text


def _culprit(code: int) -> str:
    """A C comment that names the kind of part that a stop for this reason blames."""
    kinds = {"{joint}": "a joint", "{arm}": "an arm", "{contact}": "a force"}
    found = next((words for name, words in kinds.items() if name in SENTENCES[code]), "")
    return f" /* of {found} */" if found else ""


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


def _offset(row: Any, field: str) -> int:
    """Offset (bytes) of a field in a row."""
    return int(row.fields[field][1])


class _PhaseSetting(NamedTuple):
    """A setting of phases: name, offset in MODEL, whether it may be 0, unit and meaning."""

    name: str
    offset: int
    may_be_zero: bool
    words: str


def _phase_settings() -> list[_PhaseSetting]:
    """Settings of contact phases: name, offset in MODEL, whether 0 is allowed, unit and meaning."""
    fields: Any = records.MODEL.dtype.fields
    found = []
    for name, about in PhaseSettings.model_fields.items():
        field = PHASE_NAMES.get(name, name)
        dimension = next((x for x in about.metadata if isinstance(x, Dimension)), None)
        unit = next((x for x in about.metadata if isinstance(x, str)), "")
        unit = unit or ("" if dimension is None else next(iter(dimension.units), ""))
        words = "; ".join(part for part in (unit, meaning(PhaseSettings, name)) if part)
        may_be_zero = any(getattr(x, "ge", None) == 0 for x in about.metadata)
        found.append(_PhaseSetting(name, int(fields[field][1]), may_be_zero, words))
    return found


def _reason_texts() -> dict[int, str]:
    """Sentences of the reasons; in place of values the names that they have."""
    texts = {code: _VALUE.sub(r"<\1>", text) for code, text in SENTENCES.items()}
    return texts | REASONS


def _layout() -> str:
    """osc_layout.h: offsets of fields, slots of tables."""
    lines = ["/* Written with osc_controller.h: where fields and tables of the records are. */"]
    for name, kind in RECORDS.items():
        fields: Any = kind.dtype.fields
        lines += [f"#define {name}_{field} {at}" for field, (_, at, *_) in fields.items()]
        lines += [f"#define {name}_{table} {kind.start(table)}" for table in kind.tables]
    words = len(records.MEMORY.tables) + len(records.MEMORY.counts)
    numbers = {
        "LOOK": tick.LOOK,
        "ALLOCATE": tick.ALLOCATE,
        "END": tick.END,
        "HAND_OVER": tick.HAND_OVER,
        "MOVING": tick.MOVING,
        "COMMANDED": tick.COMMANDED,
        "MEMORY_LAYOUT_WORDS": words,
        "CONTACT_BYTES": records.CONTACT_MEMORY.itemsize,
        "JOINT_BYTES": records.JOINT.itemsize,
        "JOINT_MOTOR": _offset(records.JOINT, "motor"),
        "JOINT_TAU_MAX": _offset(records.JOINT, "tau_max"),
        "HISTORY": records.HISTORY,
        "OSC_FILE_HEAD": HEAD,
    }
    lines += [f"#define {name} {value}" for name, value in numbers.items()]
    lines += [f'#define OSC_FILE_MAGIC "{MAGIC.decode()}"']
    lines += ["static const char *const ERROR_TEXTS[] = {"]
    lines += [f"    {json.dumps(text)}," for text in ERRORS.values()] + ["};"]
    lines += ["struct gain { const char *name; size_t offset; int of_contact; };"]
    lines += ["static const struct gain GAINS[] = {"]
    lines += [f'    {{"{name}", {at}, {of}}},' for name, at, of, _ in _gains()] + ["};"]
    lines += ["struct phase_setting { const char *name; size_t offset; int may_be_zero; };"]
    lines += ["static const struct phase_setting PHASE_SETTINGS[] = {"]
    lines += [
        f'    {{"{one.name}", {one.offset}, {int(one.may_be_zero)}}},' for one in _phase_settings()
    ] + ["};"]
    lines += ["static const struct { int reason; const char *text; } REASON_TEXTS[] = {"]
    lines += [
        f"    {{{code}, {json.dumps(text, ensure_ascii=False)}}},"
        for code, text in sorted(_reason_texts().items())
    ] + ["};"]
    lines += _rows()
    lines += _structure()
    lines += ["/* What osc_reset sets to zero: of MEMORY (slot −1), and of rows of its tables. */"]
    lines += ["struct forgotten { int slot, count; size_t step, offset, bytes; };"]
    lines += ["static const struct forgotten FORGOTTEN[] = {"]
    lines += [f"    {{{', '.join(map(str, one))}}}," for one in _forgotten()] + ["};", ""]
    return "\n".join(lines)


def _rows() -> list[str]:
    """Offsets in rows of MEMORY's tables, and of the joints in MODEL, that getters read."""
    lines = []
    for name, kind, wanted in (
        (
            "MEMORY",
            records.MEMORY,
            {"contacts": ("active", "phase"), "columns": ("alpha", "integral")},
        ),
        ("MEMORY", records.MEMORY, {"friction": ("theta",)}),
        ("MODEL", records.MODEL, {"joints": ("theta",)}),
    ):
        for table, columns in wanted.items():
            dtype: Any = kind.tables[table][0]
            lines.append(f"#define {name}_{table}_BYTES {dtype.itemsize}")
            lines += [f"#define {name}_{table}_{key} {dtype.fields[key][1]}" for key in columns]
    return lines


def _structure() -> list[str]:
    """Heads of records, the tables behind them, and counts that stand in MODEL, too."""
    heads = ", ".join(str(kind.dtype.itemsize) for kind in RECORDS.values())
    fields: Any = records.MODEL.dtype.fields
    tables = []
    same = []
    for name, kind in RECORDS.items():
        for dtype, sizes in kind.tables.values():
            rows = [-1 - kind.slot(one) if isinstance(one, str) else one for one in (*sizes, 1)]
            tables.append(f"    {{{name}, {dtype.itemsize}, {rows[0]}, {rows[1]}}},")
        known = [one for one in kind.counts if one in (COUNTED if name != "PROGRAM" else "a")]
        same += [f"    {{{name}, {kind.slot(one)}, {fields[COUNTED[one]][1]}}}," for one in known]
    return [
        "/* Sizes of tables: numbers, or −1 − the slot of the layout that has them. */",
        f"enum {{ {', '.join(RECORDS)}, RECORDS }};",
        f"static const size_t HEADS[] = {{{heads}}};",
        "static const struct { int record; size_t bytes; int rows, columns; } TABLES[] = {",
        *tables,
        "};",
        "static const struct { int record, slot; size_t field; } COUNTS[] = {",
        *same,
        "};",
    ]


def _forgotten() -> list[tuple[int, int, int, int, int]]:
    """Parts of MEMORY that a reset clears.

    Returns:
        For each part the offset of its table's entry in the layout (−1: the head), the slot of its
        number of rows, bytes of a row, offset in the row, and bytes to clear.
    """
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


# --- The check of what a file holds ---------------------------------------------------------------


def _ranges() -> str:
    """osc_ranges.h: `record_ranges` as C."""
    lines = ["/* Written with osc_layout.h: whether numbers of a record are in their ranges. */"]
    lines += ['#include "osc_bytes.h"', "#include <math.h>", ""]
    lines += _surface_shapes()
    for name in RECORDS:
        lines += _relations(name)
    lines += ["struct number_range {", "    int slot, rows, columns;"]
    lines += ["    size_t step, offset, count;", "    double low, high;", "};"]
    for name in NUMBERS:
        lines += [f"static const struct number_range {name}_NUMBERS[] = {{"]
        lines += _number_rows(name)
        lines += ["};"]
    return "\n".join([*lines, ""])


def _surface_shapes() -> list[str]:
    """C function that counts the shapes of a SURFACE pair from its numbers of cells."""
    shapes, (shape, _) = records.MODEL.start("shapes"), records.MODEL.tables["shapes"]
    pair: Any = records.PAIR.fields
    count = records.MODEL.slot("s")
    return [
        "static int64_t surface_shapes(const unsigned char *model, const unsigned char *pair) {",
        f"    int64_t first = whole(pair, {pair['shape_at'][1]});",
        f"    if (whole(pair, {pair['kind'][1]}) != {records.SURFACE}) return 0;",
        f"    if (first < 0 || first >= whole(model, {8 * count})) return {MOST_ROWS + 1};",
        f"    const unsigned char *row = record_table(model, {shapes}) + {shape.itemsize} * first;",
        "    double x = number(row, 8 * 13), y = number(row, 8 * 14);",
        "    if (x == 0.0 && y == 0.0) return 2;",
        f"    if (!(x >= 1.0 && y >= 1.0 && x <= {MOST_ROWS} && y <= {MOST_ROWS})) "
        f"return {MOST_ROWS + 1};",
        f"    if (x != floor(x) || y != floor(y)) return {MOST_ROWS + 1};",
        "    return 2 + (int64_t)x * (int64_t)y;",
        "}",
        "",
    ]


def _relations(name: str) -> list[str]:
    """A function: whether all whole numbers of a record are in their ranges."""
    kind = RECORDS[name]
    lines = [
        f"static int {name}_in_range(const unsigned char *head, const unsigned char *model) {{"
    ]
    lines += ["    (void)model;"]
    for table, relations in RELATIONS[name].items():
        if not table:
            lines += [f"    if (!({_in_c(one, name, '')})) return 0;" for one in relations]
            continue
        dtype, sizes = kind.tables[table]
        rows = f"whole(head, {8 * kind.slot(sizes[0])})"
        lines += [
            "    {",
            f"        const unsigned char *own = record_table(head, {kind.start(table)});",
        ]
        lines += [f"        int64_t row = 0, rows = {rows}, motors_before = 0;"]
        lines += [f"        for (; row < rows; row++, own += {dtype.itemsize}) {{"]
        lines += [f"            if (!({_in_c(one, name, table)})) return 0;" for one in relations]
        if "motor" in (dtype.names or ()):
            fields: Any = dtype.fields
            lines += [f"            motors_before += whole(own, {fields['motor'][1]}) >= 0;"]
        lines += ["        }", "        (void)motors_before;"]
        ends = ENDS.get(name, {}).get(table, ())
        lines += [f"        if (!({_in_c(one, name, table)})) return 0;" for one in ends]
        lines += ["    }"]
    return [*lines, "    return 1;", "}", ""]


def _in_c(relation: str, name: str, table: str) -> str:
    """A relation as a condition in C."""
    alternatives = []
    for sums, signs in read_relation(relation):
        sides = [_sum_in_c(one, name, table) for one in sums]
        pairs = zip(sides, signs, sides[1:], strict=False)
        alternatives.append(" && ".join(f"{left} {sign} {right}" for left, sign, right in pairs))
    return " || ".join(f"({one})" for one in alternatives) if alternatives[1:] else alternatives[0]


def _sum_in_c(products: Sum, name: str, table: str) -> str:
    """Write a sum of products as an expression in C.

    Args:
        products: (integer factor, names) of each product. name: name of the record. table: its
            table.
    """
    parts = []
    for factor, names in products:
        words = [_name_in_c(one, name, table) for one in names]
        if abs(factor) != 1 or not words:
            words.insert(0, f"INT64_C({abs(factor)})")
        parts.append(("- " if factor < 0 else "+ ") + " * ".join(words))
    return " ".join(parts).removeprefix("+ ").replace("- INT64_C", "-INT64_C", 1)


def _name_in_c(word: str, name: str, table: str) -> str:
    """The C expression for a name of `record_ranges`."""
    kind = RECORDS[name]
    dtype = kind.tables[table][0] if table else kind.dtype
    own = "own" if table else "head"
    fields: Any = dtype.fields or {}
    model: Any = records.MODEL.dtype.fields
    if word == table:
        return f"whole{'' if dtype.itemsize == 8 else 8 * dtype.itemsize}({own}, 0)"
    if word in fields:
        return f"whole({own}, {fields[word][1]})"
    if word.startswith("size_"):
        return f"whole(head, {8 * kind.slot(word.removeprefix('size_'))})"
    if word in ("row", "motors_before"):
        return word
    if word.startswith("before_"):
        offset = fields[word.removeprefix("before_")][1]
        return f"(row ? whole(own - {dtype.itemsize}, {offset}) : 0)"
    if word == "surface_shapes":
        return "surface_shapes(model, own)"
    return f"whole(model, {model[word][1]})"


def _number_rows(name: str) -> list[str]:
    """Rows of a table of C: runs of numbers that have one range."""
    kind = RECORDS[name]
    lines = []
    for table, field, (low, high) in number_ranges(name):
        dtype, sizes = kind.tables[table] if table else (kind.dtype, [1])
        fields: Any = dtype.fields or {table: (dtype, 0)}
        item, offset = fields[field][:2]
        rows, columns = [-1 - kind.slot(x) if isinstance(x, str) else x for x in (*sizes, 1)][:2]
        slot = kind.start(table) if table else -1
        bounds = ", ".join(_number_in_c(x) for x in (low, high))
        count = item.itemsize // 8
        place = f"{slot}, {rows}, {columns}, {dtype.itemsize}, {offset}, {count}"
        lines.append(f"    {{{place}, {bounds}}}, /* {table} {field} */")
    return lines


def _number_in_c(x: float) -> str:
    return f"{'-' if x < 0 else ''}INFINITY" if math.isinf(x) else repr(x)
