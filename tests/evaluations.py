"""Evaluations made up for tests: results of parts, and whole documents."""

from __future__ import annotations

from typing import Any

import numpy as np

from app.commands import evaluate
from app.commands.evaluate import SECTION_NAMES
from app.evaluation.parts import EvaluationSetup
from app.evaluation.sections import SECTIONS, mode_row
from controller.assessment import ModeResult
from controller.policy import load_policy
from sim.robots import get_robot

ROBOT = get_robot("jvrc1")
WORDS = ["evaluate", "--episodes", "1", "--workers", "2"]
LIMITS = {"x_m": [-0.1, 0.3], "y_m": [0.17, 0.3], "yaw_rad": [-0.1, 0.3], "z_m": [-0.01, 0.01]}
CURVES = ("force_mean", "force_low", "force_high", "contact_mean", "indicator_mean")


def stairs_row(way: str, rise_m: float, success: float, kind: str = "none", noise: float = 0.0):
    """A row of the section stairs, made up."""
    return {
        "way": way,
        "rise_m": rise_m,
        "noise_kind": kind,
        "noise": noise,
        "episodes": 100,
        "success": success,
        "length_s_mean": 10 * success,
    }


def measured_results() -> dict[str, Any]:
    """Parts of the sections stairs and limits, made up."""
    kinds = [
        {"x_m": x, "y_m": y, "yaw_rad": yaw, "success": 0.9 + x, "error_m_p95": 0.01 + abs(x)}
        for x in (-0.1, 0.0, 0.1)
        for y in (0.2, 0.3)
        for yaw in (0.0, 0.3)
    ]
    return {
        "stairs-a": stairs_row("up", 0.10, 0.99),
        "stairs-b": stairs_row("down", 0.10, 0.97),
        "stairs-c": stairs_row("up", 0.15, 0.985),
        "stairs-d": stairs_row("up", 0.20, 0.5),
        "stairs-e": stairs_row("down", 0.10, 1.0, "joint", 3.0),
        "limits-map": {"walks_each": 3, "kinds": kinds},
        "limits-region": {
            "walks_each": 100,
            "tried": [{"limits": LIMITS, "success": 0.8}, {"limits": LIMITS, "success": 0.995}],
            "found": True,
            "landings": 900,
            "sole_error_m_p99": 0.01234,
        },
        "limits-sway": {
            "walks": 9,
            "body_beyond_box_m": {"head": [-0.2, -0.1], "hips": [0.05, 0.0701]},
        },
    }


def evaluation_setup(episodes: int = 100) -> EvaluationSetup:
    return EvaluationSetup(robot=ROBOT, controller=load_policy(ROBOT), episodes=episodes, seed=1)


def document_of(results, stored=None, names=SECTION_NAMES):
    """evaluation.json of these results, of sections of these names."""
    setup = evaluation_setup()
    parts = [part for name in names for part in SECTIONS[name](setup)]
    return evaluate.document_of(setup, parts, results, stored)


def made_up(mode: str) -> ModeResult:
    return ModeResult(
        mode=mode,
        episodes=1,
        falls=0,
        episode_ticks=np.array([400]),
        landing_error_m=np.array([0.05, 0.01, 0.02]),
        landing_heading_error_rad=np.radians([1.0, 3.0, 2.0]),
        landing_offset_m=np.array([[0.03, -0.04], [-0.01, 0.0], [0.0, 0.02]]),
    )


def made_up_evaluation(scale: float, **who) -> dict:
    """evaluation.json with every section but limits; figures grow with the scale."""
    walk = {
        "pelvis_height_m": {"median": 0.8, "least": 0.75, "at_rest": 0.8},
        "pelvis_bob_m": 0.01 * scale,
        "swing_apex_m": {"median": 0.05 * scale, "p95": 0.1},
        "touchdown_speed_m_s": {"median": 0.15, "p95": 0.3},
        "peak_force_weights": 1.1 * scale,
        "cost_of_transport": 0.4 * scale,
        "speed_m_s": 0.28,
    }
    loads = {"peak_torque_nm": 50.0 * scale, "peak_speed_rad_s": 1.5, "rms_torque_nm": 20.0}
    limits = {"torque_limit_nm": 600.0, "speed_limit_rad_s": 8.0}
    joints: list[dict[str, Any]] = [
        {"joint": joint.name, **loads, **limits} for joint in ROBOT.joints
    ]
    joints[-6]["peak_torque_nm"] *= 1.5  # the right leg's first joint
    walks = {"walks": 8, "falls": 2}
    return {
        **document_of({"modes-forward": mode_row(made_up("forward"))}),
        **who,
        "stairs": [
            stairs_row(way, 0.10, 0.9 / scale, kind, noise)
            for way in ("up", "down")
            for kind, noise in (("none", 0.0), ("tread", 0.02), ("joint", 3.0))
        ],
        "gait": {
            **walks,
            "step_m": 0.3,
            "joints": joints,
            "joint_jerk_rad_s3": 150.0,
            "pelvis_standing_m": 0.8,
            "walk": walk,
            "cycle_time_s": [0.5, 1.5],
            **{name: [[0.5, 1.0], [1.0, 0.5]] for name in CURVES},
            "force_peak": [1.1, 1.15],
            "contact_agreement": 1.0,
            "lift_off_lag_s": 0.0,
            "touch_down_lag_s": None,
        },
        "push": [
            {
                "direction": "from behind",
                "walks": 8,
                "impulses_ns": [6.2, 12.5],
                "success": [1, 0.5],
            }
        ],
        "energy": [
            {
                **walks,
                "kind": "sideways",
                "step": [0.0, 0.3, 0.0],
                "speed_m_s": 0.1,
                "cost_of_transport": 0.7 * scale,
                "power_w": 20.0,
            }
        ],
        "pace": [
            {**walks, "step_s": 1.1, "step_m": 0.3, "speed_m_s": 0.28},
            {**walks, "step_s": 0.5, "step_m": 0.3, "falls": 8, "speed_m_s": None},
        ],
        "hardware": [
            {
                **walks,
                "what": "delay",
                "value": 5.0,
                "unit": "ms",
                "error_m_median": 0.01 * scale,
                "error_m_p95": 0.02 * scale,
            },
            {
                **walks,
                "what": "grip",
                "value": 0.1,
                "unit": "times the model's friction",
                "falls": 8,
                "error_m_median": None,
                "error_m_p95": None,
            },
        ],
        "long": {"walks": 8, "seconds": 60.0, "falls": 1, "fell_at_s": [12.0]},
    }
