"""Portraits of robots, drawn in a process of their own where a GL library is."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from app.pictures.portrait import TILE_HEIGHT, TILE_WIDTH, VIEWS_DEG, main
from sim.gl import NO_GL

ROOT = Path(__file__).resolve().parent.parent


def draw(path: Path, *words: str) -> np.ndarray:
    command = [
        sys.executable,
        "-m",
        "app.pictures.portrait",
        "--robot",
        "hrp5p",
        "--image",
        str(path),
    ]
    done = subprocess.run([*command, *words], cwd=ROOT, capture_output=True, text=True, check=False)
    if done.stderr.strip() == f"error: {NO_GL}":
        pytest.skip(NO_GL)
    assert done.returncode == 0, done.stderr
    picture = cv2.imread(str(path))
    assert picture is not None
    return picture


def test_a_portrait_shows_the_robot_dressed_or_as_it_collides(tmp_path):
    dressed = draw(tmp_path / "dressed.png")
    shapes = draw(tmp_path / "shapes.png", "--shapes")
    assert dressed.shape == shapes.shape == (TILE_HEIGHT, TILE_WIDTH * len(VIEWS_DEG), 3)
    # The accents are orange; sky, floor and bare shapes have no such colour.
    for picture, coloured in ((dressed, True), (shapes, False)):
        blue, _, red = np.moveaxis(picture.astype(int), 2, 0)
        orange = red - blue > 60
        for tile in np.split(orange, len(VIEWS_DEG), axis=1):
            assert (tile.sum() > 100) == coloured


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--robot", "r2d2", "--image", "x.png"], "choose one of"),
        (["--image", "no/such/folder/x.png"], "not a folder"),
        (["--image", "x.pdf"], "must end in"),
        ([], "--image FILE must be given"),
    ],
)
def test_wrong_input_is_told_in_one_line(words, told, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert told in error
    assert error.count("\n") == 1
