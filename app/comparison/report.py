"""What `compare` finds of each joint: as a document, as a table and in words."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from sim.identification.robot_log import RobotLog
from sim.identification.servo_fit import Servo, ServoFit
from sim.scene import Scene

FORMAT = "robot-comparison/1"
# From where on a parameter is told of as another one than the model's.
_GAIN, _DAMPING, _DELAY_S, _OFFSET_RAD = 0.1, 0.2, 0.01, math.radians(0.5)
_FRICTION_SHARE = 0.01  # of the torque limit
# Replays that stay so far from the log, and so much of what the model's own did: no servo does so.
_UNEXPLAINED_RAD, _UNEXPLAINED_SHARE = math.radians(0.5), 0.3
# Correlations of a joint with its own target, and with another one's, that tell of a mix-up.
_OWN, _OTHER = 0.3, 0.7
_LATE_S = (0.0, 0.05, 0.1)  # by how much a joint may come after its target

Document = dict[str, Any]


def comparison(
    path: Path, log: RobotLog, fit: ServoFit, scene: Scene, *, hanging: bool
) -> Document:
    """The document that `--json` prints: docs/files.md, Comparisons."""
    held = _held(log, log.time_s)
    joints = []
    for j, joint in enumerate(scene.robot.joints):
        is_known = not math.isnan(fit.servo.kp[j])
        row: Document = {
            "name": joint.name,
            "rows": int(fit.rows[j]),
            "tracking_rms_rad": _rms(held[:, j] - log.joint_pos_rad[:, j]),
            "model_rms_rad": float(fit.nominal_rms_rad[j]) if is_known else None,
            "fitted_rms_rad": float(fit.fitted_rms_rad[j]) if is_known else None,
        }
        for key, name in (
            ("kp_nm_rad", "kp"),
            ("kd_nm_s_rad", "kd"),
            ("friction_nm", "friction_nm"),
            ("delay_s", "delay_s"),
            ("offset_rad", "offset_rad"),
        ):
            of: dict[str, Servo] = {"model": fit.nominal, "fitted": fit.servo}
            of["deviation"] = fit.deviation
            values = {part: float(getattr(servo, name)[j]) for part, servo in of.items()}
            row[key] = {part: v if math.isfinite(v) else None for part, v in values.items()}
        row["verdict"] = _verdict(row, joint.torque_limit_nm, _follows(log, fit, scene, j))
        joints.append(row)
    apart_s = float(np.median(np.diff(log.time_s)))
    return {
        "format": FORMAT,
        "log": str(path),
        "robot": scene.robot.option,
        "hanging": hanging,
        "duration_s": float(log.time_s[-1] - log.time_s[0]),
        "rows": len(log.time_s),
        "rate_hz": 1 / apart_s,
        "joints": joints,
    }


def text_of(document: Document) -> str:
    """A table with a line for each joint, and what to make of it."""
    width = max(len(row["name"]) for row in document["joints"])
    heads = "tracking   model  fitted   gain  damping  friction   delay   offset"
    units = "     deg     deg     deg      %        %       N m      ms      deg"
    lines = [f"{'':{width}}  {heads}", f"{'':{width}}  {units}"]
    for row in document["joints"]:
        degrees = [row[f"{name}_rms_rad"] for name in ("tracking", "model", "fitted")]
        kp, kd = row["kp_nm_rad"], row["kd_nm_s_rad"]
        cells = [
            *((angle, 8 if k == 0 else 6, 2, 180 / math.pi) for k, angle in enumerate(degrees)),
            (_ratio(kp), 5, 0, 100),
            (_ratio(kd), 7, 0, 100),
            (row["friction_nm"]["fitted"], 8, 2, 1),
            (row["delay_s"]["fitted"], 6, 1, 1000),
            (row["offset_rad"]["fitted"], 7, 2, 180 / math.pi),
        ]
        words = [
            f"{'-':>{size}}" if value is None else f"{value * scale:{size}.{digits}f}"
            for value, size, digits, scale in cells
        ]
        lines.append(f"{row['name']:{width}}  {'  '.join(words)}   {row['verdict']}")
    return "\n".join(lines)


def _ratio(values: Document) -> float | None:
    if values["fitted"] is None or not values["model"]:
        return None
    return float(values["fitted"] / values["model"])


def _verdict(row: Document, torque_limit_nm: float, follows: str) -> str:
    if follows:
        return follows
    if row["fitted_rms_rad"] is None:
        return "too little in the log"
    unexplained = max(_UNEXPLAINED_RAD, _UNEXPLAINED_SHARE * row["model_rms_rad"])
    if row["fitted_rms_rad"] > unexplained:
        return "no servo explains it: load, contact, backlash, or other targets than those logged"
    differs = []
    for key, name, limit in (("kp_nm_rad", "gain", _GAIN), ("kd_nm_s_rad", "damping", _DAMPING)):
        ratio = _ratio(row[key])
        if ratio is not None and abs(ratio - 1) > limit:
            differs.append(f"{name} {100 * ratio:.0f} %")
    friction = row["friction_nm"]
    if abs(friction["fitted"] - friction["model"]) > _FRICTION_SHARE * torque_limit_nm:
        differs.append(f"friction {friction['fitted']:.1f} N m")
    if row["delay_s"]["fitted"] > _DELAY_S:
        differs.append(f"delay {1000 * row['delay_s']['fitted']:.0f} ms")
    if abs(row["offset_rad"]["fitted"]) > _OFFSET_RAD:
        differs.append(f"offset {math.degrees(row['offset_rad']['fitted']):+.1f} deg")
    return ", ".join(differs) or "as the model"


def _follows(log: RobotLog, fit: ServoFit, scene: Scene, j: int) -> str:
    """Which target joint j follows, where that is not its own; "" else."""
    at_s = fit.replayed[j][0]
    if not len(at_s):
        return ""
    moved = log.joint_pos_rad[np.isin(log.time_s, at_s), j]
    if moved.std() < 1e-6:
        return "does not move"
    moved = (moved - moved.mean()) / moved.std()
    alike = np.zeros(len(scene.robot.joints))
    for late_s in _LATE_S:
        targets = _held(log, at_s - late_s)
        spread = np.maximum(targets.std(axis=0), 1e-6)
        one = ((targets - targets.mean(axis=0)) / spread).T @ moved / len(moved)
        alike = np.where(np.abs(one) > np.abs(alike), one, alike)
    if alike[j] < -_OTHER:
        return "turns against its target: the sign of one of them is wrong"
    # Legs often move alike in opposite directions: rather the one that it moves along with.
    best = int((alike if alike.max() > _OTHER else np.abs(alike)).argmax())
    if best == j or alike[j] > _OWN or abs(alike[best]) < _OTHER:
        return ""
    other = scene.robot.joints[best].name
    return f"follows the target of {other}: the order of the joints is wrong"


def _held(log: RobotLog, at_s: np.ndarray) -> np.ndarray:
    """The targets (n, J) that had been sent last at the times (n,)."""
    last = np.searchsorted(log.sent_s, at_s - 1e-9) - 1
    held: np.ndarray = log.target_rad[np.maximum(last, 0)]
    return held


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean()))
