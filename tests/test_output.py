"""Files written whole or not at all; work over processes, each of which imports this file."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from app.output import (
    InputError,
    ProgressBar,
    claim_folder,
    make_folder,
    release_folders,
    replacing,
    require_writable,
    write_text,
)
from app.workers import in_order, portions
from maps.files import folder_beside, written_whole
from tests.programs import ROOT, refusal, run_python


def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "plan.json"
    path.write_text("old")
    with contextlib.suppress(ZeroDivisionError), replacing(path) as temporary:
        temporary.write_text("half")
        raise ZeroDivisionError
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_the_temporary_file_keeps_the_ending(tmp_path):
    with replacing(tmp_path / "a.png") as temporary:
        assert temporary.suffix == ".png"
        assert temporary.parent == tmp_path


def test_a_new_file_has_the_rights_that_a_new_file_gets(tmp_path):
    plain = tmp_path / "plain"
    plain.touch()
    write_text(tmp_path / "ours", "text")
    assert (tmp_path / "ours").stat().st_mode == plain.stat().st_mode


def test_a_link_stays_a_link(tmp_path):
    target, link = tmp_path / "target", tmp_path / "link"
    target.write_text("old")
    link.symlink_to(target)
    write_text(link, "new")
    assert link.is_symlink()
    assert target.read_text() == "new"


@pytest.mark.parametrize(
    ("place", "told"),
    [
        ("folder", "is a folder"),
        ("missing/plan.json", "not a folder that exists"),
        ("file/plan.json", "not a folder that exists"),
    ],
)
def test_a_place_that_cannot_be_written_is_refused_beforehand(tmp_path, place, told):
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=told) as caught:
        require_writable(tmp_path / place, option="--out")
    assert str(caught.value).startswith("--out: ")
    assert place in str(caught.value)


def test_a_device_is_never_replaced():
    with pytest.raises(InputError, match="is not a file"):
        require_writable(Path(os.devnull), option="--out")


def test_a_good_place_passes_and_stays_untouched(tmp_path):
    require_writable(tmp_path / "new.json", option="--out")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_is_made_with_those_above_it(tmp_path):
    make_folder(tmp_path / "a" / "b", option="--out")
    assert (tmp_path / "a" / "b").is_dir()


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").touch()
    for path in (tmp_path / "file", tmp_path / "file" / "b"):
        with pytest.raises(InputError, match=r"--out: cannot make the folder .*: a file is in the"):
            make_folder(path, option="--out")


def test_portions_hold_every_number_once():
    for count in (1, 7, 100, 1001):
        runs = portions(count, 2, 25)
        assert [n for run in runs for n in run] == list(range(count))
        assert max(map(len, runs)) <= 25


def _square_or_die(number: int) -> int:
    if number == 5:
        os.kill(os.getpid(), signal.SIGKILL)
    return number * number


def test_results_come_in_order_and_a_dead_process_is_told():
    assert list(in_order(_square_or_die, [3, 1, 2], 2)) == [9, 1, 4]
    with pytest.raises(InputError, match="a process died"):
        list(in_order(_square_or_die, [1, 5], 2))


KILLED = """
import os, signal
from app.workers import in_order
for number in in_order(abs, [-1, -2], 2):
    print(number, flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_workers_of_a_killed_process_end():
    """The process they work for cannot tell them, and they hold its standard output open."""
    done = run_python("-c", KILLED, timeout=300)
    assert done.returncode == -signal.SIGKILL
    assert done.stdout == "1\n"


KILLED_AT_WORK = """
import ctypes, os, sys
from pathlib import Path
from app.workers import in_order

def work(folder):
    Path(folder, str(os.getpid())).write_text("")
    ctypes.PyDLL(None).sleep(3600)  # as compiled code: no other thread of the process runs

if __name__ == "__main__":
    list(in_order(work, [sys.argv[1]] * 2, 2))
"""


def _is_alive(pid: str) -> bool:
    with contextlib.suppress(FileNotFoundError):
        return Path("/proc", pid, "stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


def _until(is_so: Callable[[], bool]) -> None:
    for _ in range(6000):
        if is_so():
            return
        time.sleep(0.05)
    pytest.fail("waited 300 s in vain")


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere they end when their work lets them")
def test_workers_of_a_killed_process_end_in_the_middle_of_compiled_code(tmp_path):
    (tmp_path / "program.py").write_text(KILLED_AT_WORK)
    at_work = tmp_path / "at_work"
    at_work.mkdir()
    parent = subprocess.Popen(
        [sys.executable, tmp_path / "program.py", at_work],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    _until(lambda: len(os.listdir(at_work)) == 2)
    workers = os.listdir(at_work)
    assert all(map(_is_alive, workers))
    parent.kill()
    parent.wait()
    _until(lambda: not any(map(_is_alive, workers)))


CLAIMED = """
import sys
from pathlib import Path
from app.output import InputError, claim_folder
try:
    claim_folder(Path(sys.argv[1]), option="--out")
except InputError as error:
    sys.exit(str(error))
"""


def test_a_folder_belongs_to_one_process_until_it_lets_go(tmp_path):
    folder = tmp_path / "run"
    claim_folder(folder, option="--out")
    claim_folder(folder, option="--out")  # it has it already
    refused = run_python("-c", CLAIMED, folder)
    assert refused.stderr.strip() == (
        f"--out: process {os.getpid()} is writing to {folder}; wait for it, end it, or name "
        "another folder"
    )
    release_folders()
    assert list(folder.iterdir()) == []
    assert run_python("-c", CLAIMED, folder).returncode == 0


@pytest.fixture(scope="module")
def taken(tmp_path_factory):
    """A folder that another process has claimed, and the number of that process."""
    folder = tmp_path_factory.mktemp("taken")
    waits = CLAIMED + "print('claimed', flush=True)\ninput()\n"
    with subprocess.Popen(
        [sys.executable, "-c", waits, str(folder)],
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as owner:
        assert owner.stdout is not None
        assert owner.stdout.readline() == "claimed\n"
        yield folder, owner.pid
        owner.communicate("\n")


@pytest.mark.parametrize(
    "words",
    [
        ("train", "--samples", "1"),
        ("trials", "--map", "maps/room.png", "--count", "1"),
        ("evaluate", "--episodes", "1"),
        ("dataset", "--count", "1"),
    ],
)
def test_commands_that_write_for_long_refuse_the_folder_of_another(words, taken, capsys):
    folder, owner = taken
    told = refusal(capsys, *words, "--out", folder)
    assert f"process {owner} is writing to {folder}" in told


def test_what_a_killed_process_claimed_is_free(tmp_path):
    killed = CLAIMED + "import os, signal\nos.kill(os.getpid(), signal.SIGKILL)\n"
    assert run_python("-c", killed, tmp_path).returncode == -signal.SIGKILL
    claim_folder(tmp_path, option="--out")
    release_folders()
    assert list(tmp_path.iterdir()) == []


LEFT = """
import os, signal, sys
from pathlib import Path
from maps.files import folder_beside, written_whole
with written_whole(Path(sys.argv[1])) as file, folder_beside(Path(sys.argv[2])) as folder:
    file.write_text("half")
    (folder / "part").touch()
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_a_killed_process_left_goes_when_the_same_is_written_again(tmp_path):
    file, folder, other = tmp_path / "a.b.json", tmp_path / "bag", tmp_path / ".a.b-my-copy.json"
    file.write_text("old")
    other.touch()
    assert run_python("-c", LEFT, file, folder).returncode == -signal.SIGKILL
    assert len(list(tmp_path.iterdir())) == 4
    assert file.read_text() == "old"
    with folder_beside(folder) as beside, written_whole(file) as ours:
        with written_whole(tmp_path / "b.json"), written_whole(tmp_path / "a.json"):
            assert set(tmp_path.iterdir()) > {file, other, beside, ours}
        # Another process, or thread, that writes the same does not take it for one that was left.
        with ThreadPoolExecutor() as pool:
            pool.submit(write_text, file, "theirs").result()
        assert file.read_text() == "theirs"
        ours.write_text("new")
    assert file.read_text() == "new"
    assert set(tmp_path.iterdir()) == {file, other, tmp_path / "a.json", tmp_path / "b.json"}


PLAN = f"{sys.executable} main.py plan --map maps/room.png --goal 0.4,0.1,0"


@pytest.mark.parametrize(
    ("line", "code", "told"),
    [
        (f"{PLAN} >&-", 0, None),
        (f"{PLAN} --help >&-", 0, ""),
        (f"{PLAN} --json <&- >&- 2>&-", 0, ""),
        (f"{PLAN} 2>/dev/full", 0, ""),
        (f"{PLAN} --map missing.png 2>/dev/full", 2, ""),
        (f"{PLAN} >/dev/full", 2, "error: cannot write standard output: No space left on device"),
    ],
)
def test_streams_that_are_closed_or_full(line, code, told):
    done = subprocess.run(["bash", "-c", line], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == code
    if told is not None:
        assert done.stderr.strip().split("\n")[-1] == told


def test_where_there_is_no_terminal_no_line_is_said_twice_in_a_row(capsys):
    with ProgressBar("planner", None, line_every_s=0.0) as bar:
        for done, note in enumerate(("loading", "loading", "3 of 9", "3 of 9", "loading")):
            bar.update(done, note)
    told = capsys.readouterr().err.splitlines()
    assert told == [f"planner: {note}" for note in ("loading", "3 of 9", "loading")]
