"""Register of the reasons why a tick is held or the arms are stopped.

Each reason has a code and a sentence, declared in the module of its rule. Names in braces in a
sentence are replaced by values in `control.reasons`.
"""

from __future__ import annotations

CODES: dict[str, int] = {}
SENTENCES: dict[int, str] = {}
#: Reasons from this code on stop the arms at once, until `reset`; the others end with their tick.
LASTING = 50


def declare_reason(name: str, code: int, sentence: str) -> int:
    """Register a reason and return its code.

    Args:
        name: name of the reason; in C programs OSC_REASON_ precedes it.
        code: number of the reason in the records of a tick.
        sentence: explanation for the user; names in braces are replaced in `control.reasons`.

    Raises:
        ValueError: another reason has this name or this code.
    """
    if name in CODES or code in SENTENCES:
        owner = next((other for other, used_code in CODES.items() if used_code == code), name)
        raise ValueError(
            f"reason {name}, code {code}: {owner} has code {CODES[owner]}; give another name or "
            f"code, below {LASTING} for a reason that ends with its tick"
        )
    CODES[name] = code
    SENTENCES[code] = sentence
    return code


NO_REASON = declare_reason("NO_REASON", 0, "")
