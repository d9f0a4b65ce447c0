"""The commands `dataset` and `dataset check`, and what they are made of."""

from __future__ import annotations

import dataclasses
import json
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.cli import main
from app.commands.dataset import lhw_text
from app.output import ExitCode
from maps.boxes import with_boxes
from maps.grid import Cell, OccupancyGrid
from maps.map_files import copy_map, find_map, load_map
from planner.corpus.check import from_document
from planner.corpus.corpus import Corpus
from planner.corpus.generate import RandomPlans, floor_around, random_plans
from planner.options import PlannerOptions
from planner.robot_model import StepModel
from planner.verify import violations
from sim.robots import get_robot, robot_names
from tests.programs import ROOM, ROOT, interrupted, picture_at, refusal

MODEL = get_robot("jvrc1").step_model


def dataset(folder: Path, *words: str) -> Corpus:
    assert main(("dataset", "--out", str(folder), "--workers", "1", *words)) == ExitCode.DONE
    return Corpus.load(folder)


@pytest.fixture(scope="module")
def small(tmp_path_factory) -> Path:
    """The folder of twelve plans on the empty floor, with the text."""
    folder: Path = tmp_path_factory.mktemp("corpus")
    dataset(folder, "--count", "12", "--seed", "3", "--format", "lhw")
    return folder


def test_plans_start_at_the_origin_and_end_in_the_ranges(small):
    corpus = Corpus.load(small)
    assert len(corpus) == 12
    assert not corpus.start.any()
    low, high = np.array([0, -1, -np.pi / 2]), np.array([2, 1, np.pi / 2])
    assert np.all((corpus.goal >= low) & (corpus.goal <= high))
    # Twelve numbers that are evenly drawn hardly ever stay in the middle half of their range.
    assert np.all(np.ptp(corpus.goal, axis=0) > (high - low) / 2)
    for i in range(12):
        side, pose = corpus.plan(i)
        assert np.all(side[1:] != side[:-1])
        np.testing.assert_allclose(pose[-2:, :2].mean(axis=0), corpus.goal[i, :2], atol=1e-9)


def test_the_manifest_tells_what_made_the_plans(small):
    manifest = json.loads((small / "manifest.json").read_text())
    corpus = Corpus.load(small)
    assert manifest["format"] == "footstep-corpus/1"
    assert (manifest["robot"], manifest["seed"], manifest["plans"]) == ("jvrc1", 3, 12)
    assert manifest["steps"] == len(corpus.side) == corpus.offsets[-1]
    assert manifest["draws"] == 12 + sum(manifest["refused"].values())
    assert manifest["planner"]["name"] == "ara"
    assert from_document(StepModel, manifest["step_model"]) == MODEL
    corpus.require_fit("jvrc1", MODEL)


@pytest.mark.slow
def test_the_same_bytes_whatever_the_workers(tmp_path):
    words = ("--count", "9", "--seed", "5", "--obstacles", "2", "--goal-x", "0,3")
    one, two = tmp_path / "one", tmp_path / "two"
    dataset(one, *words)
    dataset(two, *words, "--workers", "2")
    files = sorted(path.name for path in one.iterdir())
    assert files == ["manifest.json", "plans.npz", "plans.png", "steps.png"]
    assert files == sorted(path.name for path in two.iterdir())
    for file in files:
        assert (one / file).read_bytes() == (two / file).read_bytes(), file
    for file in ("plans.png", "steps.png"):
        picture = picture_at(one / file)
        assert min(picture.shape[:2]) > 400
        assert picture.std() > 5


@pytest.mark.parametrize("planner", ["ara", pytest.param("rrtconnect", marks=pytest.mark.slow)])
def test_a_plan_does_not_depend_on_those_before_it(planner):
    floor = floor_around([(0.0, -1.0, 0.0), (2.0, 1.0, 0.0)], MODEL)
    wanted = RandomPlans(
        grid=floor,
        model=MODEL,
        goal_x_m=(0.0, 2.0),
        goal_y_m=(-1.0, 1.0),
        goal_yaw_rad=(-1.0, 1.0),
        start=(0.0, 0.0, 0.0),
        obstacles=2,
        options=PlannerOptions(name=planner, refine=planner == "ara"),
    )
    together, alone = random_plans(wanted, [0, 1, 2])[2], random_plans(wanted, [2])[0]
    assert together.plan is not None
    assert alone.plan is not None
    np.testing.assert_array_equal(together.plan.pose_world, alone.plan.pose_world)
    np.testing.assert_array_equal(together.box, alone.box)
    other = random_plans(dataclasses.replace(wanted, seed=1), [2])[0]
    assert not np.array_equal(together.box, other.box)


def test_an_empty_map_has_edges_all_the_same():
    room = OccupancyGrid(cells=np.zeros((50, 50), np.uint8), resolution_m=0.05)
    wanted = RandomPlans(
        grid=room,
        model=MODEL,
        goal_x_m=(0.0, 2.5),
        goal_y_m=(0.0, 2.5),
        goal_yaw_rad=(-3.0, 3.0),
    )
    for drawn in random_plans(wanted, range(5)):
        assert drawn.plan is not None
        assert violations(drawn.plan, room, MODEL) == []


def check(capsys, folder: Path, *words: str) -> tuple[int, dict[str, Any], list[str]]:
    """Exit code, document and lines of `dataset check`."""
    capsys.readouterr()
    code = main(("dataset", "check", str(folder), "--workers", "1", "--json", *words))
    out, err = capsys.readouterr()
    return code, json.loads(out), err.splitlines()


def test_all_plans_pass_the_check(small, capsys):
    code, document, lines = check(capsys, small)
    assert (code, document["plans"], document["wrong"], lines) == (ExitCode.DONE, 12, {}, [])


def tampered(small: Path, folder: Path, **changes: Any) -> None:
    corpus = Corpus.load(small)
    folder.mkdir(exist_ok=True)
    dataclasses.replace(corpus, **changes).save(folder, {**corpus.manifest})


def test_the_check_names_the_plan_with_a_step_out_of_limits(small, tmp_path, capsys):
    corpus = Corpus.load(small)
    pose = np.array(corpus.pose)
    pose[corpus.offsets[4] + 1, 0] += 0.5
    tampered(small, tmp_path, pose=pose)
    code, document, lines = check(capsys, tmp_path)
    assert code == ExitCode.BAD_INPUT
    assert list(document["wrong"]) == ["4"]
    assert lines[0].startswith("plan 4: step 1: x ")


def test_the_check_finds_a_plan_that_walks_through_an_obstacle(small, tmp_path, capsys):
    corpus = Corpus.load(small)
    box = np.zeros((12, 1, 5))
    box[:, 0] = -1.0, 0.0, 0.3, 0.3, 0.0
    box[7, 0, :2] = corpus.goal[7, :2]
    tampered(small, tmp_path, box=box)
    code, document, lines = check(capsys, tmp_path)
    assert (code, list(document["wrong"])) == (ExitCode.BAD_INPUT, ["7"])
    assert any("the body on both feet hits something" in line for line in lines)


def test_the_check_finds_plans_that_another_robot_cannot_walk(small, capsys):
    code, document, lines = check(capsys, small, "--robot", "hrp5p")
    assert code == ExitCode.BAD_INPUT
    # HRP-5P stands with its feet farther apart.
    assert len(document["wrong"]) == 12
    assert "plan 0: the last two feet are not the goal's" in lines


def test_of_very_many_wrong_steps_the_first_are_told(small, tmp_path, capsys):
    tampered(small, tmp_path, pose=Corpus.load(small).pose * (9.0, 1.0, 1.0, 1.0))
    code, document, lines = check(capsys, tmp_path)
    total = sum(map(len, document["wrong"].values()))
    assert (code, len(lines)) == (ExitCode.BAD_INPUT, 21)
    assert lines[-1] == f"... and {total - 20} more; --json shows all"


def test_the_check_sees_that_a_file_was_changed(small, tmp_path, capsys):
    corpus = Corpus.load(small)
    tampered(small, tmp_path, cost_m=corpus.cost_m + 1.0)
    (tmp_path / "manifest.json").write_bytes((small / "manifest.json").read_bytes())
    code, document, lines = check(capsys, tmp_path)
    assert (code, document["changed"], document["wrong"]) == (ExitCode.BAD_INPUT, True, {})
    assert lines == ["plans.npz is not the file that manifest.json was written for"]


@pytest.mark.slow
def test_a_corpus_on_a_map(tmp_path, capsys):
    corpus = dataset(tmp_path, "--count", "3", "--map", ROOM, "--goal-x", "1.5,6")
    assert np.all(corpus.goal[:, 0] >= 1.5)
    assert len(np.unique(corpus.start, axis=0)) == 3
    grid, kept = load_map(ROOM), load_map(tmp_path / "map.yaml")
    np.testing.assert_array_equal(grid.cells, kept.cells)
    assert (kept.origin, kept.resolution_m) == (grid.origin, grid.resolution_m)
    code, document, _ = check(capsys, tmp_path)
    assert (code, document["wrong"]) == (ExitCode.DONE, {})
    assert (tmp_path / "map.png").read_bytes() == Path(ROOM).read_bytes()
    # A new corpus takes the place of the old one, files that it does not have included.
    dataset(tmp_path, "--count", "1")
    assert not (tmp_path / "map.png").exists()
    assert len(Corpus.load(tmp_path)) == 1


@pytest.mark.slow
def test_a_corpus_on_stairs(tmp_path, capsys):
    stairs = str(ROOT / "maps" / "stairs.yaml")
    # From the floor, up or not, as the map has it.
    corpus = dataset(tmp_path, "--count", "4", "--seed", "1", "--map", stairs)
    assert corpus.pose[:, 2].max() > 0.0
    code, document, _ = check(capsys, tmp_path)
    assert (code, document["wrong"]) == (ExitCode.DONE, {})
    pose = np.array(corpus.pose)
    pose[corpus.offsets[2], 2] += 0.03
    tampered(tmp_path, tmp_path, pose=pose)
    code, document, _ = check(capsys, tmp_path)
    assert (code, list(document["wrong"])) == (ExitCode.BAD_INPUT, ["2"])


def test_the_text_is_read_as_the_paper_s_code_reads_it(small):
    corpus, half_m = Corpus.load(small), MODEL.stance_width_m / 2
    plans: list[np.ndarray] = []
    plan: list[list[float]] = []
    for line in (small / "plans.txt").read_text().splitlines():
        if line == "---":
            if plan:
                plans.append(np.array(plan))
            plan = []
        else:
            plan.append([float(number) for number in line.split(",")])
    assert len(plans) == 12
    for i, rows in enumerate(plans):
        side, pose = corpus.plan(i)
        # The foot that stands is the one that does not swing first.
        np.testing.assert_array_equal(rows[0], [0.0, half_m if side[0] == 1 else -half_m, 0.0])
        np.testing.assert_allclose(rows[1:], pose[:, [0, 1, 3]], atol=1e-12)


def test_the_text_is_in_the_frame_of_the_start(small):
    corpus = Corpus.load(small)
    turned = np.array(corpus.pose)
    # By hand: turned by a quarter and moved by (5, 6), a point (x, y) comes to (5 - y, 6 + x).
    turned[:, 0], turned[:, 1] = 5.0 - corpus.pose[:, 1], 6.0 + corpus.pose[:, 0]
    turned[:, 3] += np.pi / 2
    start = np.tile([5.0, 6.0, np.pi / 2], (12, 1))
    moved = lhw_text(dataclasses.replace(corpus, pose=turned, start=start), MODEL.stance_width_m)
    for ours, theirs in zip(moved.split(), (small / "plans.txt").read_text().split(), strict=True):
        if theirs != "---":
            a, b = ([float(v) for v in line.split(",")] for line in (ours, theirs))
            np.testing.assert_allclose(a, b, atol=1e-9)


@pytest.mark.slow
def test_what_can_never_be_drawn_is_told_with_counts(tmp_path, capsys):
    out = tmp_path / "new"
    words = ("--out", str(out), "--workers", "1", "--map", ROOM, "--start", "0,0,0")
    # Within a bookcase.
    told = refusal(capsys, "dataset", *words, "--goal-x", "0.9,1.1", "--goal-y", "0,1")
    assert "plan 0 cannot be drawn: 1000 of 1000 draws" in told
    assert "(1000 goal_blocked)" in told
    assert "goal: the left foot at " in told
    assert not out.exists()


def test_bad_input_is_told_in_one_line(tmp_path, capsys):
    out = ("--out", str(tmp_path / "new"))
    assert "'2,1' is not a range" in refusal(capsys, "dataset", *out, "--goal-x", "2,1")
    assert "--count: '0' is not" in refusal(capsys, "dataset", *out, "--count", "0")
    assert "nowhere.png" in refusal(capsys, "dataset", *out, "--map", "nowhere.png")
    assert "'robbie'" in refusal(capsys, "dataset", *out, "--robot", "robbie")
    assert "give --map" in refusal(capsys, "dataset", *out, "--resolution", "0.05")
    (tmp_path / "file").touch()
    assert "cannot make the folder" in refusal(
        capsys, "dataset", "--out", tmp_path / "file" / "new"
    )
    assert "it is not a folder" in refusal(capsys, "dataset", "check", tmp_path / "new")
    assert "manifest.json: No such file" in refusal(capsys, "dataset", "check", tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file"]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"floor": None}, "manifest.json: "),
        ({"floor": ...}, "'floor' is missing"),
        ({"step_model": {"steps": [[0.0]]}}, "manifest.json: "),
        ({"step_model": {"wings": 2}}, "StepModel has no 'wings'"),
        ({"map": {"file": "none.png"}}, "none.png: no such file"),
    ],
)
def test_a_manifest_that_does_not_tell_enough(small, tmp_path, capsys, change, told):
    manifest = json.loads((small / "manifest.json").read_text()) | change
    manifest = {key: value for key, value in manifest.items() if value is not ...}
    (tmp_path / "plans.npz").write_bytes((small / "plans.npz").read_bytes())
    (tmp_path / "manifest.json").write_text(json.dumps(manifest))
    assert told in refusal(capsys, "dataset", "check", tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("by", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_leaves_nothing_behind(tmp_path, by):
    out = tmp_path / "new"
    words = ["dataset", "--count", "100000", "--workers", "2", "--out", str(out)]

    def begun(process):
        while not out.exists() and process.poll() is None:
            time.sleep(0.05)
        time.sleep(1.0)

    # It returns when the workers, too, have let go of standard error.
    code, lines = interrupted("main.py", *words, when=begun, by=by)
    assert code == (ExitCode.INTERRUPTED if by == signal.SIGINT else ExitCode.TERMINATED)
    assert lines[-1] == ("interrupted" if by == signal.SIGINT else "terminated")
    assert not any("Traceback" in line for line in lines)
    assert list(tmp_path.iterdir()) == []


def test_every_robot_s_step_model_comes_back_from_its_document():
    for name in robot_names():
        model = get_robot(name).step_model
        document = json.loads(json.dumps(dataclasses.asdict(model)))
        assert from_document(StepModel, document) == model


def test_cells_below_a_box_are_occupied():
    floor = OccupancyGrid(
        cells=np.zeros((20, 20), np.uint8), resolution_m=0.1, origin=(-1.0, -1.0, 0.0)
    )
    # By hand: 0.4 x 0.2 m about the origin, a corner of cells, hold 4 x 2 centres.
    flat = with_boxes(floor, np.array([[0.0, 0.0, 0.4, 0.2, 0.0]])).cells
    assert flat.sum() == 8
    assert np.all(flat[9:11, 8:12] == Cell.OCCUPIED)
    upright = with_boxes(floor, np.array([[0.0, 0.0, 0.4, 0.2, np.pi / 2]])).cells
    np.testing.assert_array_equal(upright, flat.T)
    # A box of side a, turned by 45 degrees, holds the centres with |x| + |y| <= a / sqrt(2).
    turned = with_boxes(floor, np.array([[0.05, 0.05, 0.3, 0.3, np.pi / 4]])).cells
    assert turned.sum() == 13
    assert with_boxes(floor, np.array([[5.0, 0.0, 0.4, 0.2, 0.0]])).cells.sum() == 0
    half = with_boxes(floor, np.array([[-1.0, 0.0, 0.4, 0.2, 0.0]])).cells
    assert half.sum() == 4


def test_the_copy_of_a_map_reads_as_the_map(tmp_path):
    metadata = find_map(ROOT / "maps" / "stairs.png", resolution_m=0.1 / 3, origin=(-1.25, 1e-7, 2))
    copy_map(metadata, tmp_path)
    copy = load_map(tmp_path / "map.yaml")
    grid = load_map(ROOT / "maps" / "stairs.png")
    assert (copy.resolution_m, copy.origin) == (0.1 / 3, (-1.25, 1e-7, 2))
    np.testing.assert_array_equal(copy.cells, grid.cells)
    assert copy.elevation_m is not None
    np.testing.assert_array_equal(copy.elevation_m, grid.elevation_m)
