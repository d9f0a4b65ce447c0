"""A slow oracle of the footstep search: the whole graph of steps as a dict, and plain Dijkstra.

Shares with the planner only the step table, that is which steps there are; poses, costs, limits of
the first step and collisions are worked out here, the last by shapely.
"""

from __future__ import annotations

import heapq
import itertools
import math

import numpy as np
import shapely
from shapely import affinity

from planner.lattice.steps import build_step_table
from planner.robot_model import BodyShape, FootShape, StepLimits, StepModel
from tests.height_oracle import HeightOracle

Node = tuple[int, int, int, int]  # col, row, heading, side


def small_model(**changes) -> StepModel:
    """A robot with few steps on a coarse lattice, for graphs that a dict can hold."""
    fields = {
        "foot": FootShape(length_m=0.2, width_m=0.1),
        "body": BodyShape(length_m=0.36, width_m=0.36),
        "limits": StepLimits(x_m=(-0.2, 0.3), y_m=(0.14, 0.4), yaw_rad=(-0.4, 0.8)),
        "steps": (
            (0.3, 0.2, 0.0),
            (-0.1, 0.2, 0.0),
            (0.0, 0.3, 0.0),
            (0.0, 0.2, 0.0),
            (0.1, 0.25, 0.79),
        ),
        "stance_width_m": 0.2,
        "cell_m": 0.1,
        "headings": 8,
        **changes,
    }
    return StepModel(**fields)


class Oracle:
    """All steps on one map toward one goal, and exact costs."""

    def __init__(self, grid, model, goal):
        self.model, self.goal = model, goal
        self.table = build_step_table(model)
        row, col = np.nonzero(grid.blocked())
        size = grid.resolution_m
        squares = shapely.box(col * size, row * size, (col + 1) * size, (row + 1) * size)
        self._blocked = shapely.union_all(squares)
        shapely.prepare(self._blocked)
        self._floor = shapely.box(0, 0, *grid.size_m)
        self._edge = self._floor.exterior
        self._origin = grid.origin
        self._heights = None if grid.elevation_m is None else HeightOracle(grid, model)
        self._free: dict = {}
        self._edges: dict = {}

    def pose(self, node: Node):
        """World x, y, yaw of a node."""
        col, row, heading, side = node
        model, (gx, gy, gyaw) = self.model, self.goal
        x = col * model.cell_m
        y = row * model.cell_m + (0.5 - side) * model.stance_width_m
        yaw = gyaw + heading * 2 * math.pi / model.headings
        return (
            gx + math.cos(gyaw) * x - math.sin(gyaw) * y,
            gy + math.sin(gyaw) * x + math.cos(gyaw) * y,
            yaw,
        )

    def box_is_free(self, x, y, yaw, length_m, width_m, margin_m) -> bool:
        """Whether a box lies on the floor, and so far from its edge and the blocked cells."""
        half_l, half_w = length_m / 2 - 1e-7, width_m / 2 - 1e-7
        box = shapely.box(-half_l, -half_w, half_l, half_w)
        box = affinity.rotate(box, yaw, origin=(0, 0), use_radians=True)
        box = affinity.translate(box, x - self._origin[0], y - self._origin[1])
        box = affinity.rotate(box, -self._origin[2], origin=(0, 0), use_radians=True)
        if not self._floor.covers(box):
            return False
        return not (self._blocked.dwithin(box, margin_m) or self._edge.dwithin(box, margin_m))

    def node_is_free(self, node: Node) -> bool:
        """Whether the foot and the body over it are free."""
        if node not in self._free:
            x, y, yaw = self.pose(node)
            foot, body = self.model.foot, self.model.body
            inward = (node[3] - 0.5) * self.model.stance_width_m
            bx, by = x - inward * math.sin(yaw), y + inward * math.cos(yaw)
            self._free[node] = (
                self.box_is_free(x, y, yaw, foot.length_m, foot.width_m, self.model.foot_margin_m)
                and self.box_is_free(
                    bx, by, yaw, body.length_m, body.width_m, self.model.body_margin_m
                )
                and (self._heights is None or self._heights.under(x, y, yaw) is not None)
            )
        return self._free[node]

    def step_is_free(self, support, swing, side) -> bool:
        """Whether the body is free at the pair pose of two foot poses x, y, yaw, and the step too.

        side: that of the swing foot.
        """
        if self._heights is not None:
            heights = self._heights.under(*support), self._heights.under(*swing)
            if not self._heights.can_step(support, heights[0], swing, heights[1], side):
                return False
        turn = math.remainder(swing[2] - support[2], 2 * math.pi)
        body = self.model.body
        return self.box_is_free(
            (support[0] + swing[0]) / 2,
            (support[1] + swing[1]) / 2,
            support[2] + turn / 2,
            body.length_m,
            body.width_m,
            self.model.body_margin_m,
        )

    def cost(self, support, swing) -> float:
        """Distance between the feet and the cost of a step."""
        return math.dist(support[:2], swing[:2]) + self.model.step_cost_m

    def edges(self, node: Node):
        """Steps from a node as (cost, node)."""
        if node not in self._edges:
            col, row, heading, side = node
            here, found = self.pose(node), []
            for k in range(len(self.model.steps)):
                at = heading, side, k
                if not self.table.cost_um[at]:
                    continue
                to = (
                    int(col + self.table.d_col[at]),
                    int(row + self.table.d_row[at]),
                    int((heading + self.table.d_heading[at]) % self.model.headings),
                    1 - side,
                )
                if self.node_is_free(to) and self.step_is_free(here, self.pose(to), 1 - side):
                    found.append((self.cost(here, self.pose(to)), to))
            self._edges[node] = found
        return self._edges[node]

    def first_steps(self, start):
        """First steps from a pair pose as (cost, node)."""
        model = self.model
        half = model.stance_width_m / 2
        x, y, yaw = start
        far = math.ceil(0.6 / model.cell_m)
        for side in (0, 1):
            sign = 1 if side else -1  # the support foot is the other one
            support = x - sign * half * math.sin(yaw), y + sign * half * math.cos(yaw), yaw
            gx, gy, gyaw = self.goal
            away = support[0] - gx, support[1] - gy
            col0 = round((math.cos(gyaw) * away[0] + math.sin(gyaw) * away[1]) / model.cell_m)
            row0 = round((math.cos(gyaw) * away[1] - math.sin(gyaw) * away[0]) / model.cell_m)
            for d_col, d_row, heading in itertools.product(
                range(-far, far + 1), range(-far, far + 1), range(model.headings)
            ):
                node = col0 + d_col, row0 + d_row, heading, side
                there = self.pose(node)
                dx, dy = there[0] - support[0], there[1] - support[1]
                turn = math.remainder(there[2] - yaw, 2 * math.pi)
                ahead = math.cos(yaw) * dx + math.sin(yaw) * dy
                out = -sign * (math.cos(yaw) * dy - math.sin(yaw) * dx)
                limits = model.limits
                inside = all(
                    low - 1e-9 <= value <= high + 1e-9
                    for value, (low, high) in zip(
                        (ahead, out, -sign * turn),
                        (limits.x_m, limits.y_m, limits.yaw_rad),
                        strict=True,
                    )
                )
                if inside and limits.reach_m:
                    polygon = shapely.Polygon(limits.reach_m)
                    inside = polygon.distance(shapely.Point(ahead, out)) <= 1e-9
                if inside and self.node_is_free(node) and self.step_is_free(support, there, side):
                    yield self.cost(support, there), node

    def best_cost(self, start) -> float:
        """Least cost of any plan from a pair pose; inf if there is none."""
        done: set[Node] = set()
        heap = list(self.first_steps(start))
        heapq.heapify(heap)
        last = self.model.stance_width_m + self.model.step_cost_m
        while heap:
            cost, node = heapq.heappop(heap)
            if node[:3] == (0, 0, 0):
                return cost + last
            if node in done:
                continue
            done.add(node)
            for step, to in self.edges(node):
                heapq.heappush(heap, (cost + step, to))
        return math.inf

    def costs_from(self, first_steps) -> dict[Node, float]:
        """Exact least cost to every node that is reached after one of the (cost, node)."""
        done: dict[Node, float] = {}
        heap = list(first_steps)
        heapq.heapify(heap)
        while heap:
            cost, node = heapq.heappop(heap)
            if node not in done:
                done[node] = cost
                for step, to in self.edges(node):
                    heapq.heappush(heap, (cost + step, to))
        return done

    def costs_to_go(self, start) -> dict[Node, float]:
        """Exact least cost to the end of a plan from every node that steps from a start reach."""
        reached = {node for _, node in self.first_steps(start)}
        waiting = list(reached)
        while waiting:
            for _, to in self.edges(waiting.pop()):
                if to not in reached:
                    reached.add(to)
                    waiting.append(to)
        before: dict[Node, list] = {node: [] for node in reached}
        for node in reached:
            for step, to in self.edges(node):
                before[to].append((step, node))
        last = self.model.stance_width_m + self.model.step_cost_m
        heap = [(last, (0, 0, 0, side)) for side in (0, 1) if (0, 0, 0, side) in reached]
        costs: dict[Node, float] = {}
        while heap:
            cost, node = heapq.heappop(heap)
            if node in costs:
                continue
            costs[node] = cost
            for step, source in before[node]:
                heapq.heappush(heap, (cost + step, source))
        return costs


def oracle_node(lattice, node: int) -> Node:
    """The oracle's node of a node of a search's space."""
    cell, row = divmod(node, 2 * lattice.headings)
    up, across = divmod(cell, lattice.cols)
    return across - lattice.origin_col, up - lattice.origin_row, row // 2, row % 2


def lattice_node(lattice, node: Node) -> int:
    """The number of the oracle's node in a search's space."""
    col, row, heading, side = node
    cell = (row + lattice.origin_row) * lattice.cols + col + lattice.origin_col
    return (cell * lattice.headings + heading) * 2 + side
