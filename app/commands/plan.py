"""The command `plan`: footsteps to a goal as a file, a picture or a summary."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from app.options import (
    GoalOptions,
    OptionalFile,
    OptionalTime,
    PlanningOptions,
    Poses,
    PosesOption,
    choice,
    find_robot_with_limits,
    number,
    read_grid,
)
from app.output import (
    PICTURE_ENDINGS,
    ExitCode,
    InputError,
    as_bad_input,
    refuse_given,
    require_writable,
    say,
    write_picture,
    write_text,
)
from app.workers import compile_planner
from maps.yaml_files import YamlFileError
from planner.options import HEURISTICS, PLANNERS, SAMPLING_PLANNERS, PlannerOptions
from planner.plan import FootstepPlan
from planner.robot_model import StepModel
from planner.step_model_file import StepModelError, load_step_model
from sim.robot_file import is_robot_file, read_step_model

FIGURE_ENDINGS = (".png", ".jpg", ".jpeg")


@dataclass(frozen=True, kw_only=True)
class PlanOptions(PlanningOptions, GoalOptions):
    """Plan footsteps from a start to a goal on a map.

    The exit code is 0 when a plan is found, 2 when the input is wrong, and 3 when there is no
    plan; then the reason says which foot or what stands in the way.
    """

    step_model: OptionalFile = None
    """Plan for the feet, limits and costs in this file and no robot, such as nao.yaml."""

    via: PosesOption = Poses()
    """Poses to be on with both feet on the way, with colons between, such as 1,0,0:2,0,1.57."""

    out: OptionalFile = None
    """Write the plan to this file, such as plan.json."""

    image: OptionalFile = None
    """Draw the plan over the map into this file, such as plan.png."""

    search_image: OptionalFile = None
    """Draw where the search looked and its cost over time into this file, such as search.png."""

    refine_image: OptionalFile = None
    """Draw the plan before and after refinement into this file, such as refinement.png."""

    heuristic: Annotated[str, choice(*HEURISTICS)] = PlannerOptions.heuristic
    """What the search that proves goes by, such as path; docs/planners.md tells them apart."""

    epsilon: Annotated[float, number(at_least=1.0)] = PlannerOptions.epsilon
    """Weight of the first search, such as 3; later ones go down to 1, the optimum."""

    time_limit: OptionalTime = None
    """Seconds after which the best plan so far is taken, such as 0.5."""

    partial: bool = False
    """Where the time runs out without a plan, give the steps that lead nearest to the goal."""

    prove: bool = False
    """Go on until the plan is proven to be the cheapest; else only a while past the first plan."""

    json: bool = False
    """Print plan.json on standard output, and nothing else there."""


def run(options: PlanOptions) -> int:
    """Carries the command out; returns the exit code."""
    # Before the search and not after it.
    require_writable(options.out, option="--out")
    require_writable(options.image, option="--image", endings=PICTURE_ENDINGS)
    require_writable(options.search_image, option="--search-image", endings=FIGURE_ENDINGS)
    require_writable(options.refine_image, option="--refine-image", endings=PICTURE_ENDINGS)
    if options.refine_image is not None and not options.refine:
        raise InputError("--refine-image shows what refinement does: leave out --no-refine")
    if options.planner in SAMPLING_PLANNERS:
        provers = [name for name in PLANNERS if name not in SAMPLING_PLANNERS]
        given = ("search_image", "epsilon", "partial", "prove")
        refuse_given(options, given, f"goes with the planners {', '.join(provers)}")
    search = _search(options)
    name, model = _step_model(options)
    grid = read_grid(options)

    # Here and not above: the compiled search takes a second to load, bad input need not wait.
    from planner.planner import Planner, plan_through

    def planned(planner: Planner) -> FootstepPlan:
        return plan_through(planner, start=options.start, poses=[*options.via, options.goal])

    compile_planner(model, search)
    planner = Planner(grid, model, search)
    plan = dataclasses.replace(planned(planner), robot=name, map=str(options.map))
    text = plan.to_json() + "\n"
    if options.out is not None:
        write_text(options.out, text)
    if options.image or options.search_image or options.refine_image:
        from app.pictures import plan_pictures as pictures

        if options.image is not None:
            write_picture(options.image, pictures.plan_picture(grid, model, plan))
        if options.search_image is not None and planner.record is not None:
            pictures.write_search_picture(
                options.search_image, grid, plan, planner.record, model.cell_m
            )
        if options.refine_image is not None and plan.found:
            unrefined = dataclasses.replace(planner.options, refine=False)
            before = planned(Planner(grid, model, unrefined))
            picture = pictures.refinement_picture(grid, model, before, plan)
            write_picture(options.refine_image, picture)
    if options.json:
        print(text, end="")
    elif plan.expansions or plan.found:
        print(summary(plan))
    if not plan.found:
        say(f"no plan: {plan.status}: {plan.reason}")
    return ExitCode.DONE if plan.found else ExitCode.NO_PLAN


def _step_model(options: PlanOptions) -> tuple[str, StepModel]:
    """Whom to plan for: a robot of the project, or a YAML file in its place."""
    file = options.step_model
    if file is not None:
        refuse_given(
            options, ("robot",), "goes without --step-model: that file says for whom to plan"
        )
    is_yaml = options.robot.endswith((".yaml", ".yml"))
    if file is None and is_yaml and not is_robot_file(options.robot):
        file = Path(options.robot)
    if file is None and is_robot_file(options.robot):
        with as_bad_input(YamlFileError):
            planned = read_step_model(options.robot)
        if planned is not None:
            _refuse_policy(options)
            return planned
    if file is None:
        robot = find_robot_with_limits(options.robot, options.policy)
        return robot.name, robot.step_model
    _refuse_policy(options)
    with as_bad_input(StepModelError):
        name, model, unknown = load_step_model(file)
    if unknown:
        say(f"warning: {file}: unknown keys are left out: {', '.join(unknown)}")
    return name, model


def _refuse_policy(options: PlanOptions) -> None:
    if options.policy is not None:
        raise InputError("--policy: a step model from a file has none; leave it out")


def _search(options: PlanOptions) -> PlannerOptions:
    """What the planner is told."""
    # A limit that the person sets takes the place of the planner's own.
    improve = options.time_limit is None and not options.prove
    # Each option is right by itself; some do not go together.
    with as_bad_input(ValueError):
        return options.planner_options(
            heuristic=options.heuristic,
            epsilon=options.epsilon,
            improve_expansions=PlannerOptions.improve_expansions if improve else None,
            time_limit_s=options.time_limit,
            partial=options.partial,
            record=options.search_image is not None,
            goal_reach_m=options.goal_tolerance.m,
            goal_reach_rad=options.goal_tolerance.rad,
        )


def summary(plan: FootstepPlan) -> str:
    """What a person wants to know of the plan, in two lines."""
    effort = (
        f"{plan.planner}: {plan.expansions} nodes expanded, first plan after "
        f"{plan.time_to_first_s:.3f} s, {plan.time_s:.3f} s in all"
    )
    if not plan.found:
        return effort
    bound = f"at most {plan.epsilon:.2f} times the least there is on the lattice"
    if plan.epsilon == 1.0:
        bound = "which is the least there is on the lattice"
    elif not math.isfinite(plan.epsilon):
        bound = "which may be far from the least"
    before_m = plan.cost_before_refinement_m
    refined = "" if before_m is None else f" refined from {before_m:.2f} m"
    return f"{len(plan)} steps, cost {plan.cost_m:.2f} m{refined}, {bound}\n{effort}"
