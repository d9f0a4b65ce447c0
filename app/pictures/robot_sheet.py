"""A page about a robot: in half-sitting with its joint axes, its soles, and a table of its joints.

For whoever drafts a robot and wants to see what was found. Drawn without a GL library.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from app.output import replacing
from app.pictures.canvas import BODY, LEFT, RIGHT, FloatArray, hex_of
from sim.robot import PHYSICS_GROUP, VISUAL_GROUP, Robot

if TYPE_CHECKING:
    import mujoco

    from sim.scene import Scene

_WIDTH_IN, _VIEWS_IN, _LEGEND_IN, _DPI = 14.0, 6.6, 0.3, 110
_ROW_IN, _LINE_IN = 0.24, 0.15  # of the table, of what was guessed
_VIEWS = (("from the front", (1, 2), 1), ("from its right", (0, 2), 1), ("from below", (0, 1), 1))
_AXIS_M = 0.09  # half the length of a joint's axis as it is drawn
# Of joints' axes, by the axis of the world that they lie along: x, y, z.
_COLOURS = {"roll": "#b03030", "pitch": "#3050b0", "yaw": "#2a7f3f"}
_COLUMNS = (
    *("joint, left", "role", "sign", "half-sitting °", "range °", "kp N m/rad", "kd", "torque N m"),
    *("speed rad/s", "armature kg m²"),
)


def write_robot_sheet(path: Path, robot: Robot, guessed: Sequence[str] = ()) -> None:
    """Draws the page into an image file, PNG or JPEG.

    Raises:
        OSError: The file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from sim.posture import standing
    from sim.scene import build_scene

    scene = build_scene(robot, timestep_s=0.001, visuals=True)
    data = standing(scene)
    rows = _rows(robot)
    table_in = _ROW_IN * (len(rows) + 2)
    text_in = _LINE_IN * (len(guessed) + 1) if guessed else 0.0
    heights_in = (_LEGEND_IN, _VIEWS_IN, table_in + text_in)
    size_in = (_WIDTH_IN, sum(heights_in))
    figure = Figure(figsize=size_in, dpi=_DPI, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(3, 3, height_ratios=heights_in)
    figure.suptitle(
        f"{robot.title}: {robot.mass_kg:g} kg, {robot.height_m:g} m, pelvis at "
        f"{robot.pelvis_height_m:g} m in half-sitting"
    )
    for column, (title, plane, sign) in enumerate(_VIEWS):
        axes = figure.add_subplot(grid[1, column])
        axes.set_title(title)
        _draw_view(axes, scene, data, plane, sign)
    _draw_legend(figure.add_subplot(grid[0, :]))
    below = figure.add_subplot(grid[2, :])
    _draw_table(below, rows)
    lines = ["Guessed:", *(f"- {line}" for line in guessed)] if guessed else []
    place = 1 - table_in / heights_in[-1]
    below.text(0.0, place, "\n".join(lines), va="top", fontsize=8, transform=below.transAxes)
    content = BytesIO()
    figure.savefig(content, format="jpg" if path.suffix.lower() in (".jpg", ".jpeg") else "png")
    with replacing(path) as temporary:
        temporary.write_bytes(content.getvalue())


def _draw_legend(axes: Any) -> None:
    """What the colours mean, above the views: words beside what is drawn would cover it."""
    from matplotlib.lines import Line2D

    lines = {"left": hex_of(LEFT), "right": hex_of(RIGHT), "middle": hex_of(BODY)}
    lines |= {f"{kind} axis": colour for kind, colour in _COLOURS.items()}
    handles = [Line2D([], [], color=colour, label=name) for name, colour in lines.items()]
    handles.append(
        Line2D([], [], color="black", marker="P", markersize=9, linewidth=0, label="centre of mass")
    )
    axes.axis("off")
    axes.legend(handles=handles, loc="center", ncols=len(handles), frameon=False, fontsize=9)


def _draw_view(
    axes: Any, scene: Scene, data: mujoco.MjData, plane: tuple[int, int], sign: int
) -> None:
    """The robot projected on a plane of the world, x to the right times the sign."""
    model, flip = scene.model, np.array([sign, 1.0])
    is_below = plane == (0, 1)
    for geom in range(model.ngeom):
        if not model.geom_bodyid[geom] or model.geom_group[geom] not in (
            PHYSICS_GROUP,
            VISUAL_GROUP,
        ):
            continue
        name = model.geom(geom).name
        is_sole = name in ("left_foot", "right_foot")
        if is_below and not (is_sole or _is_of_foot(model, geom)):
            continue
        points = _points(model, data, geom)
        outline = cv2.convexHull((points[:, plane] * flip).astype(np.float32))[:, 0]
        if model.geom_group[geom] == VISUAL_GROUP:
            axes.fill(*outline.T, color="#d8dade", linewidth=0, zorder=1)
            continue
        side = LEFT if name.startswith("left_") else RIGHT if name.startswith("right_") else BODY
        axes.plot(*_closed(outline).T, color=hex_of(side), linewidth=1.0 + is_sole, zorder=3)
    if not is_below:
        _draw_axes(axes, scene, data, plane, flip)
    com = data.body("pelvis").subtree_com[list(plane)] * flip
    axes.plot(*com, marker="P", color="black", markersize=9, zorder=6)
    if not is_below:
        axes.axhline(0, color="#888888", linewidth=0.8, zorder=0)
    axes.set_aspect("equal")
    axes.locator_params(axis="x", nbins=4)
    axes.set_xlabel(f"{'-' if sign < 0 else ''}{'xyz'[plane[0]]}, m")
    axes.set_ylabel(f"{'xyz'[plane[1]]}, m")
    if is_below:
        axes.invert_yaxis()


def _is_of_foot(model: mujoco.MjModel, geom: int) -> bool:
    feet = [model.geom(f"{side}_foot").bodyid[0] for side in ("left", "right")]
    return bool(model.geom_bodyid[geom] in feet)


def _draw_axes(
    axes: Any, scene: Scene, data: mujoco.MjData, plane: tuple[int, int], flip: FloatArray
) -> None:
    """The axis of every joint as a line, or a point where it comes out of the plane."""
    for joint in scene.robot.joints:
        of_joint = data.joint(joint.name)
        kind = tuple(_COLOURS)[int(np.abs(of_joint.xaxis).argmax())]
        ends = np.array([of_joint.xanchor + step * of_joint.xaxis for step in (-_AXIS_M, _AXIS_M)])
        shown = ends[:, list(plane)] * flip
        style = {"color": _COLOURS[kind], "zorder": 5}
        axes.plot(*shown.T, linewidth=1.6, **style)
        axes.plot(*shown.mean(axis=0), marker="o", markersize=3, **style)


def _points(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> FloatArray:
    """Points (n, 3) in the world whose hull is the geom's."""
    import mujoco

    kind, size = mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        local = np.asarray(model.mesh_vert[first : first + count], float)
    elif kind in (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_ELLIPSOID):
        turns = np.linspace(0, math.pi, 9), np.linspace(0, 2 * math.pi, 17)
        across, around = (grid.ravel() for grid in np.meshgrid(*turns))
        ball = np.column_stack(
            [np.sin(across) * np.cos(around), np.sin(across) * np.sin(around), np.cos(across)]
        )
        local = ball * size
        if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
            way = np.array([0, 0, size[1]])
            local = np.concatenate([size[0] * ball - way, size[0] * ball + way])
    else:
        corners = np.array(np.meshgrid(*3 * [[-1.0, 1.0]])).reshape(3, -1).T
        local = corners * np.where(size > 0, size, size[0])
    world: FloatArray = local @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
    return world


def _closed(outline: FloatArray) -> FloatArray:
    return np.concatenate([outline, outline[:1]])


def _rows(robot: Robot) -> list[tuple[str, ...]]:
    """What the table tells of each joint of the left leg."""
    from sim.scene import build_scene

    model = build_scene(robot, timestep_s=0.001).model
    rows = []
    for joint in robot.joints[: len(robot.joints) // 2]:
        low, high = np.degrees(model.joint(joint.name).range)
        rows.append(
            (
                *(joint.name, joint.role or "-", f"{joint.mirror_sign:+d}"),
                f"{math.degrees(joint.half_sitting_rad):.1f}",
                f"{low:.0f} to {high:.0f}",
                *(f"{v:g}" for v in (joint.kp, joint.kd, joint.torque_limit_nm)),
                *(f"{v:.3g}" for v in (joint.speed_limit_rad_s, joint.armature_kg_m2)),
            )
        )
    return rows


def _draw_table(axes: Any, rows: Sequence[tuple[str, ...]]) -> None:
    axes.axis("off")
    table = axes.table(cellText=rows, colLabels=_COLUMNS, loc="upper center", cellLoc="center")
    table.auto_set_font_size(False)
    table.set_fontsize(8)
    table.auto_set_column_width(list(range(len(_COLUMNS))))
