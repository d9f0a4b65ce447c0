"""How often walks arrive: `python -m benchmarks.walks maps --count N --seed S`.

Draws N pairs of free poses on each map of a folder, or on the maps named, and walks between them as
`trials` does. A seed that nobody has looked at gives pairs that nobody has looked at. Prints for
each map, and for all, how many walks arrived of those between whose ends the robot can pass, with
the interval that holds the true share with 95 % (Wilson's), how the others ended, how far feet
landed from their steps, and the least distance from a wall; then the worst walks, each with the
line that repeats it. Exits with 1 if a wall was touched or a robot fell.
"""

from __future__ import annotations

import functools
import math
import sys
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from app.commands.trials import TrialsOptions, draw_trials, walk_one
from app.navigation.report import Outcome, Percentiles
from app.options import find_robot_with_limits, read_grid
from app.output import InputError, ProgressBar
from app.workers import compile_planner, in_order
from maps.map_files import YAML_SUFFIXES

Z = 1.959964  # of the normal distribution, for 95 %


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """How often walks arrive.

    maps: map files, or folders whose YAML files are maps. count: pairs on each. seed: of them.
    apart: least distance in m between their ends. worst: so many walks are told of.
    """

    maps: Annotated[tuple[Path, ...], tyro.conf.Positional] = (Path("maps"),)
    count: int = 100
    seed: int = 0
    robot: str = "jvrc1"
    apart: float = 1.5
    workers: int = 0
    worst: int = 5


def wilson(successes: int, tries: int) -> tuple[float, float]:
    """Interval that holds the share of successes with 95 %.

    Wilson, Probable Inference, the Law of Succession, and Statistical Inference, 1927.
    """
    if not tries:
        return 0.0, 1.0
    share, square = successes / tries, Z * Z / tries
    middle = (share + square / 2) / (1 + square)
    half = Z / (1 + square) * math.sqrt(share * (1 - share) / tries + square / 4 / tries)
    return max(0.0, middle - half), min(1.0, middle + half)


def map_files(places: Iterable[Path]) -> list[Path]:
    """The map files among these, and in the folders among these."""
    files: list[Path] = []
    for place in places:
        found = (
            sorted(f for f in place.iterdir() if f.suffix in YAML_SUFFIXES)
            if place.is_dir()
            else []
        )
        files += found or [place]
    return files


def walked(options: TrialsOptions) -> list[dict[str, Any]]:
    """The walks of all pairs on a map, each as trials.json tells of it.

    Raises:
        InputError: The map cannot be read, or no such pairs can be drawn on it.
    """
    grid = read_grid(options)
    model = find_robot_with_limits(options.robot).step_model
    trials = draw_trials(grid, options)
    compile_planner(model, options.planner_options())
    results: list[dict[str, Any]] = []
    with ProgressBar(f"walks on {options.map}", len(trials)) as bar:
        walk = functools.partial(walk_one, grid, options)
        for result in in_order(walk, trials, options.workers):
            results.append({**result, "map": str(options.map), "seed": trials[len(results)].seed})
            bar.update(len(results))
    return results


def line(name: str, results: Sequence[Mapping[str, Any]]) -> str:
    """What there is to say of the walks of a map."""
    joined = [result for result in results if result["joined"]]
    ended = Counter(result["outcome"] for result in joined)
    reached = ended.pop(str(Outcome.REACHED), 0)
    low, high = wilson(reached, len(joined))
    others = ", ".join(f"{count} {outcome}" for outcome, count in ended.most_common()) or "none"
    errors_m = np.concatenate([result["foot_errors_m"] for result in results] or [[]])
    feet = Percentiles.of(errors_m)
    clear_m = min(
        (r["min_clearance_m"] for r in results if r["min_clearance_m"] is not None), default=None
    )
    told = [
        f"{name:<24} {reached:>4} of {len(joined):<4} {100 * low:5.1f} to {100 * high:5.1f} %",
        f"others: {others}",
        f"{len(results) - len(joined)} pairs not joined",
    ]
    if feet is not None:
        told.append(
            f"feet {100 * feet.median:.1f} / {100 * feet.p95:.1f} / {100 * feet.max:.1f} cm"
        )
    if clear_m is not None:
        told.append(f"nearest obstacle {100 * clear_m:.1f} cm")
    return "; ".join(told)


def badness(result: Mapping[str, Any]) -> tuple[bool, float]:
    """Grows with how badly a walk went: first those that did not arrive, then by the worst foot."""
    arrived = result["outcome"] == Outcome.REACHED or not result["joined"]
    return not arrived, max(result["foot_errors_m"], default=0.0)


def repeated(result: Mapping[str, Any], robot: str) -> str:
    """A walk, and the line that repeats it."""
    start, goal = (",".join(f"{v:g}" for v in result[end]) for end in ("start", "goal"))
    worst_cm = 100 * max(result["foot_errors_m"], default=0.0)
    reason = f": {result['reason']}" if result["reason"] else ""
    return (
        f"{result['outcome']}{reason}; worst foot {worst_cm:.1f} cm, {result['replans']} replans\n"
        f"    python main.py navigate --map {result['map']} --robot {robot} --start {start} "
        f"--goal {goal} --seed {result['seed']}"
    )


def main(arguments: Arguments) -> int:
    """Walks on every map and prints how it went; 1 if a wall was touched or a robot fell."""
    everything: list[dict[str, Any]] = []
    for file in map_files(arguments.maps):
        options = TrialsOptions(
            map=file,
            count=arguments.count,
            seed=arguments.seed,
            robot=arguments.robot,
            apart=arguments.apart,
            workers=arguments.workers,
        )
        try:
            results = walked(options)
        except InputError as error:
            print(f"{file.stem:<24} not walked: {error}", flush=True)
            continue
        everything += results
        print(line(file.stem, results), flush=True)
    print(line("all", everything))
    for result in sorted(everything, key=badness, reverse=True)[: arguments.worst]:
        print(repeated(result, arguments.robot))
    bad = {str(Outcome.FELL), str(Outcome.COLLIDED)}
    return int(any(result["outcome"] in bad for result in everything))


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Arguments, description=__doc__)))
