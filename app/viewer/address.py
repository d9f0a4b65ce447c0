"""The page's state in its address: a link opens the same map, robot, start, goal and boxes."""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any
from urllib.parse import parse_qs, quote, unquote

import viser

from app.navigation.route import Waypoint
from app.options import parse_pose
from app.output import InputError
from app.viewer.html_page import LINK_COOKIE
from app.viewer.obstacles import MOST_BOXES, Box
from app.viewer.server import PageServer
from planner.plan import Pose, finite_pose, wrap_angle

# In this order they stand in an address.
WORDS = ("map", "robot", "start", "via", "goal", "boxes")
_STAND = ",stand"
_NO_BOXES = "none"
_LARGEST_BOX_M, _FARTHEST_BOX_M = 1e3, 1e6
_ALIKE_M, _ALIKE_RAD = 0.002, 0.002


@dataclass(frozen=True, kw_only=True)
class Link:
    """What an address asks for; None and empty is what it leaves open.

    boxes: those that stand on the map and no others; None leaves them as they are.
    """

    map: str = ""
    robot: str = ""
    start: Pose | None = None
    via: tuple[Waypoint, ...] = ()
    goal: Pose | None = None
    boxes: tuple[Box, ...] | None = None

    @classmethod
    def read(cls, query: str) -> Link:
        """From the part of an address after the question mark; other words are left alone.

        Raises:
            InputError: A pose is none, or a box.
        """
        said = {word: texts[-1] for word, texts in parse_qs(query).items() if word in WORDS}
        return cls(
            map=said.get("map", ""),
            robot=said.get("robot", ""),
            start=_pose("start", said["start"]) if "start" in said else None,
            via=tuple(
                Waypoint(pose=_pose("via", text.removesuffix(_STAND)), stands=text.endswith(_STAND))
                for text in said.get("via", "").split(";")
                if text
            ),
            goal=_pose("goal", said["goal"]) if "goal" in said else None,
            boxes=_boxes(said["boxes"]) if "boxes" in said else None,
        )

    def __str__(self) -> str:
        """That part of an address, headings in degrees."""
        said = {"map": self.map, "robot": self.robot}
        via = (f"{_text(point.pose)}{_STAND * point.stands}" for point in self.via)
        said |= {"start": _text(self.start), "via": ";".join(via), "goal": _text(self.goal)}
        if self.boxes is not None:
            boxes = (",".join(f"{round(v, 3) + 0.0:.10g}" for v in box) for box in self.boxes)
            said["boxes"] = ";".join(boxes) or _NO_BOXES
        return "&".join(f"{word}={quote(text, safe=',;/')}" for word, text in said.items() if text)

    def leaves(self, ahead: Sequence[Waypoint]) -> bool:
        """Whether these waypoints are the last ones of its own, or it has none."""
        last = self.via[len(self.via) - len(ahead) :]
        return not self.via or (
            len(last) == len(ahead)
            and all(
                mine.stands == other.stands and is_same(mine.pose, other.pose)
                for mine, other in zip(last, ahead, strict=True)
            )
        )

    def script(self) -> str:
        """JavaScript that puts it into the address of the page that runs it, beside other words."""
        return f"""
            const ours = /^({"|".join(WORDS)})=/;
            const kept = location.search.slice(1).split('&').filter(w => w && !ours.test(w));
            const query = [...kept, {json.dumps(str(self))}].join('&');
            history.replaceState(history.state, '', location.pathname + '?' + query);
        """


def _pose(word: str, text: str) -> Pose:
    try:
        return finite_pose(parse_pose(text))
    except ValueError as error:
        raise InputError(f"{word} in the link: {error}") from None


def _boxes(text: str) -> tuple[Box, ...]:
    texts = [] if text == _NO_BOXES else text.split(";")
    if len(texts) > MOST_BOXES:
        raise InputError(f"{len(texts)} boxes in the link: {MOST_BOXES} are as many as can be")
    return tuple(_box(one) for one in texts)


def _box(text: str) -> Box:
    numbers = []
    with contextlib.suppress(ValueError):
        numbers = [float(word) for word in text.split(",")]
    fits = len(numbers) == len(Box._fields) and all(abs(v) <= _FARTHEST_BOX_M for v in numbers)
    if not fits or not all(0 < size_m <= _LARGEST_BOX_M for size_m in numbers[2:]):
        raise InputError(
            f"box in the link: {text!r} is not a box; write X,Y and its size along x and y in "
            "metres, such as 2,1,0.4,0.4"
        )
    return Box(*numbers)


def _text(pose: Pose | None) -> str:
    if pose is None:
        return ""
    x_m, y_m, degrees = (
        round(v, digits) + 0.0
        for v, digits in zip((*pose[:2], math.degrees(pose[2])), (3, 3, 2), strict=True)
    )
    return f"{x_m:.6g},{y_m:.6g},{degrees:.6g}deg"


def is_same(pose: Sequence[float] | None, other: Sequence[float] | None) -> bool:
    """Whether two poses are the same but for what an address leaves out."""
    if pose is None or other is None:
        return pose is other
    near = math.dist(pose[:2], other[:2]) <= _ALIKE_M
    return near and abs(float(wrap_angle(pose[2] - other[2]))) <= _ALIKE_RAD


class Addresses:
    """Keeps the addresses of all pages, and does by `follow` what the links that open them ask."""

    def __init__(
        self, server: PageServer, *, follow: Callable[[Link], None], say: Callable[[str], None]
    ) -> None:
        self._server, self._follow, self._say = server, follow, say
        self._shown: dict[int, Link] = {}
        server.on_client_connect(self._came)
        server.on_client_disconnect(self._left)

    def show(self, link: Link) -> None:
        """Puts the link into all addresses; one in which it stands is left alone."""
        for client_id, client in self._server.get_clients().items():
            if self._shown.get(client_id) != link:
                self._shown[client_id] = link
                self._server.run_script(client, link.script())

    def _came(self, client: viser.ClientHandle) -> None:
        name = self._server.cookie(client.client_id, LINK_COOKIE)
        query, is_others = self._server.links.taken(name)
        try:
            link = Link.read(query)
        except InputError as error:
            self._say(str(error))
            return
        if is_others and link != Link():
            self._ask(client, link)
        else:
            self._follow(link)

    def _left(self, client: viser.ClientHandle) -> None:
        self._shown.pop(client.client_id, None)

    def _ask(self, client: viser.ClientHandle, link: Link) -> None:
        """Asks whoever came from another site whether they want what its link does."""
        with client.gui.add_modal("A link from another site") as modal:
            client.gui.add_markdown(f"It asks for `{unquote(str(link)).replace('`', '')}`.")
            choice = client.gui.add_button_group("", ("Do that", "Leave all as it is"))

        def chosen(event: viser.GuiEvent[Any]) -> None:
            modal.close()
            if event.target.value == "Do that":
                self._follow(link)

        choice.on_click(chosen)
