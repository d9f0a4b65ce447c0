"""The command `sweep`: the runs of a file, what it refuses, and going on with what is missing."""

from __future__ import annotations

import json

import pytest

from app.cli import main
from app.commands import train
from app.commands.sweep import cells, read_sweep, runs_of, table
from app.output import ExitCode, InputError, claim_folder, say
from planner.corpus.corpus import MANIFEST
from tests.programs import refusal

FOUR = "samples: 1000\nseed: [0, 1]\nreward: [quiet, paper]\n"


def write(folder, text):
    file = folder / "sweep.yaml"
    file.write_text(text)
    return file


def test_every_combination_is_a_run_named_by_the_lists(tmp_path):
    file = write(tmp_path, FOUR)
    runs = runs_of(file, read_sweep(file), tmp_path)
    assert [(one.name, one.options.seed, one.options.reward) for one in runs] == [
        ("seed-0_reward-quiet", 0, "quiet"),
        ("seed-0_reward-paper", 0, "paper"),
        ("seed-1_reward-quiet", 1, "quiet"),
        ("seed-1_reward-paper", 1, "paper"),
    ]
    assert {one.options.samples for one in runs} == {1000}
    assert runs[3].options.out == tmp_path / "seed-1_reward-paper"
    assert runs[3].settings == {"samples": "1000", "seed": "1", "reward": "paper"}


def test_file_without_lists_is_one_run(tmp_path):
    file = write(tmp_path, "rise: 0.1\n")
    (one,) = runs_of(file, read_sweep(file), tmp_path)
    assert (one.name, one.options.rise) == ("run", 0.1)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "must hold options of train, such as the line seed: [0, 1, 2]"),
        ("- seed", "must hold options of train"),
        ("seed: [0, 1", "is no YAML"),
        ("sede: [0, 1]", "there is no option --sede; did you mean --seed?"),
        ("seed: [0, x]", "--seed: 'x' is not a whole number"),
        ("seed: [0, 0]", "seed has a value twice: 0, 0"),
        ("seed: []", "seed must be a word, a number, or a list of them, not []"),
        ("seed: [[0, 1], 2]", "seed must be a word, a number, or a list of them"),
        ("seed: {a: 1}", "seed must be a word, a number, or a list of them"),
        ("resume: true", "resume is for the sweep to set"),
        ("robot: [jvrc1, nobody]", "nobody"),
        ("rise: [0.1, 0.9]", "0.9 m is not from 0.02 to 0.15 m"),
        (f"seed: {list(range(40))}\nsamples: {list(range(1, 31))}", "asks for 1200 runs"),
        ("seed: &a [0]\nsamples: *a", "an alias"),
        ("corpus: [a/b, a_b]", "two runs would have the folder corpus-a_b"),
    ],
)
def test_file_that_is_wrong_is_refused_before_any_work(text, told, tmp_path, capsys):
    error = refusal(capsys, "sweep", write(tmp_path, text), "--out", tmp_path / "out")
    assert told in error
    assert "sweep.yaml" in error
    assert not (tmp_path / "out").exists()
    assert "cannot be read" in refusal(capsys, "sweep", tmp_path / "none.yaml")


def assessed(falls):
    errors = {"error_m_median": 0.0123, "error_m_p95": 0.034}
    return {"falls": falls, "episodes": 8, "success": 1 - falls / 8, **errors}


@pytest.fixture
def trained(monkeypatch):
    """Trainings that only leave what a real one leaves; those of seed 13 find no room."""
    calls: list[train.TrainOptions] = []

    def pretend(options):
        calls.append(options)
        claim_folder(options.out, option="--out")
        say(f"going on: {options.resume}")
        (options.out / "checkpoint.pt").touch()
        if options.seed == 13:
            raise InputError("too little disk: 3 MB are free")
        about = {
            "samples": 2_500_000,
            "rise_m": 0.06,
            "assessed": assessed(options.seed),
            "assessed_stairs": [assessed(0), assessed(2)],
        }
        (options.out / f"{options.robot}.json").write_text(json.dumps({"trained": about}))

    def corpus(folder, robot, workers, *, cluster):
        folder.mkdir()
        (folder / MANIFEST).touch()

    monkeypatch.setattr(train, "run", pretend)
    monkeypatch.setattr(train, "make_corpus", corpus)
    return calls


def test_sweep_trains_what_is_missing_and_goes_on_with_what_was_begun(tmp_path, trained, capsys):
    out = tmp_path / "out"
    words = ["sweep", str(write(tmp_path, "seed: [0, 1]\n")), "--out", str(out), "--workers", "1"]
    assert main(words) == ExitCode.DONE
    assert [(one.seed, one.resume) for one in trained] == [(0, False), (1, False)]
    assert {one.corpus for one in trained} == {out / "corpus-jvrc1"}
    assert capsys.readouterr().out.splitlines() == [
        "run     best at  fell    feet, median / p95  rise    stairs, plain / rough",
        "seed-0  2.50 M   0 of 8  1.2 cm / 3.4 cm     6.0 cm  100 % / 75 %",
        "seed-1  2.50 M   1 of 8  1.2 cm / 3.4 cm     6.0 cm  100 % / 75 %",
    ]
    assert (out / "seed-1" / "train.log").read_text() == "going on: False\n"
    rows = json.loads((out / "sweep.json").read_text())["runs"]
    assert [row["policy"] for row in rows] == [f"seed-{k}/jvrc1.safetensors" for k in (0, 1)]

    assert main(words) == ExitCode.DONE
    assert len(trained) == 2
    (out / "seed-1" / "run.json").unlink()  # as if it had been cut off
    write(tmp_path, "seed: [0, 1, 2]\n")
    assert main(words) == ExitCode.DONE
    assert [(one.seed, one.resume) for one in trained[2:]] == [(1, True), (2, False)]
    assert "1 of 3 runs are there already" in capsys.readouterr().err
    # Other settings under the same name are not what is there.
    write(tmp_path, "seed: [0]\nsamples: 5000\n")
    assert main(words) == ExitCode.DONE
    assert (trained[4].seed, trained[4].samples, trained[4].resume) == (0, 5000, True)


def test_run_that_fails_is_told_and_the_others_go_on(tmp_path, trained, capsys):
    out = tmp_path / "out"
    words = ["sweep", str(write(tmp_path, "seed: [13, 2]\n")), "--out", str(out), "--workers", "1"]
    assert main([*words, "--json"]) == ExitCode.BAD_INPUT
    rows = json.loads(capsys.readouterr().out)["runs"]
    assert [row["outcome"] for row in rows] == ["failed", "trained"]
    assert rows[0]["reason"] == "too little disk: 3 MB are free"
    assert "seed-13  too little disk: 3 MB are free\n" in table(rows)
    assert "error: too little disk" in (out / "seed-13" / "train.log").read_text()
    assert not (out / "seed-13" / "run.json").exists()
    assert main(words) == ExitCode.BAD_INPUT
    assert [one.seed for one in trained] == [13, 2, 13]


def test_run_without_landings_and_stairs_has_no_numbers_for_them():
    flat = {**assessed(8), "error_m_median": None, "error_m_p95": None}
    row = {"outcome": "trained", "samples": 1e5, "rise_m": 0, "assessed": flat}
    assert cells({**row, "assessed_stairs": []})[1:] == ("8 of 8", "- / -", "0.0 cm", "-")
