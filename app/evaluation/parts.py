"""The parts of an evaluation: each is measured on its own and kept as a file of its own.

A cut-off run keeps the parts that are done, and a later run with the same controller, seed and
episodes takes them up.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco

from app.output import make_folder, to_json, write_text
from controller.lipm.servos import report_of
from controller.policy import Policy
from controller.walker import Controller
from maps.files import read_json
from sim.engines import MUJOCO, Engine
from sim.robot import Robot

FORMAT = "evaluation-part/3"
Results = dict[str, dict[str, Any]]
Document = Mapping[str, Any]  # evaluation.json, or a part of it


@dataclass(frozen=True, kw_only=True)
class EvaluationSetup:
    """Who is measured, and how much. The results do not depend on `threads`."""

    robot: Robot
    controller: Controller
    episodes: int
    seed: int
    threads: int = os.cpu_count() or 1
    engine: Engine = MUJOCO

    @property
    def who(self) -> dict[str, Any]:
        """What tells the controller, and the engine it is measured in, from all others."""
        engine = {} if self.engine.about is None else {"engine": self.engine.about}
        if isinstance(self.controller, Policy):
            return {"policy_sha256": self.controller.about["sha256"], **engine}
        return {"policy_sha256": None, "controller": report_of(self.robot), **engine}

    @property
    def trained(self) -> Any:
        """What a policy says of its training."""
        return self.controller.about.get("trained") if isinstance(self.controller, Policy) else None

    def share(self, divisor: int) -> int:
        """A part of the episodes, at least one."""
        return max(1, self.episodes // divisor)

    def draws(self, count: int) -> dict[str, Any]:
        """Arguments of the rollouts of so many robots."""
        return {
            "count": count,
            "seed": self.seed,
            "threads": self.threads,
            "engine": self.engine,
        }


@dataclass(frozen=True, kw_only=True)
class Part:
    """One measurement; its name is that of its section, or begins with it and `-`.

    `measure` is told the results so far, by part name, and uses those of the parts that it `needs`.
    `robot_seconds` is how much walking is simulated: the measure of progress.
    """

    name: str
    robot_seconds: float
    measure: Callable[[Results], dict[str, Any]]
    needs: tuple[str, ...] = ()

    @property
    def section(self) -> str:
        """The section it is of."""
        return self.name.partition("-")[0]


class ResultCache:
    """The results in a folder, one file a part."""

    def __init__(self, folder: Path, setup: EvaluationSetup):
        self._folder = folder / "parts"
        # What a result depends on, besides the code.
        settings = {
            "robot": setup.robot.name,
            **setup.who,
            "episodes": setup.episodes,
            "seed": setup.seed,
            "mujoco": mujoco.__version__,
        }
        self._head = {"format": FORMAT, "settings": settings}

    def read(self, part: Part) -> dict[str, Any] | None:
        """A part's result; None where there is none of the same settings."""
        try:
            document = read_json(self._path(part))
        except (OSError, ValueError):
            return None
        if not isinstance(document, dict) or not isinstance(document.get("result"), dict):
            return None
        is_ours = document | self._head == document
        return document["result"] if is_ours else None

    def write(self, part: Part, result: Mapping[str, Any]) -> None:
        """Keep a part's result, whole or not at all."""
        make_folder(self._folder, option="--out")
        write_text(self._path(part), to_json({**self._head, "result": dict(result)}))

    def _path(self, part: Part) -> Path:
        return self._folder / f"{part.name}.json"


def finite(value: Any) -> Any:
    """The same with None in place of every number that is not finite: JSON has no word for it."""
    if isinstance(value, Mapping):
        return {key: finite(part) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(part) for part in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


# Numbers of the paper that reports set beside ours, each with where it stands in it.
# Singh, Benallegue, Morisawa, Cisneros, Kanehiro: Learning Bipedal Walking On Planned Footsteps For
# Humanoid Robots, IEEE-RAS Humanoids 2022 (arXiv 2207.12644). Numbers that the paper has but that
# nobody could look up here are left out, not guessed. Its limits on the joints of HRP-5P are in
# `sim/robots/hrp5p.py`.

TITLE = "Singh et al. 2022"

# Evaluation on stairs of 10 cm: the figures on terrain noise and on observation noise.
TREAD_NOISE_WITHSTOOD_M = 0.03
JOINT_NOISE_WITHSTOOD_DEG = 3.0

# The text on the step reward: a step counts as hit when either foot is this near.
HIT_RADIUS_M = 0.20

# Its measured peaks of HRP-5P, walking: torque in N m, speed in rad/s, left / right leg.
PAPER_PEAKS: Mapping[str, tuple[tuple[float, float], tuple[float, float]]] = {
    "hip yaw": ((17.1, 24.1), (0.37, 1.18)),
    "hip roll": ((55.0, 60.6), (0.39, 0.72)),
    "hip pitch": ((84.4, 97.9), (1.57, 1.50)),
    "knee": ((76.3, 39.8), (2.00, 1.51)),
    "ankle pitch": ((23.9, 9.45), (1.25, 1.14)),
    "ankle roll": ((11.3, 10.2), (0.57, 0.62)),
}
