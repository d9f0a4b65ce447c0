"""Boxes drawn as one solid: nothing inside, nothing missing outside."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from app.viewer.map_scene import solid


def mesh(boxes: list[list[float]], rise_m: float = 1.0) -> trimesh.Trimesh:
    vertices_m, faces = solid(np.array(boxes), base_m=0.0, rise_m=rise_m, cell_m=0.5)
    return trimesh.Trimesh(vertices_m, faces, process=False)


def test_two_boxes_that_touch_have_the_faces_of_one():
    # 2 x 1 m and 1 m high, cut in two: a lid in two pieces, and five upright faces less.
    drawn = mesh([[0.5, 0.5, 0.5, 0.5, 0.0], [1.5, 0.5, 0.5, 0.5, 0.0]])
    assert drawn.area == pytest.approx(2 * 1 + (2 + 1 + 2 + 1) * 1)
    assert len(drawn.faces) == 2 * (2 + 4)
    lo, hi = drawn.bounds
    assert (*lo, *hi) == pytest.approx((0, 0, 0, 2, 1, 1))


def test_the_higher_one_shows_what_the_lower_one_does_not_hide():
    drawn = mesh([[0.5, 0.5, 0.5, 0.5, 0.0], [1.5, 0.5, 0.5, 0.5, 0.5]])
    step = (drawn.triangles_center[:, 0] == 1.0) & (np.abs(drawn.face_normals[:, 0]) > 0.5)
    assert drawn.area_faces[step].sum() == pytest.approx(0.5)
    # It looks to where it is lower.
    assert drawn.face_normals[step, 0] == pytest.approx(-1)


def test_all_faces_look_outward():
    drawn = mesh([[-1.25, 3.0, 0.75, 0.5, 0.0]])
    away = drawn.triangles_center - (-1.25, 3.0, 0.5)
    assert len(away) == 10
    assert (np.einsum("fi,fi->f", drawn.face_normals, away) > 0.4).all()
