"""Training as short as can be, for benchmarks that begin it often."""

from __future__ import annotations

import functools

# Three segments of one update each, of two robots.
WORDS = ["train", "--samples", "300", "--simulations", "2", "--workers", "1"]


def shorten_training() -> None:
    """Lets the command `train` of this process, and of copies of it, train in short segments.

    No option of the command does: a segment of 20 updates and an assessment of 128 episodes take
    minutes.
    """
    import controller.ppo  # not above: workers of those benchmarks need no torch

    controller.ppo.TrainConfig = functools.partial(  # type: ignore[misc,assignment]
        controller.ppo.TrainConfig, updates_per_segment=1, assess_episodes=2
    )
