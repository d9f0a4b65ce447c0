"""A corpus of footstep plans as arrays, and the folder that holds it.

`DIR/plans.npz` has the arrays of `Corpus`, `DIR/manifest.json` tells what made them. This file
needs numpy only, so that training can draw plans without loading the planner.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from maps.files import check_unpacked, read_json, read_limited, written_whole
from planner.plan import FootstepPlan, PlanStatus, feet_at, relative_steps
from planner.robot_model import StepModel

FORMAT = "footstep-corpus/1"
PLANS, MANIFEST = "plans.npz", "manifest.json"
MOST_PLANS_BYTES = 2_000_000_000
# Type and shape of each array: n plans, m steps, k obstacles for each plan, o offsets.
_ARRAYS: Mapping[str, tuple[Any, str]] = {
    "offsets": (np.int64, "o"),
    "side": (np.int8, "m"),
    "pose": (np.float64, "m4"),
    "start": (np.float64, "n3"),
    "start_z": (np.float64, "n2"),
    "goal": (np.float64, "n3"),
    "cost_m": (np.float64, "n"),
    "status": (np.str_, "n"),
    "box": (np.float64, "nk5"),
}

Floats = NDArray[np.float64]
_TOLERANCE = 1e-6


class CorpusError(ValueError):
    """A folder holds no corpus that can be used here; the message is one line."""


@dataclass(frozen=True, kw_only=True)
class Corpus:
    """n plans of m steps in all, k obstacles each; arrays are read-only.

    offsets (n + 1,): plan i has the steps offsets[i] to offsets[i + 1] of side and pose. side (m,):
    0 left, 1 right. pose (m, 4): x_m, y_m, z_m, yaw_rad of each foot placed. start, goal (n, 3):
    pair poses x_m, y_m, yaw_rad. start_z (n, 2): z_m of the left and right foot at the start.
    cost_m (n,). status (n,): `PlanStatus` as text. box (n, k, 5): the obstacles that were drawn for
    each plan: x_m, y_m of the centre, length_m, width_m, yaw_rad. All in the world. robot: the name
    of the robot that can walk these plans.
    Raises CorpusError where the arrays do not fit together.
    """

    offsets: NDArray[np.int64]
    side: NDArray[np.int8]
    pose: Floats
    start: Floats
    start_z: Floats
    goal: Floats
    cost_m: Floats
    status: NDArray[np.str_]
    box: Floats
    robot: str = ""
    manifest: Mapping[str, Any] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        for name, (kind, _) in _ARRAYS.items():
            array = np.array(getattr(self, name), dtype=kind)
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        self._check()

    def _check(self) -> None:
        n, m = self.status.size, self.side.size
        counts = {"n": n, "m": m, "o": n + 1, "k": self.box.shape[1] if self.box.ndim == 3 else 0}
        for name, (_, letters) in _ARRAYS.items():
            shape = tuple(counts[c] if c in counts else int(c) for c in letters)
            found = getattr(self, name).shape
            if found != shape:
                raise CorpusError(f"{name} {found} must be {shape} for {n} plans and {m} steps")
        if self.offsets[0] != 0 or self.offsets[-1] != m or np.any(np.diff(self.offsets) < 0):
            raise CorpusError(f"offsets must grow from 0 to {m}, the number of steps")
        if not np.isin(self.side, (0, 1)).all():
            raise CorpusError("side must be 0 (left) or 1 (right) at every step")
        unknown = set(np.unique(self.status)) - set(PlanStatus)
        if unknown:
            raise CorpusError(
                f"status {str(min(unknown))!r} must be one of {', '.join(PlanStatus)}"
            )
        for name, (kind, _) in _ARRAYS.items():
            if kind is np.float64 and not np.isfinite(getattr(self, name)).all():
                raise CorpusError(f"{name} must be finite everywhere")

    def __len__(self) -> int:
        return len(self.status)

    def plan(self, i: int) -> tuple[NDArray[np.int8], Floats]:
        """Side (N,) and pose (N, 4) of the steps of plan i, in the order in which they are taken.

        Before the first of them the feet are at `start_feet`.
        """
        if not 0 <= i < len(self):
            raise IndexError(f"plan {i} must be from 0 to {len(self) - 1}")
        first, last = self.offsets[i], self.offsets[i + 1]
        return self.side[first:last], self.pose[first:last]

    def start_feet(self, i: int, stance_width_m: float) -> Floats:
        """Feet (2, 4) in the world, left then right, before the first step of plan i."""
        feet = feet_at(self.start[i], stance_width_m)
        feet[:, 2] = self.start_z[i]
        return feet

    def support(self, stance_width_m: float) -> Floats:
        """Pose (m, 4) of the foot that stands while each step is taken."""
        support = np.empty_like(self.pose)
        support[1:] = self.pose[:-1]
        for i in np.flatnonzero(np.diff(self.offsets)):
            first = self.offsets[i]
            support[first] = self.start_feet(int(i), stance_width_m)[1 - self.side[first]]
        return support

    def relative_steps(self, stance_width_m: float) -> Floats:
        """Steps (m, 3): x_m, y_m, yaw_rad of each foot in the frame of the foot that it leaves.

        y and yaw are counted outward, so they compare with StepLimits whatever the side. The feet
        stand stance_width_m apart at each start.
        """
        support, planar = self.support(stance_width_m), [0, 1, 3]
        return relative_steps(support[:, planar], self.pose[:, planar], 1 - 2 * self.side)

    def require_fit(self, robot: str, model: StepModel) -> None:
        """Raises CorpusError unless the robot of that name and step model can walk all plans."""
        if self.robot != robot:
            raise CorpusError(f"the plans are for robot {self.robot!r}, not for {robot!r}")
        if not len(self.side):
            raise CorpusError("no plan has a step")
        steps = self.relative_steps(model.stance_width_m)
        rise_m = self.pose[:, 2] - self.support(model.stance_width_m)[:, 2]
        low_m, high_m = model.limits.z_m
        inside = model.limits.contain(steps, _TOLERANCE)
        inside &= (rise_m >= low_m - _TOLERANCE) & (rise_m <= high_m + _TOLERANCE)
        outside = np.flatnonzero(~inside)
        if len(outside):
            first = int(outside[0])
            plan = int(np.searchsorted(self.offsets, first, side="right")) - 1
            x_m, y_m, yaw_rad = (float(v) for v in steps[first])
            raise CorpusError(
                f"step {first - self.offsets[plan]} of plan {plan} (x {x_m:.3f}, y {y_m:.3f}, "
                f"z {rise_m[first]:.3f}, yaw {yaw_rad:.3f}) is outside the step limits "
                f"of {robot} ({len(outside)} of {len(steps)} steps are)"
            )

    def save(self, folder: Path, manifest: Mapping[str, Any]) -> None:
        """Writes both files into a folder that exists, each under a temporary name first.

        manifest: what made the plans; format, robot, counts and the plans' digest are added. The
        same content gives the same bytes. Raises OSError where they cannot be written.
        """
        plans = self._to_npz()
        document = {
            "format": FORMAT,
            "robot": self.robot,
            "plans": len(self),
            "steps": len(self.side),
            **manifest,
            "sha256": hashlib.sha256(plans).hexdigest(),
        }
        text = json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False) + "\n"
        # Between the two renamings the digest keeps a reader from mixing old and new.
        with (
            written_whole(folder / PLANS) as new_plans,
            written_whole(folder / MANIFEST) as new_manifest,
        ):
            new_plans.write_bytes(plans)
            new_manifest.write_bytes(text.encode())

    def _to_npz(self) -> bytes:
        """The arrays as bytes of an npz file, without compression and with one date for all."""
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
            for name in _ARRAYS:
                member = io.BytesIO()
                np.lib.format.write_array(member, getattr(self, name), allow_pickle=False)
                archive.writestr(
                    zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0)), member.getvalue()
                )
        return buffer.getvalue()

    @staticmethod
    def load(folder: Path, *, even_if_changed: bool = False) -> Corpus:
        """The corpus in a folder. Raises CorpusError where there is none that can be read.

        even_if_changed: take plans that are not those that the manifest was written for.
        """
        manifest = _read_manifest(folder)
        try:
            plans = read_limited(folder / PLANS, MOST_PLANS_BYTES)
        except OSError as error:
            raise CorpusError(f"{folder} is no corpus: {PLANS}: {error.strerror}") from None
        if not even_if_changed and hashlib.sha256(plans).hexdigest() != manifest.get("sha256"):
            raise CorpusError(f"{folder}: {PLANS} is not the file that {MANIFEST} was written for")
        try:
            return Corpus(**_from_npz(plans), robot=str(manifest["robot"]), manifest=manifest)
        except KeyError as error:
            raise CorpusError(f"{folder} is no corpus: {error} is missing") from None
        except CorpusError:
            raise
        # What numpy and zipfile raise on damaged archives is of many kinds.
        except Exception as error:
            raise CorpusError(f"{folder} is no corpus: {PLANS}: {error}") from None


def _from_npz(plans: bytes) -> dict[str, NDArray[Any]]:
    """The arrays in the bytes of an npz file.

    Raises whatever numpy and zipfile raise on damaged archives, before memory is taken for what
    an archive or the header of an array only claims to hold.
    """
    check_unpacked(io.BytesIO(plans))
    with zipfile.ZipFile(io.BytesIO(plans)) as archive:
        missing = {f"{name}.npy" for name in _ARRAYS} - set(archive.namelist())
        if missing:
            raise KeyError(min(missing))
        return {name: _array_of(archive.read(f"{name}.npy")) for name in _ARRAYS}


def _array_of(member: bytes) -> NDArray[Any]:
    """The array in the bytes of an npy file. Raises ValueError if its header says more or less."""
    file = io.BytesIO(member)
    is_first = np.lib.format.read_magic(file) == (1, 0)
    form = np.lib.format
    header = form.read_array_header_1_0 if is_first else form.read_array_header_2_0
    shape, _, kind = header(file)
    claimed, held = math.prod(shape) * kind.itemsize, len(member) - file.tell()
    if claimed != held or not kind.itemsize:
        raise ValueError(f"an array {shape} of {kind} takes {claimed} bytes, there are {held}")
    file.seek(0)
    return form.read_array(file, allow_pickle=False)


def corpus_of(plans: list[FootstepPlan], robot: str, box: ArrayLike | None = None) -> Corpus:
    """The corpus of some plans, in their order. box: see `Corpus`; no obstacles if not given."""
    lengths = [len(plan) for plan in plans]
    n = len(plans)
    return Corpus(
        offsets=np.concatenate([[0], np.cumsum(lengths)]),
        side=np.concatenate([plan.side for plan in plans] or [np.zeros(0, np.int8)]),
        pose=np.concatenate([plan.pose_world for plan in plans] or [np.zeros((0, 4))]),
        start=np.array([plan.start for plan in plans]).reshape(n, 3),
        start_z=np.array([plan.start_feet_world[:, 2] for plan in plans]).reshape(n, 2),
        goal=np.array([plan.goal for plan in plans]).reshape(n, 3),
        cost_m=np.array([plan.cost_m for plan in plans]),
        status=np.array([str(plan.status) for plan in plans], dtype=np.str_),
        box=np.zeros((n, 0, 5)) if box is None else np.asarray(box),
        robot=robot,
    )


def _read_manifest(folder: Path) -> dict[str, Any]:
    if not folder.is_dir():
        raise CorpusError(f"{folder} is no corpus: it is not a folder")
    try:
        manifest = read_json(folder / MANIFEST)
    except (OSError, ValueError) as error:
        told = error.strerror if isinstance(error, OSError) else error
        raise CorpusError(f"{folder} is no corpus: {MANIFEST}: {told}") from None
    found = manifest.get("format") if isinstance(manifest, dict) else None
    if found != FORMAT:
        raise CorpusError(f"{folder}: the format in {MANIFEST} is {found!r}, must be {FORMAT!r}")
    return dict(manifest)
