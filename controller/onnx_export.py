"""A policy as one ONNX file: raw observation in, action out, and in it all that a user must know.

The graph is written out layer by layer; the normaliser is its first two nodes. The weights are in
the file itself, without a second file of data beside it. A row of the observation that holds NaN
gives a row of NaN: runtimes differ in what clipping and ReLU make of it.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from controller.gait import CONTROL_PERIOD_S, GaitTicks
from controller.observation import SCALED_LIMIT
from controller.policy import Policy
from sim.robot import Robot
from sim.scene import PHYSICS_TIMESTEP_S, build_scene

if TYPE_CHECKING:
    import onnx

FORMAT = "footstep-policy-onnx/1"
# Old enough for the runtimes of the last years; the nodes used have not changed since.
OPSET, IR_VERSION = 17, 8
CHECKED_OBSERVATIONS = 1000
TOLERANCE = 1e-5


class ExportError(ValueError):
    """The file cannot be made here, or does not do what the policy does."""


def require_onnx() -> None:
    """Checks that the package onnx is there.

    Raises:
        ExportError: it is not; the message says what to install.
    """
    try:
        import onnx  # noqa: F401
    except ImportError as error:
        raise ExportError(
            "export needs the package onnx: python -m pip install -e '.[export]'"
        ) from error


def to_onnx(policy: Policy, robot: Robot, *, clip: bool = True) -> onnx.ModelProto:
    """The model: `observation` (B, N) as from `observe`, float32, to `action` (B, J) in rad.

    With `clip` the scaled observation is cut off at the limit of training.
    """
    from onnx import TensorProto, checker, helper, numpy_helper

    nodes, constants = [], []

    def constant(name: str, values: Any, kind: Any = np.float32) -> str:
        array = np.ascontiguousarray(values, kind).reshape(np.shape(values))
        constants.append(numpy_helper.from_array(array, name))
        return name

    def node(kind: str, *inputs: str, output: str, **attributes: Any) -> str:
        nodes.append(helper.make_node(kind, inputs, [output], name=output, **attributes))
        return output

    value = node("Sub", "observation", constant("offset", policy.offset), output="centred")
    value = node("Div", value, constant("scale", policy.scale), output="scaled")
    if clip:
        limits = constant("least", -SCALED_LIMIT), constant("most", SCALED_LIMIT)
        value = node("Clip", value, *limits, output="clipped")
    last = len(policy.layers) - 1
    for k, (weight, bias) in enumerate(policy.layers):
        inputs = value, constant(f"weight_{k}", weight), constant(f"bias_{k}", bias)
        value = node("Gemm", *inputs, output=f"layer_{k}", transB=1)
        if k < last:
            value = node("Relu", value, output=f"relu_{k}")
    is_nan = node("IsNaN", "observation", output="is_nan")
    marks = node("Where", is_nan, constant("nan", np.nan), constant("zero", 0.0), output="marks")
    axes = constant("axes", [1], np.int64)
    node("Add", value, node("ReduceSum", marks, axes, output="mark", keepdims=1), output="action")
    shapes = {"observation": len(policy.offset), "action": len(robot.joints)}
    ends = {
        name: helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", width])
        for name, width in shapes.items()
    }
    graph = helper.make_graph(
        nodes, f"{robot.name}_policy", [ends["observation"]], [ends["action"]], constants
    )
    model = helper.make_model(
        graph,
        producer_name="footfall",
        ir_version=IR_VERSION,
        opset_imports=[helper.make_opsetid("", OPSET)],
        doc_string="Leg joint targets for a humanoid that steps where it is told.",
    )
    helper.set_model_props(model, metadata(policy, robot, clip=clip))
    checker.check_model(model, full_check=True)
    return model


def metadata(policy: Policy, robot: Robot, *, clip: bool = True) -> dict[str, str]:
    """What the file says of itself; lists and numbers as JSON."""
    trained = policy.about.get("trained") or {}
    task = (trained.get("config") or {}).get("task") or {}
    ticks = GaitTicks.of(robot.gait)
    scene = build_scene(robot, timestep_s=PHYSICS_TIMESTEP_S)
    x_m, _, z_m = scene.standing_qpos[:3].tolist()
    ranges = [scene.model.joint(joint.name).range.tolist() for joint in robot.joints]
    facts: dict[str, Any] = {
        "joints": [joint.name for joint in robot.joints],
        "half_sitting_rad": robot.half_sitting_rad.tolist(),
        "kp_nm_rad": [joint.kp for joint in robot.joints],
        "kd_nm_s_rad": [joint.kd for joint in robot.joints],
        "torque_limit_nm": [joint.torque_limit_nm for joint in robot.joints],
        "speed_limit_rad_s": [float(joint.speed_limit_rad_s) for joint in robot.joints],
        "joint_range_rad": ranges,
        "armature_kg_m2": [joint.armature_kg_m2 for joint in robot.joints],
        "control_period_s": CONTROL_PERIOD_S,
        "gait_ticks": {"swing": ticks.swing, "double_support": ticks.double_support},
        "pelvis_height_m": robot.pelvis_height_m,
        "standing_pelvis": {"x_m": x_m, "z_m": z_m, "pitch_rad": robot.pelvis_pitch_rad},
        "step_range_s": policy.step_range_s(robot),
        "observation": policy.about["observation"],
        "scaled_limit": SCALED_LIMIT if clip else None,
        "randomization": task.get("randomization"),
        "trained": {key: trained.get(key) for key in ("command", "seed", "samples")},
    }
    return {
        "format": FORMAT,
        "robot": robot.name,
        "joint_target_rad": "half_sitting_rad + 0.5 * (action + previous_action)",
        "mujoco_version": str(policy.about.get("mujoco_version", "unknown")),
        "git_revision": str(trained.get("git_revision", "unknown")),
        "weights_sha256": str(policy.about.get("sha256", "unknown")),
        **{key: json.dumps(value) for key, value in facts.items()},
    }


def greatest_difference(path: Path, policy: Policy, *, clip: bool = True) -> float:
    """How far the file's actions are from the policy's, in rad, over random observations.

    They are drawn three times as wide as the normaliser's scale, so some are clipped.

    Raises:
        ExportError: further than rounding to float32 explains.
    """
    from onnx.reference import ReferenceEvaluator

    rng = np.random.default_rng(0)
    drawn = rng.normal(size=(CHECKED_OBSERVATIONS, len(policy.offset)))
    observation = (policy.offset + 3 * policy.scale * drawn).astype(np.float32)
    (action,) = ReferenceEvaluator(str(path)).run(["action"], {"observation": observation})
    scaled = (observation - policy.offset) / policy.scale
    native = policy.act_scaled(np.clip(scaled, -SCALED_LIMIT, SCALED_LIMIT) if clip else scaled)
    difference = float(np.abs(action - native).max())
    # Not `>`: that is false of numbers that are not finite.
    if not difference <= TOLERANCE * max(1.0, float(np.abs(native).max())):
        raise ExportError(f"the exported policy differs from its original by {difference:.2g} rad")
    return difference
