"""Plan footsteps on a map and draw them: `python examples/plan_on_a_map.py [OUT.png]`."""

import sys

import footfall

grid = footfall.read_map("maps/room.png")
robot = footfall.load_robot("jvrc1")
plan = footfall.plan(grid, robot, (0, 0, 0), (2, 1, 1.57))
footfall.draw(sys.argv[1] if len(sys.argv) > 1 else "plan.png", grid, robot, plan)
print(plan)
