"""The sections of an evaluation, in the order in which they are measured and told."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from app.evaluation.gait import energy_parts, gait_parts, push_parts
from app.evaluation.limits import limits_parts
from app.evaluation.modes import long_parts, modes_parts, stairs_parts
from app.evaluation.parts import Bench, Part

SECTIONS: Mapping[str, Callable[[Bench], list[Part]]] = {
    "modes": modes_parts,
    "stairs": stairs_parts,
    "gait": gait_parts,
    "push": push_parts,
    "energy": energy_parts,
    "long": long_parts,
    "limits": limits_parts,
}
