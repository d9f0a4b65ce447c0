"""The assessment that training makes of itself, in simulations and with a seed of its own."""

from __future__ import annotations

import numpy as np

from controller.assessment import ModeResult, assess_mode
from controller.curriculum import Stage
from controller.policy import Policy
from controller.train_config import TrainConfig
from sim.robot import Robot

ASSESS_SEED = 987_654_321
# The held-out stair episodes with disturbances: what the follower is to withstand.
ROUGH = {"tread_error_m": 0.03, "joint_noise_deg": 3.0}


def assess_stage(
    robot: Robot, policy: Policy, config: TrainConfig, stage: Stage, *, threads: int
) -> tuple[ModeResult, ...]:
    """Results at a stage: flat, then, where it has stairs, those without and with disturbances.

    The disturbances have the share that the stage gives those of training. The episodes of the
    configuration are divided among the results.
    """
    cases: list[tuple[str | None, dict[str, float]]] = [(None, {})]
    if stage.rise_m > 0:
        rough = {name: stage.hardness * value for name, value in ROUGH.items()}
        cases += [("stairs", {"rise_m": stage.rise_m, **extra}) for extra in ({}, rough)]
    return tuple(
        assess_mode(
            robot,
            policy,
            mode,
            episodes=-(-config.assess_episodes // len(cases)),
            seed=ASSESS_SEED,
            threads=threads,
            config=config.task,
            **settings,
        )
        for mode, settings in cases
    )


def score(stage: Stage, results: tuple[ModeResult, ...]) -> tuple[float, float]:
    """What tells the better of two policies: the greater tuple.

    The one that was assessed at the higher rise is better; then falls count first, then the foot
    error.
    """
    return stage.rise_m, sum(_score(result) for result in results)


def _score(result: ModeResult) -> float:
    error_m = float(result.summary["error_m_p95"])
    return 100.0 * (result.success - 1.0) - (error_m if np.isfinite(error_m) else 1.0)
