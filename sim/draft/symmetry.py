"""A model made the mirror image of itself: pairs of bodies averaged, the others centred.

Published masses, inertias and places differ between left and right by rounding, and by cables and
boards; a policy is trained for both sides at once.
"""

from __future__ import annotations

import mujoco
import numpy as np

from sim.draft.legs import MIRROR, Legs, Tree

_NEAR_M = 0.03
_TOLD_SHARE = 0.02  # of the mass or of the size of the robot


def mirror_pairs(tree: Tree, legs: Legs) -> dict[int, int]:
    """For every body below the base its mirror image: another body, itself, or 0 for none."""
    pairs = {tree.base: tree.base, 0: 0}
    for left, right in zip(*legs.joints, strict=True):
        one, other = int(tree.model.jnt_bodyid[left]), int(tree.model.jnt_bodyid[right])
        pairs[one], pairs[other] = other, one
    for body in tree.below(tree.base):
        if body in pairs:
            _pair_children(tree, body, pairs[body], pairs)
    return {body: pairs.get(body, 0) for body in tree.below(tree.base)}


def _pair_children(tree: Tree, body: int, image: int, pairs: dict[int, int]) -> None:
    if not image:
        return
    left = [c for c in tree.children(image) if c not in pairs]
    for child in tree.children(body):
        if child in pairs:
            continue
        wanted = tree.pos[child] * MIRROR
        alike = [
            other
            for other in left
            if tree.model.body_jntnum[other] == tree.model.body_jntnum[child]
            and np.abs(tree.pos[other] - wanted).max() < _NEAR_M
            and other not in pairs
        ]
        if alike:
            # Of bodies in one place the one with the most similar mass, itself last of all.
            image_of = min(
                alike,
                key=lambda o: (
                    abs(tree.model.body_mass[o] - tree.model.body_mass[child]),
                    o == child and abs(tree.pos[child][1]) > 1e-6,
                ),
            )
            pairs[child], pairs[image_of] = image_of, child


def make_symmetric(tree: Tree, legs: Legs) -> tuple[dict[int, int], list[str]]:
    """Changes the tree's model in place; gives the mirror images, and what differed much."""
    model, pairs, told = tree.model, mirror_pairs(tree, legs), []
    size_m, mass_kg = float(np.ptp(tree.pos[:, 2])), float(model.body_mass.sum())
    for body, image in pairs.items():
        if image > body:
            notes = _average(tree, body, image, pairs, size_m, mass_kg)
            told += notes
        elif image == body:
            _centre(tree, body, at_m=0.0)
        elif not image:
            off_m = abs(tree.pos[body, 1] + (tree.axes[body] @ model.body_ipos[body])[1])
            if model.body_mass[body] * off_m > 1e-3 * mass_kg * size_m:
                told.append(
                    f"{tree.body_name(body)} ({model.body_mass[body]:.2f} kg) has no mirror image: "
                    "its mass is put on the middle plane"
                )
            _centre(tree, body, at_m=-float(tree.pos[body, 1]))
    for k, sign in enumerate(legs.mirror_sign):
        left, right = legs.joints[0][k], legs.joints[1][k]
        of_left = model.jnt_bodyid[left]
        axis = -sign * MIRROR * (tree.axes[of_left] @ model.jnt_axis[left])
        model.jnt_axis[right] = tree.axes[model.jnt_bodyid[right]].T @ axis
    return pairs, told


def _average(
    tree: Tree, one: int, other: int, pairs: dict[int, int], size_m: float, mass_kg: float
) -> list[str]:
    """Makes two bodies mirror images of each other."""
    model, told = tree.model, []
    name = f"{tree.body_name(one)} and {tree.body_name(other)}"
    masses = model.body_mass[[one, other]].copy()
    if np.ptp(masses) > _TOLD_SHARE * mass_kg:
        told.append(f"{name} weigh {masses[0]:.2f} and {masses[1]:.2f} kg: both get the mean")
    coms = [tree.axes[b] @ model.body_ipos[b] for b in (one, other)]
    if np.abs(coms[0] - coms[1] * MIRROR).max() > _TOLD_SHARE * size_m and masses.min() > 0:
        told.append(f"the centres of mass of {name} are no mirror images: both get the mean")
    com = (coms[0] + coms[1] * MIRROR) / 2
    flip = np.diag(MIRROR)
    tensors = [_inertia(tree, b) for b in (one, other)]
    tensor = (tensors[0] + flip @ tensors[1] @ flip) / 2
    model.body_mass[[one, other]] = masses.mean()
    for body, place, inertia in (
        (one, com, tensor),
        (other, com * MIRROR, flip @ tensor @ flip),
    ):
        model.body_ipos[body] = tree.axes[body].T @ place
        _set_inertia(tree, body, inertia)
    parents = [int(model.body_parentid[b]) for b in (one, other)]
    if pairs.get(parents[0]) == parents[1]:
        places = [
            tree.axes[p] @ model.body_pos[b] for p, b in zip(parents, (one, other), strict=True)
        ]
        place = (places[0] + places[1] * MIRROR) / 2
        model.body_pos[one] = tree.axes[parents[0]].T @ place
        model.body_pos[other] = tree.axes[parents[1]].T @ (place * MIRROR)
    for a, b in zip(_joints(model, one), _joints(model, other), strict=True):
        places = [tree.axes[x] @ model.jnt_pos[j] for x, j in ((one, a), (other, b))]
        place = (places[0] + places[1] * MIRROR) / 2
        model.jnt_pos[a], model.jnt_pos[b] = (
            tree.axes[one].T @ place,
            tree.axes[other].T @ (place * MIRROR),
        )
        dofs = [int(model.jnt_dofadr[j]) for j in (a, b)]
        for field in (model.dof_damping, model.dof_frictionloss, model.dof_armature):
            field[dofs] = field[dofs].mean()
    return told


def _centre(tree: Tree, body: int, *, at_m: float) -> None:
    """Puts a body's mass on the plane y = at_m from its origin, symmetric about it."""
    com = tree.axes[body] @ tree.model.body_ipos[body]
    tree.model.body_ipos[body] = tree.axes[body].T @ np.array([com[0], at_m, com[2]])
    flip = np.diag(MIRROR)
    tensor = _inertia(tree, body)
    _set_inertia(tree, body, (tensor + flip @ tensor @ flip) / 2)


def _joints(model: mujoco.MjModel, body: int) -> range:
    first = int(model.body_jntadr[body])
    return range(first, first + int(model.body_jntnum[body]))


def _inertia(tree: Tree, body: int) -> np.ndarray:
    """The tensor of inertia (3, 3) about the centre of mass, in the robot's axes."""
    quat, turn = tree.model.body_iquat[body], np.empty(9)
    mujoco.mju_quat2Mat(turn, quat)
    axes = tree.axes[body] @ turn.reshape(3, 3)
    tensor: np.ndarray = axes @ np.diag(tree.model.body_inertia[body]) @ axes.T
    return tensor


def _set_inertia(tree: Tree, body: int, tensor: np.ndarray) -> None:
    local = tree.axes[body].T @ tensor @ tree.axes[body]
    moments, axes = np.linalg.eigh(local)
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(axes).ravel())
    # Rounding must not break the triangle inequality, which MuJoCo checks.
    moments = np.minimum(moments[::-1], moments.sum() / 2)[::-1]
    tree.model.body_inertia[body], tree.model.body_iquat[body] = moments, quat
