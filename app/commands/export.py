"""The command `export`: a policy as one ONNX file, checked before it gets its name."""

from __future__ import annotations

from dataclasses import dataclass

from app.controllers import find_policy
from app.options import FileOption, OptionalFile, RobotOptions, SwitchedOn, find_robot
from app.output import (
    ExitCode,
    as_bad_input,
    replacing,
    require_writable,
    say,
    to_json,
    write_text,
)


@dataclass(frozen=True, kw_only=True)
class ExportOptions(RobotOptions):
    """Write a policy as one ONNX file, with its normaliser and all that its user must know inside.

    The observation goes in as it is measured, joint offsets in rad come out. Before the file gets
    its name it is run on random observations and compared with the policy that it was made from.
    docs/files.md says what is in it.
    """

    out: FileOption
    """The file, such as policy.onnx."""

    clip: SwitchedOn = True
    """Leave the scaled observation as it is, and do not clip it as training does."""

    mjcf: OptionalFile = None
    """Also write the robot as a MuJoCo model without servos, such as robot.xml."""

    json: bool = False
    """Print what is in the file, and how exact it is, on standard output as JSON."""


def run(options: ExportOptions) -> int:
    """Carries the command out; returns the exit code."""
    from controller.onnx_export import (
        CHECKED_OBSERVATIONS,
        ExportError,
        greatest_difference,
        metadata,
        require_onnx,
        to_onnx,
    )
    from sim.scene import robot_mjcf

    robot = find_robot(options.robot)
    with as_bad_input(ExportError):
        require_onnx()
    require_writable(options.out, option="--out", endings=(".onnx",))
    require_writable(options.mjcf, option="--mjcf", endings=(".xml",))
    policy = find_policy(robot, options.policy)
    with as_bad_input(ExportError):
        content = to_onnx(policy, robot, clip=options.clip).SerializeToString()
        with replacing(options.out) as temporary:
            temporary.write_bytes(content)
            difference = greatest_difference(temporary, policy, clip=options.clip)
    say(
        f"{options.out}: the policy of {robot.name}, {len(content) / 1e6:.2f} MB, at most "
        f"{difference:.1e} rad from the original in {CHECKED_OBSERVATIONS} random observations"
    )
    if options.mjcf is not None:
        write_text(options.mjcf, robot_mjcf(robot))
        say(f"{options.mjcf}: {robot.name} on a bare floor, in MuJoCo's format")
    if options.json:
        document = {
            "file": str(options.out),
            "mjcf": None if options.mjcf is None else str(options.mjcf),
            "bytes": len(content),
            "greatest_difference_rad": difference,
            "checked_observations": CHECKED_OBSERVATIONS,
            "metadata": metadata(policy, robot, clip=options.clip),
        }
        print(to_json(document), end="")
    return ExitCode.DONE
