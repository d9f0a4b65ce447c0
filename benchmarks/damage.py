"""What damage there is: bytes that change, odd values in documents and YAML, cut pictures."""

from __future__ import annotations

import contextlib
import json
import math
import random
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

# Whether a word is absurd depends on where it stands: each is tried everywhere.
ODD = [
    *[
        "-",
        "--",
        "nan",
        "inf",
        "-inf",
        "1e400",
        "-0.0",
        "1e-320",
        "0",
        "-1",
        "0x10",
        "1_0",
        "2,1",
        "2,1,1.57,0",
        "nan,0,0",
        "1e300,0,0",
    ],
    *[
        "1e9,1e9,0",
        "/",
        ".",
        "..",
        "/dev/null",
        "/dev/full",
        "/proc/self/mem",
        "/root/x",
        "~",
        "*",
        "true",
        "none",
        "[]",
        "{}",
        "null",
    ],
    *[
        "file:///etc/passwd",
        "map.png/x",
        "a.png",
        "a.npz",
        "--help",
        "%s",
        "$HOME",
        "é",
        "٣",
        "99999999999999999999",
    ],
    *("", " ", "\t", "\n", "a\nb", "2 1 1", "\udcff", "a" * 5000, "x" * 255 + ".png"),
    *("9" * 400, "1" * 5000),
]
WORDS = [
    *ODD,
    "[1, 2]",
    "{a: 1}",
    "&a [*a]",
    "!!python/object:os.system x",
    "1e-2",
    "|",
    ">",
    "? x",
]


def damaged(data: bytes, draw: random.Random) -> bytes:
    """The bytes with some changed, cut, put in, doubled, or gone."""
    changed = bytearray(data)
    for _ in range(draw.choice((1, 1, 1, 2, 5, 30))):
        at = (
            draw.randrange(len(changed) + 1)
            if draw.random() < 0.6
            else draw.randrange(1 + min(len(changed), 64))
        )
        how = draw.randrange(6)
        if how == 0 and changed:
            changed[min(at, len(changed) - 1)] ^= 1 << draw.randrange(8)
        elif how == 1 and changed:
            changed[min(at, len(changed) - 1)] = draw.choice((0, 255, draw.randrange(256)))
        elif how == 2 and draw.random() < 0.5:
            del changed[at:]
        elif how == 3:
            del changed[at : at + draw.choice((1, 2, 4, 50))]
        elif how == 4:
            changed[at:at] = draw.randbytes(draw.choice((1, 4, 50)))
        else:
            changed[at:at] = changed[at : at + draw.choice((4, 50, 500))]
    return bytes(changed)


def odd_document(value: object, draw: random.Random) -> object:
    """A JSON document in which one value, somewhere, is another, is gone, or is buried in lists."""
    if isinstance(value, dict) and value and draw.random() < 0.9:
        key = draw.choice(list(value))
        if draw.random() < 0.15:
            return {k: v for k, v in value.items() if k != key}
        return {**value, key: odd_document(value[key], draw)}
    if isinstance(value, list) and value and draw.random() < 0.8:
        at = draw.randrange(len(value))
        if draw.random() < 0.15:
            return value[:at] + value[at + 1 :]
        return [*value[:at], odd_document(value[at], draw), *value[at + 1 :]]
    odd = [
        None,
        True,
        -1,
        0,
        10**30,
        1e308,
        float("nan"),
        float("inf"),
        "",
        [],
        {},
        [value],
        {"a": value},
    ]
    return draw.choice([*odd, draw.choice(ODD), str(value), [[[[]]]], [value] * 1000])


def odd_json(text: str, draw: random.Random) -> bytes:
    """JSON text with its bytes damaged, a value replaced, or nested too deep to read."""
    how = draw.random()
    if how < 0.3:
        return damaged(text.encode(), draw)
    if how < 0.33:
        return b"[" * 100_000
    return json.dumps(odd_document(json.loads(text), draw)).encode("utf-8", "surrogatepass")


def odd_state(value: Any, draw: random.Random) -> Any:
    """The state of a training run in which something, somewhere, is another, or is gone."""
    if isinstance(value, dict) and value and draw.random() < 0.95:
        key = draw.choice(list(value))
        if draw.random() < 0.1:
            return {k: v for k, v in value.items() if k != key}
        return {**value, key: odd_state(value[key], draw)}
    if isinstance(value, list | tuple) and value and draw.random() < 0.8:
        at = draw.randrange(len(value))
        return type(value)([*value[:at], odd_state(value[at], draw), *value[at + 1 :]])
    if isinstance(value, str) and value.startswith(("{", "[")) and draw.random() < 0.8:
        try:
            return odd_json(value, draw).decode("utf-8", "replace")
        except ValueError:  # it is damaged already
            return damaged(value.encode(), draw).decode("utf-8", "replace")
    if isinstance(value, torch.Tensor) and draw.random() < 0.9:
        return odd_tensor(value, draw)
    return odd_document(value if isinstance(value, int | float | str) else None, draw)


def odd_tensor(tensor: torch.Tensor, draw: random.Random) -> torch.Tensor:
    """A tensor with one number, the shape or the type changed, or one that claims far more."""
    one, number = tensor.clone(), draw.choice((math.nan, math.inf, -math.inf, -1.0, 1e30, 0.0))
    if one.numel():
        one.view(-1)[draw.randrange(one.numel())] = number
    odd = (
        one,
        one,
        torch.full_like(tensor, number),
        tensor.reshape(-1)[:-1].clone(),
        tensor[None],
        tensor.reshape(tensor.shape[::-1]).clone(),
        tensor.double(),
        tensor.long(),
        tensor.to_sparse(),
        torch.zeros(()),
        torch.zeros(1).expand(10**10),
        torch.zeros([1] * tensor.ndim).expand(tensor.shape),
    )
    return draw.choice(odd)


def odd_yaml(text: str, draw: random.Random) -> bytes:
    """A map's YAML with lines that are odd, gone, there twice, or damaged."""
    lines = text.splitlines()
    for _ in range(draw.choice((1, 1, 2, 4))):
        at = draw.randrange(len(lines))
        how = draw.randrange(6)
        if how == 0:
            lines.append(lines[at])
        elif how == 1 and len(lines) > 1:
            del lines[at]
        elif how == 2:
            lines[at] = draw.choice(WORDS)
        elif how == 3:
            return damaged("\n".join(lines).encode("utf-8", "surrogatepass"), draw)
        else:
            lines[at] = (
                lines[at].split(":")[0] + ":" + draw.choice((" ", "", "\t")) + draw.choice(WORDS)
            )
    if draw.random() < 0.03:
        nested = [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 12)]
        lines = [
            "a0: &a0 x",
            *nested,
            *lines[1:],
            draw.choice(("image", "origin", "negate")) + ": *a11",
        ]
    return "\n".join(lines).encode("utf-8", "surrogatepass")


def odd_picture(draw: random.Random) -> tuple[str, bytes]:
    """A small picture of a room in one of the formats, as a file name and damaged bytes."""
    grey = np.full((60, 80), 254, np.uint8)
    grey[:2], grey[:, :2], grey[20:30, 50:] = 0, 0, 0
    form = draw.choice((".png", ".pgm", ".bmp", ".jpg", ".png", ".ppm", ".tif", ".webp"))
    many = draw.choice(
        (grey, cv2.merge([grey] * 3), cv2.merge([grey] * 4), grey.astype(np.uint16) * 257)
    )
    data = _encoded(form, many) or _encoded(form, grey)
    if form == ".pgm" and draw.random() < 0.3:
        sizes = draw.choice((b"60000 60000", b"999999999 999999999", b"0 0", b"-1 60", b"1 4800"))
        data = data.replace(b"80 60", sizes)
    if form == ".png" and draw.random() < 0.2:
        width = draw.choice((0, 1, 60_000, 2**31 - 1)).to_bytes(4, "big")
        data = data[:16] + width + draw.choice((width, data[20:24])) + data[24:]
    return f"map{form}", data if draw.random() < 0.05 else damaged(data, draw)


def _encoded(form: str, picture: NDArray[Any]) -> bytes:
    """A picture as a file of this form; empty where the form cannot hold it."""
    with contextlib.suppress(cv2.error):
        done, data = cv2.imencode(form, picture)
        return data.tobytes() if done and isinstance(data, np.ndarray) else b""
    return b""
