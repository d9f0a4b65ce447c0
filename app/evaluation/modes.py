"""Success of an evaluation: every flat mode, stairs, and a minute of mixed walking."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from app.evaluation.parts import Bench, Part, Results
from controller.assessment import ModeResult, assess_mode, at_navigation_rate
from controller.evaluation.rollouts import AT_ONCE, portions, set_off, walk
from controller.gait import CONTROL_PERIOD_S
from controller.step_sequences import MODES, draw_track

EPISODE_S = 10.0
LONG_WALK_S = 60.0
STAIR_RISES_M = (0.10, 0.15)
TREAD_NOISE_M = (0.01, 0.02, 0.03, 0.04, 0.05, 0.06)
JOINT_NOISE_DEG = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)


def modes_parts(bench: Bench) -> list[Part]:
    """Falls and foot errors of every flat mode."""

    def measure(results: Results, mode: str | None) -> dict[str, Any]:
        return mode_row(_assess(bench, mode, bench.episodes))

    return [
        Part(
            section="modes",
            name=f"modes-{mode or 'mixed'}",
            robot_seconds=bench.episodes * EPISODE_S,
            measure=partial(measure, mode=mode),
        )
        for mode in (*MODES, "standing", None)
    ]


def _assess(bench: Bench, mode: str | None, episodes: int, **settings: float) -> ModeResult:
    """Episodes of one mode, in portions that fit the memory."""
    return ModeResult.joined(
        [
            assess_mode(
                bench.robot,
                bench.policy,
                mode,
                episodes=min(AT_ONCE, episodes - first),
                seed=bench.seed + 1000 * number,
                threads=bench.threads,
                config=at_navigation_rate(),
                **settings,
            )
            for number, first in enumerate(range(0, episodes, AT_ONCE))
        ]
    )


def mode_row(result: ModeResult) -> dict[str, Any]:
    """A mode's numbers; None where no foot was set down.

    `error_m_quantiles` are the foot error's 0, 2, ... 100 % quantiles.
    """
    row: dict[str, Any] = dict(result.summary)
    landed = len(result.landing_error_m) > 0
    for axis, name in enumerate(("along", "across")):
        off_m = np.abs(result.landing_offset_m[:, axis])
        for share, suffix in ((50, "median"), (95, "p95")):
            key = f"{name}_m_{suffix}"
            row[key] = float(np.percentile(off_m, share)) if landed else None
    shares = np.arange(0, 101, 2)
    row["error_m_quantiles"] = (
        np.percentile(result.landing_error_m, shares).tolist() if landed else None
    )
    return row


def stairs_parts(bench: Bench) -> list[Part]:
    """Stairs up and down: without noise, then with noise on treads and on joints."""
    few = bench.share(5)
    cases: list[tuple[float, str, float, int]] = []
    for rise_m in STAIR_RISES_M:
        cases.append((rise_m, "none", 0.0, bench.episodes))
    cases += [(STAIR_RISES_M[0], "tread", noise_m, few) for noise_m in TREAD_NOISE_M]
    cases += [(STAIR_RISES_M[0], "joint", noise_deg, few) for noise_deg in JOINT_NOISE_DEG]

    def measure(results: Results, way: str, rise_m: float, kind: str, noise: float, n: int) -> Any:
        settings = {"rise_m": rise_m}
        if kind == "tread":
            settings["tread_error_m"] = noise
        elif kind == "joint":
            settings["joint_noise_deg"] = noise
        result = _assess(bench, f"stairs_{way}", n, **settings)
        return {
            "way": way,
            "rise_m": rise_m,
            "noise_kind": kind,
            "noise": noise,
            "length_s_mean": float(result.episode_ticks.mean()) * CONTROL_PERIOD_S,
            **mode_row(result),
        }

    return [
        Part(
            section="stairs",
            name=f"stairs-{way}-{100 * rise_m:g}cm-{kind}-{noise:g}",
            robot_seconds=episodes * EPISODE_S,
            measure=partial(measure, way=way, rise_m=rise_m, kind=kind, noise=noise, n=episodes),
        )
        for rise_m, kind, noise, episodes in cases
        for way in ("up", "down")
    ]


def long_parts(bench: Bench) -> list[Part]:
    """A minute of walking in all flat modes, changing from one to the next."""
    count = bench.share(4)
    steps = int(LONG_WALK_S / bench.robot.gait.step_s) + 2

    def draw(rng: np.random.Generator, row: int, feet: np.ndarray) -> Any:
        while True:
            track = draw_track(rng, bench.robot.training_model, feet, steps=steps)
            if len(track.side) > steps:  # not one of those that only stand
                return track

    def measure(results: Results) -> dict[str, Any]:
        survived: list[int] = []
        for rows, seed in portions(count, bench.seed):
            walker = set_off(
                bench.robot,
                draw,
                count=len(rows),
                seed=seed,
                threads=bench.threads,
            )
            lasted = np.zeros(len(rows), dtype=np.int64)
            for tick in walk(walker, bench.policy, round(LONG_WALK_S / CONTROL_PERIOD_S)):
                lasted += tick.upright
            survived += lasted.tolist()
        ticks = round(LONG_WALK_S / CONTROL_PERIOD_S)
        falls = sum(lasted < ticks for lasted in survived)
        fallen_s = sorted(lasted * CONTROL_PERIOD_S for lasted in survived if lasted < ticks)
        return {"walks": count, "seconds": LONG_WALK_S, "falls": falls, "fell_at_s": fallen_s}

    seconds = count * LONG_WALK_S
    return [Part(section="long", name="long", robot_seconds=seconds, measure=measure)]
