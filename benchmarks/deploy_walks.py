"""Walks of examples/deploy over a socket: `python -m benchmarks.deploy_walks --count N --seed S`.

Draws N pairs of free poses on a map as `trials` does, plans between them, and for each starts
examples/deploy/simulator.py, whose socket delays and loses packets, and examples/deploy/loop.py, in
real time. Prints a line a walk, then how many ended within 0.10 m of the plan's last steps, and the
loop's times. `--priority 10` gives both the priority of real-time processes, which a busy machine
needs. Exits with 1 if a walk failed.
"""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from app.cli import main as command
from app.commands.trials import Trial, TrialsOptions, draw_trials
from app.options import find_robot_with_limits, read_grid
from planner.planner import Planner

DEPLOY = Path(__file__).resolve().parent.parent / "examples" / "deploy"


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Walks of examples/deploy over a socket.

    count: walks; first: the number of the first one, to go on. seed: of the pairs. apart: least
    distance in m between their ends. jitter_ms, loss: of each packet each way. at_once: walks at
    the same time. priority: of both processes, as those of real time, 0 for none.
    """

    map: Path = Path("maps/room.png")
    count: int = 50
    first: int = 0
    seed: int = 0
    robot: str = "jvrc1"
    apart: float = 1.5
    jitter_ms: float = 5.0
    loss: float = 0.01
    at_once: int = 1
    priority: int = 0


def walked(arguments: Arguments, folder: Path, number: int) -> dict[str, Any]:
    """The reports of loop and simulator on one walk, whose plan is in the folder."""
    files = [str(folder / "policy.onnx"), str(folder / "robot.xml"), str(folder / f"{number}.json")]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    network = ["--jitter-ms", str(arguments.jitter_ms), "--loss", str(arguments.loss)]
    network += ["--seed", str(number), "--port", str(port)]
    priority = ["--priority", str(arguments.priority)]
    simulate = [sys.executable, str(DEPLOY / "simulator.py"), *files, *network, *priority]
    with subprocess.Popen(simulate, stdout=subprocess.PIPE, text=True) as simulator:
        assert simulator.stdout is not None
        simulator.stdout.readline()  # it listens
        address = ["--robot", f"127.0.0.1:{port}"]
        loop = subprocess.run(
            [sys.executable, DEPLOY / "loop.py", files[0], files[2], *address, *priority],
            stdout=subprocess.PIPE,
            text=True,
            check=False,
        )
        told, _ = simulator.communicate(timeout=30)
    return {
        "number": number,
        "loop": json.loads(loop.stdout),
        "simulator": json.loads(told),
        "walked": loop.returncode == 0 and simulator.returncode == 0,
    }


def planned(arguments: Arguments, folder: Path) -> list[int]:
    """Writes policy, model and plans into a folder; the numbers of the walks."""
    options = TrialsOptions(
        map=arguments.map,
        robot=arguments.robot,
        count=arguments.first + arguments.count,
        seed=arguments.seed,
        apart=arguments.apart,
        reachable=True,
    )
    robot, grid = find_robot_with_limits(arguments.robot), read_grid(options)
    words = ["--robot", arguments.robot, "--out", str(folder / "policy.onnx")]
    assert command(["export", *words, "--mjcf", str(folder / "robot.xml")]) == 0
    planner = Planner(grid, robot.step_model, options.planner_options())
    numbers = []
    for number, trial in list(enumerate(draw_trials(grid, options)))[arguments.first :]:
        assert isinstance(trial, Trial)
        plan = planner.plan(start=trial.start, goal=trial.goal)
        if plan.found:
            (folder / f"{number}.json").write_text(plan.to_json(), encoding="utf-8")
            numbers.append(number)
    return numbers


def main(arguments: Arguments) -> int:
    """Walks and tells; the exit code."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        numbers = planned(arguments, folder)
        results = []
        with ThreadPoolExecutor(arguments.at_once) as pool:
            for result in pool.map(lambda number: walked(arguments, folder, number), numbers):
                results.append(result)
                print(json.dumps(result), flush=True)
    good = sum(result["walked"] for result in results)
    print(f"{good} of {len(results)} walked to their last steps")
    for key in ("tick_ms", "period_ms", "late_ms", "state_age_ms"):
        worst = {
            part: [result["loop"][key][part] for result in results if key in result["loop"]]
            for part in ("median", "p99", "max")
        }
        told = ", ".join(f"{np.median(of):.2f} {part}" for part, of in worst.items())
        print(f"{key}: {told} (medians over the walks), {np.max(worst['max']):.1f} at most")
    return 0 if good == len(results) else 1


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Arguments)))
