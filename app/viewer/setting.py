"""What a walk takes place in: map and boxes, robot and policy, where it begins, how it plans."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from app.navigation.navigator import NavigatorConfig, PlansSteps
from app.viewer.live_navigator import Rover
from app.viewer.nearest_pose import Stand, place_to_stand
from app.viewer.obstacles import Obstacle, with_obstacles
from app.viewer.questions import World
from controller.policy import Policy
from maps.grid import OccupancyGrid
from planner.options import PlannerOptions
from planner.plan import Pose
from sim.robot import Robot


@dataclass(frozen=True, kw_only=True)
class Setting:
    """All that a walk depends on besides its goal; `dataclasses.replace` makes another one.

    bare_grid: the map without the boxes. start: where the robot is put.
    """

    bare_grid: OccupancyGrid
    robot: Robot
    policy: Policy
    start: Pose
    options: PlannerOptions
    seed: int
    obstacles: tuple[Obstacle, ...] = ()

    @cached_property
    def grid(self) -> OccupancyGrid:
        """The map with the boxes."""
        return with_obstacles(self.bare_grid, self.obstacles)

    @property
    def world(self) -> World:
        """What is planned over."""
        return World(grid=self.grid, model=self.robot.step_model, options=self.options)

    def stand(self, pose: Pose) -> Stand:
        """Whether the robot can be put at a pose."""
        unknown_is_free = self.options.unknown_is_free
        return place_to_stand(self.grid, self.robot.step_model, unknown_is_free, pose)

    def rover(self, *, goal: Pose | None = None, planner: PlansSteps | None) -> Rover:
        """A robot that stands at the start, with a goal or without; None plans in this process."""
        return Rover(
            self.grid,
            self.robot,
            self.policy,
            start=self.start,
            goal=self.start if goal is None else goal,
            seed=self.seed,
            config=NavigatorConfig(planner=self.options),
            planner=planner,
        )


def finite_pose(values: Sequence[float]) -> Pose:
    """Three numbers as a pose.

    Raises:
        ValueError: One of them is not finite.
    """
    x_m, y_m, yaw_rad = (float(value) for value in values)
    if not all(map(math.isfinite, (x_m, y_m, yaw_rad))):
        raise ValueError(f"pose {x_m:g},{y_m:g},{yaw_rad:g} must be finite numbers")
    return x_m, y_m, yaw_rad
