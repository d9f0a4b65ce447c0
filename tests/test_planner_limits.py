"""When a search ends: no way at all, enough of improving, and what it may say of the bound then."""

from __future__ import annotations

import math

import numpy as np
import pytest

from maps.grid import Cell, OccupancyGrid
from planner.options import PlannerOptions
from planner.plan import PlanStatus, feet_at
from planner.planner import Planner, plan_footsteps
from planner.robot_model import BodyShape
from planner.search import ara_star as run
from planner.search.reachability import Verdict, expand_both, new_flood
from planner.verify import violations
from tests.planner_floor import scatter
from tests.planner_oracle import Oracle, small_model

# A body that is longer than wide fits by its width, as the 2D search sees it, where it cannot turn.
LONG = small_model(body=BodyShape(length_m=0.9, width_m=0.36))


def random_floor(seed):
    rng = np.random.default_rng(seed)
    cells = np.zeros((24, 24), np.uint8)
    scatter(rng, cells, 8, 7)
    return OccupancyGrid(cells=cells, resolution_m=0.1), rng


def bent_corridor():
    """A room, and a corridor 0.5 m wide out of it that turns a corner."""
    cells = np.full((30, 30), Cell.OCCUPIED, np.uint8)
    cells[2:16, 2:14] = Cell.FREE
    cells[6:11, 14:25] = Cell.FREE
    cells[6:28, 20:25] = Cell.FREE
    return OccupancyGrid(cells=cells, resolution_m=0.1)


BLOCKED = PlanStatus.START_BLOCKED, PlanStatus.GOAL_BLOCKED
BENT, IN_ROOM, ROUND_CORNER = bent_corridor(), (0.8, 0.8, 0.0), (2.25, 2.1, math.pi / 2)


@pytest.fixture
def impatient(monkeypatch):
    """The floods take their turn from the first state on, in small bites."""
    for name, value in (("_PATIENCE", 1), ("_TURN", 5), ("_FLOOD_TURN", 50)):
        monkeypatch.setattr(run, name, value)


@pytest.mark.parametrize("seed", range(6))
def test_the_floods_meet_just_where_the_oracle_finds_a_way(seed):
    grid, rng = random_floor(seed)
    model = small_model(body=BodyShape(length_m=0.6, width_m=0.36))
    compared = 0
    while compared < 4:
        start, goal = rng.uniform((0.3, 0.3, -3.1), (2.1, 2.1, 3.1), (2, 3))
        planner = Planner(grid, model, PlannerOptions(refine=False))
        if planner.plan(start=start, goal=goal).status in BLOCKED:
            continue
        lattice = planner.goal_context(goal).lattice
        oracle = Oracle(grid, model, goal)

        def number(node, lattice=lattice):
            col, row, heading, side = node
            cell = (row + lattice.origin_row) * lattice.cols + col + lattice.origin_col
            return (cell * lattice.headings + heading) * 2 + side

        seeds = np.array([number(node) for _, node in oracle.first_steps(start)], np.int64)
        if not len(seeds):
            continue
        goals = np.array([number((0, 0, 0, side)) for side in (0, 1)])
        flood, verdict = new_flood(lattice, seeds, goals), Verdict.OPEN
        while verdict is Verdict.OPEN:
            flood, verdict = expand_both(lattice, flood, 7)
        assert (verdict is Verdict.MET) == math.isfinite(oracle.best_cost(start))
        compared += 1


@pytest.mark.parametrize("seed", range(4))
def test_no_goal_is_given_up_that_can_be_reached(seed, impatient):
    grid, rng = random_floor(seed)
    for _ in range(6):
        start, goal = rng.uniform((0.3, 0.3, -3.1), (2.1, 2.1, 3.1), (2, 3))
        plan = plan_footsteps(
            grid, LONG, start=start, goal=goal, options=PlannerOptions(refine=False)
        )
        if plan.status in (PlanStatus.FOUND, PlanStatus.NO_PATH):
            reachable = math.isfinite(Oracle(grid, LONG, goal).best_cost(start))
            assert plan.found == reachable


@pytest.mark.parametrize(
    ("start", "goal", "side"),
    [(IN_ROOM, ROUND_CORNER, "outside to the goal"), (ROUND_CORNER, IN_ROOM, "out from the start")],
)
def test_a_corner_too_tight_to_turn_is_found_out_from_its_smaller_side(
    start, goal, side, impatient
):
    plan = plan_footsteps(BENT, LONG, start=start, goal=goal, options=PlannerOptions(refine=False))
    assert plan.status is PlanStatus.NO_PATH
    assert side in plan.reason
    # A short body of the same width gets round the corner.
    assert plan_footsteps(
        BENT, small_model(), start=start, goal=goal, options=PlannerOptions(refine=False)
    ).found


def test_the_floods_cost_no_expansions_once_they_know(impatient, monkeypatch):
    quick = plan_footsteps(
        BENT, LONG, start=IN_ROOM, goal=ROUND_CORNER, options=PlannerOptions(refine=False)
    )
    monkeypatch.setattr(run, "_PATIENCE", 10**9)
    slow = plan_footsteps(
        BENT, LONG, start=IN_ROOM, goal=ROUND_CORNER, options=PlannerOptions(refine=False)
    )
    assert slow.status is quick.status is PlanStatus.NO_PATH
    assert quick.expansions < slow.expansions / 2


def test_improving_stops_after_so_many_states_with_a_bound_that_holds():
    grid = OccupancyGrid(cells=np.zeros((40, 40), np.uint8), resolution_m=0.1)
    cells = grid.cells.copy()
    cells[0:30, 18:20] = Cell.OCCUPIED
    grid = grid.with_cells(cells)
    model = small_model(cell_m=0.05, headings=16, clearance_m=0.3, clearance_cost_m=0.3)
    start, goal = (0.8, 0.8, 0.0), (3.2, 0.8, 1.0)

    def plan(**options):
        found = plan_footsteps(
            grid,
            model,
            start=start,
            goal=goal,
            options=PlannerOptions(epsilon=5.0, refine=False, **options),
        )
        assert violations(found, grid, model) == []
        return found

    first = plan(stop_at_first=True)
    best = plan(improve_expansions=None)
    assert best.epsilon == 1.0
    spent = best.expansions - first.expansions
    assert spent > 100
    costs = []
    for limit in (0, spent // 3, spent // 2, 2 * spent):
        bounded = plan(improve_expansions=limit)
        assert bounded.expansions <= first.expansions + limit
        assert best.cost_m - 1e-6 <= bounded.cost_m <= first.cost_m + 1e-6
        assert bounded.cost_m <= bounded.epsilon * best.cost_m + 1e-6
        costs.append(bounded.cost_m)
    assert costs == sorted(costs, reverse=True)
    assert costs[-1] == pytest.approx(best.cost_m)
    # Past the first plan the bound is worked out anew, from the states that are open then.
    assert first.epsilon < 5.0


def test_a_robot_on_its_feet_keeps_its_margin_unless_it_stands_too_near():
    # A wall along x = 0.8 m; the body, 0.36 m wide and long, with a margin of 6 cm.
    cells = np.zeros((30, 40), np.uint8)
    cells[:, :8] = Cell.OCCUPIED
    grid = OccupancyGrid(cells=cells, resolution_m=0.1)
    model = small_model(body_margin_m=0.06)
    goal, checked = (1.3, 2.2, math.pi / 2), 0
    for x_m, freely in ((1.05, True), (1.08, True), (1.02, False)):
        feet = feet_at((x_m, 0.8, math.pi / 2), model.stance_width_m)
        plan = plan_footsteps(
            grid, model, start_feet_world=feet, goal=goal, options=PlannerOptions(refine=False)
        )
        assert plan.found
        assert violations(plan, grid, model, stood_freely=freely) == []
        checked += 1
    assert checked == 3


def test_a_negative_effort_is_refused():
    with pytest.raises(ValueError, match="improve_expansions -1"):
        PlannerOptions(improve_expansions=-1, refine=False)
