"""Gain, damping, friction, delay and offset of each joint's servo, fitted to a log.

Each joint is replayed alone under its targets, with the inertia and the load that it has while all
else moves as measured (`loads.py`), and what it is replayed with is changed until its angles are
nearest to the measured ones (output error: Ljung 1999, section 7.2; least squares by Levenberg and
Marquardt). A replay lasts a window; where it begins, in angle and speed, is fitted too.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import fields as fields_of
from itertools import pairwise

import numpy as np

from sim.identification.loads import Loads
from sim.identification.robot_log import RobotLog
from sim.scene import Scene

STEP_S = 0.001
# Windows: of a hanging robot as long as this; of a swing at least as long as that, its ends cut.
_LONGEST_S, _SHORTEST_S, _ENDS_S = 1.5, 0.25, 0.05
_MOST_WINDOWS = 60
_STOP_RAD = 0.01  # so near to an end of its range a joint may touch it
ROUNDS, _CLOSE = 25, 0.02
_FIRST_DELAY_S, _LEAST_TRUST = 0.005, 1e3
# What is searched of a joint: logarithm of the gain over the model's, damping over the model's and
# friction over the model's gain (rad), both over that gain, delay, offset. The gain alone scales
# all torques: it is the hardest to tell where inertia and load are small. How far derivatives look:
_STEPS = np.array([0.01, 0.02, 0.0005, 0.0005, 0.001])
_LOW = np.array([-3.0, 0.0, 0.0, 0.0, -0.5])
_HIGH = np.array([3.0, 50.0, 1.0, 0.2, 0.5])
_DELAYED = 4  # of the replays with changed parameters, the one with another delay
_ENOUGH_ROWS, _LEAST_ROWS = 40, 6
# Angle and speed at the begin of a window are two more columns of derivatives.
_BEGIN_RAD, _BEGIN_RAD_S = 0.001, 0.01
# As little as a measured angle weighs the one that a window begins with; the speed, which comes
# from angles of some 50 ms, less.
_BEGIN_WEIGHTS = np.array([1.0, 0.05])


@dataclass(frozen=True, kw_only=True)
class Servo:
    """Parameters of J joints, each (J,): torque `kp (target(t - delay) - offset - q) - kd dq`.

    Cut off at the torque limit, then less friction: MuJoCo's `frictionloss`.
    """

    kp: np.ndarray
    kd: np.ndarray
    friction_nm: np.ndarray
    delay_s: np.ndarray
    offset_rad: np.ndarray


@dataclass(frozen=True, kw_only=True)
class ServoFit:
    """Servos as the model has them and as fitted, and how near replays with each come to the log.

    Attributes:
        nominal: the model's; its damping includes that of the joints.
        servo: fitted; nan for joints with too little in the log.
        deviation: one standard deviation of each, windows taken as independent of each other.
        rows: rows of the log that were compared (J,).
        nominal_rms_rad, fitted_rms_rad: of replayed against measured angles (J,).
        replayed: times (R,), windows' numbers (R,), angles by the model's and by the fitted
            servo (R,) of each joint, for pictures.
    """

    nominal: Servo
    servo: Servo
    deviation: Servo
    rows: np.ndarray
    nominal_rms_rad: np.ndarray
    fitted_rms_rad: np.ndarray
    replayed: list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]


def nominal_servo(scene: Scene) -> Servo:
    """The servos of the model."""
    joints, dofs = scene.robot.joints, scene.joint_qvel
    zero = np.zeros(len(joints))
    return Servo(
        kp=np.array([joint.kp for joint in joints], float),
        kd=np.array([joint.kd for joint in joints]) + scene.model.dof_damping[dofs],
        friction_nm=np.array(scene.model.dof_frictionloss[dofs]),
        delay_s=zero,
        offset_rad=zero,
    )


def fit_servos(log: RobotLog, loads: Loads, scene: Scene, *, hanging: bool) -> ServoFit:
    """Fits every joint on its own; see the head of the file.

    With `hanging` all of the log is used, else of each leg the swings of its foot.
    """
    nominal = nominal_servo(scene)
    joints = len(nominal.kp)
    replays = _Replays(log, loads, scene, hanging=hanging)
    start = np.tile([0.0, 1.0, 0.0, 0.0, 0.0], (joints, 1))
    start[:, 2] = nominal.friction_nm / nominal.kp
    every = list(range(joints))
    by_model = replays.linearised(every, start, replays.begin)
    by_model = replays.linearised(every, start, replays.begin_of(by_model, np.zeros((joints, 5))))
    known = [j for j in every if replays.rows[j] >= _ENOUGH_ROWS]
    found, best = _searched(replays, start, known)
    covariance = np.full((joints, 5, 5), np.nan)
    for j in known:
        # Of each window its rows, and two for the begin.
        sizes = [len(angle) + 2 for angle in best.angle[j]]
        covariance[j] = _covariance(best.free_rest[j], best.free_by[j], sizes)
    none = np.zeros(0)
    replayed = [
        (*replays.times(j), np.concatenate(by_model.angle[j]), np.concatenate(best.angle[j]))
        if j in known
        else (none, none, none, none)
        for j in every
    ]
    measured = [replays.measured(j) if j in known else none for j in every]
    return ServoFit(
        nominal=nominal,
        servo=_servo(found, scene),
        deviation=_deviation(found, covariance, scene),
        rows=replays.rows,
        nominal_rms_rad=np.array([_rms(replayed[j][2] - measured[j]) for j in every]),
        fitted_rms_rad=np.array([_rms(replayed[j][3] - measured[j]) for j in every]),
        replayed=replayed,
    )


def _searched(
    replays: _Replays, start: np.ndarray, known: list[int]
) -> tuple[np.ndarray, _Linearised]:
    """What is searched of the joints `known` (J, 5), nan of others, and the replays with it."""
    now = np.full_like(start, np.nan)
    now[known] = start[known]
    now[:, 3] += _FIRST_DELAY_S
    best = replays.linearised(known, now, replays.begin)
    trust = np.full(len(start), 1e-3)
    active = list(known)
    for _ in range(ROUNDS):
        if not active:
            break
        move = np.zeros_like(now)
        for j in active:
            move[j] = _step(now[j], best.free_rest[j], best.free_by[j], trust[j])
        trial = np.clip(now + move, _LOW, _HIGH)
        move[active] = trial[active] - now[active]
        tried = replays.linearised(active, trial, replays.begin_of(best, move))
        for j in tuple(active):
            is_small = np.all(np.abs(trial[j] - now[j]) < _CLOSE * _STEPS)
            if tried.rest[j] @ tried.rest[j] < best.rest[j] @ best.rest[j]:
                now[j] = trial[j]
                best.take(j, tried, replays.columns[j])
                trust[j] = max(trust[j] / 10, 1e-9)
                is_done = is_small
            else:
                trust[j] *= 10
                is_done = trust[j] > _LEAST_TRUST
            if is_done:
                active.remove(j)
    return now, best


def _servo(parameters: np.ndarray, scene: Scene) -> Servo:
    """Of what is searched (J, 5)."""
    nominal = nominal_servo(scene)
    gain, damping, friction, delay, offset = parameters.T
    return Servo(
        kp=np.exp(gain) * nominal.kp,
        kd=np.exp(gain) * damping * nominal.kd,
        friction_nm=np.exp(gain) * friction * nominal.kp,
        delay_s=delay,
        offset_rad=offset,
    )


@dataclass
class _Linearised:
    """Replays and their derivatives, by joints' numbers, for begins (2, C) in angle and speed.

    `rest` (n + 2 W,) is measured less replayed angles and how far the begins are from the measured
    ones; `free_rest` and its derivatives `free_by` (n + 2 W, 5) are without what other begins
    explain, which are `begin + shift - shift_by * change of parameters`, (2, C) and (2, 5, C).
    `angle` holds the replayed angles of each window.
    """

    rest: dict[int, np.ndarray]
    free_rest: dict[int, np.ndarray]
    free_by: dict[int, np.ndarray]
    angle: dict[int, list[np.ndarray]]
    begin: np.ndarray
    shift: np.ndarray
    shift_by: np.ndarray

    def take(self, j: int, other: _Linearised, columns: np.ndarray) -> None:
        """Takes joint j, which has these columns, from another one."""
        for name in ("rest", "free_rest", "free_by", "angle"):
            getattr(self, name)[j] = getattr(other, name)[j]
        for name in ("begin", "shift", "shift_by"):
            getattr(self, name)[..., columns] = getattr(other, name)[..., columns]


class _Replays:
    """All windows of all joints, C in all and S steps at most, replayed at once.

    `columns` holds those of each joint, `rows` (J,) how many rows of the log they have.
    """

    def __init__(self, log: RobotLog, loads: Loads, scene: Scene, *, hanging: bool):
        model, dofs, joints = scene.model, scene.joint_qvel, len(scene.joint_qvel)
        windows = []
        for j, joint in enumerate(scene.robot.joints):
            # At an end of its range it is not the servo that holds it.
            away = np.full(len(loads.time_s), True)
            if model.joint(joint.name).limited[0]:
                low, high = model.joint(joint.name).range
                away = (loads.pos_rad[:, j] > low + _STOP_RAD) & (
                    loads.pos_rad[:, j] < high - _STOP_RAD
                )
            is_on = loads.swings[:, j // (joints // 2)] & away
            windows += [(j, *one) for one in _windows(loads.time_s, is_on, hanging=hanging)]
        in_log = [_between(log.time_s, begin, end) for _, begin, end in windows]
        kept = [c for c, rows in enumerate(in_log) if len(rows) >= _LEAST_ROWS]
        windows, self._in_log = [windows[c] for c in kept], [in_log[c] for c in kept]
        self._joint = np.array([j for j, _, _ in windows], dtype=np.int64)
        begins = np.array([begin for _, begin, _ in windows])
        self.columns = [np.flatnonzero(self._joint == j) for j in range(joints)]
        self.rows = np.array([sum(len(self._in_log[c]) for c in own) for own in self.columns])
        steps = 2 + max((int((end - begin) / STEP_S) for _, begin, end in windows), default=0)
        self._at_s = begins + STEP_S * np.arange(steps)[:, None]  # (S, C)
        self._time_s, self._measured = log.time_s, log.joint_pos_rad
        self._places = [
            (log.time_s[rows] - begin) / STEP_S
            for rows, begin in zip(self._in_log, begins, strict=True)
        ]

        def along(values: np.ndarray) -> np.ndarray:
            found = np.zeros(self._at_s.shape)
            for j, own in enumerate(self.columns):
                found[:, own] = np.interp(self._at_s[:, own], loads.time_s, values[:, j])
            return found

        self._inertia, self._load = along(loads.inertia_kg_m2), along(loads.load_nm)
        self._stiffness, self._pos = along(loads.stiffness_nm_rad), along(loads.pos_rad)
        speed = along(loads.vel_rad_s)
        self.begin = np.stack([self._pos[0], speed[0]]) if len(windows) else np.zeros((2, 0))
        # The target's integral from the first one on is linear between the times they were sent.
        held = np.diff(log.sent_s, append=log.sent_s[-1] + 10.0)[:, None]
        self._sent_s = np.append(log.sent_s, log.sent_s[-1] + 10.0)
        self._integral = np.vstack([np.zeros(joints), np.cumsum(held * log.target_rad, axis=0)])
        self._first = log.target_rad[0]
        nominal = nominal_servo(scene)
        self._kp, self._kd = nominal.kp, nominal.kd
        self._limit_nm = np.array([joint.torque_limit_nm for joint in scene.robot.joints])
        # MuJoCo's frictionloss: a soft constraint to speed 0 (its documentation, Computation,
        # Solver parameters), whose force is cut off. solref and solimp as the model has them.
        width = np.clip(model.dof_solimp[dofs, 0], 1e-4, 0.9999)
        slowest = model.dof_solimp[dofs, 1]
        time_s, second = model.dof_solref[dofs].T
        self._brake = np.where(time_s > 0, 2 / (slowest * np.abs(time_s)), -second / slowest)
        self._soft = (1 - width) / width * model.dof_invweight0[dofs]

    def measured(self, j: int) -> np.ndarray:
        """Measured angles of joint j in its windows."""
        parts = [self._measured[self._in_log[c], j] for c in self.columns[j]]
        return np.concatenate([np.zeros(0), *parts])

    def times(self, j: int) -> tuple[np.ndarray, np.ndarray]:
        """Times of joint j's rows and the numbers of their windows."""
        rows = [self._in_log[c] for c in self.columns[j]]
        numbers = [np.full(len(row), w) for w, row in enumerate(rows)]
        return self._time_s[np.concatenate(rows)], np.concatenate(numbers)

    def _targets(self, columns: np.ndarray, delay_s: np.ndarray) -> np.ndarray:
        """Mean target (S, c) during each step of columns (c,), each with its delay (c,)."""
        at_s = self._at_s[:, columns] - delay_s
        at_s = np.vstack([at_s, at_s[-1] + STEP_S])
        whole = np.empty_like(at_s)
        for c, j in enumerate(self._joint[columns]):
            whole[:, c] = np.interp(at_s[:, c], self._sent_s, self._integral[:, j])
            # Before the first one: as if it had been sent long ago.
            whole[:, c] += self._first[j] * np.minimum(at_s[:, c] - self._sent_s[0], 0.0)
        return np.diff(whole, axis=0) / STEP_S

    def replay(self, columns: np.ndarray, parameters: np.ndarray, begin: np.ndarray) -> np.ndarray:
        """Angles (S, P, c) of columns (c,) by parameters (P, c, 5) from begins (P, 2, c)."""
        joint = self._joint[columns]
        gain, damping, friction, delay, offset = np.moveaxis(parameters, 2, 0)
        kp, kd = np.exp(gain) * self._kp[joint], np.exp(gain) * damping * self._kd[joint]
        friction_nm = kp * friction
        later = delay[_DELAYED] - delay[0]
        target = self._targets(columns, delay[0])
        delayed = self._targets(columns, delay[0] + later)
        limit_nm, brake, soft = self._limit_nm[joint], self._brake[joint], self._soft[joint]
        inertia, load = self._inertia[:, columns], self._load[:, columns]
        stiffness, pos = self._stiffness[:, columns], self._pos[:, columns]
        q, v = begin[:, 0].copy(), begin[:, 1].copy()
        angles = np.empty((len(inertia), *q.shape))
        push, from_offset = np.empty_like(q), -kp * offset
        for s in range(len(inertia)):
            angles[s] = q
            np.multiply(kp, target[s], out=push)
            push[_DELAYED] = kp[_DELAYED] * delayed[s]
            torque = push + from_offset - kp * q - kd * v
            cut = np.abs(torque) > limit_nm
            torque = np.clip(torque, -limit_nm, limit_nm)
            torque -= load[s] + stiffness[s] * (q - pos[s])
            mass = inertia[s]
            torque += np.clip(
                -(brake * v + torque / mass) / (1 / mass + soft), -friction_nm, friction_nm
            )
            # Damping implicit, as in MuJoCo's integrator, while the torque is not cut off.
            v = v + STEP_S * torque / (mass + np.where(cut, 0.0, STEP_S * kd))
            q = q + STEP_S * v
        return angles

    def begin_of(self, found: _Linearised, move: np.ndarray) -> np.ndarray:
        """The begins (2, C) that go best with parameters changed by `move` (J, 5)."""
        by_move = np.einsum("bkc,ck->bc", found.shift_by, move[self._joint])
        begins: np.ndarray = found.begin + found.shift - by_move
        return begins

    def linearised(
        self, joints: list[int], parameters: np.ndarray, begin: np.ndarray
    ) -> _Linearised:
        """Replays of joints' numbers by parameters (J, 5) from begins (2, C), and derivatives."""
        none = np.zeros(0, dtype=np.int64)
        columns = np.concatenate([none, *(self.columns[j] for j in joints)])
        sets = np.tile(parameters[self._joint[columns]], (8, 1, 1))
        sets[1:6] += np.diag(_STEPS)[:, None, :]
        begins = np.tile(begin[:, columns], (8, 1, 1))
        begins[6, 0] += _BEGIN_RAD
        begins[7, 1] += _BEGIN_RAD_S
        angles = self.replay(columns, sets, begins)
        shift, shift_by = np.zeros_like(begin), np.zeros((2, 5, begin.shape[1]))
        found: dict[int, list[tuple[np.ndarray, ...]]] = {j: [] for j in joints}
        for c, column in enumerate(columns):
            j, place = int(self._joint[column]), self._places[column]
            low = place.astype(int)
            share = (place - low)[:, None]
            angle = (1 - share) * angles[low, :, c] + share * angles[low + 1, :, c]  # (n, 8)
            by = (angle[:, 1:] - angle[:, :1]) / [*_STEPS, _BEGIN_RAD, _BEGIN_RAD_S]
            by_begin = np.vstack([by[:, 5:], np.diag(_BEGIN_WEIGHTS)])
            off = (self.begin[:, column] - begin[:, column]) * _BEGIN_WEIGHTS
            rest = np.append(self._measured[self._in_log[column], j] - angle[:, 0], off)
            both = np.column_stack([rest, np.vstack([by[:, :5], np.zeros((2, 5))])])
            explained = np.linalg.lstsq(by_begin, both, rcond=None)[0]
            both -= by_begin @ explained
            shift[:, column], shift_by[:, :, column] = explained[:, 0], explained[:, 1:]
            found[j].append((rest, both[:, 0], both[:, 1:], angle[:, 0]))

        def joined(part: int, empty: np.ndarray) -> dict[int, np.ndarray]:
            return {
                j: np.concatenate([one[part] for one in windows]) if windows else empty
                for j, windows in found.items()
            }

        return _Linearised(
            rest=joined(0, np.zeros(0)),
            free_rest=joined(1, np.zeros(0)),
            free_by=joined(2, np.zeros((0, 5))),
            angle={j: [one[3] for one in windows] for j, windows in found.items()},
            begin=begin,
            shift=shift,
            shift_by=shift_by,
        )


def _step(now: np.ndarray, rest: np.ndarray, by: np.ndarray, trust: float) -> np.ndarray:
    """A step of Levenberg and Marquardt; what stands at its bound and would leave it stays."""
    is_free = np.ones(len(now), dtype=bool)
    while True:
        step = np.zeros(len(now))
        normal = by[:, is_free].T @ by[:, is_free]
        damped = normal + trust * np.diag(np.diag(normal)) + 1e-12 * np.eye(len(normal))
        step[is_free] = np.linalg.solve(damped, by[:, is_free].T @ rest)
        leaves = is_free & (((now <= _LOW) & (step < 0)) | ((now >= _HIGH) & (step > 0)))
        if not leaves.any():
            return step
        is_free &= ~leaves


def _covariance(rest: np.ndarray, by: np.ndarray, sizes: list[int]) -> np.ndarray:
    """Of what is searched (5, 5), with windows of these sizes independent of each other.

    Residuals in a window are not (Liang and Zeger 1986, equation 2). inf of a single window.
    """
    ends = np.cumsum(sizes)[:-1]
    scores = [
        part.T @ own for part, own in zip(np.split(by, ends), np.split(rest, ends), strict=True)
    ]
    if len(scores) < 2:
        return np.full((5, 5), np.inf)
    inverse = np.linalg.pinv(by.T @ by)
    between = sum(np.outer(score, score) for score in scores) * len(scores) / (len(scores) - 1)
    covariance: np.ndarray = inverse @ between @ inverse
    return covariance


def _deviation(parameters: np.ndarray, covariance: np.ndarray, scene: Scene) -> Servo:
    """Standard deviations of servos found (J, 5) with covariances (J, 5, 5)."""
    at = _servo(parameters, scene)
    fields = [field.name for field in fields_of(Servo)]
    by = np.zeros((len(parameters), 5, 5))
    for k in range(5):
        near = _servo(parameters + 1e-6 * np.eye(5)[k], scene)
        for f, name in enumerate(fields):
            by[:, f, k] = (getattr(near, name) - getattr(at, name)) / 1e-6
    spread = np.sqrt(np.maximum(np.einsum("jfk,jkl,jfl->jf", by, covariance, by), 0))
    return Servo(**dict(zip(fields, spread.T, strict=True)))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean())) if len(values) else np.nan


def _windows(time_s: np.ndarray, is_on: np.ndarray, *, hanging: bool) -> list[tuple[float, float]]:
    """Begins and ends of what is replayed in one piece; at most so many, spread over the log."""
    edge = np.flatnonzero(np.diff(np.concatenate([[False], is_on, [False]]).astype(int)))
    cut_s = 0.0 if hanging else _ENDS_S
    found: list[tuple[float, float]] = []
    for first, end in edge.reshape(-1, 2):
        begin_s, end_s = float(time_s[first]) + cut_s, float(time_s[end - 1]) - cut_s
        if end_s - begin_s >= _SHORTEST_S:
            count = max(1, round((end_s - begin_s) / _LONGEST_S))
            found += pairwise(np.linspace(begin_s, end_s, count + 1).tolist())
    if len(found) > _MOST_WINDOWS:
        chosen = np.linspace(0, len(found) - 1, _MOST_WINDOWS).round().astype(int)
        found = [found[k] for k in chosen]
    return found


def _between(time_s: np.ndarray, begin_s: float, end_s: float) -> np.ndarray:
    return np.flatnonzero((time_s >= begin_s) & (time_s < end_s))
