"""What people set on a page: start, goal, waypoints and boxes, and how to take it back."""

from __future__ import annotations

from dataclasses import dataclass

from app.navigation.route import Waypoint
from app.viewer.obstacles import Obstacle
from planner.plan import Pose

# So many edits can be taken back; older ones are forgotten.
MOST_EDITS = 200


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """Where a reset puts the robot, where it is to go and by which way, and the boxes."""

    start: Pose
    goal: Pose | None = None
    waypoints: tuple[Waypoint, ...] = ()
    obstacles: tuple[Obstacle, ...] = ()


class EditHistory:
    """The scenarios that people made, one after another, and which of them holds."""

    def __init__(self, now: Scenario) -> None:
        self._now = now
        self._before: list[Scenario] = []
        self._after: list[Scenario] = []

    def note(self, now: Scenario, *, is_edit: bool) -> None:
        """Notes what holds. What is no edit, such as a way that is closed, cannot be taken back.

        Where it leaves all as it was before the last edit, as a refused goal does, there was none.
        """
        if now == self._now:
            return
        if is_edit:
            self._before = [*self._before, self._now][-MOST_EDITS:]
            self._after.clear()
        elif self._before and now == self._before[-1]:
            self._before.pop()
        self._now = now

    def undo(self) -> Scenario | None:
        """The scenario before the last edit, which is to hold now; None if there is none."""
        return self._step(self._before, self._after)

    def redo(self) -> Scenario | None:
        """The scenario whose edit was taken back last; None if there is none."""
        return self._step(self._after, self._before)

    def _step(self, source: list[Scenario], target: list[Scenario]) -> Scenario | None:
        if not source:
            return None
        target.append(self._now)
        self._now = source.pop()
        return self._now
