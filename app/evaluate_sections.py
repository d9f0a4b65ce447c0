"""The sections of an evaluation, in the order in which they are measured and told."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from app.evaluate_gait import energy_parts, gait_parts, push_parts
from app.evaluate_limits import limits_parts
from app.evaluate_modes import long_parts, modes_parts, stairs_parts
from app.evaluate_parts import Bench, Part

SECTIONS: Mapping[str, Callable[[Bench], list[Part]]] = {
    "modes": modes_parts,
    "stairs": stairs_parts,
    "gait": gait_parts,
    "push": push_parts,
    "energy": energy_parts,
    "long": long_parts,
    "limits": limits_parts,
}
