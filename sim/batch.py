"""Many simulations of one scene, stepped together; one simulation is a batch of one."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError

from sim.scene import Scene
from sim.simulation import physics_steps, steps_of_part
from sim.terrain import Ground, GroundBatch


class Variation:
    """Per-simulation friction, masses, centre of mass and servo gains, relative to the model's."""

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
        """Set all simulations; see `sim.simulation.Variation.set`."""
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


def _leave_unsaid(_warning: str) -> None:
    """In place of MuJoCo's own: that prints, and writes MUJOCO_LOG.TXT into the working folder.

    What a warning is about shows in `SimBatch.failed`, or in how the robot walks.
    """


_BAD_STATE = [
    int(warning)
    for warning in (
        mujoco.mjtWarning.mjWARN_BADQPOS,
        mujoco.mjtWarning.mjWARN_BADQVEL,
        mujoco.mjtWarning.mjWARN_BADQACC,
        mujoco.mjtWarning.mjWARN_BADCTRL,
    )
]


class SimBatch:
    """B simulations of a scene in MuJoCo, a `Simulation`."""

    def __init__(
        self,
        scene: Scene,
        *,
        count: int,
        control_period_s: float,
        threads: int = 1,
        record: tuple[str, ...] = (),
    ):
        """Set `count` simulations up in half-sitting at the origin.

        Args:
            scene: the scene.
            count: B.
            control_period_s: duration of a `step()`.
            threads: for the physics; the result does not depend on it.
            record: fields of MjData, such as qvel, that `recorded` holds after each `step()` as
                arrays (B, S, ...), as `sensors` does.

        Raises:
            ValueError: the control period is not a whole number of physics steps.
        """
        substeps = physics_steps(control_period_s, scene.model.opt.timestep)
        if mujoco.get_mju_user_warning() is None:
            mujoco.set_mju_user_warning(_leave_unsaid)
        self.scene = scene
        self.count = count
        self.substeps = substeps
        self._batch = Batch(scene.model, count, threads)
        self.qpos = self._batch.bind("qpos")
        self.qvel = self._batch.bind("qvel")
        self._ctrl = self._batch.bind("ctrl")
        self._ground: GroundBatch | None = None
        if scene.has_treads:
            poses = self._batch.bind("mocap_pos"), self._batch.bind("mocap_quat")
            self._ground = GroundBatch(scene.model, *poses)
        self._pushes: np.ndarray | None = None
        self._pelvis = scene.model.body("pelvis").id
        self.sensors = np.zeros((count, substeps, scene.model.nsensordata))
        self.recorded: dict[str, np.ndarray] = {}
        self._record = ("sensordata", *record)
        self.failed = np.zeros(count, dtype=bool)
        self.reset(np.arange(count), np.tile(scene.standing_qpos, (count, 1)))

    def reset(self, ids: np.ndarray, qpos: np.ndarray, qvel: np.ndarray | None = None) -> None:
        """Put simulations `ids` (n,) into the states qpos (n, nq), qvel (n, nv; default rest)."""
        if len(ids) == 0:
            return
        self._batch.reset(ids, stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        self.qpos[ids] = qpos
        self.qvel[ids] = 0.0 if qvel is None else qvel
        self.failed[ids] = False

    def place_ground(self, row: int, ground: Ground) -> None:
        """Give simulation `row`, just reset, its treads and floor; the scene must have treads."""
        if self._ground is None:
            raise ValueError("the scene was built without treads")
        self._ground.place(row, ground)

    @property
    def ground_pose(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Positions (B, n, 3) and quaternions (B, n, 4) of floor and treads; None without treads.

        They are copies, in the order of the model's mocap bodies.
        """
        return None if self._ground is None else self._ground.pose

    def push(self, force_world_n: np.ndarray) -> None:
        """Apply forces (B, 3) to the pelvises until the next call or reset."""
        if self._pushes is None:
            self._pushes = self._batch.bind("xfrc_applied")
        self._pushes[:, self._pelvis, :3] = force_world_n

    def variation(self) -> Variation:
        """Access to the model parameters of each simulation."""
        return Variation(self.scene.model, self._batch)

    def step(self, targets_rad: np.ndarray) -> None:
        """Advance all by one control period with the joint targets (B, J) held."""
        self._ctrl[:] = targets_rad
        self.failed[:] = False
        self._advance(self.substeps, {**self.recorded, "sensordata": self.sensors})

    def step_in_parts(self, parts: int, targets_rad: Callable[[np.ndarray], np.ndarray]) -> None:
        """Advance all by one control period in equal parts, each with joint targets of its own.

        `targets_rad` gives the targets (B, J) of a part by the sensors (B, nsensordata) at the last
        physics step before it.

        Raises:
            ValueError: the physics steps of a control period do not divide into so many parts.
        """
        size = steps_of_part(self.substeps, parts)
        self.failed[:] = False
        latest = self.sensors[:, -1].copy()
        written: list[dict[str, np.ndarray]] = []
        for part in range(parts):
            self._ctrl[:] = targets_rad(latest)
            sensors = np.zeros((self.count, size, self.sensors.shape[2]))
            self._advance(size, {"sensordata": sensors})
            written.append(self.recorded)
            self.recorded = {}
            self.sensors[:, part * size : (part + 1) * size] = sensors
            latest = sensors[:, -1]
        self.recorded = {
            name: np.concatenate([part[name] for part in written], axis=1)
            for name in self._record[1:]
            if all(name in part for part in written)
        }

    def _advance(self, steps: int, out: dict[str, np.ndarray]) -> None:
        """Run so many physics steps and write what is recorded into the arrays of `out`."""
        try:
            written = self._batch.rollout(steps, record=self._record, out=out)
            self.recorded = {name: written[name] for name in self._record[1:]}
        except SimulationError as error:
            self.failed[error.ids] = True
        # MuJoCo itself resets a state that is not finite; only its warning shows that it did.
        self.failed |= self._batch.warning[:, _BAD_STATE, 1].any(axis=1)
