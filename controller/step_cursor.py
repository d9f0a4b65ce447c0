"""The present step of each robot in its step sequence.

A step sequence is a plan preceded by the start stance: entry 0 is the pose of the foot that moves
first, entry 1 that of the other foot, entry 2 + k is step k. The gait clock moves the window on the
sequence: it advances when a step's period ends, so side of the step and phase of the gait agree.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controller.gait import CONTROL_PERIOD_S, GaitTicks, clock, support_indicator
from planner.robot_model import Side

STANCE = 2  # entries of a sequence before its first step
# Share of its swing during which a foot that must clear something is on its way up.
RISING_SHARE = 0.7
# So much higher than what it clears the policy is told that its step is.
CLEARED_BY_M = 0.03


@dataclass(frozen=True, kw_only=True)
class StepSequence:
    """The start stance followed by the steps.

    `side` (STANCE + N,) alternates; `pose_world` (STANCE + N, 4) is x_m, y_m, z_m, yaw_rad.
    `step_s` (N,) is how long each step takes; None: as long as the robot's gait does.
    `swing_over_z_m` (N,) is the top of what each step swings over, -inf where that is nothing;
    None: all level with the feet.
    """

    side: np.ndarray
    pose_world: np.ndarray
    step_s: np.ndarray | None = None
    swing_over_z_m: np.ndarray | None = None

    @classmethod
    def of(
        cls,
        start_feet_world: np.ndarray,
        side: np.ndarray,
        pose_world: np.ndarray,
        step_s: np.ndarray | None = None,
        swing_over_z_m: np.ndarray | None = None,
    ) -> StepSequence:
        """A sequence from the start feet (2, 4; left, right) and the steps side (N,), pose (N, 4).

        Raises:
            ValueError: the steps do not alternate between left and right.
        """
        if np.any(np.diff(side) == 0):
            raise ValueError("steps must alternate between left and right")
        first = Side(int(side[0])) if len(side) else Side.LEFT
        order = np.array([first, 1 - first])
        return cls(
            side=np.concatenate([order, side]),
            pose_world=np.concatenate([start_feet_world[order], pose_world]),
            step_s=step_s,
            swing_over_z_m=swing_over_z_m,
        )


@dataclass(frozen=True, kw_only=True)
class UpcomingSteps:
    """Steps of one robot from the present one on; times are in seconds from now.

    `side` (n,), `pose_world` (n, 4), `lift_off_s` and `touch_down_s` (n,). What the present step
    has done already lies in the past.
    """

    side: np.ndarray
    pose_world: np.ndarray
    lift_off_s: np.ndarray
    touch_down_s: np.ndarray


class StepCursor:
    """The present step of each of B robots and the control tick within its period.

    `entry` (B,) is the first sequence entry of the window. While a robot walks, this is the step
    whose foot swings or has just landed; `tick` (B,) counts from its lift-off. While it stands, the
    window holds the two feet it stands on. `gait` is the duration of steps without their own.
    """

    def __init__(self, gait: GaitTicks, count: int, capacity: int):
        self.gait = gait
        self._rows = np.arange(count)
        self._side = np.zeros((count, STANCE + capacity + 1), dtype=np.int64)
        self._pose = np.zeros((count, STANCE + capacity + 1, 4))
        self._swing = np.full((count, STANCE + capacity + 1), gait.swing, dtype=np.int64)
        self._double = np.full((count, STANCE + capacity + 1), gait.double_support, dtype=np.int64)
        self._over_z_m = np.full((count, STANCE + capacity + 1), -np.inf)
        self._steps = np.zeros(count, dtype=np.int64)
        self._wait = np.zeros(count, dtype=np.int64)
        self.entry = np.zeros(count, dtype=np.int64)
        self.tick = np.zeros(count, dtype=np.int64)
        self.standing = np.ones(count, dtype=bool)

    def follow(
        self, row: int, sequence: StepSequence, *, wait_ticks: int = 0, walking: bool = False
    ) -> None:
        """Let robot `row` follow a sequence from its beginning.

        It stands for `wait_ticks`, then shifts its weight during one double support, then
        takes the first step. With `walking` its feet are both down in mid-walk: it lifts the
        first foot at once.
        """
        steps = len(sequence.side) - STANCE
        end = STANCE + steps
        if end + 1 > self._side.shape[1]:
            grown = end + 1 - self._side.shape[1]
            self._side = np.pad(self._side, ((0, 0), (0, grown)))
            self._pose = np.pad(self._pose, ((0, 0), (0, grown), (0, 0)))
            self._swing = np.pad(self._swing, ((0, 0), (0, grown)))
            self._double = np.pad(self._double, ((0, 0), (0, grown)))
            self._over_z_m = np.pad(self._over_z_m, ((0, 0), (0, grown)))
        self._side[row, :end], self._pose[row, :end] = sequence.side, sequence.pose_world
        # After the last step the window shows the other foot where it stands.
        self._side[row, end], self._pose[row, end] = sequence.side[-2], sequence.pose_world[-2]
        self._swing[row], self._double[row] = self.gait.swing, self.gait.double_support
        if sequence.step_s is not None and steps:
            ticks = self.gait.for_durations(sequence.step_s)
            self._swing[row, STANCE:end], self._double[row, STANCE:end] = (
                ticks.swing,
                ticks.double_support,
            )
            # The weight shift before the first step is as quick as that step.
            self._swing[row, :STANCE] = self._swing[row, STANCE]
            self._double[row, :STANCE] = self._double[row, STANCE]
        self._over_z_m[row] = -np.inf
        if sequence.swing_over_z_m is not None:
            self._over_z_m[row, STANCE:end] = sequence.swing_over_z_m
        self._steps[row] = steps
        self._wait[row] = wait_ticks
        self.standing[row] = steps == 0 or not walking
        self.entry[row] = STANCE if walking and steps else 0
        self.tick[row] = 0

    def shift(self, rows: np.ndarray, offset_m: np.ndarray) -> None:
        """Move the present and all later steps of the robots `rows` (n,) by x, y (n, 2)."""
        entry = np.arange(self._pose.shape[1])
        # The entry after the last step is the other foot, which stands: see `follow`.
        end = (STANCE + self._steps[rows])[:, None]
        step = np.where(entry == end, entry - STANCE, entry)
        later = (step >= self.entry[rows, None]) & (entry <= end)
        self._pose[rows, :, :2] += later[..., None] * offset_m[:, None]

    def move_steps(self, row: int, first: int, pose_world: np.ndarray) -> None:
        """Give the steps of robot `row` from number `first` on, from 0, other poses (n, 4)."""
        end = STANCE + int(self._steps[row])
        self._pose[row, STANCE + first : end] = pose_world
        self._pose[row, end] = self._pose[row, end - STANCE]

    def hasten(self, rows: np.ndarray, swing_ticks: np.ndarray) -> None:
        """End the present swings of the robots `rows` (n,) after so many ticks (n,).

        The double support after it is shortened by the same share.
        """
        at = rows, self.entry[rows]
        double = np.rint(self._double[at] * (swing_ticks / self._swing[at])).astype(np.int64)
        self._swing[at], self._double[at] = swing_ticks, np.maximum(double, 1)

    def postpone(self, row: int, ticks: int) -> None:
        """Let robot `row`, while both its feet are down, lift the next foot so much later."""
        if self.standing[row]:
            self._wait[row] += ticks
        else:
            self._double[row, self.entry[row]] += ticks

    def advance(self) -> np.ndarray:
        """Let one control tick pass; true (B,) where the period of a step has just ended.

        The weight shift before the first step is not a step.
        """
        walking = ~self.standing
        self.tick[walking] += 1
        ended = walking & (self.tick >= self.ticks.step)
        stepped = ended & (self.entry >= STANCE)
        self.entry[ended] += 1
        self.tick[ended] = 0
        arrived = ended & (self.entry == STANCE + self._steps)
        self.standing[arrived] = True
        self.entry[arrived] -= STANCE
        self._set_off()
        return stepped

    def _set_off(self) -> None:
        """Start the gait of robots whose wait is over, at the double support before a swing."""
        waiting = self.standing & (self.entry == 0) & (self._steps > 0)
        self._wait[waiting] -= 1
        start = waiting & (self._wait < 0)
        self.standing[start] = False
        self.entry[start] = STANCE - 1
        self.tick[start] = self._swing[start, STANCE - 1]

    @property
    def ticks(self) -> GaitTicks:
        """Durations (B,) of the step in the window's first place."""
        at = self._rows, self.entry
        return GaitTicks(swing=self._swing[at], double_support=self._double[at])

    @property
    def step_s(self) -> np.ndarray:
        """Seconds (B, 2) that the present and the next step take; the gait's while it stands."""
        entries = self._rows[:, None], self.entry[:, None] + np.arange(2)
        ticks = np.where(
            self.standing[:, None],
            self.gait.step,
            self._swing[entries] + self._double[entries],
        )
        return ticks * CONTROL_PERIOD_S

    @property
    def step_number(self) -> np.ndarray:
        """Steps completed or under way (B,): 0 before the first swing."""
        return np.clip(self.entry - STANCE + 1 + STANCE * self.arrived, 0, self._steps)

    @property
    def arrived(self) -> np.ndarray:
        """True (B,) where the last step has been taken and the robot stands."""
        return self.standing & ((self.entry > 0) | (self._steps == 0))

    @property
    def swinging(self) -> np.ndarray:
        """True (B,) while a foot is in its swing."""
        return ~self.standing & (self.tick < self.ticks.swing)

    @property
    def side(self) -> np.ndarray:
        """The foot of the step in the window's first place (B,)."""
        return self._side[self._rows, self.entry]

    @property
    def window(self) -> np.ndarray:
        """Poses in the world of the present and the next step (B, 2, 4)."""
        entries = self.entry[:, None] + np.arange(2)
        return self._pose[self._rows[:, None], entries]

    @property
    def swing_over_z_m(self) -> np.ndarray:
        """Top (B,) of what the step in the window's first place swings over, -inf for nothing."""
        return self._over_z_m[self._rows, self.entry]

    @property
    def shown_window(self) -> np.ndarray:
        """The window (B, 2, 4) as the policy sees it.

        It is not told what lies between the steps. So a foot that must clear something sees a
        step a little higher than that until it is past it, and lifts itself onto it.
        """
        window = self.window
        rising = self.swinging & (self.tick < RISING_SHARE * self.ticks.swing)
        raised_m = np.maximum(window[:, 0, 2], self.swing_over_z_m + CLEARED_BY_M)
        window[:, 0, 2] = np.where(rising, raised_m, window[:, 0, 2])
        return window

    @property
    def foot_targets(self) -> np.ndarray:
        """Where each foot should be now (B, 2, 4), left then right.

        The swing foot's is the present step, the support foot's the step before it; of a
        standing robot both are where it stands.
        """
        other = np.where(self.standing, self.entry + 1, self.entry - 1)
        is_present = self.side[:, None] == np.arange(2)
        entries = np.where(is_present, self.entry[:, None], other[:, None])
        return self._pose[self._rows[:, None], entries]

    @property
    def lift_off_poses(self) -> np.ndarray:
        """Where the foot of the window's first step stood before it (B, 4)."""
        return self._pose[self._rows, np.maximum(self.entry - STANCE, 0)]

    @property
    def stances(self) -> np.ndarray:
        """Both feet (B, 3, 2, 4) of the stance before the present step, of that after it, and next.

        In the order in which the feet move. Before the first step and after the last one there is
        no farther stance than the one that the robot stands in.
        """
        after = np.where(self.standing, self.entry, self.entry - 1)
        next_ = np.where(self.standing, self.entry, np.minimum(self.entry, self._steps))
        before = np.where(self.standing, self.entry, np.maximum(self.entry - STANCE, 0))
        entries = np.stack([before, after, next_], axis=1)[..., None] + np.arange(2)
        return self._pose[self._rows[:, None, None], entries]

    def upcoming(self, row: int) -> UpcomingSteps:
        """The steps of robot `row` that are under way or still to come; none where it arrived."""
        entry, tick = int(self.entry[row]), int(self.tick[row])
        end = STANCE + int(self._steps[row])
        first = end if self.arrived[row] else max(entry, STANCE)
        swing, step = self._swing[row, first:end], (self._swing + self._double)[row, first:end]
        if entry >= STANCE:
            lift_off = -tick
        elif self.standing[row]:
            lift_off = int(self._wait[row]) + 1 + int(self._double[row, STANCE - 1])
        else:
            lift_off = int(self._swing[row, entry] + self._double[row, entry]) - tick
        begins = lift_off + np.concatenate([[0], np.cumsum(step)[:-1]])[: len(step)]
        return UpcomingSteps(
            side=self._side[row, first:end],
            pose_world=self._pose[row, first:end],
            lift_off_s=begins * CONTROL_PERIOD_S,
            touch_down_s=(begins + swing) * CONTROL_PERIOD_S,
        )

    @property
    def clock(self) -> np.ndarray:
        """Sine and cosine of the gait phase (B, 2)."""
        return clock(self.ticks, self.side, self.tick, self.standing)

    @property
    def support_indicator(self) -> np.ndarray:
        """How much each foot should bear weight (B, 2), in [-1, 1], left then right."""
        return support_indicator(self.ticks, self.side, self.tick, self.standing)
