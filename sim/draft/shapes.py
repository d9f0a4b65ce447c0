"""Soles and collision shapes of a draft, fitted to the shapes of the model."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from sim.draft.legs import MIRROR, DraftError, Legs, Tree
from sim.source_model import SourceShape

_SOLE_BAND_M = 0.002  # how far above its lowest points the sole still is
_STEEPEST = np.tan(np.radians(40))
_LEAST_M = 0.05  # smaller shapes of the upper body are left out
_LARGEST_MESH_M = 10.0
_GAP_M = 0.03  # between the legs' shapes at rest


@dataclass(frozen=True, kw_only=True)
class Sole:
    """The box under the left foot, in the robot's axes from the origin of the foot's body."""

    centre_m: np.ndarray
    length_m: float
    width_m: float
    thickness_m: float
    pitch_rad: float
    notes: tuple[str, ...] = ()


def points_of(
    tree: Tree, shapes: Iterable[SourceShape], *, colliding: bool
) -> dict[int, np.ndarray]:
    """The vertices (N, 3) on every body in the robot's axes from its origin.

    Of shapes that collide, or that are seen, where a body has such; else of all that it has.

    Raises:
        DraftError: A mesh is so large that its unit must be millimetres.
    """
    clouds: dict[int, dict[bool, list[np.ndarray]]] = {}
    for shape in shapes:
        body = tree.model.body(shape.body).id
        if len(shape.vertices) and np.ptp(shape.vertices, axis=0).max() > _LARGEST_MESH_M:
            size_m = np.ptp(shape.vertices, axis=0).max()
            raise DraftError(
                f"a mesh of {shape.body} is {size_m:.0f} m large: it seems to be in millimetres; "
                'give it scale="0.001 0.001 0.001"'
            )
        own = clouds.setdefault(body, {True: [], False: []})
        is_preferred = shape.collides if colliding else shape.is_visual
        own[is_preferred].append(shape.vertices @ tree.axes[body].T)
    return {
        body: np.concatenate(own[True] or own[False]) for body, own in clouds.items() if body > 0
    }


def find_sole(tree: Tree, legs: Legs, points: Mapping[int, np.ndarray]) -> Sole:
    """The lowest flat part of the left foot's shapes, as a box.

    Raises:
        DraftError: The foot has no shapes.
    """
    found = [_sole_of(tree, legs, points, side) for side in (0, 1)]
    left, right = found
    notes = []
    off_m = np.abs(left.centre_m - right.centre_m * MIRROR).max()
    off_m = max(off_m, abs(left.length_m - right.length_m), abs(left.width_m - right.width_m))
    if off_m > 0.005:
        notes.append(f"the soles differ by {1000 * off_m:.0f} mm between left and right: the mean")
    if left.length_m < left.width_m:
        notes.append("the sole is wider than long")
    return Sole(
        centre_m=(left.centre_m + right.centre_m * MIRROR) / 2,
        length_m=(left.length_m + right.length_m) / 2,
        width_m=(left.width_m + right.width_m) / 2,
        thickness_m=0.02,
        pitch_rad=(left.pitch_rad + right.pitch_rad) / 2,
        notes=tuple(notes),
    )


def _sole_of(tree: Tree, legs: Legs, points: Mapping[int, np.ndarray], side: int) -> Sole:
    foot = legs.feet[side]
    clouds = [
        points[body] + tree.pos[body] - tree.pos[foot]
        for body in tree.below(foot)
        if body in points
    ]
    if not clouds:
        raise DraftError(
            f"the foot {tree.body_name(foot)} has no shapes from which to find its sole: name a "
            "file with meshes, or give --sole LENGTH,WIDTH,DEPTH in m"
        )
    cloud = np.concatenate(clouds)
    pitch_rad = _pitch_of_underside(cloud)
    cos, sin = np.cos(pitch_rad), np.sin(pitch_rad)
    level = np.array([[cos, 0, -sin], [0, 1, 0], [sin, 0, cos]])  # from robot to sole axes
    flat = cloud @ level.T
    lowest = flat[:, 2].min()
    band = flat[flat[:, 2] <= lowest + _SOLE_BAND_M]
    low, high = band.min(axis=0), band.max(axis=0)
    centre = level.T @ np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, lowest])
    return Sole(
        centre_m=centre,
        length_m=float(high[0] - low[0]),
        width_m=float(high[1] - low[1]),
        thickness_m=0.02,
        pitch_rad=pitch_rad,
    )


def _pitch_of_underside(cloud: np.ndarray) -> float:
    """How far the toes are lower than the heel: the slope of the longest edge from below."""
    edges = lower_hull(cloud[:, [0, 2]])
    runs = np.diff(edges, axis=0)
    gentle = runs[np.abs(runs[:, 1]) <= _STEEPEST * np.abs(runs[:, 0])]
    if not len(gentle):
        return 0.0
    run = gentle[int(np.hypot(*gentle.T).argmax())]
    pitch = -float(np.arctan2(run[1], run[0]))
    # A capsule's underside is a row of short edges; a sole is one long edge.
    is_sole = np.hypot(*run) > 0.3 * np.ptp(cloud[:, 0])
    return pitch if is_sole and abs(pitch) > np.radians(0.5) else 0.0


def lower_hull(points: np.ndarray) -> np.ndarray:
    """The lower edge (k, 2) of the convex hull of points (N, 2), from left to right."""
    hull: list[np.ndarray] = []
    for point in points[np.lexsort((points[:, 1], points[:, 0]))]:
        while len(hull) > 1:
            (ax, ay), (bx, by) = hull[-1] - hull[-2], point - hull[-2]
            if ax * by - ay * bx > 0:
                break
            hull.pop()
        hull.append(point)
    return np.array(hull)


def leg_shapes(
    tree: Tree, legs: Legs, points: Mapping[int, np.ndarray], sole: Sole
) -> list[dict[str, object]]:
    """Capsules of thigh and shank, clear of each other, and of the ground, at rest."""
    shapes: list[dict[str, object]] = []
    knee, ankle = legs.joint("knee"), legs.joint("ankle_pitch")
    spans = (
        ("thigh", legs.joint("hip_pitch"), knee),
        ("shank", knee, ankle),
    )
    floor_z = tree.pos[legs.feet[0], 2] + sole.centre_m[2]
    for name, upper, lower in spans:
        body = int(tree.model.body_parentid[tree.model.jnt_bodyid[lower]])
        while body not in points and body != tree.base:
            body = int(tree.model.body_parentid[body])
        first, last = tree.anchor[upper], tree.anchor[lower]
        moved = int(tree.model.jnt_bodyid[upper])
        if body in points and moved in _above(tree, body):
            ends, radius = _capsule_around(points[body] + tree.pos[body], first, last)
        else:
            body = int(tree.model.body_parentid[tree.model.jnt_bodyid[lower]])
            ends, radius = np.array([first, last]), 0.12 * float(np.linalg.norm(last - first))
        # Room to the other leg, of which this is the mirror image.
        radius = min(radius, max(float(ends[:, 1].min()) - _GAP_M / 2, 0.02))
        lift = floor_z + 0.05 + radius - ends[1, 2]
        if lift > 0 and ends[0, 2] - ends[1, 2] > lift:
            ends[1] += (ends[0] - ends[1]) * lift / (ends[0, 2] - ends[1, 2])
        image = int(tree.model.jnt_bodyid[legs.joints[1][0]])
        shapes.append(
            {
                "name": name,
                "bodies": [tree.body_name(body), ""],
                "ends_m": [list(end - tree.pos[body]) for end in ends],
                "radius_m": radius,
                "of": (body, image),
            }
        )
    return shapes


def _above(tree: Tree, body: int) -> set[int]:
    found = set()
    while body > 0:
        found.add(body)
        body = int(tree.model.body_parentid[body])
    return found


def _capsule_around(
    cloud: np.ndarray, first: np.ndarray, last: np.ndarray
) -> tuple[np.ndarray, float]:
    """Ends (2, 3) and radius of a capsule along a line that holds nearly all points."""
    along = (last - first) / np.linalg.norm(last - first)
    place = (cloud - first) @ along
    inside = cloud[(place > 0.1 * place.max()) & (place < np.linalg.norm(last - first))]
    inside = inside if len(inside) > 10 else cloud
    place = (inside - first) @ along
    beside = inside - first - np.outer(place, along)
    offset = (beside.max(axis=0) + beside.min(axis=0)) / 2
    radius = float(np.percentile(np.linalg.norm(beside - offset, axis=1), 85))
    low, high = np.percentile(place, [2, 98])
    low, high = (
        min(low + radius, (low + high) / 2 - 0.01),
        max(high - radius, (low + high) / 2 + 0.01),
    )
    return first + offset + np.outer([low, high], along), radius


def upper_shapes(
    tree: Tree, legs: Legs, pairs: Mapping[int, int], points: Mapping[int, np.ndarray]
) -> list[dict[str, object]]:
    """A box or capsule for each large body of the upper body; pairs are fitted on the left."""
    of_legs = {b for first in legs.first for b in tree.below(first)}
    shapes: list[dict[str, object]] = []
    for body in tree.below(tree.base):
        image = pairs[body]
        is_right = image not in (0, body) and tree.pos[body, 1] < tree.pos[image, 1]
        is_same_place = image not in (0, body) and np.isclose(tree.pos[body, 1], tree.pos[image, 1])
        if body in of_legs or body not in points or is_right or (is_same_place and body > image):
            continue
        cloud = points[body]
        if image == body:
            # Its mirror image too, about the middle plane of the robot.
            cloud = np.concatenate([cloud, cloud * MIRROR])
        low, high = np.percentile(cloud, [1, 99], axis=0)
        size = np.maximum(high - low, 0.01)
        if size.max() < _LEAST_M or np.sort(size)[1] < _LEAST_M / 2:
            continue
        shape: dict[str, object] = {"name": "", "of": (body, image)}
        order = np.argsort(size)
        if size[order[2]] > 1.6 * size[order[1]]:
            radius = float(size[order[:2]].mean() / 2)
            ends = np.tile((low + high) / 2, (2, 1))
            reach = max(size[order[2]] / 2 - radius, 0.01)
            ends[:, order[2]] += [-reach, reach]
            shape |= {"ends_m": [list(end) for end in ends], "radius_m": radius}
        else:
            shape |= {"centre_m": list((low + high) / 2), "size_m": list(size)}
        shapes.append(shape)
    return shapes


def trunk_shape(tree: Tree) -> dict[str, object]:
    """A capsule from the base to the highest body, for a model without shapes."""
    top_m = max(float(tree.pos[1:, 2].max()), 0.4)
    ends = [[0.0, 0.0, 0.12], [0.0, 0.0, top_m]]
    return {"name": "trunk", "of": (tree.base, tree.base), "ends_m": ends, "radius_m": 0.12}


def name_shapes(
    tree: Tree, pairs: Mapping[int, int], shapes: Iterable[dict[str, object]]
) -> list[dict[str, object]]:
    """The rows of `shapes` in a robot file: bodies by name, numbers in mm, names made unique."""
    rows: list[dict[str, object]] = []
    taken: set[str] = set()
    for shape in shapes:
        body = shape["of"][0]  # type: ignore[index]
        image = pairs[body]
        row: dict[str, object] = {"name": str(shape["name"]) or _plain(tree, body, image)}
        while row["name"] in taken:
            row["name"] = f"{row['name']}_2"
        taken.add(str(row["name"]))
        names = [tree.body_name(body)]
        if image not in (0, body):
            names.append(tree.body_name(image))
        row |= {"bodies": names} if len(names) == 2 else {"body": names[0]}
        for key in ("ends_m", "radius_m", "centre_m", "size_m"):
            if key in shape:
                row[key] = np.round(np.asarray(shape[key], float), 3).tolist()
        rows.append(row)
    return rows


def _plain(tree: Tree, body: int, image: int) -> str:
    """A name for a shape: that of its body, of a pair what both names have in common."""
    name = tree.body_name(body)
    words = re.split(r"[^A-Za-z0-9]+", name)
    others = re.split(r"[^A-Za-z0-9]+", tree.body_name(image)) if image else words
    common_words = [one for one, other in zip(words, others, strict=False) if one == other]
    if common_words and len(words) == len(others):
        name = "_".join(common_words)
    elif image not in (0, body):
        other = tree.body_name(image)
        start = next((k for k, (a, b) in enumerate(zip(name, other, strict=False)) if a != b), 0)
        tail = 0
        while tail < min(len(name), len(other)) - start and name[-1 - tail] == other[-1 - tail]:
            tail += 1
        common = f"{name[:start]} {name[len(name) - tail :]}"
        name = re.sub(r"[^A-Za-z0-9]+", "_", common).strip("_") or name
    name = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_").lower()
    # Names that begin with a side would be taken for those of pairs.
    return re.sub(r"^(left|right)_", "", name) or "shape"
