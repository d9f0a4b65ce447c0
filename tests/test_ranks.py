"""Training in several ranks: equal parameters, resumed with other ranks, one that dies."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys

import numpy as np
import pytest
import torch

from app.cli import main
from controller.checkpoint import CHECKPOINT, TrainingError
from controller.ranks import Ranks, find_device
from planner.corpus.corpus import corpus_of
from planner.plan import FootstepPlan, feet_at
from planner.robot_model import Side
from sim.robots import get_robot
from tests.programs import ROOT, refusal

# Small runs of 20 updates, cut off after 10; `ranks` are those of the process.
TINY_RUNS = """
import hashlib, json, sys
from pathlib import Path
from controller.curriculum import Curriculum
from controller.env import TaskConfig
from controller.ppo import PpoConfig, TrainConfig
from controller.ranks import Ranks, joined_ranks
from controller.runner import Trainer
from sim.robots import get_robot

TINY = TrainConfig(
    samples=20 * 4 * 8,
    updates_per_segment=10,
    assess_episodes=3,
    curriculum=Curriculum(top_rise_m=0.1, rise_step_m=0.05, flat_success=0, stairs_success=0),
    task=TaskConfig(episode_ticks=8),
    ppo=PpoConfig(robots=4, ticks_per_update=8, hidden=(8,), minibatches=2, epochs=2),
)

def run(folder, ranks, *, resume=False, cut=False):
    trainer = Trainer(
        get_robot("jvrc1"), TINY, Path(folder), threads=1, command="test", ranks=ranks
    )
    if resume:
        trainer.resume()
    def progress(report):
        if cut:
            raise EOFError
    try:
        trainer.run(progress)
    except EOFError:
        pass
    return trainer

def digest(trainer):
    learner = trainer.ppo.save()
    tensors = [*learner["actor_state_dict"].values(), *learner["critic_state_dict"].values()]
    for state in learner["optimizer_state_dict"]["state"].values():
        tensors += [state["exp_avg"], state["exp_avg_sq"]]
    content = b"".join(tensor.numpy().tobytes() for tensor in tensors)
    known = [trainer.segment, trainer.best_score, str(trainer.stage), len(trainer.history)]
    return [hashlib.sha256(content).hexdigest(), *known]
"""

IN_RANKS = (
    TINY_RUNS
    + """
with joined_ranks() as ranks:
    out = Path(sys.argv[1])
    whole = run(out / "whole", ranks)
    advantages = whole.ppo.storage.advantages.double()
    run(out / "cut", ranks, cut=True)
    resumed = run(out / "cut", ranks, resume=True)
    taken_over = run(out / "alone", ranks, resume=True)
    told = {
        "robots": whole.env.num_envs,
        "whole": digest(whole),
        "resumed": digest(resumed),
        "taken_over": digest(taken_over),
        "advantages": [len(advantages.ravel()), advantages.sum().item(),
                       advantages.square().sum().item()],
        "episodes": whole.history[0]["assess"]["episodes"],
        "landings": whole.history[0]["landing_error_m"],
    }
    run(out / "left", ranks, cut=True)
    (out / f"rank-{ranks.rank}.json").write_text(json.dumps(told))
"""
)


def torchrun(ranks: int, *words: object) -> subprocess.CompletedProcess[str]:
    """A program in so many ranks on this machine."""
    launcher = "torch.distributed.run", "--standalone", "--nproc-per-node", ranks
    return subprocess.run(
        [sys.executable, "-m", *map(str, (*launcher, *words))],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )


def alone(folder, **how):
    """A run of one process in a folder, and its digest."""
    names: dict = {}
    exec(TINY_RUNS, names)
    trainer = names["run"](folder, Ranks(), **how)
    return trainer, names["digest"](trainer)


@pytest.mark.slow
def test_two_ranks_end_with_the_same_parameters_and_resume_each_others_runs(tmp_path):
    program = tmp_path / "in_ranks.py"
    program.write_text(IN_RANKS)
    alone(tmp_path / "alone", cut=True)
    done = torchrun(2, program, tmp_path)
    assert done.returncode == 0, done.stderr
    first, second = (json.loads((tmp_path / f"rank-{k}.json").read_text()) for k in (0, 1))
    # 20 updates: all parameters and moments of Adam, stage and best score.
    for name in ("whole", "resumed", "taken_over"):
        assert first[name] == second[name]
        assert first[name][1] == first[name][4] == 2
    assert first["whole"] == first["resumed"] != first["taken_over"]
    assert first["robots"] == second["robots"] == 2
    assert first["episodes"] == second["episodes"] == 3
    # Mean 0 and deviation 1 over both ranks, not in each.
    count, total, squares = np.add(first["advantages"], second["advantages"])
    assert count == 2 * 2 * 8
    assert total == pytest.approx(0.0, abs=1e-4)
    assert squares / (count - 1) == pytest.approx(1.0, abs=1e-4)
    assert abs(first["advantages"][1]) > 1e-3
    # One process goes on with what two have begun.
    trainer, _ = alone(tmp_path / "left", resume=True)
    assert (trainer.segment, trainer.env.num_envs) == (2, 4)


# The command line with small segments; what is in the second place happens before a segment.
COMMAND = """
import functools, os, signal, sys
import controller.ppo
from controller import runner
controller.ppo.TrainConfig = functools.partial(
    controller.ppo.TrainConfig, updates_per_segment=1, assess_episodes=2
)
segment = runner.Trainer._run_segment
def dying(self, writer):
    if (self.segment, self.ranks.rank) == (1, 1):
        os.kill(os.getpid(), signal.SIGKILL)
    return segment(self, writer)
runner.Trainer._run_segment = dying
from app.cli import main
sys.exit(main(sys.argv[1:]))
"""


def told_by(done: subprocess.CompletedProcess[str]) -> list[str]:
    """What the ranks said of the end, among the lines of torchrun itself."""
    return re.findall(r"^(?:error|warning|terminated|interrupted)\b.*", done.stderr, re.MULTILINE)


@pytest.mark.slow
def test_rank_that_dies_ends_all_in_one_line_and_leaves_a_whole_checkpoint(tmp_path):
    robot, start, goal = get_robot("jvrc1"), (0.0, 0.0, 0.0), (0.1, 0.0, 0.0)
    feet, ahead = (feet_at(pose, robot.step_model.stance_width_m) for pose in (start, goal))
    plan = FootstepPlan(
        start_feet_world=feet,
        start=start,
        goal=goal,
        side=np.array([Side.LEFT, Side.RIGHT], np.int8),
        pose_world=ahead,
    )
    corpus, out, program = tmp_path / "corpus", tmp_path / "run", tmp_path / "command.py"
    corpus.mkdir()
    corpus_of([plan], robot.name).save(corpus, {})
    program.write_text(COMMAND)
    words = ["train", "--corpus", corpus, "--out", out, "--simulations", 2, "--samples", 256]
    done = torchrun(2, program, *words)
    assert done.returncode != 0
    (line,) = told_by(done)
    assert line.startswith("error: ")
    assert line.endswith("go on from there with --resume")
    assert torch.load(out / CHECKPOINT, weights_only=True)["segment"] == 1
    names = {path.name for path in out.iterdir()} - {".lock"}
    assert names == {CHECKPOINT, "config.json", "tensorboard", "jvrc1.json", "jvrc1.safetensors"}
    about = json.loads((out / "jvrc1.json").read_text())
    command = "torchrun --nproc-per-node 2 main.py train --robot jvrc1 --samples 256 --seed 0"
    assert about["trained"]["command"].startswith(command)
    assert " --simulations 2 " in about["trained"]["command"]


def test_simulations_must_divide_among_the_ranks():
    Ranks(rank=2, count=4).require_equal_shares(12)
    with pytest.raises(
        TrainingError, match="4 simulations do not divide among 3 ranks: start 1, 2, 4"
    ):
        Ranks(rank=0, count=3).require_equal_shares(4)


def test_wrong_command_line_is_told_by_the_first_rank_of_a_machine(capsys, monkeypatch):
    monkeypatch.setenv("LOCAL_RANK", "0")
    assert "--samples" in refusal(capsys, "train", "--out", "x", "--samples", "0")
    monkeypatch.setenv("LOCAL_RANK", "1")
    with pytest.raises(SystemExit) as ended:
        main(["train", "--out", "x", "--samples", "0"])
    assert ended.value.code == 2
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize(("total", "count"), [(10, 3), (2, 4), (256, 8)])
def test_shares_add_up_and_differ_by_at_most_one(total, count):
    shares = [Ranks(rank=rank, count=count).share(total) for rank in range(count)]
    assert sum(shares) == total
    assert max(shares) - min(shares) <= 1


def test_every_rank_draws_something_else_and_one_alone_what_it_always_drew():
    drawn = [
        Ranks(rank=rank, count=count).seed_sequence(7, 3).generate_state(4).tolist()
        for count in (1, 2, 4)
        for rank in range(count)
    ]
    assert len({tuple(state) for state in drawn}) == 7
    assert drawn[0] == np.random.SeedSequence([7, 3]).generate_state(4).tolist()


def test_device_is_the_cpu_unless_there_is_a_gpu(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert {find_device(name, Ranks()).type for name in ("auto", "cpu")} == {"cpu"}
    with pytest.raises(TrainingError, match=r"--device cuda: torch .* finds no GPU here") as raised:
        find_device("cuda", Ranks())
    assert "\n" not in str(raised.value)


def test_ranks_of_a_machine_take_its_gpus_in_turn(monkeypatch):
    chosen: list[torch.device] = []
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.setattr(torch.cuda, "set_device", chosen.append)
    for local_rank in range(3):
        find_device("auto", Ranks(rank=local_rank, count=3, local_rank=local_rank))
    assert [device.index for device in chosen] == [0, 1, 0]
    assert find_device("cpu", Ranks()).type == "cpu"
