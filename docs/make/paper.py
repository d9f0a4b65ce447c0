"""The tables of docs/paper.md, from the reports in docs/evaluation.

    python -m docs.make.paper

writes each table anew between the comments that name it. Reports are those of `evaluate`; a robot
without one has no column.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from app.evaluation.parts import (
    JOINT_NOISE_WITHSTOOD_DEG,
    PAPER_PEAKS,
    TREAD_NOISE_WITHSTOOD_M,
)
from app.output import write_text
from controller.policy import POLICY_FOLDER
from sim.robots import get_robot

DOCS = Path(__file__).resolve().parents[1]
PAGE = DOCS / "paper.md"
_BLOCK = re.compile(r"(<!-- table (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)
# Of HRP-5P, for the policy and for model-based walking alike.
PAPER_FORCE_N, PAPER_MASS_KG = 1000.0, 103.0

Report = Mapping[str, Any]
Reports = Mapping[str, Report]


def read_reports(folder: Path = DOCS / "evaluation") -> dict[str, Report]:
    """The committed report of each robot, by its name."""
    return {
        path.parent.name: json.loads(path.read_text(encoding="utf-8"))
        for path in sorted(folder.glob("*/evaluation.json"))
    }


def page_with_tables(page: str, reports: Reports) -> str:
    """The page with each of its tables made from the reports.

    Raises:
        KeyError: It names a table that is none of `TABLES`.
    """
    return _BLOCK.sub(lambda at: f"{at[1]}\n{TABLES[at[2]](reports)}\n\n{at[3]}", page)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def _titles(reports: Reports) -> list[str]:
    return [f"{get_robot(name).title}, ours" for name in reports]


def _reports(reports: Reports) -> str:
    rows = []
    for name, report in reports.items():
        about = json.loads((POLICY_FOLDER / f"{name}.json").read_text(encoding="utf-8"))
        is_shipped = about["sha256"] == report["policy_sha256"]
        trained = report["trained"]
        rows.append(
            [
                get_robot(name).title,
                f"[report](evaluation/{name}/report.md)",
                f"{trained['samples'] / 1e6:.1f} M samples, code of {trained['git_revision']}",
                "the one that comes along" if is_shipped else "one before that which comes along",
            ]
        )
    return _table(["robot", "report", "policy", "which is"], rows)


def _modes(reports: Reports) -> str:
    names = [row["mode"] for row in next(iter(reports.values()))["modes"]]

    def told(report: Report, mode: str) -> str:
        row = next((row for row in report["modes"] if row["mode"] == mode), None)
        if row is None:
            return "-"
        falls = f"{row['falls']} of {row['episodes']}"
        if not row["landings"]:
            return falls
        median, p95 = row["error_m_median"], row["error_m_p95"]
        return f"{falls}; {100 * median:.1f} / {100 * p95:.1f} cm"

    rows = [[n.replace("_", " "), *(told(r, n) for r in reports.values())] for n in names]
    return _table(["mode", *_titles(reports)], rows)


def _stairs(reports: Reports) -> str:
    noises = (
        *(("tread", n / 100, f"treads ±{n} cm off", TREAD_NOISE_WITHSTOOD_M) for n in range(1, 7)),
        *(("joint", n, f"joints ±{n}° off", JOINT_NOISE_WITHSTOOD_DEG) for n in range(1, 7)),
    )

    def told(report: Report, kind: str, amount: float) -> str:
        found = {
            row["way"]: row
            for row in report.get("stairs", ())
            if (row["rise_m"], row["noise_kind"]) == (0.1, kind)
            and abs(row["noise"] - amount) < 1e-9
        }
        if not found:
            return "-"
        both = [f"{100 * found[way]['success']:.1f} %" for way in ("up", "down")]
        return f"{' / '.join(both)} of {found['up']['episodes']}"

    rows = [["as they seem", "withstood", *(told(r, "none", 0) for r in reports.values())]]
    for kind, amount, name, withstood in noises:
        paper = "withstood" if amount <= withstood else "falls off"
        rows.append([name, paper, *(told(r, kind, amount) for r in reports.values())])
    return _table(["stairs of 10 cm", "paper, HRP-5P", *_titles(reports)], rows)


def _peaks(reports: Reports) -> str:
    report = reports.get("hrp5p", {})
    ours = {row["joint"]: row for row in report.get("gait", {}).get("joints", ())}

    def told(joint: str, key: str) -> str:
        both = [ours[f"{side}{joint}"][key] for side in "LR" if f"{side}{joint}" in ours]
        return " / ".join(f"{value:.3g}" for value in both) or "-"

    joints = ("CY", "CR", "CP", "KP", "AP", "AR")  # HRP-5P's own names, in the paper's order
    rows = [
        [
            name,
            "{:g} / {:g}".format(*torque),
            told(joint, "peak_torque_nm"),
            "{:g} / {:g}".format(*speed),
            told(joint, "peak_speed_rad_s"),
        ]
        for joint, (name, (torque, speed)) in zip(joints, PAPER_PEAKS.items(), strict=True)
    ]
    head = ["left / right", "paper, N m", "ours, N m", "paper, rad/s", "ours, rad/s"]
    return _table(head, rows)


def _gait(reports: Reports) -> str:
    force = f"{PAPER_FORCE_N / PAPER_MASS_KG / 9.81:.2f} weights, HRP-5P"

    def row(name: str, paper: str, told: Callable[[Report], str]) -> list[str]:
        return [name, paper, *(told(report["gait"]) for report in reports.values())]

    rows = [
        row(
            "vertical force under a foot, peak",
            force,
            lambda gait: f"{max(gait['force_peak']):.2f} weights",
        ),
        row(
            "contact is what the phase indicator asks for",
            "",
            lambda gait: f"{100 * gait['contact_agreement']:.1f} % of the time",
        ),
        row("walked straight", "", lambda gait: f"{gait['walks'] - gait['falls']} walks of 10 s"),
    ]
    return _table(["gait", "paper", *_titles(reports)], rows)


TABLES: Mapping[str, Callable[[Reports], str]] = {
    "reports": _reports,
    "modes": _modes,
    "stairs": _stairs,
    "peaks": _peaks,
    "gait": _gait,
}

if __name__ == "__main__":
    write_text(PAGE, page_with_tables(PAGE.read_text(encoding="utf-8"), read_reports()))
