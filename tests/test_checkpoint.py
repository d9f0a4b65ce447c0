"""Curriculum and swing ground, worked by hand; checkpoints: refusals and a full disk."""

from __future__ import annotations

import errno
import json
import math
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from controller.checkpoint import CHECKPOINT, TrainingError, read_checkpoint
from controller.curriculum import FLAT, MEASURED, PAPER, Curriculum, Stage
from controller.ppo import PpoConfig, TrainConfig
from controller.reward_inputs import swing_ground_m
from controller.runner import Trainer
from sim.robots import get_robot


def after(curriculum, stage, flat=1.0, stairs=1.0, updates=0):
    return curriculum.after(stage, updates=updates, flat_success=flat, stairs_success=stairs)


def test_run_begins_on_flat_ground_without_disturbances():
    assert {c.first() for c in (MEASURED, PAPER, FLAT)} == {
        Stage(rise_m=0.0, disturbance_level=0.0)
    }


def test_stairs_come_with_success_on_flat_ground_alone():
    assert after(MEASURED, Stage(), flat=0.94) == Stage()
    first = after(MEASURED, Stage(), flat=0.95, stairs=0.0)
    assert (first.rise_m, first.disturbance_level) == pytest.approx((0.015, 0.1))


def test_rise_grows_only_while_flat_and_stairs_both_succeed():
    stage = Stage(rise_m=0.03, disturbance_level=0.2)
    assert after(MEASURED, stage, flat=0.94, stairs=1.0) == stage
    assert after(MEASURED, stage, flat=1.0, stairs=0.89) == stage
    grown = after(MEASURED, stage, flat=0.95, stairs=0.90)
    assert (grown.rise_m, grown.disturbance_level) == pytest.approx((0.045, 0.3))


def test_rise_stops_at_the_top():
    curriculum = replace(MEASURED, top_rise_m=0.04)
    stage, rises = curriculum.first(), []
    for _ in range(4):
        stage = after(curriculum, stage)
        rises.append(stage.rise_m)
    assert rises == pytest.approx([0.015, 0.03, 0.04, 0.04])
    assert stage.disturbance_level == 1.0


@pytest.mark.parametrize(
    ("updates", "rise_m"),
    [(0, 0.0), (3000, 0.0), (7000, 0.05), (9000, 0.075), (11_000, 0.10), (20_000, 0.10)],
)
def test_papers_schedule_is_flat_for_3000_updates_then_linear_over_8000(updates, rise_m):
    """It asks for no success."""
    stage = after(PAPER, Stage(), flat=0.0, stairs=0.0, updates=updates)
    assert stage.rise_m == pytest.approx(rise_m)
    assert stage.disturbance_level == pytest.approx(rise_m / 0.10)


def test_flat_runs_get_the_disturbances_once_they_walk():
    assert after(FLAT, Stage(), flat=0.9) == Stage()
    assert after(FLAT, Stage(), flat=0.96) == Stage(rise_m=0.0, disturbance_level=1.0)


@pytest.mark.parametrize(
    "values",
    [
        {"top_rise_m": -0.1},
        {"top_rise_m": float("nan")},
        {"rise_step_m": 0.0},
        {"flat_success": 1.1},
        {"stairs_success": -0.1},
        {"flat_updates": -1},
        {"growth_updates": 0},
    ],
)
def test_impossible_curriculum_is_refused_by_its_name(values):
    with pytest.raises(ValueError, match=next(iter(values))):
        Curriculum(**values)


def lift(done_x_m, rise_m, y_m=0.0, way_m=0.4, gone=0.5):
    """Reference for a foot of 20 cm at x of a way along x, over a start at height 1."""
    sole = np.array([[done_x_m, y_m, 9.0, 0.0]])
    start, target = np.array([[0, 0, 1.0, 0.0]]), np.array([[way_m, 0, 1.0 + rise_m, 0.0]])
    return float(swing_ground_m(sole, start, target, np.array([gone]), 0.20)[0])


@pytest.mark.parametrize("x_m", [-0.1, 0.0, 0.13, 0.4, 0.6])
def test_ground_under_a_swing_on_the_level_is_the_level(x_m):
    assert lift(x_m, 0.0) == 1.0
    assert lift(x_m, 0.0, way_m=0.0) == 1.0


@pytest.mark.parametrize(
    ("x_m", "up_m"),
    [
        (-0.1, 1.00),  # swung back first
        (0.0, 1.00),
        (0.1, 1.05),  # a quarter of the way
        (0.2, 1.10),
        (0.3, 1.10),
        (0.5, 1.10),  # past its target
    ],
)
def test_ground_rises_early_going_up(x_m, up_m):
    assert lift(x_m, 0.10) == pytest.approx(up_m)
    assert lift(x_m, 0.10, y_m=0.3) == pytest.approx(up_m)  # only the way along counts


@pytest.mark.parametrize(
    ("x_m", "gone", "down_m"),
    [
        (-0.1, 0.9, 1.00),
        (0.24, 0.9, 1.00),  # the edge is at 0.2, the heel still 6 cm behind it
        (0.27, 0.9, 0.95),
        (0.30, 0.9, 0.90),  # past it
        (0.50, 0.9, 0.90),
        (0.40, 0.4, 1.00),  # there before its time
        (0.40, 0.625, 0.95),
        (0.40, 0.85, 0.90),
    ],
)
def test_ground_falls_once_the_heel_is_past_the_edge_and_it_is_time(x_m, gone, down_m):
    assert lift(x_m, -0.10, gone=gone) == pytest.approx(down_m)


def test_ground_falls_at_the_end_of_a_step_shorter_than_the_foot():
    assert lift(0.1, -0.10, way_m=0.1, gone=0.9) == pytest.approx(0.90)


# Checkpoints: what is refused, in one line, and what outlives a full disk.

SMALL = TrainConfig(
    samples=256,
    updates_per_segment=2,
    ppo=PpoConfig(robots=2, ticks_per_update=32, hidden=(8,), minibatches=2),
)


@pytest.fixture(scope="module")
def trainer(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    return Trainer(get_robot("jvrc1"), SMALL, folder, threads=1, command="test")


@pytest.fixture
def saved(trainer):
    """The trainer with its checkpoint as it was at the start."""
    trainer.segment, trainer.history = 0, []
    trainer.save_checkpoint()
    return trainer


def change(trainer, **values):
    """Put other values into the checkpoint; None takes the key out."""
    path = trainer.out / CHECKPOINT
    document = torch.load(path, weights_only=True)
    document.update(values)
    torch.save({key: value for key, value in document.items() if value is not None}, path)


def refusal(trainer) -> str:
    with pytest.raises(TrainingError) as raised:
        trainer.resume()
    message = str(raised.value)
    assert "\n" not in message
    return message


def test_checkpoint_of_another_layout_is_refused_saying_what_differs(saved):
    layout = json.loads(torch.load(saved.out / CHECKPOINT, weights_only=True)["layout"])
    assert layout["observation"][0] == ["roll_pitch_rad", 2]
    layout["observation"][0] = ["pitch_roll_rad", 2]
    change(saved, layout=json.dumps(layout))
    message = refusal(saved)
    assert "is from another layout: its observation is [['pitch_roll_rad', 2]" in message
    assert "jvrc1 has [['roll_pitch_rad', 2]" in message
    assert "damaged" not in message


def test_checkpoint_from_before_layouts_were_stored_is_taken(saved):
    change(saved, layout=None)
    saved.resume()
    assert read_checkpoint(saved.out, SMALL, saved.robot).segment == 0


def test_networks_of_another_size_are_refused(saved):
    learner = torch.load(saved.out / CHECKPOINT, weights_only=True)["learner"]
    key = next(k for k, v in learner["actor_state_dict"].items() if v.ndim == 2)
    learner["actor_state_dict"][key] = torch.zeros(8, 40)
    change(saved, learner=learner, layout=None)
    assert "its networks do not fit jvrc1 as it is now" in refusal(saved)


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"format": "walk-training/1"}, "is not a walk-training/5 checkpoint"),
        ({"stage": None}, "is damaged: KeyError('stage')"),
        ({"stage": {"rise": 0.1}}, "is damaged"),
        ({"config": "{"}, "is damaged"),
        ({"learner": {}}, "its networks do not fit"),
        ({"learner": "none"}, "its networks do not fit"),
        ({"segment": 10**30}, "is damaged"),
        ({"segment": -1}, "is damaged"),
        ({"segment": False}, "is damaged"),
        ({"segment": 1, "history": "[{}]"}, "a segment that was not assessed"),
        ({"segment": 1, "history": "[1]"}, "is damaged"),
        ({"stage": {"rise_m": math.nan, "disturbance_level": 0.0}}, "nan is not from 0 to 0.15"),
        ({"stage": {"rise_m": 0.2, "disturbance_level": 0.0}}, "0.2 is not from 0 to 0.15"),
        ({"stage": {"rise_m": "high", "disturbance_level": 0.0}}, "is damaged"),
        ({"blended": math.nan}, "rewards blended by nan"),
        ({"blended": 1.5}, "rewards blended by 1.5"),
        ({"blended": "all"}, "is damaged"),
        ({"best_score": [math.nan]}, "a best score of (nan,)"),
        ({"best_score": "good"}, "a best score of"),
    ],
)
def test_damaged_checkpoint_is_refused(saved, values, told):
    change(saved, **values)
    assert told in refusal(saved)


def with_moments(trainer):
    """The learner as its checkpoint has it once it has trained."""
    for group in trainer.ppo.optimizer.param_groups:
        for parameter in group["params"]:
            parameter.grad = torch.zeros_like(parameter)
    trainer.ppo.optimizer.step()
    trainer.save_checkpoint()
    return torch.load(trainer.out / CHECKPOINT, weights_only=True)["learner"]


def test_learner_that_has_trained_is_taken_up(saved):
    learner = with_moments(saved)
    assert learner["optimizer_state_dict"]["state"]
    saved.resume()


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("part", ["actor_state_dict", "critic_state_dict"])
def test_weights_that_are_not_finite_are_refused(saved, part, number):
    learner = with_moments(saved)
    next(w for w in learner[part].values() if w.ndim == 2)[3, 5] = number
    change(saved, learner=learner)
    assert "it holds numbers that are not finite" in refusal(saved)


@pytest.mark.parametrize(
    ("moment", "tensor", "told"),
    [
        ("exp_avg_sq", lambda was: -torch.ones_like(was), "negative squares"),
        ("exp_avg", lambda was: was * math.nan, "not finite"),
        ("step", lambda was: was * math.inf, "not finite"),
        ("exp_avg", lambda was: was[..., :-1], "do not fit"),
        ("exp_avg", lambda was: was.double(), "do not fit"),
        ("exp_avg", lambda was: was.to_sparse(), "do not fit"),
        ("exp_avg", lambda was: torch.zeros(1).expand(10**10), "do not fit"),
        ("exp_avg", lambda was: None, "do not fit"),
        ("other", lambda was: torch.zeros(1), "do not fit"),
    ],
)
def test_moments_that_no_training_gives_are_refused(saved, moment, tensor, told):
    learner = with_moments(saved)
    moments = next(iter(learner["optimizer_state_dict"]["state"].values()))
    moments[moment] = tensor(moments.get(moment))
    change(saved, learner=learner)
    assert told in refusal(saved)


@pytest.mark.parametrize(
    ("name", "value"),
    [("betas", (0.9, math.nan)), ("eps", "small"), ("lr", None), ("params", [0]), ("amsgrad", 1)],
)
def test_optimizers_with_other_settings_are_refused(saved, name, value):
    learner = with_moments(saved)
    learner["optimizer_state_dict"]["param_groups"][0][name] = value
    change(saved, learner=learner)
    assert "do not fit" in refusal(saved)


def test_bits_that_changed_in_the_weights_are_noticed(saved):
    """Torch reads such a file: only the checksums in it tell."""
    path = saved.out / CHECKPOINT
    content = bytearray(path.read_bytes())
    weights = next(
        w
        for w in torch.load(path, weights_only=True)["learner"]["actor_state_dict"].values()
        if w.ndim == 2
    )
    content[content.index(weights.numpy().tobytes()) + 10] ^= 1
    path.write_bytes(content)
    torch.load(path, weights_only=True)
    assert "it is damaged or no checkpoint" in refusal(saved)


def test_file_that_is_no_checkpoint_is_refused(saved):
    path = saved.out / CHECKPOINT
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    assert "it is damaged or no checkpoint" in refusal(saved)
    torch.save([1, 2], path)
    assert "is not a walk-training/5 checkpoint" in refusal(saved)
    path.unlink()
    assert "no checkpoint.pt" in refusal(saved)


def test_other_settings_are_named(saved):
    robot = get_robot("jvrc1")
    with pytest.raises(TrainingError, match=r"other settings \(seed, corpus\): resume") as raised:
        read_checkpoint(saved.out, replace(SMALL, seed=1, corpus="x"), robot)
    assert "damaged" not in str(raised.value)
    longer = replace(SMALL, samples=4000)  # a run may be made longer
    assert read_checkpoint(saved.out, longer, robot).segment == 0


def run_of(trainer, monkeypatch, writes):
    """A run whose segments cost nothing, each the best so far; tells what is written when."""

    def segment(writer):
        trainer.segment += 1
        trainer.history.append({"assess": {}, "assess_stairs": [], "rise_m": 0.0})
        return SimpleNamespace(best=True)

    real = Path.write_bytes

    def write_bytes(path, content):
        writes.append(path.suffix)
        if len(writes) > 5:
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(path, content)

    monkeypatch.setattr(trainer, "_run_segment", segment)
    monkeypatch.setattr(Path, "write_bytes", write_bytes)
    trainer.run(lambda report: None)


def test_full_disk_ends_the_run_in_one_line_and_keeps_the_last_checkpoint(saved, monkeypatch):
    """The policy comes before the checkpoint: a run killed between them writes it once more."""
    writes: list[str] = []
    with pytest.raises(TrainingError, match="No space left on device; make room") as raised:
        run_of(saved, monkeypatch, writes)
    assert "\n" not in str(raised.value)
    assert writes == [".safetensors", ".json", ".pt"] * 2
    assert read_checkpoint(saved.out, SMALL, saved.robot).segment == 1
    assert not list(saved.out.glob(".*"))


def test_run_stops_before_the_disk_is_full(saved, monkeypatch):
    free = iter([60_000_000, 40_000_000])
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=next(free)))
    with pytest.raises(TrainingError, match=r"too little disk: 40 MB .* needs 50 MB"):
        run_of(saved, monkeypatch, [])
    assert read_checkpoint(saved.out, SMALL, saved.robot).segment == 1
