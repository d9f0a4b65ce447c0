"""The URDF of a humanoid of boxes, with figures that a test can work out by hand."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

# Joint of a leg, from the hip down: name, place from the joint before (m), axis, range (rad).
LEG = (
    ("yaw", (0.0, 0.1, -0.1), (0, 0, 1), (-0.5, 0.8)),
    ("roll", (0.0, 0.0, 0.0), (1, 0, 0), (-0.4, 0.6)),
    ("pitch", (0.0, 0.0, 0.0), (0, 1, 0), (-2.0, 0.7)),
    ("knee", (0.0, 0.0, -0.40), (0, 1, 0), (0.0, 2.4)),
    ("ankle", (0.0, 0.0, -0.38), (0, 1, 0), (-1.2, 0.8)),
    ("tilt", (0.0, 0.0, 0.0), (1, 0, 0), (-0.4, 0.4)),
)
MASSES_KG = {"yaw": 1.0, "roll": 1.0, "pitch": 5.0, "knee": 3.0, "ankle": 0.5, "tilt": 1.5}
# Boxes by joint: size, middle.
BOXES = {
    "pitch": ((0.12, 0.12, 0.30), (0, 0, -0.2)),
    "knee": ((0.10, 0.10, 0.28), (0, 0, -0.18)),
    "tilt": ((0.22, 0.10, 0.04), (0.03, 0.0, -0.06)),
}
NAMES = {"left": "{joint}_a", "right": "{joint}_b"}


@dataclass(frozen=True, kw_only=True)
class Humanoid:
    """What a URDF of it has: names, senses of axes, and where it looks.

    `flipped` are the joints whose axis points the other way, of the right leg where they end in
    `_b`. `yaw_rad` turns all of it in the axes of its base.
    """

    flipped: frozenset[str] = frozenset()
    yaw_rad: float = 0.0
    changes: Mapping[str, str] = field(default_factory=dict)

    def urdf(self) -> str:
        """The text of the file."""
        parts = [_link("trunk", 20.0, ((0.2, 0.3, 0.5), (0, 0, 0.25)), self.yaw_rad)]
        parts.append(_link("skull", 3.0, ((0.2, 0.2, 0.2), (0, 0, 0.1)), self.yaw_rad))
        parts.append(self._joint("neck", "trunk", "skull", (0, 0, 0.5), (0, 0, 1), (-1, 1)))
        for side, sign in (("left", 1), ("right", -1)):
            above = "trunk"
            for joint, (x, y, z), axis, ends in LEG:
                name = NAMES[side].format(joint=joint)
                turns = sign if axis[1] == 0 else 1  # the range mirrors with the axis
                flip = -1 if name in self.flipped else 1
                low, high = sorted((turns * flip * ends[0], turns * flip * ends[1]))
                parts.append(
                    _link(f"{name}_link", MASSES_KG[joint], BOXES.get(joint), self.yaw_rad)
                )
                parts.append(
                    self._joint(
                        name,
                        above,
                        f"{name}_link",
                        (x, sign * y, z),
                        tuple(flip * a for a in axis),
                        (low, high),
                    )
                )
                above = f"{name}_link"
            parts += self._arm(side, sign)
        text = f'<robot name="boxes">{"".join(parts)}</robot>'
        for old, new in self.changes.items():
            assert old in text, old
            text = text.replace(old, new)
        return text

    def _arm(self, side: str, sign: int) -> list[str]:
        """Two links that point sideways with all joints at 0."""
        end = "a" if side == "left" else "b"
        box = ((0.06, 0.26, 0.06), (0, sign * 0.14, 0))
        return [
            _link(f"upper_{end}", 2.0, box, self.yaw_rad),
            _link(f"fore_{end}", 1.0, box, self.yaw_rad),
            _link(f"hand_{end}", 0.5, ((0.05, 0.1, 0.05), (0, sign * 0.05, 0)), self.yaw_rad),
            self._joint(
                f"shoulder_{end}",
                "trunk",
                f"upper_{end}",
                (0, sign * 0.18, 0.45),
                (1, 0, 0),
                (-2, 2),
            ),
            self._joint(
                f"elbow_{end}",
                f"upper_{end}",
                f"fore_{end}",
                (0, sign * 0.28, 0),
                (0, 0, 1),
                (-2, 2),
            ),
            self._joint(
                f"wrist_{end}",
                f"fore_{end}",
                f"hand_{end}",
                (0, sign * 0.28, 0),
                (0, 1, 0),
                (-2, 2),
            ),
        ]

    def _joint(self, name, parent, child, place, axis, ends) -> str:
        x, y, z = _turned(place, self.yaw_rad)
        a, b, c = _turned(axis, self.yaw_rad)
        return (
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{x} {y} {z}"/><axis xyz="{a} {b} {c}"/>'
            f'<limit lower="{ends[0]}" upper="{ends[1]}" effort="120" velocity="10"/></joint>'
        )


def _turned(point, yaw_rad) -> tuple[float, float, float]:
    x, y, z = point
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    return round(cos * x - sin * y, 12), round(sin * x + cos * y, 12), z


def _link(name, mass_kg, box, yaw_rad) -> str:
    size, middle = box or ((0.08, 0.08, 0.08), (0, 0, 0))
    x, y, z = _turned(middle, yaw_rad)
    w, d, h = (mass_kg / 12 * (sum(s * s for s in size) - s * s) for s in size)
    shape = (
        f'<collision><origin xyz="{x} {y} {z}" rpy="0 0 {yaw_rad}"/>'
        f'<geometry><box size="{size[0]} {size[1]} {size[2]}"/></geometry></collision>'
    )
    return (
        f'<link name="{name}"><inertial><origin xyz="{x} {y} {z}" rpy="0 0 {yaw_rad}"/>'
        f'<mass value="{mass_kg}"/>'
        f'<inertia ixx="{w}" iyy="{d}" izz="{h}" ixy="0" ixz="0" iyz="0"/></inertial>'
        f"{shape if box else ''}</link>"
    )
