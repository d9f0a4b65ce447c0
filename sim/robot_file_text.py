"""Robot files as text: `robot.yaml` with a comment at every key, and the light model beside it."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from maps.files import written_whole
from planner.robot_model import StepLimits, StepModel
from sim.file_model import SIDES, pelvis_axes, quat_of
from sim.joint_roles import roles_of
from sim.robot import PHYSICS_GROUP, Robot
from sim.robot_file import FILE, FORMAT

if TYPE_CHECKING:
    import mujoco

MODEL = "model.xml"
TURNED_BASE = "robot_base"
WIDTH = 100

COMMENTS: Mapping[str, str] = {
    "format": "A robot of Footfall; docs/robot-file.md tells of every key. Points are from the "
    "origin of their body, in m along the pelvis's axes (x forward, y left, z up) with all joints "
    "at 0; those of pairs are of the left side.",
    "name": "Names policies and reports: letters, digits, dots, - and _.",
    "title": "What people call it.",
    "model": "Bodies, masses and joints in MuJoCo's format, no shapes. Only `plan` does without.",
    "meshes": "Optional: the published model whose meshes it wears, and where its packages are.",
    "mass_kg": "Of the whole robot, as the model has it.",
    "height_m": "From the soles to the top of the collision shapes with the leg joints at 0.",
    "bodies": "The model's names of the body that all hangs on and of the first body of each leg.",
    "head": "A point that should stay above the pelvis.",
    "half_sitting": "The pelvis above the soles, and how far it leans forward, in the posture that "
    "walking begins from. With half_sitting_deg of the joints it must leave the soles flat.",
    "fallen_height_m": "It has fallen where its pelvis is lower than this above the lower foot.",
    "gait": "Of one step: one foot in the air, then both on the ground.",
    "steady_pressure_share": "Optional: how far out the centre of pressure may be in undisturbed "
    "walking, in half soles, before a step changes.",
    "joints": "The joints of a leg from the hip down, left and right. Angles and ranges are the "
    "left one's; mirror_sign is 1 where the right one has the same in the mirrored posture, else "
    "-1. The torque is kp (target - angle) - kd speed, at most the limit.",
    "held_deg": "Joints of the model that do not move, where they are not at 0.",
    "soles": "The boxes that stand on the ground: the middle of the left one's underside, with the "
    "length and width of step_model.foot.",
    "shapes": "What collides: capsules (ends_m, radius_m) and boxes (centre_m, size_m).",
    "step_model": "What plans need: docs/ros.md tells of the keys of step models. Steps are x, y, "
    "yaw of the swing foot from the support foot, y and yaw positive outward.",
    "training_limits": "Optional: limits of the steps that training takes, a little wider.",
}


def write_robot(
    folder: Path,
    document: Mapping[str, Any],
    model: mujoco.MjModel,
    turn: np.ndarray | None = None,
) -> None:
    """Writes `robot.yaml` and the model that it names into a folder that is there.

    Raises:
        OSError: A file cannot be written.
    """
    for name, text in ((MODEL, model_text(model, turn)), (FILE, robot_text(document))):
        with written_whole(folder / name) as temporary:
            temporary.write_text(text, encoding="utf-8")


def robot_text(document: Mapping[str, Any]) -> str:
    """The text of a robot file, with its keys in the order of `COMMENTS`."""
    blocks = []
    for key, comment in COMMENTS.items():
        if key in document:
            lines = _wrapped(comment)
            blocks.append("\n".join([*lines, *_yaml_lines(key, document[key], "")]))
    return "\n\n".join(blocks) + "\n"


def _wrapped(comment: str) -> list[str]:
    import textwrap

    return [f"# {line}" for line in textwrap.wrap(comment, WIDTH - 2)]


def _yaml_lines(key: str, value: Any, indent: str) -> list[str]:
    """A key and its value: on one line where that is short, rows of lists on one line each."""
    flow = f"{indent}{key}: {_flow(value)}"
    is_table = isinstance(value, (list, tuple)) and value and isinstance(value[0], Mapping)
    if not is_table and (len(flow) <= WIDTH or not isinstance(value, (Mapping, list, tuple))):
        return [flow]
    lines = [f"{indent}{key}:"]
    if isinstance(value, Mapping):
        for name, one in value.items():
            lines += _yaml_lines(name, one, indent + "  ")
        return lines
    for row in value:
        first = f"{indent}  - {_flow(row)}"
        if len(first) <= WIDTH or not isinstance(row, Mapping):
            lines.append(first)
            continue
        for n, (name, one) in enumerate(row.items()):
            lines.append(f"{indent}  {'-' if n == 0 else ' '} {name}: {_flow(one)}")
    return lines


def _flow(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {_flow(one)}" for key, one in value.items()) + "}"
    if isinstance(value, (list, tuple, np.ndarray)):
        return "[" + ", ".join(_flow(one) for one in value) + "]"
    if isinstance(value, str):
        return _quoted(value)
    return _number(float(value))


def _quoted(text: str) -> str:
    import json

    import yaml

    try:
        is_plain = yaml.safe_load(f"{{a: {text}}}") == {"a": text}
    except yaml.YAMLError:
        is_plain = False
    return text if is_plain else json.dumps(text)


def _number(value: float) -> str:
    """The shortest number that is read back as this value."""
    value += 0.0  # no -0
    if value == int(value) and abs(value) < 1e15:
        return str(int(value))
    text = repr(value)
    if "e" in text and "." not in text:
        text = text.replace("e", ".0e")  # else YAML takes it for text
    return text


def degrees(angle_rad: float) -> float:
    """The angle in degrees, with the fewest digits that are read back as this very angle."""
    exact = math.degrees(angle_rad)
    for digits in range(2, 13):
        if math.radians(round(exact, digits)) == angle_rad:
            return round(exact, digits)
    return exact


def step_limits_document(limits: StepLimits) -> dict[str, Any]:
    """The keys and values of step limits."""
    return {key: value for key, value in asdict(limits).items() if key != "reach_m" or value}


def step_model_document(model: StepModel) -> dict[str, Any]:
    """The keys and values of a step model."""
    return {**asdict(model), "limits": step_limits_document(model.limits)}


def document_of(robot: Robot) -> tuple[dict[str, Any], mujoco.MjModel]:
    """What a robot of the registry would have in a file, without its looks, and the light model.

    Raises:
        ValueError: It has passive joints, which robot files do not know.
    """
    if robot.passive:
        raise ValueError(
            f"{robot.name} has passive joints ({robot.passive[0].name}, ...), which robot files do "
            "not know: copy its module in sim/robots"
        )
    spec = robot.build()
    spec.compiler.fusestatic = False  # or compiling takes bodies without joints out of the spec
    axes = pelvis_axes(spec, "pelvis")
    half = len(robot.joints) // 2
    roles = roles_of(robot)
    ranges = {joint.name: spec.compile().joint(joint.name).range for joint in robot.joints}
    soles, shapes = _soles_and_shapes(spec, axes)
    head = spec.site("head")
    document = {
        **identity_document(robot),
        "bodies": {name: name for name in ("pelvis", "left_leg", "right_leg")},
        "head": {
            "body": head.parent.name,
            "point_m": _rounded(axes[head.parent.name] @ head.pos),
        },
        "joints": [
            {
                "names": [left.name, right.name],
                "role": role,
                "mirror_sign": left.mirror_sign,
                "half_sitting_deg": degrees(left.half_sitting_rad),
                "range_deg": [degrees(float(end)) for end in ranges[left.name]],
                "kp_nm_per_rad": left.kp,
                "kd_nm_s_per_rad": left.kd,
                "torque_limit_nm": left.torque_limit_nm,
                "speed_limit_rad_s": left.speed_limit_rad_s,
                "armature_kg_m2": left.armature_kg_m2,
            }
            for left, right, role in zip(
                robot.joints[:half], robot.joints[half:], roles, strict=True
            )
        ],
        "soles": soles,
        "shapes": shapes,
    }
    for element in [*spec.geoms, *spec.sites]:
        spec.delete(element)
    return document, spec.compile()


def identity_document(robot: Robot) -> dict[str, Any]:
    """The keys whose values are in the fields of a robot as they are."""
    document: dict[str, Any] = {
        "format": FORMAT,
        "name": robot.name,
        "title": robot.title,
        "model": MODEL,
        "mass_kg": robot.mass_kg,
        "height_m": robot.height_m,
        "half_sitting": {
            "pelvis_height_m": robot.pelvis_height_m,
            "pelvis_pitch_deg": degrees(robot.pelvis_pitch_rad),
        },
        "fallen_height_m": robot.fallen_height_m,
        "gait": asdict(robot.gait),
        "steady_pressure_share": robot.steady_pressure_share,
        "step_model": step_model_document(robot.step_model),
    }
    if robot.training_limits is not None:
        document["training_limits"] = step_limits_document(robot.training_limits)
    return document


def _soles_and_shapes(
    spec: mujoco.MjSpec, axes: Mapping[str, np.ndarray]
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The boxes of the feet, and all other collision shapes, of a spec made by `sim/solids.py`."""
    feet = [spec.geom(f"{side}_foot") for side in SIDES]
    sites = [spec.site(f"{side}_sole") for side in SIDES]
    soles = {
        "bodies": [foot.parent.name for foot in feet],
        "centre_m": _rounded(axes[feet[0].parent.name] @ sites[0].pos),
        "thickness_m": 2 * float(feet[0].size[2]),
    }
    shapes: dict[str, dict[str, Any]] = {}
    for geom in spec.geoms:
        if geom.group != PHYSICS_GROUP or geom in feet:
            continue
        side, _, name = geom.name.partition("_")
        body = geom.parent.name
        if side in SIDES:
            pair = shapes.setdefault(name, {"name": name, "bodies": ["", ""]})
            pair["bodies"][SIDES.index(side)] = body
            if side == "right":
                continue
        else:
            pair = shapes.setdefault(geom.name, {"name": geom.name, "body": body})
        pair |= _solid_document(geom, axes[body])
    return soles, list(shapes.values())


def _solid_document(geom: mujoco.MjsGeom, axes: np.ndarray) -> dict[str, Any]:
    import mujoco

    if geom.type == mujoco.mjtGeom.mjGEOM_CAPSULE:
        ends = geom.fromto.reshape(2, 3) @ axes.T
        return {"ends_m": [_rounded(end) for end in ends], "radius_m": float(geom.size[0])}
    return {"centre_m": _rounded(axes @ geom.pos), "size_m": _rounded(2 * geom.size)}


def _rounded(point: Iterable[float]) -> list[float]:
    return [round(float(value), 12) for value in point]


def model_text(model: mujoco.MjModel, turn: np.ndarray | None = None) -> str:
    """MJCF of the bodies, masses and joints of a model, with every digit.

    MuJoCo's own writer keeps six. Angles are in radians, from where the model has the joints at
    first. With `turn` (3, 3), from the base's axes to the robot's, it has no free joint, and hangs
    on a body `TURNED_BASE` along the robot's axes where the two differ.
    """
    import mujoco

    root = ET.Element("mujoco", model="robot")
    ET.SubElement(root, "compiler", angle="radian")
    ET.SubElement(root, "option", integrator="implicitfast")
    elements = {0: ET.SubElement(root, "worldbody")}
    is_turned = turn is not None and not np.allclose(turn, np.eye(3))
    if is_turned:
        elements[0] = ET.SubElement(elements[0], "body", name=TURNED_BASE)
    for k in range(1, model.nbody):
        body, parent = model.body(k), int(model.body_parentid[k])
        pos, quat = body.pos, body.quat
        if turn is not None and not parent:
            pos, quat = np.zeros(3), quat_of(turn)
        element = ET.SubElement(
            elements[parent],
            "body",
            name=body.name or f"body_{k}",
            pos=_words(pos),
            quat=_words(quat),
        )
        elements[k] = element
        if body.mass[0] > 0:
            ET.SubElement(
                element,
                "inertial",
                pos=_words(body.ipos),
                quat=_words(body.iquat),
                mass=_words(body.mass),
                diaginertia=_words(body.inertia),
            )
        first, count = int(model.body_jntadr[k]), int(model.body_jntnum[k])
        for joint in range(first, first + count):
            is_free = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE
            if turn is None or not is_free:
                element.append(_joint_element(model, joint))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _joint_element(model: mujoco.MjModel, joint: int) -> ET.Element:
    import mujoco

    kinds = mujoco.mjtJoint
    names = {kinds.mjJNT_FREE: "free", kinds.mjJNT_SLIDE: "slide", kinds.mjJNT_BALL: "ball"}
    kind = mujoco.mjtJoint(int(model.jnt_type[joint]))
    element = ET.Element("joint", name=model.joint(joint).name or f"joint_{joint}")
    if kind in names:
        element.attrib["type"] = names[kind]
    if kind == kinds.mjJNT_FREE:
        return element
    dof = int(model.jnt_dofadr[joint])
    element.attrib["pos"] = _words(model.jnt_pos[joint])
    element.attrib["axis"] = _words(model.jnt_axis[joint])
    if model.jnt_limited[joint]:
        at_first = model.qpos0[model.jnt_qposadr[joint]]
        element.attrib["range"] = _words(model.jnt_range[joint] - at_first)
    for name, value in (
        ("damping", [model.dof_damping[dof]]),
        ("frictionloss", [model.dof_frictionloss[dof]]),
        ("armature", [model.dof_armature[dof]]),
    ):
        if np.any(value):
            element.attrib[name] = _words(value)
    return element


def _words(values: Iterable[float]) -> str:
    return " ".join(_number(float(value)) for value in np.ravel(np.asarray(values, float)))
