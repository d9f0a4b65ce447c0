"""A navigator that can be told something else at any time: goal, map, stop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.navigation.navigator import FootstepPlanner, Navigator, Placed
from app.navigation.report import Outcome
from controller.evaluation.gait_summary import GaitRecorder
from controller.gait import CONTROL_PERIOD_S
from controller.step_cursor import STANCE
from controller.walker import Walker
from maps.grid import OccupancyGrid
from planner.endpoints import Footing
from planner.plan import FootstepPlan, feet_at, pair_pose
from planner.robot_model import Side
from sim.scene import scene_of

# A robot that stands is not simulated for longer: its feet would creep, and nobody would gain.
_REST_AFTER_S = 2.0


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

    In mid-step the robot cannot change its mind: a plan from `ahead()` waits until the foot in the
    air has landed. `tick()` goes on balancing the robot when there is nowhere to go; `idle_s` is
    for how long it has.
    """

    landings = 0
    idle_s = 0.0
    going = False
    halted = False
    _waiting: tuple[FootstepPlan, int] | None = None

    @property
    def has_ended(self) -> bool:
        """Whether it fell or ran into something: only a new navigator helps."""
        return self.outcome in (Outcome.FELL, Outcome.COLLIDED)

    @property
    def rests(self) -> bool:
        """Whether there is nothing to simulate until it is told to go somewhere."""
        return self.has_ended or self.idle_s > _REST_AFTER_S

    @property
    def waiting(self) -> FootstepPlan | None:
        """The plan that will be taken up when the foot in the air has landed."""
        return None if self._waiting is None else self._waiting[0]

    def status(self, *, is_asking: bool) -> str:
        """What it does, in a word, or how it ended and why; `is_asking` for a plan."""
        if self.halted and not self.has_ended:
            return "stopping" if self.going else "stopped"
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
        standing = bool(self.walker.cursor.standing[0])
        now = replan_point.landing == self.landings and standing and replan_point.first_side is None
        if not now and (
            replan_point.first_side is None or replan_point.landing != self.landings + 1
        ):
            return False
        if fresh:
            self.plans, self.placed, self.followed = [], [], []
            self.qpos = [self.qpos[-1]]
            self._gait = GaitRecorder(self.walker)
        self.goal, self.outcome, self.reason = tuple(goal), None, ""
        self.going, self.halted, self.idle_s = True, False, 0.0
        self.plans.append(plan)
        if now:
            self._waiting = None
            self._follow(plan, wait_ticks=0, walking=False)
        else:
            self._waiting = plan, replan_point.landing
        return True

    def halt(self) -> None:
        """Puts the feet side by side as soon as it can, and stands there."""
        replan_point = self.replan_point()
        if replan_point.first_side is None:
            self._waiting, self.going, self.halted, self.idle_s = None, False, True, 0.0
            return
        support = replan_point.feet_world[replan_point.first_side.other]
        feet = _beside(support, replan_point.first_side, self.robot.step_model.stance_width_m)
        feet = self._footing.at_rest(feet)
        goal, start = pair_pose(feet), pair_pose(replan_point.feet_world)
        plan = FootstepPlan(
            start_feet_world=replan_point.feet_world,
            start=(start[0], start[1], start[2]),
            goal=(goal[0], goal[1], goal[2]),
            side=np.array([replan_point.first_side], np.int8),
            pose_world=feet[replan_point.first_side][None],
        )
        self.go(plan.goal, plan, replan_point, fresh=False)
        self.halted = True

    def use_planner(self, planner: FootstepPlanner) -> None:
        """Asks this one from now on."""
        self._planner = planner

    def set_grid(self, grid: OccupancyGrid) -> None:
        """Goes on in exactly the same state on a changed map."""
        before = self.walker
        scene = scene_of(grid, self.robot, self.config.planner.unknown_is_free)
        walker = Walker(scene, threads=1, record=("qvel",))
        walker.place(0, before.sim.qpos[0], before.sim.qvel[0])
        walker.cursor, walker.action = before.cursor, before.action
        walker.sim.sensors[:] = before.sim.sensors
        self.grid, self.scene, self.walker = grid, scene, walker
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
        self.walker.act(self.policy.act(self.walker.observe()))
        self.qpos[-1] = self.walker.sim.qpos[0].copy()
        self._look_for_failure()

    def _landed(self, placed: Placed) -> None:
        self.landings += 1
        waiting, self._waiting = self._waiting, None
        super()._landed(placed)
        replanned = self.followed and self.followed[-1][0] == self.time_s
        if waiting is not None and waiting[1] == self.landings and not replanned:
            self._follow(waiting[0], wait_ticks=0, walking=True)


def _beside(support: np.ndarray, side: Side, width_m: float) -> np.ndarray:
    """Both feet (2, 4) of a robot that stands with its other foot at the pose support (4,)."""
    x_m, y_m, z_m, yaw_rad = support
    half_m = side.outward * width_m / 2
    middle = (x_m - half_m * np.sin(yaw_rad), y_m + half_m * np.cos(yaw_rad), yaw_rad)
    feet = feet_at(middle, width_m)
    feet[:, 2] = z_m
    return feet
