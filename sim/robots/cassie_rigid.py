"""Cassie without springs and rods: ten servos, and a tarsus that turns as the rod would make it.

It takes physics steps of twice the length, each at less than two thirds of the cost. A policy that
was trained on it walks the faithful `sim/robots/cassie.py` too. All figures are that one's. Springs
are held as in half-sitting, the four-bar linkage of thigh, achilles rod, shin and tarsus becomes a
coupling of joints, and the masses of the rods hang where their ends are, which leaves the robot's
mass as it is. Crank and plantar rod do not turn with the foot: that would add a thirtieth to the
inertia of its rotor.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from sim.robots import cassie
from sim.solids import fix_joint

if TYPE_CHECKING:
    import mujoco

# The tarsus's angle, in rad from 58 degrees, as a polynomial of the knee's from -45 degrees, fitted
# to the closed linkage over the knee's whole range, within 0.1 degrees.
COUPLING = (0.075769, -0.976125, 0.033814, 0.023869, 0.006992)

# What hangs where in place of the rods: body of the left leg, place (m), mass (kg). A rod's mass
# goes to its two ends, in such shares that its centre of mass stays. Places are those of the loops'
# ends, with crank and heel spring as in half-sitting.
_ROD_KG, _CRANK_KG, _PLANTAR_KG = 0.1567, 0.1261, 0.1186
_ROD_SHARE, _PLANTAR_SHARE = 0.24719 / 0.5012, 0.17792 / 0.35012  # at the far end
_HANGING = (
    ("hip_pitch", (0.0, 0.0, 0.045), (1 - _ROD_SHARE) * _ROD_KG),
    ("tarsus", (-0.116452, 0.029092, 0.004585), _ROD_SHARE * _ROD_KG),
    ("tarsus", (0.05837, -0.03892, 0.0206), _CRANK_KG),
    ("tarsus", (0.06191, -0.08886, 0.01484), (1 - _PLANTAR_SHARE) * _PLANTAR_KG),
    ("foot", (0.05512, 0.006, 0.01484), _PLANTAR_SHARE * _PLANTAR_KG),
)
_BALL_RADIUS_M = 0.02
# Of the coupling: as stiff as physics steps of 5 ms allow, or it gives by 3 degrees.
_SOLREF, _SOLIMP = (0.01, 1.0), (0.99, 0.999, 0.001, 0.5, 2.0)


def build() -> mujoco.MjSpec:
    """The model of `cassie.build` without springs, rods and loops."""
    import mujoco

    spec = cassie.build()
    for loop in list(spec.equalities):
        spec.delete(loop)
    for side in ("left", "right"):
        for joint, angle_rad in (("shin", cassie.SHIN_RAD), ("heel-spring", cassie.HEEL_RAD)):
            fix_joint(spec, spec.joint(f"{side}-{joint}"), angle_rad)
        for body in ("achilles_rod", "foot_crank"):
            spec.delete(spec.body(f"{side}_{body}"))
        for k, (body, place, mass_kg) in enumerate(_HANGING):
            hung = spec.body(f"{side}_{body}").add_body(
                name=f"{side}_hung_{k}", pos=np.array(place) * [1, 1, 1 if side == "left" else -1]
            )
            hung.mass, hung.inertia = mass_kg, np.full(3, 0.4 * mass_kg * _BALL_RADIUS_M**2)
            hung.explicitinertial = True
        spec.add_equality(
            type=mujoco.mjtEq.mjEQ_JOINT,
            name=f"{side}_coupling",
            name1=f"{side}-tarsus",
            name2=f"{side}-knee",
            data=[*COUPLING, *[0.0] * 7],
            solref=_SOLREF,
            solimp=_SOLIMP,
        )
    return spec


ROBOT = replace(
    cassie.ROBOT,
    name="cassie-rigid",
    title="Cassie without springs",
    passive=cassie.passive_joints(["tarsus"]),
    longest_timestep_s=0.005,
    trained_as="",
    build=build,
)
