"""The command `train` up to the training itself: what it takes, makes and refuses."""

from __future__ import annotations

import shutil
from types import SimpleNamespace

import pytest

from app.cli import main
from app.commands import dataset, train
from app.commands.train import TrainOptions, chosen_curriculum
from controller.checkpoint import TrainingError
from planner.corpus.corpus import MANIFEST, PLANS, corpus_of
from sim.robots import get_robot, robot_names
from tests.programs import refusal, run_python

WITH_H1 = pytest.mark.skipif(
    "h1" not in robot_names(), reason="its model comes with the extra `unitree`"
)


class Pretended:
    """A trainer that only tells what it was given."""

    made: list[Pretended] = []  # noqa: RUF012

    def __init__(self, robot, config, out, *, threads, command, planned, ranks, device):
        self.robot, self.config, self.out, self.command = robot, config, out, command
        self.planned, self.segment, self.resumed = planned, 0, False
        self.made.append(self)

    def resume(self):
        self.resumed = True

    def run(self, progress):
        (self.out / "checkpoint.pt").touch()


@pytest.fixture
def trainers(monkeypatch):
    monkeypatch.setattr(Pretended, "made", [])
    monkeypatch.setattr("controller.runner.Trainer", Pretended)
    monkeypatch.setattr(train, "CORPUS_PLANS", 2)
    return Pretended.made


@pytest.mark.slow
def test_run_from_nothing_makes_the_corpus_that_dataset_makes(tmp_path, trainers, monkeypatch):
    out, other = tmp_path / "run", tmp_path / "corpus"
    assert main(["train", "--out", str(out), "--workers", "1"]) == 0
    wide = ["--goal-x=-1,3", "--goal-y=-2,2", "--goal-yaw=-3.14,3.14", "--obstacles", "4"]
    words = ["dataset", "--count", "2", *wide, "--refine", "--workers", "1", "--out", str(other)]
    assert main(words) == 0
    for name in (PLANS, MANIFEST):
        assert (out / "corpus" / name).read_bytes() == (other / name).read_bytes()
    assert len(trainers[0].planned.offsets) == 3
    assert trainers[0].config.corpus == trainers[0].planned.digest != ""
    assert trainers[0].command.endswith("--curriculum measured --out DIR")

    monkeypatch.setattr(dataset, "run", lambda options: pytest.fail("the corpus is there"))
    assert main(["train", "--out", str(out), "--resume"]) == 0
    assert trainers[1].resumed
    assert trainers[1].config == trainers[0].config
    assert main(["train", "--out", str(tmp_path / "b"), "--corpus", str(other)]) == 0
    assert trainers[2].config == trainers[0].config
    assert trainers[2].command.endswith("--corpus CORPUS --out DIR")
    assert not (tmp_path / "b" / "corpus").exists()

    whole = trainers[0].config
    for what in ("periodic", "symmetry", "offset"):
        out = tmp_path / what
        assert main(["train", "--out", str(out), "--corpus", str(other), "--without", what]) == 0
        config = trainers[-1].config
        assert trainers[-1].command.endswith(f"--without {what} --corpus CORPUS --out DIR")
        assert config.ppo.symmetric == (what != "symmetry")
        assert config.ppo.half_sitting_offset == (what != "offset")
        for before, after in (
            (whole.warm_up, config.warm_up),
            (whole.task.reward, config.task.reward),
        ):
            dropped = before.keys() - after.keys()
            assert ("ground_force" in dropped) == (what == "periodic")
            assert all(before[term] == after[term] for term in after)


def test_folder_to_resume_from_must_hold_a_run(tmp_path, trainers, capsys):
    missing = tmp_path / "typo"
    assert "holds no checkpoint.pt" in refusal(capsys, "train", "--resume", "--out", missing)
    assert not missing.exists()
    (tmp_path / "checkpoint.pt").touch()
    assert "holds a run already; add --resume" in refusal(capsys, "train", "--out", tmp_path)
    # A run with a corpus from elsewhere: making another one would train on something else.
    error = refusal(capsys, "train", "--resume", "--out", tmp_path)
    assert "has no corpus of its own: name the one that it began with" in error
    assert not (tmp_path / "corpus").exists()
    assert trainers == []


@pytest.mark.slow
def test_checkpoint_that_cannot_be_taken_up_is_told_in_one_line(
    tmp_path, trainers, capsys, monkeypatch
):
    def refuse(trainer):
        raise TrainingError("checkpoint.pt is from another layout")

    assert main(["train", "--out", str(tmp_path), "--workers", "1"]) == 0
    capsys.readouterr()
    monkeypatch.setattr(Pretended, "resume", refuse)
    error = refusal(capsys, "train", "--resume", "--out", tmp_path)
    assert error == "error: checkpoint.pt is from another layout\n"


@pytest.mark.slow
def test_corpus_of_another_robot_is_refused(tmp_path, trainers, capsys):
    plans = tmp_path / "plans"
    plans.mkdir()
    assert main(["dataset", "--count", "1", "--out", str(plans)]) == 0
    capsys.readouterr()
    words = ["--robot", "hrp5p", "--corpus", plans, "--out", tmp_path / "run"]
    assert refusal(capsys, "train", *words) == (
        f"error: --corpus: {plans}: the plans are for robot 'jvrc1', not for 'hrp5p'; "
        "make one by `dataset --robot hrp5p --out DIR`\n"
    )
    corpus_of([], "hrp5p").save(plans, {})
    assert "no plan has a step" in refusal(capsys, "train", *words)
    (plans / PLANS).write_bytes(b"other")
    assert "is not the file that manifest.json was written for" in refusal(capsys, "train", *words)


def test_too_little_disk_is_told_before_any_work(tmp_path, trainers, capsys, monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=3_000_000))
    error = refusal(capsys, "train", "--out", tmp_path / "run")
    assert "too little disk: 3 MB are free" in error
    assert "a run needs 50 MB" in error
    assert not (tmp_path / "run" / "corpus").exists()


def test_disk_that_fills_up_ends_the_run_in_one_line(tmp_path, trainers, capsys, monkeypatch):
    def fill(trainer, progress):
        raise TrainingError("cannot write in DIR: No space left on device; make room")

    monkeypatch.setattr(Pretended, "run", fill)
    assert main(["train", "--out", str(tmp_path), "--workers", "1"]) == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert last == "error: cannot write in DIR: No space left on device; make room"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--rise", "0.3"], "0.3 m is not from 0.02 to 0.15 m, what JVRC-1's step limits"),
        (["--rise", "0.01"], "0.01 m is not from 0.02 to 0.15 m"),
        (["--rise", "nan"], "--rise"),
        pytest.param(
            ["--robot", "h1", "--rise", "0.1"],
            "Unitree H1 has no stairs in its step limits",
            marks=WITH_H1,
        ),
        (["--rise", "0.1", "--curriculum", "flat"], "0.1 m of rise and --curriculum flat"),
        (["--samples", "0"], "--samples"),
    ],
)
def test_impossible_ranges_are_refused(words, told, tmp_path, trainers, capsys):
    assert told in refusal(capsys, "train", *words, "--out", tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("robot", "words", "top_m"),
    [
        ("jvrc1", {}, 0.15),
        ("jvrc1", {"rise": 0.08}, 0.08),
        ("jvrc1", {"curriculum": "paper"}, 0.10),
        ("jvrc1", {"curriculum": "flat"}, 0.0),
        pytest.param("h1", {}, 0.0, marks=WITH_H1),
        pytest.param("h1", {"curriculum": "paper"}, 0.0, marks=WITH_H1),
    ],
)
def test_highest_stair_is_the_one_asked_for_or_the_robots(robot, words, top_m, tmp_path):
    options = TrainOptions(out=tmp_path, robot=robot, **words)
    assert chosen_curriculum(options, get_robot(robot)).top_rise_m == top_m


# Hides the libraries of the extra `train`, loads every file that does without, and runs a command.
WITHOUT_LEARNER = """
import importlib, pathlib, sys
hidden = {"torch", "rsl_rl", "tensordict", "tensorboard"}
class Finder:
    def __init__(self, finder):
        self.finder = finder
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] not in hidden:
            return self.finder.find_spec(name, path, target)
    def __getattr__(self, name):
        return getattr(self.finder, name)
sys.meta_path[:] = map(Finder, sys.meta_path)
learner = {f"controller.{name}" for name in ("ppo", "runner", "checkpoint", "ranks")}
files = [path for room in ("controller", "app") for path in pathlib.Path(room).rglob("*.py")]
names = {".".join(path.with_suffix("").parts) for path in files} - learner
assert len(names) > 60, names
for name in sorted(names):
    importlib.import_module(name)
from app.cli import main
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["navigate", "--map", "maps/room.png", "--goal", "0.5,0.5,0"], 0, "reached"),
        (["train"], 2, "train needs torch, rsl_rl, tensorboard, which the extra `train` installs"),
    ],
)
def test_only_training_needs_torch(words, code, said, tmp_path):
    done = run_python("-c", WITHOUT_LEARNER, *words, "--out", tmp_path)
    assert done.returncode == code, done.stderr
    assert said in done.stdout + done.stderr
    assert "Traceback" not in done.stderr
