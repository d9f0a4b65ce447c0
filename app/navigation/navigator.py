"""The loop that joins everything: plan, next two steps, policy, physics, and plan again."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from app.navigation.placed import Placed
from app.navigation.report import (
    NavigationReport,
    Outcome,
    Percentiles,
    PolicyFile,
    installed_versions,
)
from app.navigation.route import FootstepPlanner, halting_plan, plan_through
from app.navigation.sensed import Sensing, SensingConfig, in_frame, in_map
from controller.evaluation.gait_summary import GaitRecorder
from controller.evaluation.push_recovery import random_pushes
from controller.gait import CONTROL_PERIOD_S, step_durations_s
from controller.lipm.servos import report_of
from controller.policy import Policy
from controller.recovery import change_steps, step_change
from controller.step_cursor import STANCE, StepSequence
from controller.walker import Controller, Walker
from maps.grid import OccupancyGrid
from planner.endpoints import Footing
from planner.options import PlannerOptions
from planner.plan import FootstepPlan, Pose, finite_pose, pair_pose, wrap_angle
from planner.planner import Planner
from planner.robot_model import Side
from sim.engines import MUJOCO, Engine
from sim.hardware import HardwareErrors
from sim.robot import Robot
from sim.scene import min_clearance_m, scene_of

GOAL_TOLERANCE_M = 0.10
GOAL_TOLERANCE_RAD = math.radians(10.0)
_PUSHES = 1  # makes their draws differ from those of the joints' noise
# Shares of the move of a step that are tried when the whole of it would end on an obstacle.
_MOVE_SHARES = (1.0, 0.75, 0.5, 0.25, 0.0)


@dataclass(frozen=True, kw_only=True)
class NavigatorConfig:
    """When to plan again, when to give up, the `pace` of the steps, pushes, and the engine.

    `pace` is one of `PACES`. The pelvis is pushed by `push_n_s` over 0.1 s in a direction drawn
    anew, every 3 to 5 s. With `sensing` the robot knows no more than it measures. `hardware` is
    how it and the ground differ from the model.
    """

    replan_error_m: float = 0.06
    replan_error_rad: float = 0.20
    replan_error_z_m: float = 0.03
    max_replans: int = 20
    wait_s: float = 0.5
    settle_s: float = 1.0
    settle_limit_s: float = 4.0
    still_speed_m_s: float = 0.05
    spare_time_s: float = 10.0
    joint_noise_rad: float = 0.01
    pace: str = "normal"
    push_n_s: float = 0.0
    sensing: SensingConfig | None = None
    engine: Engine = MUJOCO
    hardware: HardwareErrors | None = None
    planner: PlannerOptions = field(default_factory=PlannerOptions)


class Navigator:
    """One robot on its way to a goal: `plan()` once, then `tick()` until `outcome` is set.

    Poses are x_m, y_m, yaw_rad in the world; time passes only in `tick()`. `plans` holds all plans
    that were made, `followed` those that were walked, each with the time at which it was taken up,
    `placed` each step as asked for and as placed, `qpos` the robot's state at each control step.
    `recovery_steps` is how many steps were moved or hastened against a push.
    """

    def __init__(
        self,
        grid: OccupancyGrid,
        robot: Robot,
        policy: Controller,
        *,
        start: Sequence[float],
        goal: Sequence[float],
        seed: int = 0,
        config: NavigatorConfig | None = None,
        planner: FootstepPlanner | None = None,
    ):
        self.config = config = config or NavigatorConfig()
        self.grid, self.robot, self.policy = grid, robot, policy
        self.start, self.goal, self.seed = tuple(start), tuple(goal), seed
        unknown_is_free = self.config.planner.unknown_is_free
        self.scene = scene_of(grid, robot, unknown_is_free)
        self.walker = Walker(
            self.scene, record=("qvel",), engine=config.engine, hardware=config.hardware, seed=seed
        )
        self._act = policy.start(self.walker)
        self.gait = GaitRecorder(self.walker)
        self._footing = Footing(grid, robot.step_model, unknown_is_free)
        self._planner = planner or Planner(grid, robot.step_model, self.config.planner)
        qpos = self.scene.qpos_at(np.array(self.start), self._footing.stand_m(self.start))
        self._start_feet = self._footing.at_rest(self.scene.soles_at(qpos))
        noise = np.random.default_rng(seed).uniform(-1, 1, len(robot.joints))
        qpos[self.scene.joint_qpos] += self.config.joint_noise_rad * noise
        self.walker.place(0, qpos)
        sensing = self.config.sensing
        self.sensing = None if sensing is None else Sensing(self.walker, sensing, seed=seed)
        self._halts = False
        # Until there is a plan it stands where it is: its next two steps are its own feet.
        self.walker.follow(
            0, StepSequence.of(self._start_feet, np.zeros(0, np.int8), np.zeros((0, 4)))
        )
        self.plans: list[FootstepPlan] = []
        self.followed: list[tuple[float, FootstepPlan]] = []
        self.placed: list[Placed] = []
        self.qpos: list[np.ndarray] = [qpos.copy()]
        self.outcome: Outcome | None = None
        self.reason = ""
        self.recovery_steps = 0
        self._recovers = False
        self._pushes = random_pushes(self.config.push_n_s, np.random.default_rng((seed, _PUSHES)))
        self._push = next(self._pushes, None)
        self._still_ticks = 0
        self._arrived_ticks = 0
        self._deadline_s = 0.0

    @property
    def time_s(self) -> float:
        """Simulated time since the start."""
        return (len(self.qpos) - 1) * CONTROL_PERIOD_S

    @property
    def planning_time_s(self) -> float:
        """Seconds spent on all plans so far."""
        return sum(plan.time_s for plan in self.plans)

    @property
    def replans(self) -> int:
        """How often a new plan was made on the way."""
        return max(0, len(self.plans) - 1)

    @property
    def ahead(self) -> tuple[Pose, ...]:
        """The poses through which it walks on its way and which it has not passed yet."""
        if not self.followed:
            return ()
        begun_s, plan = self.followed[-1]
        done = sum(placed.time_s > begun_s for placed in self.placed)
        return tuple(w.pose for w in plan.waypoints if w.step > done and not w.stands)

    @property
    def goal_error(self) -> tuple[float, float]:
        """Distance in m and heading difference in rad of the feet's pair pose from the goal."""
        return self._distance_to_goal(self._true_feet())

    @property
    def min_clearance_m(self) -> float | None:
        """The least distance of the robot from a wall over the whole walk; None without walls."""
        return min_clearance_m(self.scene, np.array(self.qpos[::4]))

    @property
    def compile_time_s(self) -> float:
        """Seconds for which plans waited for the compiler; `planning_time_s` is without them."""
        return self._planner.compile_time_s if isinstance(self._planner, Planner) else 0.0

    def report(
        self,
        *,
        map: str = "",
        policy: PolicyFile | None = None,
        compile_time_s: float | None = None,
        wall_time_s: float = 0.0,
    ) -> NavigationReport:
        """What the walk, which must have ended, came to.

        compile_time_s: how long the walk waited for the compiler, if not only for plans.
        """
        assert self.outcome is not None
        walked = self.outcome is not Outcome.NO_PATH
        distance_m, angle_rad = self.goal_error if walked else (None, None)
        return NavigationReport(
            outcome=self.outcome,
            reason=self.reason,
            goal_error_m=distance_m,
            goal_error_rad=angle_rad,
            steps_planned=len(self.plans[0]) if self.plans else 0,
            steps_taken=len(self.placed),
            replans=self.replans,
            recovery_steps=self.recovery_steps,
            foot_error_m=Percentiles.of([placed.error_m for placed in self.placed]),
            min_clearance_m=self.min_clearance_m if walked else None,
            planning_time_s=self.planning_time_s,
            compile_time_s=self.compile_time_s if compile_time_s is None else compile_time_s,
            sim_time_s=self.time_s,
            wall_time_s=wall_time_s,
            robot=self.robot.name,
            map=map,
            start=finite_pose(self.start),
            goal=finite_pose(self.goal),
            seed=self.seed,
            policy=policy,
            controller=None
            if isinstance(self.policy, Policy)
            else report_of(self.robot, self.sensing is not None, self.walker.relaxed[0]),
            engine=self.config.engine.about,
            gait=self.gait.summary(),
            sensed=None if self.sensing is None else self.sensing.summary(),
            narrow_place=self.plans[-1].narrow_place if self.plans else None,
            versions=installed_versions(),
        )

    def __repr__(self) -> str:
        how = "walking" if self.outcome is None else str(self.outcome)
        return f"{type(self).__name__}({self.robot.name}: {how}, {len(self.placed)} steps taken)"

    def plan(self) -> FootstepPlan:
        """Plan from the standing start; without a plan the outcome is NO_PATH."""
        plan = self._plan_from(self._start_feet, None)
        if plan.found:
            wait_ticks = round(self.config.wait_s / CONTROL_PERIOD_S)
            self._follow(plan, wait_ticks=wait_ticks, walking=False)
        else:
            self._end(Outcome.NO_PATH, plan.reason)
        return plan

    def tick(self) -> None:
        """One control step: act, look for the end of the walk, and plan again where needed."""
        self._be_pushed()
        self._recover()
        cursor = self.walker.cursor
        side = Side(int(cursor.side[0]))
        asked = cursor.foot_targets[0, [side]]
        walking = not cursor.standing[0]
        stepped = bool(self._act()[0])
        self.qpos.append(self.walker.sim.qpos[0].copy())
        if self.sensing is not None:
            self.sensing.ticked(self.time_s)
            self._halts |= self.sensing.has_jumped()
        self._look_for_failure()
        if self.outcome is not None:
            return
        self.gait.ticked(self.walker, side, walking=walking, landed=stepped)
        if stepped:
            step = {"side": side, "asked_world": self._in_map(asked)[0], "time_s": self.time_s}
            self.placed.append(Placed(placed_world=self._true_feet()[side], **step))
            seen = Placed(placed_world=self._feet()[side], **step)
            if self.sensing is not None:
                self.sensing.landed(seen)
            self._landed(seen)
        if cursor.arrived[0]:
            self._settle()
        elif self.time_s > self._deadline_s:
            self._end(Outcome.TIMED_OUT, f"still walking after {self.time_s:.0f} s")

    def _be_pushed(self) -> None:
        """Apply the push that is due, or its end."""
        if self._push is None:
            return
        tick = len(self.qpos) - 1
        force_world_n = self._push.force_world_n if self._push.acts(tick) else (0.0, 0.0, 0.0)
        self.walker.sim.push(np.array([force_world_n]))
        if self._push.is_over(tick):
            self._push = next(self._pushes)

    def _recover(self) -> None:
        """Change the present step where a push needs it, but never move it onto an obstacle.

        On stairs and over sills the ground says where a foot can stand and how long it must swing,
        and the policy is left alone.
        """
        change = step_change(self.walker)
        if not change.needed[0]:
            return
        cursor = self.walker.cursor
        side, feet = cursor.side[0], cursor.foot_targets[0]
        heights_m = [*feet[:, 2], cursor.lift_off_poses[0, 2]]
        highest_m = max(*heights_m, cursor.swing_over_z_m[0])
        if highest_m - min(heights_m) > self.robot.step_model.level_m:
            return
        offset_m = change.offset_world_m[0].copy()
        for share in _MOVE_SHARES:
            moved = feet.copy()
            moved[side, :2] += share * offset_m
            change.offset_world_m[0] = share * offset_m
            if share == 0 or self._footing.may_stand(self._in_map(moved)):
                break
        sooner = change.swing_ticks[0] < cursor.ticks.swing[0]
        if not (sooner or change.offset_world_m[0].any()):
            return
        change_steps(self.walker, change)
        self.recovery_steps += not self._recovers
        self._recovers = True

    def _landed(self, placed: Placed) -> None:
        """Plan again where a foot came to rest elsewhere than the plan goes on from."""
        config = self.config
        off_z_m = abs(float(placed.placed_world[2] - placed.asked_world[2]))
        near = placed.error_m <= config.replan_error_m and off_z_m <= config.replan_error_z_m
        as_planned = near and placed.error_rad <= config.replan_error_rad and not self._recovers
        self._recovers = False
        if self.walker.cursor.arrived[0]:
            return  # settling measures the goal itself
        if self._halts:
            self._halts = False
            plan = halting_plan(
                self._footing,
                self.robot.step_model.stance_width_m,
                self._feet(),
                placed.side.other,
            )
            self._follow(plan, wait_ticks=0, walking=True)
            return
        if (as_planned and self._keeps_to_map()) or self._out_of_replans():
            return
        plan = self._plan_from(self._feet(), placed.side.other)
        if plan.found:
            self._follow(plan, wait_ticks=0, walking=True)

    def _keeps_to_map(self) -> bool:
        """Whether the plan goes on where the robot takes itself to be.

        Steps that the policy has seen stay where they are. Those after them follow a small
        correction of the robot's place; a larger one needs another plan.
        """
        if self.sensing is None:
            return True
        if self.sensing.has_left_plan(pair_pose(self._feet())[:2]):
            return False
        cursor, plan = self.walker.cursor, self.followed[-1][1]
        unseen = max(int(cursor.entry[0]) - STANCE, 0) + 1
        cursor.move_steps(0, unseen, in_frame(plan.pose_world[unseen:], self.sensing.frame))
        return True

    def _settle(self) -> None:
        """Wait until the robot stands still, then say whether this is the goal or plan again."""
        config = self.config
        still = np.linalg.norm(self.walker.state.qvel[0, :3]) < config.still_speed_m_s
        self._still_ticks = self._still_ticks + 1 if still else 0
        self._arrived_ticks += 1
        settled = self._still_ticks * CONTROL_PERIOD_S >= config.settle_s
        if not settled and self._arrived_ticks * CONTROL_PERIOD_S < config.settle_limit_s:
            return
        believed = self._distance_to_goal(self._feet())
        if settled and _is_near(*believed):
            is_there = _is_near(*self.goal_error)
            self._end(
                Outcome.REACHED if is_there else Outcome.TIMED_OUT,
                "" if is_there else f"{_from_goal(*self.goal_error)}, and takes itself to be there",
            )
            return
        where = _from_goal(*believed)
        if self._out_of_replans():
            self._end(Outcome.TIMED_OUT, f"{where} after {self.replans} replans")
            return
        plan = self._plan_from(self._feet(), None)
        if plan.found and len(plan):
            self._follow(plan, wait_ticks=0, walking=False)
        else:
            self._end(Outcome.TIMED_OUT, f"{where}, and no plan from there: {plan.reason}")

    def _look_for_failure(self) -> None:
        sensors, sim = self.scene.sensors, self.walker.sim
        if self.walker.failures[0]:
            x, y = sim.qpos[0, :2]
            self._end(Outcome.FELL, f"{self.walker.failures[0]}, near {x:z.2f}, {y:z.2f}")
            return
        if sim.failed[0]:
            self._end(Outcome.FELL, "the simulation left the finite numbers")
            return
        if sim.sensors[0, :, sensors.wall_contacts[0]].max() > 0:
            x, y = sim.qpos[0, :2]
            self._end(Outcome.COLLIDED, f"the robot touched an obstacle near {x:z.2f}, {y:z.2f}")
            return
        latest = sim.sensors[0, -1]
        lower_sole_z = latest[sensors.sole_pos_world[:, 2]].min()
        if latest[sensors.pelvis_pos_world[2]] - lower_sole_z < self.robot.fallen_height_m:
            x, y = sim.qpos[0, :2]
            self._end(Outcome.FELL, f"the robot fell near {x:z.2f}, {y:z.2f}")

    def _plan_from(self, feet_world: np.ndarray, first_side: Side | None) -> FootstepPlan:
        plan = plan_through(
            self._planner,
            goal=self.goal,
            start_feet_world=feet_world,
            first_side=first_side,
            via=self.ahead,
            stands=any(w.stands for _, plan in self.followed[-1:] for w in plan.waypoints),
        )
        paced = self._paced(plan)
        self.plans.append(paced)
        return paced

    def _paced(self, plan: FootstepPlan) -> FootstepPlan:
        """The plan with durations of its steps by the pace; normal ones are the gait's own."""
        shortest_s, longest_s = self.policy.step_range_s(self.robot)
        step_s = step_durations_s(plan, self.robot.gait, self.config.pace, shortest_s, longest_s)
        return plan if step_s is None else replace(plan, step_s=step_s)

    def _follow(self, plan: FootstepPlan, *, wait_ticks: int, walking: bool) -> None:
        if plan.step_s is not None and len(plan):
            self.policy.require_pace(self.robot, plan.step_s)
        side = plan.side.astype(np.int64)
        over_z_m = self._footing.swing_over_z_m(plan)
        frame = np.zeros(3) if self.sensing is None else self.sensing.plan_in_frame()
        start, steps = (in_frame(at, frame) for at in (plan.start_feet_world, plan.pose_world))
        sequence = StepSequence.of(start, side, steps, plan.step_s, over_z_m)
        self.walker.follow(0, sequence, wait_ticks=wait_ticks, walking=walking)
        self.followed.append((self.time_s, plan))
        self._still_ticks = self._arrived_ticks = 0
        own_s = len(plan) * self.robot.gait.step_s
        walk_s = own_s if plan.step_s is None else float(plan.step_s.sum())
        config = self.config
        self._deadline_s = self.time_s + config.wait_s + walk_s + config.spare_time_s

    def _feet(self) -> np.ndarray:
        """Both soles (2, 4) in the map, as the robot takes them to be, on the ground there."""
        return self._footing.at_rest(self._in_map(self.walker.state.soles_world[0]))

    def _true_feet(self) -> np.ndarray:
        """Both soles (2, 4) as they are, at the height of the ground that they rest on."""
        return self._footing.at_rest(self.walker.soles_world()[0])

    def _in_map(self, poses: np.ndarray) -> np.ndarray:
        """Poses (n, 4) in the frame of the steps, in the map."""
        return poses if self.sensing is None else in_map(poses, self.sensing.frame)

    def _distance_to_goal(self, feet_world: np.ndarray) -> tuple[float, float]:
        pose = pair_pose(feet_world)
        distance_m = math.hypot(pose[0] - self.goal[0], pose[1] - self.goal[1])
        return distance_m, abs(float(wrap_angle(pose[2] - self.goal[2])))

    def _out_of_replans(self) -> bool:
        return self.replans >= self.config.max_replans

    def _end(self, outcome: Outcome, reason: str) -> None:
        self.outcome, self.reason = outcome, reason


def _is_near(distance_m: float, angle_rad: float) -> bool:
    return distance_m <= GOAL_TOLERANCE_M and angle_rad <= GOAL_TOLERANCE_RAD


def _from_goal(distance_m: float, angle_rad: float) -> str:
    return f"{distance_m:.2f} m and {math.degrees(angle_rad):.0f} degrees from the goal"
