"""Walk to a goal in MuJoCo and look at each step: `python examples/walk_a_plan.py [X,Y,YAW]`."""

import sys

import footfall

goal = tuple(float(part) for part in (sys.argv[1] if len(sys.argv) > 1 else "2,1,1.57").split(","))
walk = footfall.navigate(
    footfall.read_map("maps/room.png"), footfall.load_robot("jvrc1"), (0, 0, 0), goal
)
for number, step in enumerate(walk.placed, start=1):
    x_m, y_m, _, yaw_rad = step.placed_world
    print(
        f"{number:3d} {step.side.name.lower():5} at {x_m:5.2f}, {y_m:5.2f}, {yaw_rad:5.2f}: "
        f"{100 * step.error_m:.1f} cm from its step"
    )
print(walk.report().summary())
