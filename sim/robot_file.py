"""Robots from files: a folder with `robot.yaml` and the MuJoCo model that it names.

docs/robot-file.md tells of every key. Points, shapes and soles are given from the origin of their
body along the axes of the pelvis with all joints at 0 (x forward, y left, z up), so that left and
right are mirror images whatever the axes of the model's bodies. Reading loads no MuJoCo.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from maps.yaml_files import Section, YamlFileError, read_yaml
from planner.robot_model import (
    STEP_MODEL_NEEDS,
    StepLimits,
    StepModel,
    step_limits_of,
    step_model_of,
)
from sim.file_model import FileModel, MeshSource, PlacedShape, Soles
from sim.joint_roles import ROLES
from sim.robot import GaitTiming, LegJoint, Robot
from sim.solids import Box, Solid, Vector, capsule

FILE = "robot.yaml"
FORMAT = "robot/1"

_OPTIONAL = ("title", "meshes", "held_deg", "steady_pressure_share", "training_limits")
_PHYSICAL = (
    *("model", "mass_kg", "height_m", "bodies", "head", "half_sitting", "fallen_height_m"),
    *("gait", "joints", "soles", "shapes"),
)
KEYS = ("format", "name", *_PHYSICAL, "step_model", *_OPTIONAL)
_BODIES = ("pelvis", "left_leg", "right_leg")
_JOINT = (
    *("names", "role", "mirror_sign", "half_sitting_deg", "range_deg", "kp_nm_per_rad"),
    *("kd_nm_s_per_rad", "torque_limit_nm", "speed_limit_rad_s", "armature_kg_m2"),
)
# What a policy learns from. Titles, pictures and the steps of plans may change under it.
_LEARNED = (
    "name",
    "bodies",
    "head",
    "half_sitting",
    "gait",
    "joints",
    "held_deg",
    "soles",
    "shapes",
)


def is_robot_file(name: str) -> bool:
    """Whether `--robot NAME` names a folder with a robot file, or such a file itself."""
    return Path(name).name == FILE or Path(name).is_dir()


def file_of(name: str | Path) -> Path:
    """The robot file that a folder holds, or that is named itself."""
    return Path(name) if Path(name).name == FILE else Path(name) / FILE


def read_step_model(name: str | Path) -> tuple[str, StepModel] | None:
    """Name and step model of a robot file without a model, or None of one that has a model.

    Plans need no more than the keys `name` and `step_model`.

    Raises:
        YamlFileError: The file cannot be read, or a key or value is wrong.
    """
    document = _read(file_of(name))
    if "model" in document:
        return None
    document.check_keys(("name", "step_model"), KEYS)
    return _name(document), _step_model(document)


def read_robot(name: str | Path) -> Robot:
    """The robot of a file.

    Raises:
        YamlFileError: A file cannot be read, a key is missing or unknown, or a value is wrong.
    """
    path = file_of(name)
    document = _read(path)
    if "model" not in document:
        raise YamlFileError(f"{path}: key 'model' is missing; only `plan` does without")
    document.check_keys([key for key in KEYS if key not in _OPTIONAL], KEYS)
    named, step_model = _name(document), _step_model(document)
    model_path = path.parent / document.text("model")
    names = _model_names(model_path)
    joints, ranges_rad = _joints(document, names["joint"])
    pelvis, left, right = _bodies(document, names["body"])
    head = document.section("head", ("body", "point_m"), ("body", "point_m"))
    half_sitting = document.section("half_sitting", *2 * [("pelvis_height_m", "pelvis_pitch_deg")])
    gait = document.section("gait", *2 * [("single_support_s", "double_support_s")])
    model = FileModel(
        path=model_path,
        bodies={"pelvis": pelvis, "left_leg": left, "right_leg": right},
        joints=tuple(ranges_rad),
        ranges_rad=ranges_rad,
        held_rad=_held(document, names["joint"], ranges_rad),
        soles=_soles(document, names["body"], step_model),
        shapes=_shapes(document, names["body"]),
        head=(_known(head, "body", names["body"]), _point(head, "point_m")),
        meshes=_meshes(document),
    )
    return Robot(
        name=named,
        title=document.text("title", named),
        step_model=step_model,
        gait=GaitTiming(**{key: gait.number(key, above=0.0) for key in gait.values}),
        joints=joints,
        mass_kg=document.number("mass_kg", above=0.0),
        height_m=document.number("height_m", above=0.0),
        pelvis_height_m=half_sitting.number("pelvis_height_m", above=0.0),
        pelvis_pitch_rad=math.radians(half_sitting.number("pelvis_pitch_deg")),
        fallen_height_m=document.number("fallen_height_m", above=0.0),
        build=model.build,
        add_meshes=None if model.meshes is None else model.add_meshes,
        training_limits=_training_limits(document),
        steady_pressure_share=document.number(
            "steady_pressure_share", above=0.0, default=Robot.steady_pressure_share
        ),
        folder=path.parent,
        digest=_digest(document, model_path),
    )


def _read(path: Path) -> Section:
    document = read_yaml(path)
    document.check_keys(("format",))
    if document.values["format"] != FORMAT:
        raise document.error("format", f"must be {FORMAT}")
    return document


def _name(document: Section) -> str:
    name = document.text("name")
    if not re.fullmatch(r"[A-Za-z0-9][\w.-]*", name):
        # Policies and folders are named after it.
        raise document.error("name", "must be letters, digits, dots, - and _ alone, such as talos")
    return name


def _step_model(document: Section) -> StepModel:
    """The step model of a robot file: its keys are those of step models in docs/ros.md."""
    return step_model_of(document.section("step_model", STEP_MODEL_NEEDS))


def _training_limits(document: Section) -> StepLimits | None:
    if "training_limits" not in document:
        return None
    return step_limits_of(document, "training_limits")


def _model_names(path: Path) -> dict[str, set[str]]:
    """Names of the bodies and joints of a model in MuJoCo's format."""
    try:
        root = ET.parse(path).getroot()
    except OSError as error:
        raise YamlFileError(f"{path}: cannot be read: {error.strerror}") from None
    except ET.ParseError as error:
        raise YamlFileError(f"{path}: not XML: {error}") from None
    if root.tag != "mujoco":
        raise YamlFileError(f"{path}: must be a model of MuJoCo, <mujoco>, not <{root.tag}>")
    return {tag: {e.get("name", "") for e in root.iter(tag)} for tag in ("body", "joint")}


def _point(section: Section, key: str) -> Vector:
    x, y, z = section.numbers(key, 3, "[0.03, 0, -0.1]")
    return x, y, z


def _known(section: Section, key: str, names: Iterable[str]) -> str:
    name = section.text(key)
    if name not in names:
        raise section.error(key, "must be a body of the model")
    return name


def _pair(section: Section, key: str, names: Iterable[str], example: str) -> tuple[str, str]:
    left, right = section.texts(key, 2, example)
    for name in (left, right):
        if name not in names:
            raise section.error(key, f"names {name!r}, which the model does not have")
    return left, right


def _bodies(document: Section, names: set[str]) -> tuple[str, str, str]:
    section = document.section("bodies", _BODIES, _BODIES)
    pelvis, left, right = (_known(section, key, names) for key in _BODIES)
    if len({pelvis, left, right}) < 3:
        raise document.error("bodies", "must be three different bodies")
    return pelvis, left, right


def _joints(
    document: Section, names: set[str]
) -> tuple[tuple[LegJoint, ...], dict[str, tuple[float, float]]]:
    """The joints of both legs, and their ranges by name."""
    rows = document.rows("joints")
    if len(rows) not in (5, 6):
        raise YamlFileError(
            f"{document.path}: joints has {len(rows)} rows, must have 6 from the hip down, or 5 "
            "of a leg without ankle roll"
        )
    legs: tuple[list[LegJoint], list[LegJoint]] = ([], [])
    ranges_rad: list[dict[str, tuple[float, float]]] = [{}, {}]
    for row in rows:
        row.check_keys(_JOINT, _JOINT)
        sign = row.whole("mirror_sign")
        if sign not in (1, -1):
            raise row.error("mirror_sign", "must be 1 or -1")
        role = row.text("role")
        if role not in ROLES:
            raise row.error("role", f"must be one of {', '.join(ROLES)}")
        low_deg, high_deg = row.interval("range_deg", "[-30, 90]")
        angle_deg = row.number("half_sitting_deg")
        if not low_deg < high_deg:
            raise row.error("range_deg", "must be LOW, HIGH with LOW < HIGH")
        if not low_deg < angle_deg < high_deg:
            raise row.error("half_sitting_deg", f"must lie within range_deg {low_deg}, {high_deg}")
        pair = _pair(row, "names", names, "[left_knee, right_knee]")
        for side, (name, side_sign) in enumerate(zip(pair, (1, sign), strict=True)):
            low, high = sorted((side_sign * low_deg, side_sign * high_deg))
            ranges_rad[side][name] = math.radians(low), math.radians(high)
            legs[side].append(
                LegJoint(
                    name=name,
                    kp=row.number("kp_nm_per_rad", above=0.0),
                    kd=row.number("kd_nm_s_per_rad", above=0.0),
                    torque_limit_nm=row.number("torque_limit_nm", above=0.0),
                    speed_limit_rad_s=row.number("speed_limit_rad_s", above=0.0),
                    armature_kg_m2=row.number("armature_kg_m2", at_least=0.0),
                    half_sitting_rad=math.radians(side_sign * angle_deg),
                    mirror_sign=sign,
                    role=role,
                )
            )
    for key, values in (
        ("role", [row.text("role") for row in rows]),
        ("names", [joint.name for leg in legs for joint in leg]),
    ):
        for value in values:
            if values.count(value) > 1:
                raise YamlFileError(f"{document.path}: joints: {key} {value!r} is there twice")
    return (*legs[0], *legs[1]), ranges_rad[0] | ranges_rad[1]


def _held(document: Section, names: set[str], moved: Mapping[str, object]) -> dict[str, float]:
    if "held_deg" not in document:
        return {}
    section = document.section("held_deg")
    for name in section.values:
        if name not in names:
            raise YamlFileError(f"{document.path}: held_deg: the model has no joint {name!r}")
        if name in moved:
            raise YamlFileError(f"{document.path}: held_deg: {name!r} is one of `joints`")
    return {name: math.radians(section.number(name)) for name in section.values}


def _soles(document: Section, names: set[str], step_model: StepModel) -> Soles:
    needed = ("bodies", "centre_m", "thickness_m")
    section = document.section("soles", needed, (*needed, "pitch_deg"))
    return Soles(
        bodies=_pair(section, "bodies", names, "[left_foot, right_foot]"),
        centre_m=_point(section, "centre_m"),
        size_m=(
            step_model.foot.length_m,
            step_model.foot.width_m,
            section.number("thickness_m", above=0.0),
        ),
        pitch_rad=math.radians(section.number("pitch_deg", default=0.0)),
    )


def _shapes(document: Section, names: set[str]) -> tuple[PlacedShape, ...]:
    shapes = []
    for row in document.rows("shapes"):
        row.check_keys(("name",))
        on = "bodies" if "bodies" in row else "body"
        sizes = ("ends_m", "radius_m") if "ends_m" in row else ("centre_m", "size_m")
        row.check_keys((on, *sizes), ("name", on, *sizes))
        bodies = (
            _pair(row, "bodies", names, "[left_thigh, right_thigh]")
            if on == "bodies"
            else (_known(row, "body", names),)
        )
        shapes.append(PlacedShape(name=row.text("name"), bodies=bodies, solid=_solid(row)))
    taken = [name for shape in shapes for name in shape.names]
    for name in taken:
        if taken.count(name) > 1 or name in ("left_foot", "right_foot"):
            raise YamlFileError(f"{document.path}: shapes: the name {name!r} is taken")
    return tuple(shapes)


def _solid(row: Section) -> Solid:
    if "ends_m" in row:
        ends = row.points("ends_m", 3)
        if len(ends) != 2 or ends[0] == ends[1]:
            raise row.error("ends_m", "must be two different points [x, y, z]")
        return capsule(ends[0], ends[1], row.number("radius_m", above=0.0))
    size = _point(row, "size_m")
    if min(size) <= 0:
        raise row.error("size_m", "must be above 0")
    return Box(centre=_point(row, "centre_m"), size=size)


def _meshes(document: Section) -> MeshSource | None:
    if "meshes" not in document:
        return None
    section = document.section("meshes", ("file",), ("file", "packages"))
    packages: dict[str, str] = {}
    if "packages" in section:
        folders = section.section("packages")
        packages = {name: folders.text(name) for name in folders.values}
    return MeshSource(
        file=section.text("file"), packages=packages, folder=document.path.parent.absolute()
    )


def _digest(document: Section, model_path: Path) -> str:
    """Hexadecimal digest of what a policy for this robot learns from."""
    learned: dict[str, Any] = {key: document.values.get(key) for key in _LEARNED}
    learned["foot"] = document.values["step_model"]["foot"]
    digest = hashlib.sha256(json.dumps(learned, sort_keys=True).encode())
    digest.update(model_path.read_bytes())
    return digest.hexdigest()
