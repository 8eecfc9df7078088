"""Permitted ranges of the numbers in a controller's records, declared once for Python and C.

Whole numbers are indices, counts, kinds and switches. Compiled code uses them without a check, so
that a number beyond its range would read or write at any address. Their ranges are declared as
relations such as "first + 1 <= end <= n_joints"; tests require a relation for every such field.
`without_python` writes them as C for programs that read files; `require_ranges` checks them in
Python.

A relation compares sums of products, a side for each of <=, ==, != in it; " or " separates
alternatives. Names are, in this order of precedence,

| name | is |
|---|---|
| `first` | a field of the same row; of a table of whole numbers: its name, the number itself |
| `before_first` | that field of the row before, 0 in the first row |
| `row` | the number of the row |
| `size_k` | a size of this record's tables, see `law.nested` |
| `motors_before` | rows before this one whose `motor` is not −1 |
| `surface_shapes` | shapes that a SURFACE pair reads; 0 of others |
| `n_joints` | a field of MODEL |

Floating-point numbers of MODEL and MEMORY are finite, except those declared in `NUMBERS`. Those
of WORK, INPUT and PROGRAM are computed from these in every tick.
"""

import math
import operator
import re
from collections.abc import Callable, Iterator
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np

import osc_contact.law.tick  # noqa: F401  its modules declare the reasons
from osc_contact.errors import InvalidInputError
from osc_contact.law import records as at
from osc_contact.law.limits import PROGRAM
from osc_contact.law.nested import Bytes, Nested, View
from osc_contact.law.reasons import CODES
from osc_contact.settings.control import PhaseSettings, SafetySettings
from osc_contact.settings.quantities import may_be_infinite

MOST_ARMS = 32  #: largest number of arms in a file
MOST_ROWS = 4096  #: largest number of contacts, of shapes and of columns of N
MOST_TICKS = 1 << 48  #: largest count of ticks (9000 years at 1 kHz); sums of a few do not overflow
MOST_TORQUE = 1e9  #: largest torque (N m, N), so that differences of torques are finite

RECORDS = {
    "JOB": at.JOB,
    "MODEL": at.MODEL,
    "MEMORY": at.MEMORY,
    "WORK": at.WORK,
    "INPUT": at.INPUT,
    "PROGRAM": PROGRAM,
}


def _for_each_field(relation: str, *names: str) -> tuple[str, ...]:
    """Repeat a relation for several fields.

    Args:
        relation: relation with x in place of a name.
        *names: names of the fields.
    """
    return tuple(re.sub(r"\bx\b", name, relation) for name in names)


def _flag_relations(*names: str) -> tuple[str, ...]:
    """Relations of fields that are 0 or 1."""
    return _for_each_field("0 <= x <= 1", *names)


def _tick_relations(*names: str) -> tuple[str, ...]:
    """Relations of fields that count ticks."""
    return _for_each_field(f"0 <= x <= {MOST_TICKS}", *names)


_REASON = _for_each_field(f"0 <= x <= {max(CODES.values())}", "reason")
_SIX = "0 <= x <= 6"
_SQUEEZES = ("n_bars == 0 or size_squeezes == n_bars", "n_bars != 0 or size_squeezes == 1")

#: Relations of whole numbers by record and table ("": the head), in the order in which they are
#: checked: the terms of a sum have been found to be small before, so that it does not overflow.
RELATIONS: dict[str, dict[str, tuple[str, ...]]] = {
    # Readers of a file compare the offsets of the records with their sizes.
    "JOB": {
        "": (
            "switches == 0",
            f"begin == {at.LOOK}",
            f"stop == {at.END}",
            "first == 0",
            "last == 1",
            "count == 1",
            *_for_each_field("0 <= x", "model", "memory", "work", "input"),
            "model_step == row_bytes",
        ),
    },
    "MODEL": {
        "": (
            f"1 <= n_arms <= {MOST_ARMS}",
            f"n_arms <= n_joints <= {at.MAX_JOINTS} * n_arms",
            "0 <= n_motors <= n_joints",
            *_for_each_field(
                f"0 <= x <= {MOST_ROWS}", "n_contacts", "n_shapes", "n_columns", "n_bars"
            ),
            "2 * n_bars == n_arms * n_arms - n_arms",
            "n_bars == 0 or n_extra == n_bars + 6 * n_arms",
            "n_bars != 0 or n_extra == 1 + 6 * n_arms",
            *_flag_relations("held", "slipping", "rubs", "friction_learning", "friction_errors"),
            *_flag_relations("phased", "guarded", "hop_stops"),
            f"{at.BY_OBJECT} <= metric <= {at.BY_MATRIX}",
            f"{at.FILTER} <= reading <= {at.LEAST_SQUARES}",
            "-1 <= leader <= n_arms - 1",
            *_tick_relations("repeats", "fault_ticks", "fast_ticks", "row_bytes", "memory_bytes"),
        ),
        "arms": (
            "first == before_end",
            f"first + 1 <= end <= first + {at.MAX_JOINTS}",
            "end <= n_joints",
            "first <= tip_joint <= end - 1",
            "sensor_joint == -1 or first <= sensor_joint <= end - 1",
            "outer_joint == -1 or first <= outer_joint <= end - 1",
            *_for_each_field(_SIX, "m", "full_rank"),
            "full_rank <= m",
            f"{at.RIGID} <= kind <= {at.OTHER}",
            *_flag_relations("filtered"),
        ),
        "joints": (*_flag_relations("slides"), "motor == -1 or motor == motors_before"),
        "pairs": (
            f"{at.POINTS} <= kind <= {at.FUNCTION}",
            f"kind != {at.GIVEN}",  # Python evaluates it
            f"kind != {at.FUNCTION}",  # its address is valid in the process that made it only
            "0 <= count <= n_columns",
            "first == before_first + before_count",
            f"count == 1 or kind == {at.POINTS} or kind == {at.TANGENTS}",
            f"0 <= freedoms <= {MOST_ROWS}",
            "shape_at == before_shape_at + before_count + before_freedoms",
            f"shape_at + count + freedoms <= {MOST_ROWS}",
            "surface_shapes <= count + freedoms",
            *_flag_relations("has_friction"),
            "address == 0",
        ),
        "columns": ("before_contact <= contact <= n_contacts - 1",),
        "bodies": (
            f"{at.UNYIELDING} <= kind <= {at.YIELDING}",
            "0 <= same <= row",
            *_flag_relations("pushes", "face"),
        ),
    },
    "MEMORY": {
        "": (
            *_for_each_field(_SIX, "force_rank"),
            "0 <= located <= 2",
            *_tick_relations("ticked", "gap", "age", "faults", "lost", "overspeed", "repeats"),
            *_tick_relations(
                "wrench_age", "old_joints", "old_wrists", "balanced", "instant", "stamped"
            ),
            *_flag_relations("fresh", "engaged", "hand_over", "wrench_missing", "has_wrench"),
            f"0 <= settled <= {at.SETTLED}",
            f"0 <= derived <= {at.NOISY}",
            *_flag_relations("compared", "above", "chosen_set", "by_column"),
            *_REASON,
            f"0 <= cause <= {max(CODES.values())}",
            f"{at.RUN} <= state <= {at.SAFE_STOP}",
            f"0 <= culprit <= {MOST_ROWS}",
            "0 <= hopping <= n_columns",
            "-1 <= unbraked <= n_joints - 1",
            f"0 <= repeated <= {at.JOINTS + at.WRISTS + at.OUTDATED}",
            f"0 <= late <= {at.HISTORY}",
            f"0 <= given <= {at.GIVEN_TWIST}",
            f"{at.OK} <= status <= {at.HOPPING}",
            *_SQUEEZES,
        ),
        "contacts": (*_flag_relations("active", "held"), "0 <= phase <= 2"),
        "joints": (
            f"0 <= faulty <= {at.FAULTY_POSITION + at.FAULTY_SPEED}",
            *_tick_relations("unread_q", "unread_v", "changes"),
            *_flag_relations("stuck", "driven"),
            f"{at.NOT_BARRED} <= barred <= {at.EXCHANGED}",
            "0 <= followed <= 4",
        ),
        "arms": (
            *_tick_relations("unread"),
            *_flag_relations("weighed", "let_go", "holds", "released"),
        ),
        "columns": (
            *_flag_relations("closed", "collision", "known", "has_desired"),
            "0 <= pressing <= 2",
        ),
        "friction_known": ("0 <= friction_known <= 3",),
    },
    "WORK": {
        "": (
            *_for_each_field(_SIX, "rank", "locked", "n_lost"),
            *_flag_relations("looked"),
            *_for_each_field(
                "0 <= x <= n_joints", "jumps", "jumped", "speed_jumps", "speed_jumped"
            ),
            "0 <= count <= n_columns",
            f"{at.OK} <= status <= {at.HOPPING}",
            *_REASON,
            f"0 <= where <= {MOST_ROWS}",
            "0 <= n_internal <= n_bars",
            *_flag_relations("commanded", "moving", "weightless"),
            "size_6k == 6 * n_arms",
            "size_6e == 6 + n_extra",
            *_SQUEEZES,
            "size_bar_row == 3 * n_arms + n_bars",
            "size_effect_row == 6 * n_arms + n_joints + n_bars",
        ),
        "arms": (*_for_each_field(_SIX, "n_locked", "n_kept", "n_lost"), *_flag_relations("wide")),
        "columns": _flag_relations("shaped"),
        "chosen": ("0 <= chosen <= n_columns - 1",),
        "kept": ("0 <= kept <= n_columns - 1",),
        "owners": ("0 <= owners <= n_arms - 1",),
    },
    "INPUT": {"": _flag_relations("moving", "chosen_set")},
    "PROGRAM": {
        "": (
            "size_a == n_motors",
            "size_s == n_extra",
            "n_columns == 0 or size_k == n_columns",
            "n_columns != 0 or size_k == 1",
            "0 <= size_p <= n_joints + 2 * n_arms",
            "size_v == size_a + size_k",
            "size_w == 12 + size_s + size_p + size_v + size_k",
            "size_k1 == size_k + 1",
            "size_vv == size_v * size_v",
            "size_kv == size_k * size_v",
            "size_vk == size_v + size_k",
            *_for_each_field(_SIX, "d", "r"),
            "0 <= k <= size_k",
            "0 <= s <= size_s",
            *_flag_relations("short"),
        ),
        "at_limit": _flag_relations("at_limit"),
        "sense": ("sense == 0",),
        "free": ("0 <= free <= size_v - 1",),
    },
}

#: Relations after the last row of a table, which `before_…` then refers to.
ENDS: dict[str, dict[str, tuple[str, ...]]] = {
    "MODEL": {
        "arms": ("before_end == n_joints",),
        "joints": ("motors_before == n_motors",),
        "pairs": (
            "before_first + before_count == n_columns",
            "before_shape_at + before_count + before_freedoms == n_shapes",
        ),
    }
}

_FINITE = (-float(np.finfo(float).max), float(np.finfo(float).max))
_NOT_NEGATIVE = (0.0, _FINITE[1])
_LIMIT = (0.0, math.inf)  #: a limit; inf: no limit
_ANY = (-math.inf, math.inf)
#: Ranges of the settings that may be infinite; fields of MODEL have the names of the settings.
_OPEN = {
    key: _LIMIT
    for settings in (SafetySettings, PhaseSettings)
    for key, field in settings.model_fields.items()
    if may_be_infinite(field) and key in (at.MODEL.dtype.names or ())
}
#: Ranges of numbers that are not just finite, by record and table.
NUMBERS: dict[str, dict[str, dict[str, tuple[float, float]]]] = {
    "MODEL": {
        "": {
            **_OPEN,
            "period": (1e-9, 1e3),
            "fastest": (1e-3, math.inf),
        },
        "joints": {
            "tau_max": _LIMIT,
            "speed_max": _LIMIT,
            "rated": _LIMIT,
            "lower": _ANY,
            "upper": _ANY,
            "low": _ANY,
            "high": _ANY,
        },
    },
    "MEMORY": {
        "contacts": {"least": _ANY, "since": _LIMIT},
        "torques": {"torques": (-MOST_TORQUE, MOST_TORQUE)},
    },
}


# --- Parsed relations -----------------------------------------------------------------------------

Sum = list[tuple[int, list[str]]]  #: factor and names of each product


@cache
def read_relation(text: str) -> list[tuple[list[Sum], list[str]]]:
    """Parse a relation.

    Args:
        text: relation such as "n_bars == 0 or 0 <= first <= row + 1".

    Returns:
        For each alternative the sums that it compares, and the signs <=, == and != between them.
    """
    alternatives = []
    for alternative in text.split(" or "):
        parts = re.split(r" (<=|==|!=) ", alternative)  # sum, sign, sum, sign, … , sum
        sums = [_read_sum(part) for part in parts[::2]]
        alternatives.append((sums, parts[1::2]))
    return alternatives


def _read_sum(text: str) -> Sum:
    """Parse a sum of products, such as "2 * n_arms + 1".

    Args:
        text: terms joined by " + " or " - ", factors by " * "; factors are integers or names.

    Returns:
        (integer factor, names) of each product.
    """
    words = re.split(r" ([+-]) ", text)
    products: Sum = []
    for sign, product in zip(["+", *words[1::2]], words[::2], strict=True):
        factor = 1 if sign == "+" else -1
        names = []
        for part in product.split(" * "):
            if re.fullmatch(r"-?\d+", part):
                factor *= int(part)
            else:
                names.append(part)
        products.append((factor, names))
    return products


def names_in(text: str) -> set[str]:
    """Set of the names in a relation between numbers of a record.

    A relation compares sums of products of names and whole numbers; " or " separates alternatives.

    Args:
        text: relation, such as "n_bars == 0 or 0 <= first <= row + 1".
    """
    words: set[str] = set()
    for sums, _ in read_relation(text):
        for products in sums:
            for _, names in products:
                words.update(names)
    return words


def _relation_holds(text: str, value: Callable[[str], int]) -> bool:
    """Determine whether one of the alternatives of a relation holds.

    A relation compares sums of products of names and whole numbers, each with its neighbour, by <=,
    == or !=; " or " separates alternatives.

    Args:
        text: relation, such as "n_bars == 0 or 0 <= first <= row + 1".
        value: function from a name to its value.
    """
    compare = {"<=": operator.le, "==": operator.eq, "!=": operator.ne}
    for sums, signs in read_relation(text):
        numbers = [
            sum(factor * math.prod(map(value, names)) for factor, names in products)
            for products in sums
        ]
        # all comparisons of an alternative must be true
        neighbours = zip(pairwise(numbers), signs, strict=True)
        if all(
            compare[sign](left_value, right_value) for (left_value, right_value), sign in neighbours
        ):
            return True
    return False


# --- A controller's records -----------------------------------------------------------------------


class _Names:
    """Values of the names of relations, while the rows of a table are gone through."""

    def __init__(self, kind: Nested, record: View, model: View) -> None:
        """Begin without a table.

        Args:
            kind: layout of the record.
            record: view of it.
            model: view of MODEL.
        """
        self.kind, self.record, self.model = kind, record, model
        self.own: Any = None
        self.before: Any = None
        self.table = ""
        self.row = self.motors = 0

    def begin(self, table: str) -> None:
        """Begin a table at its first row; the caller sets `own` to this row.

        Index of the row and number of motors of the rows before it become 0; there is no row before
        it.

        Args:
            table: name of the table; "": the head of the record.
        """
        self.table = table
        self.row = 0
        self.motors = 0
        self.before = None

    def step(self) -> None:
        """Make the present row the previous one, and count its motor."""
        self.before = self.own
        if "motor" in (self.own.dtype.names or ()):
            self.motors += int(self.own["motor"] >= 0)

    def __call__(self, name: str) -> int:
        """Value of a name in a relation.

        Args:
            name: the table, for an element of a plain one; a field of the present row;
                before_FIELD, a field of the row before it (0 in the first row); size_TABLE, the
                number of rows of a table; row, the index of the present row; motors_before, the
                number of motors of the rows before it; surface_shapes, the SHAPE rows that the
                present pair reads; or a field of MODEL.
        """
        if name == self.table:
            return int(self.own)
        if self.own is not None and name in (self.own.dtype.names or ()):
            return int(self.own[name])
        if name.startswith("before_"):
            return 0 if self.before is None else int(self.before[name.removeprefix("before_")])
        if name.startswith("size_"):
            slot = self.kind.slot(name.removeprefix("size_"))
            return int(self.record.head["layout"][slot])
        match name:
            case "row":
                return self.row
            case "motors_before":
                return self.motors
            case "surface_shapes":
                return _surface_shapes(self.model, self.own)
        return int(self.model.head[name])


def _surface_shapes(model: View, pair: np.record) -> int:
    """Number of SHAPE rows that a SURFACE pair reads; 0 for pairs of other kinds.

    They are a row of the surface, one of its axes, and one for each cell of a grid. An invalid
    index or number of cells gives `MOST_ROWS` + 1, which no model has.

    Args:
        model: view of MODEL.
        pair: its PAIR row.
    """
    first = int(pair["shape_at"])
    if pair["kind"] != at.SURFACE:
        return 0
    if not 0 <= first < len(model.shapes):
        return MOST_ROWS + 1
    x, y = model.shapes.row[first, 13:15]
    if x == 0.0 and y == 0.0:
        return 2
    are_whole = all(1.0 <= n <= MOST_ROWS and n == math.floor(n) for n in (x, y))
    return 2 + int(x) * int(y) if are_whole else MOST_ROWS + 1


def broken_relations(name: str, record: View, model: View) -> Iterator[str]:
    """Yield clauses, each of which names a field of a record and the relation that it violates.

    Args:
        name: name of the record in `RECORDS`.
        record: view of the record.
        model: view of MODEL, whose counts the relations refer to.
    """
    kind = RECORDS[name]
    value = _Names(kind, record, model)
    for table, relations in RELATIONS[name].items():
        rows = getattr(record, table).view(np.ndarray) if table else [record.head]
        value.begin(table)
        for index, row in enumerate(rows):
            value.row = index
            value.own = row
            place = f"{name}.{table}[{value.row}]" if table else name
            yield from (
                f"{place}: {text}" for text in relations if not _relation_holds(text, value)
            )
            value.step()
        value.own = None
        for text in ENDS.get(name, {}).get(table, ()):
            if not _relation_holds(text, value):
                yield f"{name}.{table}: {text}"
    yield from _strange_numbers(name, record)


def _strange_numbers(name: str, record: View) -> Iterator[str]:
    """Yield a clause for each floating-point field with a number out of its range.

    Args:
        name: name of the record in `RECORDS`.
        record: view of the record.
    """
    for table, field, (low, high) in number_ranges(name):
        rows = getattr(record, table).view(np.ndarray) if table else record.head
        values = rows[field] if field in (rows.dtype.names or ()) else rows
        if not ((values >= low) & (values <= high)).all():
            yield f"{name}.{table}.{field}: {low:g} <= number <= {high:g}".replace("..", ".")


def number_ranges(name: str) -> Iterator[tuple[str, str, tuple[float, float]]]:
    """Yield table ("": the head), field and range of each floating-point field of a record.

    Records without ranges of floating-point numbers yield nothing.

    Args:
        name: name of the record in `RECORDS`.
    """
    if name not in NUMBERS:
        return
    kind = RECORDS[name]
    heads = {"": kind.dtype, **{table: dtype for table, (dtype, _) in kind.tables.items()}}
    for table, dtype in heads.items():
        ranges = NUMBERS[name].get(table, {})
        for field in dtype.names or (table,):
            if (dtype[field] if dtype.names else dtype).base.kind == "f":
                yield table, field, ranges.get(field, _FINITE)


def broken_ranges(raw: Bytes, program: Bytes) -> list[str]:
    """Clauses that name the fields of a controller's records that are out of their ranges.

    Args:
        raw: JOB, MODEL, MEMORY, WORK and INPUT of one controller, with correct layouts.
        program: PROGRAM of its motor limits, with a correct layout.
    """
    job = at.JOB.view(raw)
    starts = {"JOB": 0, **{place.upper(): int(job[place]) for place in _PLACES}}
    views = {name: RECORDS[name].view(raw[start:]) for name, start in starts.items()}
    views["PROGRAM"] = PROGRAM.view(program)
    model = views["MODEL"]
    clauses: list[str] = []
    for name, view in views.items():
        clauses += broken_relations(name, view, model)
    return clauses + list(_strange_torques(model, views["MEMORY"]))


_PLACES = ("model", "memory", "work", "input")  #: fields of JOB with the offsets of records


def _strange_torques(model: View, memory: View) -> Iterator[str]:
    """Yield a clause if a motor's limit is not above zero, or a last torque is beyond its limit.

    Args:
        model: view of MODEL, with the limits (N m, N).
        memory: view of MEMORY, with the torques.
    """
    joints = model.joints.view(np.ndarray)
    limits = joints["tau_max"][joints["motor"] >= 0]
    if not (limits > 0.0).all():
        yield "MODEL.joints.tau_max: 0 < limit of a motor"
    elif len(limits) == len(memory.torques) and not (np.abs(memory.torques) <= limits).all():
        yield "MEMORY.torques: |torque| <= tau_max of its motor"


def require_ranges(raw: Bytes, program: Bytes) -> None:
    """Refuse records with numbers out of their ranges, which a file must not hold.

    Args:
        raw: bytes of JOB, MODEL, MEMORY, WORK and INPUT of a controller.
        program: bytes of PROGRAM, the quadratic program of its motor limits.

    Raises:
        InvalidInputError: a number is out of its range.
    """
    if clauses := broken_ranges(raw, program):
        raise InvalidInputError(
            f"this controller cannot be saved: its numbers do not satisfy {'; '.join(clauses[:5])}"
        )
