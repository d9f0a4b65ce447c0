"""Parameters of the old package's node footstep_planner, as ROS parameters or in its files."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from planner.options import FULL, HEURISTIC_PLANNERS, PlannerOptions
from planner.robot_model import StepModel
from planner.step_model_file import StepModelError, old_step_model, unknown_old_keys

# Of the old node, where nothing else is asked for.
ALLOCATED_TIME_S = 7.0
_CHANGED_CELLS_LIMIT = 20_000
_PLANNERS = {"ARAPlanner": "ara", "ADPlanner": "adstar", "RSTARPlanner": "rstar"}
_HEURISTICS = {
    "EuclideanHeuristic": "euclidean",
    "EuclStepCostHeuristic": "steps",
    "PathCostHeuristic": "path",
}


@dataclass(frozen=True, kw_only=True)
class NodeParameters:
    """What the node plans by.

    sole_ahead_m: how far the middle of the sole lies before the origin of the foot's frame.
    changed_cells_limit: where more of the map's cells change, the planner begins anew. warnings:
    one line for what has no effect.
    """

    model: StepModel
    options: PlannerOptions
    sole_ahead_m: float = 0.0
    changed_cells_limit: int = _CHANGED_CELLS_LIMIT
    warnings: tuple[str, ...] = ()


def read_parameters(
    document: Mapping[str, Any], path: Path, model: StepModel, options: PlannerOptions
) -> NodeParameters:
    """The parameters in a document; path: the file or namespace of ROS that it is from.

    model, options: what holds where the document has no word on it.

    Raises:
        StepModelError: A value is wrong or missing.
    """
    warnings, sole_ahead_m = [], 0.0
    unknown = unknown_old_keys(document)
    if unknown:
        warnings.append(f"{path}: unknown parameters are left out: {', '.join(unknown)}")
    if "foot" in document or "footsteps" in document:
        model = old_step_model(document, path)
        shift = document["foot"].get("origin_shift")
        shift = shift if isinstance(shift, Mapping) else {}
        sole_ahead_m = _number(path, shift, "x", 0.0, within="foot/origin_shift/")
        if _number(path, shift, "y", 0.0, within="foot/origin_shift/"):
            warnings.append(f"{path}: foot/origin_shift/y is left out: soles are centred sideways")
    else:
        alone = [key for key in ("accuracy", "step_cost", "diff_angle_cost") if key in document]
        if alone:
            warnings.append(f"{path}: {', '.join(alone)}: no effect without foot and footsteps")
    limit = _number(path, document, "changed_cells_limit", _CHANGED_CELLS_LIMIT)
    return NodeParameters(
        model=model,
        options=_options(document, path, options),
        sole_ahead_m=sole_ahead_m,
        changed_cells_limit=int(limit),
        warnings=tuple(warnings),
    )


def _options(document: Mapping[str, Any], path: Path, options: PlannerOptions) -> PlannerOptions:
    name, heuristic = options.name, options.heuristic
    if "planner_type" in document:
        name = _named(path, document, "planner_type", _PLANNERS)
    if name == "ara" and not _switch(path, document, "forward_search", True):
        name = "backward"
    if "heuristic_type" in document:
        heuristic = _named(path, document, "heuristic_type", _HEURISTICS)
    epsilon = _number(path, document, "initial_epsilon", options.epsilon)
    if epsilon < 1.0:
        raise StepModelError(f"{path}: initial_epsilon {epsilon:g} must be at least 1")
    time_limit_s = _number(path, document, "allocated_time", ALLOCATED_TIME_S)
    if time_limit_s <= 0:
        raise StepModelError(f"{path}: allocated_time {time_limit_s:g} must be above 0")
    return dataclasses.replace(
        options,
        name=name,
        # Searches from the goal have a heuristic of their own.
        heuristic=heuristic if name in HEURISTIC_PLANNERS else FULL,
        epsilon=epsilon,
        time_limit_s=time_limit_s,
        # Who names a time is given plans that are improved until then.
        improve_expansions=None if "allocated_time" in document else options.improve_expansions,
        stop_at_first=_switch(path, document, "search_until_first_solution", False),
        record=True,
    )


def _named(path: Path, document: Mapping[str, Any], key: str, names: Mapping[str, str]) -> str:
    value = document[key]
    if value not in names:
        raise StepModelError(f"{path}: {key} {value!r} must be one of {', '.join(names)}")
    return names[value]


def _switch(path: Path, document: Mapping[str, Any], key: str, default: bool) -> bool:
    value = document.get(key, default)
    if not isinstance(value, bool):
        raise StepModelError(f"{path}: {key} {value!r} must be true or false")
    return value


def _number(
    path: Path, document: Mapping[str, Any], key: str, default: float, within: str = ""
) -> float:
    value = document.get(key, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < math.inf:
        raise StepModelError(f"{path}: {within}{key} {value!r} must be a finite number")
    return float(value)
