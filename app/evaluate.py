"""The command `evaluate`: a policy's falls and foot errors, mode by mode, as a report."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from app.errors import ExitCode, as_bad_input
from app.evaluate_options import EvaluateOptions
from app.inputs import find_robot
from app.output import make_folder, replacing, to_json, write_text
from app.progress import ProgressBar
from app.report import installed_versions
from controller.assess import ModeResult, assess_mode, at_navigation_rate
from controller.policy import PolicyError, load_policy
from controller.sequences import MODES

FORMAT = "policy-evaluation/1"
EPISODES_AT_ONCE = 250
COLUMNS = (
    ("mode", "mode", "{}"),
    ("episodes", "episodes", "{}"),
    ("falls", "falls", "{}"),
    ("landings", "steps", "{}"),
    ("error_m_median", "foot error, median", "{:.1f} cm"),
    ("error_m_p95", "95th percentile", "{:.1f} cm"),
    ("error_m_p99", "99th percentile", "{:.1f} cm"),
    ("heading_deg_median", "heading error, median", "{:.1f}°"),
    ("heading_deg_p95", "95th percentile", "{:.1f}°"),
)


def run(options: EvaluateOptions) -> int:
    """Carries the command out; returns the exit code."""
    robot = find_robot(options.robot)
    with as_bad_input(PolicyError):
        policy = load_policy(robot, options.policy)
    make_folder(options.out, option="--out")
    modes: list[str | None] = [*MODES, "standing", None]
    results: list[ModeResult] = []
    document: dict[str, Any] = {}
    with ProgressBar("modes", len(modes)) as bar:
        for mode in modes:
            bar.update(len(results), mode or "mixed")
            results.append(_assess(options, robot, policy, mode))
            document = _document(options, policy.about, results)
            write_text(options.out / "evaluation.json", to_json(document))
            write_text(options.out / "report.md", report(document))
    draw_errors(options.out / "errors.png", results)
    print(to_json(document) if options.json else report(document), end="")
    return ExitCode.DONE


def _assess(options: EvaluateOptions, robot: Any, policy: Any, mode: str | None) -> ModeResult:
    """All episodes of one mode, in portions that fit the memory."""
    portions = []
    for number, first in enumerate(range(0, options.episodes, EPISODES_AT_ONCE)):
        portions.append(
            assess_mode(
                robot,
                policy,
                mode,
                episodes=min(EPISODES_AT_ONCE, options.episodes - first),
                seed=options.seed + 1000 * number,
                threads=options.workers or os.cpu_count() or 1,
                config=at_navigation_rate(),
            )
        )
    return ModeResult.joined(portions)


def _document(
    options: EvaluateOptions, about: Mapping[str, Any], results: Sequence[ModeResult]
) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "robot": options.robot,
        "policy_sha256": about["sha256"],
        "trained": about.get("trained"),
        "seed": options.seed,
        "versions": installed_versions(),
        "modes": [
            {key: None if value != value else value for key, value in result.summary.items()}
            for result in results
        ],
    }


def report(document: Mapping[str, Any]) -> str:
    """The Markdown report."""
    lines = [
        f"# How well {document['robot']} follows its steps",
        "",
        "Held-out episodes of 10 s, physics at 1 kHz, policy without noise. A foot error is the "
        "horizontal distance between where a foot rests at the end of its step's period and "
        "where the step was asked for.",
        "",
        "| " + " | ".join(title for _, title, _ in COLUMNS) + " |",
        "|" + "---|" * len(COLUMNS),
    ]
    for mode in document["modes"]:
        lines.append("| " + " | ".join(_cell(mode, *column) for column in COLUMNS) + " |")
    lines += ["", f"Policy {document['policy_sha256'][:12]}, seed {document['seed']}.", ""]
    return "\n".join(lines)


def _cell(mode: Mapping[str, Any], key: str, title: str, form: str) -> str:
    value = mode[key]
    if value is None:
        return "-"
    return form.format(100 * value if "_m_" in key else value)


def draw_errors(path: Path, results: Sequence[ModeResult]) -> None:
    """Cumulative distribution of the foot error of every mode that takes steps."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.subplots()
    for result in results:
        if len(result.landing_error_m):
            error_cm = 100 * np.sort(result.landing_error_m)
            axes.plot(error_cm, np.linspace(0, 1, len(error_cm)), label=result.mode)
    axes.set(xlabel="foot error, cm", ylabel="share of steps", xlim=(0, 8), ylim=(0, 1))
    axes.grid(alpha=0.3)
    axes.legend(frameon=False, fontsize=8)
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=120)
