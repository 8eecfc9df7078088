"""Key frames of a page that plays a recording, as one drawing command.

Most of a page's numbers are key frames. They are converted from arrays to the bytes of MessagePack,
which meshcat's viewer reads, without a Python object for each number.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from osc_contact.lab.visual.messages import packed, packed_list, packed_map


class Animation:
    """Key frames of all nodes."""

    def __init__(self, fps: float) -> None:
        """Make an animation without key frames.

        Args:
            fps: frames per second.
        """
        self.fps = fps
        self._clips: dict[str, list[bytes]] = {}

    def track(self, path: str, name: str, kind: str, values: NDArray[Any]) -> None:
        """Append the key frames of a property, without those between equal values.

        The last frame always has a key, as tracks of different length would be repeated at
        different times. The packed track is appended to `_clips` of the path; a property that does
        not change has none.

        Args:
            path: path of the node that moves.
            name: name of the property, such as `position`.
            kind: type of the property in three.js, such as `vector3`.
            values: (frames, …) value of each frame.
        """
        changed = np.any(values[1:] != values[:-1], axis=tuple(range(1, values.ndim)))
        if not changed.any():
            return
        frames = np.flatnonzero(np.append(True, changed) | np.append(changed, True))
        track = {
            "name": packed(f".{name}"),
            "type": packed(kind),
            "keys": packed_keys(frames, values[frames]),
        }
        self._clips.setdefault(path, []).append(packed_map(track))

    def message(self) -> bytes:
        """Packed command (msgpack) that starts the animation and repeats it for ever.

        It has a clip for each path of a node, with the key frames of `_clips`.
        """
        return packed_map(
            {
                "type": packed("set_animation"),
                "animations": packed_list(
                    [self._clip(path, tracks) for path, tracks in self._clips.items()]
                ),
                "options": packed({"play": True, "repetitions": float("inf")}),
                "path": packed(""),
            }
        )

    def _clip(self, path: str, tracks: Sequence[bytes]) -> bytes:
        """Packed animation of a node, from its path and packed tracks."""
        clip = {"fps": packed(self.fps), "name": packed("default"), "tracks": packed_list(tracks)}
        return packed_map({"path": packed(path), "clip": packed_map(clip)})


def packed_keys(frames: NDArray[np.integer], values: NDArray[Any]) -> bytes:
    """Pack the list [{"time": frame, "value": value}, …] in the format MessagePack.

    Numbers have single precision. The bytes of all keys are alike, so they are written as an array.

    Args:
        frames: (k,) numbers of the frames.
        values: (k,) booleans, or (k, n) numbers, n < 16.
    """
    if values.dtype == np.bool_:
        value = np.dtype([("mark", "u1")])
    else:
        number = np.dtype([("mark", "u1"), ("number", ">f4")])
        value = np.dtype([("count", "u1"), ("numbers", number, values.shape[1:])])
    keys = np.empty(
        len(frames),
        [("head", "S7"), ("time", ">u4"), ("name", "S6"), ("value", value)],
    )
    keys["head"] = b"\x82\xa4time\xce"  # a map of two, a text of four, 32 bits
    keys["time"] = frames
    keys["name"] = b"\xa5value"
    if values.dtype == np.bool_:
        keys["value"]["mark"] = np.where(values, 0xC3, 0xC2)  # true, false
    else:
        keys["value"]["count"] = 0x90 + values.shape[1]  # a list of so many
        keys["value"]["numbers"]["mark"] = 0xCA  # a float of 32 bits
        keys["value"]["numbers"]["number"] = values
    return packed_list([keys.tobytes()], len(keys))
