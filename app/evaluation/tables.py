"""Tables and cells of the Markdown report."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

from app.evaluation.parts import Document

CellText = Callable[[Document], str]  # of a row


def plain_joint(name: str) -> str:
    """A left joint's name in words: L_HIP_P, left_hip_pitch_joint and LCP all give hip pitch."""
    bare = re.sub(r"^(left|l)_?|_joint$", "", name.lower())
    bare = re.sub(r"^([cka])([ypr])$", r"\1_\2", bare)
    words = [_JOINT_WORDS.get(word, word) for word in bare.split("_")]
    return "knee" if words[0] == "knee" else " ".join(words)


_JOINT_WORDS = {"c": "hip", "k": "knee", "a": "ankle", "y": "yaw", "p": "pitch", "r": "roll"}


def table(rows: Sequence[Document], *columns: tuple[str, str | CellText]) -> list[str]:
    """A Markdown table; a column is its title, and a format or a function of a row's fields."""
    cells = [
        [cell.format_map(row) if isinstance(cell, str) else cell(row) for _, cell in columns]
        for row in rows
    ]
    head, *lines = (
        "| " + " | ".join(line) + " |" for line in ([title for title, _ in columns], *cells)
    )
    return [head, "|" + "---|" * len(columns), *lines]


def paragraphs(*parts: str | Sequence[str]) -> list[str]:
    """The lines of a section: parts of one line or several, with a blank line between."""
    lines: list[str] = []
    for part in parts:
        lines += ["", part] if isinstance(part, str) else ["", *part]
    return lines[1:]


def shown(value: float | None, form: str, scale: float = 1.0) -> str:
    """A number that may not be known."""
    return "-" if value is None else form.format(scale * value)


def number(name: str, form: str, scale: float = 1.0) -> CellText:
    """A number of a row that may not be known."""
    return lambda row: shown(row[name], form, scale)


def spread_of(name: str, scale: float = 100.0, unit: str = " cm") -> CellText:
    """Median and 95th percentile, by default of lengths in metres."""

    def spread(row: Document) -> str:
        if row[f"{name}median"] is None:
            return "-"
        return f"{scale * row[f'{name}median']:.1f} / {scale * row[f'{name}p95']:.1f}{unit}"

    return spread


HEADING = spread_of("heading_deg_", 1.0, "°")
