"""What there is to be seen of a session at this moment."""

from __future__ import annotations

from app.viewer.record import Record
from app.viewer.replanning import Guide
from app.viewer.setting import finite_pose
from app.viewer.snapshot import Snapshot
from planner.plan import FootstepPlan, Pose


def look(guide: Guide, record: Record, *, start: Pose, speed: float) -> Snapshot:
    """The robot, its plan and its walk so far; called in the thread of the physics."""
    rover = guide.rover
    plan, done = _plan_to_show(guide)
    return Snapshot(
        qpos=rover.qpos[-1],
        time_s=rover.time_s,
        walk=record.walk,
        start=start,
        goal=finite_pose(rover.goal) if rover.plans and not rover.halted else None,
        wished=guide.wished,
        plan=plan,
        done=done,
        placed_side=record.placed_side,
        placed_world=record.placed_world,
        foot_error_m=record.foot_error_m,
        path_world=record.path_world,
        status=rover.status(is_asking=guide.question is not None),
        replans=rover.replans,
        answer_s=guide.answer_s,
        clearance_m=record.clearance_m,
        goal_error=rover.goal_error if rover.plans else None,
        speed=speed,
        notice=guide.notice,
    )


def _plan_to_show(guide: Guide) -> tuple[FootstepPlan | None, int]:
    """The plan to be seen, and how many of its steps have been taken."""
    rover = guide.rover
    if rover.waiting is not None:
        return rover.waiting, 0
    if guide.question is not None and guide.preview is not None and not rover.going:
        return guide.preview, 0
    if not rover.followed:
        return None, 0
    begun_s, plan = rover.followed[-1]
    return plan, sum(placed.time_s > begun_s for placed in rover.placed)
