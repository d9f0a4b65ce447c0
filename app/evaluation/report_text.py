"""The Markdown report of an evaluation, with the paper's numbers beside ours."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from app.evaluation.beside import beside, who
from app.evaluation.parts import (
    HIT_RADIUS_M,
    JOINT_NOISE_WITHSTOOD_DEG,
    PAPER_PEAKS,
    TITLE,
    TREAD_NOISE_WITHSTOOD_M,
    Document,
)
from app.evaluation.tables import (
    HEADING,
    CellText,
    number,
    paragraphs,
    plain_joint,
    shown,
    spread_of,
    table,
)
from controller.evaluation.gait_metrics import asymmetry


def report(document: Document) -> str:
    """The whole report; what was not measured is left out."""
    lines = [
        f"# How well {document['robot']} follows its steps",
        "",
        f"{who(document).capitalize()}, evaluated with seed {document['seed']} and "
        f"{document['episodes']} episodes (fewer where a section says so), physics at 1 kHz, "
        "without exploration noise, episodes that training never sees. The numbers are in "
        f"`evaluation.json`. The paper is {TITLE}; where none of its numbers stands beside ours, "
        "it has none or none was at hand.",
        "",
    ]
    for key, told in _SECTIONS.items():
        if document.get(key):
            lines += [*told(document), ""]
    return "\n".join(lines)


def _modes(document: Document) -> list[str]:
    return paragraphs(
        "## Falls and foot errors",
        "A foot error is the horizontal distance between where a foot rests at the end of its "
        "step's period and where that step was asked for; along and across are its parts along "
        "and across the step. The paper gives no such distance: its step counts as hit when "
        f"either foot is within {100 * HIT_RADIUS_M:.0f} cm.",
        table(
            document["modes"],
            ("mode", "{mode}"),
            ("episodes", "{episodes}"),
            ("falls", "{falls}"),
            ("steps", "{landings}"),
            ("foot error, median / p95", spread_of("error_m_")),
            ("p99", number("error_m_p99", "{:.1f} cm", 100)),
            ("along, median / p95", spread_of("along_m_")),
            ("across, median / p95", spread_of("across_m_")),
            ("heading, median / p95", HEADING),
        ),
        "![Share of steps within a distance](errors.png)",
    )


# Kind of noise: how it is told, in which unit, and how much the paper's policy withstood.
_NOISES = {
    "none": ("none", 1.0, 0.0),
    "tread": ("treads, cm ±{:g}", 100.0, TREAD_NOISE_WITHSTOOD_M),
    "joint": ("joints, degrees ±{:g}", 1.0, JOINT_NOISE_WITHSTOOD_DEG),
}


def _stairs(document: Document) -> list[str]:
    cases: dict[tuple[int, float, float], dict[str, Any]] = {}
    for row in document["stairs"]:
        case = list(_NOISES).index(row["noise_kind"]), row["rise_m"], row["noise"]
        cases.setdefault(case, {**row, "up": "-", "down": "-"})[row["way"]] = (
            f"{100 * row['success']:.1f} %, {row['length_s_mean']:.1f} s"
        )

    def noise(row: Document) -> str:
        told, scale, _ = _NOISES[row["noise_kind"]]
        return told.format(scale * row["noise"])

    def paper(row: Document) -> str:
        if row["noise_kind"] == "none":
            return "trained for" if row["rise_m"] <= 0.10 else "-"
        *_, withstood = _NOISES[row["noise_kind"]]
        return "withstood" if row["noise"] <= withstood + 1e-9 else "falls off"

    return paragraphs(
        "## Stairs",
        "Episodes of 10 s on runs of 25 to 30 cm. Success: neither fallen nor strayed from the "
        "plan. Each tread is uniformly higher or lower than observed by up to the tread noise; "
        "joint noise is uniform on every observed joint position, with matching noise on the "
        "velocities.",
        table(
            [cases[case] for case in sorted(cases)],
            ("rise", number("rise_m", "{:g} cm", 100)),
            ("noise", noise),
            ("episodes", "{episodes}"),
            ("up: success, length", "{up}"),
            ("down", "{down}"),
            (f"{TITLE}, 10 cm", paper),
        ),
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
    rows = [
        {
            "joint": plain_joint(left["joint"]),
            "left": left,
            "right": right,
            "uneven": 100 * asymmetry(left["rms_torque_nm"], right["rms_torque_nm"]),
        }
        for left, right in zip(joints[:half], joints[half:], strict=True)
    ]
    loads = table(
        rows,
        ("joint", "{joint}"),
        (
            "peak torque left / right, N m",
            "{left[peak_torque_nm]:.0f} / {right[peak_torque_nm]:.0f}",
        ),
        ("limit", "{left[torque_limit_nm]:g}"),
        (
            "peak speed left / right, rad/s",
            "{left[peak_speed_rad_s]:.2f} / {right[peak_speed_rad_s]:.2f}",
        ),
        ("limit", "{left[speed_limit_rad_s]:g}"),
        ("left and right differ by", "{uneven:.1f} %"),
    )
    return paragraphs(
        *head,
        _walk_figures(gait),
        loads,
        [
            *(
                _paper_peaks(rows)
                if document["robot"] == "hrp5p"
                else [f"{TITLE} lists peak loads of HRP-5P only."]
            ),
            "The last column compares the root mean square torques.",
        ],
        "![Peak loads as shares of their limits](loads.png)",
        f"The vertical force under a foot peaks at {max(gait['force_peak']):.2f} times the weight "
        "(left {:.2f}, right {:.2f}).".format(*gait["force_peak"]),
        "![Vertical ground force over the gait](forces.png)",
        "Contact is what the phase indicator asks for during "
        f"{shown(gait['contact_agreement'], '{:.1f} %', 100)} of the time outside its ramps; feet "
        f"lift off {shown(gait['lift_off_lag_s'], '{:.0f} ms', 1000)} after the clock and touch "
        f"down {shown(gait['touch_down_lag_s'], '{:.0f} ms', 1000)} after it (medians; less than "
        "0 is early).",
        "![Phase indicator and contact](contact.png)",
    )


def _walk_figures(gait: Document) -> list[str]:
    """How as many walks looked that also came to a stand; the names are those of report.json."""
    jerk = f"Joint jerk: {shown(gait['joint_jerk_rad_s3'], '{:.0f} rad/s³')} (root mean square)."
    walk = gait["walk"]
    if walk is None:
        return [jerk]
    height = walk["pelvis_height_m"]
    touchdown = walk["touchdown_speed_m_s"] or {"median": None, "p95": None}
    figures = {
        "pelvis over the lower sole, median / least": (
            f"{height['median']:.3f} / {height['least']:.3f} m"
        ),
        f"the same at rest (half-sitting: {gait['pelvis_standing_m']:.3f} m)": shown(
            height["at_rest"], "{:.3f} m"
        ),
        "bob of the pelvis in a step, median": f"{100 * walk['pelvis_bob_m']:.1f} cm",
        "swing apex, median / 95th percentile": spread_of("")(walk["swing_apex_m"]),
        "sole's speed down, last 25 ms before contact, median / 95th percentile": (
            f"{shown(touchdown['median'], '{:.2f}')} / {shown(touchdown['p95'], '{:.2f}')} m/s"
        ),
        "peak force of one foot": f"{walk['peak_force_weights']:.2f} weights",
        "cost of transport": shown(walk["cost_of_transport"], "{:.2f}"),
        "speed": f"{walk['speed_m_s']:.2f} m/s",
    }
    rows = [{"name": name, "value": value} for name, value in figures.items()]
    return paragraphs(
        "The same steps again, then a stand: every step counts, those of setting off and stopping "
        "too.",
        table(rows, ("gait", "{name}"), ("", "{value}")),
        jerk,
    )


def _paper_peaks(rows: Sequence[Document]) -> list[str]:
    """The paper's measured peaks of HRP-5P beside ours: how many times its greater leg's."""
    rows = [{**row, "paper": PAPER_PEAKS[row["joint"]]} for row in rows]

    def ours_over(peak: str, which: int) -> CellText:
        return lambda row: (
            f"{max(row['left'][peak], row['right'][peak]) / max(row['paper'][which]):.1f}"
        )

    peaks = table(
        rows,
        ("joint", "{joint}"),
        (
            f"peak torque in {TITLE}, left / right, N m",
            "{paper[0][0]:g} / {paper[0][1]:g}",
        ),
        ("ours over its greater", ours_over("peak_torque_nm", 0)),
        ("peak speed there, rad/s", "{paper[1][0]:g} / {paper[1][1]:g}"),
        ("ours over its greater", ours_over("peak_speed_rad_s", 1)),
    )
    return [*peaks, "", f"The limits above are those of {TITLE} too."]


def _push(document: Document) -> list[str]:
    rows = document["push"]

    def success(number: int) -> CellText:
        return lambda row: f"{100 * row['success'][number]:.0f} %"

    impulses = enumerate(rows[0]["impulses_ns"])
    return paragraphs(
        "## Push recovery",
        f"{rows[0]['walks']} walks straight forward for each direction and impulse, "
        "pushed once for 0.1 s at the pelvis, at a moment drawn over the gait cycle; success is "
        "to be on one's feet at the end.",
        table(
            rows,
            ("pushed", "{direction}"),
            *((f"{impulse:g} N s", success(number)) for number, impulse in impulses),
        ),
        "![Success against impulse](push.png)",
    )


def _energy(document: Document) -> list[str]:
    def length(row: Document) -> str:
        x_m, y_m, _ = row["step"]
        return f"{100 * (y_m if row['kind'] == 'sideways' else abs(x_m)):.0f} cm"

    return paragraphs(
        "## Speed and cost of transport",
        "Cost of transport is E / (m g d) with E the absolute mechanical work of all leg joints: "
        "what brakes costs as much as what drives.",
        table(
            document["energy"],
            ("walk", "{kind}"),
            ("step", length),
            ("speed", number("speed_m_s", "{:.2f} m/s")),
            ("mechanical power", number("power_w", "{:.0f} W")),
            ("cost of transport", number("cost_of_transport", "{:.2f}")),
        ),
        "![Cost of transport over speed](energy.png)",
    )


def _pace(document: Document) -> list[str]:
    return paragraphs(
        "## Pace",
        f"{document['pace'][0]['walks']} walks of 10 s straight forward for each duration of a "
        "step, all with the longest step; the first is the robot's own gait.",
        table(
            document["pace"],
            ("a step takes", "{step_s:g} s"),
            ("falls", "{falls} of {walks}"),
            ("speed", number("speed_m_s", "{:.2f} m/s")),
        ),
        "![Falls and speed by the duration of a step](pace.png)",
    )


def _hardware(document: Document) -> list[str]:
    rows = document["hardware"]
    return paragraphs(
        "## Robot and ground other than modelled",
        f"{rows[0]['walks']} walks of 10 s in mixed modes for each value, which the robot is not "
        "told; docs/hardware.md says what each means.",
        table(
            rows,
            ("what", "{what}"),
            ("value", "{value:g} {unit}"),
            ("falls", "{falls} of {walks}"),
            ("foot error, median", number("error_m_median", "{:.1f} cm", 100)),
            ("p95", number("error_m_p95", "{:.1f} cm", 100)),
        ),
        "![Success and foot error by what differs](hardware.png)",
    )


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

    def ends(name: str, scale: float) -> CellText:
        return lambda tried: "{:.1f} to {:.1f}".format(*(scale * v for v in tried["limits"][name]))

    found = limits["measured"]
    told = ["None of them reached 99 %: planning uses those of the robot's file."]
    if found is not None:
        z0, z1 = (100 * end for end in found["limits"]["z_m"])
        told = [
            "Planning uses the last of these, steps down to "
            f"{-z0:.0f} cm and up to {z1:.0f} cm, a foot margin of "
            f"{100 * found['foot_margin_m']:.1f} cm (99th percentile of how far any point of a "
            "sole comes down from its place within these limits) and a body margin of "
            f"{100 * found['body_margin_m']:.1f} cm (the most that any shape, here "
            f"{found['evidence']['widest_shape']}, left its box in "
            f"{found['evidence']['planned_walks']} planned walks).",
            f"Stored: {limits['stored'] or 'no'}.",
        ]
    return paragraphs(
        "## What planning may ask for",
        "Each kind of step on a grid over what was trained was walked "
        f"{limits['map']['walks_each']} times for 10 s: about every other step is of that kind, "
        "those between are of the planner's set.",
        "![Success and foot error of all kinds of steps](limits.png)",
        "The limits are those trained on, cut back at the corner where most walks fall until 99 % "
        "succeed. Walks begin with two steps on corners and go on anywhere within the limits and "
        "with steps of the planner's set:",
        table(
            limits["region"]["tried"],
            ("forward, cm", ends("x_m", 100)),
            ("sideways, cm", ends("y_m", 100)),
            ("turn, degrees", ends("yaw_rad", math.degrees(1))),
            ("success", number("success", "{:.1f} %", 100)),
        ),
        *told,
    )


_SECTIONS: Mapping[str, Callable[[Document], list[str]]] = {
    "modes": _modes,
    "stairs": _stairs,
    "gait": _gait,
    "push": _push,
    "energy": _energy,
    "pace": _pace,
    "hardware": _hardware,
    "long": _long,
    "limits": _limits,
    "beside": beside,
}
