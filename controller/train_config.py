"""A whole training run as one value: what is trained, on what, how long."""

from __future__ import annotations

from dataclasses import dataclass, field

from controller.curriculum import Curriculum
from controller.ppo import PpoConfig
from controller.task_config import TaskConfig


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """A whole run. `samples` are control steps of single robots.

    `corpus` is the digest of the planner's corpus that is trained on, empty for none.
    """

    robot: str = "jvrc1"
    samples: int = 16_000_000
    seed: int = 0
    corpus: str = ""
    updates_per_segment: int = 20
    assess_episodes: int = 128
    curriculum: Curriculum = field(default_factory=Curriculum)
    task: TaskConfig = field(default_factory=TaskConfig)
    ppo: PpoConfig = field(default_factory=PpoConfig)

    @property
    def samples_per_segment(self) -> int:
        """Control steps between two checkpoints."""
        return self.updates_per_segment * self.ppo.samples_per_update

    @property
    def segments(self) -> int:
        """Segments of the whole run; the last one may go a little past `samples`."""
        return -(-self.samples // self.samples_per_segment)
