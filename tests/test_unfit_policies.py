"""Policies that cannot walk: their walks end, in time, and what is not a number is not loaded."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.navigation.navigator import Navigator, NavigatorConfig
from app.navigation.report import Outcome
from controller.policy import Policy, PolicyError, load_policy, save_policy
from maps.grid import OccupancyGrid
from sim.robots import get_robot

ROBOT = get_robot("jvrc1")
FLOOR = OccupancyGrid(
    cells=np.zeros((80, 80), np.uint8), resolution_m=0.05, origin=(-2.0, -2.0, 0.0)
)


def with_weights(change) -> Policy:
    """The shipped policy with its weights and biases changed by a function of layer and array."""
    policy = load_policy(ROBOT)
    layers = [
        (change(k, weight).astype(np.float32), change(k, bias).astype(np.float32))
        for k, (weight, bias) in enumerate(policy.layers)
    ]
    return replace(policy, layers=tuple(layers))


RNG = np.random.default_rng(0)
LAST = len(load_policy(ROBOT).layers) - 1
UNFIT = {
    "random": lambda _, array: RNG.normal(scale=0.5, size=array.shape),
    "silent": lambda _, array: 0.0 * array,
    # As if its actions were meant for servos of other gains.
    "weak": lambda k, array: array * (0.3 if k == LAST else 1.0),
    "strong": lambda k, array: array * (3.0 if k == LAST else 1.0),
    "mirrored": lambda k, array: -array if k == LAST else array,
    "damaged": lambda _, array: np.where(RNG.random(array.shape) < 0.2, 0.0, array),
    "without bounds": lambda _, array: 1e30 * array,
}


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of numbers without bounds
@pytest.mark.parametrize("name", UNFIT)
def test_a_walk_ends_within_what_its_plans_allow(name, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    config = NavigatorConfig(max_replans=2)
    walk = Navigator(
        FLOOR,
        ROBOT,
        with_weights(UNFIT[name]),
        start=(0.0, 0.0, 0.0),
        goal=(0.3, 0.1, 0.3),
        config=config,
    )
    walk.plan()
    while walk.outcome is None:
        walk.tick()
    assert walk.outcome in (Outcome.FELL, Outcome.TIMED_OUT)
    assert walk.reason
    # Each plan is waited for, walked, and may overrun by so much; then the robot may settle.
    own_s = config.wait_s + config.spare_time_s + config.settle_limit_s
    steps = sum(len(plan) for plan in walk.plans)
    assert walk.time_s <= steps * ROBOT.gait.step_s + len(walk.plans) * own_s
    assert len(walk.plans) <= 1 + config.max_replans
    # MuJoCo writes what it thinks of a simulation into the working folder, if nobody stops it.
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("part", ["weight", "bias", "offset", "scale"])
def test_numbers_that_are_not_finite_are_refused_at_loading(tmp_path, part, value):
    def spoiled(array):
        array = np.array(array)
        array.flat[-1] = value
        return array

    policy = load_policy(ROBOT)
    if part in ("offset", "scale"):
        policy = replace(policy, **{part: spoiled(getattr(policy, part))})
    else:
        weight, bias = policy.layers[0]
        spoilt = (spoiled(weight), bias) if part == "weight" else (weight, spoiled(bias))
        policy = replace(policy, layers=(spoilt, *policy.layers[1:]))
    path = tmp_path / "jvrc1.safetensors"
    save_policy(policy, path)
    with pytest.raises(PolicyError, match="not finite"):
        load_policy(ROBOT, path)
