"""The summary of many walks: counts of how they ended, percentiles, and the table for people."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from app.navigation.report import Outcome, Percentiles


def summarise(results: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Counts of outcomes, and percentiles over all feet placed."""
    outcomes = Counter(result["outcome"] for result in results)
    errors = np.concatenate([result["foot_errors_m"] for result in results] or [[]])
    clearances = [r["min_clearance_m"] for r in results if r["min_clearance_m"] is not None]
    goals = [r["goal_error_m"] for r in results if r["outcome"] == Outcome.REACHED]
    parted = [result for result in results if not result.get("joined", True)]
    return {
        "walks": len(results),
        **{str(outcome): outcomes.get(str(outcome), 0) for outcome in Outcome},
        "unconnected": len(parted),
        "narrow_places": _narrow_places([r["narrow_place"] for r in parted if r["narrow_place"]]),
        "steps_taken": len(errors),
        "replans": sum(result["replans"] for result in results),
        "recovery_steps": sum(result["recovery_steps"] for result in results),
        "foot_error_m": _percentiles(errors),
        "goal_error_m": _percentiles(goals),
        "min_clearance_m": min(clearances, default=None),
        "planning_time_s": _percentiles([result["planning_time_s"] for result in results]),
        "gait": _gait(results),
        "relaxed": dict(sum((Counter(r.get("relaxed", {})) for r in results), Counter())),
        "sensed": _all_sensed([r["sensed"] for r in results if r.get("sensed")]),
        "sim_time_s": sum(result["sim_time_s"] for result in results),
    }


def _all_sensed(walks: Sequence[Mapping[str, Any]]) -> dict[str, Any] | None:
    """Drift per metre, per full turn, and what else shows how well the robots knew their places."""
    if not walks:
        return None
    walked_m, turned_rad = (sum(walk[key] for walk in walks) for key in ("walked_m", "turned_rad"))
    drift_rad = sum(walk["drift_rad"] for walk in walks)
    shares = [walk["drift_m"] / walk["walked_m"] for walk in walks if walk["walked_m"] > 1.0]
    places = [walk["localization_error_m"] for walk in walks if walk["localization_error_m"]]
    own = np.concatenate([walk["own_foot_errors_m"] for walk in walks])
    return {
        "drift_m_per_m": _percentiles(shares),
        "drift_rad_per_turn": drift_rad / turned_rad * math.tau if turned_rad else None,
        "walked_m": walked_m,
        "turned_rad": turned_rad,
        "own_foot_error_m": _percentiles(own),
        "localization_error_m": _percentiles([place["median"] for place in places]),
        **{key: sum(walk[key] for walk in walks) for key in ("fixes", "rejected", "jumps")},
    }


def _narrow_places(places: Sequence[Mapping[str, float]]) -> list[dict[str, float]]:
    """The different ones, to within a decimetre, with how many pairs each parts; most first."""
    at = [(round(place["x"], 1), round(place["y"], 1)) for place in places]
    counted = Counter(at).most_common()
    return [{**places[at.index(spot)], "pairs": count} for spot, count in counted]


def _gait(results: Sequence[Mapping[str, Any]]) -> dict[str, float] | None:
    """Medians over the walks of what their gait was like; None where nobody walked far enough."""
    gaits = [result["gait"] for result in results if result["gait"] is not None]
    if not gaits:
        return None

    def median(name: str) -> float:
        values = [gait[name] for gait in gaits]
        return float(np.median([v["median"] if isinstance(v, Mapping) else v for v in values]))

    names = ("pelvis_height_m", "pelvis_bob_m", "swing_apex_m", "peak_force_weights")
    return {name: median(name) for name in (*names, "cost_of_transport", "speed_m_s")}


def table(summary: Mapping[str, Any]) -> str:
    """The summary for people."""
    walks = summary["walks"]
    rows = {"walks": f"{walks}"}
    for outcome in Outcome:
        count = summary[str(outcome)]
        rows[str(outcome)] = f"{count} ({100 * count / walks:.1f} %)"
    parted = summary["unconnected"]
    if parted:
        rows["reached"] += f", of {walks - parted} that a way joins"
        rows["no_path"] += f"; {parted} pairs lie in parts that this robot cannot pass between"
        rows["no_path"] += "".join(
            f", {place['width_m']:.2f} m wide at {place['x']:z.1f},{place['y']:z.1f}"
            for place in summary["narrow_places"][:3]
        )
    rows["steps taken"] = f"{summary['steps_taken']}, {summary['recovery_steps']} against a push"
    rows["replans"] = f"{summary['replans']}"
    for key, title in (("foot_error_m", "feet from their steps"), ("goal_error_m", "goal missed")):
        if summary[key] is not None:
            rows[title] = ", ".join(f"{100 * v:.1f} cm {name}" for name, v in summary[key].items())
    if summary["min_clearance_m"] is not None:
        rows["least clearance"] = f"{100 * summary['min_clearance_m']:.1f} cm"
    if summary["gait"] is not None:
        rows["gait (medians)"] = (
            "pelvis {pelvis_height_m:.2f} m, bob {bob:.1f} cm, feet lifted {apex:.1f} cm, "
            "cost of transport {cost_of_transport:.2f} at {speed_m_s:.2f} m/s".format(
                bob=100 * summary["gait"]["pelvis_bob_m"],
                apex=100 * summary["gait"]["swing_apex_m"],
                **summary["gait"],
            )
        )
    if summary["sensed"] is not None:
        rows |= _sensed_rows(summary["sensed"])
    if summary["relaxed"]:
        told = (f"{stage} {count}" for stage, count in summary["relaxed"].items())
        rows["constraints dropped"] = ", ".join(told).replace("_", " ")
    return "\n".join(f"{title:<24}{value}" for title, value in rows.items())


def _sensed_rows(sensed: Mapping[str, Any]) -> dict[str, str]:
    rows: dict[str, str] = {}
    if sensed["drift_m_per_m"] is not None:
        drift = ", ".join(f"{100 * v:.1f} % {k}" for k, v in sensed["drift_m_per_m"].items())
        rows["odometry's drift"] = f"{drift} of the way"
        if sensed["drift_rad_per_turn"] is not None:
            rows["odometry's drift"] += (
                f"; {math.degrees(sensed['drift_rad_per_turn']):.1f} degrees a full turn"
            )
    for key, title in (
        ("own_foot_error_m", "feet, as it saw them"),
        ("localization_error_m", "place on the map"),
    ):
        if sensed[key] is not None:
            rows[title] = ", ".join(f"{100 * v:.1f} cm {name}" for name, v in sensed[key].items())
    return rows


def _percentiles(values: ArrayLike) -> dict[str, float] | None:
    found = Percentiles.of(values)
    return None if found is None else asdict(found)
