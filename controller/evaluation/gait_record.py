"""Walks recorded at the physics rate: joint torques and speeds, ground forces, the gait's phase."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controller.evaluation.rollouts import set_off, walk
from controller.gait import CONTROL_PERIOD_S, GaitTicks
from controller.policy import Policy
from controller.step_cursor import Track
from controller.step_sequences import chain_steps
from planner.robot_model import Side
from sim.robot import Robot

Step = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class WalkRecord:
    """B robots over T control steps of S physics steps each; N = T * S.

    torque_nm, joint_speed_rad_s (B, N, J): of the servos and of the joints they turn.
    ground_force_n (B, N, 2): vertical force on each foot, left then right.
    indicator (B, T, 2), cycle_tick (B, T): as in `controller.evaluation.rollouts.Tick`.
    pelvis_xy_world (B, T, 2); pelvis_height_m (B, T): above the lower sole.
    sole_height_m (B, T, 2): above the floor; upright (B,): did not fall.
    """

    timestep_s: float
    torque_nm: np.ndarray
    joint_speed_rad_s: np.ndarray
    ground_force_n: np.ndarray
    indicator: np.ndarray
    cycle_tick: np.ndarray
    pelvis_xy_world: np.ndarray
    pelvis_height_m: np.ndarray
    sole_height_m: np.ndarray
    upright: np.ndarray

    @property
    def substeps(self) -> int:
        """S, physics steps in a control step."""
        return self.torque_nm.shape[1] // self.indicator.shape[1]

    def of_upright(self) -> WalkRecord:
        """The walks in which the robot did not fall."""
        chosen = {name: getattr(self, name)[self.upright] for name in _PER_ROBOT}
        return WalkRecord(timestep_s=self.timestep_s, **chosen)

    def steady(self, ticks: GaitTicks) -> WalkRecord:
        """The walks after three steps, from one moment of the gait to the same in a later cycle.

        The body sways once a cycle: between any two moments it has come nearer or farther.
        """
        start, cycle = 3 * ticks.step, 2 * ticks.step
        end = start + (self.indicator.shape[1] - 1 - start) // cycle * cycle + 1
        every = self.substeps
        cut = {n: getattr(self, n)[:, start * every : end * every] for n in _PER_PHYSICS_STEP}
        cut |= {name: getattr(self, name)[:, start:end] for name in _PER_CONTROL_STEP}
        return WalkRecord(timestep_s=self.timestep_s, upright=self.upright, **cut)


_PER_PHYSICS_STEP = ("torque_nm", "joint_speed_rad_s", "ground_force_n")
_PER_CONTROL_STEP = (
    *("indicator", "cycle_tick", "pelvis_xy_world", "pelvis_height_m", "sole_height_m"),
)
_PER_ROBOT = (*_PER_PHYSICS_STEP, *_PER_CONTROL_STEP, "upright")


def record_walk(
    robot: Robot,
    policy: Policy,
    step: Step,
    *,
    count: int,
    seconds: float,
    seed: int,
    threads: int = 1,
) -> WalkRecord:
    """`count` robots that repeat one step, half of them beginning with the left foot.

    The step is (x_m, y_m, yaw_rad) of the swing foot in the support foot's frame, y and yaw
    outward, as in `StepModel.steps`. Where it leads sideways or turns, the feet take turns: one
    takes the step, the other follows to the stance width.
    """
    steps = int(seconds / robot.gait.step_s) + 2

    def draw(rng: np.random.Generator, row: int, feet: np.ndarray) -> Track:
        relative = repeated(step, robot.step_model.stance_width_m, steps)
        side, poses = chain_steps(feet, Side(row % 2), relative)
        return Track.of(feet, side, poses)

    walker = set_off(robot, draw, count=count, seed=seed, threads=threads, record=("qvel",))
    sensors, joints = walker.scene.sensors, walker.scene.joint_qvel
    torque, speed, force, indicator, cycle_tick, pelvis, soles = [], [], [], [], [], [], []
    upright = np.ones(count, dtype=bool)
    for tick in walk(walker, policy, round(seconds / CONTROL_PERIOD_S)):
        read = walker.sim.sensors
        torque.append(read[:, :, sensors.joint_torque])
        force.append(read[:, :, sensors.ground_force_world[:, 2]])
        speed.append(walker.sim.recorded["qvel"][:, :, joints])
        pelvis.append(read[:, -1, sensors.pelvis_pos_world])
        soles.append(read[:, -1, sensors.sole_pos_world[:, 2]])
        indicator.append(tick.indicator)
        cycle_tick.append(tick.cycle_tick)
        upright = tick.upright
    pelvis_world, sole_height_m = np.stack(pelvis, axis=1), np.stack(soles, axis=1)
    return WalkRecord(
        timestep_s=float(walker.scene.model.opt.timestep),
        torque_nm=np.concatenate(torque, axis=1),
        joint_speed_rad_s=np.concatenate(speed, axis=1),
        ground_force_n=np.concatenate(force, axis=1),
        indicator=np.stack(indicator, axis=1),
        cycle_tick=np.stack(cycle_tick, axis=1),
        pelvis_xy_world=pelvis_world[..., :2],
        pelvis_height_m=pelvis_world[..., 2] - sole_height_m.min(axis=2),
        sole_height_m=sole_height_m,
        upright=upright,
    )


def repeated(step: Step, stance_width_m: float, steps: int) -> np.ndarray:
    """Steps (steps, 3) of a walk that goes on in one manner; see `record_walk`."""
    x_m, y_m, yaw_rad = step
    follows = (x_m, stance_width_m, 0.0) if y_m != stance_width_m or yaw_rad else step
    return np.array([(step, follows)[k % 2] for k in range(steps)])
