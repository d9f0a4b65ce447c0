"""Who walks, in what world, and what the robot knows of it: options of the commands that walk."""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, Optional, Union

from app.controllers import ControllerOption, load_controlled
from app.engines import EngineOptions, load_engine
from app.options import (
    PaceOption,
    PlanningOptions,
    PushOption,
    Reach,
    ReachOption,
    find_robot,
    number,
    text,
)
from app.output import InputError, refuse_given

if TYPE_CHECKING:
    from app.navigation.navigator import NavigatorConfig
    from app.navigation.sensed import SensingConfig
    from controller.walker import Controller
    from planner.options import PlannerOptions
    from sim.engines import Engine
    from sim.hardware import HardwareErrors
    from sim.robot import Robot


_OF_LOCALIZATION = tuple(f"localization_{name}" for name in ("noise", "delay", "outliers", "jump"))


class Jump(NamedTuple):
    """From when on, and by how much, places are off."""

    at_s: float
    m: float


def parse_jump(word: str) -> Jump:
    """Reads a time and a length such as 5,1; raises ValueError unless neither is negative."""
    with contextlib.suppress(ValueError, TypeError):
        jump = Jump(*map(float, word.split(",")))
        if all(0 <= value < math.inf for value in jump):
            return jump
    raise ValueError(f"{word!r} is not a jump; write S,M in seconds and metres, such as 5,1")


def parse_hardware(word: str) -> HardwareErrors:
    """Reads NAME=VALUE,...; raises ValueError where a name or value cannot be."""
    from sim.hardware import HardwareErrors

    names = [field.name for field in fields(HardwareErrors) if field.name != "payload_m"]
    values: dict[str, Any] = {}
    for part in word.split(","):
        name, _, value = part.partition("=")
        if name not in names:
            raise ValueError(f"{name!r} is not one of {', '.join(names)}")
        try:
            values[name] = float(value)
        except ValueError:
            raise ValueError(f"{part!r} is not NAME=VALUE, such as delay_s=0.015") from None
    return HardwareErrors(**values)


@dataclass(frozen=True, kw_only=True)
class WalkOptions(EngineOptions, PlanningOptions):
    """How steps are planned and walked."""

    controller: ControllerOption = "policy"
    """Who walks: the trained policy, or a controller by a model, such as lipm (docs/lipm.md)."""

    pace: PaceOption = "normal"
    """How quickly to step, such as fast; turns and climbs are taken no faster than normal."""

    push: PushOption = 0.0
    """Push the robot by so many N s every 3 to 5 seconds of the walk, from anywhere, such as 10."""

    sensed: bool = False
    """Let the robot know what its joints, inertial unit and soles measure, and nothing else."""

    localization: Annotated[Optional[float], number(above=0, at_most=40, metavar="HZ")] = None  # noqa: UP045
    """How often a second such a robot is told its place, such as 10; none: it goes by its legs."""

    localization_noise: ReachOption = Reach(0.03, math.radians(2.0))
    """Standard deviations of that place and heading, such as 0.03,2deg."""

    localization_delay: Annotated[float, number(at_least=0, at_most=5)] = 0.1
    """By how many seconds it comes late, such as 0.1."""

    localization_outliers: Annotated[float, number(at_least=0, at_most=0.9)] = 0.0
    """Share of places that are off by a metre, such as 0.05."""

    localization_jump: Annotated[Optional[Jump], text("S,M", parse_jump)] = None  # noqa: UP045
    """From when on, and by how much, all places are off, such as 5,1."""

    # Of a type whose module is not loaded here; None comes first, see app/options.py.
    hardware: Annotated[Union[None, Any], text("NAME=VALUE,...", parse_hardware)] = None  # noqa: RUF036, UP007
    """How robot and ground differ from the model, such as gain=0.85; see docs/hardware.md."""

    def sensing(self) -> SensingConfig | None:
        """What the navigator is told; None: the robot knows its true state.

        Raises:
            InputError: The options do not go together.
        """
        from app.navigation.localization import LocalizationConfig
        from app.navigation.sensed import SensingConfig

        if not self.sensed:
            refuse_given(self, ("localization",), "goes with --sensed")
        if self.localization is None:
            refuse_given(self, _OF_LOCALIZATION, "goes with --localization")
            return SensingConfig() if self.sensed else None
        noise = self.localization_noise
        if min(noise) <= 0:
            raise InputError(f"--localization-noise {noise.m:g},{noise.rad:g}: must be above 0")
        jump = self.localization_jump or Jump(0.0, 0.0)
        localization = LocalizationConfig(
            rate_hz=self.localization,
            noise_m=noise.m,
            noise_rad=noise.rad,
            delay_s=self.localization_delay,
            outliers=self.localization_outliers,
            jump_at_s=jump.at_s,
            jump_m=jump.m,
        )
        return SensingConfig(localization=localization)

    def load(self) -> tuple[Robot, Controller, Engine]:
        """The robot, what moves it, and the engine that simulates it.

        Raises:
            InputError: There is none of that name, or they cannot do what is asked together.
        """
        if self.hardware is not None and self.controller != "policy":
            raise InputError(f"--hardware goes with --controller policy, not {self.controller}")
        if self.hardware is not None and self.engine != "mujoco":
            raise InputError(f"--hardware goes with --engine mujoco, not with {self.engine}")
        robot = find_robot(self.robot)
        if self.sensed and robot.passive:
            raise InputError(
                f"--sensed cannot tell where the feet of {robot.name} are: nothing measures its "
                f"passive joints ({robot.passive[0].name}, ...)"
            )
        self.sensing()
        robot, controller = load_controlled(self, self.controller, self.pace)
        return robot, controller, load_engine(self, robot)

    def navigator_config(self, engine: Engine, planner: PlannerOptions) -> NavigatorConfig:
        """What a navigator is told."""
        from app.navigation.navigator import NavigatorConfig

        return NavigatorConfig(
            planner=planner,
            pace=self.pace,
            push_n_s=self.push,
            sensing=self.sensing(),
            engine=engine,
            hardware=self.hardware,
        )
