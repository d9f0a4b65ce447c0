"""The ROS 1 node seen by a real rosmaster and a client of its own, and its parameters."""

from __future__ import annotations

import importlib.util
import io
import itertools
import json
import math
import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="the extra ros1 is not installed")

from app.ros.ros1_parameters import read_parameters
from planner.options import PlannerOptions
from planner.plan import relative_step
from planner.robot_model import Side, StepModel
from planner.step_model_file import StepModelError, old_step_model
from tests.programs import ROOT, refusal

SYSTEM = Path("/usr/lib/python3/dist-packages")
needs_ros1 = pytest.mark.skipif(
    not all(
        importlib.util.find_spec(name) or (SYSTEM / name).is_dir()
        for name in ("rospy", "rosmaster", "nav_msgs", "sensor_msgs", "visualization_msgs")
    ),
    reason="no ROS 1: apt-get install python3-rospy python3-rosmaster python3-nav-msgs "
    "python3-sensor-msgs python3-visualization-msgs",
)
PATIENCE_S = 600.0
AHEAD_M = 0.02
# Values of no real robot, in the places where the old package had them; two keys it never had.
PARAMETERS: dict[str, Any] = {
    "planner_type": "ARAPlanner",
    "heuristic_type": "EuclStepCostHeuristic",
    "initial_epsilon": 2.0,
    "allocated_time": 5.0,
    "forward_search": True,
    "search_until_first_solution": False,
    "changed_cells_limit": 20000,
    "accuracy": {"collision_check": 2, "cell_size": 0.05, "num_angle_bins": 32},
    "step_cost": 0.1,
    "diff_angle_cost": 0.0,
    "foot": {
        "size": {"x": 0.16, "y": 0.08, "z": 0.02},
        "separation": 0.1,
        "origin_shift": {"x": AHEAD_M, "y": 0.0},
        "sise": 1,
        "max": {
            "step": {"x": 0.1, "y": 0.16, "theta": 0.4},
            "inverse": {"step": {"x": -0.05, "y": 0.09, "theta": -0.1}},
        },
    },
    "footsteps": {
        "x": [0.1, 0.0, -0.05, 0.0, 0.0],
        "y": [0.1, 0.1, 0.1, 0.15, 0.12],
        "theta": [0.0, 0.0, 0.0, 0.0, 0.39],
    },
    "wheels": 4,
}
MODEL = old_step_model(PARAMETERS, Path("test"))


def read(**changes: Any) -> Any:
    document = {key: value for key, value in (PARAMETERS | changes).items() if value is not None}
    return read_parameters(document, Path("/node"), MODEL, PlannerOptions())


def test_parameters_mean_what_they_meant():
    options = read().options
    assert (options.name, options.heuristic, options.epsilon) == ("ara", "steps", 2.0)
    assert (options.time_limit_s, options.improve_expansions) == (5.0, None)
    assert not options.stop_at_first
    assert read(search_until_first_solution=True).options.stop_at_first
    assert read(planner_type="ADPlanner").options.name == "adstar"
    assert read(planner_type="RSTARPlanner", forward_search=False).options.name == "rstar"
    assert read(heuristic_type="EuclideanHeuristic").options.heuristic == "euclidean"
    backward = read(forward_search=False, heuristic_type="PathCostHeuristic").options
    assert (backward.name, backward.heuristic) == ("backward", "full")
    # Where no time is named, plans are improved as far as `plan` improves them.
    options = read(allocated_time=None).options
    assert (options.time_limit_s, options.improve_expansions) == (7.0, 60_000)


def test_unknown_parameters_warn_by_their_full_names():
    (line,) = read().warnings
    assert line == "/node: unknown parameters are left out: foot/sise, wheels"
    foot = PARAMETERS["foot"] | {"origin_shift": {"x": 0.0, "y": 0.01}}
    assert any("foot/origin_shift/y" in line for line in read(foot=foot).warnings)
    other: StepModel = read(foot=None, footsteps=None).model
    assert other is MODEL
    lines = read(foot=None, footsteps=None).warnings
    assert any("step_cost" in line and "no effect" in line for line in lines)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"planner_type": "RRT"}, "planner_type 'RRT' must be one of ARAPlanner, ADPlanner"),
        ({"heuristic_type": 3}, "heuristic_type 3 must be one of EuclideanHeuristic"),
        ({"initial_epsilon": 0.5}, "initial_epsilon 0.5 must be at least 1"),
        ({"initial_epsilon": math.inf}, "initial_epsilon inf must be a finite number"),
        ({"allocated_time": 0}, "allocated_time 0 must be above 0"),
        ({"forward_search": "no"}, "forward_search 'no' must be true or false"),
        ({"footsteps": None}, "key 'footsteps' is missing"),
        ({"foot": 3}, "key 'foot/size/x' is missing"),
    ],
)
def test_what_is_wrong_is_named(changes, told):
    with pytest.raises(StepModelError, match="/node: ") as error:
        read(**changes)
    assert told in str(error.value)


class Process:
    """A program, and the lines that it prints on both streams."""

    def __init__(self, words: list[str], environment: dict[str, str]) -> None:
        self.process = subprocess.Popen(
            [sys.executable, *words],
            cwd=ROOT,
            env={**os.environ, **environment},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.errors: list[str] = []
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        assert self.process.stderr is not None
        self.errors.extend(line.rstrip("\n") for line in self.process.stderr)

    def end(self) -> int:
        self.process.terminate()
        return self.process.wait(timeout=60)


class Client(Process):
    """The client's commands as methods; see `ros1_client.py`."""

    def __init__(self, home: Path) -> None:
        super().__init__(["tests/ros1_client.py"], {"ROS_HOME": str(home)})
        self.port = self._read()

    def _read(self) -> Any:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert line, self.errors
        return json.loads(line)

    def __getattr__(self, name: str) -> Any:
        def command(*words: Any, **named: Any) -> Any:
            assert self.process.stdin is not None
            self.process.stdin.write(json.dumps([name, words, named]) + "\n")
            self.process.stdin.flush()
            return self._read()

        return command

    def until(self, is_so: Any, what: str) -> Any:
        """What `is_so` gives once it is true; fails after a long time."""
        ends_s = time.monotonic() + PATIENCE_S
        while not (found := is_so()):
            assert time.monotonic() < ends_s, f"waited in vain for {what}: {self.log()}"
            time.sleep(0.02)
        return found

    def warned(self, count: int) -> str:
        """The last of so many warnings of the node, of which there must be no more."""

        def lines() -> list[str]:
            # Of the parameters it warns so early that not everybody listens yet.
            return [line for line in self.log() if "unknown parameters" not in line]

        self.until(lambda: len(lines()) >= count, f"warning {count}")
        time.sleep(0.1)
        assert len(lines()) == count, lines()
        return lines()[-1]


def room(*, wall: bool = False, short: int = 0) -> dict[str, Any]:
    """5 x 3 m from -1,-1.5, walled in; with a wall across it at x = 1 that has a gap."""
    cells = np.zeros((60, 100), int)
    cells[[0, -1]] = 100
    cells[:, [0, -1]] = 100
    if wall:
        cells[:40, 40:42] = 100
    fields = {"info.resolution": 0.05, "info.width": 100, "info.height": 60}
    fields |= {"info.origin.position.x": -1.0, "info.origin.position.y": -1.5}
    fields |= {"info.origin.orientation.w": 1.0}
    return {**fields, "data": cells.ravel().tolist()[: 6000 - short]}


def pose_fields(x: float, y: float, yaw: float, within: str = "pose") -> dict[str, Any]:
    return {
        f"{within}.position.x": x,
        f"{within}.position.y": y,
        f"{within}.orientation.z": math.sin(yaw / 2),
        f"{within}.orientation.w": math.cos(yaw / 2),
    }


def check_steps(steps: list[list[float]]) -> None:
    """Legs alternate, and each step of soles is one that the parameters allow."""
    legs = [Side.LEFT if step[3] == 1 else Side.RIGHT for step in steps]
    assert all(a is not b for a, b in itertools.pairwise(legs))
    soles = [
        np.array([x + AHEAD_M * math.cos(yaw), y + AHEAD_M * math.sin(yaw), 0.0, yaw])
        for x, y, yaw, _ in steps
    ]
    taken = zip(soles[1:], soles[2:], legs[2:], strict=False)
    found = [relative_step(support, swing, side) for support, swing, side in taken]
    assert len(found) > 2
    assert all(MODEL.limits.contain(step, 1e-6) for step in found)


@needs_ros1
@pytest.mark.slow
def test_services_and_topics_answer_a_client_of_the_old_node(tmp_path):
    client = Client(tmp_path)
    node = None
    try:
        # However slow the machine is, there shall be a plan.
        client.parameters(PARAMETERS | {"allocated_time": 300.0})
        environment = {
            "ROS_MASTER_URI": f"http://127.0.0.1:{client.port}",
            "ROS_HOME": str(tmp_path),
        }
        node = Process(["main.py", "ros1", "goal:=/move_base_simple/goal"], environment)
        running = node.process
        client.until(
            lambda: running.poll() is not None or client.serves("plan_footsteps_feet"), "the node"
        )
        assert running.poll() is None, node.errors
        _talk(client)
        assert any("left out: foot/sise, wheels" in line for line in node.errors), node.errors
        addresses = listening(node.process.pid)
        assert addresses <= {"127.0.0.1"}
        assert node.process.poll() is None
        assert node.end() == 143
    finally:
        for process in (node, client):
            if process is not None:
                process.process.kill()


def _talk(client: Client) -> None:
    start, goal = [0.0, 0.0, 0.0], [1.5, -0.5, 0.5]
    answer = client.ask("plan_footsteps", start + goal)
    assert (answer["result"], answer["footsteps"]) == (False, [])
    assert "plan_footsteps: there is no map yet" in client.warned(1)
    client.send("map", **room(short=1))
    assert "must have 100 x 60" in client.warned(2)
    client.send("map", **room())

    answer = client.until(
        lambda: (got := client.ask("plan_footsteps", start + goal))["result"] and got, "a plan"
    )
    steps = answer["footsteps"]
    # Absolute poses of the feet's origins, from the feet at the start to those at the goal.
    half_m = 0.05
    first = {1: [0.0, half_m, 0.0], 0: [0.0, -half_m, 0.0]}
    for *pose, leg in steps[:2]:
        assert pose == pytest.approx(first[leg], abs=1e-9)
    aside = np.array([-math.sin(0.5), math.cos(0.5), 0.0]) * half_m
    for *pose, leg in steps[-2:]:
        wanted = np.array(goal) + aside * (1 if leg == 1 else -1)
        assert pose == pytest.approx(wanted.tolist(), abs=1e-9)
    check_steps(steps)
    assert answer["costs"] > 1.58  # the straight way, and something for each step
    assert 1.0 <= answer["final_eps"] <= 2.0
    assert 0.0 < answer["planning_time"] < PATIENCE_S
    assert answer["expanded_states"] > 0

    warnings = 2
    legs = [leg == 1 for *_, leg in steps]
    client.until(lambda: [is_left for *_, is_left in shown(client)] == legs, "the markers")
    client.until(lambda: len(client.latest("path")[1]) == len(steps) - 1, "the path")
    # Each topic has a connection of its own: what was sent first may come last.
    client.until(
        lambda: all(client.latest(name)[1] is not None for name in client_topics()), "all topics"
    )
    seen = {name: client.latest(name)[1] for name in client_topics()}
    markers = shown(client)
    for (_, _, x, y, _), (at_x, at_y, yaw, _) in zip(markers, steps, strict=True):
        sole = at_x + AHEAD_M * math.cos(yaw), at_y + AHEAD_M * math.sin(yaw)
        assert (x, y) == pytest.approx(sole, abs=1e-6)
    way = seen["heuristic_path"]
    assert way[0] == pytest.approx([AHEAD_M, 0.0], abs=0.04)
    end = [goal[0] + AHEAD_M * math.cos(0.5), goal[1] + AHEAD_M * math.sin(0.5)]
    assert way[-1] == pytest.approx(end, abs=1e-4)
    assert len(seen["expanded_states"]) > 10
    assert seen["start"] == ["map", 0.0, 0.0]

    # No plan: the call succeeds, `result` and a line in the log tell; the markers go.
    answer = client.ask("plan_footsteps", [*start, 3.95, 0.0, 0.0])
    assert (answer["result"], answer["footsteps"], answer["final_eps"]) == (False, [], None)
    warnings += 1
    assert "no plan: goal_blocked" in client.warned(warnings)
    client.until(
        lambda: {action for action, *_ in client.latest("footsteps_array")[1]} == {2}, "deletes"
    )
    assert not client.ask("plan_footsteps", [*start, math.nan, 0.0, 0.0])["result"]
    warnings += 1
    assert "plan_footsteps: " in client.warned(warnings)

    # Feet that do not stand side by side, at the start and at the goal.
    feet = [0.05, 0.06, 0.1, 0.0, -0.06, 0.0, 1.56, 0.05, 0.0, 1.5, -0.05, 0.0]
    answer = client.ask("plan_footsteps_feet", feet)
    assert answer["result"], client.log()
    ends = {(*feet[k : k + 3],): leg for k, leg in ((0, 1), (3, 0), (6, 1), (9, 0))}
    found = [*answer["footsteps"][:2], *answer["footsteps"][-2:]]
    assert len(found) == 4
    for x, y, yaw, leg in found:
        near = min(ends, key=lambda end: math.dist(end, (x, y, yaw)))
        assert math.dist(near, (x, y, yaw)) < 1e-9
        assert ends.pop(near) == leg
    check_steps(answer["footsteps"])

    # By topics, as RViz's arrows give them.
    for bad, told in (
        (pose_fields(math.nan, 0, 0), "not finite"),
        (pose_fields(1, 0, 0) | {"pose.orientation.w": 0.5}, "length 0.5"),
        (pose_fields(1, 0, 0) | {"header.frame_id": "odom"}, "frame is 'odom'"),
    ):
        client.send("goal", **bad)
        warnings += 1
        assert told in client.warned(warnings)
    client.send("initialpose", **pose_fields(-0.5, 0.5, -0.3, "pose.pose"))
    client.until(lambda: client.latest("start")[1][1:] == [-0.5, 0.5], "the start")
    before = client.latest("path")[0]
    client.send("goal", **pose_fields(2.5, 0.0, 0.0))
    client.until(lambda: client.latest("path")[0] > before and client.latest("path")[1], "a path")
    straight = client.latest("path")[1]
    assert straight[0] == pytest.approx(
        [-0.5 + AHEAD_M * math.cos(0.3), 0.5 - AHEAD_M * math.sin(0.3)]
    )
    before = client.latest("path")[0]
    client.send("map", **room(wall=True))
    client.until(lambda: client.latest("path")[0] > before, "another path")
    round_it = client.latest("path")[1]
    assert max(y for x, y in round_it if abs(x - 1.0) < 0.2) > 0.5
    assert max(y for x, y in straight if abs(x - 1.0) < 0.2) < 0.5
    client.warned(warnings)


def shown(client: Client) -> list[Any]:
    """The markers that are not deleted."""
    return [marker for marker in client.latest("footsteps_array")[1] if marker[0] == 0]


def client_topics() -> tuple[str, ...]:
    return "footsteps_array", "path", "heuristic_path", "expanded_states", "start"


def listening(pid: int) -> set[str]:
    """Addresses that a process listens at."""
    done = subprocess.run(["ss", "-ltnp"], capture_output=True, text=True, check=False)
    lines = [line for line in done.stdout.splitlines() if f"pid={pid}," in line]
    return {line.split()[3].rpartition(":")[0] for line in lines}


@needs_ros1
def test_generated_messages_have_the_old_sums_and_bytes():
    """By sums and bytes worked out by hand in `ros1_client.py`; the old package's own is known."""
    from app.ros.ros1_messages import humanoid_nav_msgs, require_ros1
    from tests import ros1_client

    require_ros1()
    made = humanoid_nav_msgs()
    assert ros1_client.PLAN_FOOTSTEPS == "6776471c1b6635688929b81b014b1c1c"
    assert made.PlanFootsteps._md5sum == ros1_client.PLAN_FOOTSTEPS
    assert made.PlanFootstepsBetweenFeet._md5sum == ros1_client.PLAN_FOOTSTEPS_FEET
    answer = made.PlanFootsteps._response_class(result=True, costs=1.5, expanded_states=7)
    step = made.StepTarget(leg=made.StepTarget.left)
    step.pose.x, step.pose.theta = 0.25, -1.0
    answer.footsteps = [step]
    stream = io.BytesIO()
    answer.serialize(stream)
    told = ros1_client.services()["plan_footsteps"]._response_class().deserialize(stream.getvalue())
    assert told.told["footsteps"] == [(0.25, 0.0, -1.0, 1)]
    assert (told.told["costs"], told.told["expanded_states"]) == (1.5, 7)


@needs_ros1
def test_a_ros2_message_as_one_of_ros1():
    from app.ros import messages
    from app.ros.ros1_messages import as_ros1, require_ros1

    require_ros1()
    poses = np.array([[1.0, 2.0, 0.0, 0.0], [3.0, 4.0, 0.0, math.pi / 2]])
    way = as_ros1("nav_msgs/Path", messages.path(poses, 5 * 10**9 + 7), "world")
    assert (way.header.frame_id, way.header.stamp.secs, way.header.stamp.nsecs) == ("world", 5, 7)
    assert [p.pose.position.y for p in way.poses] == [2.0, 4.0]
    assert way.poses[1].pose.orientation.z == pytest.approx(math.sqrt(0.5))
    assert messages.pose2d_of(way.poses[1].pose) == pytest.approx((3.0, 4.0, math.pi / 2))


def test_what_cannot_be_is_refused(capsys, tmp_path):
    assert "is no remapping" in refusal(capsys, "ros1", "goal")
    file = tmp_path / "footsteps_a.yaml"
    assert "cannot be read" in refusal(capsys, "ros1", "--step-model", file)
    told = refusal(capsys, "ros1", "--step-model", file, "--robot", "h1")
    assert "--robot goes without --step-model" in told
    assert "--origin is about a map" in refusal(capsys, "ros1", "--origin", "0,0,0")


@needs_ros1
def test_without_a_master_one_line_says_so(capsys, monkeypatch):
    for name in ("ROS_IP", "ROS_HOSTNAME"):
        monkeypatch.setenv(name, "127.0.0.1")
    monkeypatch.setenv("ROS_MASTER_URI", "http://127.0.0.1:9")
    assert "no ROS master at http://127.0.0.1:9" in refusal(capsys, "ros1")
    monkeypatch.setenv("ROS_MASTER_URI", "http://192.0.2.1:11311")
    assert "give --network" in refusal(capsys, "ros1")
