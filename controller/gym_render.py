"""Pictures of the walking task: one robot with its meshes and its next two steps."""

from __future__ import annotations

import importlib
import math
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from planner.robot_model import Side
from sim.gl import NoGlError, prepare_gl
from sim.robot import PHYSICS_GROUP, VISUAL_GROUP
from sim.scene import Scene, build_scene

# Of pictures, in pixels.
WIDTH, HEIGHT = 640, 480
COLOURS = {Side.LEFT: (0.12, 0.43, 0.78, 1.0), Side.RIGHT: (0.94, 0.47, 0.16, 1.0)}
PLATE_THICKNESS_M = 0.004


@dataclass(frozen=True, kw_only=True)
class RenderState:
    """State of all robots for drawing.

    `qpos` is (B, nq), `window` (B, 2, 4) the present and the next step in the world, `side` (B,)
    the foot of the present one. `ground` is as `Simulation.ground_pose` gives it.
    """

    qpos: np.ndarray
    window: np.ndarray
    side: np.ndarray
    ground: tuple[np.ndarray, np.ndarray] | None


class SceneRenderer:
    """Draws one robot with its meshes and its next two steps.

    It makes its own GL context: `mujoco.Renderer` depends on MUJOCO_GL when MuJoCo was imported.
    """

    def __init__(self, scene: Scene):
        """Prepare to draw the robot of a scene on its ground.

        Raises:
            NoGlError: no GL library works here.
        """
        self._context = _gl_context()
        robot = scene.robot
        self._foot = robot.step_model.foot
        self._model = build_scene(
            robot, timestep_s=scene.model.opt.timestep, visuals=True, treads=scene.has_treads
        ).model
        self._model.vis.quality.offsamples = 0  # smooth edges take most of the time in software
        self._model.vis.headlight.ambient[:] = 0.2
        self._data = mujoco.MjData(self._model)
        self._scene = mujoco.MjvScene(self._model, 2000)
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            self._scene.flags[flag] = False
        self._shown = mujoco.MjvOption()
        has_meshes = np.any(self._model.geom_group == VISUAL_GROUP)
        self._shown.geomgroup[PHYSICS_GROUP] = not has_meshes
        self._camera = mujoco.MjvCamera()
        self._camera.distance = 1.5 * robot.height_m
        self._camera.azimuth, self._camera.elevation = 70.0, -18.0
        self._renderer = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._renderer)

    def draw(self, moment: RenderState, row: int) -> np.ndarray:
        """Image (HEIGHT, WIDTH, 3), RGB, of robot `row`."""
        self._context.make_current()
        qpos, window, side = moment.qpos[row], moment.window[row], Side(int(moment.side[row]))
        self._data.qpos[:] = qpos
        if moment.ground is not None:
            self._data.mocap_pos[:] = moment.ground[0][row]
            self._data.mocap_quat[:] = moment.ground[1][row]
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        self._camera.lookat[:] = qpos[:3]
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(
            self._model, self._data, self._shown, None, self._camera, everything, self._scene
        )
        self._add_plate(window[0], side)
        self._add_plate(window[1], side.other)
        picture = np.empty((HEIGHT, WIDTH, 3), np.uint8)
        frame = mujoco.MjrRect(0, 0, WIDTH, HEIGHT)
        mujoco.mjr_render(frame, self._scene, self._renderer)
        mujoco.mjr_readPixels(picture, None, frame, self._renderer)
        return np.ascontiguousarray(picture[::-1])  # OpenGL counts rows from below

    def close(self) -> None:
        """Free the GL context; may be called again."""
        if self._context is not None:
            self._context.make_current()
            self._renderer.free()
            self._context.free()
            self._context = None

    def _add_plate(self, pose_world: np.ndarray, side: Side) -> None:
        """Add a coloured plate at the target of a foot."""
        x, y, z, yaw = pose_world
        cos, sin = math.cos(yaw), math.sin(yaw)
        plate = self._scene.geoms[self._scene.ngeom]
        mujoco.mjv_initGeom(
            plate,
            mujoco.mjtGeom.mjGEOM_BOX.value,
            np.array([self._foot.length_m / 2, self._foot.width_m / 2, PLATE_THICKNESS_M]),
            np.array([x, y, z]),
            np.array([cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0]),
            np.array(COLOURS[side], np.float32),
        )
        self._scene.ngeom += 1


def _gl_context() -> Any:
    """A current GL context from the library that works here."""
    way = prepare_gl()
    try:
        module = importlib.import_module(f"mujoco.{way}" if way else "mujoco")
        context = module.GLContext(WIDTH, HEIGHT)
        context.make_current()
    except Exception as error:
        # Each way fails in its own manner: ImportError, RuntimeError, GLError, FatalError.
        raise NoGlError from error
    return context
