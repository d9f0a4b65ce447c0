"""Two evaluations of one robot side by side: this one, and another under the key `beside`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from app.evaluation.parts import Document
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


def names(document: Document) -> tuple[str, str]:
    """What to call the two: by their controllers, where these differ."""
    this, other = (
        (of.get("controller") or {"name": "policy"})["name"]
        for of in (document, document["beside"])
    )
    return (this, other) if this != other else ("this", "other")


def beside_rows(document: Document, section: str, *keys: str) -> list[dict[str, Any]]:
    """Rows that both evaluations have, as `this` and `other`: those that agree in these fields."""

    def rows(of: Document) -> dict[str, Document]:
        return {str([row[key] for key in keys]): row for row in of.get(section, [])}

    this, other = rows(document), rows(document["beside"])
    return [{"this": this[key], "other": other[key]} for key in this if key in other]


def who(document: Document) -> str:
    """Which controller was measured, in words, and in which engine if not in MuJoCo."""
    engine = document.get("engine")
    where = f" in {engine['name']} {engine['version']}" if engine else ""
    if not document.get("controller"):
        return f"policy {document['policy_sha256'][:12]}{where}"
    told = document["controller"]
    return f"controller {told['name']} ({told['rate_hz']} Hz; {told['state']}){where}"


def has(document: Document, section: str) -> bool:
    """Whether an evaluation can show a section; of a gait in which all fell there is nothing."""
    found = document.get(section)
    return bool(found and (section != "gait" or "joints" in found))


def beside(document: Document) -> list[str]:
    """The section of the report on the two."""
    other, (this, that) = document["beside"], names(document)

    def both(title: str, cell: CellText) -> list[tuple[str, CellText]]:
        return [
            (f"{title}, {this}", lambda row: cell(row["this"])),
            (f"{title}, {that}", lambda row: cell(row["other"])),
        ]

    parts: list[list[str]] = []
    for section, tell in _SECTIONS.items():
        if has(document, section) and has(other, section):
            parts += tell(document, both)
    return paragraphs(
        f"## Beside another {'policy' if this == 'this' else 'controller'}",
        f"The other is {who(other)}, evaluated with seed {other['seed']} and {other['episodes']} "
        "episodes.",
        [f"- {this.capitalize()}: {_made(document)}.", f"- {that.capitalize()}: {_made(other)}."],
        *parts,
    )


Both = Callable[[str, CellText], list[tuple[str, CellText]]]


def _modes(document: Document, both: Both) -> list[list[str]]:
    return [
        table(
            beside_rows(document, "modes", "mode"),
            ("mode", "{this[mode]}"),
            *both("falls", "{falls} of {episodes}".format_map),
            *both("foot error, median / p95", spread_of("error_m_")),
            *both("heading, median / p95", HEADING),
        ),
        ["![Both, mode by mode](beside.png)"],
    ]


def _stairs(document: Document, both: Both) -> list[list[str]]:
    return [
        table(
            beside_rows(document, "stairs", "rise_m", "way", "noise_kind", "noise"),
            ("stairs", lambda row: _stair(row["this"])),
            *both("success", lambda row: f"{100 * row['success']:.1f} % of {row['episodes']}"),
        ),
        ["![Success on noisy stairs, both](beside_noise.png)"],
    ]


def _stair(row: Document) -> str:
    noise = {
        "none": "",
        "tread": f", treads ±{100 * row['noise']:g} cm",
        "joint": f", joints ±{row['noise']:g}°",
    }
    return f"{100 * row['rise_m']:g} cm {row['way']}{noise[row['noise_kind']]}"


# Of `gait`: title, where the figure lies, format, scale.
_GAIT = (
    ("peak force of one foot, weights", ("walk", "peak_force_weights"), "{:.2f}", 1.0),
    ("pelvis over the lower sole, median, m", ("walk", "pelvis_height_m", "median"), "{:.2f}", 1.0),
    ("bob of the pelvis, cm", ("walk", "pelvis_bob_m"), "{:.1f}", 100.0),
    ("feet lifted, median, cm", ("walk", "swing_apex_m", "median"), "{:.1f}", 100.0),
    ("soles down at, median, m/s", ("walk", "touchdown_speed_m_s", "median"), "{:.2f}", 1.0),
    ("cost of transport", ("walk", "cost_of_transport"), "{:.2f}", 1.0),
    ("speed, m/s", ("walk", "speed_m_s"), "{:.2f}", 1.0),
    ("joint jerk, rad/s³", ("joint_jerk_rad_s3",), "{:.0f}", 1.0),
)


def _gait(document: Document, both: Both) -> list[list[str]]:
    pair = {"this": document["gait"], "other": document["beside"]["gait"]}

    def at(gait: Document, path: tuple[str, ...]) -> float | None:
        value: Any = gait
        for key in path:
            value = None if value is None else value[key]
        return value

    figures = [
        {
            "name": title,
            **{
                which: {"value": shown(at(gait, path), form, scale)} for which, gait in pair.items()
            },
        }
        for title, path, form, scale in _GAIT
    ]
    joints = [
        {"name": plain_joint(this["joint"]), "this": this, "other": other, "limits": this}
        for this, other in zip(
            *(joint_peaks(gait["joints"]) for gait in pair.values()), strict=True
        )
    ]
    return [
        table(figures, ("gait", "{name}"), *both("longest steps", "{value}".format_map)),
        table(
            joints,
            ("joint", "{name}"),
            *both("peak torque, N m", number("peak_torque_nm", "{:.0f}")),
            ("limit", "{limits[torque_limit_nm]:g}"),
            *both("peak speed, rad/s", number("peak_speed_rad_s", "{:.2f}")),
            ("limit", "{limits[speed_limit_rad_s]:g}"),
        ),
        ["![Vertical ground force over the gait, both](beside_forces.png)"],
        ["![Peak loads of the joints, both](beside_loads.png)"],
    ]


def joint_peaks(joints: Sequence[Document]) -> list[dict[str, Any]]:
    """The left leg's joints with the greater peaks of both legs."""
    half = len(joints) // 2
    peaks = ("peak_torque_nm", "peak_speed_rad_s")
    return [
        {**left, **{peak: max(left[peak], right[peak]) for peak in peaks}}
        for left, right in zip(joints[:half], joints[half:], strict=True)
    ]


def _push(document: Document, both: Both) -> list[list[str]]:
    rows = beside_rows(document, "push", "direction", "impulses_ns")
    if not rows:
        return []

    def success(k: int) -> CellText:
        return lambda row: " / ".join(
            f"{100 * row[which]['success'][k]:.0f} %" for which in ("this", "other")
        )

    impulses = enumerate(rows[0]["this"]["impulses_ns"])
    return [
        [f"On their feet at the end after one push, {' / '.join(names(document))}:"],
        table(
            rows,
            ("pushed", "{this[direction]}"),
            *((f"{impulse:g} N s", success(k)) for k, impulse in impulses),
        ),
        ["![Success against impulse, both](beside_push.png)"],
    ]


def _energy(document: Document, both: Both) -> list[list[str]]:
    def step(row: Document) -> str:
        x_m, y_m, _ = row["this"]["step"]
        kind = row["this"]["kind"]
        return f"{kind}, {100 * (y_m if kind == 'sideways' else abs(x_m)):.0f} cm"

    return [
        table(
            beside_rows(document, "energy", "kind", "step"),
            ("walk", step),
            *both("cost of transport", number("cost_of_transport", "{:.2f}")),
            *both("speed", number("speed_m_s", "{:.2f} m/s")),
            *both("falls", "{falls} of {walks}".format_map),
        ),
        ["![Cost of transport over speed, both](beside_energy.png)"],
    ]


def _pace(document: Document, both: Both) -> list[list[str]]:
    return [
        table(
            beside_rows(document, "pace", "step_s"),
            ("a step takes", "{this[step_s]:g} s"),
            *both("falls", "{falls} of {walks}".format_map),
            *both("speed", number("speed_m_s", "{:.2f} m/s")),
        ),
        ["![Falls and speed by the duration of a step, both](beside_pace.png)"],
    ]


def _long(document: Document, both: Both) -> list[list[str]]:
    pair = {"this": document["long"], "other": document["beside"]["long"]}
    told = (
        f"{name}: {long['falls']} of {long['walks']} fell"
        for name, long in zip(names(document), pair.values(), strict=True)
    )
    return [[f"A minute of mixed walking: {'; '.join(told)}."]]


_SECTIONS: dict[str, Callable[[Document, Both], list[list[str]]]] = {
    "modes": _modes,
    "stairs": _stairs,
    "gait": _gait,
    "push": _push,
    "energy": _energy,
    "pace": _pace,
    "long": _long,
}


def _made(document: Document) -> str:
    """The command that trained a policy and how long it had learned, as far as it says."""
    if document.get("controller"):
        return "not trained; docs/lipm.md tells what it is given"
    trained = document.get("trained") or {}
    if "command" not in trained:
        return "its file does not say how it was trained"
    return f"`{trained['command']}`, the checkpoint at {trained['samples']:,} samples"
