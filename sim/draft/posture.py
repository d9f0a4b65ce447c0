"""Postures of a draft: arms that hang close to the body, and half-sitting on flat soles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from sim.draft.legs import DraftError, Legs, Tree
from sim.draft.shapes import Sole

_KNEES_BENT_RAD = np.radians((40.0, 37.0, 34.0, 31.0))  # what is tried, the best first
_SPARE_RAD = np.radians(4.0)
_SPREAD = 0.08  # sideways, of the way down an arm
_BENT_RAD = np.radians(25.0)
_ARM_LEAST_M = 0.25


@dataclass(frozen=True, kw_only=True)
class HalfSitting:
    """Joint angles (J,) of the left leg, of the model's own zero, with the pelvis upright.

    `pelvis_height_m` is of the base's origin above the soles, `stance_m` the distance of the feet.
    """

    angles_rad: np.ndarray
    knee_bend_rad: float
    pelvis_height_m: float
    stance_m: float


def ranges_of(tree: Tree, legs: Legs) -> np.ndarray:
    """Low and high end (J, 2) of the left leg's joints, from the angle that the model has at first.

    What the right leg cannot do as its mirror image is left out.

    Raises:
        DraftError: A joint has no range.
    """
    model = tree.model
    ranges = []
    for left, right, sign in zip(*legs.joints, legs.mirror_sign, strict=True):
        ends = []
        for joint in (left, right):
            name = tree.joint_name(joint)
            if not model.jnt_limited[joint]:
                raise DraftError(
                    f"joint {name} has no limits: give it lower and upper, in rad in a URDF"
                )
            low, high = model.jnt_range[joint] - model.qpos0[model.jnt_qposadr[joint]]
            if high - low < 1e-6:
                raise DraftError(
                    f"limits of joint {name} are both {low:g}: a leg's joint must move"
                )
            ends.append((low, high))
        mirrored = ends[1] if sign > 0 else (-ends[1][1], -ends[1][0])
        low, high = max(ends[0][0], mirrored[0]), min(ends[0][1], mirrored[1])
        if not low < high:
            raise DraftError(
                f"the ranges of {tree.joint_name(left)} and {tree.joint_name(right)} have nothing "
                "in common as mirror images"
            )
        ranges.append((low, high))
    return np.array(ranges)


def hang_arms(tree: Tree, legs: Legs, pairs: Mapping[int, int]) -> dict[str, float]:
    """Angles in rad of the joints that are held: arms hang, all else at 0 or near it.

    Angles are those of the model itself; joints that stay where the model has them are left out.
    """
    model, data = tree.model, mujoco.MjData(tree.model)
    moved = {*legs.joints[0], *legs.joints[1]}
    for joint in set(tree.hinges) - moved:
        if model.jnt_limited[joint]:
            address = model.jnt_qposadr[joint]
            data.qpos[address] = np.clip(data.qpos[address], *model.jnt_range[joint])
    for chain in _arms(tree, legs, pairs):
        _hang(tree, data, chain)
        for joint in chain:
            image = _image_of(tree, joint, pairs)
            if image is not None:
                address, other = model.jnt_qposadr[[joint, image]]
                angle = _sign(tree, joint, image) * (data.qpos[address] - model.qpos0[address])
                data.qpos[other] = model.qpos0[other] + angle
                if model.jnt_limited[image]:
                    data.qpos[other] = np.clip(data.qpos[other], *model.jnt_range[image])
    held = {}
    for joint in sorted(set(tree.hinges) - moved):
        address = model.jnt_qposadr[joint]
        angle = float(data.qpos[address] - model.qpos0[address])
        if abs(angle) > 1e-4:
            held[tree.joint_name(joint)] = angle
    return held


def _image_of(tree: Tree, joint: int, pairs: Mapping[int, int]) -> int | None:
    body = int(tree.model.jnt_bodyid[joint])
    image = pairs.get(body, 0)
    if image in (0, body) or tree.model.body_jntnum[image] != tree.model.body_jntnum[body]:
        return None
    return int(tree.model.body_jntadr[image] + joint - tree.model.body_jntadr[body])


def _sign(tree: Tree, joint: int, image: int) -> float:
    return -float(np.sign(tree.axis[joint] * np.array([1, -1, 1]) @ tree.axis[image])) or 1.0


def _arms(tree: Tree, legs: Legs, pairs: Mapping[int, int]) -> list[list[int]]:
    """The chains of joints of left arms, from the shoulder on, down to the last large link."""
    first_of_legs = set(legs.first)
    arms = []
    for body, image in pairs.items():
        parent = int(tree.model.body_parentid[body])
        is_root = image not in (0, body) and pairs.get(parent) == parent
        if not is_root or body in first_of_legs or tree.pos[body, 1] < tree.pos[image, 1]:
            continue
        chains = [tree.chain_of(b) for b in tree.below(body)]
        longest = max(chains, key=lambda c: len(c))
        chain = [j for j in longest if j in {*range(tree.model.njnt)} - set(tree.chain_of(parent))]
        if len(chain) < 2:
            continue
        reach_m = float(np.linalg.norm(np.diff(tree.anchor[chain], axis=0), axis=1).sum())
        reach_m += float(np.linalg.norm(tree.model.body_ipos[tree.model.jnt_bodyid[chain[-1]]]))
        if reach_m >= _ARM_LEAST_M:
            arms.append(chain)
    return arms


def _hang(tree: Tree, data: mujoco.MjData, chain: list[int]) -> None:
    """Turns the joints of an arm, within their ranges, until it hangs with its elbow a little bent.

    The joints are laid along a line down from the shoulder that is bent at half its length.
    """
    model = tree.model
    # The joints, and where the mass beyond the last of them is.
    last = int(model.jnt_bodyid[chain[-1]])
    beyond_last = tree.below(last)
    masses = model.body_mass[beyond_last]
    hand = np.average(
        [tree.pos[b] + tree.axes[b] @ model.body_ipos[b] for b in beyond_last],
        axis=0,
        weights=np.maximum(masses, 1e-9),
    )
    in_last = tree.axes[last].T @ (hand - tree.pos[last])
    laid = np.concatenate([tree.anchor[chain], [hand]])
    steps = np.linalg.norm(np.diff(laid, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    half = along[-1] / 2
    elbow = along[int(np.abs(along - half).argmin())]
    out = np.sign(tree.anchor[chain[-1], 1]) * _SPREAD
    down = np.stack([0 * along, out * along, -np.minimum(along, elbow)], axis=1)
    beyond = np.maximum(along - elbow, 0.0)
    down += np.outer(beyond, [np.sin(_BENT_RAD), 0.0, -np.cos(_BENT_RAD)])
    addresses = model.jnt_qposadr[chain]
    at_first = model.qpos0[addresses]
    low = np.where(model.jnt_limited[chain], model.jnt_range[chain, 0], at_first - np.pi)
    high = np.where(model.jnt_limited[chain], model.jnt_range[chain, 1], at_first + np.pi)
    base = data.xpos[tree.base], data.xmat[tree.base].reshape(3, 3)

    def cost(angles: np.ndarray) -> float:
        data.qpos[addresses] = angles
        mujoco.mj_kinematics(model, data)
        at_hand = data.xpos[last] + data.xmat[last].reshape(3, 3) @ in_last
        world = np.concatenate([data.xanchor[chain], [at_hand]])
        places = (world - base[0]) @ base[1] @ tree.turn.T
        off = places - places[0] - down
        return float(np.sum(off**2) + 2e-4 * np.sum((angles - at_first) ** 2))

    mujoco.mj_kinematics(model, data)
    best = np.clip(data.qpos[addresses].copy(), low, high)
    least = cost(best)
    step = 0.8
    while step > 0.01:
        improved = False
        for k in range(len(chain)):
            for change in (step, -step):
                tried = best.copy()
                tried[k] = np.clip(tried[k] + change, low[k], high[k])
                value = cost(tried)
                if value < least - 1e-9:
                    best, least, improved = tried, value, True
        if not improved:
            step /= 2
    # Whole degrees are easier to read and to change.
    data.qpos[addresses] = np.clip(
        at_first + np.radians(np.degrees(best - at_first).round()), low, high
    )


def half_sitting(
    tree: Tree, legs: Legs, sole: Sole, held_rad: Mapping[str, float], ranges_rad: np.ndarray
) -> HalfSitting:
    """The posture with the pelvis upright, soles flat, and the centre of mass above their middle.

    Knees are bent by 40 degrees between thigh and shank, or less where the ranges ask for it.

    Raises:
        DraftError: There is no such posture within the ranges.
    """
    reason = ""
    for bend_rad in _KNEES_BENT_RAD:
        found = _sit(tree, legs, sole, held_rad, float(bend_rad))
        spare = np.minimum(found.angles_rad - ranges_rad[:, 0], ranges_rad[:, 1] - found.angles_rad)
        worst = int(spare.argmin())
        if spare[worst] >= min(_SPARE_RAD, np.ptp(ranges_rad[worst]) / 4):
            return found
        name = tree.joint_name(legs.joints[0][worst])
        low, high = np.degrees(ranges_rad[worst])
        at = np.degrees(found.angles_rad[worst])
        reason = f"{name} would be at {at:.0f} degrees, its range is {low:.0f} to {high:.0f}"
    raise DraftError(f"no half-sitting with bent knees and flat soles: {reason}")


def _sit(
    tree: Tree, legs: Legs, sole: Sole, held_rad: Mapping[str, float], bend_rad: float
) -> HalfSitting:
    model, data = tree.model, mujoco.MjData(tree.model)
    for name, angle in held_rad.items():
        data.qpos[model.joint(name).qposadr[0]] += angle
    addresses = np.array([model.jnt_qposadr[list(leg)] for leg in legs.joints])
    at_first = model.qpos0[addresses[0]]
    signs = np.array(legs.mirror_sign, float)
    pitch = [legs.roles.index(role) for role in ("hip_pitch", "knee", "ankle_pitch")]
    axes_y = np.sign(tree.axis[[legs.joints[0][k] for k in pitch], 1])
    hip, knee, ankle = (tree.anchor[legs.joints[0][k]] for k in pitch)
    thigh, shank = knee - hip, ankle - knee
    # How far the knee is bent at first: from the thigh's slope to the shank's.
    bent_rad = np.arctan2(-shank[0], -shank[2]) - np.arctan2(-thigh[0], -thigh[2])
    angles = np.zeros(len(signs))
    angles[pitch[1]] = axes_y[1] * (bend_rad - bent_rad)

    def place(lean_rad: float) -> tuple[float, np.ndarray, np.ndarray]:
        """How far the centre of mass is before the soles, and the soles' places."""
        angles[pitch[0]] = axes_y[0] * lean_rad
        total = lean_rad + (bend_rad - bent_rad) + sole.pitch_rad
        angles[pitch[2]] = -axes_y[2] * total
        data.qpos[addresses[0]] = at_first + angles
        data.qpos[addresses[1]] = model.qpos0[addresses[1]] + signs * angles
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        base, turn = data.xpos[tree.base], tree.turn @ data.xmat[tree.base].reshape(3, 3).T
        soles = []
        for side, foot in enumerate(legs.feet):
            centre = sole.centre_m * (np.array([1, -1, 1]) if side else 1)
            local = tree.axes[foot].T @ centre
            world = data.xpos[foot] + data.xmat[foot].reshape(3, 3) @ local
            soles.append(turn @ (world - base))
        com = turn @ (data.subtree_com[tree.base] - base)
        return float(com[0] - np.mean(soles, axis=0)[0]), np.array(soles), angles.copy()

    low, high = -1.3, 0.6  # of the hip: the feet go forward as it leans back
    for _ in range(40):
        middle = (low + high) / 2
        before_m, _, _ = place(middle)
        # With the thigh further forward the soles are too.
        low, high = (low, middle) if before_m > 0 else (middle, high)
    _, soles, found = place((low + high) / 2)
    return HalfSitting(
        angles_rad=found,
        knee_bend_rad=bend_rad,
        pelvis_height_m=float(-soles[:, 2].mean()),
        stance_m=float(soles[0, 1] - soles[1, 1]),
    )
