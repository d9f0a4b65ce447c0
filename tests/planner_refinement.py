"""Plans before and after refinement, and the laws that hold between them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from maps.grid import OccupancyGrid
from planner.lattice.steps import feet_apart
from planner.options import PlannerOptions
from planner.plan import FootstepPlan, feet_at, relative_step
from planner.planner import plan_footsteps
from planner.refinement.cost import refinement_problem
from planner.robot_model import Side
from planner.verify import violations
from tests.planner_floor import LATTICE, fine_model, scatter, walled
from tests.planner_oracle import small_model

REFINED = PlannerOptions(refine=True)
FLOOR = walled(40, 60)


def shy_model(**changes):
    """A robot that minds turning, side steps, steps back and walls."""
    costs = {"turn_cost_m": 0.05, "side_cost_m": 0.2, "back_cost_m": 0.2, "clearance_cost_m": 0.1}
    return fine_model(**{**costs, **changes})


def random_floor(seed, cells=60):
    rng = np.random.default_rng(seed)
    floor = np.zeros((cells, cells), np.uint8)
    scatter(rng, floor, 6, 9)
    origin = (*rng.uniform(-3, 3, 2), rng.uniform(-3, 3)) if seed % 2 else (0.0, 0.0, 0.0)
    return OccupancyGrid(cells=floor, resolution_m=0.05, origin=origin), rng


def both(grid, model, **query):
    """The plan on the lattice, and the refined one."""
    plans = [plan_footsteps(grid, model, options=o, **query) for o in (LATTICE, REFINED)]
    return plans[0], plans[1]


def steps_of(plan: FootstepPlan):
    """Steps (N, 3) of a plan as the limits count them."""
    support = plan.start_feet_world[Side(int(plan.side[0])).other]
    steps = []
    for side, pose in zip(plan.side, plan.pose_world, strict=True):
        steps.append(relative_step(support, pose, Side(int(side))))
        support = pose
    return np.array(steps)


def assert_laws(grid, model, before, after, stood_freely=True):
    assert after.found == before.found
    if not before.found:
        return
    assert before.cost_before_refinement_m is None
    assert after.cost_before_refinement_m == before.cost_m
    assert after.cost_m <= before.cost_m
    assert after.epsilon == before.epsilon
    assert len(after) <= len(before)
    assert violations(after, grid, model, stood_freely=stood_freely) == []
    steps = steps_of(after)
    assert model.limits.contain(steps, 1e-9).all()
    assert feet_apart(steps, model.foot, model.foot_gap_m - 1e-9).all()
    np.testing.assert_array_equal(after.start_feet_world, before.start_feet_world)
    goal = feet_at(after.goal, model.stance_width_m)
    assert after.pose_world[-2:, [0, 1, 3]].tolist() == goal[after.side[-2:]][:, [0, 1, 3]].tolist()
    assert set(after.side[-2:].tolist()) == {0, 1}


def stairs():
    """Treads of 0.3 m that rise by 5 cm from x = 1.5 m on, and a robot that climbs them."""
    treads = [(0, 30 + 6 * k, 40, 80, 0.05 * (k + 1)) for k in range(4)]
    grid = walled(40, 80, resolution_m=0.05, treads=treads)
    limits = replace(small_model().limits, z_m=(-0.08, 0.08))
    return grid, small_model(limits=limits, cell_m=0.05, headings=16)


def problem_of(planner, plan):
    """RefinementProblem of a planner's space, and a plan as a path on a map whose origin is 0."""
    feet = plan.start_feet_world[:, [0, 1, 3]].copy()
    problem = refinement_problem(
        planner.goal_context(plan.goal).lattice,
        planner.model,
        feet,
        np.zeros(2, np.int64),
        planner.model.body_margin_m,
    )
    poses = np.vstack([feet[1 - plan.side[0]], plan.pose_world[:, [0, 1, 3]]])
    return problem, poses, float(Side(int(plan.side[0])).outward)
