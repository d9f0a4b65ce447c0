"""The options of `navigate`, and what comes before MuJoCo is loaded: the help needs no more."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from app.options import (
    FolderOption,
    MapOptions,
    OptionalFile,
    PlannerName,
    Pose,
    PoseOption,
    Reach,
    ReachOption,
    RobotName,
    whole_number,
)
from app.output import say
from planner.options import PlannerOptions
from sim.gl import NoGlError, prepare_gl, switch_gl_off


@dataclass(frozen=True, kw_only=True)
class NavigateOptions(MapOptions):
    """Plan footsteps to the goal, walk them in MuJoCo with the trained policy, and report.

    The robot plans again when a foot lands too far from its step. The exit code is 0 when the
    robot stands at the goal, 2 when the input is wrong, 3 when there is no plan, and 4 when there
    was a plan and the walk failed.
    """

    goal: PoseOption
    """Where to stand in the end: metres and radians in the map's frame, such as 2,1,1.57."""

    start: PoseOption = Pose(0.0, 0.0, 0.0)
    """Where the robot stands at first, such as -1,2,0."""

    goal_tolerance: ReachOption = Reach(0.0, 0.0)
    """How far from the goal, and how far turned, a cheaper plan may end, such as 0.05,0.08."""

    robot: RobotName = "jvrc1"
    """Which robot, such as jvrc1."""

    planner: PlannerName = PlannerOptions.name
    """Which planner, such as ara; docs/planners.md tells them apart."""

    refine: bool = True
    """Move the steps off the lattice to where they cost less, unless --no-refine is given."""

    policy: OptionalFile = None
    """The policy that walks, such as runs/train/jvrc1.safetensors; none: the robot's own."""

    seed: Annotated[int, whole_number(at_least=0)] = 0
    """Seed of everything random, such as 7."""

    out: FolderOption = Path("runs/navigate")
    """Folder for report.json, plan.json and path.png, such as runs/today; made when missing."""

    view: bool = False
    """Show the walk live on a web page, for this machine alone, and report when it is over."""

    html: OptionalFile = None
    """Also write the walk as a web page to watch, such as walk.html; opens from disk."""

    video: OptionalFile = None
    """Also write a film of the walk, such as walk.mp4; needs a GL library."""

    strip: OptionalFile = None
    """Also write a picture strip of the whole walk, such as walk.png; needs a GL library."""

    gait_strip: OptionalFile = None
    """Also write a picture strip of one gait cycle, such as gait.png; needs a GL library."""

    json: bool = False
    """Print report.json on standard output, and nothing else there."""

    @property
    def search(self) -> PlannerOptions:
        """What the planner is told."""
        return PlannerOptions(
            name=self.planner,
            refine=self.refine,
            unknown_is_free=self.unknown_is_free,
            seed=self.seed,
            goal_reach_m=self.goal_tolerance.m,
            goal_reach_rad=self.goal_tolerance.rad,
        )

    @property
    def draws_robot(self) -> bool:
        """Whether anything is asked for that needs a GL library."""
        return not (self.video is None and self.strip is None and self.gait_strip is None)


def run(options: NavigateOptions) -> int:
    """Carries the command out; returns the exit code.

    MuJoCo reads the choice of GL library when it is imported, so it is made here, before. Without
    one the walk takes place all the same, and one line says what is missing.
    """
    if options.draws_robot:
        try:
            prepare_gl()
        except NoGlError as error:
            say(f"warning: {error}; going on without film and strips")
            options = dataclasses.replace(options, video=None, strip=None, gait_strip=None)
    else:
        switch_gl_off()

    from app.commands import navigate

    return navigate.run(options)
