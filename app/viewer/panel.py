"""The controls beside the scene: what can be typed, pressed and read."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import viser
from viser import uplot

from app.viewer.markers import SIDE_RGB
from app.viewer.pointer import Tool
from app.viewer.snapshot import Notice, Snapshot
from planner.options import PLANNERS, PlannerOptions
from planner.plan import Pose
from planner.robot_model import Side

# Plots of the walk: how far each foot came down from its step, and what the feet carry.

_HEIGHT_PX = 170
# The latest steps are what one wants to see.
_STEPS_SHOWN = 60
_GREY = "#8a8f98"


class Plots:
    """Two plots in the container that is open when it is made."""

    def __init__(self, gui: viser.GuiApi) -> None:
        nothing = np.zeros(1)
        self._latest_s = 0.0
        left, right = (_css(SIDE_RGB[side]) for side in Side)
        self._errors = gui.add_uplot(
            (nothing, nothing, nothing),
            (
                uplot.Series(label="step"),
                uplot.Series(label="left cm", stroke=left, width=1, points={"show": True}),
                uplot.Series(label="right cm", stroke=right, width=1, points={"show": True}),
            ),
            title="Foot from its step, cm",
            scales={"x": {"time": False}},
            axes=_axes(),
            height=_HEIGHT_PX,
        )
        self._forces = gui.add_uplot(
            (nothing, nothing, nothing),
            (
                uplot.Series(label="s"),
                uplot.Series(label="left N", stroke=left, width=2),
                uplot.Series(label="right N", stroke=right, width=2),
            ),
            title="Ground force, N",
            scales={"x": {"time": False}},
            axes=_axes(),
            height=_HEIGHT_PX,
        )

    def show_errors(self, side: np.ndarray, error_m: np.ndarray) -> None:
        """Errors (N,) of the steps of each side, in the order of the walk."""
        if len(side) == 0:
            side, error_m = np.array([Side.LEFT]), np.zeros(1)
        number = np.arange(1, len(side) + 1)
        shown = slice(-_STEPS_SHOWN, None)
        # A foot's line stays where it is while the other one steps.
        latest = [np.maximum.accumulate(np.where(side == foot, number, 0)) for foot in Side]
        left, right = (100 * np.append(0.0, error_m)[steps][shown] for steps in latest)
        self._errors.data = (number[shown].astype(float), left, right)

    def show_forces(self, forces: np.ndarray) -> None:
        """Time in s, left and right force in N: (3, T); nothing is sent where time stands still."""
        if forces[0, -1] == self._latest_s:
            return
        self._latest_s = float(forces[0, -1])
        self._forces.data = (forces[0], forces[1], forces[2])


def _axes() -> tuple[uplot.Axis, uplot.Axis]:
    """A grey that can be read on white and on black."""
    axis = uplot.Axis(stroke=_GREY, grid={"stroke": _GREY + "40"}, ticks={"stroke": _GREY})
    return axis, axis


def _css(rgb: tuple[int, int, int]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*rgb)


SPEEDS = {"Pause": 0.0, "Slow": 0.25, "1x": 1.0, "Fastest": math.inf}
# Stands before the name on the button that is pressed: viser's buttons all look alike.
CHOSEN = "✓ "
_GO_THERE, _PUT_THERE = "Go to the nearest free pose", "Put the robot at the nearest free pose"
_HINTS = {
    Tool.GOAL: "**Goal**: click the floor where the robot is to go; drag to say where it looks.",
    Tool.BOX: "**Box**: click the floor to set a box down, click a box to take it away, drag it to "
    "move it.",
    Tool.ROBOT: "**Robot**: click or drag where the robot is to be put. The walk begins anew.",
    Tool.LOOK: "**Look**: drag to turn the view, right button to shift it, wheel to come nearer.",
}


@dataclass(frozen=True, kw_only=True)
class Actions:
    """What the panel's controls do."""

    go: Callable[[Pose], None]
    put: Callable[[Pose], None]
    stop: Callable[[], None]
    reset: Callable[[], None]
    use_tool: Callable[[Tool], None]
    set_speed: Callable[[float], None]
    toggle_follow: Callable[[int], None]
    set_options: Callable[[PlannerOptions], None]
    set_robot: Callable[[str], None]
    clear_boxes: Callable[[], None]
    remove_box: Callable[[], None]


class Panel:
    """Controls of all pages that watch: what one does, the others see."""

    def __init__(
        self,
        gui: viser.GuiApi,
        actions: Actions,
        *,
        robots: tuple[str, ...],
        robot: str,
        options: PlannerOptions,
    ) -> None:
        self._gui, self._actions, self._options = gui, actions, options
        self._heard: Notice | None = None
        self._text = ""
        self._status = gui.add_markdown("")
        self._notice = gui.add_markdown("", visible=False)
        self._take_offer = gui.add_button(_GO_THERE, color="orange", visible=False)
        self._take_offer.on_click(lambda _event: self._accept())
        self._add_tools()
        self._add_walk()
        with gui.add_folder("Goal") as goal:
            self._goal = self._add_pose("", "Go", actions.go)
        self._switch_order = goal.order - 0.5
        with gui.add_folder("Start", expand_by_default=False):
            self._start = self._add_pose("start ", "Put the robot there", actions.put)
        with gui.add_folder("Boxes", expand_by_default=False):
            self._add_boxes()
        with gui.add_folder("Robot and planner", expand_by_default=False):
            self._add_choices(robots, robot)
        with gui.add_folder("Plots"):
            self.plots = Plots(gui)
        self._add_keys()

    @property
    def switch_order(self) -> float:
        """Where a page's own switches stand among the controls: between walk and goal."""
        return self._switch_order

    @property
    def box_size_m(self) -> tuple[float, float]:
        """Extents in x and y of the next box."""
        return self._box_x.value, self._box_y.value

    def show(self, snapshot: Snapshot, unheard: Notice | None) -> None:
        """Brings what is read up to date; `unheard` is a notice of the page itself."""
        text = status_text(snapshot)
        if text != self._text:
            self._text = self._status.content = text
        notice = unheard or snapshot.notice
        is_news = notice != self._heard
        self._show_poses(snapshot, notice if is_news else None)
        if is_news:
            self._show_notice(notice)

    def _show_poses(self, snapshot: Snapshot, news: Notice | None) -> None:
        """Start and goal as they hold, also where something was typed that has just been refused.

        As long as there is no goal at all the refused one stays, to be corrected.
        """
        refused = None if news is None else news.refused
        is_start = news is not None and news.puts_robot
        self._start.show(snapshot.start, anew=refused is not None and is_start)
        goal = snapshot.requested or snapshot.goal or (None if is_start else refused)
        self._goal.show(goal, anew=refused is not None and not is_start)

    def _show_notice(self, notice: Notice | None) -> None:
        self._heard = notice
        self._notice.content = "" if notice is None else f"⚠️ {notice.text}"
        self._notice.visible = notice is not None
        self._take_offer.visible = notice is not None and notice.alternative is not None
        if notice is not None and notice.alternative is not None:
            self._take_offer.label = _PUT_THERE if notice.puts_robot else _GO_THERE

    def _accept(self) -> None:
        notice = self._heard
        if notice is None or notice.alternative is None:
            return
        if notice.puts_robot:
            self._actions.put(notice.alternative)
        else:
            self._actions.go(notice.alternative)

    def _add_tools(self) -> None:
        self._tools = self._gui.add_button_group("Pointer", marked(Tool, Tool.GOAL))
        self._tools.on_click(lambda event: self.use_tool(Tool(unmarked(event.target.value))))
        self._hint = self._gui.add_markdown(_HINTS[Tool.GOAL])

    def use_tool(self, tool: Tool) -> None:
        """Chooses what the pointer does."""
        self._hint.content = _HINTS[tool]
        self._tools.options = marked(Tool, tool)
        self._actions.use_tool(tool)

    def set_speed(self, name: str) -> None:
        """Chooses one of SPEEDS."""
        self._speeds.options = marked(SPEEDS, name)
        self._actions.set_speed(SPEEDS[name])

    def _add_walk(self) -> None:
        self._speeds = self._gui.add_button_group("Speed", marked(SPEEDS, "1x"))
        self._speeds.on_click(lambda event: self.set_speed(unmarked(event.target.value)))
        walk = self._gui.add_button_group("Walk", ["Stop", "Reset"])
        walk.on_click(
            lambda event: (
                self._actions.stop() if event.target.value == "Stop" else self._actions.reset()
            )
        )

    def _add_pose(self, prefix: str, word: str, act: Callable[[Pose], None]) -> _PoseFields:
        fields = _PoseFields(self._gui, prefix)
        self._gui.add_button(word).on_click(lambda _event: act(fields.pose))
        return fields

    def _add_boxes(self) -> None:
        self._box_x = self._gui.add_slider("size in x, m", 0.1, 2.0, 0.05, 0.4)
        self._box_y = self._gui.add_slider("size in y, m", 0.1, 2.0, 0.05, 0.4)
        clear = self._gui.add_button("Remove all boxes")
        clear.on_click(lambda _event: self._actions.clear_boxes())

    def _add_choices(self, robots: tuple[str, ...], robot: str) -> None:
        chosen = self._gui.add_dropdown("Robot", robots, initial_value=robot)
        chosen.on_update(lambda _event: self._actions.set_robot(chosen.value))
        planner = self._gui.add_dropdown("Planner", PLANNERS, initial_value=self._options.name)
        epsilon = self._gui.add_slider(
            "epsilon",
            1.0,
            10.0,
            0.5,
            min(10.0, self._options.epsilon),
            hint="The heuristic's weight in the first search: large is quick, 1 is best at once.",
        )

        def changed(_event: Any) -> None:
            self._options = replace(self._options, name=planner.value, epsilon=epsilon.value)
            self._actions.set_options(self._options)

        planner.on_update(changed)
        epsilon.on_update(changed)

    def _add_keys(self) -> None:
        for tool, key in ((Tool.GOAL, "G"), (Tool.BOX, "B"), (Tool.ROBOT, "R"), (Tool.LOOK, "L")):
            self._add_key(f"Pointer: {tool}", key, partial(self.use_tool, tool))
        for name, key in (("Pause", "P"), ("Slow", "2"), ("1x", "1"), ("Fastest", "F")):
            self._add_key(f"Speed: {name}", key, partial(self.set_speed, name))
        follow = self._gui.add_command("Camera follows, or does not", hotkey="C")
        follow.on_trigger(lambda event: self._toggle_follow(event.client_id))
        self._add_key("Stop", "X", self._actions.stop)
        self._add_key("Reset", "0", self._actions.reset)
        self._add_key("Remove the last box", "backspace", self._actions.remove_box)

    def _toggle_follow(self, client_id: int | None) -> None:
        if client_id is not None:
            self._actions.toggle_follow(client_id)

    def _add_key(self, label: str, key: Any, action: Callable[[], None]) -> None:
        command = self._gui.add_command(label, hotkey=key)
        command.on_trigger(lambda _event: action())


class _PoseFields:
    """A pose as three numbers that can be typed, the heading in degrees."""

    def __init__(self, gui: viser.GuiApi, prefix: str) -> None:
        # Any: viser's types say that the value of a number cannot be set.
        self._x: Any = gui.add_number(f"{prefix}x, m", 0.0, step=0.05)
        self._y: Any = gui.add_number(f"{prefix}y, m", 0.0, step=0.05)
        self._degrees: Any = gui.add_number(f"{prefix}heading, °", 0.0, step=5.0)
        self._shown: Pose | None = None

    @property
    def pose(self) -> Pose:
        """As it stands there."""
        yaw_rad = math.radians(self._degrees.value)
        return float(self._x.value), float(self._y.value), yaw_rad

    def show(self, pose: Pose | None, *, anew: bool = False) -> None:
        """Puts a pose there; if it is that of the last time, what was typed stays unless `anew`."""
        if pose is None or (pose == self._shown and not anew):
            return
        self._shown = pose
        self._x.value, self._y.value = pose[0], pose[1]
        self._degrees.value = round(math.degrees(pose[2]), 1)


def marked(names: Iterable[str], chosen: str) -> tuple[str, ...]:
    """The names as they stand on buttons, the chosen one marked."""
    return tuple(f"{CHOSEN}{name}" if name == chosen else str(name) for name in names)


def unmarked(name: str) -> str:
    """The name that a button stands for."""
    return name.removeprefix(CHOSEN)


def status_text(snapshot: Snapshot) -> str:
    """What there is to say of the walk, as Markdown.

    Always as many lines: the buttons below must not jump when somebody is about to press one.
    """
    plan, answer_s, error_m = snapshot.plan, snapshot.answer_s, snapshot.foot_error_m
    steps, second, error, near = "no steps yet", "plan –", "foot error –", "nearest wall –"
    if plan is not None:
        steps = f"step {snapshot.done} of {len(plan)}, {snapshot.replans} replans"
    if snapshot.goal_error is not None and snapshot.status == "reached":
        away_m, away_rad = snapshot.goal_error
        second = f"from the goal {100 * away_m:.1f} cm, {math.degrees(away_rad):.1f}°"
    elif answer_s is not None:
        second = f"plan after {1000 * answer_s:.0f} ms"
    if len(error_m):
        error = f"foot error {100 * error_m[-1]:.1f} cm, at most {100 * error_m.max():.1f} cm"
    if snapshot.clearance_m is not None:
        near = f"nearest wall {100 * snapshot.clearance_m:.0f} cm"
    walked = f"{snapshot.time_s:.0f} s walked, speed {snapshot.speed:.1f}x"
    title = f"### {snapshot.status[:1].upper()}{snapshot.status[1:]}"
    return "  \n".join((title, steps, second, error, near, walked))
