"""Another policy of the same robot beside the one measured, such as one of another reward."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from app.evaluation.parts import Document, pair, paragraphs, table
from app.output import InputError

# What of the other policy's evaluation is shown; the rest stays in its own report.
SHOWN = ("policy_sha256", "trained", "episodes", "seed", "modes", "stairs", "long")


def read_beside(folder: Path, robot: str, form: str) -> dict[str, Any]:
    """What is shown of the evaluation in a folder, of format `form`.

    Raises:
        InputError: No evaluation of this robot's modes is there; says what is.
    """
    path = folder / "evaluation.json"
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(
            f"--beside: {path} cannot be read ({error.strerror}); give the folder of an evaluation"
        ) from None
    except ValueError:
        document = None
    if not isinstance(document, dict) or document.get("format") != form:
        raise InputError(f"--beside: {path} is not an evaluation of format {form}")
    if document.get("robot") != robot:
        raise InputError(f"--beside: {path} is of {document.get('robot')}, not of {robot}")
    if not document.get("modes"):
        raise InputError(f"--beside: {path} has no modes; measure it with --sections modes")
    return {key: document[key] for key in SHOWN if key in document}


def compared(document: Document) -> list[str]:
    """The lines of the section in report.md."""
    other = document["beside"]
    rows = [
        (
            mine["mode"],
            f"{mine['falls']} of {mine['episodes']}",
            f"{theirs['falls']} of {theirs['episodes']}",
            pair(mine, "error_m_median", "error_m_p95"),
            pair(theirs, "error_m_median", "error_m_p95"),
            pair(mine, "heading_deg_median", "heading_deg_p95", 1.0, "°"),
            pair(theirs, "heading_deg_median", "heading_deg_p95", 1.0, "°"),
        )
        for mine, theirs in both_rows(document)
    ]
    titles = (
        *("mode", "falls, this", "falls, other"),
        *("foot error, this, median / p95", "foot error, other"),
        *("heading, this, median / p95", "heading, other"),
    )
    stairs = _plain_stairs(document, other)
    titles_stairs = ("stairs", "success, this", "success, other")
    return paragraphs(
        "## Beside another policy",
        f"The other is {other['policy_sha256'][:12]}, evaluated with seed {other['seed']}.",
        [f"- This: {_made(document)}.", f"- Other: {_made(other)}."],
        table(titles, rows),
        "![Both policies, mode by mode](beside.png)",
        *([table(titles_stairs, stairs)] if stairs else []),
    )


def both_rows(document: Document) -> Iterator[tuple[Document, Document]]:
    """The rows of the modes that both have, in this one's order."""
    theirs = {row["mode"]: row for row in document["beside"]["modes"]}
    for row in document.get("modes", []):
        if row["mode"] in theirs:
            yield row, theirs[row["mode"]]


def _plain_stairs(document: Document, other: Document) -> list[tuple[str, str, str]]:
    """Success on the stairs without noise that both have walked."""

    def plain(rows: Document) -> dict[tuple[float, str], Document]:
        return {
            (row["rise_m"], row["way"]): row
            for row in rows.get("stairs", [])
            if row["noise_kind"] == "none"
        }

    mine, theirs = plain(document), plain(other)
    return [
        (
            f"{100 * rise_m:g} cm {way}",
            f"{100 * mine[rise_m, way]['success']:.1f} % of {mine[rise_m, way]['episodes']}",
            f"{100 * theirs[rise_m, way]['success']:.1f} % of {theirs[rise_m, way]['episodes']}",
        )
        for rise_m, way in mine
        if (rise_m, way) in theirs
    ]


def _made(document: Document) -> str:
    """The command that trained a policy and how long it had learned, as far as it says."""
    trained = document.get("trained") or {}
    if "command" not in trained:
        return "its file does not say how it was trained"
    return f"`{trained['command']}`, the checkpoint at {trained['samples']:,} samples"
