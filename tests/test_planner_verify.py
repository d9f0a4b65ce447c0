"""The verifier finds what it is there for."""

from __future__ import annotations

import numpy as np
import pytest

from planner.plan import FootstepPlan, PlanStatus
from planner.verify import violations
from tests.planner_floor import FLOOR, blocked_at, small_plan
from tests.planner_oracle import small_model


@pytest.fixture(scope="module")
def plan():
    return small_plan()


def spoiled(plan, **changes):
    fields = {name: getattr(plan, name) for name in plan.__dataclass_fields__}
    return FootstepPlan(**{**fields, **changes})


def test_the_verifier_finds_every_kind_of_wrong(plan):
    model = small_model()
    assert violations(plan, FLOOR, model) == []

    def wrongs(**changes):
        return " ".join(violations(spoiled(plan, **changes), FLOOR, model))

    moved = np.array(plan.pose_world)
    moved[2, 0] += 0.3
    assert "is outside" in wrongs(pose_world=moved)
    same = np.array(plan.side)
    same[1] = same[0]
    assert "twice in a row" in wrongs(side=same)
    short = np.array(plan.pose_world)
    short[-1, 0] += 1e-6
    assert "not the goal's" in wrongs(pose_world=short)
    onto = np.array(plan.pose_world)
    onto[3, :2] = onto[2, :2]
    assert "apart" in wrongs(pose_world=onto)
    lifted = np.array(plan.pose_world)
    lifted[1, 2] = 0.1
    assert "is not 0 on a flat floor" in wrongs(pose_world=lifted)
    assert "not found" in wrongs(status=PlanStatus.NO_PATH)


@pytest.mark.parametrize(
    ("cell_of", "what"), [(0, "the foot hits"), (1, "the body on both feet hits")]
)
def test_the_verifier_finds_what_feet_and_body_hit(plan, cell_of, what):
    i = len(plan) // 2
    middle = (plan.pose_world[i] + plan.pose_world[i - 1]) / 2
    point = (plan.pose_world[i] if cell_of == 0 else middle)[:2]
    row, col = FLOOR.world_to_cell(point)
    assert what in " ".join(
        violations(plan, blocked_at((row, col, row + 1, col + 1)), small_model())
    )
