"""Waypoints on the page: a list that can be typed, and arrows on the floor."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import viser

from app.navigation.live_navigator import Notice
from app.navigation.route import Waypoint
from app.options import parse_pose
from app.output import InputError
from app.viewer.markers import Marker, is_above
from app.viewer.scene import Rgb
from planner.plan import finite_pose

WAYPOINT_RGB: Rgb = (46, 125, 90)
STAND = "stand"


def waypoints_of(text: str) -> tuple[Waypoint, ...]:
    """The waypoints of a list with one on each line: x, y and heading in degrees, and "stand".

    Raises:
        InputError: A line is none.
    """
    found = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.replace("°", "").split(",")
        if not line.strip():
            continue
        stands = words[-1].strip() == STAND
        try:
            pose = parse_pose(",".join(words[: len(words) - stands]) + "deg")
        except ValueError:
            raise InputError(
                f"waypoint in line {number}: {line.strip()!r}; write x, y in metres and the "
                f"heading in degrees, such as 2, 1, 90, and {STAND} after that to stand there"
            ) from None
        found.append(Waypoint(pose=finite_pose(pose), stands=stands))
    return tuple(found)


def text_of(waypoints: Sequence[Waypoint]) -> str:
    """The list of the waypoints."""
    lines = []
    for waypoint in waypoints:
        x_m, y_m, yaw_rad = waypoint.pose
        numbers = round(x_m, 3), round(y_m, 3), round(math.degrees(yaw_rad), 1)
        words = [f"{number + 0.0:g}" for number in numbers] + [STAND] * waypoint.stands
        lines.append(", ".join(words))
    return "\n".join(lines)


class WaypointFields:
    """The list with its buttons. What somebody is typing stays until it is set or cleared."""

    def __init__(
        self,
        gui: viser.GuiApi,
        *,
        set_waypoints: Callable[[Sequence[Waypoint]], None],
        say: Callable[[str], None],
    ) -> None:
        self._set_waypoints, self._say = set_waypoints, say
        gui.add_markdown("With Shift held a click of the tool Goal adds one.")
        self._stands = gui.add_checkbox("Stand at the next one", initial_value=False)
        # Any: viser's types say that the value of a text cannot be set.
        self.text: Any = gui.add_text(
            "x, y, °",
            "",
            multiline=True,
            hint=f"One in each line, such as 2, 1, 90 or 2, 1, 90, {STAND}.",
        )
        self._shown: tuple[Waypoint, ...] = ()
        self._shown_text = ""
        buttons = gui.add_button_group("Waypoints", ("Set", "Clear"))
        buttons.on_click(lambda event: self.set() if event.target.value == "Set" else self.clear())

    @property
    def stands(self) -> bool:
        """Whether the robot is to stand at the next one that is clicked."""
        return bool(self._stands.value)

    def set(self) -> None:
        """Takes what is typed."""
        try:
            waypoints = waypoints_of(self.text.value)
        except InputError as error:
            self._say(str(error))
            return
        self._shown_text = self.text.value
        self._set_waypoints(waypoints)

    def clear(self) -> None:
        """Takes all away."""
        self._shown_text = self.text.value = ""
        self._set_waypoints(())

    def show(self, waypoints: tuple[Waypoint, ...]) -> None:
        """Shows those that are ahead now."""
        if waypoints != self._shown and self.text.value == self._shown_text:
            self._shown = waypoints
            self._shown_text = self.text.value = text_of(waypoints)


class WaypointMarkers:
    """A numbered arrow at each waypoint. `height_m` of a pose is that of what lies there."""

    def __init__(self, scene: viser.SceneApi, height_m: Callable[[Sequence[float]], float]) -> None:
        self._scene, self._height_m = scene, height_m
        self._markers: list[Marker] = []
        self._shown: tuple[tuple[Waypoint, ...], Notice | None] = (), None

    def show(self, waypoints: tuple[Waypoint, ...], notice: Notice | None = None) -> None:
        """Shows those that are ahead now, and which is refused; what is as before is left alone."""
        if (waypoints, notice) == self._shown:
            return
        self._shown = waypoints, notice
        for number in range(len(self._markers), len(waypoints)):
            name, word = f"/waypoint_{number}", str(number + 1)
            marker = Marker(self._scene, name, WAYPOINT_RGB, word=word, height_m=self._height_m)
            self._markers.append(marker)
        for number, marker in enumerate(self._markers):
            is_there = number < len(waypoints)
            marker.show(waypoints[number].pose if is_there else None)
            if is_there:
                waypoint = waypoints[number]
                words = [str(number + 1)] + [STAND] * waypoint.stands
                is_refused = notice is not None and notice.waypoint == waypoint
                marker.say(", ".join(words + ["refused"] * is_refused))
                free = notice.alternative if notice is not None and is_refused else None
                # Clear of the word at the pose that is offered.
                is_upper = free is None or is_above(waypoint.pose, free, self._height_m)
                marker.hang_word(is_below=not is_upper)
