"""Robots that follow step sequences, in training (B = 256) and in navigation (B = 1)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from controller.actuation import ImperfectServos
from controller.gait import CONTROL_PERIOD_S, GaitTicks
from controller.leg_odometry import RobotState
from controller.observation import observe
from controller.step_cursor import StepCursor, StepSequence
from sim.engines import MUJOCO, Engine
from sim.hardware import HardwareErrors, change_model
from sim.onboard_sensors import SensorReadings
from sim.robot import Robot
from sim.scene import Scene
from sim.simulation import Simulation


class Controller(Protocol):
    """What moves the robots of a walker: a policy, or the model-based controller."""

    @property
    def is_paced(self) -> bool:
        """Whether it takes steps of other durations than the robot's gait."""
        ...

    def step_range_s(self, robot: Robot) -> tuple[float, float]:
        """Shortest and longest duration of a step."""
        ...

    def require_pace(self, robot: Robot, step_s: ArrayLike) -> None:
        """Checks that it can take steps of these durations; raises ValueError if not."""
        ...

    def start(self, walker: Walker) -> Callable[[], np.ndarray]:
        """A function that advances the walker by one control step, as `Walker.act` does."""
        ...


class Walker:
    """B robots in a scene, each with a step cursor and its last action.

    An action (B, J) is an offset in rad from half-sitting. The joint target is the mean of the
    new action and the one before, as in the reference code of Singh et al. 2022.
    `placed` (B,) counts how often each was put into a state; `failures` holds why the controller of
    each gave up, "" while it has not; `relaxed` how often each stage of it dropped its constraints,
    for controllers that have such stages.
    `disturbed` (B,) is whether a robot's steps may change against a push; a controller that can
    tell a push from its own gait clears it, others leave it true.
    `loading_ticks` is how many control ticks after touch-down a foot bears the weight, where the
    controller knows.
    `noise` adds to an observation what its sensors err by, which `observe` itself is without.
    `latency_ticks` (B,) in [0, 1] is the delay of the joint targets in control steps;
    `target_rad` (B, J) the targets last asked for, before any delay.
    `estimated` is the state that robots see in place of the true one, where sensors are all that
    they have, and `readings` what those read last; whoever estimates it sets both anew after each
    step, and in `sense`, which is called with the sensors (B, nsensordata) and the time since the
    part before where a control step goes on in parts. `servos` take the joint targets of a policy
    where they are not those of the model.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        count: int = 1,
        threads: int = 1,
        capacity: int = 16,
        record: tuple[str, ...] = (),
        engine: Engine = MUJOCO,
        hardware: HardwareErrors | None = None,
        seed: int = 0,
    ):
        """Set the robots up; `hardware` changes the scene's model, `seed` is for what it draws."""
        self._hardware = hardware
        if hardware is not None:
            change_model(scene.model, scene.robot, hardware)
        self.scene = scene
        self.robot = scene.robot
        self._engine = engine
        self._settings: dict[str, Any] = {"count": count, "threads": threads, "record": record}
        self.sim = self._simulate()
        self.cursor = StepCursor(GaitTicks.of(self.robot.gait), count, capacity)
        self.action = np.zeros((count, len(self.robot.joints)))
        self.failures = [""] * count
        self.relaxed: list[dict[str, int]] = [{} for _ in range(count)]
        self.noise: Callable[[np.ndarray], np.ndarray] = lambda observation: observation
        self.disturbed = np.ones(count, dtype=bool)
        self.loading_ticks = 0
        self.placed = np.zeros(count, dtype=np.int64)
        self.latency_ticks = np.zeros(count)
        self.estimated: RobotState | None = None
        self.readings: SensorReadings | None = None
        self.sense: Callable[[np.ndarray, float], None] | None = None
        self.servos: ImperfectServos | None = None
        if hardware is not None and hardware.changes_servos:
            self.servos = ImperfectServos(self.sim, hardware, seed=seed)
        self._sent = np.zeros((count, len(self.robot.joints)))
        self.target_rad = np.tile(self.robot.half_sitting_rad, (count, 1))

    def _simulate(self) -> Simulation:
        settings = self._settings
        return self._engine.simulate(self.scene, control_period_s=CONTROL_PERIOD_S, **settings)

    def place(self, row: int, qpos: np.ndarray, qvel: np.ndarray | None = None) -> None:
        """Put robot `row` into a state and forget its last action."""
        self.sim.reset(np.array([row]), qpos[None], None if qvel is None else qvel[None])
        self.action[row] = self._sent[row] = 0.0
        self.placed[row] += 1
        self.failures[row] = ""
        self.relaxed[row] = {}

    def enter(self, scene: Scene) -> None:
        """Go on in the same state in another scene of the robot, such as one with more walls."""
        if self._hardware is not None:
            change_model(scene.model, scene.robot, self._hardware)
        before = self.sim
        self.scene = scene
        self.sim = self._simulate()
        self.sim.reset(np.arange(before.count), before.qpos, before.qvel)
        self.sim.sensors[:] = before.sensors

    def follow(
        self, row: int, sequence: StepSequence, *, wait_ticks: int = 0, walking: bool = False
    ) -> None:
        """Give robot `row` a sequence; see `StepCursor.follow`."""
        self.cursor.follow(row, sequence, wait_ticks=wait_ticks, walking=walking)

    def observe(self) -> np.ndarray:
        """The policy's observation of every robot (B, N), before scaling."""
        qpos, qvel = self.sim.qpos, self.sim.qvel
        if self.estimated is not None:
            qpos, qvel = self.estimated.qpos, self.estimated.qvel
        elif self.servos is not None:
            qpos = qpos.copy()
            qpos[:, self.scene.joint_qpos] += self.servos.encoder_offset_rad
        return observe(
            self.robot,
            qpos=qpos,
            qvel=qvel,
            joint_qpos=self.scene.joint_qpos,
            joint_qvel=self.scene.joint_qvel,
            clock=self.cursor.clock,
            window=self.cursor.shown_window,
            step_s=self.cursor.step_s,
        )

    def act(self, action: np.ndarray) -> np.ndarray:
        """Advance one control step under the actions (B, J), then the gait clock.

        Returns:
            True (B,) where a step's period has just ended, as from `StepCursor.advance`.
        """
        blend = 0.5 * (action + self.action)
        self.target_rad = self.robot.half_sitting_rad + blend
        latency = self.latency_ticks[:, None]
        command = self.robot.half_sitting_rad + (1 - latency) * blend + latency * self._sent
        if self.servos is None:
            self.sim.step(command)
        else:
            self.servos.step(self.sim, command)
        self._sent = blend
        self.action = action.copy()
        return self.cursor.advance()

    def act_in_parts(
        self, parts: int, targets_rad: Callable[[np.ndarray], np.ndarray]
    ) -> np.ndarray:
        """Advance one control step in equal parts, then the gait clock.

        The joint targets (B, J) of each part come from the sensors before it: see
        `Simulation.step_in_parts`. Returns the same as `act`.
        """
        part, part_s = 0, CONTROL_PERIOD_S / parts

        def noted(sensors: np.ndarray) -> np.ndarray:
            nonlocal part
            # Before the first part it knows what it measured after the last control step.
            if part and self.sense is not None:
                self.sense(sensors, part_s)
            part += 1
            self.target_rad = targets_rad(sensors)
            return self.target_rad

        self.sim.step_in_parts(parts, noted)
        return self.cursor.advance()

    @property
    def state(self) -> RobotState:
        """What the robots know of themselves: their true states, or as they are `estimated`."""
        if self.estimated is not None:
            return self.estimated
        sensors, latest = self.scene.sensors, self.sim.sensors[:, -1]
        return RobotState(
            qpos=self.sim.qpos,
            qvel=self.sim.qvel,
            soles_world=self.soles_world(),
            com_pos_world=latest[:, sensors.com_pos_world],
            com_linvel_world=latest[:, sensors.com_linvel_world],
        )

    def soles_world(self) -> np.ndarray:
        """Pose x, y, z, yaw of each sole in the world (B, 2, 4) at the last physics step."""
        latest = self.sim.sensors[:, -1]
        position = latest[:, self.scene.sensors.sole_pos_world]
        axis = latest[:, self.scene.sensors.sole_x_axis_world]
        yaw = np.arctan2(axis[..., 1], axis[..., 0])
        return np.concatenate([position, yaw[..., None]], axis=2)

    def joint_torque_nm(self) -> np.ndarray:
        """Joint torques (B, J) at the last physics step."""
        return self.sim.sensors[:, -1][:, self.scene.sensors.joint_torque]

    def fallen(self) -> np.ndarray:
        """Robots (B,) whose pelvis is too low, whose legs touch, or whose controller gave up.

        Or whose simulation failed.
        """
        sensors, latest = self.scene.sensors, self.sim.sensors[:, -1]
        lower_sole_z = latest[:, sensors.sole_pos_world[:, 2]].min(axis=1)
        height_m = latest[:, sensors.pelvis_pos_world[2]] - lower_sole_z
        touching = self.sim.sensors[:, :, sensors.legs_touching[0]].max(axis=1) > 0
        # Negated so that nan counts as a fall.
        gave_up = np.array(self.failures, dtype=bool)
        return self.sim.failed | ~(height_m >= self.robot.fallen_height_m) | touching | gave_up
