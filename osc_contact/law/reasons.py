"""Reasons for which a tick is held: each is declared, code and sentence, beside its rule.

Sentences are filled in by `control.reasons`; names in braces are those of its facts.
"""

from __future__ import annotations

CODES: dict[str, int] = {}
SENTENCES: dict[int, str] = {}
#: Reasons from this code on stop the arms at once, until `reset`; the others end with their tick.
LASTING = 50


def declare_reason(name: str, code: int, sentence: str) -> int:
    """The code of a reason, which is known by it from now on.

    Args:
        name: in C programs, after OSC_REASON_. code: in the records of a tick.
        sentence: for people; names in braces are those of `control.reasons`.

    Raises:
        ValueError: another reason has this name or this code.
    """
    if name in CODES or code in SENTENCES:
        raise ValueError(f"reason {code}, {name}: another one has its code or name")
    CODES[name] = code
    SENTENCES[code] = sentence
    return code


NO_REASON = declare_reason("NO_REASON", 0, "")
