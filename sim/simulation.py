"""What the controllers need of a physics engine: B simulations of a scene, stepped together."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from sim.scene import Scene
from sim.terrain import Ground


class Variation(Protocol):
    """Per-simulation friction, masses, centre of mass and servo gains, relative to the model's."""

    def set(
        self,
        *,
        friction: np.ndarray,
        mass: np.ndarray,
        pelvis_com_m: np.ndarray,
        gain: np.ndarray,
    ) -> None:
        """Set all simulations.

        Args:
            friction: factor (B,) of all sliding friction.
            mass: factor (B,) of all masses and inertias.
            pelvis_com_m: offset (B, 3) of the pelvis body's centre of mass.
            gain: factor (B,) of the servos' stiffness and damping.
        """
        ...


class Simulation(Protocol):
    """B simulations of a scene under joint position targets.

    `qpos` (B, nq) and `qvel` (B, nv), in MuJoCo's coordinates, are live views of the states:
    writing them sets the states. `sensors` (B, S, nsensordata) holds every sensor at each of the S
    physics steps of the last `step()`. `failed` (B,) marks the simulations whose last step raised
    or left a state that is not finite; they must be reset. `recorded` holds the fields to record as
    arrays (B, S, ...), as `sensors` does.
    """

    scene: Scene
    count: int
    substeps: int
    qpos: np.ndarray
    qvel: np.ndarray
    sensors: np.ndarray
    recorded: dict[str, np.ndarray]
    failed: np.ndarray

    def reset(self, ids: np.ndarray, qpos: np.ndarray, qvel: np.ndarray | None = None) -> None:
        """Put simulations `ids` (n,) into the states qpos (n, nq), qvel (n, nv; default rest)."""
        ...

    def place_ground(self, row: int, ground: Ground) -> None:
        """Give simulation `row`, just reset, its treads and floor; the scene must have treads."""
        ...

    @property
    def ground_pose(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Positions (B, n, 3) and quaternions (B, n, 4) of floor and treads; None without treads.

        They are copies, in the order of the model's mocap bodies.
        """
        ...

    def push(self, force_world_n: np.ndarray) -> None:
        """Apply forces (B, 3) to the pelvises' centres of mass until the next call or reset."""
        ...

    def variation(self) -> Variation:
        """Access to the model parameters of each simulation."""
        ...

    def step(self, targets_rad: np.ndarray) -> None:
        """Advance all by one control period with the joint targets (B, J) held."""
        ...

    def step_in_parts(self, parts: int, targets_rad: Callable[[np.ndarray], np.ndarray]) -> None:
        """Advance all by one control period in equal parts, each with joint targets of its own.

        `targets_rad` gives the targets (B, J) of a part by the sensors (B, nsensordata) at the last
        physics step before it.

        Raises:
            ValueError: the physics steps of a control period do not divide into so many parts.
        """
        ...


def physics_steps(control_period_s: float, timestep_s: float) -> int:
    """How many physics steps a control period has.

    Raises:
        ValueError: not a whole number of them.
    """
    steps = round(control_period_s / timestep_s)
    if steps < 1 or abs(steps * timestep_s - control_period_s) > 1e-9:
        raise ValueError(
            f"control period {control_period_s} s is not a whole number of physics steps "
            f"of {timestep_s} s"
        )
    return steps


def steps_of_part(substeps: int, parts: int) -> int:
    """How many of the physics steps of a control period one of equal parts has.

    Raises:
        ValueError: they do not divide into so many.
    """
    if parts < 1 or substeps % parts:
        raise ValueError(f"{substeps} physics steps do not divide into {parts} parts")
    return substeps // parts
