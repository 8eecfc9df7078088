"""Sources of the C library that runs controllers from files without Python.

The header, and the offsets of fields for the C sources, are written from the declarations of the
records and settings; `osc_controller.c` contains no offset.
"""

import json
import math
import re
import tarfile
from collections.abc import Iterable, Sequence
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

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
from osc_contact.law.nested import Nested
from osc_contact.law.reasons import CODES, SENTENCES
from osc_contact.law.records import COUNTED
from osc_contact.law.tick import BAD_INPUT, STOPPED
from osc_contact.settings.control import PhaseSettings
from osc_contact.settings.gains import Gains
from osc_contact.settings.quantities import Dimension, meaning

_Dtype = np.dtype[Any]  #: type of a record, of a row of a table, or of numbers

#: Names and meanings of enum osc_error, in the order of its codes 0, −1, …
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
#: Sentences, for C, of the reasons whose sentences Python makes from the inputs of the tick.
REASONS = {
    BAD_INPUT: "a number of the measurement or of the reference is not finite or out of range",
    STOPPED: "stopped, until osc_reset is called; field cause has the reason of the stop",
}
_VALUE = re.compile(r"\{(?:\w+\.)?(\w+)[^}]*\}")  #: value in a sentence: {joint}, {x.rate:g}


# --- The C library --------------------------------------------------------------------------------


def write_library(folder: Path) -> None:
    """Write law.o and the sources of the library, see `write_sources`.

    Args:
        folder: folder of the files; it is made if it does not exist.
    """
    write_sources(folder)
    write_whole(object_file(), folder / "law.o")


def write_sources(folder: Path) -> None:
    """Write the C sources of the library, those of the solver daqp, and their build files.

    Args:
        folder: folder of the files; it is made if it does not exist.
    """
    folder.mkdir(parents=True, exist_ok=True)
    contents: dict[str, str | bytes] = {
        "osc_layout.h": _layout_header(),
        "osc_ranges.h": _ranges_header(),
    }
    for item in (files("osc_contact.control") / "c_files").iterdir():
        if item.name.endswith(".tar.xz"):
            with item.open("rb") as stream, tarfile.open(fileobj=stream) as archive:
                archive.extractall(folder, filter="data")
        elif item.name.endswith(".in"):
            contents[item.name.removesuffix(".in")] = _header_text(item.read_text("utf-8"))
        else:
            contents[item.name] = item.read_bytes()
    for name, content in contents.items():
        write_whole(content, folder / name)


def _enum_lines(prefix: str, members: Iterable[tuple[str, int]]) -> str:
    """Write the lines of a C enum.

    Args:
        prefix: prefix of each name.
        members: (name, value) of each member.
    """
    return ",\n".join(f"    {prefix}{name} = {value}" for name, value in members)


def _header_text(text: str) -> str:
    """Write osc_controller.h: fill in the names between @ in its template.

    Names of errors, statuses, states, reasons, phases and settings, with their numbers and
    descriptions, are those of the Python package, so that both have one declaration.

    Args:
        text: content of osc_controller.h.in.

    Returns:
        Content of osc_controller.h.
    """
    phases = (f" *   {setting.name}: {setting.words}" for setting in _phase_settings())
    values = {
        "VERSION": version("osc-contact"),
        "FILE_VERSION": str(FORMAT),
        "LAW": law_hash(),
        "ERRORS": ",\n".join(
            f"    OSC_{name} = {-code} /* {words} */"
            for code, (name, words) in enumerate(ERRORS.items())
        ),
        "STATUSES": _enum_lines("OSC_STATUS_", Status.__members__.items()),
        "STATES": _enum_lines("OSC_STATE_", SafetyState.__members__.items()),
        "REASONS": ",\n".join(
            f"    OSC_REASON_{name} = {code}{_culprit_comment(code)}"
            for name, code in CODES.items()
        ),
        "GAINS": "\n".join(f" *   {gain.name}: {gain.words}" for gain in _changeable_gains()),
        "PHASES": _enum_lines("OSC_PHASE_", Phase.__members__.items()),
        "PHASE_SETTINGS": "\n".join(phases),
    }
    for name, value in values.items():
        text = text.replace(f"@{name}@", value)
    return text


def _culprit_comment(code: int) -> str:
    """Write a C comment with the kind of part that the field `culprit` of a stop numbers.

    It is empty for a reason whose sentence names no joint, arm or contact.

    Args:
        code: code of the reason.
    """
    kinds = {"{joint}": "a joint", "{arm}": "an arm", "{contact}": "a force"}
    for name, words in kinds.items():
        if name in SENTENCES[code]:
            return f" /* of {words} */"
    return ""


class _Gain(NamedTuple):
    """Gain that may change while a controller runs.

    Attributes:
        name: name, such as "force.integral".
        offset: offset in MODEL (bytes).
        contact_offset: offset in rows of MEMORY's contacts (bytes); −1: it is not stored there.
        words: unit and meaning.
    """

    name: str
    offset: int
    contact_offset: int
    words: str


def _changeable_gains() -> list[_Gain]:
    """List the gains that may change while a controller runs, from the settings' declarations.

    Each has its name, the offsets (bytes) of its fields in MODEL and in a contact's row of MEMORY
    (−1: none there), and unit and meaning for the header.
    """
    gains = []
    for name, (field, contact_field) in GAIN_FIELDS.items():
        loop, key = name.split(".")
        kind = type(getattr(Gains(), loop))
        unit = " ".join(x for x in kind.model_fields[key].metadata if isinstance(x, str))
        contact_offset = (
            _field_offset(records.CONTACT_MEMORY, contact_field) if contact_field else -1
        )
        words = f"{unit}; {meaning(kind, key)}"
        gains.append(_Gain(name, _field_offset(records.MODEL.dtype, field), contact_offset, words))
    return gains


def _fields_of(dtype: _Dtype) -> dict[str, tuple[_Dtype, int]]:
    """Fields of a structured dtype by name: type and offset (bytes); empty for numbers."""
    return {name: (field[0], field[1]) for name, field in (dtype.fields or {}).items()}


def _field_offset(row: _Dtype, field: str) -> int:
    """Offset (bytes) of a field in a row of a structured dtype."""
    return _fields_of(row)[field][1]


class _PhaseSetting(NamedTuple):
    """Setting of contact phases.

    Attributes:
        name: name in `PhaseSettings`.
        offset: offset in MODEL (bytes).
        may_be_zero: True if 0 is allowed.
        words: unit and meaning.
    """

    name: str
    offset: int
    may_be_zero: bool
    words: str


def _phase_settings() -> list[_PhaseSetting]:
    """List the settings of contact phases, from the declaration of `PhaseSettings`.

    Each has its name, the offset (bytes) of its field in MODEL, whether it may be 0, and unit and
    meaning for the header.
    """
    settings = []
    for name, about in PhaseSettings.model_fields.items():
        field = PHASE_NAMES.get(name, name)
        # the unit is a string in the metadata, or the first unit of the dimension there
        dimension = next((x for x in about.metadata if isinstance(x, Dimension)), None)
        unit = next((x for x in about.metadata if isinstance(x, str)), "")
        if not unit and dimension is not None:
            unit = next(iter(dimension.units), "")
        words = "; ".join(part for part in (unit, meaning(PhaseSettings, name)) if part)
        may_be_zero = any(getattr(x, "ge", None) == 0 for x in about.metadata)
        offset = _field_offset(records.MODEL.dtype, field)
        settings.append(_PhaseSetting(name, offset, may_be_zero, words))
    return settings


def _reason_texts() -> dict[int, str]:
    """Sentences of the reasons by their codes, with <joint> for the value of "joint"."""
    texts = {code: _VALUE.sub(r"<\1>", text) for code, text in SENTENCES.items()}
    return texts | REASONS


def _layout_header() -> str:
    """Write osc_layout.h, from which the C library knows the layout of the records.

    It has offsets of fields, slots of tables, numbers of flags and sizes, and tables of gains,
    settings of phases, sentences of reasons, and of what a reset sets to zero.

    Returns:
        Content of the file.
    """
    lines = ["/* Written with osc_controller.h: where fields and tables of the records are. */"]
    for name, kind in RECORDS.items():
        fields = _fields_of(kind.dtype)
        lines += [f"#define {name}_{field} {at}" for field, (_, at) in fields.items()]
        lines += [f"#define {name}_{table} {kind.start(table)}" for table in kind.tables]
    words = len(records.MEMORY.tables) + len(records.MEMORY.counts)
    numbers = {
        "LOOK": records.LOOK,
        "ALLOCATE": records.ALLOCATE,
        "END": records.END,
        "HAND_OVER": records.HAND_OVER,
        "MOVING": tick.MOVING,
        "COMMANDED": tick.COMMANDED,
        "MEMORY_LAYOUT_WORDS": words,
        "CONTACT_BYTES": records.CONTACT_MEMORY.itemsize,
        "JOINT_BYTES": records.JOINT.itemsize,
        "JOINT_MOTOR": _field_offset(records.JOINT, "motor"),
        "JOINT_TAU_MAX": _field_offset(records.JOINT, "tau_max"),
        "HISTORY": records.HISTORY,
        "NOISY": records.NOISY,
        "OSC_FILE_HEAD": HEAD,
    }
    lines += [f"#define {name} {value}" for name, value in numbers.items()]
    lines += [f'#define OSC_FILE_MAGIC "{MAGIC.decode()}"']
    lines += ["static const char *const ERROR_TEXTS[] = {"]
    lines += [f"    {json.dumps(text)}," for text in ERRORS.values()] + ["};"]
    lines += ["struct gain { const char *name; size_t offset; int of_contact; };"]
    lines += ["static const struct gain GAINS[] = {"]
    lines += [
        f'    {{"{gain.name}", {gain.offset}, {gain.contact_offset}}},'
        for gain in _changeable_gains()
    ] + ["};"]
    lines += ["struct phase_setting { const char *name; size_t offset; int may_be_zero; };"]
    lines += ["static const struct phase_setting PHASE_SETTINGS[] = {"]
    lines += [
        f'    {{"{setting.name}", {setting.offset}, {int(setting.may_be_zero)}}},'
        for setting in _phase_settings()
    ] + ["};"]
    lines += ["static const struct { int reason; const char *text; } REASON_TEXTS[] = {"]
    lines += [
        f"    {{{code}, {json.dumps(text, ensure_ascii=False)}}},"
        for code, text in sorted(_reason_texts().items())
    ] + ["};"]
    lines += _row_offsets()
    lines += _structure_lines()
    lines += ["/* What osc_reset sets to zero: of MEMORY (slot −1), and of rows of its tables. */"]
    lines += ["struct forgotten { int slot, count; size_t step, offset, bytes; };"]
    lines += ["static const struct forgotten FORGOTTEN[] = {"]
    lines += [f"    {{{', '.join(map(str, part))}}}," for part in _parts_to_reset()] + ["};", ""]
    return "\n".join(lines)


def _row_offsets() -> list[str]:
    """Write the offsets in rows of tables of MEMORY and MODEL that the library's getters read.

    Returns:
        Lines of C: for each table the bytes of a row, and the offset (bytes) of each field.
    """
    lines = []
    for name, kind, fields_by_table in (
        (
            "MEMORY",
            records.MEMORY,
            {"contacts": ("active", "phase"), "columns": ("alpha", "integral")},
        ),
        ("MEMORY", records.MEMORY, {"friction": ("theta",)}),
        ("MODEL", records.MODEL, {"joints": ("theta",)}),
    ):
        for table, columns in fields_by_table.items():
            dtype = kind.tables[table][0]
            lines.append(f"#define {name}_{table}_BYTES {dtype.itemsize}")
            lines += [
                f"#define {name}_{table}_{key} {_field_offset(dtype, key)}" for key in columns
            ]
    return lines


def _structure_lines() -> list[str]:
    """Write the sizes of the records' heads and tables, and the counts that are also in MODEL.

    The library checks with them that the bytes of a file have the layout that its header declares.

    Returns:
        Lines of C with the tables HEADS (bytes), TABLES (record, bytes of an element, rows,
        columns; a size < 0 is −1 − the slot of the layout that has it) and COUNTS (record, slot of
        its layout, offset of the same count in MODEL), of the counts that `COUNTED` names.
    """
    heads = ", ".join(str(kind.dtype.itemsize) for kind in RECORDS.values())
    fields = _fields_of(records.MODEL.dtype)
    tables = []
    count_rows = []
    for name, kind in RECORDS.items():
        for dtype, sizes in kind.tables.values():
            rows, columns = _sizes_in_c(kind, sizes)
            tables.append(f"    {{{name}, {dtype.itemsize}, {rows}, {columns}}},")
        # PROGRAM uses letters of its own for its counts, except for a, the number of motors
        counted = {"a"} if name == "PROGRAM" else set(COUNTED)
        for count in kind.counts:
            if count in counted:
                count_rows.append(
                    f"    {{{name}, {kind.slot(count)}, {fields[COUNTED[count]][1]}}},"
                )
    return [
        "/* Sizes of tables: numbers, or −1 − the slot of the layout that has them. */",
        f"enum {{ {', '.join(RECORDS)}, RECORDS }};",
        f"static const size_t HEADS[] = {{{heads}}};",
        "static const struct { int record; size_t bytes; int rows, columns; } TABLES[] = {",
        *tables,
        "};",
        "static const struct { int record, slot; size_t field; } COUNTS[] = {",
        *count_rows,
        "};",
    ]


def _sizes_in_c(kind: Nested, sizes: Sequence[int | str]) -> tuple[int, int]:
    """Numbers of rows and columns of a table; −1 − slot for a size that the layout has.

    Args:
        kind: layout of the record.
        sizes: one or two sizes of the table, numbers or names of counts; a second size that is
            missing is 1.
    """
    rows, columns = [
        -1 - kind.slot(size) if isinstance(size, str) else size for size in (*sizes, 1)
    ][:2]
    return rows, columns


def _parts_to_reset() -> list[tuple[int, int, int, int, int]]:
    """List the parts of MEMORY that a reset clears.

    Returns:
        For each part the offset of its table's entry in the layout (−1: the head), the slot of its
        number of rows, bytes of a row, offset in the row, and bytes to clear.
    """
    fields = _fields_of(records.MEMORY.dtype)
    parts = [(-1, 0, 0, fields[name][1], fields[name][0].itemsize) for name in FORGOTTEN]
    for table, names in FORGOTTEN_TABLES.items():
        dtype, sizes = records.MEMORY.tables[table]
        slot = records.MEMORY.start(table)
        count = records.MEMORY.slot(sizes[0])
        columns = _fields_of(dtype)
        if not names:  # the whole row
            parts.append((slot, count, dtype.itemsize, 0, dtype.itemsize))
        for name in names:
            offset, size = columns[name][1], columns[name][0].itemsize
            parts.append((slot, count, dtype.itemsize, offset, size))
    return parts


# --- Check of the numbers in a file ---------------------------------------------------------------


def _ranges_header() -> str:
    """Write osc_ranges.h: the ranges that `record_ranges` declares, as C functions and tables.

    Returns:
        Content of the file.
    """
    lines = ["/* Written with osc_layout.h: whether numbers of a record are in their ranges. */"]
    lines += ['#include "osc_bytes.h"', "#include <math.h>", ""]
    lines += _surface_shapes()
    for name in RECORDS:
        lines += _relations_function(name)
    lines += ["struct number_range {", "    int slot, rows, columns;"]
    lines += ["    size_t step, offset, count;", "    double low, high;", "};"]
    for name in NUMBERS:
        lines += [f"static const struct number_range {name}_NUMBERS[] = {{"]
        lines += _number_rows(name)
        lines += ["};"]
    return "\n".join([*lines, ""])


def _surface_shapes() -> list[str]:
    """Write the C function that counts the SHAPE rows of a SURFACE pair from its cells.

    It is `record_ranges._surface_shapes` in C.
    """
    shapes = records.MODEL.start("shapes")
    shape, _ = records.MODEL.tables["shapes"]
    pair = _fields_of(records.PAIR)
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


def _relations_function(name: str) -> list[str]:
    """Write the C function that checks the relations of the whole numbers of a record.

    A relation such as "first + 1 <= end" limits an index or count, in the head of the record or in
    each row of one of its tables.

    Args:
        name: name of the record in `RECORDS`.

    Returns:
        Lines of a C function that returns 1 if all relations hold, else 0.
    """
    kind = RECORDS[name]
    lines = [
        f"static int {name}_in_range(const unsigned char *head, const unsigned char *model) {{"
    ]
    lines += ["    (void)model;"]
    for table, relations in RELATIONS[name].items():
        # relations of the record's own fields, which need no loop
        if not table:
            lines += [f"    if (!({_in_c(text, name, '')})) return 0;" for text in relations]
            continue
        dtype, sizes = kind.tables[table]
        rows = f"whole(head, {8 * kind.slot(sizes[0])})"
        lines += [
            "    {",
            f"        const unsigned char *own = record_table(head, {kind.start(table)});",
        ]
        # relations of a table are checked in every row; those of motors count the motors so far
        lines += [f"        int64_t row = 0, rows = {rows}, motors_before = 0;"]
        lines += [f"        for (; row < rows; row++, own += {dtype.itemsize}) {{"]
        lines += [f"            if (!({_in_c(text, name, table)})) return 0;" for text in relations]
        if "motor" in (dtype.names or ()):
            fields = _fields_of(dtype)
            lines += [f"            motors_before += whole(own, {fields['motor'][1]}) >= 0;"]
        lines += ["        }", "        (void)motors_before;"]
        # after the loop `row` and `motors_before` are totals, which ENDS compares with the head
        ends = ENDS.get(name, {}).get(table, ())
        lines += [f"        if (!({_in_c(text, name, table)})) return 0;" for text in ends]
        lines += ["    }"]
    return [*lines, "    return 1;", "}", ""]


def _in_c(relation: str, name: str, table: str) -> str:
    """Write a relation as a condition in C.

    Args:
        relation: relation of `record_ranges`.
        name: name of the record.
        table: its table; "": the head.
    """
    alternatives = []
    for sums, signs in read_relation(relation):
        sides = [_sum_in_c(products, name, table) for products in sums]
        pairs = zip(sides, signs, sides[1:], strict=False)
        alternatives.append(" && ".join(f"{left} {sign} {right}" for left, sign, right in pairs))
    if len(alternatives) == 1:
        return alternatives[0]
    return " || ".join(f"({alternative})" for alternative in alternatives)


def _sum_in_c(products: Sum, name: str, table: str) -> str:
    """Write a sum of products as an expression in C.

    Args:
        products: (integer factor, names) of each product.
        name: name of the record.
        table: its table; "": the head.
    """
    parts = []
    for factor, names in products:
        words = [_name_in_c(word, name, table) for word in names]
        if abs(factor) != 1 or not words:
            words.insert(0, f"INT64_C({abs(factor)})")
        parts.append(("- " if factor < 0 else "+ ") + " * ".join(words))
    return " ".join(parts).removeprefix("+ ").replace("- INT64_C", "-INT64_C", 1)


def _name_in_c(word: str, name: str, table: str) -> str:
    """Write a name in a relation of `record_ranges` as an expression in C.

    `record_ranges` lists the kinds of names: fields of the row, of the row before (`before_…`) and
    of MODEL, sizes (`size_…`), and `row`, `motors_before` and `surface_shapes`. The expression
    reads a whole number at an offset (bytes) behind the pointer `own` (row), `head` (record) or
    `model`.

    Args:
        word: the name.
        name: name of the record.
        table: its table; "": the head.
    """
    kind = RECORDS[name]
    dtype = kind.tables[table][0] if table else kind.dtype
    pointer = "own" if table else "head"
    fields = _fields_of(dtype)
    model = _fields_of(records.MODEL.dtype)
    if word == table:
        return f"whole{'' if dtype.itemsize == 8 else 8 * dtype.itemsize}({pointer}, 0)"
    if word in fields:
        return f"whole({pointer}, {fields[word][1]})"
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
    """Write the rows of a C table with the place and the range of each floating-point field.

    A row has the slot of the table in the record's layout (−1: the head), its numbers of rows and
    columns, bytes of an element, offset of the field (bytes), number of its elements, and the
    bounds.

    Args:
        name: name of the record in `RECORDS`.
    """
    kind = RECORDS[name]
    lines = []
    for table, field, (low, high) in number_ranges(name):
        if table:
            dtype, sizes = kind.tables[table]
        else:
            dtype, sizes = kind.dtype, [1]
        fields = _fields_of(dtype) or {table: (dtype, 0)}
        item, offset = fields[field]
        rows, columns = _sizes_in_c(kind, sizes)
        slot = kind.start(table) if table else -1
        bounds = ", ".join(_number_in_c(x) for x in (low, high))
        count = item.itemsize // 8
        place = f"{slot}, {rows}, {columns}, {dtype.itemsize}, {offset}, {count}"
        lines.append(f"    {{{place}, {bounds}}}, /* {table} {field} */")
    return lines


def _number_in_c(x: float) -> str:
    """Write a floating-point number, which may be infinite, as a literal in C."""
    if math.isinf(x):
        return "-INFINITY" if x < 0 else "INFINITY"
    return repr(x)
