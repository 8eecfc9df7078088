"""Time series of a run: recording → one file → back."""

from __future__ import annotations

import json
import os
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .errors import RecordingError
from .files import whole_file

__all__ = ["Recording"]

_FORMAT = 1
_META = "meta"
_RESERVED = frozenset({_META, "file", "allow_pickle"})
#: What reading a file that is none of ours, or damaged, ends in; `load` says which. zipfile answers
#: unknown compression with NotImplementedError, encryption with RuntimeError; sizes made of garbage
#: end in MemoryError or OverflowError.
_UNREADABLE = (
    OSError, ValueError, KeyError, TypeError, EOFError, RuntimeError, MemoryError, OverflowError,
    NotImplementedError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip

Array = npt.NDArray[Any]


class Recording:
    """Time series of one run: `meta` (JSON-able) and `channels` (first axis = control tick).

    Args:
        meta: what the series belong to; kept as JSON data (tuples become lists).
        channels: arrays of bool, int or float with equally long first axes.

    Raises:
        RecordingError: meta is not JSON-able, or the channels do not fit together."""

    def __init__(self, meta: Mapping[str, Any], channels: Mapping[str, npt.ArrayLike]) -> None:
        self.meta: dict[str, Any] = _plain(meta)
        self.channels: dict[str, Array] = {}
        for name, values in channels.items():
            array = np.asarray(values)
            _check_name(name)
            if array.dtype.kind not in "biuf" or array.ndim < 1:
                raise RecordingError(
                    f"channel {name!r} has dtype {array.dtype} and shape {array.shape}; expected "
                    "bool, int or float with the tick as first axis"
                )
            self.channels[name] = array
        lengths = {name: len(array) for name, array in self.channels.items()}
        if len(set(lengths.values())) > 1:
            raise RecordingError(f"channels differ in their number of ticks: {lengths}")

    def __getitem__(self, name: str) -> Array:
        """Return the channel `name`."""
        if name not in self.channels:
            known = ", ".join(self.channels) or "none"
            raise RecordingError(f"no channel {name!r} in this recording; there are: {known}")
        return self.channels[name]

    def __contains__(self, name: object) -> bool:
        return name in self.channels

    @property
    def magnitude_names(self) -> list[str]:
        """Names of the columns of alpha: the contact's, or contact.1, contact.2, … if several."""
        names = [str(name) for name in self.meta.get("contact_names", [])]
        owners = list(self.meta.get("columns", range(len(names))))
        return [
            names[i] if owners.count(i) == 1 else f"{names[i]}.{owners[:k].count(i) + 1}"
            for k, i in enumerate(owners)
        ]

    def __len__(self) -> int:
        """Return the number of control ticks."""
        return len(next(iter(self.channels.values()), ()))

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write one .npz file: complete under its final name, or not there at all.

        Raises:
            RecordingError: the file cannot be written; an older file of the name is kept."""
        target = Path(path)
        text = json.dumps({"format": _FORMAT, "meta": self.meta}, allow_nan=False)
        arrays: dict[str, Any] = {**self.channels, _META: np.array(text)}
        try:
            with whole_file(target) as unfinished, open(unfinished, "xb") as file:
                np.savez(file, allow_pickle=False, **arrays)
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise RecordingError(f"cannot write the recording {target}: {error}") from error
        return target

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Recording:
        """Read a file written by `save`; checksums are verified, nothing is unpickled.

        Raises:
            RecordingError: no such file, damaged, or not a recording."""
        source = Path(path)
        if not source.is_file():
            raise RecordingError(f"no recording {source}: there is no such file")
        try:
            with zipfile.ZipFile(source) as archive:
                damaged = archive.testzip()
            if damaged is not None:
                raise RecordingError(f"{source} is damaged: the checksum of {damaged} is wrong")
            with np.load(source, allow_pickle=False) as stored:
                arrays = {name: stored[name] for name in stored.files}
            content = json.loads(str(arrays.pop(_META)[()]))
            version, meta = content["format"], content["meta"]
        except _UNREADABLE as error:
            raise RecordingError(
                f"{source} is not a recording, or is damaged: {type(error).__name__}: {error}"
            ) from error
        if version != _FORMAT:
            raise RecordingError(
                f"{source} has recording format {version!r}; this version reads format {_FORMAT}"
            )
        return cls(meta, arrays)


def _check_name(name: str) -> None:
    if not name.isidentifier() or name in _RESERVED:
        raise RecordingError(f"{name!r} cannot name a channel; use an identifier, not {_RESERVED}")


def _plain(meta: Mapping[str, Any]) -> dict[str, Any]:
    try:
        plain = json.loads(json.dumps(dict(meta), allow_nan=False))
    except (TypeError, ValueError) as error:
        raise RecordingError(f"meta must be JSON-able (finite numbers, text): {error}") from error
    return dict(plain)
