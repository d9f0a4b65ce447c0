"""The robot as ROS names it: a URDF made from the compiled model, and its frames over time."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from app.ros.messages import MAP_FRAME
from sim.robot import PHYSICS_GROUP
from sim.scene import Scene
from sim.sensors import SIDES

ROOT_FRAME = "pelvis"
_RGBA = "0.75 0.77 0.80 1"

# parent frame, child frame, position (3,) in m, quaternion (4,) w, x, y, z
FrameTransform = tuple[str, str, np.ndarray, np.ndarray]


class RobotFrames:
    """The frames of a robot: a body is a link of its name, a sole is `left_sole`, `right_sole`.

    `urdf` is the text of `robot_description`. Its shapes are those that the physics collides, so
    that it needs no other file.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._data = mujoco.MjData(scene.model)
        root = int(scene.model.body(ROOT_FRAME).id)
        of_robot = np.flatnonzero(scene.model.body_rootid == root)
        self._bodies = [int(body) for body in of_robot if body != root]
        self.urdf = _urdf(scene, [root, *self._bodies])

    def place(self, qpos: np.ndarray) -> None:
        """Moves the robot to a state qpos (nq,), about which the other functions tell then."""
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self.scene.model, self._data)

    def fixed(self) -> Iterator[FrameTransform]:
        """Links without a joint, and the soles."""
        model = self.scene.model
        for body in self._bodies:
            if model.body_jntnum[body] == 0:
                yield (*self._names(body), model.body_pos[body], model.body_quat[body])
        for side in SIDES:
            site = model.site(f"{side}_sole")
            parent = model.body(int(site.bodyid[0])).name
            yield parent, f"{side}_sole", np.array(site.pos), np.array(site.quat)

    def moving(self) -> Iterator[FrameTransform]:
        """The pelvis in the map, and every link that has a joint in its parent."""
        data, model = self._data, self.scene.model
        root = data.body(ROOT_FRAME)
        yield MAP_FRAME, ROOT_FRAME, root.xpos.copy(), root.xquat.copy()
        for body in self._bodies:
            if model.body_jntnum[body] == 0:
                continue
            parent = int(model.body_parentid[body])
            back, quat = np.zeros(4), np.zeros(4)
            mujoco.mju_negQuat(back, data.xquat[parent])
            mujoco.mju_mulQuat(quat, back, data.xquat[body])
            away = data.xpos[body] - data.xpos[parent]
            yield (*self._names(body), data.xmat[parent].reshape(3, 3).T @ away, quat)

    def in_sole(self, side: int, vector_world: np.ndarray) -> np.ndarray:
        """A vector (3,) of the world in the axes of the left (0) or right (1) sole."""
        turned: np.ndarray = (
            self._data.site(f"{SIDES[side]}_sole").xmat.reshape(3, 3).T @ vector_world
        )
        return turned

    def _names(self, body: int) -> tuple[str, str]:
        model = self.scene.model
        return model.body(int(model.body_parentid[body])).name, model.body(body).name


def _urdf(scene: Scene, bodies: list[int]) -> str:
    model = scene.model
    limits = {joint.name: joint for joint in scene.robot.joints}
    root = ET.Element("robot", name=scene.robot.name)
    for body in bodies:
        link = ET.SubElement(root, "link", name=model.body(body).name)
        _add_inertia(link, model, body)
        for geom in np.flatnonzero(
            (model.geom_bodyid == body) & (model.geom_group == PHYSICS_GROUP)
        ):
            _add_visuals(link, model, int(geom))
    for body in bodies[1:]:
        hinges = _hinges(model, body)
        kind = "revolute" if hinges else "floating" if model.body_jntnum[body] else "fixed"
        name = model.joint(hinges[0]).name if hinges else f"{model.body(body).name}_{kind}"
        joint = ET.SubElement(root, "joint", name=name, type=kind)
        parent = model.body(int(model.body_parentid[body])).name
        ET.SubElement(joint, "parent", link=parent)
        ET.SubElement(joint, "child", link=model.body(body).name)
        _add_origin(joint, model.body_pos[body], model.body_quat[body])
        if hinges:
            ET.SubElement(joint, "axis", xyz=_text(model.jnt_axis[hinges[0]]))
            is_limited = bool(model.jnt_limited[hinges[0]])
            low, high = model.jnt_range[hinges[0]] if is_limited else (-math.pi, math.pi)
            servo = limits.get(name)
            ET.SubElement(
                joint,
                "limit",
                lower=f"{low:.6g}",
                upper=f"{high:.6g}",
                effort=f"{servo.torque_limit_nm if servo else 0.0:.6g}",
                velocity=f"{servo.speed_limit_rad_s if servo else 0.0:.6g}",
            )
    for side in SIDES:
        site = model.site(f"{side}_sole")
        ET.SubElement(root, "link", name=f"{side}_sole")
        joint = ET.SubElement(root, "joint", name=f"{side}_sole_fixed", type="fixed")
        ET.SubElement(joint, "parent", link=model.body(int(site.bodyid[0])).name)
        ET.SubElement(joint, "child", link=f"{side}_sole")
        _add_origin(joint, site.pos, site.quat)
    ET.indent(root)
    return '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _hinges(model: mujoco.MjModel, body: int) -> list[int]:
    """The body's one hinge in its own origin, which URDF has a word for; else none."""
    first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    is_hinge = count == 1 and model.jnt_type[first] == mujoco.mjtJoint.mjJNT_HINGE
    return [first] if is_hinge and np.allclose(model.jnt_pos[first], 0) else []


def _add_inertia(link: ET.Element, model: mujoco.MjModel, body: int) -> None:
    inertial = ET.SubElement(link, "inertial")
    _add_origin(inertial, model.body_ipos[body], model.body_iquat[body])
    ET.SubElement(inertial, "mass", value=f"{model.body_mass[body]:.6g}")
    xx, yy, zz = (f"{value:.6g}" for value in model.body_inertia[body])
    ET.SubElement(inertial, "inertia", ixx=xx, iyy=yy, izz=zz, ixy="0", ixz="0", iyz="0")


def _add_visuals(link: ET.Element, model: mujoco.MjModel, geom: int) -> None:
    """The shape of a geom; a capsule is a cylinder and two spheres, a mesh the box around it."""
    kind, size = mujoco.mjtGeom(int(model.geom_type[geom])), model.geom_size[geom]
    pos, quat = model.geom_pos[geom], model.geom_quat[geom]
    along = np.zeros(9)
    mujoco.mju_quat2Mat(along, quat)
    turn = along.reshape(3, 3)
    if kind in (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_CYLINDER):
        _add_shape(link, pos, quat, "cylinder", radius=size[0], length=2 * size[1])
        for end in (-1, 1) if kind is mujoco.mjtGeom.mjGEOM_CAPSULE else ():
            _add_shape(link, pos + end * size[1] * turn[:, 2], quat, "sphere", radius=size[0])
    elif kind is mujoco.mjtGeom.mjGEOM_SPHERE:
        _add_shape(link, pos, quat, "sphere", radius=size[0])
    elif kind is mujoco.mjtGeom.mjGEOM_BOX:
        _add_shape(link, pos, quat, "box", size=2 * size)
    else:
        centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        _add_shape(link, pos + turn @ centre, quat, "box", size=2 * half)


def _add_shape(
    link: ET.Element, pos: np.ndarray, quat: np.ndarray, kind: str, **sizes: ArrayLike
) -> None:
    visual = ET.SubElement(link, "visual")
    _add_origin(visual, pos, quat)
    shape = {name: _text(np.atleast_1d(value)) for name, value in sizes.items()}
    ET.SubElement(ET.SubElement(visual, "geometry"), kind, shape)
    material = ET.SubElement(visual, "material", name="robot")
    ET.SubElement(material, "color", rgba=_RGBA)


def _add_origin(parent: ET.Element, pos: np.ndarray, quat: np.ndarray) -> None:
    ET.SubElement(parent, "origin", xyz=_text(pos), rpy=_text(roll_pitch_yaw(quat)))


def roll_pitch_yaw(quat: ArrayLike) -> np.ndarray:
    """Fixed-axis angles (3,) about x, y, z of a quaternion w, x, y, z, as URDF writes them."""
    w, x, y, z = np.asarray(quat, float) / np.linalg.norm(quat)
    pitch = math.asin(float(np.clip(2 * (w * y - z * x), -1, 1)))
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return np.array([roll, pitch, yaw])


def _text(values: ArrayLike) -> str:
    return " ".join(f"{value + 0.0:.6g}" for value in np.asarray(values, float))
