"""What every robot must keep, as checks that measure it and say which key mends what is wrong.

Keys are those of `robot.yaml`; the fields of `sim/robot.py` have nearly the same names.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from maps.boxes import Terraces
from sim.batch import SimBatch
from sim.joint_roles import RoleError, roles_in
from sim.posture import (
    SPARE_RAD,
    PostureError,
    joint_ranges,
    loop_residual,
    mirrored_qpos,
    mirrored_qvel,
    planned_steps,
    reach_m,
    standing,
    state_at,
    step_spare_rad,
)
from sim.robot import PHYSICS_GROUP, VISUAL_GROUP, Robot
from sim.scene import WALL_HEIGHT_M, Scene, build_scene, min_clearance_m
from sim.sensors import SIDES

_TIMESTEP_S = 0.001
_STANDING_S = 4.0


class Problems(list[str]):
    """Lines that tell what is wrong, and which key mends it."""

    def unless(self, is_right: bool | np.bool_, problem: str) -> None:
        """Adds the problem if it is one."""
        if not is_right:
            self.append(problem)


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What a check found: what it measured, and the problems, of which there should be none."""

    check: str
    measured: str
    problems: tuple[str, ...] = ()


@dataclass(frozen=True)
class Check:
    """A check by name. `look` adds problems, and returns what it measured in a few words."""

    name: str
    look: Callable[[Scene, Problems], str]

    def __call__(self, scene: Scene) -> Finding:
        """Carries it out."""
        problems = Problems()
        measured = self.look(scene, problems)
        return Finding(check=self.name, measured=measured, problems=tuple(problems))


def check_robot(robot: Robot) -> Iterator[Finding]:
    """The findings of all checks, as they come; of the model alone if it cannot be built."""
    try:
        scene = build_scene(robot, timestep_s=_TIMESTEP_S)
    except (ValueError, KeyError) as error:
        told = " ".join(str(error).split())
        yield Finding(check="model", measured="", problems=(f"it cannot be built: {told}: model",))
        return
    yield Finding(check="model", measured=f"{scene.model.nbody - 1} bodies that move or stand")
    for check in CHECKS:
        yield check(scene)


def _mass(scene: Scene, problems: Problems) -> str:
    mass_kg = float(scene.model.body_mass.sum())
    stated_kg = scene.robot.mass_kg
    problems.unless(
        abs(mass_kg - stated_kg) <= 0.05,
        f"the model has {mass_kg:.2f} kg, the file says {stated_kg:g}: mass_kg",
    )
    return f"{mass_kg:.2f} kg"


def _joints(scene: Scene, problems: Problems) -> str:
    robot, model = scene.robot, scene.model
    joints, half = robot.joints, len(robot.joints) // 2
    stated = len(joints) + sum(len(joint.mirror_sign) for joint in robot.passive)
    problems.unless(
        model.nv == 6 + stated and model.nu == len(joints),
        f"{model.nv - 6} joints move and {stated} are stated: joints",
    )
    ranges = joint_ranges(scene)
    for joint, (low, high) in zip(joints, ranges, strict=True):
        is_limited = bool(model.joint(joint.name).limited[0]) and low < high
        problems.unless(is_limited, f"{joint.name} has no range: joints, range_deg")
        problems.unless(
            low < joint.half_sitting_rad < high,
            f"{joint.name} is at {np.degrees(joint.half_sitting_rad):.1f} degrees in half-sitting, "
            f"out of its range: joints, half_sitting_deg or range_deg",
        )
    fields = ("kp", "kd", "torque_limit_nm", "speed_limit_rad_s", "armature_kg_m2")
    for left, right, of_left, of_right in zip(
        joints[:half], joints[half:], ranges[:half], ranges[half:], strict=True
    ):
        mirrored = of_left if left.mirror_sign > 0 else -of_left[::-1]
        problems.unless(
            bool(np.allclose(of_right, mirrored, rtol=0, atol=1e-6)),
            f"the range of {right.name} does not mirror that of {left.name}: joints, range_deg",
        )
        for name in fields:
            problems.unless(
                getattr(left, name) == getattr(right, name) > 0,
                f"{name} of {left.name} and {right.name} must be the same and above 0: joints",
            )
        problems.unless(
            right.half_sitting_rad == left.mirror_sign * left.half_sitting_rad,
            f"{right.name} does not mirror {left.name} in half-sitting: joints, half_sitting_deg",
        )
    for k, joint in enumerate(joints):
        body = int(model.joint(joint.name).bodyid[0])
        while body and model.body(body).name not in ("left_leg", "right_leg"):
            body = int(model.body_parentid[body])
        problems.unless(
            bool(body) and model.body(body).name == f"{SIDES[k // half]}_leg",
            f"{joint.name} is not in the {SIDES[k // half]} leg: bodies, {SIDES[k // half]}_leg",
        )
    passive = f", {len(robot.passive) // 2} passive" if robot.passive else ""
    return f"{half} in each leg{passive}"


def _roles(scene: Scene, problems: Problems) -> str:
    stated = [joint.role for joint in scene.robot.joints[: len(scene.robot.joints) // 2]]
    try:
        seen = roles_in(scene)
    except RoleError as error:
        problems.append(f"{error}: joints")
        return ""
    for role, found, joint in zip(stated, seen, scene.robot.joints, strict=False):
        problems.unless(
            role in ("", found),
            f"{joint.name} is called {role} and turns as a {found}: joints, role",
        )
    return ", ".join(seen)


def _half_sitting(scene: Scene, problems: Problems) -> str:
    soles = scene.soles_at(scene.standing_qpos)
    height_m = float(scene.standing_qpos[2])
    open_by = loop_residual(scene, standing(scene))
    problems.unless(open_by <= 1e-4, f"loops are open by {open_by:.1e} m or rad: passive joints")
    problems.unless(
        bool(np.abs(soles[:, 2]).max() <= 2e-4),
        f"one sole is {1000 * np.ptp(soles[:, 2]):.1f} mm higher than the other: "
        "joints, half_sitting_deg or mirror_sign",
    )
    problems.unless(
        abs(soles[0, 1] + soles[1, 1]) <= 1e-6, "the feet are not symmetric: soles or mirror_sign"
    )
    problems.unless(
        abs(height_m - scene.robot.pelvis_height_m) <= 2e-3,
        f"the pelvis is at {height_m:.4f} m, the file says {scene.robot.pelvis_height_m:g}: "
        "half_sitting, pelvis_height_m",
    )
    data = standing(scene)
    for side in SIDES:
        tilt = data.site(f"{side}_sole").xmat.reshape(3, 3)[:, 2] - [0, 0, 1]
        tilt_deg = np.degrees(np.abs(tilt).max())
        problems.unless(
            bool(np.abs(tilt).max() <= 2e-3),
            f"the {side} sole is {tilt_deg:.1f} degrees off the ground: hip pitch, knee and ankle "
            "pitch and pelvis_pitch_deg must add up to 0: joints, half_sitting_deg",
        )
    over_m = com_over_soles_m(scene, data)
    foot = scene.robot.step_model.foot
    problems.unless(
        abs(over_m) <= foot.length_m / 2,
        f"the centre of mass is {100 * over_m:.1f} cm before the middle of the soles, which are "
        f"{100 * foot.length_m:.0f} cm long: joints, half_sitting_deg",
    )
    return (
        f"pelvis at {height_m:.4f} m, centre of mass {100 * over_m:+.1f} cm from the soles' middle"
    )


def com_over_soles_m(scene: Scene, data: mujoco.MjData) -> float:
    """How far before the middle of the soles the centre of mass is, in half-sitting."""
    soles = np.mean([data.site(f"{side}_sole").xpos[0] for side in SIDES])
    return float(data.body("pelvis").subtree_com[0] - soles)


def _contacts(scene: Scene, problems: Problems) -> str:
    data = standing(scene, sunk_m=0.001)
    expected = {frozenset({"floor", f"{side}_foot"}) for side in SIDES}
    touching = {
        frozenset(scene.model.geom(geom).name for geom in contact.geom) for contact in data.contact
    }
    for pair in touching - expected:
        problems.append(f"{' and '.join(sorted(pair))} touch in half-sitting: shapes, or soles")
    for pair in expected - touching:
        problems.append(f"{' and '.join(sorted(pair))} do not touch in half-sitting: soles")
    return "only the soles touch the floor"


def _soles(scene: Scene, problems: Problems) -> str:
    foot = scene.robot.step_model.foot
    data = standing(scene)
    for side in SIDES:
        geom, site = scene.model.geom(f"{side}_foot"), data.site(f"{side}_sole")
        half_m = reach_m(scene, data, geom.id, site.xmat.reshape(3, 3))
        problems.unless(
            bool(np.allclose(2 * half_m[:2], [foot.length_m, foot.width_m], atol=1e-6)),
            f"the shape of the {side} foot is not the planner's foot: step_model, foot",
        )
        below_m = site.xmat.reshape(3, 3).T @ (site.xpos - data.geom_xpos[geom.id])
        problems.unless(
            bool(np.allclose(below_m, [0, 0, -half_m[2]], atol=1e-6)),
            f"the site of the {side} sole is not in the middle of its shape's underside: soles",
        )
    return f"{100 * foot.length_m:.1f} x {100 * foot.width_m:.1f} cm"


def _body_box(scene: Scene, problems: Problems) -> str:
    data, body = standing(scene), scene.robot.step_model.body
    most = np.zeros(2)
    for geom in range(scene.model.ngeom):
        # What the upper body alone is: it meets surroundings and no leg.
        if scene.model.geom_contype[geom] or not scene.model.geom_conaffinity[geom]:
            continue
        reach = (np.abs(data.geom_xpos[geom]) + reach_m(scene, data, geom))[:2]
        most = np.maximum(most, reach)
        for key, wide, half_m in zip(
            ("length_m", "width_m"), reach, (body.length_m / 2, body.width_m / 2), strict=True
        ):
            problems.unless(
                wide <= half_m + 1e-6,
                f"{scene.model.geom(geom).name} reaches {wide:.3f} m from the middle of the soles, "
                f"the box of the body {half_m:.3f}: step_model, body.{key}",
            )
    problems.unless(bool(most.all()), "there is no shape of the upper body: shapes")
    return f"shapes within {2 * most[0]:.2f} x {2 * most[1]:.2f} m"


def _height(scene: Scene, problems: Problems) -> str:
    upright = np.zeros(scene.model.nq)
    upright[3] = 1.0
    # Loops are closed in half-sitting, not where all joints are at 0.
    data = state_at(scene, scene.standing_qpos if scene.robot.passive else upright)
    shapes = np.flatnonzero(
        (scene.model.geom_group == PHYSICS_GROUP) & (scene.model.geom_bodyid > 0)
    )
    top = max(data.geom_xpos[geom, 2] + reach_m(scene, data, int(geom))[2] for geom in shapes)
    height_m = float(top - data.site("left_sole").xpos[2])
    problems.unless(
        abs(height_m - scene.robot.height_m) <= 0.02,
        f"it is {height_m:.3f} m high, the file says {scene.robot.height_m:g}: height_m or shapes",
    )
    head_m = data.site("head").xpos[2] - data.body("pelvis").xpos[2]
    problems.unless(head_m > 0, "the head is not above the pelvis: head")
    return f"{height_m:.2f} m"


def _fallen(scene: Scene, problems: Problems) -> str:
    robot = scene.robot
    share = robot.fallen_height_m / robot.pelvis_height_m
    problems.unless(
        0.5 <= share <= 0.9,
        f"{robot.fallen_height_m:g} m is {share:.0%} of the pelvis's height, should be about three "
        "quarters: fallen_height_m",
    )
    return f"below {robot.fallen_height_m:g} m, {share:.0%} of half-sitting"


def _mirrored_motion(scene: Scene, problems: Problems) -> str:
    """Off the ground, where no contact solver breaks the symmetry: the model itself is mirrored."""
    robot, rng = scene.robot, np.random.default_rng(2)
    index, sign = robot.mirror_joints
    qpos = scene.standing_qpos.copy()
    qpos[2] += 0.5
    qvel = 0.3 * rng.normal(size=scene.model.nv)
    targets = robot.half_sitting_rad + 0.2 * rng.normal(size=len(robot.joints))
    sim = SimBatch(scene, count=2, control_period_s=0.025)
    sim.reset(
        np.arange(2),
        np.stack([qpos, mirrored_qpos(scene, qpos)]),
        np.stack([qvel, mirrored_qvel(scene, qvel)]),
    )
    for _ in range(4):
        sim.step(np.stack([targets, sign * targets[index]]))
    off = np.abs(sim.qpos[1] - mirrored_qpos(scene, sim.qpos[0]))
    # Published inertias may differ between left and right in the sixth digit.
    problems.unless(
        bool(off.max() <= 1e-4),
        f"after 0.1 s the mirrored robot is {off.max():.1e} m or rad off the mirror image: "
        "mirror_sign, soles, or masses and inertias in the model",
    )
    moved = np.abs(sim.qpos[0] - mirrored_qpos(scene, sim.qpos[0])).max()
    problems.unless(bool(moved > 1e-2), "the targets move nothing: kp_nm_per_rad")
    return f"left and right differ by {off.max():.0e} m or rad after 0.1 s"


def _servos(scene: Scene, problems: Problems) -> str:
    robot, data = scene.robot, standing(scene)
    data.qvel[scene.joint_qvel] = 0.1
    data.ctrl[:] = robot.half_sitting_rad
    limits = np.array([joint.torque_limit_nm for joint in robot.joints])
    gains = np.array([[joint.kp, joint.kd] for joint in robot.joints])
    share = 0.2 * limits / gains[:, 0]
    data.ctrl[:] += share
    mujoco.mj_forward(scene.model, data)
    expected = np.clip(gains[:, 0] * share - 0.1 * gains[:, 1], -limits, limits)
    is_pd = np.allclose(data.actuator_force, expected)
    data.ctrl[:] = robot.half_sitting_rad + 1e3
    mujoco.mj_forward(scene.model, data)
    is_limited = np.allclose(data.actuator_force, limits)
    problems.unless(is_pd and is_limited, "torques are not kp (target - q) - kd dq: joints")
    return f"torques up to {limits.min():g} to {limits.max():g} N m"


def _crossed_legs(scene: Scene, problems: Problems) -> str:
    data = standing(scene)
    half, rolls = len(scene.robot.joints) // 2, 0
    for k, joint in enumerate(scene.robot.joints):
        forward = data.xaxis[scene.model.joint(joint.name).id][0]
        if abs(forward) > 0.8:
            side = 1 if k < half else -1
            data.qpos[scene.joint_qpos[k]] -= 0.3 * side * np.sign(forward)  # both feet inwards
            rolls += 1
    problems.unless(rolls >= 2, "no joint rolls the hips: joints")
    mujoco.mj_forward(scene.model, data)
    problems.unless(
        data.sensordata[scene.sensors.legs_touching][0] > 0,
        "legs that cross are not felt: shapes of the legs",
    )
    return "legs that cross are felt"


def _walls(scene: Scene, problems: Problems) -> str:
    """A wall 2 cm beside the robot is free, one 2 cm inside is felt, and both are measured."""
    widest_m = _widest_m(scene)
    for gap_m in (0.02, -0.02):
        # The wall's own frame is turned and shifted, as a map's may be.
        wall = np.array([[widest_m + gap_m + 0.05, 0.0, 0.05, 2.0, 0.0]])
        terraces = Terraces(walls=wall, origin=(0.0, 0.0, np.pi / 2))
        beside = build_scene(scene.robot, timestep_s=_TIMESTEP_S, terraces=terraces)
        data = standing(beside)
        is_felt = data.sensordata[beside.sensors.wall_contacts[0]] > 0
        measured = min_clearance_m(beside, beside.standing_qpos[None])
        problems.unless(
            is_felt == (gap_m < 0) and measured is not None and abs(measured - gap_m) <= 2e-3,
            f"a wall {100 * gap_m:+.0f} cm beside the robot is measured as {measured}: shapes",
        )
    return f"felt {widest_m:.2f} m to the side"


def _widest_m(scene: Scene) -> float:
    """Largest y of any collision shape whose widest point is below the walls' height."""
    data = standing(scene)
    return max(
        float(data.geom_xpos[geom, 1] + reach_m(scene, data, int(geom))[1])
        for geom in np.flatnonzero(scene.model.geom_conaffinity > 0)
        if data.geom_xpos[geom, 2] < WALL_HEIGHT_M
    )


def _reach(scene: Scene, problems: Problems) -> str:
    steps, least_rad = planned_steps(scene), np.inf
    for swing, step in itertools.product((0, 1), steps):
        told = f"step {[round(value, 3) for value in step]} of the {SIDES[swing]} foot"
        try:
            spare_rad, worst = step_spare_rad(scene, step, swing)
        except PostureError as error:
            problems.append(f"{told}: {error}: step_model, limits or steps")
            continue
        least_rad = min(least_rad, spare_rad)
        name = scene.robot.joints[worst].name
        problems.unless(
            spare_rad >= SPARE_RAD,
            f"{told}: {name} is {np.degrees(spare_rad):.1f} degrees inside its range, must be 2: "
            "step_model, limits or steps, or range_deg",
        )
    return f"{len(steps)} steps a foot, joints {np.degrees(least_rad):.0f} degrees off their ends"


def _looks(scene: Scene, problems: Problems) -> str:
    dressed = build_scene(scene.robot, timestep_s=_TIMESTEP_S, visuals=True).model
    fields = ("body_mass", "body_inertia", "body_ipos", "body_iquat", "body_pos", "body_quat")
    is_same = dressed.nbody == scene.model.nbody and all(
        np.array_equal(getattr(scene.model, name), getattr(dressed, name)) for name in fields
    )
    added = np.flatnonzero(dressed.geom_group == VISUAL_GROUP)
    is_same &= dressed.ngeom == scene.model.ngeom + len(added)
    is_same &= not (dressed.geom_contype[added].any() or dressed.geom_conaffinity[added].any())
    problems.unless(is_same, "its meshes change the physics: meshes")
    return f"{len(added)} meshes"


def _stands(scene: Scene, problems: Problems) -> str:
    """Whether it stands still under its servos alone. To fall is no fault: the policy balances."""
    data = standing(scene)
    data.ctrl[:] = scene.robot.half_sitting_rad
    while data.time < _STANDING_S:
        mujoco.mj_step(scene.model, data)
        if not np.isfinite(data.qpos).all():
            problems.append("the simulation blows up: gains, armature_kg_m2 or masses of the model")
            return ""
        if data.qpos[2] < scene.robot.fallen_height_m:
            return f"falls after {data.time:.1f} s, which is no fault: the policy balances"
    return f"stands for {_STANDING_S:g} s"


CHECKS = (
    Check("mass", _mass),
    Check("joints", _joints),
    Check("roles", _roles),
    Check("half-sitting", _half_sitting),
    Check("contacts at rest", _contacts),
    Check("soles", _soles),
    Check("body box", _body_box),
    Check("height", _height),
    Check("fallen height", _fallen),
    Check("mirror image", _mirrored_motion),
    Check("servos", _servos),
    Check("crossed legs", _crossed_legs),
    Check("walls", _walls),
    Check("reach of the steps", _reach),
    Check("meshes", _looks),
    Check("standing", _stands),
)
