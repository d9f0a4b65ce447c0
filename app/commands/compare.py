"""The command `compare`: a robot's log replayed in the simulator, joint by joint."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from app.options import FolderOption, RobotName, find_robot, text
from app.output import ExitCode, InputError, make_folder, say, to_json, write_text

LogArgument = Annotated[Path, text("LOG", Path), tyro.conf.Positional]


@dataclass(frozen=True, kw_only=True)
class CompareOptions:
    """Compare a robot's log with the simulator: gain, damping, friction, delay, offset by joint.

    LOG is a CSV file or an MCAP recording with joint positions, joint targets and the inertial
    unit, such as examples/deploy and `navigate --record` write: docs/files.md. Each joint is
    replayed alone, under its targets, while all else moves as it was measured: while its foot is in
    the air, or, with --hanging, all the time. docs/deploying.md tells what to make of the result.
    """

    log: LogArgument
    """The log, such as log.csv or walk.mcap."""

    robot: RobotName = "jvrc1"
    """Which robot, such as jvrc1, or the folder of a robot file, such as robots/talos."""

    hanging: bool = False
    """The robot hung in a stand, its pelvis at rest and its feet in the air."""

    out: FolderOption = Path("runs/compare")
    """Folder for compare.json and compare.png, such as runs/compare."""

    json: bool = False
    """Print the result as a document on standard output, and nothing else there."""


def run(options: CompareOptions) -> int:
    """Carries the command out; returns the exit code."""
    robot = find_robot(options.robot)
    if robot.passive:
        raise InputError(
            f"--robot: compare cannot replay {robot.name}: nothing measures its passive joints "
            f"({robot.passive[0].name}, ...)"
        )
    make_folder(options.out, option="--out")

    # Here and not above: they load MuJoCo and matplotlib, for which wrong input need not wait.
    from app.comparison.picture import write_comparison
    from app.comparison.read_log import read_log
    from app.comparison.report import comparison, text_of
    from sim.identification.loads import loads_along
    from sim.identification.servo_fit import fit_servos
    from sim.scene import PHYSICS_TIMESTEP_S, build_scene

    scene = build_scene(robot, timestep_s=PHYSICS_TIMESTEP_S)
    log = read_log(options.log, scene)
    loads = loads_along(log, scene, hanging=options.hanging)
    fit = fit_servos(log, loads, scene, hanging=options.hanging)
    document = comparison(options.log, log, fit, scene, hanging=options.hanging)
    write_text(options.out / "compare.json", to_json(document))
    write_comparison(options.out / "compare.png", document, log, fit)
    print(to_json(document) if options.json else text_of(document) + "\n", end="")
    say(f"{options.out}: compare.json, compare.png")
    return ExitCode.DONE
