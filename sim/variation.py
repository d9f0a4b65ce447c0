"""Simulations whose models differ: friction, masses, centre of mass and servo gains."""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco.batch import Batch


class Variation:
    """Per-simulation values of a model's fields, set as multiples of the model's own."""

    def __init__(self, model: mujoco.MjModel, batch: Batch):
        self._model, self._batch = model, batch
        self._pelvis = model.body("pelvis").id
        names = (
            *("geom_friction", "body_mass", "body_inertia", "body_ipos"),
            *("actuator_gainprm", "actuator_biasprm"),
        )
        self._fields = {name: batch.expand(name) for name in names}
        self._nominal = {name: np.array(getattr(model, name)) for name in names}

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
            friction: factor (B,) of the sliding friction of everything.
            mass: factor (B,) of all masses and inertias.
            pelvis_com_m: by how much (B, 3) the pelvis body's centre of mass is off.
            gain: factor (B,) of the servos' stiffness and damping.
        """
        fields, nominal = self._fields, self._nominal
        fields["geom_friction"][:] = nominal["geom_friction"]
        fields["geom_friction"][..., 0] *= friction[:, None]
        fields["body_mass"][:] = nominal["body_mass"] * mass[:, None]
        fields["body_inertia"][:] = nominal["body_inertia"] * mass[:, None, None]
        fields["body_ipos"][:] = nominal["body_ipos"]
        fields["body_ipos"][:, self._pelvis] += pelvis_com_m
        for name in ("actuator_gainprm", "actuator_biasprm"):
            fields[name][:] = nominal[name] * gain[:, None, None]
        self._batch.set_const()
