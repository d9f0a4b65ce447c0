"""Walks a plan on an exported policy, with ONNX Runtime and plain MuJoCo; no import of Footfall.

    python main.py export --robot jvrc1 --out policy.onnx --mjcf robot.xml
    python main.py plan --map maps/room.png --goal 2,1,1.57 --out plan.json
    python examples/deploy/walk_plan.py policy.onnx robot.xml plan.json

All that it knows of the policy is in the ONNX file. `Robot` is what to replace on hardware: it
gives the state and takes joint targets at 40 Hz. Its floor is level here, whatever the map.
docs/deploying.md explains every number.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import onnxruntime

TEXTS = ("format", "robot", "joint_target_rad", "mujoco_version", "git_revision", "weights_sha256")
WAIT_S, SETTLE_S = 0.5, 2.0


def load_policy(policy_file: str) -> tuple[Any, dict[str, Any]]:
    """The policy, and what its file says of itself."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1  # it is small: more threads only wait for each other
    providers = ["CPUExecutionProvider"]
    policy = onnxruntime.InferenceSession(policy_file, options, providers=providers)
    told = policy.get_modelmeta().custom_metadata_map
    return policy, {key: text if key in TEXTS else json.loads(text) for key, text in told.items()}


class Robot:
    """The robot in simulation: servos by the policy's metadata, standing where the plan begins."""

    def __init__(self, model_file: str, about: dict[str, Any], feet: np.ndarray):
        spec = mujoco.MjSpec.from_file(model_file)
        servos = about["joints"], about["kp_nm_rad"], about["kd_nm_s_rad"], about["torque_limit_nm"]
        for name, kp, kd, limit_nm in zip(*servos, strict=True):
            servo = spec.add_actuator(name=name, target=name, forcerange=[-limit_nm, limit_nm])
            servo.trntype = mujoco.mjtTrn.mjTRN_JOINT
            servo.set_to_position(kp=kp, kv=kd)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.substeps = round(about["control_period_s"] / self.model.opt.timestep)
        joints = [self.model.joint(name) for name in about["joints"]]
        self.at_qpos = [int(joint.qposadr[0]) for joint in joints]
        self.at_qvel = [int(joint.dofadr[0]) for joint in joints]
        # Half-sitting, the soles flat on the floor midway between the feet of the plan's start.
        pelvis, yaw = about["standing_pelvis"], np.angle(np.exp(1j * feet[:, 3]).sum())
        x, y, z, _ = feet.mean(axis=0)
        cos, sin = math.cos(yaw), math.sin(yaw)
        self.data.qpos[:3] = x + cos * pelvis["x_m"], y + sin * pelvis["x_m"], z + pelvis["z_m"]
        half = yaw / 2, pelvis["pitch_rad"] / 2
        turned = np.array([math.cos(half[0]), 0, 0, math.sin(half[0])])
        tilted = np.array([math.cos(half[1]), 0, math.sin(half[1]), 0])
        mujoco.mju_mulQuat(self.data.qpos[3:7], turned, tilted)
        self.data.qpos[self.at_qpos] = about["half_sitting_rad"]
        mujoco.mj_forward(self.model, self.data)

    def state(self) -> dict[str, np.ndarray]:
        """Pelvis position and roll, pitch, yaw in the world, its angular velocity, the joints."""
        w, x, y, z = self.data.qpos[3:7]
        roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
        pitch = math.asin(np.clip(2 * (w * y - z * x), -1, 1))
        yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        return {
            "position_m": self.data.qpos[:3].copy(),
            "roll_pitch_yaw_rad": np.array([roll, pitch, yaw]),
            "angvel_rad_s": self.data.qvel[3:6].copy(),
            "joint_pos_rad": self.data.qpos[self.at_qpos],
            "joint_vel_rad_s": self.data.qvel[self.at_qvel],
        }

    def send(self, target_rad: np.ndarray) -> None:
        """Holds the joint targets for one control period."""
        self.data.ctrl[:] = target_rad
        mujoco.mj_step(self.model, self.data, self.substeps)

    def soles(self) -> dict[str, np.ndarray]:
        """Where the soles are, for the report alone; the policy does not see it."""
        return {side: self.data.site(f"{side}_sole").xpos.copy() for side in ("left", "right")}


def gait(plan: dict[str, Any], about: dict[str, Any]) -> Iterator[tuple[Any, np.ndarray, Any, str]]:
    """For each control period: clock, the present and the next step, their durations, who lands.

    The robot stands, shifts its weight for one double support, takes the steps, and stands.
    """
    period_s, steps = about["control_period_s"], plan["steps"]
    swing, double = about["gait_ticks"]["swing"], about["gait_ticks"]["double_support"]
    own = swing + double
    first = steps[0]["side"] if steps else "left"
    side = [first, "right" if first == "left" else "left", *(step["side"] for step in steps)]
    pose = [plan["start_feet"][name] for name in side[:2]]
    pose += [[step[key] for key in ("x", "y", "z", "yaw")] for step in steps]
    seen = np.array([*pose, pose[-2]])  # after the last step comes the other foot, which stands
    ticks = [round(s / period_s) for s in plan.get("step_s") or [own * period_s] * len(steps)]
    ticks = [*(ticks[:1] * 2), *ticks, own]
    for _ in range(round(WAIT_S / period_s)):
        yield (0.0, 0.0), seen[:2], (own * period_s, own * period_s), ""
    for k in range(1, len(pose) if steps else 1):
        durations_s = ticks[k] * period_s, ticks[k + 1] * period_s
        begin = round(ticks[k] * swing / own) if k == 1 else 0
        for tick in range(begin, ticks[k]):
            phase = math.pi * (tick / ticks[k] + (side[k] == "left"))
            lands = side[k] if k > 1 and tick == ticks[k] - 1 else ""
            yield (math.sin(phase), math.cos(phase)), seen[k : k + 2], durations_s, lands
    for _ in range(round(SETTLE_S / period_s)):
        yield (0.0, 0.0), seen[-3:-1], (own * period_s, own * period_s), ""


def observe(
    about: dict[str, Any], state: dict[str, np.ndarray], clock: Any, window: np.ndarray, step_s: Any
) -> np.ndarray:
    """The observation (1, N), field by field in the order that the file names."""
    roll, pitch, yaw = state["roll_pitch_yaw_rad"]
    steps = window - [*state["position_m"], yaw]
    cos, sin = math.cos(yaw), math.sin(yaw)
    steps[:, :2] = steps[:, :2] @ np.array([[cos, -sin], [sin, cos]])
    steps[:, 2] += about["pelvis_height_m"]
    steps[:, 3] = np.angle(np.exp(1j * steps[:, 3]))
    fields = {
        "roll_pitch_rad": (roll, pitch),
        "pelvis_angvel_rad_s": state["angvel_rad_s"],
        "joint_pos_rad": state["joint_pos_rad"],
        "joint_vel_rad_s": state["joint_vel_rad_s"],
        "clock": clock,
        "step_1": steps[0],
        "step_2": steps[1],
        "step_s": step_s,
    }
    names = [name for name, _ in about["observation"]]
    return np.concatenate([fields[name] for name in names], dtype=np.float32)[None]


def main(policy_file: str, model_file: str, plan_file: str) -> int:
    """Walks, and says how far the feet end from the plan's last steps; 0 if it stands there."""
    policy, about = load_policy(policy_file)
    plan = json.loads(Path(plan_file).read_text(encoding="utf-8"))
    robot = Robot(model_file, about, np.array([plan["start_feet"][s] for s in ("left", "right")]))
    half_sitting_rad = np.array(about["half_sitting_rad"])
    previous, errors_m = np.zeros(len(half_sitting_rad)), []
    for clock, window, step_s, lands in gait(plan, about):
        observation = observe(about, robot.state(), clock, window, step_s)
        (action,) = policy.run(["action"], {"observation": observation})[0].astype(float)
        robot.send(half_sitting_rad + 0.5 * (action + previous))
        previous = action
        if lands:
            errors_m.append(math.dist(robot.soles()[lands][:2], window[0, :2]))
        if robot.state()["position_m"][2] < window[:, 2].min() + 0.7 * about["pelvis_height_m"]:
            print(f"fell after {len(errors_m)} of {len(plan['steps'])} steps")
            return 4
    last = {step["side"]: (step["x"], step["y"]) for step in plan["steps"][-2:]}
    off_m = max((math.dist(robot.soles()[side][:2], xy) for side, xy in last.items()), default=0.0)
    median, most = (100 * np.percentile(errors_m or [0.0], share) for share in (50, 100))
    print(f"{len(errors_m)} steps, {median:.1f} cm median, {most:.1f} cm at most from the plan")
    print(f"stands within {100 * off_m:.1f} cm of the last steps")
    return 0 if off_m < 0.10 else 4


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]) if len(sys.argv) == 4 else __doc__)
