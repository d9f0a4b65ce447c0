"""How reports write numbers, names and tables."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any


def table(titles: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """A Markdown table."""
    lines = ["| " + " | ".join(titles) + " |", "|" + "---|" * len(titles)]
    return lines + ["| " + " | ".join(row) + " |" for row in rows]


def cell(value: float | None, form: str = "{:.1f}", scale: float = 1.0) -> str:
    """A number as it stands in a table."""
    return "-" if value is None else form.format(scale * value)


def pair(
    row: Mapping[str, Any], first: str, second: str, scale: float = 100.0, unit: str = " cm"
) -> str:
    """Two numbers of a row in one cell, by default lengths in metres."""
    if row[first] is None:
        return "-"
    return f"{scale * row[first]:.1f} / {scale * row[second]:.1f}{unit}"


def plain_joint(name: str) -> str:
    """A left joint's name in words: L_HIP_P, left_hip_pitch_joint and LCP all give hip pitch."""
    bare = re.sub(r"^(left|l)_?|_joint$", "", name.lower())
    bare = re.sub(r"^([cka])([ypr])$", r"\1_\2", bare)
    words = [_JOINT_WORDS.get(word, word) for word in bare.split("_")]
    return "knee" if words[0] == "knee" else " ".join(words)


_JOINT_WORDS = {"c": "hip", "k": "knee", "a": "ankle", "y": "yaw", "p": "pitch", "r": "roll"}
