"""A robot file drafted from a published model, and what of it was guessed."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from planner.robot_model import BodyShape, FootShape
from sim.draft.legs import DraftError, Legs, Tree, find_legs
from sim.draft.posture import HalfSitting, half_sitting, hang_arms, ranges_of
from sim.draft.shapes import (
    Sole,
    find_sole,
    leg_shapes,
    name_shapes,
    points_of,
    trunk_shape,
    upper_shapes,
)
from sim.draft.steps import reachable_steps, stance_width_m, step_model_of, training_limits_of
from sim.draft.symmetry import make_symmetric
from sim.posture import reach_m, standing, state_at
from sim.robot import PHYSICS_GROUP, Robot
from sim.robot_file import FORMAT, read_robot
from sim.robot_file_text import (
    MODEL,
    TURNED_BASE,
    step_limits_document,
    step_model_document,
    write_robot,
)
from sim.scene import Scene, build_scene
from sim.source_model import SourceModel

# Servo gains of a robot of 60 kg, in N m/rad; in proportion to the mass.
_KP = {"hip_yaw": 200, "hip_roll": 200, "hip_pitch": 200, "knee": 250}
_KP_ANKLE, _MASS_KG, _KD_S = 80.0, 60.0, 0.1
# A servo at its limit is off its target by this much at least.
_LEAST_OFF_RAD = 0.5
_ARMATURE_PER_KG = 0.002
_SPEED_RAD_S = 12.0
_STEP_S, _DOUBLE_SHARE, _LEG_M = 1.1, 0.32, 0.8
_FALLEN_SHARE = 0.74
_TINY_KG = 1e-6


@dataclass(frozen=True, kw_only=True)
class DraftChoices:
    """What a person may decide instead of the draft: docs/adding-a-robot.md lists them."""

    name: str = ""
    forward: str = ""
    feet: tuple[str, ...] = ()
    sole_m: tuple[float, ...] = ()
    torque_limit_nm: float | None = None
    speed_limit_rad_s: float | None = None


@dataclass(frozen=True, kw_only=True)
class Draft:
    """A robot file as a document, the model beside it, and what was guessed or mended."""

    document: dict[str, Any]
    model: mujoco.MjModel
    turn: np.ndarray
    guessed: tuple[str, ...]

    def write(self, folder: Path) -> None:
        """Writes the robot file and its model.

        Raises:
            OSError: A file cannot be written.
        """
        write_robot(folder, self.document, self.model, self.turn)


def draft(
    source: SourceModel,
    choices: DraftChoices = DraftChoices(),
    meshes: Mapping[str, Any] | None = None,
) -> Draft:
    """The draft of a robot file; `meshes` is what that key shall hold.

    Raises:
        DraftError: It is no humanoid that can walk here, or its figures cannot be right; the
            message names the element and what would be right.
    """
    model = _compiled(source)
    guessed = list(source.mended)
    tree, legs = find_legs(model, forward=choices.forward, feet=choices.feet)
    guessed += legs.notes
    _check_masses(tree, legs)
    # Shapes that collide are made for the ground; those that are seen tell how wide a robot is.
    ground_points = points_of(tree, source.shapes, colliding=True)
    points = points_of(tree, source.shapes, colliding=False)
    pairs, told = make_symmetric(tree, legs)
    guessed += told
    ranges_rad = ranges_of(tree, legs)
    sole = _chosen_sole(choices, tree, legs, ground_points)
    guessed += sole.notes
    held_rad = hang_arms(tree, legs, pairs)
    sitting = half_sitting(tree, legs, sole, held_rad, ranges_rad)
    joints, told = _joint_rows(source, choices, tree, legs, ranges_rad, sitting)
    guessed += told
    upper = upper_shapes(tree, legs, pairs, points)
    if not upper:
        upper = [trunk_shape(tree)]
        guessed.append("shapes: the model shows nothing of the upper body; a capsule stands for it")
    shapes = name_shapes(tree, pairs, [*upper, *leg_shapes(tree, legs, points, sole)])
    name = choices.name or _plain(source.name)
    document = {
        "format": FORMAT,
        "name": name,
        "title": source.name,
        "model": MODEL,
        **({"meshes": dict(meshes)} if meshes else {}),
        "mass_kg": round(float(model.body_mass.sum()), 3),
        "height_m": 1.0,
        "bodies": _bodies(tree, legs),
        "head": {},
        "half_sitting": {
            "pelvis_height_m": round(sitting.pelvis_height_m, 4),
            "pelvis_pitch_deg": 0,
        },
        "fallen_height_m": round(_FALLEN_SHARE * sitting.pelvis_height_m, 2),
        "gait": _gait(_leg_m(tree, legs, sitting)),
        "joints": joints,
        "held_deg": {n: round(math.degrees(a), 2) for n, a in held_rad.items()},
        "soles": {
            "bodies": [tree.body_name(foot) for foot in legs.feet],
            "centre_m": np.round(sole.centre_m, 4).tolist(),
            "thickness_m": sole.thickness_m,
            **({"pitch_deg": round(math.degrees(sole.pitch_rad), 2)} if sole.pitch_rad else {}),
        },
        "shapes": shapes,
    }
    told = _fit(document, tree, legs, sitting, sole, points)
    return Draft(document=document, model=model, turn=tree.turn, guessed=(*guessed, *told))


def _plain(name: str) -> str:
    import re

    return re.sub(r"[^A-Za-z0-9_.-]+", "_", name).strip("_.-").lower() or "robot"


def _compiled(source: SourceModel) -> mujoco.MjModel:
    """The model with every body of its own, of which those without mass get next to none."""
    if not source.is_free:
        base = source.spec.worldbody.first_body()
        raise DraftError(
            f"body {'' if base is None else base.name} is fixed to the world: the base must be "
            "free; give it a <freejoint/>"
        )
    compiler = source.spec.compiler
    compiler.fusestatic, compiler.balanceinertia = False, True
    compiler.boundmass, compiler.boundinertia = 1e-9, 1e-12
    try:
        return source.spec.compile()
    except ValueError as error:
        raise DraftError(f"MuJoCo cannot use it: {' '.join(str(error).split())}") from None


def _check_masses(tree: Tree, legs: Legs) -> None:
    model = tree.model
    for leg in legs.joints:
        for joint in leg:
            body = int(model.jnt_bodyid[joint])
            if model.body_mass[body] < _TINY_KG:
                raise DraftError(
                    f"{tree.body_name(body)}, which {tree.joint_name(joint)} moves, has no mass: "
                    "give it an inertial"
                )
    mass_kg = float(model.body_mass.sum())
    if not 1.0 <= mass_kg <= 1000.0:
        raise DraftError(f"it weighs {mass_kg:g} kg, must be from 1 to 1000: masses must be in kg")


def _chosen_sole(
    choices: DraftChoices, tree: Tree, legs: Legs, points: Mapping[int, np.ndarray]
) -> Sole:
    if not choices.sole_m:
        return find_sole(tree, legs, points)
    length_m, width_m, depth_m = choices.sole_m
    return Sole(
        centre_m=np.array([length_m / 5, 0.0, -depth_m]),
        length_m=length_m,
        width_m=width_m,
        thickness_m=0.02,
        pitch_rad=0.0,
        notes=("the sole reaches 70 % of its length before the ankle: soles, centre_m",),
    )


def _bodies(tree: Tree, legs: Legs) -> dict[str, str]:
    is_turned = not np.allclose(tree.turn, np.eye(3))
    return {
        "pelvis": TURNED_BASE if is_turned else tree.body_name(tree.base),
        "left_leg": tree.body_name(legs.first[0]),
        "right_leg": tree.body_name(legs.first[1]),
    }


def _leg_m(tree: Tree, legs: Legs, sitting: HalfSitting) -> float:
    """From the axis of the hip to the sole, in half-sitting."""
    return sitting.pelvis_height_m + float(tree.anchor[legs.joint("hip_pitch"), 2])


def _gait(leg_m: float) -> dict[str, float]:
    """Durations of a step that grow as those of a pendulum of the leg's length."""
    step_s = _STEP_S * math.sqrt(leg_m / _LEG_M)
    double_s = round(20 * _DOUBLE_SHARE * step_s) / 20
    return {
        "single_support_s": round(20 * (step_s - double_s)) / 20,
        "double_support_s": max(double_s, 0.1),
    }


def _joint_rows(
    source: SourceModel,
    choices: DraftChoices,
    tree: Tree,
    legs: Legs,
    ranges_rad: np.ndarray,
    sitting: HalfSitting,
) -> tuple[list[dict[str, Any]], list[str]]:
    rows, told = [], []
    mass_kg = float(tree.model.body_mass.sum())
    armature_guess = round(_ARMATURE_PER_KG * mass_kg, 3)
    guesses: dict[str, list[str]] = {"speed_limit_rad_s": [], "armature_kg_m2": []}
    for k, role in enumerate(legs.roles):
        left, right = legs.joints[0][k], legs.joints[1][k]
        names = [tree.joint_name(left), tree.joint_name(right)]
        torque_nm = _limit(source.efforts_nm, names, choices.torque_limit_nm, "torque")
        speed_rad_s = _limit(source.speeds_rad_s, names, choices.speed_limit_rad_s, "speed")
        if speed_rad_s is None:
            speed_rad_s = _SPEED_RAD_S
            guesses["speed_limit_rad_s"].append(role)
        armature = float(tree.model.dof_armature[tree.model.jnt_dofadr[left]])
        if armature <= 0:
            armature = armature_guess
            guesses["armature_kg_m2"].append(role)
        assert torque_nm is not None
        low, high = _inner_degrees(ranges_rad[k])
        wished = _KP.get(role, _KP_ANKLE) * mass_kg / _MASS_KG
        kp = _two_digits(min(wished, torque_nm / _LEAST_OFF_RAD))
        rows.append(
            {
                "names": names,
                "role": role,
                "mirror_sign": legs.mirror_sign[k],
                "half_sitting_deg": round(math.degrees(float(sitting.angles_rad[k])), 2),
                "range_deg": [low, high],
                "kp_nm_per_rad": kp,
                "kd_nm_s_per_rad": round(_KD_S * kp, 3),
                "torque_limit_nm": torque_nm,
                "speed_limit_rad_s": speed_rad_s,
                "armature_kg_m2": armature,
            }
        )
    for key, roles in guesses.items():
        if roles:
            value = _SPEED_RAD_S if key == "speed_limit_rad_s" else armature_guess
            told.append(f"joints, {key}: {value:g}, as the model has none ({', '.join(roles)})")
    torques = {row["torque_limit_nm"] for row in rows}
    if len(torques) == 1 and choices.torque_limit_nm is None:
        told.append(
            f"joints, torque_limit_nm: all are {torques.pop():g} in the model, which may be a "
            "placeholder"
        )
    told.append("joints, kp and kd: by mass, and at most the torque limit at half a radian")
    return rows, told


def _inner_degrees(range_rad: Sequence[float]) -> tuple[float, float]:
    """The range in hundredths of a degree, which does not reach beyond it."""
    low, high = (math.degrees(float(end)) for end in range_rad)
    return math.ceil(round(100 * low, 6)) / 100, math.floor(round(100 * high, 6)) / 100


def _two_digits(value: float) -> float:
    return float(f"{value:.2g}")


def _limit(
    stated: Mapping[str, float], names: list[str], chosen: float | None, kind: str
) -> float | None:
    """The lower limit of the left and the right joint; None where the model states no speed."""
    if chosen is not None:
        return chosen
    if not any(name in stated for name in names):
        if kind == "speed":
            return None
        raise DraftError(
            f"joint {names[0]} has no torque limit: state its effort, or give --torque-limit NM, "
            "such as 150, for all joints of the legs"
        )
    for name in names:
        if stated.get(name, 1.0) <= 0:
            raise DraftError(
                f"the {kind} limit of joint {name} is {stated[name]:g}, must be above 0; or give "
                f"--{kind}-limit"
            )
    return min(stated[name] for name in names if name in stated)


def _fit(
    document: dict[str, Any],
    tree: Tree,
    legs: Legs,
    sitting: HalfSitting,
    sole: Sole,
    points: Mapping[int, np.ndarray],
) -> list[str]:
    """Fills in what is measured on the robot itself: head, height, body and steps."""
    leg_m = _leg_m(tree, legs, sitting)
    # Whole millimetres, and no more than the sole has.
    foot = FootShape(
        length_m=math.floor(1000 * sole.length_m + 1e-6) / 1000,
        width_m=math.floor(1000 * sole.width_m + 1e-6) / 1000,
    )
    document["head"] = _head(document, tree, legs, points)
    stance_m = stance_width_m(sitting.stance_m, foot)
    rough = step_model_of(
        leg_m=leg_m,
        stance_m=stance_m,
        foot=foot,
        body=BodyShape(length_m=1.0, width_m=1.0),
        share=0.4,
        inward=0.0,
    )
    document["step_model"] = step_model_document(rough)
    scene = build_scene(_robot_of(document, tree), timestep_s=0.001)
    document["height_m"] = round(_height_m(scene), 3)
    body = _body_shape(scene)
    model, share = reachable_steps(scene, leg_m=leg_m, stance_m=stance_m, foot=foot, body=body)
    document["step_model"] = step_model_document(model)
    limits = training_limits_of(model.limits, leg_m, foot)
    document["training_limits"] = step_limits_document(limits)
    told = [
        f"half_sitting: knees bent by {math.degrees(sitting.knee_bend_rad):.0f} degrees, the "
        "centre of mass above the soles' middle",
        f"step_model, limits: {share:.0%} of what suits a leg of {leg_m:.2f} m",
        "gait, fallen_height_m, body_margin_m: by leg length",
    ]
    if stance_m > sitting.stance_m + 0.005:
        told.append(
            f"step_model, stance_width_m: {stance_m:g}, wider than the feet hang "
            f"({sitting.stance_m:.3f}), for room between them"
        )
    return told


def _robot_of(document: Mapping[str, Any], tree: Tree) -> Robot:
    """The robot of a document, as it would be read from its file."""
    with tempfile.TemporaryDirectory() as folder:
        write_robot(Path(folder), document, tree.model, tree.turn)
        robot = read_robot(folder)
        spec = robot.build()
    return replace(robot, build=spec.copy)


def _head(
    document: Mapping[str, Any], tree: Tree, legs: Legs, points: Mapping[int, np.ndarray]
) -> dict[str, Any]:
    """The top of what is above the base, near the middle plane."""
    of_legs = {b for first in legs.first for b in tree.below(first)}
    best, height = tree.base, -math.inf
    for body, cloud in points.items():
        if body in of_legs:
            continue
        top = cloud[int(cloud[:, 2].argmax())] + tree.pos[body]
        is_middle = abs(tree.pos[body, 1]) < 0.02 and abs(cloud[:, 1].mean()) < 0.03
        if is_middle and top[2] > height:
            best, height = body, float(top[2])
    if height == -math.inf:
        return {"body": tree.body_name(tree.base), "point_m": [0, 0, 0.3]}
    cloud = points[best]
    x = float((cloud[:, 0].min() + cloud[:, 0].max()) / 2)
    z = float(cloud[:, 2].max() - min(0.05, np.ptp(cloud[:, 2]) / 4))
    return {"body": tree.body_name(best), "point_m": [round(x, 3), 0, round(z, 3)]}


def _height_m(scene: Scene) -> float:
    qpos = np.zeros(scene.model.nq)
    qpos[3] = 1.0
    data = state_at(scene, qpos)
    shapes = np.flatnonzero(
        (scene.model.geom_group == PHYSICS_GROUP) & (scene.model.geom_bodyid > 0)
    )
    top = max(data.geom_xpos[geom, 2] + reach_m(scene, data, int(geom))[2] for geom in shapes)
    return float(top - data.site("left_sole").xpos[2])


def _body_shape(scene: Scene) -> BodyShape:
    """A box around the upper body as it is held, centred between the soles, in whole cm."""
    data, reach = standing(scene), np.full(2, 0.05)
    for geom in range(scene.model.ngeom):
        if scene.model.geom_contype[geom] or not scene.model.geom_conaffinity[geom]:
            continue
        reach = np.maximum(reach, (np.abs(data.geom_xpos[geom]) + reach_m(scene, data, geom))[:2])
    length_m, width_m = (math.ceil(200 * float(r) + 0.5) / 100 for r in reach)
    return BodyShape(length_m=length_m, width_m=width_m)
