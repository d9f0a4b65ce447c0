"""The report of a walk: report.json, format "navigation-report/1", and its summary for people."""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.metadata
import math
import platform
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from app.output import ExitCode, to_json
from controller.evaluation.gait_summary import GaitSummary
from maps.files import from_json
from planner.plan import NarrowPlace

FORMAT = "navigation-report/1"
PACKAGES = ("mujoco", "numpy", "numba")
# Left out where a walk is too short to have a gait, or no place too narrow; older reports do not
# have the others.
_OPTIONAL = frozenset(
    ("compile_time_s", "controller", "engine", "gait", "narrow_place", "recovery_steps", "sensed")
)
PoseTuple = tuple[float, float, float]


class Outcome(StrEnum):
    """How a walk ended."""

    REACHED = "reached"
    NO_PATH = "no_path"
    FELL = "fell"
    COLLIDED = "collided"
    TIMED_OUT = "timed_out"

    @property
    def exit_code(self) -> ExitCode:
        """What `navigate` ends with."""
        if self is Outcome.REACHED:
            return ExitCode.DONE
        return ExitCode.NO_PLAN if self is Outcome.NO_PATH else ExitCode.WALK_FAILED


@dataclass(frozen=True, kw_only=True)
class Percentiles:
    """Median, 95th percentile and largest of some values."""

    median: float
    p95: float
    max: float

    @classmethod
    def of(cls, values: ArrayLike) -> Self | None:
        """Those of values (N,); None where there are none."""
        found = np.asarray(values, dtype=float)
        if found.size == 0:
            return None
        median, p95 = np.percentile(found, [50, 95])
        return cls(median=float(median), p95=float(p95), max=float(found.max()))


@dataclass(frozen=True, kw_only=True)
class PolicyFile:
    """Which policy walked."""

    file: str
    sha256: str

    @classmethod
    def of(cls, path: Path) -> Self:
        """The file's name and the SHA-256 of its bytes, in hexadecimal."""
        return cls(file=str(path), sha256=hashlib.sha256(path.read_bytes()).hexdigest())


@dataclass(frozen=True, kw_only=True)
class SensedSummary:
    """How well the robot knew where it was.

    `walked_m` and `turned_rad` are the way of the point midway between the feet and the turns of
    their heading, from step to step. `drift_m` and `drift_rad` are by how much the odometry alone
    was off at the end. `own_foot_error_m` are the distances of feet from their steps as the robot
    saw both, median, 95th percentile and most. `localization_error_m` are those of its place in the
    map at the steps, `fixes`, `rejected` and `jumps` what came of localization.
    """

    walked_m: float
    turned_rad: float
    drift_m: float
    drift_rad: float
    own_foot_error_m: dict[str, float] | None
    localization_error_m: dict[str, float] | None
    fixes: int = 0
    rejected: int = 0
    jumps: int = 0


@dataclass(frozen=True, kw_only=True, repr=False)
class NavigationReport:
    """Everything that report.json says, under the same names and in the same order.

    What was not measured, because the robot never walked, is None. Poses are x_m, y_m, yaw_rad
    in the map frame; `goal_error_rad` is the size of the error in heading. `foot_error_m` are
    distances between the places where feet came to rest and those of their steps.
    `recovery_steps` were moved or hastened against a push. `compile_time_s` is how long plans
    waited for the compiler, which is not part of `planning_time_s`. `controller` tells of one that
    is no policy: its name, rate and servo gains, and how often each stage dropped its constraints.
    `sensed` tells how well a robot that goes by its sensors knew where it was. `engine` is the one
    that simulated, if not MuJoCo: name, version and contact model.
    """

    outcome: Outcome
    reason: str = ""
    goal_error_m: float | None = None
    goal_error_rad: float | None = None
    steps_planned: int = 0
    steps_taken: int = 0
    replans: int = 0
    recovery_steps: int = 0
    foot_error_m: Percentiles | None = None
    min_clearance_m: float | None = None
    planning_time_s: float = 0.0
    compile_time_s: float | None = None
    sim_time_s: float = 0.0
    wall_time_s: float = 0.0
    robot: str
    map: str
    start: PoseTuple
    goal: PoseTuple
    seed: int
    policy: PolicyFile | None = None
    controller: Mapping[str, Any] | None = None
    engine: Mapping[str, Any] | None = None
    gait: GaitSummary | None = None
    narrow_place: NarrowPlace | None = None
    sensed: SensedSummary | None = None
    versions: Mapping[str, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        error = self.foot_error_m
        feet = "" if error is None else f", feet {100 * error.median:.1f} cm off (median)"
        return f"NavigationReport({self.outcome}: {self.steps_taken} steps{feet})"

    def to_json(self) -> str:
        """The text of report.json."""
        values = {key: getattr(self, key) for key in _KEYS}
        values["outcome"] = str(self.outcome)
        for key in ("foot_error_m", "policy", "gait", "narrow_place", "sensed"):
            values[key] = None if values[key] is None else dataclasses.asdict(values[key])
        for key in ("start", "goal"):
            values[key] = [float(part) for part in values[key]]
        values["versions"] = dict(self.versions)
        for key in _OPTIONAL:
            if values[key] is None:
                del values[key]
        return to_json({"format": FORMAT, **values})

    @classmethod
    def from_json(cls, text: str) -> Self:
        """The report that the text of report.json holds.

        Raises:
            ValueError: Not such a report; the message says what is wrong in it.
        """
        try:
            document = from_json(text)
        except ValueError as error:
            raise ValueError(f"not a report: invalid JSON ({error})") from None
        if not isinstance(document, dict) or document.get("format") != FORMAT:
            found = document.get("format") if isinstance(document, dict) else document
            raise ValueError(f"not a report: format is {found!r}, must be {FORMAT!r}")
        values = {key: value for key, value in document.items() if key != "format"}
        _check_keys(values)
        try:
            values["outcome"] = Outcome(values["outcome"])
            for key, kind in (
                ("foot_error_m", Percentiles),
                ("policy", PolicyFile),
                ("gait", GaitSummary),
                ("narrow_place", NarrowPlace),
                ("sensed", SensedSummary),
            ):
                values[key] = None if values.get(key) is None else kind(**values[key])
            for key in ("start", "goal"):
                x_m, y_m, yaw_rad = (float(part) for part in values[key])
                values[key] = (x_m, y_m, yaw_rad)
            return cls(**values)
        except (TypeError, ValueError) as error:
            raise ValueError(f"not a report: {error}") from None

    def summary(self) -> str:
        """What a person wants to know, in a few lines."""
        lines = [f"{self.outcome}" + (f": {self.reason}" if self.reason else "")]
        if self.goal_error_m is not None and self.goal_error_rad is not None:
            degrees = math.degrees(self.goal_error_rad)
            lines.append(f"from the goal: {100 * self.goal_error_m:.1f} cm, {degrees:.1f} degrees")
        recovered = f", {self.recovery_steps} against a push" if self.recovery_steps else ""
        lines.append(
            f"steps: {self.steps_taken} taken{recovered}, {self.steps_planned} planned, "
            f"{self.replans} replans"
        )
        if self.foot_error_m is not None:
            error = self.foot_error_m
            lines.append(
                f"feet from their steps: {100 * error.median:.1f} cm median, "
                f"{100 * error.p95:.1f} cm 95th percentile, {100 * error.max:.1f} cm at most"
            )
        if self.gait is not None:
            lines.append(gait_line(self.gait))
        if self.sensed is not None:
            lines.append(sensed_line(self.sensed))
        if self.min_clearance_m is not None:
            lines.append(f"nearest to an obstacle: {100 * self.min_clearance_m:.0f} cm")
        lines.append(
            f"time: {self.planning_time_s:.2f} s planning, {self.sim_time_s:.1f} s walked, "
            f"{self.wall_time_s:.1f} s on the clock"
        )
        return "\n".join(lines)


def gait_line(gait: GaitSummary) -> str:
    """How it walked, for people."""
    height, apex = gait.pelvis_height_m, gait.swing_apex_m
    landing = gait.touchdown_speed_m_s
    down = "" if landing is None else f", soles down at {landing['median']:.2f} m/s"
    return (
        f"gait: pelvis at {height['median']:.2f} m (least {height['least']:.2f}), bobs "
        f"{100 * gait.pelvis_bob_m:.1f} cm, feet lifted {100 * apex['median']:.1f} cm{down}, "
        f"{gait.peak_force_weights:.2f} weights on a foot, cost of transport "
        f"{gait.cost_of_transport:.2f} at {gait.speed_m_s:.2f} m/s"
    )


def sensed_line(sensed: SensedSummary) -> str:
    """How well the robot knew where it was, for people."""
    line = (
        f"sensed: odometry off by {100 * sensed.drift_m:.1f} cm and "
        f"{math.degrees(sensed.drift_rad):.1f} degrees after {sensed.walked_m:.1f} m and "
        f"{math.degrees(sensed.turned_rad):.0f} degrees of turns"
    )
    if sensed.fixes and sensed.localization_error_m is not None:
        line += f", place known to {100 * sensed.localization_error_m['median']:.1f} cm (median)"
    if sensed.jumps:
        line += f"; localization jumped {sensed.jumps} times: stopped and planned again"
    return line


_KEYS = tuple(field.name for field in dataclasses.fields(NavigationReport))


def _check_keys(values: Mapping[str, Any]) -> None:
    for key in _KEYS:
        if key not in values and key not in _OPTIONAL:
            raise ValueError(f"not a report: key {key!r} is missing")
    for key in values:
        if key not in _KEYS:
            raise ValueError(f"not a report: key {key!r} is unknown")


def installed_versions(packages: Iterable[str] = PACKAGES) -> dict[str, str]:
    """Versions of Python and of the packages, read without importing them."""
    versions = {"python": platform.python_version()}
    versions.update({name: importlib.metadata.version(name) for name in packages})
    return versions
