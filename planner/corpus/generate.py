"""Plans between random poses: on an empty floor, among random obstacles, or on a map.

Each plan has a random stream of its own, made from the seed and the plan's number. So it does not
depend on the plans before it, nor on the process that draws it.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from maps.boxes import with_boxes
from maps.grid import OccupancyGrid
from maps.images import MOST_PIXELS
from planner.collision import Terrain, terrain_of
from planner.endpoints import what_blocks
from planner.options import PlannerOptions
from planner.plan import FootstepPlan, Pose, feet_at, finite_pose
from planner.planner import Planner
from planner.robot_model import Interval, StepModel

Floats = NDArray[np.float64]

RESOLUTION_M = 0.05
# Beyond the largest box around the robot, so that a plan on the empty floor never feels its edge.
_ROOM_M = 1.0
# Length and width of the least and of the greatest obstacle.
_LEAST_BOX_M, _GREATEST_BOX_M = (0.2, 0.1), (1.0, 0.6)
# How often one plan's start and goal (and each of its obstacles) are drawn before giving up; a
# search that finds nothing costs a thousand times more than a pose that is blocked.
_DRAWS, _SEARCHES, _DRAWS_PER_BOX = 1000, 20, 100
NO_ROOM = "no_room"


@dataclass(frozen=True, kw_only=True)
class RandomPlans:
    """What to draw.

    grid: the floor without the obstacles that are drawn. start: None draws it from the whole grid.
    goal_x_m, goal_y_m, goal_yaw_rad: ranges in the world. obstacles: so many boxes for each plan.
    """

    grid: OccupancyGrid
    model: StepModel
    goal_x_m: Interval
    goal_y_m: Interval
    goal_yaw_rad: Interval
    start: Pose | None = None
    obstacles: int = 0
    seed: int = 0
    options: PlannerOptions = field(default_factory=PlannerOptions)


@dataclass(frozen=True, kw_only=True)
class Drawn:
    """One plan, its obstacles (k, 5) as in `Corpus.box`, and what became of the draws before it.

    plan is None if all draws failed. refused counts them by reason: a `PlanStatus` or "no_room"
    where the obstacles left none; reason is the last one in words.
    """

    plan: FootstepPlan | None
    box: Floats
    refused: Counter[str]
    reason: str = ""


def floor_around(poses: Sequence[Pose], model: StepModel) -> OccupancyGrid:
    """An empty floor around pair poses, with room to turn on all sides.

    Raises ValueError where it would have more cells than a map may have pixels.
    """
    xy = np.array([pose[:2] for pose in poses])
    margin_m = _ROOM_M + _body_radius_m(model)
    low = np.floor((xy.min(axis=0) - margin_m) / RESOLUTION_M)
    high = np.ceil((xy.max(axis=0) + margin_m) / RESOLUTION_M)
    if float(np.prod(high - low)) > MOST_PIXELS:
        x_m, y_m = (high - low) * RESOLUTION_M
        raise ValueError(
            f"a floor of {x_m:.4g} m x {y_m:.4g} m is too large: at most {MOST_PIXELS} cells "
            f"of {RESOLUTION_M:g} m"
        )
    cols, rows = (high - low).astype(int)
    x_m, y_m = (float(v) for v in low * RESOLUTION_M)
    return OccupancyGrid(
        cells=np.zeros((rows, cols), np.uint8), resolution_m=RESOLUTION_M, origin=(x_m, y_m, 0.0)
    )


def random_plans(wanted: RandomPlans, numbers: Iterable[int]) -> list[Drawn]:
    """The plans of these numbers."""
    terrain = terrain_of(wanted.grid, wanted.options.unknown_is_free)
    shared = Planner(wanted.grid, wanted.model, wanted.options)
    return [_draw(wanted, number, terrain, shared) for number in numbers]


def _draw(wanted: RandomPlans, number: int, terrain: Terrain, shared: Planner) -> Drawn:
    """Draws start, goal and obstacles until there is a plan."""
    rng = np.random.default_rng(np.random.SeedSequence(wanted.seed, spawn_key=(number,)))
    refused: Counter[str] = Counter()
    searches, reason = 0, ""
    while refused.total() < _DRAWS and searches < _SEARCHES:
        start, goal = wanted.start or _anywhere(wanted.grid, rng), _goal(wanted, rng)
        reason = _blocked(wanted, terrain, start, goal, refused)
        if reason:
            continue
        boxes = _boxes(wanted, start, goal, rng)
        if boxes is None:
            refused[NO_ROOM] += 1
            reason = "no room for the obstacles beside start and goal"
            continue
        plan = _planner(wanted, shared, start, goal, boxes).plan(start=start, goal=goal)
        if plan.found:
            return Drawn(plan=plan, box=boxes, refused=refused)
        refused[plan.status] += 1
        reason = plan.reason
        searches += 1
    return Drawn(plan=None, box=np.zeros((0, 5)), refused=refused, reason=reason)


def _planner(
    wanted: RandomPlans, shared: Planner, start: Pose, goal: Pose, boxes: Floats
) -> Planner:
    """The planner over the floor of one plan; shared is the one without obstacles."""
    if len(boxes):
        return Planner(with_boxes(wanted.grid, boxes), wanted.model, wanted.options)
    if not wanted.grid.cells.any() and wanted.grid.elevation_m is None:
        # The search looks at all the floor there is, and on an empty one the way needs little.
        around = floor_around([start, goal], wanted.model)
        if _holds(wanted.grid, around):
            return Planner(around, wanted.model, wanted.options)
    return shared


def _holds(floor: OccupancyGrid, part: OccupancyGrid) -> bool:
    """Whether a part lies within a floor."""
    low, high = part.bounds_world()[:2], part.bounds_world()[2:]
    corners = np.array([(x, y) for x in (low[0], high[0]) for y in (low[1], high[1])])
    inside = floor.world_to_grid(corners)
    return bool(np.all((inside >= -1e-9) & (inside <= np.array(floor.size_m) + 1e-9)))


def _goal(wanted: RandomPlans, rng: np.random.Generator) -> Pose:
    low, high = zip(wanted.goal_x_m, wanted.goal_y_m, wanted.goal_yaw_rad, strict=True)
    return finite_pose(rng.uniform(low, high))


def _anywhere(grid: OccupancyGrid, rng: np.random.Generator) -> Pose:
    x0, y0, x1, y1 = grid.bounds_world()
    return finite_pose(rng.uniform((x0, y0, -math.pi), (x1, y1, math.pi)))


def _blocked(
    wanted: RandomPlans, terrain: Terrain, start: Pose, goal: Pose, refused: Counter[str]
) -> str:
    """Why the robot cannot stand at start or goal, counted too; empty if it can."""
    for name, pose in (("start", start), ("goal", goal)):
        feet = feet_at(pose, wanted.model.stance_width_m)
        blocked = what_blocks(wanted.grid, terrain, wanted.model, feet)
        if blocked:
            refused[f"{name}_blocked"] += 1
            return f"{name}: {blocked}"
    return ""


def _boxes(wanted: RandomPlans, start: Pose, goal: Pose, rng: np.random.Generator) -> Floats | None:
    """Obstacles (k, 5) that leave the robot room to stand at start and goal; None if none do."""
    boxes = np.zeros((wanted.obstacles, 5))
    for box in boxes:
        for _ in range(_DRAWS_PER_BOX):
            x_m, y_m, yaw_rad = _anywhere(wanted.grid, rng)
            length_m, width_m = rng.uniform(_LEAST_BOX_M, _GREATEST_BOX_M)
            apart_m = min(math.dist((x_m, y_m), pose[:2]) for pose in (start, goal))
            cell_m = wanted.grid.resolution_m
            keep_m = _body_radius_m(wanted.model) + math.hypot(length_m, width_m) / 2 + cell_m
            if apart_m > keep_m:
                box[:] = x_m, y_m, length_m, width_m, yaw_rad
                break
        else:
            return None
    return boxes


def _body_radius_m(model: StepModel) -> float:
    """Radius of the circle around everything that must be free where the robot stands."""
    body = math.hypot(model.body.length_m, model.body.width_m) / 2 + model.body_margin_m
    foot = (model.stance_width_m + math.hypot(model.foot.length_m, model.foot.width_m)) / 2
    return max(body, foot + model.foot_margin_m)
