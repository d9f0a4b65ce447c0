"""How one walk was walked: posture, swing, touch-down, force and cost, summed up as it goes.

The figures of report.json's `gait`; `gait_metrics` has those of many walks of one kind.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from controller.gait import CONTROL_PERIOD_S
from controller.step_cursor import STANCE
from planner.robot_model import Side

if TYPE_CHECKING:
    from controller.walker import Walker

# Less than this of the robot's weight on a foot does not count as contact.
CONTACT_WEIGHTS = 0.02
# With fewer steps there is no gait to speak of.
LEAST_STEPS = 4
# Over this time before contact a sole's speed is averaged; and so long the robot is at rest.
TOUCHDOWN_S, REST_S = 0.025, 0.25


@dataclass(frozen=True, kw_only=True)
class GaitSummary:
    """Figures of a walk. Lengths in m, speeds in m/s, forces over the robot's weight.

    pelvis_height_m: above the lower sole, median and least while walking, and at rest at the end
    (None if it did not come to rest). pelvis_bob_m: median over the steps of the range of that.
    swing_apex_m: median and 95th percentile of the greatest height of a sole above the straight
    line between the places that it left and reached. touchdown_speed_m_s: the same of its downward
    speed over the last 25 ms before contact. cost_of_transport: work of the joints, braking
    included, per weight and distance; the distance is that of the pelvis from step to step.
    """

    pelvis_height_m: dict[str, float | None]
    pelvis_bob_m: float
    swing_apex_m: dict[str, float]
    touchdown_speed_m_s: dict[str, float] | None
    peak_force_weights: float
    cost_of_transport: float
    speed_m_s: float


class GaitRecorder:
    """Watches the only robot of a walker, whose `record` must have qvel, control step by step."""

    def __init__(self, walker: Walker) -> None:
        self._weight_n = walker.robot.weight_n
        self._joints = walker.scene.joint_qvel
        self._heights_m: list[float] = []
        self._resting_m: list[float] = []
        self._bobs_m: list[float] = []
        self._apexes_m: list[float] = []
        self._touchdowns_m_s: list[float] = []
        self._work_j = self._walked_m = self._walked_s = self._peak_n = 0.0
        self._step_from_world: np.ndarray | None = None
        self._begin_step()

    def _begin_step(self) -> None:
        self._step_heights_m: list[float] = []
        self._sole_path_world: list[np.ndarray] = []
        self._sole_down_m_s: list[np.ndarray] = []
        self._sole_force_n: list[np.ndarray] = []

    def ticked(self, walker: Walker, side: Side, *, walking: bool, landed: bool) -> None:
        """Notes a control step; `side` was the swing foot, `landed` that its period is over.

        `walking` is whether the robot was asked to step.
        """
        read, sensors = walker.sim.sensors[0], walker.scene.sensors
        latest = read[-1]
        pelvis = latest[sensors.pelvis_pos_world]
        height_m = float(pelvis[2] - latest[sensors.sole_pos_world[:, 2]].min())
        force_n = read[:, sensors.ground_force_world[:, 2]]
        if not walking:
            self._resting_m.append(height_m)
            return
        self._resting_m.clear()
        self._peak_n = max(self._peak_n, float(force_n.max()))
        torque_nm, speed = read[:, sensors.joint_torque], walker.sim.recorded["qvel"][0]
        power_w = np.abs(torque_nm * speed[:, self._joints]).sum(axis=1)
        self._work_j += float(power_w.mean()) * CONTROL_PERIOD_S
        self._walked_s += CONTROL_PERIOD_S
        self._heights_m.append(height_m)
        if walker.cursor.entry[0] < STANCE and not landed:
            self._step_from_world = pelvis[:2].copy()
            return  # The weight shift before the first step is not a step.
        self._step_heights_m.append(height_m)
        self._sole_path_world.append(latest[sensors.sole_pos_world[side]])
        self._sole_down_m_s.append(-read[:, sensors.sole_linvel_world[side, 2]])
        self._sole_force_n.append(force_n[:, side])
        if landed:
            self._end_step(pelvis[:2].copy())

    def _end_step(self, pelvis_xy_world: np.ndarray) -> None:
        if self._step_from_world is not None:
            self._walked_m += float(np.linalg.norm(pelvis_xy_world - self._step_from_world))
        self._step_from_world = pelvis_xy_world
        self._bobs_m.append(float(np.ptp(self._step_heights_m)))
        self._apexes_m.append(swing_apex_m(np.array(self._sole_path_world)))
        touchdown = touchdown_speed_m_s(
            np.concatenate(self._sole_down_m_s),
            np.concatenate(self._sole_force_n) > CONTACT_WEIGHTS * self._weight_n,
            round(TOUCHDOWN_S * len(self._sole_down_m_s[0]) / CONTROL_PERIOD_S),
        )
        if touchdown is not None:
            self._touchdowns_m_s.append(touchdown)
        self._begin_step()

    def summary(self) -> GaitSummary | None:
        """The figures; None where too few steps were taken."""
        if len(self._bobs_m) < LEAST_STEPS or self._walked_m <= 0:
            return None
        rest = self._resting_m[-round(REST_S / CONTROL_PERIOD_S) :]
        touchdowns = self._touchdowns_m_s
        return GaitSummary(
            pelvis_height_m={
                "median": float(np.median(self._heights_m)),
                "least": float(np.min(self._heights_m)),
                "at_rest": float(np.mean(rest)) if rest else None,
            },
            pelvis_bob_m=float(np.median(self._bobs_m)),
            swing_apex_m=_median_and_p95(self._apexes_m),
            touchdown_speed_m_s=_median_and_p95(touchdowns) if touchdowns else None,
            peak_force_weights=self._peak_n / self._weight_n,
            cost_of_transport=self._work_j / (self._weight_n * self._walked_m),
            speed_m_s=self._walked_m / self._walked_s,
        )


def swing_apex_m(path_world: np.ndarray) -> float:
    """Greatest height of a path (n, 3) above the straight line between its ends.

    Where the ends are above one another, or nearly, the height is that above the higher one.
    """
    start, end = path_world[0], path_world[-1]
    way = (end - start)[:2]
    length_m = float(np.linalg.norm(way))
    if length_m < 0.01:
        line_m = np.full(len(path_world), max(start[2], end[2]))
    else:
        share = np.clip((path_world[:, :2] - start[:2]) @ way / length_m**2, 0.0, 1.0)
        line_m = start[2] + share * (end[2] - start[2])
    return float((path_world[:, 2] - line_m).max())


def touchdown_speed_m_s(down_m_s: np.ndarray, contact: np.ndarray, before: int) -> float | None:
    """Mean downward speed over the `before` physics steps before a foot's first new contact.

    down_m_s, contact (n,): at each physics step from lift-off on; None where the foot never left
    the ground or did not come back.
    """
    lifted = np.flatnonzero(~contact)
    if not len(lifted):
        return None
    # Chatter at lift-off is no touch-down: the longest flight ends with it.
    flights = np.split(lifted, np.flatnonzero(np.diff(lifted) > 1) + 1)
    longest = max(flights, key=len)
    touched = int(longest[-1]) + 1
    if touched >= len(contact) or len(longest) < before:
        return None
    return float(down_m_s[touched - before : touched].mean())


def _median_and_p95(values: list[float]) -> dict[str, float]:
    median, p95 = np.percentile(values, [50, 95])
    return {"median": float(median), "p95": float(p95)}
