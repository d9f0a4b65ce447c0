"""Many simulations of one scene in Drake, with the states and sensors of MuJoCo's.

Positions of bodies, and all that follows from them, are MuJoCo's kinematics at Drake's state; what
touches what, and with which forces, is Drake's own.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import mujoco
import numpy as np
from pydrake.systems.analysis import Simulator

from sim.drake.contact_model import ContactModel, EngineError
from sim.drake.contacts import ContactReader
from sim.drake.plant import ScenePlant, plant_of, transform
from sim.scene import Scene
from sim.simulation import Variation, physics_steps, steps_of_part
from sim.terrain import Ground, GroundBatch

RECORDED = ("qpos", "qvel")
# Below this speed the dry friction of a joint is viscous.
_CREEP_RAD_S = 0.01


class DrakeBatch:
    """B simulations of a scene in Drake, a `Simulation`; they share one plant."""

    def __init__(
        self,
        scene: Scene,
        *,
        count: int,
        control_period_s: float,
        threads: int = 1,
        record: tuple[str, ...] = (),
        contact: ContactModel | None = None,
    ):
        """Set `count` simulations up in half-sitting at the origin.

        Args:
            scene: the scene.
            count: B.
            control_period_s: duration of a `step()`.
            threads: for the physics; the result does not depend on it.
            record: `qpos`, `qvel` or both, for `recorded`.
            contact: how bodies touch, and the duration of a physics step.

        Raises:
            ValueError: the control period is not a whole number of physics steps, or the field
                to record is another.
            EngineError: Drake cannot hold the scene.
        """
        contact = contact or ContactModel()
        model = scene.model
        self.substeps = physics_steps(control_period_s, model.opt.timestep)
        self._steps = physics_steps(control_period_s, contact.timestep_s)
        for name in record:
            if name not in RECORDED:
                raise ValueError(f"cannot record {name!r} in Drake: only {', '.join(RECORDED)}")
        self.scene, self.count = scene, count
        self.qpos, self.qvel = np.zeros((count, model.nq)), np.zeros((count, model.nv))
        self.sensors = np.zeros((count, self.substeps, model.nsensordata))
        self.recorded: dict[str, np.ndarray] = {}
        self._record = record
        self.failed = np.zeros(count, dtype=bool)
        mocap = np.flatnonzero(model.body_mocapid >= 0)
        mocap = mocap[np.argsort(model.body_mocapid[mocap])]
        self._parked = model.body_pos[mocap].copy(), model.body_quat[mocap].copy()
        self._poses = tuple(np.tile(poses, (count, 1, 1)) for poses in self._parked)
        self._ground = GroundBatch(model, *self._poses) if scene.has_treads else None
        # Drake's steps may be longer or shorter than the scene's, at which is read and recorded.
        at = np.arange(self.substeps + 1) * model.opt.timestep / contact.timestep_s
        self._read_at = np.floor(at[:-1] + 1e-6).astype(int)
        self._recorded_at = np.ceil(at[1:] - 1e-6).astype(int) - 1
        self._read = np.zeros((count, self._steps, model.nsensordata))
        self._states = np.zeros((count, self._steps, model.nq + model.nv))
        parts = plant_of(scene, contact)
        self._simulations = [DrakeSimulation(scene, parts) for _ in range(count)]
        self._pool = ThreadPoolExecutor(threads) if min(threads, count) > 1 else None
        self.reset(np.arange(count), np.tile(scene.standing_qpos, (count, 1)))

    def reset(self, ids: np.ndarray, qpos: np.ndarray, qvel: np.ndarray | None = None) -> None:
        """Put simulations `ids` (n,) into the states qpos (n, nq), qvel (n, nv; default rest)."""
        self.qpos[ids] = qpos
        self.qvel[ids] = 0.0 if qvel is None else qvel
        self.failed[ids] = False
        for poses, parked in zip(self._poses, self._parked, strict=True):
            poses[ids] = parked
        for row in ids:
            self._simulations[row].push_world_n[:] = 0.0
            self._place(row)

    def place_ground(self, row: int, ground: Ground) -> None:
        """Give simulation `row`, just reset, its treads and floor; the scene must have treads."""
        if self._ground is None:
            raise ValueError("the scene was built without treads")
        self._ground.place(row, ground)
        self._place(row)

    def _place(self, row: int) -> None:
        self._simulations[row].place_ground(*(poses[row] for poses in self._poses))

    @property
    def ground_pose(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Positions (B, n, 3) and quaternions (B, n, 4) of floor and treads; None without treads.

        They are copies, in the order of the model's mocap bodies.
        """
        return None if self._ground is None else self._ground.pose

    def push(self, force_world_n: np.ndarray) -> None:
        """Apply forces (B, 3) to the pelvises' centres of mass until the next call or reset."""
        for simulation, force in zip(self._simulations, force_world_n, strict=True):
            simulation.push_world_n[:] = force

    def variation(self) -> Variation:
        """There is none.

        Raises:
            EngineError: always.
        """
        raise EngineError(
            "--engine drake holds no variation of friction, masses and gains: train and vary with "
            "--engine mujoco"
        )

    def step(self, targets_rad: np.ndarray) -> None:
        """Advance all by one control period with the joint targets (B, J) held."""
        self.step_in_parts(1, lambda _: targets_rad)

    def step_in_parts(self, parts: int, targets_rad: Callable[[np.ndarray], np.ndarray]) -> None:
        """Advance all by one control period in equal parts; see `Simulation.step_in_parts`."""
        size = steps_of_part(self._steps, parts)
        state = np.concatenate([self.qpos, self.qvel], axis=1)
        self.failed[:] = ~np.isfinite(state).all(axis=1)
        latest = self.sensors[:, -1].copy()
        for first in range(0, self._steps, size):
            self._advance(range(first, first + size), np.asarray(targets_rad(latest), float))
            latest = self._read[:, first + size - 1].copy()
        self.sensors[:] = self._read[:, self._read_at]
        states, nq = self._states[:, self._recorded_at], self.qpos.shape[1]
        told = {"qpos": states[..., :nq], "qvel": states[..., nq:]}
        self.recorded = {name: told[name] for name in self._record}

    def _advance(self, steps: range, targets_rad: np.ndarray) -> None:
        """Run some of the physics steps of a control period."""

        def run(row: int) -> None:
            self.failed[row] = not self._run(row, steps, targets_rad[row])

        rows = np.flatnonzero(~self.failed).tolist()
        for _ in map(run, rows) if self._pool is None else self._pool.map(run, rows):
            pass

    def _run(self, row: int, steps: range, targets_rad: np.ndarray) -> bool:
        """Advance one simulation; false when it failed, and its state is as it was."""
        simulation = self._simulations[row]
        qpos, qvel = self.qpos[row].copy(), self.qvel[row].copy()
        for k in steps:
            try:
                qpos, qvel = simulation.advance(qpos, qvel, targets_rad, self._read[row, k])
            except RuntimeError:  # Drake's solver found no solution
                return False
            if not (np.isfinite(qpos).all() and np.isfinite(qvel).all()):
                return False
            self._states[row, k] = *qpos, *qvel
        self.qpos[row], self.qvel[row] = qpos, qvel
        return True


class DrakeSimulation:
    """One simulation: a context of the scene's plant, and the servos.

    `push_world_n` (3,) acts on the pelvis's centre of mass.
    """

    def __init__(self, scene: Scene, parts: ScenePlant):
        model = scene.model
        self._scene, self._parts = scene, parts
        self._root = parts.diagram.CreateDefaultContext()
        self._context = parts.plant.GetMyMutableContextFromRoot(self._root)
        self._simulator = Simulator(parts.diagram, self._root)
        self._start_clock()
        self._layout = StateLayout(model, parts)
        self._reader = ContactReader(scene, parts)
        self._data = mujoco.MjData(model)
        self._pelvis = model.body("pelvis").id
        self._forces = parts.plant.get_applied_generalized_force_input_port().FixValue(
            self._context, np.zeros(model.nv)
        )
        self._contacts = parts.plant.get_contact_results_output_port()
        self.push_world_n = np.zeros(3)
        self._kp, self._kd = model.actuator_gainprm[:, 0], -model.actuator_biasprm[:, 2]
        self._limits_nm = model.actuator_forcerange.T
        # The servos' damping is implicit in time, as it is in MuJoCo: the joints have it.
        self._damping, self._dry_nm = np.array(model.dof_damping), model.dof_frictionloss
        self._damping[scene.joint_qvel] += self._kd
        self._damp(self._damping)

    def place_ground(self, position: np.ndarray, quaternion: np.ndarray) -> None:
        """Put floor and treads at positions (n, 3), quaternions (n, 4), by mocap number."""
        for mocap, frame in self._parts.mocap_frames.items():
            pose = transform(position[mocap], quaternion[mocap])
            frame.SetPoseInParentFrame(self._context, pose)

    def advance(
        self, qpos: np.ndarray, qvel: np.ndarray, targets_rad: np.ndarray, sensordata: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The state one physics step after qpos (nq,), qvel (nv,) under joint targets (J,).

        The sensors (nsensordata,) of the state before are written.

        Raises:
            RuntimeError: Drake's solver found no solution.
        """
        scene, plant = self._scene, self._parts.plant
        speed = qvel[scene.joint_qvel]
        torque_nm = self._kp * (targets_rad - qpos[scene.joint_qpos]) - self._kd * speed
        torque_nm = np.clip(torque_nm, *self._limits_nm)
        applied = np.zeros(scene.model.nv)
        applied[scene.joint_qvel] = torque_nm + self._kd * speed
        if self._dry_nm.any():
            self._damp(self._damping + self._dry_nm / np.maximum(np.abs(qvel), _CREEP_RAD_S))
        self._read_kinematics(qpos, qvel, sensordata)
        if self.push_world_n.any():
            arm_m = self._data.xipos[self._pelvis] - self._data.xpos[self._pelvis]
            applied[:6] = *self.push_world_n, *np.cross(arm_m, self.push_world_n)
        self._forces.GetMutableData().get_mutable_value().SetFromVector(
            self._layout.forces(applied)
        )
        plant.SetPositionsAndVelocities(self._context, self._layout.to_drake(qpos, qvel))
        self._steps += 1
        try:
            self._simulator.AdvanceTo(self._steps * plant.time_step(), interruptible=False)
        except RuntimeError:
            self._start_clock()
            raise
        self._reader.read(self._contacts.Eval(self._context), sensordata)
        sensordata[scene.sensors.joint_torque] = torque_nm
        return self._layout.to_mujoco(plant.GetPositionsAndVelocities(self._context))

    def _start_clock(self) -> None:
        self._root.SetTime(0.0)
        self._simulator.Initialize()
        self._steps = 0

    def _damp(self, damping: np.ndarray) -> None:
        """Set the joints' damping from that of all degrees of freedom (nv,)."""
        model = self._scene.model
        for number, joint in self._parts.joints.items():
            joint.SetDamping(self._context, float(damping[model.jnt_dofadr[number]]))

    def _read_kinematics(self, qpos: np.ndarray, qvel: np.ndarray, sensordata: np.ndarray) -> None:
        """Write all sensors of positions and velocities."""
        model, data = self._scene.model, self._data
        data.qpos[:], data.qvel[:] = qpos, qvel
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_subtreeVel(model, data)
        mujoco.mj_sensorPos(model, data)
        mujoco.mj_sensorVel(model, data)
        sensordata[:] = data.sensordata


class StateLayout:
    """Where MuJoCo's positions and velocities are in Drake's.

    Of the free joint Drake has the quaternion before the position, and the angular velocity, in
    world axes, before the linear one.
    """

    def __init__(self, model: mujoco.MjModel, parts: ScenePlant):
        base = parts.base
        self._q_of, self._v_of = np.zeros(model.nq, int), np.zeros(model.nv, int)
        self._q_of[:7] = base.position_start() + np.array([4, 5, 6, 0, 1, 2, 3])
        self._v_of[:6] = base.velocity_start() + np.array([3, 4, 5, 0, 1, 2])
        for number, joint in parts.joints.items():
            self._q_of[model.jnt_qposadr[number]] = joint.position_start()
            self._v_of[model.jnt_dofadr[number]] = joint.velocity_start()

    def forces(self, applied: np.ndarray) -> np.ndarray:
        """Drake's generalised forces (nv,) of those (nv,) of MuJoCo's degrees of freedom."""
        forces = np.zeros(len(applied))
        forces[self._v_of] = applied
        return forces

    def to_drake(self, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        """Drake's state (nq + nv,)."""
        state = np.zeros(len(qpos) + len(qvel))
        state[self._q_of] = qpos
        quaternion = self._q_of[3:7]
        state[quaternion] /= np.linalg.norm(state[quaternion])
        turned = qvel.copy()
        mujoco.mju_rotVecQuat(turned[3:6], qvel[3:6], state[quaternion])
        state[len(qpos) + self._v_of] = turned
        return state

    def to_mujoco(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """MuJoCo's qpos (nq,) and qvel (nv,) of Drake's state."""
        count = len(self._q_of)
        qpos, qvel = state[:count][self._q_of], state[count:][self._v_of]
        inverse = np.empty(4)
        mujoco.mju_negQuat(inverse, qpos[3:7])
        spin = np.empty(3)
        mujoco.mju_rotVecQuat(spin, qvel[3:6], inverse)
        qvel[3:6] = spin
        return qpos, qvel
