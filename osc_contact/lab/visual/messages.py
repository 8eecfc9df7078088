"""Drawing commands as meshcat's viewer reads them: MessagePack, numbers in single precision."""

from collections.abc import Mapping, Sequence
from typing import Any


def packed(content: Any) -> bytes:
    """A command, or a part of one; numbers in single precision, as the viewer keeps them."""
    import umsgpack

    return umsgpack.packb(content, force_float_precision="single")


def packed_map(entries: Mapping[str, bytes]) -> bytes:
    """A map whose values are packed already."""
    pairs = (packed(key) + value for key, value in entries.items())
    return b"\xdf" + len(entries).to_bytes(4, "big") + b"".join(pairs)


def packed_list(entries: Sequence[bytes], count: int | None = None) -> bytes:
    """A list whose items are packed already.

    Args:
        entries: packed.
        count: how many there are, where they are not one each.
    """
    length = len(entries) if count is None else count
    return b"\xdd" + length.to_bytes(4, "big") + b"".join(entries)
