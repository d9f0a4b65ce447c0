"""Step models in YAML files: this project's format, and that of humanoid_navigation.

`docs/ros.md` lists the keys. The old package had two files for a robot, `footsteps_NAME.yaml` and
`planning_params_NAME.yaml`; either name stands for both.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from maps.yaml_files import Section, YamlFileError, finite, read_yaml
from planner.robot_model import (
    BodyShape,
    FootShape,
    StepLimits,
    StepModel,
    check_polygon,
    step_model_of,
)

FORMAT = "step-model/1"
_OLD_NAMES = ("footsteps_", "planning_params_")
_OLD_SHAPE = {
    *("accuracy/collision_check", "accuracy/cell_size", "accuracy/num_angle_bins"),
    *("step_cost", "diff_angle_cost", "step_range/x", "step_range/y"),
    *("foot/size/x", "foot/size/y", "foot/size/z", "foot/separation"),
    *("foot/origin_shift/x", "foot/origin_shift/y"),
    *(f"foot/max/{which}step/{axis}" for which in ("", "inverse/") for axis in ("x", "y", "theta")),
    *("footsteps/x", "footsteps/y", "footsteps/theta"),
}
# What the old package's files say of its search, which this one's options say in their own way.
_OLD_SEARCH = {
    *("planner_type", "heuristic_type", "heuristic_scale", "allocated_time", "initial_epsilon"),
    *("forward_search", "search_until_first_solution", "changed_cells_limit", "max_hash_size"),
    *("num_random_nodes", "random_node_dist"),
}


# A file that holds no step model: the message names the key and what would be right.
StepModelError = YamlFileError


def load_step_model(path: Path) -> tuple[str, StepModel, tuple[str, ...]]:
    """Name, step model, and keys that mean nothing here, of a YAML file.

    Raises:
        StepModelError: The file cannot be read, a key is missing or unknown, or a value is wrong.
    """
    if is_old(path):
        both = read_old(path)
        name = path.stem.removeprefix(_prefix(path))
        return name, old_step_model(both, path), unknown_old_keys(both)
    document = read_yaml(path)
    format_ = document.values.get("format")
    if format_ != FORMAT:
        raise StepModelError(
            f"{path}: format is {format_!r}, must be {FORMAT!r}; the old package's "
            "files are named footsteps_NAME.yaml and planning_params_NAME.yaml"
        )
    model = step_model_of(document, beside=("format", "name"))
    return str(document.values.get("name", path.stem)), model, ()


def read_old(path: Path) -> dict[str, Any]:
    """The keys of both files of the old package's pair, given either name.

    Raises:
        StepModelError: A file cannot be read.
    """
    name = path.name.removeprefix(_prefix(path))
    document: dict[str, Any] = {}
    for prefix in _OLD_NAMES:
        document |= read_yaml(path.with_name(f"{prefix}{name}")).values
    return document


def is_old(path: Path) -> bool:
    """Whether a file is one of the old package's pair, by its name."""
    return path.name.startswith(_OLD_NAMES)


def _prefix(path: Path) -> str:
    return next(prefix for prefix in _OLD_NAMES if path.name.startswith(prefix))


def unknown_old_keys(document: Mapping[str, Any]) -> tuple[str, ...]:
    """Keys that the old package did not have, such as foot/sise, in alphabetical order."""

    def leaves(within: str, value: Any) -> Iterator[str]:
        if not isinstance(value, Mapping) or not value:
            yield within
            return
        for key, inner in value.items():
            yield from leaves(f"{within}/{key}" if within else str(key), inner)

    return tuple(sorted(set(leaves("", document)) - _OLD_SHAPE - _OLD_SEARCH - {""}))


def old_step_model(document: Mapping[str, Any], path: Path) -> StepModel:
    """The step model in parameters of the old package.

    path: the file, or the namespace of ROS, that they are from; errors name it.

    Raises:
        StepModelError: A key is missing, or a value is wrong.
    """
    file = Section(path, document)
    file.check_keys(("foot", "footsteps"))

    def number(*keys: str, default: float | None = None) -> float:
        value: Any = document
        for key in keys:
            value = value.get(key) if isinstance(value, Mapping) else None
        if value is None and default is not None:
            return default
        if value is None:
            raise StepModelError(f"{path}: key {'/'.join(keys)!r} is missing")
        return finite(path, "/".join(keys), value)

    def interval(axis: str) -> tuple[float, float]:
        low, high = (
            number("foot", "max", "inverse", "step", axis),
            number("foot", "max", "step", axis),
        )
        return low, high

    length_m, width_m = number("foot", "size", "x"), number("foot", "size", "y")
    separation_m = number("foot", "separation")
    reach_m = _columns(path, document, "step_range", ("x", "y")) if "step_range" in document else ()
    if len(reach_m) > 1 and reach_m[0] == reach_m[-1]:
        reach_m = reach_m[:-1]
    if reach_m:
        reach_m = _counter_clockwise(reach_m)
        file.made(lambda: check_polygon("step_range", reach_m))
    bins = {"accuracy/num_angle_bins": number("accuracy", "num_angle_bins", default=64)}
    return file.made(
        lambda: StepModel(
            foot=FootShape(length_m=length_m, width_m=width_m),
            # The old planner knew feet only: the body is as large as both of them side by side.
            body=BodyShape(length_m=length_m, width_m=separation_m + width_m),
            limits=StepLimits(
                x_m=interval("x"), y_m=interval("y"), yaw_rad=interval("theta"), reach_m=reach_m
            ),
            steps=_columns(path, document, "footsteps", ("x", "y", "theta")),
            stance_width_m=separation_m,
            step_cost_m=number("step_cost", default=0.05),
            turn_cost_m=number("diff_angle_cost", default=0.0),
            foot_gap_m=0.0,
            cell_m=number("accuracy", "cell_size", default=0.01),
            headings=Section(path, bins).whole("accuracy/num_angle_bins"),
        ),
    )


def _columns(
    path: Path, document: Mapping[str, Any], name: str, axes: tuple[str, ...]
) -> tuple[Any, ...]:
    """Points of lists of their coordinates, one for each axis."""
    section = document[name]
    if not isinstance(section, Mapping):
        raise StepModelError(f"{path}: {name} must hold the lists {', '.join(axes)}")
    for axis in axes:
        if not isinstance(section.get(axis), list):
            raise StepModelError(f"{path}: key '{name}/{axis}' must be a list of numbers")
    columns = [[finite(path, f"{name}/{axis}", v) for v in section[axis]] for axis in axes]
    if len({len(column) for column in columns}) != 1:
        counts = ", ".join(f"{len(c)} {axis}" for axis, c in zip(axes, columns, strict=True))
        raise StepModelError(f"{path}: {name} must have as many of each, has {counts}")
    return tuple(zip(*columns, strict=True))


def _counter_clockwise(points: tuple[Any, ...]) -> tuple[Any, ...]:
    around = zip(points, (*points[1:], points[0]), strict=True)
    area = sum(a[0] * b[1] - b[0] * a[1] for a, b in around)
    return points if area > 0 else points[::-1]
