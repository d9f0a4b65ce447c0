"""The command `export`: a policy as one ONNX file, checked before it gets its name."""

from __future__ import annotations

from dataclasses import dataclass

from app.options import FileOption, RobotOptions, find_robot
from app.output import ExitCode, as_bad_input, replacing, require_writable, say, to_json
from controller.policy import PolicyError, load_policy


@dataclass(frozen=True, kw_only=True)
class ExportOptions(RobotOptions):
    """Write a policy as one ONNX file, with its normaliser and all that its user must know inside.

    The observation goes in as it is measured, joint offsets in rad come out. Before the file gets
    its name it is run on random observations and compared with the policy that it was made from.
    docs/files.md says what is in it.
    """

    out: FileOption
    """The file, such as policy.onnx."""

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

    robot = find_robot(options.robot)
    require_writable(options.out, option="--out", endings=(".onnx",))
    with as_bad_input(PolicyError, ExportError):
        require_onnx()
        policy = load_policy(robot, options.policy)
        content = to_onnx(policy, robot).SerializeToString()
        with replacing(options.out) as temporary:
            temporary.write_bytes(content)
            difference = greatest_difference(temporary, policy)
    say(
        f"{options.out}: the policy of {robot.name}, {len(content) / 1e6:.2f} MB, at most "
        f"{difference:.1e} rad from the original in {CHECKED_OBSERVATIONS} random observations"
    )
    if options.json:
        document = {
            "file": str(options.out),
            "bytes": len(content),
            "greatest_difference_rad": difference,
            "checked_observations": CHECKED_OBSERVATIONS,
            "metadata": metadata(policy, robot),
        }
        print(to_json(document), end="")
    return ExitCode.DONE
