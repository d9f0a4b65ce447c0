"""The ROS 2 node seen from outside, by a bare DDS participant in `ros2_peer.py`."""

# Cyclone DDS reads its types when the program runs; checkers know less of them.
# mypy: disable-error-code="arg-type,assignment,index"

from __future__ import annotations

import itertools
import json
import math
import re
import subprocess
import time

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")

from app.ros.plan_requests import RequestError, read_request
from planner.plan import FootstepPlan
from tests.programs import ROOM, refusal
from tests.ros2_peer import (
    DOMAIN,
    Header,
    InitialPose,
    Node,
    Participant,
    Point,
    Pose,
    PoseStamped,
    PoseWithCovariance,
    Quaternion,
    Text,
    pose_at,
    room,
)


def udp_addresses(pid: int) -> set[str]:
    """Addresses of a process's UDP sockets, each with the device it is bound to."""
    done = subprocess.run(["ss", "-lunp"], capture_output=True, text=True, check=False)
    lines = [line for line in done.stdout.splitlines() if f"pid={pid}," in line]
    return {re.sub(r":\d+$", "", line.split()[3]) for line in lines}


@pytest.mark.slow
def test_a_robot_walks_where_a_bare_participant_sends_it(tmp_path):
    node = Node("--sim-time", "--robot", "jvrc1")
    try:
        peer = Participant(DOMAIN)
        peer.until(lambda: peer.goal.get_matched_subscriptions(), "the node")
        goal = pose_at(0.8, -0.4, 0.5)
        peer.goal.write(PoseStamped(Header(), goal))
        peer.until(lambda: len(node.warnings()) == 1, "a warning: no map")
        assert "goal_pose: there is no map yet" in node.warnings()[0]

        empty = room()
        empty.info.width, empty.data = 0, []
        peer.map.write(empty)
        peer.until(lambda: len(node.warnings()) == 2, "a warning: no cells")
        short = room()
        short.data = short.data[:-1]
        peer.map.write(short)
        peer.until(lambda: len(node.warnings()) == 3, "a warning: too few cells")
        assert "must have 100 x 60" in node.warnings()[2]

        peer.map.write(room())
        peer.until(lambda: peer.got["robot_description"] and peer.got["odom"], "the robot")
        assert peer.got["robot_description"][0].data.startswith("<?xml")
        at = peer.got["odom"][-1].pose.pose.position
        assert (at.x, at.y) == pytest.approx((0, 0), abs=0.1)

        plans_on_request(peer, node)
        for bad, told in (
            (PoseStamped(Header(), pose_at(math.nan, 0, 0)), "not finite"),
            (PoseStamped(Header(frame_id="odom"), goal), "frame is 'odom'"),
            (PoseStamped(Header(), Pose(Point(), Quaternion(w=0.3))), "length 0.3"),
            (PoseStamped(Header(), pose_at(9, 9, 0)), "no plan"),
        ):
            count = len(node.warnings())
            peer.goal.write(bad)
            peer.until(lambda count=count: len(node.warnings()) > count, told)
            assert told in node.warnings()[-1]
            assert len(node.warnings()) == count + 1

        asked_s = time.monotonic()
        peer.goal.write(PoseStamped(Header(), goal))
        peer.until(lambda: any(m.markers for m in peer.got["footsteps"]), "footsteps")
        print(f"goal to first marker: {1000 * (time.monotonic() - asked_s):.0f} ms")
        markers = next(m for m in peer.got["footsteps"] if m.markers).markers
        assert {marker.action for marker in markers} == {0}
        assert [marker.id for marker in markers] == list(range(len(markers)))
        left = [marker.color.b > marker.color.r for marker in markers]
        assert all(a != b for a, b in itertools.pairwise(left))
        peer.until(lambda: any(p.poses for p in peer.got["path"]), "the path")
        end = [p for p in peer.got["path"] if p.poses][-1].poses[-1].pose.position
        assert (end.x, end.y) == pytest.approx((0.8, -0.4), abs=1e-6)

        peer.until(lambda: any(e["event"] == "reached" for e in peer.events()), "the goal")
        at = peer.got["odom"][-1].pose.pose.position
        assert math.dist((at.x, at.y), (0.8, -0.4)) < 0.2
        legs = peer.got["joint_states"][-1]
        assert len(legs.name) == len(legs.position) == len(legs.velocity) == len(legs.effort) == 12
        frames = {t.child_frame_id: t.header.frame_id for t in peer.got["tf"][-1].transforms}
        assert frames["pelvis"] == "map"
        fixed = {t.child_frame_id for t in peer.got["tf_static"][0].transforms}
        assert {"left_sole", "right_sole"} <= fixed
        ticks = [c.clock.sec * 40 + c.clock.nanosec // 25_000_000 for c in peer.got["clock"]]
        assert np.all(np.diff(ticks) > 0)

        # A wall comes up on the way: the robot plans again, and arrives all the same.
        peer.got["footsteps"].clear()
        peer.goal.write(PoseStamped(Header(), pose_at(2.6, -0.6, 0.0)))
        peer.until(lambda: any(m.markers for m in peer.got["footsteps"]), "footsteps")
        straight = len([m for m in peer.got["footsteps"] if m.markers][-1].markers)
        peer.got["footsteps"].clear()
        peer.map.write(room(wall=True))
        peer.until(
            lambda: any(
                sum(marker.action == 0 for marker in m.markers) > straight
                for m in peer.got["footsteps"]
            ),
            "a way round the wall",
        )
        reached = sum(e["event"] == "reached" for e in peer.events())
        peer.until(
            lambda: (
                sum(e["event"] == "reached" for e in peer.events()) > reached
                or any(e["event"] in ("fell", "collided") for e in peer.events())
            ),
            "the second goal",
        )
        at = peer.got["odom"][-1].pose.pose.position
        assert math.dist((at.x, at.y), (2.6, -0.6)) < 0.2

        # RViz puts the robot somewhere else: its footprints go.
        there = PoseWithCovariance(pose_at(-0.2, 0.5, 1.0), [0.0] * 36)
        peer.got["odom"].clear()
        peer.start.write(InitialPose(Header(), there))
        peer.until(
            lambda: peer.got["odom"] and peer.got["odom"][-1].pose.pose.position.x < 0.1,
            "the robot at its new place",
        )
        addresses = udp_addresses(node.process.pid)
        assert all(one.startswith("127.0.0.1") or one.endswith("%lo") for one in addresses)
        assert node.process.poll() is None
    finally:
        node.process.terminate()
        code = node.process.wait(timeout=60)
    assert code == 143
    assert len(node.warnings()) == 8, node.lines


def plans_on_request(peer: Participant, node: Node) -> None:
    """Questions are answered in their order, one that is none with what is wrong with it."""
    goal = [0.8, -0.4, 0.5]
    for question in (
        {"id": "from here", "goal": goal},
        {"id": "from there", "start": [1.0, 0.5, 0.0], "goal": goal},
        {"id": "nowhere", "goal": [9.0, 9.0, 0.0]},
    ):
        peer.request.write(Text(json.dumps({"format": "plan-request/1", **question})))
    peer.until(lambda: len(peer.got["plan"]) == 3, "three plans")
    here, there, nowhere = (json.loads(answer.data) for answer in peer.got["plan"])
    assert [answer["id"] for answer in (here, there, nowhere)] == [
        *("from here", "from there", "nowhere")
    ]
    for answer, start in ((here, (0.0, 0.0)), (there, (1.0, 0.5))):
        plan = FootstepPlan.from_json(json.dumps(answer))
        assert plan.found
        assert plan.start[:2] == pytest.approx(start, abs=0.1)
        assert plan.pose_world[-2:, :2].mean(axis=0) == pytest.approx(goal[:2], abs=1e-6)
    assert (nowhere["status"], nowhere["steps"]) == ("off_map", [])
    count = len(node.warnings())
    peer.request.write(Text('{"format": "plan-request/1", "id": "x", "goal": [1, 2]}'))
    peer.until(lambda: len(peer.got["plan"]) == 4, "an answer")
    told = json.loads(peer.got["plan"][-1].data)
    assert told["id"] == "x"
    assert told["error"] == "goal [1, 2] must be 3 finite numbers"
    peer.until(lambda: len(node.warnings()) > count, "a warning")
    assert node.warnings()[-1] == f"warning: plan_request: {told['error']}"


def request(**keys):
    return json.dumps({"format": "plan-request/1", "id": "a", **keys})


def test_a_question_is_read():
    feet = {"left": [0.0, 0.1, 0.0, 0.0], "right": [0.0, -0.1, 0.0, 0.0]}
    read = read_request(request(goal=[1, 2, 0.5], start_feet=feet), 0.3)
    assert (read.id, read.goal) == ("a", (1.0, 2.0, 0.5))
    assert read.start_feet_world[:, 1].tolist() == [0.1, -0.1]
    read = read_request(request(goal=[1, 2, 0.5], start=[1, 1, 0]), 0.3)
    assert read.start_feet_world[:, :2].ravel() == pytest.approx([1, 1.15, 1, 0.85])
    assert read_request(request(goal=[1, 2, 0.5]), 0.3).start_feet_world is None


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("", "not JSON"),
        ("[]", "must be an object"),
        ('{"goal": [1, 2, 3]}', "must be an object with the format"),
        (request(), "key 'goal' is missing"),
        (request(goal=[1, 2]), r"goal \[1, 2\] must be 3 finite numbers"),
        (request(goal=[1, 2, "x"]), "must be 3 finite numbers"),
        (request(goal=[1, 2, True]), "must be 3 finite numbers"),
        (request(goal=[[1], [2], [3]]), "must be 3 finite numbers"),
        (request(goal=[1, 2, 10**400]), "must be 3 finite numbers"),
        ('{"format": "plan-request/1", "goal": [1, 2, NaN]}', "must be 3 finite"),
        (request(goal=[1, 2, 3], start=[0, 0, 0], start_feet={}), "not both"),
        (request(goal=[1, 2, 3], start_feet={"left": [0, 0, 0, 0]}), "left and right"),
        (request(goal=[1, 2, 3], gaol=1), "key 'gaol' is unknown"),
        (request(id=3, goal=[1, 2, 3]), "id 3 must be a text"),
    ],
)
def test_what_is_wrong_with_a_question_is_named(words, told):
    with pytest.raises(RequestError, match=told):
        read_request(words, 0.3)


def test_options_that_do_not_go_together(capsys):
    assert "give --network too" in refusal(capsys, "ros2", "--interface", "eth0")
    assert "must be from 0 to 232" in refusal(capsys, "ros2", "--domain", "233")
    nowhere = ("--map", ROOM, "--start", "100,0,0", "--domain", DOMAIN + 2)
    assert "cannot stand at its start" in refusal(capsys, "ros2", *nowhere)
    assert "--resolution is about a map" in refusal(capsys, "ros2", "--resolution", "0.05")
    assert "no-such-interface" in refusal(
        capsys, "ros2", "--network", "--interface", "no-such-interface", "--domain", DOMAIN + 1
    )
