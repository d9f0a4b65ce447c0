"""Where compiled code and tables are kept: apart by sources, and in a place that can be written."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

import planner
from planner.heuristics.heuristic import tables_of
from planner.heuristics.table_file import read_tables, write_tables
from planner.robot_model import BodyShape, FootShape, StepLimits, StepModel

FOLDER = Path(planner.__file__).parent
CALLEE = (
    "from planner.compiled import njit_no_refcount\n\n\n"
    "@njit_no_refcount\ndef value():\n    return {}\n"
)
CALLER = (
    "from planner.callee import value\nfrom planner.compiled import njit_no_refcount\n\n\n"
    "@njit_no_refcount\ndef twice():\n    return 2 * value()\n"
)


@pytest.fixture
def sources(tmp_path):
    """A folder with a package `planner` of which two functions are compiled."""
    folder = tmp_path / "sources" / "planner"
    folder.mkdir(parents=True)
    for name in ("__init__.py", "cache.py", "compiled.py"):
        shutil.copy(FOLDER / name, folder / name)
    (folder / "callee.py").write_text(CALLEE.format(1))
    (folder / "caller.py").write_text(CALLER)
    return folder


def twice(sources: Path, **environment: str) -> tuple[str, str]:
    """What the compiled function of the package says in a process of its own, and its errors."""
    kept = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", "PYTHONPATH")}
    run = subprocess.run(
        [sys.executable, "-c", "from planner.caller import twice; print(twice())"],
        cwd=sources.parent,
        env=kept | environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return run.stdout.strip(), run.stderr


def code_in(folder: Path) -> list[Path]:
    return sorted(folder.rglob("*.nbc"))


def shut(folder: Path) -> None:
    """Lets nothing be made in a folder, for root neither: a file is in its place."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    folder.write_text("")


@pytest.mark.parametrize("named", [False, True])
def test_a_changed_callee_in_another_file_is_compiled_anew(sources, tmp_path, named):
    environment = {"NUMBA_CACHE_DIR": str(tmp_path / "named")} if named else {}
    for number in (1, 2):
        (sources / "callee.py").write_text(CALLEE.format(number))
        assert twice(sources, **environment) == (str(2 * number), "")
    folder = tmp_path / "named" if named else sources / "__pycache__"
    assert len(list(folder.glob("numba-*"))) == 2
    assert len(code_in(folder)) == 4


@pytest.mark.slow
def test_caches_of_other_sources_go_once_they_are_old_and_nothing_else_does(sources):
    caches = sources / "__pycache__"
    old, used, young = (caches / f"numba-{name}" for name in ("old", "used", "young"))
    others = caches / "numbers", caches / "numba.txt"
    for folder in (old, used, young, others[0]):
        (folder / "part").mkdir(parents=True)
        (folder / "part" / "code.nbc").write_text("")
    others[1].write_text("")
    two_days_ago = time.time() - 2 * 24 * 3600
    for path in caches.rglob("*"):
        # Of `used` one file was written just now.
        if path.is_relative_to(young) or path == used / "part" / "code.nbc":
            continue
        os.utime(path, (two_days_ago, two_days_ago))
    assert twice(sources)[0] == "2"
    assert not old.exists()
    for kept in (used, young, *others):
        assert kept.exists()
    # The cache of these sources is there now, and is left alone however old it is.
    (own,) = set(caches.glob("numba-*")) - {used, young}
    for path in (own, *own.rglob("*")):
        os.utime(path, (two_days_ago, two_days_ago))
    assert twice(sources)[0] == "2"
    assert own.exists()


def test_where_the_sources_cannot_be_written_to_the_users_caches_serve(sources, tmp_path):
    shut(sources / "__pycache__")
    assert twice(sources, XDG_CACHE_HOME=str(tmp_path / "caches")) == ("2", "")
    assert len(code_in(tmp_path / "caches" / "footfall")) == 2


def test_without_a_home_temporary_files_serve_and_one_line_says_so(sources, tmp_path):
    shut(sources / "__pycache__")
    shut(tmp_path / "home")
    (tmp_path / "tmp").mkdir()
    places = {"HOME": str(tmp_path / "home"), "TMPDIR": str(tmp_path / "tmp")}
    said, errors = twice(sources, XDG_CACHE_HOME="", **places)
    assert said == "2"
    (folder,) = (tmp_path / "tmp").glob("footfall*")
    assert len(code_in(folder)) == 2
    assert errors.count("UserWarning") == 1
    assert f"compiled code is kept in {folder}" in errors
    # What others may write to is not read.
    folder.chmod(0o777)
    said, errors = twice(sources, XDG_CACHE_HOME="", **places)
    assert said == "2"
    assert errors.count("UserWarning") == 1
    assert "compiled again at every start" in errors


@dataclass(frozen=True, kw_only=True)
class _Table:
    cost: np.ndarray
    inside: np.ndarray
    rate: float
    cap: int


TABLE = _Table(
    cost=np.arange(12, dtype=np.int32).reshape(3, 4).T,
    inside=np.array([True, False, True]),
    rate=0.1 + 0.2,
    cap=1 << 40,
)


def test_tables_come_back_from_their_file_to_the_bit(tmp_path):
    path = tmp_path / "tables"
    write_tables(path, "key", [TABLE, TABLE])
    read = read_tables(path, "key", [_Table, _Table])
    assert read is not None
    assert len(read) == 2
    for kept in read:
        assert (kept.rate, kept.cap) == (TABLE.rate, TABLE.cap)
        for name in ("cost", "inside"):
            array, before = getattr(kept, name), getattr(TABLE, name)
            assert array.dtype == before.dtype
            assert array.flags.c_contiguous
            np.testing.assert_array_equal(array, before)
        kept.cost[:] = 0
    again = read_tables(path, "key", [_Table, _Table])
    assert again is not None
    assert again[0].cost[1, 0] == TABLE.cost[1, 0]


def test_tables_that_are_damaged_or_made_for_something_else_are_not_read(tmp_path):
    path = tmp_path / "tables"
    assert read_tables(path, "key", [_Table]) is None
    write_tables(path, "key", [TABLE])
    assert read_tables(path, "another key", [_Table]) is None
    whole = path.read_bytes()
    for at in (0, 40, 60, len(whole) - 1):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
        assert read_tables(path, "key", [_Table]) is None
    for length in (0, 10, 40, len(whole) - 1):
        path.write_bytes(whole[:length])
        assert read_tables(path, "key", [_Table]) is None


MODEL = StepModel(
    foot=FootShape(length_m=0.2, width_m=0.1),
    body=BodyShape(length_m=0.2, width_m=0.5),
    limits=StepLimits(x_m=(-0.2, 0.3), y_m=(0.1, 0.3), yaw_rad=(-0.4, 0.4)),
    steps=((0.2, 0.2, 0.0), (0.0, 0.2, 0.4), (0.0, 0.3, 0.0), (-0.1, 0.2, 0.0), (0.0, 0.2, 0.0)),
    stance_width_m=0.2,
    headings=16,
    cell_m=0.1,
)


def test_damaged_tables_of_a_robot_are_made_again(tmp_path, monkeypatch):
    monkeypatch.setattr("planner.heuristics.heuristic.cache_folder", lambda: tmp_path)
    made = tables_of.__wrapped__(MODEL)
    (path,) = tmp_path.iterdir()
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    again = tables_of.__wrapped__(MODEL)
    assert path.read_bytes() == whole
    np.testing.assert_array_equal(again.goal_table.cost_um, made.goal_table.cost_um)
    assert again.potential.rate == made.potential.rate
    # Of another robot they are other tables.
    tables_of.__wrapped__(replace(MODEL, step_cost_m=0.2))
    assert len(list(tmp_path.iterdir())) == 2


def test_where_nothing_can_be_kept_the_tables_are_the_same(tmp_path, monkeypatch):
    monkeypatch.setattr("planner.heuristics.heuristic.cache_folder", lambda: tmp_path)
    kept = tables_of.__wrapped__(MODEL)
    monkeypatch.setattr("planner.heuristics.heuristic.cache_folder", lambda: None)
    made = tables_of.__wrapped__(MODEL)
    np.testing.assert_array_equal(made.exits.turn_um, kept.exits.turn_um)
    assert made.goal_table.cap_um == kept.goal_table.cap_um
