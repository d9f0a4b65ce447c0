"""Plans on request: a question in JSON is answered with plan.json, wherever the robot walks."""

from __future__ import annotations

import contextlib
import json
import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from app.navigation.planner_process import Asked, PlannerProcess, World
from maps.files import from_json
from planner.plan import Pose, feet_at, finite_pose
from planner.robot_model import Side

FORMAT = "plan-request/1"
_KEYS = ("format", "id", "goal", "start", "start_feet")
# Who asks faster than plans are made is told so.
_MOST_WAITING = 16


@dataclass(frozen=True, kw_only=True)
class PlanRequest:
    """A question: from feet (2, 4), or from where the robot stands for None, to a pair pose."""

    id: str
    goal: Pose
    start_feet_world: np.ndarray | None = None


class RequestError(ValueError):
    """A question that is none: what is wrong, and the `id` of the question where it is known."""

    def __init__(self, message: str, id: str | None = None) -> None:
        super().__init__(message)
        self.id = id


def read_request(words: str, stance_width_m: float) -> PlanRequest:
    """The question in a JSON text; `docs/ros.md` has its keys.

    Raises:
        RequestError: It is none; the message names the key and what would be right.
    """
    try:
        document = from_json(words)
    except ValueError as error:
        raise RequestError(f"not JSON: {error}") from None
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise RequestError(f"must be an object with the format {FORMAT!r}")
    name = document.get("id", "")
    if not isinstance(name, str):
        raise RequestError(f"id {name!r:.40} must be a text")
    for key in document:
        if key not in _KEYS:
            raise RequestError(f"key {key!r:.40} is unknown; there are {', '.join(_KEYS)}", name)
    if "goal" not in document:
        raise RequestError("key 'goal' is missing", name)
    if "start" in document and "start_feet" in document:
        raise RequestError("give start or start_feet, not both", name)
    feet = None
    if "start" in document:
        feet = feet_at(_numbers(document, "start", 3, name), stance_width_m)
    elif "start_feet" in document:
        both = document["start_feet"]
        if not isinstance(both, dict) or set(both) != {"left", "right"}:
            raise RequestError("start_feet must hold left and right", name)
        feet = np.array([_numbers(both, side.name.lower(), 4, name) for side in Side])
    goal = finite_pose(_numbers(document, "goal", 3, name))
    return PlanRequest(id=name, goal=goal, start_feet_world=feet)


def _numbers(document: dict[str, Any], key: str, count: int, name: str) -> list[float]:
    value = document[key]
    if isinstance(value, list) and len(value) == count and all(map(_is_finite, value)):
        return [float(one) for one in value]
    raise RequestError(f"{key} {value!r:.60} must be {count} finite numbers", name)


def _is_finite(value: object) -> bool:
    with contextlib.suppress(OverflowError):  # of whole numbers with hundreds of digits
        return type(value) in (int, float) and math.isfinite(value)  # type: ignore[arg-type]
    return False


def refusal(error: RequestError) -> str:
    """The answer to a question that is none."""
    return json.dumps({"format": FORMAT, "id": error.id, "error": str(error)})


class PlanRequests:
    """Answers questions one after the other, in their order; used from one thread.

    The planner is in a process of its own, which begins with the first question: that of the robot
    answers the newest question alone.
    """

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self._world: World | None = None
        self._planner: PlannerProcess | None = None
        self._waiting: deque[tuple[str, Asked]] = deque()
        self._asked: str | None = None

    def set_world(self, world: World) -> None:
        """Plans from now on over this map."""
        self._world = world
        if self._planner is not None:
            self._planner.set_world(world)

    def ask(self, request: PlanRequest, feet_world: np.ndarray, first_side: Side | None) -> None:
        """Takes a question; feet (2, 4) and the side to step first are the robot's.

        Raises:
            RequestError: There is no map yet, or there are too many questions.
        """
        if self._world is None:
            raise RequestError("there is no map yet", request.id)
        if len(self._waiting) >= _MOST_WAITING:
            raise RequestError(f"{_MOST_WAITING} questions are waiting: ask later", request.id)
        feet, given = feet_world, request.start_feet_world
        if given is not None:
            feet, first_side = given, None
        asked = Asked(goal=request.goal, start_feet_world=feet, first_side=first_side)
        self._waiting.append((request.id, asked))

    def answers(self) -> Iterator[str]:
        """The plans made since: plan.json with the question's `id`; never waits."""
        for answer in self._planner.answers() if self._planner and self._asked is not None else ():
            plan = replace(answer.plan, robot=self._robot, map="map")
            yield json.dumps({"id": self._asked, **json.loads(plan.to_json())})
            self._asked = None
        if self._asked is None and self._waiting:
            assert self._world is not None
            self._planner = self._planner or PlannerProcess(self._world)
            self._asked, asked = self._waiting.popleft()
            self._planner.ask(once=True, **asked)

    def close(self) -> None:
        """Ends the planner."""
        if self._planner is not None:
            self._planner.close()
