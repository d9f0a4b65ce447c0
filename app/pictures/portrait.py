"""Pictures of a robot standing: `python -m app.pictures.portrait --robot jvrc1 --image jvrc1.png`.

For whoever adds a robot and wants to see it, as it is dressed or as it collides.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np

from app.options import FileOption, RobotName, find_robot, parse_options
from app.output import PICTURE_ENDINGS, ExitCode, InputError, require_writable, write_picture
from app.pictures.canvas import Picture
from app.pictures.rendering import Recording, View, drawing
from sim.gl import NoGlError, prepare_gl
from sim.robot import PHYSICS_GROUP, VISUAL_GROUP, Robot

VIEWS_DEG = (180.0, 145.0, 90.0, 30.0)
TILE_WIDTH, TILE_HEIGHT = 360, 600


@dataclass(frozen=True, kw_only=True)
class PortraitOptions:
    """Which robot, and where the picture goes."""

    robot: RobotName = "jvrc1"
    """Which robot, such as jvrc1."""

    image: FileOption
    """The picture to write, such as jvrc1.png."""

    shapes: bool = False
    """Show the shapes that collide instead of the looks."""


def portrait(robot: Robot, *, shapes: bool = False) -> Picture:
    """The robot in half-sitting from the front, front right, right and back right, side by side.

    Raises:
        NoGlError: No GL library works here. Was `prepare_gl` called before MuJoCo's import?
    """
    from sim.scene import build_scene

    scene = build_scene(robot, timestep_s=0.001, visuals=True)
    model = scene.model
    if shapes:
        # With nothing in the group of the looks, the shapes that collide are drawn.
        model.geom_group[model.geom_group == VISUAL_GROUP] = PHYSICS_GROUP + 1
    recording = Recording(qpos=scene.standing_qpos[None], time_s=np.zeros(1))
    pictures = []
    for azimuth_deg in VIEWS_DEG:
        view = View(distance_m=2.7, azimuth_deg=azimuth_deg, elevation_deg=-8.0, height_m=0.88)
        with drawing(
            model, recording, view, width=TILE_WIDTH, height=TILE_HEIGHT, fine=True
        ) as drawer:
            pictures.append(drawer.draw(0))
    return np.hstack(pictures)


def main(words: list[str]) -> int:
    """Carries the command line out; returns the exit code."""
    program = "python -m app.pictures.portrait"
    try:
        options = parse_options(
            PortraitOptions, words, program=program, example=f"{program} --image robot.png"
        )
        require_writable(options.image, option="--image", endings=PICTURE_ENDINGS)
        robot = find_robot(options.robot)
        prepare_gl()
        write_picture(options.image, portrait(robot, shapes=options.shapes)[:, :, ::-1])
    except (InputError, NoGlError) as error:
        print(f"error: {error}", file=sys.stderr)
        return ExitCode.BAD_INPUT
    return ExitCode.DONE


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
