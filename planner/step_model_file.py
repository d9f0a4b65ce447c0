"""Step models in YAML files: this project's format, and that of humanoid_navigation.

`docs/ros.md` lists the keys. The old package had two files for a robot, `footsteps_NAME.yaml` and
`planning_params_NAME.yaml`; either name stands for both.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from maps.files import MOST_YAML_BYTES, from_yaml, read_limited
from planner.robot_model import BodyShape, FootShape, StepLimits, StepModel, check_polygon

FORMAT = "step-model/1"
_OLD_NAMES = ("footsteps_", "planning_params_")
_SHAPES = ("foot", "body", "limits", "steps")
_LIMITS = tuple(field.name for field in dataclasses.fields(StepLimits))
_NUMBERS = tuple(f.name for f in dataclasses.fields(StepModel) if f.name not in _SHAPES)
_NEEDED = ("foot", "body", "limits", "steps", "stance_width_m")
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


class StepModelError(ValueError):
    """A file that holds no step model: the message names the key and what would be right."""


def load_step_model(path: Path) -> tuple[str, StepModel, tuple[str, ...]]:
    """Name, step model, and keys that mean nothing here, of a YAML file.

    Raises:
        StepModelError: The file cannot be read, a key is missing or unknown, or a value is wrong.
    """
    if is_old(path):
        both = read_old(path)
        name = path.stem.removeprefix(_prefix(path))
        return name, old_step_model(both, path), unknown_old_keys(both)
    document = _read(path)
    if document.get("format") != FORMAT:
        raise StepModelError(
            f"{path}: format is {document.get('format')!r}, must be {FORMAT!r}; the old package's "
            "files are named footsteps_NAME.yaml and planning_params_NAME.yaml"
        )
    _check_keys(path, "", document, known=("format", "name", *_SHAPES, *_NUMBERS), needed=_NEEDED)
    limits = _section(path, document, "limits", _LIMITS, ("x_m", "y_m", "yaw_rad"))
    with_shape: dict[str, Any] = {
        "foot": FootShape(**_sizes(path, document, "foot")),
        "body": BodyShape(**_sizes(path, document, "body")),
        "limits": _made(
            path,
            lambda: StepLimits(
                **{
                    key: _points(path, key, value, 2)
                    if key == "reach_m"
                    else _interval(path, f"limits.{key}", value)
                    for key, value in limits.items()
                }
            ),
        ),
        "steps": _points(path, "steps", document["steps"], 3),
    }
    numbers: dict[str, Any] = {
        key: _number(path, key, document[key]) for key in _NUMBERS if key in document
    }
    if "headings" in numbers:
        numbers["headings"] = _whole(path, "headings", document["headings"])
    model = _made(path, lambda: StepModel(**with_shape, **numbers))
    return str(document.get("name", path.stem)), model, ()


def read_old(path: Path) -> dict[str, Any]:
    """The keys of both files of the old package's pair, given either name.

    Raises:
        StepModelError: A file cannot be read.
    """
    name = path.name.removeprefix(_prefix(path))
    document: dict[str, Any] = {}
    for prefix in _OLD_NAMES:
        document |= _read(path.with_name(f"{prefix}{name}"))
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
    _check_keys(path, "", document, needed=("foot", "footsteps"))

    def number(*keys: str, default: float | None = None) -> float:
        value: Any = document
        for key in keys:
            value = value.get(key) if isinstance(value, Mapping) else None
        if value is None and default is not None:
            return default
        if value is None:
            raise StepModelError(f"{path}: key {'/'.join(keys)!r} is missing")
        return _number(path, "/".join(keys), value)

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
        _made(path, lambda: check_polygon("step_range", reach_m))
    bins = number("accuracy", "num_angle_bins", default=64)
    return _made(
        path,
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
            headings=_whole(path, "accuracy/num_angle_bins", bins),
        ),
    )


def _read(path: Path) -> dict[str, Any]:
    try:
        document = from_yaml(read_limited(path, MOST_YAML_BYTES).decode("utf-8"))
    except OSError as error:
        raise StepModelError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise StepModelError(f"{path}: {error}") from None
    if not isinstance(document, dict):
        raise StepModelError(f"{path}: must hold keys and values, holds {document!r:.40}")
    return {str(key): value for key, value in document.items()}


def _check_keys(
    path: Path,
    within: str,
    document: Mapping[str, Any],
    *,
    known: tuple[str, ...] | None = None,
    needed: tuple[str, ...] = (),
) -> None:
    for key in needed:
        if key not in document:
            raise StepModelError(f"{path}: key {within + key!r} is missing")
    for key in document if known is not None else ():
        if key not in (known or ()):
            raise StepModelError(
                f"{path}: key {within + str(key)!r} is unknown; there are {', '.join(known or ())}"
            )


def _section(
    path: Path,
    document: Mapping[str, Any],
    name: str,
    known: tuple[str, ...],
    needed: tuple[str, ...],
) -> dict[str, Any]:
    section = document[name]
    if not isinstance(section, Mapping):
        raise StepModelError(f"{path}: {name} must hold {', '.join(needed)}")
    _check_keys(path, f"{name}.", section, known=known, needed=needed)
    return dict(section)


def _sizes(path: Path, document: Mapping[str, Any], name: str) -> dict[str, float]:
    keys = ("length_m", "width_m")
    section = _section(path, document, name, keys, keys)
    sizes = {key: _number(path, f"{name}.{key}", section[key]) for key in keys}
    for key, size_m in sizes.items():
        if size_m <= 0:
            raise StepModelError(f"{path}: {name}.{key} {size_m:g} must be above 0")
    return sizes


def _number(path: Path, key: str, value: Any) -> float:
    if not isinstance(value, bool) and isinstance(value, (int, float)):
        with contextlib.suppress(OverflowError):  # of whole numbers with hundreds of digits
            if math.isfinite(value):
                return float(value)
    raise StepModelError(f"{path}: {key} {value!r} must be a finite number")


def _whole(path: Path, key: str, value: Any) -> int:
    if _number(path, key, value) != int(value):
        raise StepModelError(f"{path}: {key} {value!r} must be a whole number")
    return int(value)


def _interval(path: Path, key: str, value: Any) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 2:
        raise StepModelError(f"{path}: {key} {value!r} must be two numbers, such as [-0.1, 0.3]")
    low, high = (_number(path, key, one) for one in value)
    return low, high


def _points(path: Path, key: str, value: Any, width: int) -> tuple[Any, ...]:
    if not isinstance(value, list) or not all(
        isinstance(row, list) and len(row) == width for row in value
    ):
        raise StepModelError(f"{path}: {key} must be a list of lists of {width} numbers")
    return tuple(tuple(_number(path, key, one) for one in row) for row in value)


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
    columns = [[_number(path, f"{name}/{axis}", v) for v in section[axis]] for axis in axes]
    if len({len(column) for column in columns}) != 1:
        counts = ", ".join(f"{len(c)} {axis}" for axis, c in zip(axes, columns, strict=True))
        raise StepModelError(f"{path}: {name} must have as many of each, has {counts}")
    return tuple(zip(*columns, strict=True))


def _counter_clockwise(points: tuple[Any, ...]) -> tuple[Any, ...]:
    around = zip(points, (*points[1:], points[0]), strict=True)
    area = sum(a[0] * b[1] - b[0] * a[1] for a, b in around)
    return points if area > 0 else points[::-1]


def _made(path: Path, make: Callable[[], Any]) -> Any:
    """What `make` gives; its ValueError becomes one that names the file."""
    try:
        return make()
    except StepModelError:
        raise
    except ValueError as error:
        raise StepModelError(f"{path}: {error}") from None
