"""How an episode begins: the posture, the steps, the ground under them and what disturbs."""

from __future__ import annotations

import numpy as np

from controller.curriculum import Stage
from controller.gait import CONTROL_PERIOD_S
from controller.planned import PlannedSteps
from controller.randomization import Disturbances
from controller.stairs import STAIR_MODES, draw_stairs
from controller.step_cursor import Track
from controller.step_sequences import MAX_STEPS, draw_track
from controller.task_config import TaskConfig
from controller.walker import Walker


class Episodes:
    """Draws the episodes of the robots of a walker.

    `mode` is one of `MODES`, `STAIR_MODES` or `standing`, and None draws from all flat modes, the
    planner's own steps if there are any `planned`, and, at the stage's rise, stairs. `on_stairs`
    (B,) tells which robots are on stairs.
    """

    def __init__(
        self,
        walker: Walker,
        disturbances: Disturbances,
        *,
        config: TaskConfig,
        mode: str | None,
        planned: PlannedSteps | None,
    ):
        self.config, self.mode, self.planned = config, mode, planned
        self.on_stairs = np.zeros(walker.sim.count, dtype=bool)
        self._walker, self._disturbances = walker, disturbances
        self._start_feet = walker.scene.soles_at(walker.scene.standing_qpos)

    def begin(self, rng: np.random.Generator, row: int, stage: Stage) -> None:
        """Put robot `row` where it starts, and give it its steps, ground and disturbances."""
        scene, config, walker = self._walker.scene, self.config, self._walker
        joints = len(walker.robot.joints)
        qpos, qvel = scene.standing_qpos.copy(), np.zeros(scene.model.nv)
        qpos[scene.joint_qpos] += config.joint_noise_rad * rng.uniform(-1, 1, joints)
        qvel[scene.joint_qvel] = config.joint_speed_noise_rad_s * rng.uniform(-1, 1, joints)
        walker.place(row, qpos, qvel)
        steps = int(rng.integers(4, MAX_STEPS + 1))
        if stage.hardness > 0:
            self._disturbances.draw_episode(
                rng, row, stage.hardness, period_s=CONTROL_PERIOD_S, ticks=config.episode_ticks
            )
        else:
            self._disturbances.calm(row)
        walker.late_ticks[row] = self._disturbances.late_ticks[row]
        mode = self.mode
        if mode is None and stage.rise_m > 0 and rng.uniform() < config.stairs_share:
            mode = "stairs"
        if mode in STAIR_MODES:
            track = self._on_stairs(rng, row, stage, str(mode), steps)
        else:
            track = self._on_the_level(rng, mode, steps)
        walker.follow(row, track, wait_ticks=int(rng.integers(config.wait_ticks + 1)))
        self.on_stairs[row] = mode in STAIR_MODES

    def _on_stairs(
        self, rng: np.random.Generator, row: int, stage: Stage, mode: str, steps: int
    ) -> Track:
        track, ground = draw_stairs(
            rng,
            self._walker.robot.training_model,
            self._start_feet,
            mode=mode,
            rise_m=self._draw_rise_m(rng, stage),
            steps=steps,
            tread_error_m=self._disturbances.draw_tread_error_m(rng, stage.hardness),
        )
        self._walker.sim.place_ground(row, ground)
        return track

    def _on_the_level(self, rng: np.random.Generator, mode: str | None, steps: int) -> Track:
        if mode is None and self.planned and rng.uniform() < self.config.planned_share:
            return self.planned.draw(rng, self._start_feet, steps=steps)
        model = self._walker.robot.training_model
        return draw_track(rng, model, self._start_feet, mode=mode, steps=steps)

    def _draw_rise_m(self, rng: np.random.Generator, stage: Stage) -> float:
        """Half of the rises are near the stage's, the others anywhere below."""
        if self.config.exact_rise:
            return stage.rise_m
        low = 0.8 if rng.uniform() < 0.5 else 0.1
        return stage.rise_m * rng.uniform(low, 1.0)
