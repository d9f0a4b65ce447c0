"""The legs of a model, found by geometry: two chains of joints that mirror each other.

All is in the robot's axes, with the joints where the model has them at first: x forward, y left, z
up, from the origin of the body that all hangs on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np

from sim.joint_roles import RoleError, roles_of_axes

MIRROR = np.array([1.0, -1.0, 1.0])
# Left and right of a model may differ by so much, of its size and in the cosine of axes.
_OFF_SHARE, _OFF_COSINE = 0.02, 0.02
_LEAST_JOINTS, _TALLEST_M = 5, 10.0
# Forward: the turn about z from the model's axes to the robot's.
FORWARD = {"x": 0.0, "y": -np.pi / 2, "-x": np.pi, "-y": np.pi / 2}


class DraftError(ValueError):
    """No robot can be drafted: the message names the element, and what would be right."""


@dataclass(frozen=True, kw_only=True)
class Tree:
    """The bodies and joints of a compiled model in the robot's axes.

    `turn` (3, 3) takes the axes of the base body to the robot's. `pos` (nbody, 3) and `axes`
    (nbody, 3, 3) are of bodies, `anchor` and `axis` (njnt, 3) of joints.
    """

    model: mujoco.MjModel
    base: int
    turn: np.ndarray
    pos: np.ndarray
    axes: np.ndarray
    anchor: np.ndarray
    axis: np.ndarray

    def body_name(self, body: int) -> str:
        """The name of a body."""
        return self.model.body(body).name or f"body_{body}"

    def joint_name(self, joint: int) -> str:
        """The name of a joint."""
        return self.model.joint(joint).name or f"joint_{joint}"

    @cached_property
    def hinges(self) -> list[int]:
        """The joints that turn."""
        kinds = self.model.jnt_type
        return [j for j in range(self.model.njnt) if kinds[j] == mujoco.mjtJoint.mjJNT_HINGE]

    def chain_of(self, body: int) -> tuple[int, ...]:
        """The hinges between the base and a body, from the base on."""
        chain: list[int] = []
        while body > 0:
            first, count = int(self.model.body_jntadr[body]), int(self.model.body_jntnum[body])
            chain[:0] = [j for j in range(first, first + count) if j in self.hinges]
            body = int(self.model.body_parentid[body])
        return tuple(chain)

    def children(self, body: int) -> list[int]:
        """The bodies right below a body."""
        return [b for b in range(1, self.model.nbody) if self.model.body_parentid[b] == body]

    def below(self, body: int) -> list[int]:
        """A body and all below it."""
        found = [body]
        for one in found:
            found.extend(self.children(one))
        return found


def tree_of(model: mujoco.MjModel, forward: str = "x") -> Tree:
    """The tree of a model whose base looks along `forward`, one of `FORWARD`.

    Raises:
        DraftError: There is more than one body in the world, or none.
    """
    roots = [b for b in range(1, model.nbody) if model.body_parentid[b] == 0]
    moving = [b for b in roots if model.body_subtreemass[b] > 0]
    if len(moving) != 1:
        names = ", ".join(model.body(b).name for b in moving) or "none"
        raise DraftError(f"one body must carry all others; with mass there are: {names}")
    (base,) = moving
    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0
    mujoco.mj_kinematics(model, data)
    angle = FORWARD[forward]
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]).round(12)
    to_robot = turn @ data.xmat[base].reshape(3, 3).T
    origin = data.xpos[base]
    return Tree(
        model=model,
        base=base,
        turn=turn,
        pos=(data.xpos - origin) @ to_robot.T,
        axes=np.array([_clean(to_robot @ m.reshape(3, 3)) for m in data.xmat]),
        anchor=(data.xanchor - origin) @ to_robot.T,
        axis=data.xaxis @ to_robot.T,
    )


def _clean(turn: np.ndarray) -> np.ndarray:
    """The rotation, exact where it is nearly a permutation of axes."""
    return np.where(np.abs(turn - turn.round()) < 1e-9, turn.round(), turn)


@dataclass(frozen=True, kw_only=True)
class Legs:
    """The joints of both legs from the hip down with their roles, left before right.

    `first` are the first bodies of the legs, `feet` the bodies that the last joints move.
    `mirror_sign` (J,) is as in `sim/robot.py`. `notes` tell what was not clear.
    """

    joints: tuple[tuple[int, ...], tuple[int, ...]]
    roles: tuple[str, ...]
    mirror_sign: tuple[int, ...]
    first: tuple[int, int]
    feet: tuple[int, int]
    notes: tuple[str, ...] = ()

    def joint(self, role: str, side: int = 0) -> int:
        """The joint of a role."""
        return self.joints[side][self.roles.index(role)]


def find_legs(
    model: mujoco.MjModel, *, forward: str = "", feet: Sequence[str] = ()
) -> tuple[Tree, Legs]:
    """The tree of a model, turned so that it looks along x, and its legs.

    `forward` tells where it looks, `feet` names the bodies of the left and the right foot; without
    they are found: the lowest two chains that are mirror images, and the side to which knees bend.

    Raises:
        DraftError: There are no two legs of at least five joints with the roles of a leg.
    """
    trees = [tree_of(model, forward)] if forward else [tree_of(model, "x"), tree_of(model, "y")]
    height_m = float(np.ptp(np.concatenate([trees[0].anchor[:, 2], trees[0].pos[1:, 2]])))
    if height_m > _TALLEST_M:
        raise DraftError(
            f"its joints span {height_m:.0f} m in height: lengths seem to be in millimetres, "
            "must be in metres"
        )
    found = [(pair, tree) for tree in trees for pair in _mirrored_chains(tree, feet)]
    if not found:
        raise DraftError(_why_none(trees[0], feet))
    found.sort(key=lambda one: _tip_height_m(*one))
    pair, tree = found[0]
    lowest_m = min(float(tree.anchor[c[-1], 2]) for c in _ends(tree))
    if not feet and _tip_height_m(pair, tree) - lowest_m > 0.15 * height_m:
        raise DraftError(_why_none(tree, feet))  # what mirror each other are the arms
    _refuse_more_legs(found, height_m)
    if len(pair[0]) < _LEAST_JOINTS:
        names = ", ".join(tree.joint_name(j) for j in pair[0])
        raise DraftError(
            f"a leg has {len(pair[0])} joints ({names}); it must have at least {_LEAST_JOINTS}"
        )
    if not forward and _looks_back(tree, pair[0]):
        opposite = {"x": "-x", "y": "-y"}["x" if tree is trees[0] else "y"]
        tree, pair = tree_of(model, opposite), (pair[1], pair[0])
    if tree.anchor[pair[0][-1], 1] < tree.anchor[pair[1][-1], 1]:
        pair = pair[1], pair[0]
    return tree, _legs_of(tree, pair)


Pair = tuple[tuple[int, ...], tuple[int, ...]]


def _tip_height_m(pair: Pair, tree: Tree) -> float:
    return float(np.mean([tree.anchor[leg[-1], 2] for leg in pair]))


def _mirrored_chains(tree: Tree, feet: Sequence[str]) -> list[Pair]:
    """Pairs of chains without joints in common that are mirror images, of two joints or more."""
    ends = _ends(tree)
    if feet:
        ends = [tree.chain_of(_body(tree, name)) for name in feet]
    pairs = []
    for k, one in enumerate(ends):
        for other in ends[k + 1 :]:
            common = sum(1 for a, b in zip(one, other, strict=False) if a == b)
            pair = one[common:], other[common:]
            if len(pair[0]) == len(pair[1]) >= 2 and _mirror(tree, pair):
                pairs.append(pair)
    return pairs


def _ends(tree: Tree) -> list[tuple[int, ...]]:
    """The chains of joints that end where no joint follows."""
    chains = {tree.chain_of(body) for body in range(1, tree.model.nbody)} - {()}
    return sorted(c for c in chains if not any(o[: len(c)] == c and o != c for o in chains))


def _body(tree: Tree, name: str) -> int:
    try:
        return int(tree.model.body(name).id)
    except KeyError:
        raise DraftError(f"--feet: there is no body {name!r} in the model") from None


def _mirror(tree: Tree, pair: Pair) -> bool:
    one, other = (list(chain) for chain in pair)
    size_m = max(float(np.abs(tree.anchor).max()), 0.1)
    places = np.abs(tree.anchor[one] * MIRROR - tree.anchor[other]).max()
    cosines = np.abs(np.sum(tree.axis[one] * MIRROR * tree.axis[other], axis=1))
    apart = np.abs(tree.anchor[one][:, 1]).max()
    return bool(
        places <= _OFF_SHARE * size_m
        and cosines.min() >= 1 - _OFF_COSINE
        and apart > _OFF_SHARE * size_m
    )


def _why_none(tree: Tree, feet: Sequence[str]) -> str:
    ends = sorted(_ends(tree), key=lambda c: tree.anchor[c[-1], 2])
    if not ends:
        return "no joint turns: a robot has two legs of five or six joints each"
    told = ", ".join(f"{tree.joint_name(c[-1])} ({len(c)} joints)" for c in ends[:3])
    named = f" to the feet {', '.join(feet)}" if feet else ""
    return (
        f"no two chains of joints{named} are mirror images; the lowest end in {told}: "
        "--feet LEFT,RIGHT names the bodies of the feet"
    )


def _refuse_more_legs(found: list[tuple[Pair, Tree]], height_m: float) -> None:
    """A second pair of chains that ends as low as the first, and has other joints."""
    first, tree = found[0]
    used = {*first[0], *first[1]}
    for pair, other in found[1:]:
        is_as_low = _tip_height_m(pair, other) - _tip_height_m(first, tree) < 0.1 * height_m
        if is_as_low and not used & {*pair[0], *pair[1]}:
            names = [tree.joint_name(leg[-1]) for leg in (*first, *pair)]
            raise DraftError(
                f"it has four legs, which end in {', '.join(names)}: a humanoid has two; "
                "--feet LEFT,RIGHT names the bodies of its feet"
            )


def _looks_back(tree: Tree, leg: tuple[int, ...]) -> bool:
    """Whether the knee bends so that the foot goes along +x: forward is then the other way."""
    pitches = [j for j in leg if np.abs(tree.axis[j]).argmax() == 1]
    if len(pitches) < 3:
        return False
    knee, ankle = pitches[1], pitches[2]
    low, high = tree.model.jnt_range[knee] if tree.model.jnt_limited[knee] else (-1.0, 1.0)
    bend = high if abs(high) >= abs(low) else low
    moved = np.cross(tree.axis[knee], tree.anchor[ankle] - tree.anchor[knee])
    return bool(np.sign(bend) * moved[0] > 0)


def _legs_of(tree: Tree, pair: Pair) -> Legs:
    """Roles and signs of a pair of chains; what is below the ankles is held."""
    count, notes = _ankle_end(tree, pair[0]), []
    held = [tree.joint_name(j) for leg in pair for j in leg[count:]]
    if held:
        notes.append(f"held, as they lie beyond the ankles: {', '.join(held)}")
    left, right = pair[0][:count], pair[1][:count]
    try:
        roles = roles_of_axes(tree.axis[list(left)])
    except RoleError as error:
        names = ", ".join(tree.joint_name(j) for j in left)
        raise DraftError(f"the left leg ({names}): {error}") from None
    hangs_on = int(tree.model.body_parentid[tree.model.jnt_bodyid[left[0]]])
    between = [tree.joint_name(j) for j in tree.chain_of(hangs_on)]
    if between:
        notes.append(
            f"held, as it lies between the base {tree.body_name(tree.base)} and the legs: "
            f"{', '.join(between)}"
        )
    # A mirror turns the sense of rotation about the mirrored axis.
    signs = -np.sign(np.sum(tree.axis[list(left)] * MIRROR * tree.axis[list(right)], axis=1))
    bodies = [[int(tree.model.jnt_bodyid[j]) for j in leg] for leg in (left, right)]
    return Legs(
        joints=(left, right),
        roles=roles,
        mirror_sign=tuple(int(sign) for sign in signs),
        first=(bodies[0][0], bodies[1][0]),
        feet=(bodies[0][-1], bodies[1][-1]),
        notes=tuple(notes),
    )


def _ankle_end(tree: Tree, leg: tuple[int, ...]) -> int:
    """How many joints there are up to the ankle: three that pitch, and a roll beside the last."""
    about = [int(np.abs(tree.axis[j]).argmax()) for j in leg]
    pitches = [k for k, axis in enumerate(about) if axis == 1]
    if len(pitches) < 3:
        return len(leg)
    last = pitches[2]
    has_roll = 0 in about[pitches[1] : last]
    if not has_roll and last + 1 < len(leg) and about[last + 1] == 0:
        last += 1
    return last + 1
