"""A corpus of plans: what goes in comes out, to the byte; what is none is refused in one line."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from planner.corpus.corpus import Corpus, CorpusError, corpus_of
from planner.plan import FootstepPlan, feet_at, relative_step
from planner.robot_model import Side
from sim.robots import get_robot

MODEL = get_robot("jvrc1").step_model
WIDTH_M = MODEL.stance_width_m


def walk(start: tuple[float, float, float], *steps: tuple[Side, float, float, float]):
    """A plan whose steps are given as swing side and outward pose in the support foot's frame."""
    feet = feet_at(start, WIDTH_M)
    poses = []
    for side, x_m, y_m, yaw_rad in steps:
        support = feet[side.other]
        cos, sin, out = math.cos(support[3]), math.sin(support[3]), side.outward
        feet[side] = (
            support[0] + cos * x_m - sin * out * y_m,
            support[1] + sin * x_m + cos * out * y_m,
            0.0,
            support[3] + out * yaw_rad,
        )
        poses.append(feet[side].copy())
    return FootstepPlan(
        start_feet_world=feet_at(start, WIDTH_M),
        start=start,
        goal=start,
        side=np.array([side for side, *_ in steps], np.int8),
        pose_world=np.array(poses).reshape(-1, 4),
        cost_m=float(len(steps)),
    )


STEPS_A = ((Side.LEFT, 0.1, WIDTH_M, 0.1), (Side.RIGHT, 0.2, WIDTH_M, 0.0))
STEPS_B = ((Side.RIGHT, -0.05, WIDTH_M + 0.02, 0.05),)


@pytest.fixture
def corpus() -> Corpus:
    return corpus_of(
        [walk((0.0, 0.0, 0.0), *STEPS_A), walk((1.0, 2.0, 3.0)), walk((1.0, -1.0, 2.0), *STEPS_B)],
        "jvrc1",
    )


def test_each_plan_comes_back_out(corpus):
    assert len(corpus) == 3
    side, pose = corpus.plan(0)
    assert side.tolist() == [0, 1]
    # By hand: the left foot goes 0.1 ahead of the right foot, half a width to the side.
    np.testing.assert_allclose(pose[0], [0.1, WIDTH_M / 2, 0.0, 0.1], atol=1e-12)
    assert len(corpus.plan(1)[0]) == 0
    assert corpus.plan(2)[0].tolist() == [1]
    with pytest.raises(IndexError, match="plan 3 must be from 0 to 2"):
        corpus.plan(3)


def test_steps_relative_to_the_support_foot(corpus):
    steps = corpus.relative_steps(WIDTH_M)
    np.testing.assert_allclose(steps, [step[1:] for step in (*STEPS_A, *STEPS_B)], atol=1e-12)
    # The law of a single step, from planner/plan.py, says the same.
    start = feet_at(corpus.start[2], WIDTH_M)[Side.LEFT]
    one = relative_step(start, corpus.plan(2)[1][0], Side.RIGHT)
    np.testing.assert_allclose(steps[2], one, atol=1e-12)


def test_what_was_saved_is_loaded(corpus, tmp_path):
    corpus.save(tmp_path, {"seed": 7})
    loaded = Corpus.load(tmp_path)
    for name in ("offsets", "side", "pose", "start", "start_z", "goal", "cost_m", "status", "box"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(corpus, name))
    assert loaded.robot == "jvrc1"
    assert (loaded.manifest["seed"], loaded.manifest["plans"], loaded.manifest["steps"]) == (
        7,
        3,
        3,
    )
    assert not loaded.pose.flags.writeable
    assert sorted(path.name for path in tmp_path.iterdir()) == ["manifest.json", "plans.npz"]


def test_the_same_content_gives_the_same_bytes(corpus, tmp_path, monkeypatch):
    for name, now in (("a", 0.0), ("b", 1e9)):
        monkeypatch.setattr("time.time", lambda now=now: now)
        (tmp_path / name).mkdir()
        corpus.save(tmp_path / name, {"seed": 7})
    for file in ("plans.npz", "manifest.json"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


def test_numpy_reads_the_arrays(corpus, tmp_path):
    corpus.save(tmp_path, {})
    with np.load(tmp_path / "plans.npz") as arrays:
        assert arrays["status"].tolist() == ["found"] * 3
        assert arrays["offsets"].tolist() == [0, 2, 2, 3]


def test_a_corpus_fits_its_robot_alone(corpus):
    corpus.require_fit("jvrc1", MODEL)
    with pytest.raises(CorpusError, match="for robot 'jvrc1', not for 'hrp5p'"):
        corpus.require_fit("hrp5p", MODEL)
    limits = replace(MODEL.limits, x_m=(-0.01, 0.3))
    steps = tuple(step for step in MODEL.steps if limits.contain(step))
    narrow = replace(MODEL, limits=limits, steps=steps)
    with pytest.raises(CorpusError, match=r"step 0 of plan 2 \(x -0.050.*1 of 3 steps"):
        corpus.require_fit("jvrc1", narrow)


def test_steps_that_rise_too_far(corpus):
    pose = np.array(corpus.pose)
    pose[:2, 2] = 0.1, 0.2
    stairs = replace(corpus, pose=pose)
    limits = replace(MODEL.limits, z_m=(-0.1, 0.1))
    stairs.require_fit("jvrc1", replace(MODEL, limits=limits))
    pose[1, 2] = 0.201
    with pytest.raises(CorpusError, match=r"step 1 of plan 0 \(x .* z 0\.101, .*1 of 3 steps"):
        replace(corpus, pose=pose).require_fit("jvrc1", replace(MODEL, limits=limits))
    # A plan that starts up there does not rise.
    pose[:] = corpus.pose
    pose[:2, 2] = 0.5
    high = replace(corpus, pose=pose, start_z=[[0.5, 0.5], [0.0, 0.0], [0.0, 0.0]])
    high.require_fit("jvrc1", replace(MODEL, limits=replace(limits, z_m=(0.0, 0.0))))
    np.testing.assert_array_equal(high.start_feet(0, WIDTH_M)[:, 2], [0.5, 0.5])


def test_a_folder_that_holds_no_corpus(tmp_path, corpus):
    with pytest.raises(CorpusError, match="it is not a folder"):
        Corpus.load(tmp_path / "nowhere")
    with pytest.raises(CorpusError, match=r"manifest\.json: No such file"):
        Corpus.load(tmp_path)
    corpus.save(tmp_path, {})
    manifest = tmp_path / "manifest.json"
    document = json.loads(manifest.read_text())
    for text, told in (
        ("{", r"manifest\.json"),
        ("[]", "format"),
        (json.dumps(document | {"format": "footstep-corpus/9"}), "'footstep-corpus/9', must be"),
    ):
        manifest.write_text(text)
        with pytest.raises(CorpusError, match=told) as caught:
            Corpus.load(tmp_path)
        assert "\n" not in str(caught.value)


def test_plans_that_the_manifest_does_not_know(tmp_path, corpus):
    corpus.save(tmp_path, {})
    plans = tmp_path / "plans.npz"
    plans.write_bytes(plans.read_bytes()[:-100])
    with pytest.raises(CorpusError, match="not the file"):
        Corpus.load(tmp_path)
    plans.unlink()
    with pytest.raises(CorpusError, match=r"plans\.npz: No such file"):
        Corpus.load(tmp_path)


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("offsets", [0, 2, 3], "offsets"),
        ("offsets", [0, 3, 2, 3], "offsets must grow"),
        ("side", [0, 1, 2], "side must be"),
        ("pose", np.full((3, 4), np.nan), "pose must be finite"),
        ("status", ["found", "found", "lost"], "'lost' must be one of found"),
    ],
)
def test_arrays_that_do_not_fit_together(corpus, name, value, told):
    with pytest.raises(CorpusError, match=told):
        replace(corpus, **{name: value})
