"""Films and strips of walks, drawn with a GL library by processes of their own."""

from __future__ import annotations

import numpy as np
import pytest

from app.pictures import film
from tests.programs import drawn_by, picture_at

# How a program that draws begins: without a GL library it ends with one line.
WITH_GL = """
import sys
from pathlib import Path
from app.pictures.rendering import Recording
from sim.gl import NoGlError, prepare_gl
try:
    prepare_gl()
except NoGlError as error:
    sys.exit(str(error))
"""

DRAW = (
    WITH_GL
    + """
import mujoco, numpy as np
from app.pictures.film import write_strip
from app.pictures.film import write_film
model = mujoco.MjModel.from_xml_string('''
<mujoco>
  <worldbody>
    <light pos="0 0 5" dir="0 0 -1"/>
    <geom type="plane" size="0 0 1" rgba="0 1 0 1"/>
    <geom type="box" pos="1 -1.5 0.5" size="0.5 0.05 0.5" rgba="0 0 0 1"/>
    <body pos="0 0 0.75"><freejoint/><geom type="sphere" size="0.3" rgba="1 0 0 1"/></body>
  </worldbody>
</mujoco>''')
qpos = np.zeros((81, 7))
qpos[:, 0] = np.linspace(0, 2, 81)
qpos[:, 2], qpos[:, 3] = 0.75, 1
recording = Recording(qpos=qpos, time_s=np.arange(81) / 40)
folder = Path(sys.argv[1])
write_strip(folder / "strip.png", model, recording, frames=4, width=100, height=80)
heights = model.geom_size[:, 2].copy()
print(write_film(folder / "film.mp4", model, recording, width=160, height=120))
print(write_film(folder / "slow.mp4", model, recording, width=64, height=64, frames_per_s=10))
assert (model.geom_size[:, 2] == heights).all()
"""
)


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """Folder with a strip and a film."""
    folder = tmp_path_factory.mktemp("drawn")
    assert drawn_by("-c", DRAW, folder).split() == ["61", "21"]
    return folder


def is_red(picture: np.ndarray) -> np.ndarray:
    blue, green, red = np.moveaxis(picture.astype(int), -1, 0)
    return (red > 60) & (red > 2 * green) & (red > 2 * blue)


def test_a_strip_shows_the_robot_in_every_tile_and_through_walls(drawn):
    strip = picture_at(drawn / "strip.png")
    assert strip.shape == (80, 400, 3)
    for tile_at in range(0, 400, 100):
        # The camera follows: the robot is in the middle of each tile, also behind the wall.
        assert is_red(strip[30:50, tile_at + 40 : tile_at + 60]).mean() > 0.5


@pytest.mark.parametrize("codec", ["h264", "vp9"])
def test_a_film_shows_the_pictures_given_to_it(tmp_path, monkeypatch, capsys, codec):
    import av

    if codec == "vp9":
        monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    # Red on top; below blue that gives way to green from picture to picture.
    pictures = np.zeros((8, 64, 96, 3), np.uint8)
    pictures[:, :32, :, 0] = 255
    for number, picture in enumerate(pictures):
        picture[32:, : 12 * number, 1] = picture[32:, 12 * number :, 2] = 255
    with film.encoder(tmp_path / "film.mp4", 96, 64, 10) as add:
        for picture in pictures:
            add(picture)
    assert ("film" in capsys.readouterr().err) == (codec == "vp9")
    with av.open(str(tmp_path / "film.mp4")) as container:
        stream = container.streams.video[0]
        assert stream.codec_context.name == codec
        assert stream.average_rate == 10
        shown = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
    assert len(shown) == len(pictures)
    for picture, frame in zip(pictures, shown, strict=True):
        # Half as many pixels have a colour of their own, and nothing is exact.
        assert np.mean(np.abs(picture.astype(int) - frame)) < 12


def test_a_film_has_the_frames_of_the_walk(drawn):
    import av

    with av.open(str(drawn / "film.mp4")) as film:
        stream = film.streams.video[0]
        assert stream.codec_context.name == "h264"
        assert stream.average_rate == 30
        frames = [frame.to_ndarray(format="bgr24") for frame in film.decode(stream)]
    assert len(frames) == 61
    assert frames[0].shape == (120, 160, 3)
    assert is_red(frames[0]).any()
    assert is_red(frames[-1]).any()


PRINTS = (
    WITH_GL
    + """
from app.pictures.rendering import Footmark, View, drawing
from planner.robot_model import FootShape, Side
import cv2, mujoco, numpy as np
model = mujoco.MjModel.from_xml_string('''
<mujoco>
  <worldbody>
    <light pos="0 -4 5" dir="0 4 -5"/>
    <geom type="plane" size="9 9 1" rgba="0.85 0.86 0.88 1"/>
    <body pos="0 5 0.3"><freejoint/><geom type="sphere" size="0.1"/></body>
  </worldbody>
</mujoco>''')
qpos = np.array([[0, 0, 0.3, 1, 0, 0, 0.0]])
foot = FootShape(length_m=0.4, width_m=0.4)
marks = [
    Footmark(foot=foot, side=side, pose_world=np.array([x, y, 0.0, 0.0]), is_placed=y > 0, from_s=0)
    for side, x in ((Side.LEFT, 0.5), (Side.RIGHT, -0.5)) for y in (-0.5, 0.5)
]
view = View(azimuth_deg=0.0, elevation_deg=-89.9, height_m=0.0)
above = Recording(qpos=qpos, time_s=np.zeros(1))
for name, fine in (("strip", True), ("film", False)):
    with drawing(model, above, view, width=240, height=240, fine=fine, marks=marks) as drawer:
        model.geom_rgba[1, 3] = 0.0
        cv2.imwrite(str(Path(sys.argv[1]) / f"{name}.png"), drawer.draw(0)[:, :, ::-1])
"""
)


@pytest.mark.parametrize("name", ["strip", "film"])
def test_planned_prints_are_paler_than_placed_ones_in_strips_and_films(tmp_path, name):
    drawn_by("-c", PRINTS, tmp_path)
    picture = picture_at(tmp_path / f"{name}.png").astype(float)
    # As seen from above with x up: planned ones on the right, left feet on top.
    pixels_per_m = 240 / 2 / (3.2 * np.tan(np.radians(22.5)))
    at = np.rint(120 + pixels_per_m * 0.5 * np.array([-1, 1])).astype(int)
    tiles = {(v, u): picture[v - 5 : v + 6, u - 5 : u + 6] for v in at for u in at}
    grey = {place: tile.mean(axis=2) for place, tile in tiles.items()}
    for v in at:
        placed, planned = grey[v, at[0]], grey[v, at[1]]
        assert planned.min() > placed.max() + 20
        # Even: not speckled by shadows.
        assert np.ptp(planned) < 8
