"""Walking by what the robot measures: its state by the legs, its place on the map by fixes.

Two frames: the policy's steps are in the frame of the odometry, which never jumps; plans are in the
map. Where one lies in the other is corrected by localization, if there is any.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field

import numpy as np

from app.navigation.localization import (
    LocalizationConfig,
    PoseFilter,
    SimulatedLocalization,
    frame_difference,
)
from app.navigation.placed import Placed
from app.navigation.report import Percentiles, SensedSummary
from controller.leg_odometry import LegOdometry, RobotState
from controller.observation import pelvis_yaw_rad
from controller.walker import Walker
from planner.plan import from_frame, pair_pose, to_frame, wrap_angle
from sim.onboard_sensors import OnboardSensors, SensorErrors, SensorReadings

# A frame that has moved by more than this under the steps that are being taken calls for a plan.
MOST_MOVED_M, MOST_MOVED_RAD = 0.04, math.radians(4.0)
# A foot that has landed may not be flat yet: so much of what its height is off is put right.
HEIGHT_SHARE = 0.5


@dataclass(frozen=True, kw_only=True)
class SensingConfig:
    """The errors of the robot's sensors, and how it is localized; None: not at all."""

    errors: SensorErrors = field(default_factory=SensorErrors)
    localization: LocalizationConfig | None = None


class Sensing:
    """What one robot knows of its state and place, from control step to control step.

    `own_errors_m` are the distances of feet from their steps as the robot saw both.
    """

    def __init__(self, walker: Walker, config: SensingConfig, *, seed: int):
        """Begin where the robot stands, which it is told."""
        self._walker = walker
        sensors_seed, fixes_seed = np.random.SeedSequence((seed, 2)).generate_state(2)
        offset_rad = None if walker.servos is None else walker.servos.encoder_offset_rad[0]
        self._sensors = OnboardSensors(
            walker.scene, config.errors, seed=int(sensors_seed), encoder_offset_rad=offset_rad
        )
        self._time_s = 0.0
        first = self._read(walker.sim.sensors[0, -1], 0.0)
        self._odometry = LegOdometry(walker.scene, walker.sim.qpos[0], first)
        self._fixes: SimulatedLocalization | None = None
        self._filter: PoseFilter | None = None
        if config.localization is not None:
            self._fixes = SimulatedLocalization(config.localization, seed=int(fixes_seed))
            self._filter = PoseFilter(config=config.localization)
        self._walked_m = self._turned_rad = 0.0
        self._last_true: np.ndarray | None = None
        self._place_errors_m: list[float] = []
        self.own_errors_m: list[float] = []
        self._told_jumps = 0
        self._plan_frame = np.zeros(3)
        walker.sense = self._sense
        walker.estimated = self._odometry.state

    @property
    def state(self) -> RobotState:
        """The robot's state in the frame of the odometry."""
        return self._odometry.state

    @property
    def frame(self) -> np.ndarray:
        """Pose x, y, yaw (3,) of the odometry's frame in the map."""
        return np.zeros(3) if self._filter is None else self._filter.odom_in_map

    def plan_in_frame(self) -> np.ndarray:
        """The frame, in which a plan is about to be walked."""
        self._plan_frame = self.frame.copy()
        return self._plan_frame

    def has_left_plan(self, at_map: np.ndarray) -> bool:
        """Whether the frame has moved at a point (2,) by more than the plan's steps can follow."""
        moved_m, turned_rad = frame_difference(self._plan_frame, self.frame, at_map)
        return moved_m > MOST_MOVED_M or turned_rad > MOST_MOVED_RAD

    def ticked(self, time_s: float) -> None:
        """Take what is measured after a control step."""
        self._update(self._walker.sim.sensors[0, -1], time_s)
        if self._filter is None or self._fixes is None:
            return
        self._filter.predict(_pose(self.state.qpos), time_s)
        for fix in self._fixes.fixes(_pose(self._walker.sim.qpos), time_s):
            self._filter.correct(fix)

    def has_jumped(self) -> bool:
        """Whether the map's frame was found to have moved since this was last asked."""
        jumps = 0 if self._filter is None else self._filter.jumps
        told, self._told_jumps = self._told_jumps, jumps
        return jumps > told

    def landed(self, step: Placed) -> None:
        """Note a step in the map, as asked for and as the robot takes it to have been placed.

        On the ground, whose height it knows, a foot also tells how high the robot is.
        """
        self.own_errors_m.append(step.error_m)
        true = pair_pose(self._walker.soles_world()[0])
        if self._last_true is not None:
            self._walked_m += float(np.hypot(*(true - self._last_true)[:2]))
            self._turned_rad += abs(float(wrap_angle(true[2] - self._last_true[2])))
        self._last_true = true
        if self._filter is not None:
            believed = from_frame(_pose(self.state.qpos)[None], self.frame)[0]
            place = _pose(self._walker.sim.qpos)
            self._place_errors_m.append(float(np.hypot(*(believed - place)[:2])))
        off_m = float(step.placed_world[2] - self.state.soles_world[0, step.side, 2])
        self._odometry.raise_by(HEIGHT_SHARE * off_m)
        self._walker.estimated = self._odometry.state

    def summary(self) -> SensedSummary:
        """What came of it so far."""
        off = _pose(self.state.qpos) - _pose(self._walker.sim.qpos)
        counts = self._filter
        return SensedSummary(
            walked_m=self._walked_m,
            turned_rad=self._turned_rad,
            drift_m=float(np.hypot(*off[:2])),
            drift_rad=abs(float(wrap_angle(off[2]))),
            own_foot_error_m=_told(self.own_errors_m),
            localization_error_m=_told(self._place_errors_m),
            fixes=0 if counts is None else counts.fixes,
            rejected=0 if counts is None else counts.rejected,
            jumps=0 if counts is None else counts.jumps,
        )

    def _sense(self, sensors: np.ndarray, since_s: float) -> None:
        """Take what is measured between two parts of a control step."""
        self._update(sensors[0], self._time_s + since_s)

    def _update(self, sensors: np.ndarray, time_s: float) -> None:
        self._odometry.update(self._read(sensors, time_s), time_s - self._time_s)
        self._time_s = time_s
        self._walker.estimated = self._odometry.state

    def _read(self, sensors: np.ndarray, time_s: float) -> SensorReadings:
        sim = self._walker.sim
        readings = self._sensors.read(sim.qpos[0], sim.qvel[0], sensors, time_s)
        self._walker.readings = readings
        return readings


def in_frame(poses_map: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """Poses (n, 4) x, y, z, yaw in the map as seen from a frame x, y, yaw (3,) in it."""
    return _with_heights(to_frame(poses_map[:, [0, 1, 3]], frame), poses_map)


def in_map(poses: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """Poses (n, 4) as `in_frame` gives them, in the map."""
    return _with_heights(from_frame(poses[:, [0, 1, 3]], frame), poses)


def _with_heights(poses: np.ndarray, heights_of: np.ndarray) -> np.ndarray:
    return np.column_stack([poses[:, :2], heights_of[:, 2], poses[:, 2]])


def _pose(qpos: np.ndarray) -> np.ndarray:
    """Pose x, y, yaw (3,) of the pelvis at qpos (1, nq)."""
    return np.array([*qpos[0, :2], pelvis_yaw_rad(qpos)[0]])


def _told(errors_m: list[float]) -> dict[str, float] | None:
    found = Percentiles.of(errors_m)
    return None if found is None else asdict(found)
