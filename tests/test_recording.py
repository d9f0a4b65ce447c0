"""Recordings of walks, read back by the readers of mcap and rosbags; messages and URDF."""

from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ET
from collections import defaultdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

pytest.importorskip("mcap", reason="the extra record is not installed")
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from app.cli import main
from app.controllers import load_walker
from app.ros import messages
from app.ros.description import RobotFrames, roll_pitch_yaw
from app.ros.recording import session_recording
from app.viewer.obstacles import Obstacle
from app.viewer.session import Session
from maps.grid import Cell, OccupancyGrid
from planner.robot_model import FootShape, Side
from sim.robots import get_robot
from sim.scene import build_scene
from tests.scenes import HALL, wait_until

ROOT = Path(__file__).resolve().parent.parent
GOAL = (0.4, -0.5, -0.4)
LATCHED = {"/map", "/robot_description", "/tf_static"}
EACH_TICK = {
    *("/tf", "/joint_states", "/joint_targets", "/odom", "/gait_phase"),
    *("/left_foot_force", "/right_foot_force"),
}
CHANGES = {"/footsteps", "/path", "/footsteps_placed", "/plan_events", "/report"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A walk of a few steps, written in every way."""
    folder = tmp_path_factory.mktemp("walk")
    goal = ",".join(map(str, GOAL))
    words = ["--map", "maps/room.png", "--goal", goal, "--out", str(folder)]
    words += ["--record", str(folder / "walk.mcap"), "--bag", str(folder / "bag")]
    assert main(["navigate", *words]) == 0
    return folder


@pytest.fixture(scope="module")
def told(folder):
    """Messages by topic, with their times in ns, decoded by the definitions in the file itself."""
    stores: dict[str, Any] = {}
    found: defaultdict[str, list[tuple[int, Any]]] = defaultdict(list)
    with (folder / "walk.mcap").open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages(log_time_order=False):
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
            if schema.name not in stores:
                stores[schema.name] = get_typestore(Stores.EMPTY)
                stores[schema.name].register(get_types_from_msg(schema.data.decode(), schema.name))
            value = stores[schema.name].deserialize_cdr(message.data, schema.name)
            found[channel.topic].append((message.log_time, value))
    return found


@pytest.fixture(scope="module")
def documents(folder):
    return [json.loads((folder / name).read_text()) for name in ("plan.json", "report.json")]


def test_every_tick_is_there(told, documents):
    assert set(told) == LATCHED | EACH_TICK | CHANGES
    ticks = round(documents[1]["sim_time_s"] / 0.025)
    for topic in EACH_TICK:
        times = [time_ns for time_ns, _ in told[topic]]
        assert times == [25_000_000 * (k + 1) for k in range(ticks)]
    for topic in LATCHED:
        assert [time_ns for time_ns, _ in told[topic]] == [0]


def test_planned_and_placed_footprints_are_those_of_the_documents(told, documents):
    plan, report = documents
    planned = told["/footsteps"][0][1].markers
    assert [marker.id for marker in planned] == list(range(len(plan["steps"])))
    for marker, step in zip(planned, plan["steps"], strict=True):
        at, turn = marker.pose.position, marker.pose.orientation
        assert (at.x, at.y) == pytest.approx((step["x"], step["y"]))
        assert 2 * math.atan2(turn.z, turn.w) == pytest.approx(step["yaw"])
        assert (marker.color.b > marker.color.r) == (step["side"] == "left")
    placed = told["/footsteps_placed"][-1][1].markers
    assert len(placed) == report["steps_taken"]
    ways = [
        math.dist((m.pose.position.x, m.pose.position.y), (s["x"], s["y"]))
        for m, s in zip(placed, plan["steps"], strict=True)
    ]
    assert max(ways) == pytest.approx(report["foot_error_m"]["max"], abs=1e-9)


def test_events_and_report(told, documents):
    plan, report = documents
    events = [json.loads(value.data) for _, value in told["/plan_events"]]
    names = [event["event"] for event in events]
    assert names == ["plan", *["step"] * len(plan["steps"]), "reached"]
    assert max(e["error_m"] for e in events if "error_m" in e) == pytest.approx(
        report["foot_error_m"]["max"], abs=1e-5
    )
    assert json.loads(told["/report"][-1][1].data) == report
    middles = told["/path"][0][1].poses
    assert len(middles) == len(plan["steps"]) + 1
    last = middles[-1].pose.position
    assert (last.x, last.y) == pytest.approx(GOAL[:2])


def test_frames_lead_from_the_map_to_the_soles(told, documents):
    parts = [*told["/tf_static"][0][1].transforms, *told["/tf"][-1][1].transforms]
    parent = {part.child_frame_id: part for part in parts}

    def position(frame):
        at = np.zeros(3)
        while frame != "map":
            part = parent[frame]
            turn = part.transform.rotation
            move = part.transform.translation
            out = np.zeros(3)
            mujoco.mju_rotVecQuat(out, at, np.array([turn.w, turn.x, turn.y, turn.z]))
            at, frame = out + np.array([move.x, move.y, move.z]), part.header.frame_id
        return at

    soles = np.array([position(f"{side}_sole") for side in ("left", "right")])
    placed = {
        marker.color.b > marker.color.r: marker
        for marker in told["/footsteps_placed"][-1][1].markers
    }
    for is_left, sole in zip((True, False), soles, strict=True):
        at = placed[is_left].pose.position
        assert sole[:2] == pytest.approx((at.x, at.y), abs=0.02)
        assert abs(sole[2]) < 0.01
    assert math.dist(soles[:, :2].mean(axis=0), GOAL[:2]) == pytest.approx(
        documents[1]["goal_error_m"], abs=2e-3
    )


def test_the_feet_bear_the_weight_at_rest(told):
    forces = [
        [value.wrench.force.z for _, value in told[f"/{side}_foot_force"][-20:]]
        for side in ("left", "right")
    ]
    assert np.sum(forces, axis=0).mean() == pytest.approx(get_robot("jvrc1").weight_n, rel=0.02)


def test_the_bag_holds_the_same_messages(folder, told):
    store = get_typestore(Stores.ROS2_HUMBLE)
    counts: defaultdict[str, int] = defaultdict(int)
    with Reader(folder / "bag") as bag:
        for connection, time_ns, data in bag.messages():
            assert time_ns in {time for time, _ in told[connection.topic]}
            assert store.deserialize_cdr(data, connection.msgtype) is not None
            counts[connection.topic] += 1
        offered: Any = {c.topic: c.ext for c in bag.connections}
    assert counts == {topic: len(values) for topic, values in told.items()}
    assert offered["/map"].offered_qos_profiles[0].durability.name == "TRANSIENT_LOCAL"
    assert offered["/tf"].offered_qos_profiles[0].durability.name == "VOLATILE"
    assert not list(folder.glob(".bag.*"))


def test_trials_write_one_file_a_walk(tmp_path):
    words = ["--map", "maps/room.png", "--count", "2", "--workers", "1", "--apart", "0.3"]
    words += ["--out", str(tmp_path), "--record", str(tmp_path / "t.mcap")]
    assert main(["trials", *words]) == 0
    results = json.loads((tmp_path / "trials.json").read_text())["trials"]
    for number, result in enumerate(results):
        with (tmp_path / f"t-{number}.mcap").open("rb") as stream:
            reader = make_reader(stream)
            (message,) = [m for _, _, m in reader.iter_messages(topics=["/report"])]
        report = json.loads(messages.decoded("std_msgs/msg/String", message.data).data)
        assert report["goal"] == result["goal"]
        assert report["outcome"] == result["outcome"]


def steered_and_stopped(file):
    """A robot walks a little, gets a box on its map, is put elsewhere, and Ctrl-C is pressed."""
    robot, policy = load_walker("jvrc1")
    with session_recording(file) as recorder:
        assert recorder is not None
        session, told_of = Session(HALL, robot, policy), []

        def on_tick(replanner):
            recorder.ticked(replanner)
            told_of.append(replanner.navigator)

        session.on_tick, session.clock.factor = on_tick, math.inf
        session.start()
        session.go_to((0.3, 0.0, 0.0))
        wait_until(lambda: session.snapshot.status == "reached")
        session.set_obstacles([Obstacle(number=1, x_m=7.0, y_m=5.0, size_x_m=0.2, size_y_m=0.2)])
        session.reset((0.0, -0.3, 0.0))
        wait_until(lambda: told_of[-1] is not told_of[0])
        session.close()
        assert not file.exists()
        raise KeyboardInterrupt


def test_what_a_steered_robot_does_is_written_until_it_is_stopped(tmp_path):
    file = tmp_path / "s.mcap"
    with pytest.raises(KeyboardInterrupt):
        steered_and_stopped(file)
    found: defaultdict[str, list[tuple[int, Any]]] = defaultdict(list)
    with file.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages(log_time_order=False):
            assert schema is not None
            value = messages.decoded(schema.name, message.data)
            found[channel.topic].append((message.log_time, value))
    times = [time_ns for time_ns, _ in found["/tf"]]
    assert times == [25_000_000 * (k + 1) for k in range(len(times))]
    assert len(found["/robot_description"]) == 1
    assert len(found["/map"]) > 1
    assert max(found["/map"][-1][1].data) == 100 > max(found["/map"][0][1].data)
    events = [json.loads(value.data)["event"] for _, value in found["/plan_events"]]
    assert events[0] == "plan"
    assert events.count("step") >= 2
    assert events[-1] == "reached"
    # The robot was put somewhere else: its footprints go.
    assert {marker.action for marker in found["/footsteps_placed"][-1][1].markers} == {2}


def test_a_session_that_fails_leaves_no_recording(tmp_path):
    with pytest.raises(ValueError, match="fault"), session_recording(tmp_path / "s.mcap"):
        raise ValueError("fault")
    assert not list(tmp_path.iterdir())
    with session_recording(None) as recorder:
        assert recorder is None


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--record", "walk.bag"], "--record: walk.bag must end in .mcap"),
        (["--bag", "maps"], "--bag: maps exists already"),
        (["--record", "walk.mcap", "--view"], "leave out --view"),
    ],
)
def test_what_cannot_be_written_is_said_before_the_walk(words, told, capsys, tmp_path):
    walk = ["navigate", "--map", "maps/room.png", "--goal", "1,0,0", "--out", str(tmp_path)]
    assert main([*walk, *words]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ")
    assert told in line


@pytest.mark.parametrize("name", ["jvrc1", "hrp5p"])
def test_the_urdf_moves_as_the_model_does(name):
    """Forward kinematics of the URDF, read as its specification says, against MuJoCo's."""
    scene = build_scene(get_robot(name), timestep_s=0.001)
    rng = np.random.default_rng(3)
    qpos = scene.standing_qpos.copy()
    qpos[scene.joint_qpos] = rng.uniform(-0.4, 0.4, len(scene.joint_qpos))
    data = mujoco.MjData(scene.model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(scene.model, data)
    root: Any = ET.fromstring(RobotFrames(scene).urdf)

    def rotation(axis, angle):
        quat, turn = np.zeros(4), np.zeros(9)
        mujoco.mju_axisAngle2Quat(quat, np.array(axis, float), angle)
        mujoco.mju_quat2Mat(turn, quat)
        return turn.reshape(3, 3)

    def numbers(element, key):
        return np.array([float(word) for word in element.get(key).split()])

    pelvis = data.body("pelvis")
    found = {"pelvis": (pelvis.xpos, pelvis.xmat.reshape(3, 3))}
    for joint in root.findall("joint"):
        position, turn = found[joint.find("parent").get("link")]
        origin = joint.find("origin")
        roll, pitch, yaw = numbers(origin, "rpy")
        turned = turn @ rotation((0, 0, 1), yaw) @ rotation((0, 1, 0), pitch)
        turned = turned @ rotation((1, 0, 0), roll)
        if joint.get("type") == "revolute":
            angle = qpos[scene.model.joint(joint.get("name")).qposadr[0]]
            turned = turned @ rotation(numbers(joint.find("axis"), "xyz"), angle)
        child = joint.find("child").get("link")
        found[child] = position + turn @ numbers(origin, "xyz"), turned
    for side in ("left", "right"):
        site = data.site(f"{side}_sole")
        position, turn = found[f"{side}_sole"]
        assert position == pytest.approx(site.xpos, abs=1e-4)
        assert turn.ravel() == pytest.approx(site.xmat, abs=1e-4)
    assert {link.get("name") for link in root.findall("link")} == set(found)
    mass = sum(float(m.get("value")) for m in root.iter("mass"))
    assert mass == pytest.approx(get_robot(name).mass_kg, rel=0.01)


def test_angles_of_a_quaternion_by_hand():
    half = math.sqrt(0.5)
    assert roll_pitch_yaw((half, 0, 0, half)) == pytest.approx((0, 0, math.pi / 2))
    assert roll_pitch_yaw((half, half, 0, 0)) == pytest.approx((math.pi / 2, 0, 0))
    assert roll_pitch_yaw((half, 0, half, 0))[1] == pytest.approx(math.pi / 2)


def test_a_map_survives_the_message():
    cells = np.random.default_rng(0).integers(0, 3, (7, 4)).astype(np.uint8)
    grid = OccupancyGrid(cells=cells, resolution_m=0.05, origin=(-1.0, 2.0, 0.3))
    kind = "nav_msgs/msg/OccupancyGrid"
    again = messages.decoded(kind, messages.encoded(kind, messages.occupancy(grid, 5)))
    back = messages.grid_of(again)
    assert np.array_equal(back.cells, cells)
    assert back.resolution_m == 0.05
    assert back.origin == pytest.approx(grid.origin)
    assert set(np.asarray(again.data)[cells.ravel() == Cell.OCCUPIED]) == {100}


@pytest.mark.parametrize(
    ("width", "data", "told"),
    [
        (0, [], "at least one"),
        (3, [0, 0, 0, 0], "must have 3 x 2"),
        (2, [0, 101, 0, 0], "from -1"),
    ],
)
def test_maps_that_are_none(width, data, told):
    info = SimpleNamespace(height=2, width=width, resolution=0.05)
    with pytest.raises(ValueError, match=told):
        messages.grid_of(SimpleNamespace(info=info, data=np.array(data)))


@pytest.mark.parametrize(
    ("position", "turn", "told"),
    [
        ((math.nan, 0, 0), (1, 0, 0, 0), "not finite"),
        ((0, 0, 0), (0, 0, 0, 0), "length 0"),
        ((0, 0, 0), (2, 0, 0, 0), "length 2"),
        ((0, 0, 0), (0.8, 0.6, 0, 0), "tilted"),
    ],
)
def test_poses_that_are_none(position, turn, told):
    at = SimpleNamespace(**dict(zip("xyz", position, strict=True)))
    orientation = SimpleNamespace(**dict(zip("wxyz", turn, strict=True)))
    with pytest.raises(ValueError, match=told):
        messages.pose2d_of(SimpleNamespace(position=at, orientation=orientation))


def test_footprints_that_are_no_more_are_deleted():
    markers = messages.FootprintMarkers("planned", FootShape(length_m=0.2, width_m=0.1), opacity=1)
    poses = np.zeros((3, 4))
    markers.show([Side.LEFT, Side.RIGHT, Side.LEFT], poses, 0)
    shown = markers.show([Side.LEFT], poses[:1], 1).markers
    assert [(marker.id, marker.action) for marker in shown] == [(0, 0), (1, 2), (2, 2)]
    assert len(markers.show([Side.LEFT], poses[:1], 2).markers) == 1


def test_a_walk_that_never_begins_is_recorded_as_such(tmp_path):
    words = ["--map", "maps/room.png", "--goal", "9,9,0", "--out", str(tmp_path)]
    assert main(["navigate", *words, "--record", str(tmp_path / "w.mcap")]) == 3
    with (tmp_path / "w.mcap").open("rb") as stream:
        found = {channel.topic: m for _, channel, m in make_reader(stream).iter_messages()}
    event = json.loads(messages.decoded("std_msgs/msg/String", found["/plan_events"].data).data)
    assert event["event"] == "no_path"
    assert event["reason"]
    assert "/report" in found


def test_the_layout_names_topics_that_are_recorded(told):
    layout = (ROOT / "docs" / "foxglove_layout.json").read_text()
    panels = json.loads(layout)["configById"]
    topics = set(panels["3D!walk"]["topics"])
    paths = [path["value"] for name in panels for path in panels[name].get("paths", ())]
    paths += [panel["topicPath"] for panel in panels.values() if "topicPath" in panel]
    assert paths
    assert topics | {path.partition(".")[0] for path in paths} <= set(told)
