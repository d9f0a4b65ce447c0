"""A navigator that can be told something else at any time, and what is known of its walk."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.navigation.navigator import Navigator
from app.navigation.placed import Placed
from app.navigation.report import Outcome
from app.navigation.route import FootstepPlanner, Waypoint, halting_plan
from controller.evaluation.gait_summary import GaitRecorder
from controller.gait import CONTROL_PERIOD_S
from controller.step_cursor import STANCE
from maps.grid import OccupancyGrid
from planner.endpoints import Footing
from planner.plan import (
    FootstepPlan,
    NarrowPlace,
    Pose,
)
from planner.robot_model import Side
from sim.scene import min_clearance_m, scene_of

# A robot that stands is not simulated for longer: its feet would creep, and nobody would gain.
_REST_AFTER_S = 2.0
FORCE_WINDOW_S = 6.0
_PATH_EVERY_TICKS = 10


@dataclass(frozen=True, kw_only=True)
class ReplanPoint:
    """The next moment at which another plan can be taken up.

    feet_world (2, 4): where the feet will be then. first_side: which must step first; None while
    the robot stands. landing: how many feet will have landed by then since the robot was placed.
    """

    feet_world: np.ndarray
    first_side: Side | None
    landing: int


class LiveNavigator(Navigator):
    """A navigator whose plans come from outside, whenever they are ready.

    In mid-step the robot cannot change its mind: a plan from `replan_point()` waits until the foot
    in the air has landed: meanwhile it is `waiting`. `tick()` goes on balancing the robot when
    there is nowhere to go; `idle_s` is for how long it has. `stops` counts the waypoints at which
    it stood on this walk.
    """

    landings = stops = 0
    idle_s = 0.0
    going = False
    halted = False
    waiting: FootstepPlan | None = None
    _waits_for = 0

    @property
    def replans(self) -> int:
        """How often a new plan was made on the way; the one from a stop to the next is none."""
        return max(0, super().replans - self.stops)

    @property
    def has_ended(self) -> bool:
        """Whether it fell or ran into something: only a new navigator helps."""
        return self.outcome in (Outcome.FELL, Outcome.COLLIDED)

    @property
    def rests(self) -> bool:
        """Whether there is nothing to simulate until it is told to go somewhere."""
        return self.has_ended or self.idle_s > _REST_AFTER_S

    def status(self, *, is_asking: bool) -> str:
        """What it does, in a word, or how it ended and why; `is_asking` for a plan."""
        if self.halted and not self.has_ended:
            return "stopping" if self.going else "stopped"
        if is_asking and self.outcome is Outcome.REACHED:
            return "planning"
        if self.outcome is not None:
            return f"{self.outcome}" + (f": {self.reason}" if self.reason else "")
        if is_asking and not self.going:
            return "planning"
        return "walking" if self.going else "standing"

    def replan_point(self) -> ReplanPoint:
        """Where and when the next plan can be taken up."""
        cursor = self.walker.cursor
        feet = self._feet()
        if cursor.standing[0]:
            return ReplanPoint(feet_world=feet, first_side=None, landing=self.landings)
        if cursor.entry[0] < STANCE:
            # Its weight is on the way to the first support foot; the first step lands next.
            first = Side(int(cursor.side[0])).other
            feet[first] = cursor.window[0, 1]
        else:
            first = Side(int(cursor.side[0]))
            if cursor.swinging[0]:
                feet[first] = cursor.window[0, 0]
        return ReplanPoint(feet_world=feet, first_side=first.other, landing=self.landings + 1)

    def go(
        self, goal: Sequence[float], plan: FootstepPlan, replan_point: ReplanPoint, *, fresh: bool
    ) -> bool:
        """Follows a plan made from `replan_point`; false when that moment is over.

        With `fresh` a new walk begins: what is known of the one before is forgotten.
        """
        is_now = replan_point.first_side is None
        if is_now and not self.walker.cursor.standing[0]:
            return False
        if replan_point.landing != self.landings + (not is_now):
            return False
        if fresh:
            self.plans, self.placed, self.followed = [], [], []
            self.qpos, self.recovery_steps = [self.qpos[-1]], 0
            self.stops = 0
            self.gait = GaitRecorder(self.walker)
        self.goal, self.outcome, self.reason = tuple(goal), None, ""
        self.going, self.halted, self.idle_s = True, False, 0.0
        self.plans.append(plan)
        self.waiting, self._waits_for = None if is_now else plan, replan_point.landing
        if is_now:
            self._follow(plan, wait_ticks=0, walking=False)
        return True

    def may_go_on(self) -> bool:
        """Whether the step after the present one would end where the robot may stand."""
        replan_point = self.replan_point()
        if replan_point.first_side is None:
            return True
        feet = replan_point.feet_world.copy()
        following = self.walker.cursor.window[0, 1]
        if self.waiting is not None and len(self.waiting):
            following = self.waiting.pose_world[0]
        feet[replan_point.first_side] = following
        return self._footing.may_stand(feet)

    def halt(self) -> None:
        """Puts the feet side by side as soon as it can, and stands there."""
        replan_point = self.replan_point()
        if replan_point.first_side is None:
            self.waiting, self.going, self.halted, self.idle_s = None, False, True, 0.0
            return
        plan = halting_plan(
            self._footing,
            self.robot.step_model.stance_width_m,
            replan_point.feet_world,
            replan_point.first_side,
        )
        self.go(plan.goal, plan, replan_point, fresh=False)
        self.halted = True

    def set_grid(self, grid: OccupancyGrid, planner: FootstepPlanner) -> None:
        """Goes on in exactly the same state on a changed map, over which that planner plans."""
        self.scene = scene_of(grid, self.robot, self.config.planner.unknown_is_free)
        self.walker.enter(self.scene)
        self.grid, self._planner = grid, planner
        self._footing = Footing(grid, self.robot.step_model, self.config.planner.unknown_is_free)

    def tick(self) -> None:
        """One control step, on the way to a goal or on the spot."""
        if self.has_ended:
            return
        if self.going and self.outcome is None:
            super().tick()
            self.going, self.idle_s = self.outcome is None, 0.0
            return
        self.idle_s += CONTROL_PERIOD_S
        self._act()
        self.qpos[-1] = self.walker.sim.qpos[0].copy()
        self._look_for_failure()

    def _landed(self, placed: Placed) -> None:
        self.landings += 1
        waiting, self.waiting = self.waiting, None
        super()._landed(placed)
        replanned = self.followed and self.followed[-1][0] == self.time_s
        if waiting is not None and self._waits_for == self.landings and not replanned:
            self._follow(waiting, wait_ticks=0, walking=True)


@dataclass(frozen=True, kw_only=True)
class Notice:
    """Something that went wrong, in words, and a pose that would do instead, if one is known.

    Both poses are goals, or with `puts_robot` places for the robot to begin anew, or with
    `waypoint`, which is the one that is refused, poses for that. `goal` is what somebody asked for,
    `narrow_place` what is too narrow on the way there.
    """

    text: str
    refused: Pose | None = None
    alternative: Pose | None = None
    puts_robot: bool = False
    waypoint: Waypoint | None = None
    goal: Pose | None = None
    narrow_place: NarrowPlace | None = None


class WalkHistory:
    """What plots and footprints show of a walk, filled by the physics; arrays as in `Snapshot`.

    They are replaced, never changed, so any thread may read them.
    """

    def __init__(self) -> None:
        self._forces: deque[tuple[float, float, float]] = deque(
            maxlen=round(FORCE_WINDOW_S / CONTROL_PERIOD_S)
        )
        self._ticks = 0
        self.walk = 0
        self.clearance_m: float | None = None
        self.placed_side = np.zeros(0, np.int8)
        self.placed_world = np.zeros((0, 4))
        self.foot_error_m = np.zeros(0)
        self.path_world = np.zeros((0, 2))

    def begin(self, navigator: Navigator) -> None:
        """A new walk: what is known of the one before is forgotten."""
        self.walk += 1
        self.clearance_m = None
        self.landed(navigator)

    def ticked(self, navigator: Navigator) -> None:
        """Notes the forces on the feet."""
        self._ticks += 1
        sensors = navigator.scene.sensors.ground_force_world[:, 2]
        left, right = navigator.walker.sim.sensors[0, :, sensors].mean(axis=-1)
        self._forces.append((self._ticks * CONTROL_PERIOD_S, float(left), float(right)))

    def landed(self, navigator: Navigator) -> None:
        """Notes a step that was taken, and how near a wall the robot is."""
        placed = navigator.placed
        self.placed_side = np.array([step.side for step in placed], np.int8)
        self.placed_world = np.array([step.placed_world for step in placed]).reshape(-1, 4)
        self.foot_error_m = np.array([step.error_m for step in placed])
        self.path_world = np.array([qpos[:2] for qpos in navigator.qpos[::_PATH_EVERY_TICKS]])
        near = min_clearance_m(navigator.scene, navigator.qpos[-1][None])
        if near is not None:
            self.clearance_m = near if self.clearance_m is None else min(near, self.clearance_m)

    def forces(self) -> np.ndarray:
        """Time in s and upward force on the left and right foot in N, (3, T), the latest last."""
        return np.array(list(self._forces) or [(0.0, 0.0, 0.0)]).T
