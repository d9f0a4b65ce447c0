"""examples/deploy/loop.py and simulator.py in simulated time: watchdog, limits, log, network."""

from __future__ import annotations

import ast
import importlib
import math
import socket
import sys
from typing import Any

import numpy as np
import pytest

from app.cli import main
from app.comparison.read_log import read_log
from sim.robots import get_robot
from sim.scene import build_scene
from tests.programs import ROOT

pytest.importorskip("onnxruntime", reason="comes with the extra `test`")
FOLDER = ROOT / "examples" / "deploy"


@pytest.fixture(scope="module")
def programs():
    """The modules loop, simulator and walk_plan."""
    sys.path.insert(0, str(FOLDER))
    yield [importlib.import_module(name) for name in ("loop", "simulator", "walk_plan")]
    sys.path.remove(str(FOLDER))


@pytest.fixture(scope="module")
def files(tmp_path_factory, programs):
    """What is exported: policy, what its file tells, the model's file."""
    folder = tmp_path_factory.mktemp("exported")
    policy, model = str(folder / "p.onnx"), str(folder / "robot.xml")
    assert main(["export", "--out", policy, "--mjcf", model]) == 0
    return *programs[2].load_policy(policy), model


def plan_ahead(steps):
    """So many steps of 0.15 m ahead."""
    sides = ["left", "right"] * steps
    return {
        "start_feet": {"left": [0, 0.09, 0, 0], "right": [0, -0.09, 0, 0]},
        "steps": [
            {"side": side, "x": 0.15 * (k + 1), "y": 0.09 * (1 - 2 * (side == "right")), "z": 0.0}
            | {"yaw": 0.0}
            for k, side in enumerate(sides[:steps])
        ],
    }


class SimulatedLink:
    """A link in simulated time; the robot's clock is the loop's. `deaf_s` ends what it hears."""

    def __init__(self, programs, world):
        loop, self.world = programs[0], world
        self.state: Any = None
        self.offset_s, self.deaf_s, self.time_s = math.inf, math.inf, 0.0
        self.late_at_s: dict[float, float] = {}
        self.sent: list[tuple[float, np.ndarray]] = []
        self._state, self._command = loop.state_type(12), loop.command_type(12)

    def now_s(self):
        return self.time_s

    def wait(self, until_s):
        for at_s in [at_s for at_s in self.late_at_s if at_s <= until_s]:
            until_s += self.late_at_s.pop(at_s)
        self.time_s = max(self.time_s, until_s)
        self.world.advance(self.time_s + 1e-9)
        for at_s, packet in self.world.back.get(self.time_s):
            state = np.frombuffer(packet, self._state)[0]
            if at_s > self.deaf_s:
                continue
            self.offset_s = min(self.offset_s, at_s - state["stamp_s"])
            if self.state is None or state["stamp_s"] > self.state["stamp_s"]:
                self.state = state

    def send(self, number, gain, target_rad):
        self.sent.append((gain, target_rad.copy()))
        packet = np.array([(number, gain, target_rad)], self._command)
        self.world.there.put(packet.tobytes(), self.time_s)


def run_loop(programs, files, plan, *, jitter_s=0.005, loss=0.01, change=None, file=None, **drives):
    """The loop's report, the machine and the link, after a walk in simulated time."""
    loop, simulator, _ = programs
    policy, about, model = files
    feet = np.array([plan["start_feet"][side] for side in ("left", "right")])
    machine = simulator.Machine(model, about, feet, **drives)
    rng = np.random.default_rng(0)
    networks = [simulator.Network(rng, jitter_s, loss) for _ in range(2)]
    link = SimulatedLink(programs, simulator.World(machine, *networks))
    walk = loop.Walk(policy, about, plan)
    if change is not None:
        change(link, machine, walk)
    report = loop.run(link, walk, about, loop.Log(file, about["joints"]))
    return report, machine, link


def test_they_import_nothing_of_ours():
    for name, more in (("loop", set()), ("simulator", {"loop", "mujoco"})):
        tree = ast.parse((FOLDER / f"{name}.py").read_text(encoding="utf-8"))
        imported = {
            module.split(".")[0]
            for node in ast.walk(tree)
            if isinstance(node, (ast.Import, ast.ImportFrom))
            for module in (
                [alias.name for alias in node.names]
                if isinstance(node, ast.Import)
                else [node.module or ""]
            )
        }
        assert imported - set(sys.stdlib_module_names) == {"numpy", "walk_plan"} | more


def test_a_walk_over_jitter_and_loss_and_its_log(programs, files, tmp_path):
    plan, path = plan_ahead(4), tmp_path / "log.csv"
    with path.open("w", newline="") as file:
        report, machine, link = run_loop(programs, files, plan, file=file)
    assert report["outcome"] == "done", report
    assert programs[1].verdict(machine, plan)["off_m"] < 0.05
    # Half a second of waiting, half a double support, four steps of 1.1 s, two seconds of rest.
    assert report["ticks"] == pytest.approx((0.5 + 0.35 / 2 + 4 * 1.1 + 2.0) / 0.025, abs=15)
    assert report["ticks"] == len([gain for gain, _ in link.sent]) - 1
    assert 0.0 < report["state_age_ms"]["median"] < 15.0
    log = read_log(path, build_scene(get_robot("jvrc1"), timestep_s=0.001))
    assert len(log.time_s) == report["ticks"]
    assert np.allclose(log.target_rad, [target for _, target in link.sent[1:]], atol=1e-5)
    assert np.all(log.sent_s >= log.time_s)


def test_a_sensor_that_falls_silent_stops_it_softly(programs, files):
    def silent(link, machine, walk):
        link.deaf_s = 1.0

    report, machine, link = run_loop(programs, files, plan_ahead(2), change=silent)
    assert report["outcome"] == "stopped"
    assert "the newest state is" in report["reason"]
    # Noticed within 60 ms and a tick.
    assert 1.0 < report["ticks"] * 0.025 + 0.1 < 1.0 + 0.06 + 0.15
    gains = [gain for gain, _ in link.sent]
    fade = gains[report["ticks"] + 1 :]
    assert fade[0] == 1.0
    assert fade[-1] == 0.0
    assert np.all(np.diff(fade) <= 0)
    assert np.abs(np.diff(fade)).max() < 0.06
    # It sank down, and lies at rest.
    assert machine.data.qpos[2] < 0.6


@pytest.mark.parametrize(("late_s", "is_stopped"), [(0.03, False), (0.2, True)])
def test_a_deadline_missed_once_is_nothing_and_by_far_a_stop(programs, files, late_s, is_stopped):
    def late(link, machine, walk):
        link.late_at_s[1.0] = late_s

    report, _, _ = run_loop(programs, files, plan_ahead(1), change=late)
    assert report["outcome"] == ("stopped" if is_stopped else "done")
    assert report["late_ms"]["max"] >= 1e3 * late_s - 1e-6
    if is_stopped:
        assert report["reason"] == "1 deadlines missed, the last by 200 ms"


def test_a_fall_stops_it(programs, files):
    def pushed(link, machine, walk):
        machine.model.opt.gravity[0] = 6.0

    report, _, _ = run_loop(programs, files, plan_ahead(2), change=pushed)
    assert report["outcome"] == "stopped"
    assert report["reason"].startswith(("it falls", "a joint turns"))


def test_an_action_that_is_not_finite_stops_it(programs, files):
    def broken(link, machine, walk):
        class Policy:
            def run(self, names, inputs):
                return [np.full((1, 12), np.nan, np.float32)]

        walk._policy = Policy()

    report, _, link = run_loop(programs, files, plan_ahead(1), change=broken)
    assert report["reason"] == "the policy's action is not finite"
    assert np.isfinite([target for _, target in link.sent]).all()


def test_a_loop_that_dies_is_noticed_by_the_drives(programs, files):
    simulator = programs[1]
    _, about, model = files
    feet = np.array(list(plan_ahead(0)["start_feet"].values()))
    machine = simulator.Machine(model, about, feet)
    for _ in range(100):
        machine.step()
    assert machine.model.actuator_gainprm[0, 0] == pytest.approx(about["kp_nm_rad"][0])
    for _ in range(600):
        machine.step()
    assert machine.model.actuator_gainprm[0, 0] == 0.0


def test_limits_by_hand(programs, files):
    loop, about = programs[0], files[1]
    one = {
        "joint_range_rad": [[-0.5, 0.5]],
        "kp_nm_rad": [100.0],
        "kd_nm_s_rad": [10.0],
        "torque_limit_nm": [20.0],
        "speed_limit_rad_s": [4.0],
    }

    def kept(target, pos, vel):
        state = np.zeros(1, loop.state_type(1))[0]
        state["joint_pos_rad"], state["joint_vel_rad_s"] = pos, vel
        return loop.Limits(one).keep(np.array([target]), state)[0]

    assert kept(0.1, 0.0, 0.0) == 0.1
    # 20 N m are 0.2 rad of 100 N m/rad; 1 rad/s of 10 N m s/rad are 0.1 rad more.
    assert kept(1.0, 0.0, 0.0) == pytest.approx(0.2)
    assert kept(1.0, 0.0, 1.0) == pytest.approx(0.3)
    assert kept(-1.0, 0.0, 1.0) == pytest.approx(-0.1)
    # At the greatest speed, or the end of the range, the torque may only hold back.
    assert kept(1.0, 0.0, 4.0) == pytest.approx(0.4)
    assert kept(0.3, 0.0, 4.0) == pytest.approx(0.3)
    assert kept(1.0, 0.5, 0.0) == pytest.approx(0.5)
    assert kept(0.4, 0.5, 0.0) == pytest.approx(0.4)
    with pytest.raises(loop.Stop, match=r"6\.1 rad/s"):
        kept(0.0, 0.0, -6.1)
    joints = [get_robot("jvrc1").joints[j] for j in (0, 11)]
    assert [about["speed_limit_rad_s"][j] for j in (0, 11)] == [
        joint.speed_limit_rad_s for joint in joints
    ]


def test_the_network_delays_and_loses_as_asked(programs):
    network = programs[1].Network(np.random.default_rng(1), 0.005, 0.1)
    for k in range(5000):
        network.put(str(k).encode(), k * 0.001)
    arrived = network.get(10.0)
    assert len(arrived) == pytest.approx(4500, abs=100)
    delays = [at_s - int(packet) * 0.001 for at_s, packet in arrived]
    assert min(delays) >= 0
    assert max(delays) <= 0.005
    assert np.mean(delays) == pytest.approx(0.0025, abs=2e-4)
    numbers = [int(packet) for _, packet in arrived]
    assert sorted(numbers) != numbers


def test_of_packets_on_the_socket_the_newest_counts(programs):
    loop = programs[0]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as robot:
        robot.bind(("127.0.0.1", 0))
        link = loop.UdpLink(robot.getsockname(), 12)
        link.send(7, 0.5, np.arange(12.0))
        packet, peer = robot.recvfrom(4096)
        (command,) = np.frombuffer(packet, loop.command_type(12))
        assert (command["number"], command["gain"]) == (7, 0.5)
        assert command["target_rad"].tolist() == list(range(12))
        state = np.zeros(1, loop.state_type(12))
        for stamp_s in (1.0, 3.0, 2.0):
            state["stamp_s"] = stamp_s
            robot.sendto(state.tobytes(), peer)
        robot.sendto(b"nonsense", peer)
        link.wait(link.now_s() + 0.3)
        assert link.state["stamp_s"] == 3.0
        assert link.offset_s == pytest.approx(link.now_s() - 3.0, abs=1.0)


def test_chirps_turn_one_joint_of_each_leg(programs, files):
    loop, about = programs[0], files[1]
    moves = loop.Excitation(about, seconds_each=2.0)
    targets = []
    while (target := moves.target(None)) is not None:
        targets.append(target - about["half_sitting_rad"])
    turns = np.array(targets).reshape(6, 80, 12)
    for j in range(6):
        moved = np.abs(turns[j]).max(axis=0) > 1e-9
        assert np.flatnonzero(moved).tolist() == [j, j + 6]
        assert turns[j, :, j] == pytest.approx(turns[j, :, j + 6])
        assert 0.18 < np.abs(turns[j]).max() <= 0.2


def test_the_programs_refuse_what_does_not_go_together(programs, files, capsys):
    for words in (["p.onnx"], ["p.onnx", "plan.json", "--excite"]):
        with pytest.raises(SystemExit) as stopped:
            programs[0].main(words)
        assert stopped.value.code == 2
    assert "either a plan or --excite" in capsys.readouterr().err
