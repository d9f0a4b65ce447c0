"""The Markdown report of an evaluation, with the paper's numbers beside ours."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from app.evaluation.comparison import compared
from app.evaluation.parts import (
    HIT_RADIUS_M,
    JOINT_NOISE_WITHSTOOD_DEG,
    PAPER_PEAKS,
    TITLE,
    TREAD_NOISE_WITHSTOOD_M,
    Document,
    cell,
    pair,
    paragraphs,
    table,
)
from controller.evaluation.gait_metrics import asymmetry


def plain_joint(name: str) -> str:
    """A left joint's name in words: L_HIP_P, left_hip_pitch_joint and LCP all give hip pitch."""
    bare = re.sub(r"^(left|l)_?|_joint$", "", name.lower())
    bare = re.sub(r"^([cka])([ypr])$", r"\1_\2", bare)
    words = [_JOINT_WORDS.get(word, word) for word in bare.split("_")]
    return "knee" if words[0] == "knee" else " ".join(words)


_JOINT_WORDS = {"c": "hip", "k": "knee", "a": "ankle", "y": "yaw", "p": "pitch", "r": "roll"}


def report(document: Document) -> str:
    """The whole report; what was not measured is left out."""
    lines = [
        f"# How well {document['robot']} follows its steps",
        "",
        f"Policy {document['policy_sha256'][:12]}, evaluated with seed {document['seed']} and "
        f"{document['episodes']} episodes (fewer where a section says so), physics at 1 kHz, "
        "policy without exploration noise, episodes that training never sees. The numbers are in "
        f"`evaluation.json`. The paper is {TITLE}; where none of its numbers stands beside ours, "
        "it has none or none was at hand.",
        "",
    ]
    for key, told in _SECTIONS.items():
        if document.get(key):
            lines += [*told(document), ""]
    return "\n".join(lines)


def _modes(document: Document) -> list[str]:
    rows = [
        (
            row["mode"],
            str(row["episodes"]),
            str(row["falls"]),
            str(row["landings"]),
            pair(row, "error_m_median", "error_m_p95"),
            cell(row["error_m_p99"], "{:.1f} cm", 100),
            pair(row, "along_m_median", "along_m_p95"),
            pair(row, "across_m_median", "across_m_p95"),
            pair(row, "heading_deg_median", "heading_deg_p95", 1.0, "°"),
        )
        for row in document["modes"]
    ]
    titles = (
        *("mode", "episodes", "falls", "steps", "foot error, median / p95", "p99"),
        *("along, median / p95", "across, median / p95", "heading, median / p95"),
    )
    return paragraphs(
        "## Falls and foot errors",
        "A foot error is the horizontal distance between where a foot rests at the end of its "
        "step's period and where that step was asked for; along and across are its parts along "
        "and across the step. The paper gives no such distance: its step counts as hit when "
        f"either foot is within {100 * HIT_RADIUS_M:.0f} cm.",
        table(titles, rows),
        "![Share of steps within a distance](errors.png)",
    )


def _stairs(document: Document) -> list[str]:
    def shown(kind: str, unit: str, scale: float, withstood: float) -> list[list[str]]:
        rows = [row for row in document["stairs"] if row["noise_kind"] == kind]
        ways = ("up", "down")
        lines = []
        for rise_m, noise in sorted({(row["rise_m"], row["noise"]) for row in rows}):
            here = {
                row["way"]: row for row in rows if row["rise_m"] == rise_m and row["noise"] == noise
            }
            cells = [
                f"{100 * here[way]['success']:.1f} %, {here[way]['length_s_mean']:.1f} s"
                if way in here
                else "-"
                for way in ways
            ]
            if kind == "none":
                paper = "trained for" if rise_m <= 0.10 else "-"
                what = "none"
            else:
                paper = "withstood" if noise <= withstood + 1e-9 else "falls off"
                what = f"{unit} ±{scale * noise:g}"
            some = next(iter(here.values()))
            label = f"{100 * rise_m:g} cm"
            lines.append([label, what, str(some["episodes"]), *cells, paper])
        return lines

    rows = [
        *shown("none", "", 1.0, 0.0),
        *shown("tread", "treads, cm", 100.0, TREAD_NOISE_WITHSTOOD_M),
        *shown("joint", "joints, degrees", 1.0, JOINT_NOISE_WITHSTOOD_DEG),
    ]
    titles = ("rise", "noise", "episodes", "up: success, length", "down", f"{TITLE}, 10 cm")
    return paragraphs(
        "## Stairs",
        "Episodes of 10 s on runs of 25 to 30 cm. Success: neither fallen nor strayed from the "
        "plan. Each tread is uniformly higher or lower than observed by up to the tread noise; "
        "joint noise is uniform on every observed joint position, with matching noise on the "
        "velocities.",
        table(titles, rows),
        "![Success and episode length on noisy stairs](stairs.png)",
    )


def _gait(document: Document) -> list[str]:
    gait = document["gait"]
    head = (
        "## Gait, loads, ground force and contact",
        f"{gait['walks']} walks of 10 s straight forward with steps of {100 * gait['step_m']:.0f} "
        f"cm, recorded at 1 kHz; {gait['falls']} fell and are left out.",
    )
    joints = gait.get("joints")
    if not joints:
        return paragraphs(*head)
    half = len(joints) // 2
    rows = []
    for left, right in zip(joints[:half], joints[half:], strict=True):
        uneven = asymmetry(left["rms_torque_nm"], right["rms_torque_nm"])
        rows.append(
            (
                plain_joint(left["joint"]),
                f"{left['peak_torque_nm']:.0f} / {right['peak_torque_nm']:.0f}",
                f"{left['torque_limit_nm']:g}",
                f"{left['peak_speed_rad_s']:.2f} / {right['peak_speed_rad_s']:.2f}",
                f"{left['speed_limit_rad_s']:g}",
                f"{100 * uneven:.1f} %",
            )
        )
    titles = (
        *("joint", "peak torque left / right, N m", "limit"),
        *("peak speed left / right, rad/s", "limit", "left and right differ by"),
    )
    return paragraphs(
        *head,
        _walk_figures(gait),
        table(titles, rows),
        [
            *_paper_peaks(document["robot"], joints),
            "The last column compares the root mean square torques.",
        ],
        "![Peak loads as shares of their limits](loads.png)",
        f"The vertical force under a foot peaks at {max(gait['force_peak']):.2f} times the weight "
        "(left {:.2f}, right {:.2f}).".format(*gait["force_peak"]),
        "![Vertical ground force over the gait](forces.png)",
        "Contact is what the phase indicator asks for during "
        f"{cell(gait['contact_agreement'], '{:.1f} %', 100)} of the time outside its ramps; feet "
        f"lift off {cell(gait['lift_off_lag_s'], '{:.0f} ms', 1000)} after the clock and touch "
        f"down {cell(gait['touch_down_lag_s'], '{:.0f} ms', 1000)} after it (medians; less than 0 "
        "is early).",
        "![Phase indicator and contact](contact.png)",
    )


def _walk_figures(gait: Mapping[str, Any]) -> list[str]:
    """How as many walks looked that also came to a stand; the names are those of report.json."""
    jerk = f"Joint jerk: {cell(gait['joint_jerk_rad_s3'], '{:.0f} rad/s³')} (root mean square)."
    walk = gait["walk"]
    if walk is None:
        return [jerk]
    height, apex = walk["pelvis_height_m"], walk["swing_apex_m"]
    touchdown = walk["touchdown_speed_m_s"] or {"median": None, "p95": None}
    rows = [
        (
            "pelvis over the lower sole, median / least",
            f"{height['median']:.3f} / {height['least']:.3f} m",
        ),
        (
            f"the same at rest (half-sitting: {gait['pelvis_standing_m']:.3f} m)",
            cell(height["at_rest"], "{:.3f} m"),
        ),
        ("bob of the pelvis in a step, median", f"{100 * walk['pelvis_bob_m']:.1f} cm"),
        ("swing apex, median / 95th percentile", pair(apex, "median", "p95")),
        (
            "sole's speed down, last 25 ms before contact, median / 95th percentile",
            f"{cell(touchdown['median'], '{:.2f}')} / {cell(touchdown['p95'], '{:.2f}')} m/s",
        ),
        ("peak force of one foot", f"{walk['peak_force_weights']:.2f} weights"),
        ("cost of transport", cell(walk["cost_of_transport"], "{:.2f}")),
        ("speed", f"{walk['speed_m_s']:.2f} m/s"),
    ]
    return paragraphs(
        "The same steps again, then a stand: every step counts, those of setting off and stopping "
        "too.",
        table(("gait", ""), rows),
        jerk,
    )


def _paper_peaks(robot: str, joints: Sequence[Mapping[str, Any]]) -> list[str]:
    """The paper's measured peaks of HRP-5P beside ours: how many times its greater leg's."""
    if robot != "hrp5p":
        return [f"{TITLE} lists peak loads of HRP-5P only."]
    half, rows = len(joints) // 2, []
    for left, right in zip(joints[:half], joints[half:], strict=True):
        torques_nm, speeds_rad_s = PAPER_PEAKS[plain_joint(left["joint"])]
        ours_nm = max(left["peak_torque_nm"], right["peak_torque_nm"])
        ours_rad_s = max(left["peak_speed_rad_s"], right["peak_speed_rad_s"])
        rows.append(
            (
                plain_joint(left["joint"]),
                "{:g} / {:g}".format(*torques_nm),
                f"{ours_nm / max(torques_nm):.1f}",
                "{:g} / {:g}".format(*speeds_rad_s),
                f"{ours_rad_s / max(speeds_rad_s):.1f}",
            )
        )
    titles = (
        *("joint", f"peak torque in {TITLE}, left / right, N m", "ours over its greater"),
        *("peak speed there, rad/s", "ours over its greater"),
    )
    return [*table(titles, rows), "", f"The limits above are those of {TITLE} too."]


def _push(document: Document) -> list[str]:
    impulses = document["push"][0]["impulses_ns"]
    rows = [
        (row["direction"], *(f"{100 * share:.0f} %" for share in row["success"]))
        for row in document["push"]
    ]
    titles = ("pushed", *(f"{impulse:g} N s" for impulse in impulses))
    return paragraphs(
        "## Push recovery",
        f"{document['push'][0]['walks']} walks straight forward for each direction and impulse, "
        "pushed once for 0.1 s at the pelvis, at a moment drawn over the gait cycle; success is "
        "to be on one's feet at the end.",
        table(titles, rows),
        "![Success against impulse](push.png)",
    )


def _energy(document: Document) -> list[str]:
    rows = [
        (
            row["kind"],
            f"{100 * _length_m(row):.0f} cm",
            cell(row["speed_m_s"], "{:.2f} m/s"),
            cell(row["power_w"], "{:.0f} W"),
            cell(row["cost_of_transport"], "{:.2f}"),
        )
        for row in document["energy"]
    ]
    titles = ("walk", "step", "speed", "mechanical power", "cost of transport")
    return paragraphs(
        "## Speed and cost of transport",
        "Cost of transport is E / (m g d) with E the absolute mechanical work of all leg joints: "
        "what brakes costs as much as what drives.",
        table(titles, rows),
        "![Cost of transport over speed](energy.png)",
    )


def _length_m(row: Document) -> float:
    x_m, y_m, _ = row["step"]
    return abs(x_m) if row["kind"] != "sideways" else y_m


def _long(document: Document) -> list[str]:
    long = document["long"]
    stayed = 1 - long["falls"] / long["walks"]
    return paragraphs(
        "## A minute of mixed walking",
        f"{long['walks']} walks of {long['seconds']:.0f} s that change between all flat modes: "
        f"{long['falls']} fell, {100 * stayed:.1f} % succeeded.",
    )


def _limits(document: Document) -> list[str]:
    limits = document["limits"]
    head = (
        "## What planning may ask for",
        "Each kind of step on a grid over what was trained was walked "
        f"{limits['map']['walks_each']} times for 10 s: about every other step is of that kind, "
        "those between are of the planner's set.",
        "![Success and foot error of all kinds of steps](limits.png)",
        "The limits are those trained on, cut back at the corner where most walks fall until 99 % "
        "succeed. Walks begin with two steps on corners and go on anywhere within the limits and "
        "with steps of the planner's set:",
    )
    rows = [
        (*_ends(tried["limits"]), f"{100 * tried['success']:.1f} %")
        for tried in limits["region"]["tried"]
    ]
    tried = table(("forward, cm", "sideways, cm", "turn, degrees", "success"), rows)
    found = limits["measured"]
    if found is None:
        none = "None of them reached 99 %: planning uses those of the robot's file."
        return paragraphs(*head, tried, none)
    z0, z1 = (100 * end for end in found["limits"]["z_m"])
    return paragraphs(
        *head,
        tried,
        "Planning uses the last of these, steps down to "
        f"{-z0:.0f} cm and up to {z1:.0f} cm, a foot margin of {100 * found['foot_margin_m']:.1f} "
        "cm (99th percentile of how far any point of a sole comes down from its place within "
        f"these limits) and a body margin of {100 * found['body_margin_m']:.1f} cm (the most that "
        f"any shape, here {found['evidence']['widest_shape']}, left its box in "
        f"{found['evidence']['planned_walks']} planned walks).",
        f"Stored: {limits['stored'] or 'no'}.",
    )


def _ends(limits: Document) -> tuple[str, str, str]:
    def shown(name: str, scale: float) -> str:
        low, high = (scale * end for end in limits[name])
        return f"{low:.1f} to {high:.1f}"

    return shown("x_m", 100), shown("y_m", 100), shown("yaw_rad", math.degrees(1))


_SECTIONS: Mapping[str, Callable[[Document], list[str]]] = {
    "modes": _modes,
    "stairs": _stairs,
    "gait": _gait,
    "push": _push,
    "energy": _energy,
    "long": _long,
    "limits": _limits,
    "beside": compared,
}
