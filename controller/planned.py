"""Steps of the planner's corpus, as training draws them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controller.step_cursor import Track
from controller.step_sequences import chain_steps
from planner.corpus.corpus import Corpus
from planner.robot_model import Side, StepModel


@dataclass(frozen=True, kw_only=True)
class PlannedSteps:
    """All steps (m, 3) of n plans in their support foot's frame, y and yaw outward.

    Plan i has the steps offsets[i] to offsets[i + 1]; digest tells one corpus from another.
    """

    offsets: np.ndarray
    relative: np.ndarray
    digest: str

    @classmethod
    def of(cls, corpus: Corpus, robot: str, model: StepModel) -> PlannedSteps:
        """The steps of a corpus that the robot of that name can walk.

        Raises:
            CorpusError: the plans are another robot's, outside the limits, or have no step.
        """
        corpus.require_fit(robot, model)
        return cls(
            offsets=corpus.offsets,
            relative=corpus.relative_steps(model.stance_width_m),
            digest=str(corpus.manifest.get("sha256", "")),
        )

    def draw(self, rng: np.random.Generator, start_feet_world: np.ndarray, *, steps: int) -> Track:
        """At most `steps` steps in a row of one plan, from the feet (2, 4), either foot first.

        With the other foot first it is the plan in a mirror.
        """
        plan = int(rng.choice(np.flatnonzero(np.diff(self.offsets))))
        first, last = int(self.offsets[plan]), int(self.offsets[plan + 1])
        begin = int(rng.integers(first, max(first, last - steps) + 1))
        foot = Side(int(rng.integers(2)))
        side, poses = chain_steps(
            start_feet_world, foot, self.relative[begin : min(begin + steps, last)]
        )
        return Track.of(start_feet_world, side, poses)
