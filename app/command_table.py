"""The commands there are. A new command is one entry here and the module that it names."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any


@dataclass(frozen=True, kw_only=True)
class Command:
    """One command, by name only: nothing is imported until the command is asked for.

    Attributes:
        summary: One line for the list of commands.
        options: `module:Dataclass`; its fields are the options, its docstring heads the help.
        run: `module:function`, called with the options; it returns the exit code.
        example: A command line that works, without `python main.py`.
        draws: Whether it may draw the robot. It then settles the GL library itself, before it
            imports MuJoCo (`prepare_gl` in sim/gl.py); for others rendering is off.
    """

    summary: str
    options: str
    run: str
    example: str
    draws: bool = False

    def load_options(self) -> type[Any]:
        """The dataclass of the options."""
        return _load(self.options)

    def load_run(self) -> Callable[[Any], int]:
        """The function that carries the command out."""
        return _load(self.run)


def _load(place: str) -> Any:
    module, _, name = place.partition(":")
    return getattr(importlib.import_module(module), name)


COMMANDS: Mapping[str, Command] = MappingProxyType(
    {
        "dataset": Command(
            summary="plan footsteps to many random goals: a corpus to train on",
            options="app.commands.dataset_options:DatasetOptions",
            run="app.commands.dataset:run",
            example="dataset --count 1000 --out runs/corpus",
        ),
        "dataset check": Command(
            summary="check every step of a corpus by independent geometry",
            options="app.commands.dataset_options:DatasetCheckOptions",
            run="app.commands.dataset_check:run",
            example="dataset check runs/corpus",
        ),
        "evaluate": Command(
            summary="measure how well a policy walks, as one report with figures",
            options="app.commands.evaluate_options:EvaluateOptions",
            run="app.commands.evaluate:run",
            example="evaluate --robot jvrc1 --out runs/evaluate",
        ),
        "export": Command(
            summary="write a policy as one ONNX file for other programs",
            options="app.commands.export:ExportOptions",
            run="app.commands.export:run",
            example="export --robot jvrc1 --out policy.onnx",
        ),
        "navigate": Command(
            summary="plan, walk the plan in MuJoCo with the trained policy, report",
            options="app.commands.navigate_options:NavigateOptions",
            run="app.commands.navigate_options:run",
            example="navigate --map maps/room.png --goal 2,1,1.57",
            draws=True,
        ),
        "plan": Command(
            summary="plan footsteps from a start to a goal on a map",
            options="app.commands.plan:PlanOptions",
            run="app.commands.plan:run",
            example="plan --map maps/room.png --goal 2,1,1.57 --image plan.png",
        ),
        "serve": Command(
            summary="open a web page: click a goal and watch the robot walk there",
            options="app.commands.serve_options:ServeOptions",
            run="app.commands.serve:run",
            example="serve --map maps/room.png",
        ),
        "train": Command(
            summary="train the policy that walks",
            options="app.commands.train_options:TrainOptions",
            run="app.commands.train:run",
            example="train --robot jvrc1 --out runs/train",
        ),
        "trials": Command(
            summary="walk many random pairs of start and goal on a map",
            options="app.commands.trials_options:TrialsOptions",
            run="app.commands.trials:run",
            example="trials --map maps/room.png --count 100",
        ),
    }
)
