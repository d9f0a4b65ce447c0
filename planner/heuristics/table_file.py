"""Files of tables: dataclasses of arrays and numbers, kept from one process to the next.

A file is a digest, the length of a header, the header as JSON, and the arrays one after the other.
The digest is that of the key and all that follows it, so a file that was damaged, or made for
something else, is not read.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from maps.files import written_whole

_ALIGNED = 64
_LENGTH_BYTES = 8
_DIGEST_BYTES = hashlib.sha256().digest_size


def write_tables(path: Path, key: str, tables: Sequence[Any]) -> None:
    """Writes dataclasses, whose fields are arrays and numbers, whole or not at all.

    key: what they were made for. Raises OSError where the file cannot be written.
    """
    arrays, heads, end = [], [], 0
    for table in tables:
        head: dict[str, Any] = {}
        for field in dataclasses.fields(table):
            value = getattr(table, field.name)
            if isinstance(value, np.ndarray):
                value = np.ascontiguousarray(value)
                arrays.append((end, value))
                head[field.name] = [end, value.dtype.str, value.shape]
                end += -(-value.nbytes // _ALIGNED) * _ALIGNED
            else:
                head[field.name] = value
        heads.append(head)
    header = json.dumps(heads).encode()
    body = bytearray(_arrays_at(len(header)) - _DIGEST_BYTES + end)
    body[:_LENGTH_BYTES] = len(header).to_bytes(_LENGTH_BYTES, "little")
    body[_LENGTH_BYTES : _LENGTH_BYTES + len(header)] = header
    for begin, array in arrays:
        at = _arrays_at(len(header)) - _DIGEST_BYTES + begin
        body[at : at + array.nbytes] = array.tobytes()
    digest = hashlib.sha256(key.encode())
    digest.update(body)
    with written_whole(path) as temporary, temporary.open("wb") as file:
        file.write(digest.digest())
        file.write(body)


def read_tables(path: Path, key: str, kinds: Sequence[type[Any]]) -> list[Any] | None:
    """The dataclasses of these kinds in a file; None unless it is whole and made for the key.

    Arrays are C-contiguous, and may be written to, which does not change the file.
    """
    try:
        with path.open("rb") as file:
            memory = bytearray(path.stat().st_size)
            file.readinto(memory)
    except OSError:
        return None
    # Not mapped: a file that somebody cuts short would take the process with it.
    digest = hashlib.sha256(key.encode())
    digest.update(memoryview(memory)[_DIGEST_BYTES:])
    if memory[:_DIGEST_BYTES] != digest.digest():
        return None
    at = _DIGEST_BYTES + _LENGTH_BYTES
    length = int.from_bytes(memory[_DIGEST_BYTES:at], "little")
    heads = json.loads(memory[at : at + length])

    def value(stored: Any) -> Any:
        if not isinstance(stored, list):
            return stored
        begin, dtype, shape = stored
        array = np.frombuffer(memory, dtype, math.prod(shape), _arrays_at(length) + begin)
        return array.reshape(shape)

    return [
        kind(**{name: value(stored) for name, stored in head.items()})
        for kind, head in zip(kinds, heads, strict=True)
    ]


def _arrays_at(header_bytes: int) -> int:
    """Where in a file the arrays begin."""
    return -(-(_DIGEST_BYTES + _LENGTH_BYTES + header_bytes) // _ALIGNED) * _ALIGNED
