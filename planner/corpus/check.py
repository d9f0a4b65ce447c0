"""The command `dataset check`: every step of a corpus, by geometry that no search uses."""

from __future__ import annotations

import dataclasses
import math
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maps.boxes import with_boxes
from maps.grid import OccupancyGrid
from maps.images import MOST_PIXELS
from maps.map_files import MapError, load_map
from planner.corpus.corpus import MANIFEST, Corpus, CorpusError
from planner.plan import FootstepPlan, PlanStatus, finite_pose
from planner.robot_model import StepModel
from planner.verify import violations


@dataclass(frozen=True, kw_only=True)
class Rules:
    """What the plans of a corpus must keep to: the floor that all share, and the robot's limits."""

    grid: OccupancyGrid
    model: StepModel
    unknown_is_free: bool


Portion = list[tuple[FootstepPlan, NDArray[np.float64]]]


def check_plans(rules: Rules, portion: Portion) -> list[list[str]]:
    """What is wrong with each of these plans."""
    return [
        violations(
            plan,
            with_boxes(rules.grid, boxes),
            rules.model,
            unknown_is_free=rules.unknown_is_free,
        )
        for plan, boxes in portion
    ]


def plan_of(corpus: Corpus, i: int, stance_width_m: float) -> FootstepPlan:
    """Plan i as a value of its own, which begins at the pair pose of its start."""
    side, pose = corpus.plan(i)
    return FootstepPlan(
        start_feet_world=corpus.start_feet(i, stance_width_m),
        start=finite_pose(corpus.start[i]),
        goal=finite_pose(corpus.goal[i]),
        side=side,
        pose_world=pose,
        robot=corpus.robot,
        status=PlanStatus(str(corpus.status[i])),
        cost_m=float(corpus.cost_m[i]),
    )


def rules_of(folder: Path, corpus: Corpus) -> Rules:
    """The floor and the step model that the manifest tells of.

    Raises:
        CorpusError: It does not tell them.
        MapError: The map beside it cannot be read.
    """
    manifest = corpus.manifest
    try:
        if manifest["map"] is not None:
            grid = load_map(folder / str(manifest["map"]["file"]))
        else:
            grid = _floor(manifest["floor"])
        return Rules(
            grid=grid,
            model=from_document(StepModel, manifest["step_model"]),
            unknown_is_free=bool(manifest["planner"]["unknown_is_free"]),
        )
    except KeyError as error:
        raise CorpusError(f"{folder}: {MANIFEST}: {error} is missing") from None
    except MapError:
        raise
    except (TypeError, ValueError) as error:
        raise CorpusError(f"{folder}: {MANIFEST}: {error}") from None


def _floor(document: Mapping[str, Any]) -> OccupancyGrid:
    rows, cols = int(document["rows"]), int(document["cols"])
    if not 0 < rows * cols <= MOST_PIXELS or rows < 1:
        raise ValueError(f"floor {rows} x {cols} must have from 1 to {MOST_PIXELS} cells")
    return OccupancyGrid(
        cells=np.zeros((rows, cols), np.uint8),
        resolution_m=float(document["resolution_m"]),
        origin=finite_pose(document["origin"]),
    )


Value = typing.TypeVar("Value")


def from_document(kind: type[Value], document: Any) -> Value:
    """The dataclass that `dataclasses.asdict` and JSON made a document of.

    Raises:
        TypeError, ValueError: The document has other keys, or values of other types.
    """
    if not isinstance(document, Mapping):
        raise TypeError(f"{kind.__name__} {document!r} must be an object with keys")
    kinds = typing.get_type_hints(kind)
    unknown = document.keys() - kinds.keys()
    if unknown:
        raise TypeError(f"{kind.__name__} has no {min(unknown)!r}: another version wrote this")
    return kind(**{name: _value(kinds[name], value) for name, value in document.items()})


def _value(kind: Any, value: Any) -> Any:
    """A value of a type hint: a dataclass, a tuple or union of values, or a plain one."""
    if dataclasses.is_dataclass(kind) and isinstance(kind, type):
        return from_document(kind, value)
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        options = [option for option in typing.get_args(kind) if option is not type(None)]
        return None if value is None else _value(options[0], value)
    if typing.get_origin(kind) is tuple:
        if not isinstance(value, list):
            raise TypeError(f"{value!r} must be a list")
        inner = typing.get_args(kind)
        kinds = [inner[0]] * len(value) if inner[-1] is Ellipsis else list(inner)
        return tuple(_value(k, v) for k, v in zip(kinds, value, strict=True))
    if isinstance(value, bool | int | float) and not math.isfinite(value):
        raise ValueError(f"{value!r} must be finite")
    return value
