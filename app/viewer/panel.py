"""The controls beside the scene: what can be typed, pressed and read."""

from __future__ import annotations

import html
import math
import re
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import viser
from viser import uplot

from app.navigation.live_navigator import Notice
from app.viewer.downloads import Downloads
from app.viewer.markers import SIDE_RGB
from app.viewer.obstacles import ObstacleEditor
from app.viewer.pointer import Tool
from app.viewer.session import Session
from app.viewer.snapshot import Snapshot
from app.viewer.waypoints import WaypointFields
from planner.options import PLANNERS
from planner.plan import Pose
from planner.robot_model import Side
from planner.search.search_record import SearchRecord

SPEEDS = {"Pause": 0.0, "Slow": 0.25, "1x": 1.0, "Fastest": math.inf}
# Stands before the name on the button that is pressed: viser's buttons all look alike.
CHOSEN = "✓ "
_GO_THERE, _PUT_THERE = "Go to the nearest free pose", "Put the robot at the nearest free pose"
_MOVE_THERE = "Move the waypoint to the nearest free pose"
_HINTS = {
    Tool.GOAL: "**Goal**: click the floor where the robot is to go; drag to say where it looks. "
    "With Shift held a click adds a waypoint.",
    Tool.BOX: "**Box**: click the floor to set a box down, click a box to take it away, drag it to "
    "move it.",
    Tool.ROBOT: "**Robot**: click or drag where the robot is to be put. The walk begins anew.",
    Tool.LOOK: "**Look**: drag to turn the view, right button to shift it, wheel to come nearer.",
}
_TOOL_KEYS: dict[Tool, Any] = {Tool.GOAL: "G", Tool.BOX: "B", Tool.ROBOT: "R", Tool.LOOK: "L"}
_SPEED_KEYS: dict[str, Any] = {"Pause": "P", "Slow": "2", "1x": "1", "Fastest": "F"}
# Five lines; a longer text is scrolled.
_BOX = (
    '<div style="height: 7.5em; line-height: 1.5; overflow-y: auto; padding: 0 0.5em;'
    ' font-size: 0.875em">{}</div>'
)
# As planners name a pose: metres, and the heading in radians.
_FREE_POSE = re.compile(r"(the nearest free pose is [^,\s]+,[^,\s]+),(-?[\d.e-]+)")
_PLOT_HEIGHT_PX = 170
# The latest steps are what one wants to see.
_STEPS_SHOWN = 60
# Can be read on white and on black.
_GREY = "#8a8f98"


class Panel:
    """Controls of all pages that watch: what one does, the others see.

    `goal` and `start` are the poses that can be typed, `notice` is what went wrong, in words,
    `waypoints` their list, `downloads` the files about the walk, `robot` the choice of a robot.
    `switch_order` is where a page's own switches stand: between walk and goal; `map_order` where it
    lets choose a map: before the plots; `theme_order` where it chooses light or dark: after them.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        session: Session,
        obstacle_editor: ObstacleEditor,
        *,
        robots: tuple[str, ...],
        set_robot: Callable[[str], None],
        use_tool: Callable[[Tool], None],
        toggle_follow: Callable[[int | None], None],
        say: Callable[[str], None],
    ) -> None:
        self._gui, self._session, self._use_tool = gui, session, use_tool
        self._heard: Notice | None = None
        self._text = ""
        self._status = gui.add_markdown("")
        # One takes the place of the other, and the button waits: nothing moves under a pointer.
        self._details = gui.add_html("")
        self.notice = gui.add_html("", visible=False)
        self._take_offer = gui.add_button(_GO_THERE, color="orange", disabled=True)
        self._take_offer.on_click(lambda _event: self.take_offer())
        self._tools = gui.add_button_group("Pointer", marked(Tool, Tool.GOAL))
        self._tools.on_click(lambda event: self.use_tool(Tool(unmarked(event.target.value))))
        self._hint = gui.add_markdown(_HINTS[Tool.GOAL])
        self._speeds = gui.add_button_group("Speed", marked(SPEEDS, "1x"))
        self._speeds.on_click(lambda event: self.set_speed(unmarked(event.target.value)))
        walk = {"Stop": session.stop, "Reset": session.reset}
        buttons = gui.add_button_group("Walk", list(walk))
        buttons.on_click(lambda event: walk[event.target.value]())
        edits = {"Undo": session.undo, "Redo": session.redo}
        buttons = gui.add_button_group(
            "Edits", list(edits), hint="Of goal, start and boxes: taken back, and made again."
        )
        buttons.on_click(lambda event: edits[event.target.value]())
        with gui.add_folder("Goal") as folder:
            self.goal = PoseFields(gui, "", "Go", session.go_to)
        self.switch_order = folder.order - 0.5
        with gui.add_folder("Waypoints", expand_by_default=False):
            self.waypoints = WaypointFields(gui, set_waypoints=session.set_waypoints, say=say)
        with gui.add_folder("Start", expand_by_default=False):
            self.start = PoseFields(gui, "start ", "Put the robot there", session.reset)
        with gui.add_folder("Boxes", expand_by_default=False):
            self._box_x, self._box_y = (
                gui.add_slider(f"size in {axis}, m", 0.1, 2.0, 0.05, 0.4) for axis in "xy"
            )
            clear = gui.add_button("Remove all boxes")
            clear.on_click(lambda _event: obstacle_editor.clear())
        with gui.add_folder("Robot and planner", expand_by_default=False):
            chosen = session.setup.robot.option
            # Any: viser's types say that the value of a choice cannot be set.
            self.robot: Any = gui.add_dropdown("Robot", robots, initial_value=chosen)
            self.robot.on_update(lambda _event: set_robot(self.robot.value))
            self._add_planner_options()
        with gui.add_folder("Save", expand_by_default=False):
            self.downloads = Downloads(gui, session)
        with gui.add_folder("Plots") as folder:
            self._gait = gui.add_markdown("", visible=False)
            self.plots = Plots(gui)
        self.map_order = folder.order - 0.5
        self.theme_order = folder.order + 0.5
        self._keys: dict[str, str] = {}
        for tool, key in _TOOL_KEYS.items():
            self._add_key(f"Pointer: {tool}", key, partial(self.use_tool, tool))
        for name, key in _SPEED_KEYS.items():
            self._add_key(f"Speed: {name}", key, partial(self.set_speed, name))
        follow = self._add_command("Camera follows, or does not", "C")
        follow.on_trigger(lambda event: toggle_follow(event.client_id))
        self._add_key("Stop", "X", session.stop)
        self._add_key("Reset", "0", session.reset)
        self._add_key("Remove the last box", "backspace", obstacle_editor.remove_last)
        self._add_key("Undo", "Z", session.undo, "cmd/ctrl")
        self._add_key("Redo", "Z", session.redo, "cmd/ctrl+shift")
        with gui.add_folder("Keys", expand_by_default=False):
            gui.add_markdown("\n".join(f"- **{key}** {does}" for key, does in self._keys.items()))

    @property
    def box_size_m(self) -> tuple[float, float]:
        """Extents in x and y of the next box."""
        return self._box_x.value, self._box_y.value

    def show(self, snapshot: Snapshot, unheard: Notice | None) -> None:
        """Brings what is read up to date; `unheard` is a notice of the page itself."""
        text = status_text(snapshot)
        if text != self._text:
            self._text = text
            self._status.content, _, details = text.partition("  \n")
            self._details.content = _BOX.format("<br>".join(details.split("  \n")))
        notice = unheard or snapshot.notice
        is_news, self._heard = notice != self._heard, notice
        self.start.show(snapshot.start)
        self.goal.show(snapshot.requested or snapshot.goal)
        self.waypoints.show(snapshot.waypoints)
        if notice is not None and is_news:
            if notice.puts_robot and notice.refused is not None:
                self.start.correct(notice.refused)
            elif notice.goal is not None:
                self.goal.correct(notice.goal)
        self.plots.show_search(None if snapshot.answer is None else snapshot.answer.record)
        if snapshot.gait != self._gait.content:
            self._gait.content, self._gait.visible = snapshot.gait, bool(snapshot.gait)
        if is_news:
            self._show_notice(notice)

    def _show_notice(self, notice: Notice | None) -> None:
        text = "" if notice is None else f"⚠️ {html.escape(in_degrees(notice.text), quote=False)}"
        self.notice.content = _BOX.format(text)
        self.notice.visible, self._details.visible = notice is not None, notice is None
        self._take_offer.disabled = notice is None or notice.alternative is None
        if notice is not None and notice.alternative is not None:
            offer = _PUT_THERE if notice.puts_robot else _GO_THERE
            self._take_offer.label = offer if notice.waypoint is None else _MOVE_THERE

    def take_offer(self) -> None:
        """Takes the pose that would do instead of a refused one: as goal, start or waypoint."""
        notice = self._heard
        if notice is None or notice.alternative is None:
            return
        if notice.waypoint is not None and notice.goal is not None:
            self._session.move_waypoint(notice.waypoint, notice.alternative, notice.goal)
        elif notice.puts_robot:
            self._session.reset(notice.alternative)
        else:
            self._session.go_to(notice.alternative)

    def use_tool(self, tool: Tool) -> None:
        """Chooses what the pointer does."""
        self._hint.content = _HINTS[tool]
        self._tools.options = marked(Tool, tool)
        self._use_tool(tool)

    def set_speed(self, name: str) -> None:
        """Chooses one of SPEEDS."""
        self._speeds.options = marked(SPEEDS, name)
        self._session.clock.factor = SPEEDS[name]

    def _add_planner_options(self) -> None:
        options = self._session.setup.options
        planner = self._gui.add_dropdown("Planner", PLANNERS, initial_value=options.name)
        epsilon = self._gui.add_slider(
            "epsilon",
            1.0,
            10.0,
            0.5,
            min(10.0, options.epsilon),
            hint="The heuristic's weight in the first search: large is quick, 1 is best at once.",
        )

        shows_search = self._gui.add_checkbox(
            "Show the search",
            initial_value=options.record,
            hint="Expanded cells on the floor and cost over time among the plots, from the next "
            "goal on. Planner ara has them; planning takes a little longer.",
        )

        def changed(_event: Any) -> None:
            self._session.set_options(
                replace(
                    options,
                    name=planner.value,
                    epsilon=epsilon.value,
                    record=shows_search.value,
                )
            )

        for control in (planner, epsilon, shows_search):
            control.on_update(changed)

    def _add_key(
        self, label: str, key: Any, action: Callable[[], None], modifier: Any = None
    ) -> None:
        self._add_command(label, key, modifier).on_trigger(lambda _event: action())

    def _add_command(self, label: str, key: Any, modifier: Any = None) -> Any:
        held = "" if modifier is None else f"{modifier.replace('cmd/ctrl', 'Ctrl')}+"
        self._keys[f"{held}{key}"] = label
        return self._gui.add_command(label, hotkey=key, modifier=modifier)


class PoseFields:
    """A pose as three numbers that can be typed, the heading in degrees, and a button for it."""

    def __init__(
        self, gui: viser.GuiApi, prefix: str, button: str, act: Callable[[Pose], None]
    ) -> None:
        # Any: viser's types say that the value of a number cannot be set.
        self._x: Any = gui.add_number(f"{prefix}x, m", 0.0, step=0.05)
        self._y: Any = gui.add_number(f"{prefix}y, m", 0.0, step=0.05)
        self._degrees: Any = gui.add_number(f"{prefix}heading, °", 0.0, step=5.0)
        self._shown: Pose | None = None
        gui.add_button(button).on_click(lambda _event: act(self.pose))

    @property
    def pose(self) -> Pose:
        """As it stands there."""
        yaw_rad = math.radians(self._degrees.value)
        return float(self._x.value), float(self._y.value), yaw_rad

    def show(self, pose: Pose | None) -> None:
        """Puts a pose there; if it is that of the last time, what was typed stays."""
        if pose is None or pose == self._shown:
            return
        self._shown = pose
        self.correct(pose)

    def correct(self, pose: Pose) -> None:
        """Puts a pose there that was refused, to be corrected; it stays until another one holds."""
        self._x.value, self._y.value = pose[0], pose[1]
        self._degrees.value = round(math.degrees(pose[2]), 1)


class Plots:
    """How far each foot came down from its step, what the feet carry, and how the search went."""

    def __init__(self, gui: viser.GuiApi) -> None:
        self._latest_s = 0.0
        points = uplot.Series(width=1, points={"show": True})
        self._errors = _add_plot(gui, "Foot from its step, cm", "step", points)
        self._forces = _add_plot(gui, "Ground force, N", "s", uplot.Series(width=2))
        self._search = _add_plot(
            gui, "Cost over time, m", "ms", uplot.Series(width=2), names=("plan", "lower bound")
        )
        self._search.visible = False
        self._record: SearchRecord | None = None

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

    def show_search(self, record: SearchRecord | None) -> None:
        """Cost of the best plan and lower bound from the first plan on; nothing where none is."""
        if record is self._record:
            return
        self._record = record
        found = np.zeros(0, bool) if record is None else np.isfinite(record.cost_m)
        self._search.visible = bool(found.any())
        if record is not None and found.any():
            bound_m = np.maximum.accumulate(record.lower_bound_m)
            self._search.data = (1e3 * record.time_s[found], record.cost_m[found], bound_m[found])

    def show_forces(self, forces: np.ndarray) -> None:
        """Time in s, left and right force in N: (3, T); nothing is sent where time stands still."""
        if forces[0, -1] == self._latest_s:
            return
        self._latest_s = float(forces[0, -1])
        self._forces.data = (forces[0], forces[1], forces[2])


def _add_plot(
    gui: viser.GuiApi,
    title: str,
    across: str,
    line: uplot.Series,
    names: tuple[str, str] = ("left", "right"),
) -> viser.GuiUplotHandle:
    """A plot with two such lines, of the feet unless named; the title ends with the unit."""
    unit = title.rpartition(" ")[2]
    axis = uplot.Axis(stroke=_GREY, grid={"stroke": _GREY + "40"}, ticks={"stroke": _GREY})
    lines: list[uplot.Series] = [
        {
            **line,
            "label": f"{names[side]} {unit}",
            "stroke": "#{:02x}{:02x}{:02x}".format(*SIDE_RGB[side]),
        }
        for side in Side
    ]
    return gui.add_uplot(
        (np.zeros(1),) * 3,
        (uplot.Series(label=across), *lines),
        title=title,
        scales={"x": {"time": False}},
        axes=(axis, axis),
        height=_PLOT_HEIGHT_PX,
    )


def marked(names: Iterable[str], chosen: str) -> tuple[str, ...]:
    """The names as they stand on buttons, the chosen one marked."""
    return tuple(f"{CHOSEN}{name}" if name == chosen else str(name) for name in names)


def unmarked(name: str) -> str:
    """The name that a button stands for."""
    return name.removeprefix(CHOSEN)


def in_degrees(text: str) -> str:
    """A planner's reason in the unit of the page."""
    return _FREE_POSE.sub(
        lambda found: f"{found[1]},{math.degrees(float(found[2])):.0f}°", text, count=1
    )


def status_text(snapshot: Snapshot) -> str:
    """What there is to say of the walk, as Markdown.

    Always as many lines: the buttons below must not jump when somebody is about to press one.
    """
    plan, answer_s, error_m = snapshot.plan, snapshot.answer_s, snapshot.foot_error_m
    steps, second, error, near = "no steps yet", "plan –", "foot error –", "nearest obstacle –"
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
        near = f"nearest obstacle {100 * snapshot.clearance_m:.0f} cm"
    walked = f"{snapshot.time_s:.0f} s walked, speed {snapshot.speed:.1f}x"
    state = snapshot.loading or snapshot.status
    title = f"### {state[:1].upper()}{state[1:]}"
    return "  \n".join((title, steps, second, error, near, walked))
