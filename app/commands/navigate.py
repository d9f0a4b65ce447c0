"""The command `navigate`: plan, walk in MuJoCo with the trained policy, report."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from app.controllers import load_controlled
from app.navigation.report import NavigationReport, Outcome, PolicyFile
from app.options import (
    FolderOption,
    GoalOptions,
    OptionalFile,
    OptionalFolder,
    Pose,
    Reach,
    Size,
    SizeOption,
    read_grid,
    whole_number,
)
from app.output import (
    PICTURE_ENDINGS,
    InputError,
    ProgressBar,
    make_folder,
    refuse_given,
    require_writable,
    say,
    write_picture,
    write_text,
)
from app.ros.recording import Recorder, recording, require_recordable
from app.walk_options import WalkOptions
from app.workers import compile_planner
from controller.policy import own_policy_path
from maps.grid import OccupancyGrid
from planner.options import PlannerOptions
from planner.plan import FootstepPlan
from sim.engines import Engine
from sim.gl import NoGlError, prepare_gl, switch_gl_off
from sim.robot import Robot

if TYPE_CHECKING:
    from app.navigation.navigator import Navigator
    from controller.walker import Controller


@dataclass(frozen=True, kw_only=True)
class NavigateOptions(WalkOptions, GoalOptions):
    """Plan footsteps to the goal, walk them in MuJoCo with the trained policy, and report.

    The robot plans again when a foot lands too far from its step. The exit code is 0 when the
    robot stands at the goal, 2 when the input is wrong, 3 when there is no plan, and 4 when there
    was a plan and the walk failed.
    """

    out: FolderOption = Path("runs/navigate")
    """Folder for report.json, plan.json and path.png, such as runs/today; made when missing."""

    view: bool = False
    """Show the walk live on a web page, for this machine alone, and report when it is over."""

    html: OptionalFile = None
    """Also write the walk as a web page to watch, such as walk.html; opens from disk."""

    video: OptionalFile = None
    """Also write a film of the walk, such as walk.mp4; needs a GL library."""

    video_size: SizeOption = Size(1280, 720)
    """Width and height of the film in pixels, such as 640x360."""

    fps: Annotated[int, whole_number(at_least=1, at_most=1000, metavar="RATE")] = 30
    """Pictures that the film shows a second, such as 60."""

    strip: OptionalFile = None
    """Also write a picture strip of the whole walk, such as walk.png; needs a GL library."""

    gait_strip: OptionalFile = None
    """Also write a picture strip of one gait cycle, such as gait.png; needs a GL library."""

    record: OptionalFile = None
    """Also write the walk as an MCAP file, which Foxglove opens, such as walk.mcap."""

    bag: OptionalFolder = None
    """Also write the walk as a ROS 2 bag into this new folder, such as runs/bag."""

    json: bool = False
    """Print report.json on standard output, and nothing else there."""

    @property
    def search(self) -> PlannerOptions:
        """What the planner is told."""
        m, rad = self.goal_tolerance
        return self.planner_options(goal_reach_m=m, goal_reach_rad=rad)

    @property
    def draws_robot(self) -> bool:
        """Whether anything is asked for that needs a GL library."""
        return not (self.video is None and self.strip is None and self.gait_strip is None)


def run(options: NavigateOptions) -> int:
    """Carries the command out; returns the exit code.

    MuJoCo reads the choice of GL library when it is imported, so it is made here, before. Without
    one the walk takes place all the same, and one line says what is missing.
    """
    if options.video is None:
        refuse_given(options, ("video_size", "fps"), "goes with --video")
    if options.draws_robot:
        try:
            prepare_gl()
        except NoGlError as error:
            say(f"warning: {error}; going on without film and strips")
            options = dataclasses.replace(options, video=None, strip=None, gait_strip=None)
    else:
        switch_gl_off()
    started = time.perf_counter()
    _require_reachable(options)
    if options.view and (options.sensed or options.hardware is not None):
        raise InputError("--sensed and --hardware are for walks that nobody steers: no --view")
    grid = read_grid(options)
    robot, policy, engine = options.load()
    by_model = options.controller == "lipm"
    # Before the walk and not after it.
    make_folder(options.out, option="--out")
    require_writable(options.html, option="--html", endings=(".html", ".htm"))
    require_writable(options.video, option="--video", endings=(".mp4",))
    require_writable(options.strip, option="--strip", endings=PICTURE_ENDINGS)
    require_writable(options.gait_strip, option="--gait-strip", endings=PICTURE_ENDINGS)
    if options.view and options.engine != "mujoco":
        raise InputError(f"--view shows walks in mujoco: leave out --engine {options.engine}")
    if options.view and (options.record or options.bag):
        raise InputError("--record and --bag write a walk that nobody steers: leave out --view")
    require_recordable(options.record, options.bag)
    compiled_s = compile_planner(robot.step_model, options.search)
    with ExitStack() as stack:
        if options.view:
            navigator = stack.enter_context(viewed(options, grid, robot, policy))
            # Who watches may have sent the robot somewhere else.
            options = dataclasses.replace(options, goal=Pose(*navigator.goal))
            recorder = None
        else:
            navigator, recorder = walked(options, grid, robot, policy, engine, stack)
        plan = dataclasses.replace(
            navigator.plans[0],
            robot=robot.name,
            map=str(options.map),
            start=options.start,
            goal=options.goal,
        )
        report = navigator.report(
            map=plan.map,
            policy=None if by_model else PolicyFile.of(options.policy or own_policy_path(robot)),
            compile_time_s=compiled_s + navigator.compile_time_s,
            wall_time_s=time.perf_counter() - started,
        )
        _write(options, navigator, plan, report)
        if recorder is not None:
            recorder.ended(report.to_json())
        print(report.to_json() if options.json else report.summary() + "\n", end="", flush=True)
        if options.json and report.outcome is not Outcome.REACHED:
            say(f"{report.outcome}: {report.reason}")
        drawn = _draw(options, grid, robot, navigator)
        if not options.json:
            files = ", ".join(["report.json", "plan.json", "path.png", *map(str, drawn)])
            say(f"written to {options.out}: {files}")
    return report.outcome.exit_code


def walked(
    options: NavigateOptions,
    grid: OccupancyGrid,
    robot: Robot,
    policy: Controller,
    engine: Engine,
    stack: ExitStack,
) -> tuple[Navigator, Recorder | None]:
    """A walk from plan to end, showing how many steps are done, and what records it.

    The recording is whole when the stack is left.
    """
    from app.navigation.navigator import Navigator

    navigator = Navigator(
        grid,
        robot,
        policy,
        start=options.start,
        goal=options.goal,
        seed=options.seed,
        config=options.navigator_config(engine, options.search),
    )
    recorder = stack.enter_context(recording(navigator, record=options.record, bag=options.bag))
    plan = navigator.plan()
    with ProgressBar("walking, steps", len(plan)) as bar:
        while navigator.outcome is None:
            navigator.tick()
            if recorder is not None:
                recorder.ticked()
            bar.update(min(len(navigator.placed), len(plan)))
    return navigator, recorder


def _require_reachable(options: NavigateOptions) -> None:
    """A plan may end only where the robot, whose feet land a little off, still is at the goal."""
    from app.navigation.navigator import GOAL_TOLERANCE_M, GOAL_TOLERANCE_RAD

    most = Reach(GOAL_TOLERANCE_M / 2, GOAL_TOLERANCE_RAD / 2)
    asked = options.goal_tolerance
    if asked.m > most.m or asked.rad > most.rad:
        raise InputError(
            f"--goal-tolerance {asked.m:g},{asked.rad:g} is more than {most.m:g},{most.rad:.2g}: "
            f"a goal is reached within {GOAL_TOLERANCE_M:g} m and "
            f"{math.degrees(GOAL_TOLERANCE_RAD):g} degrees"
        )


def _write(
    options: NavigateOptions, navigator: Navigator, plan: FootstepPlan, report: NavigationReport
) -> None:
    from app.pictures.walk_pictures import path_picture

    write_text(options.out / "report.json", report.to_json())
    write_text(options.out / "plan.json", plan.to_json() + "\n")
    write_picture(options.out / "path.png", path_picture(navigator, plan))


def _draw(
    options: NavigateOptions, grid: OccupancyGrid, robot: Robot, navigator: Navigator
) -> list[Path]:
    """Replay, film and picture strips of the walk, where they were asked for; the files."""
    from app.pictures.rendering import FOLLOW
    from app.pictures.walk_pictures import outcome_of, recording_of
    from sim.scene import scene_of

    recording = recording_of(navigator)
    if options.html is not None:
        from app.viewer.replay import Story, write_replay

        story = Story(
            recording=recording,
            plans=tuple(navigator.followed),
            placed=tuple(navigator.placed),
            goal=options.goal,
            title=f"Footfall: {robot.title} on {options.map}",
            outcome=outcome_of(navigator),
        )
        write_replay(options.html, grid, robot, story)
    files = (options.html, options.video, options.strip, options.gait_strip)
    written = [file for file in files if file is not None]
    if not options.draws_robot:
        return written
    from app.pictures.film import write_film, write_strip
    from app.pictures.rendering import footmarks_of

    scene = scene_of(grid, robot, options.unknown_is_free, visuals=True)
    marks = footmarks_of(robot.step_model.foot, navigator.followed, navigator.placed)
    if options.video is not None:
        x_m, y_m, yaw_rad = options.goal
        goal = f"{x_m:g}, {y_m:g}, {math.degrees(yaw_rad):.0f} degrees"
        write_film(
            options.video,
            scene.model,
            recording,
            title=f"{robot.title} on {options.map} to {goal}",
            width=options.video_size.width,
            height=options.video_size.height,
            frames_per_s=options.fps,
            marks=marks,
        )
    if options.strip is not None:
        size = {"columns": 4, "width": 400, "height": 360}
        write_strip(options.strip, scene.model, recording, view=FOLLOW, marks=marks, **size)
    if options.gait_strip is not None:
        middle_s = recording.time_s[-1] / 2
        end_s = middle_s + 2 * robot.gait.step_s
        write_strip(
            options.gait_strip, scene.model, recording, start_s=middle_s, end_s=end_s, marks=marks
        )
    return written


@contextlib.contextmanager
def viewed(
    options: NavigateOptions, grid: OccupancyGrid, robot: Robot, policy: Controller
) -> Iterator[Navigator]:
    """Gives the walk when it is over; on leaving, the page goes on until Ctrl-C."""
    from app.viewer.page import open_page

    with open_page(
        grid,
        robot,
        policy,
        title=f"Footfall: {options.map}",
        map_name=str(options.map),
        start=options.start,
        goal=options.goal,
        options=options.search,
        seed=options.seed,
        load=lambda name: load_controlled(
            dataclasses.replace(options, robot=name, policy=None), options.controller, options.pace
        ),
    ) as page:
        session = page.session
        say(f"open {page.server.url} in a browser to watch; the walk begins when it is open")
        page.wait_for_visitor()
        session.start()
        page.run(is_over=lambda: session.ended is not None)
        assert session.ended is not None
        yield session.ended
        say("the page stays open; Ctrl-C ends it")
        with contextlib.suppress(KeyboardInterrupt):
            page.run()
