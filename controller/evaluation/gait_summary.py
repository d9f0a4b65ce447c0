"""How one walk was walked: posture, swing, touch-down, force and cost, summed up as it goes.

The figures of report.json's `gait`; `gait_metrics` has those of many walks of one kind.
"""

from __future__ import annotations

from collections.abc import Sequence
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
    included, per weight and distance; the distance is that of the point midway between the soles
    from step to step, since the pelvis also sways where the robot gets nowhere.
    """

    pelvis_height_m: dict[str, float | None]
    pelvis_bob_m: float
    swing_apex_m: dict[str, float]
    touchdown_speed_m_s: dict[str, float] | None
    peak_force_weights: float
    cost_of_transport: float
    speed_m_s: float


class GaitRecorder:
    """Watches robot `row` of a walker, whose `record` must have qvel, control step by step."""

    def __init__(self, walker: Walker, row: int = 0) -> None:
        self._row = row
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
        read, sensors = walker.sim.sensors[self._row], walker.scene.sensors
        latest = read[-1]
        soles = latest[sensors.sole_pos_world]
        height_m = float(latest[sensors.pelvis_pos_world[2]] - soles[:, 2].min())
        midway_world = soles[:, :2].mean(axis=0)
        force_n = read[:, sensors.ground_force_world[:, 2]]
        if not walking:
            self._resting_m.append(height_m)
            return
        self._resting_m.clear()
        self._peak_n = max(self._peak_n, float(force_n.max()))
        torque_nm, speed = read[:, sensors.joint_torque], walker.sim.recorded["qvel"][self._row]
        power_w = np.abs(torque_nm * speed[:, self._joints]).sum(axis=1)
        self._work_j += float(power_w.mean()) * CONTROL_PERIOD_S
        self._walked_s += CONTROL_PERIOD_S
        self._heights_m.append(height_m)
        if walker.cursor.entry[self._row] < STANCE and not landed:
            self._step_from_world = midway_world
            return  # The weight shift before the first step is not a step.
        self._step_heights_m.append(height_m)
        self._sole_path_world.append(latest[sensors.sole_pos_world[side]])
        self._sole_down_m_s.append(-read[:, sensors.sole_linvel_world[side, 2]])
        self._sole_force_n.append(force_n[:, side])
        if landed:
            self._end_step(midway_world)

    def _end_step(self, midway_world: np.ndarray) -> None:
        if self._step_from_world is not None:
            self._walked_m += float(np.linalg.norm(midway_world - self._step_from_world))
        self._step_from_world = midway_world
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
        return summary_of([self])


def summary_of(walks: Sequence[GaitRecorder]) -> GaitSummary | None:
    """The figures of the same robot's walks as one; None where too few steps were taken.

    The height at rest is the median over the walks that came to rest.
    """
    bobs_m = [bob_m for walk in walks for bob_m in walk._bobs_m]
    walked_m = sum(walk._walked_m for walk in walks)
    if len(bobs_m) < LEAST_STEPS or walked_m <= 0:
        return None
    heights_m = np.concatenate([walk._heights_m for walk in walks])
    latest = round(REST_S / CONTROL_PERIOD_S)
    rests_m = [np.mean(walk._resting_m[-latest:]) for walk in walks if walk._resting_m]
    touchdowns = [speed for walk in walks for speed in walk._touchdowns_m_s]
    weight_n = walks[0]._weight_n
    return GaitSummary(
        pelvis_height_m={
            "median": float(np.median(heights_m)),
            "least": float(heights_m.min()),
            "at_rest": float(np.median(rests_m)) if rests_m else None,
        },
        pelvis_bob_m=float(np.median(bobs_m)),
        swing_apex_m=_median_and_p95([apex_m for walk in walks for apex_m in walk._apexes_m]),
        touchdown_speed_m_s=_median_and_p95(touchdowns) if touchdowns else None,
        peak_force_weights=max(walk._peak_n for walk in walks) / weight_n,
        cost_of_transport=sum(walk._work_j for walk in walks) / (weight_n * walked_m),
        speed_m_s=walked_m / sum(walk._walked_s for walk in walks),
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
