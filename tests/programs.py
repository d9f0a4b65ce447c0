"""The program run by tests: its refusals, processes of its own, and pictures that it wrote."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from app.cli import main
from app.output import ExitCode
from sim.gl import NO_GL

ROOT = Path(__file__).resolve().parent.parent
ROOM = str(ROOT / "maps" / "room.png")


def refusal(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """The one line of an error with which a command line is refused."""
    capsys.readouterr()
    assert main([str(word) for word in words]) == ExitCode.BAD_INPUT
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    return str(err)


def run_python(*words: object, **options: Any) -> subprocess.CompletedProcess[str]:
    """Python with these words, from the top folder unless another one is given."""
    return subprocess.run(
        [sys.executable, *map(str, words)],
        **{"cwd": ROOT, "capture_output": True, "text": True, "check": False, **options},
    )


def drawn_by(*words: object, **options: Any) -> str:
    """What Python printed that drew with these words; skips the test without a GL library.

    Drawing takes a process of its own, as MuJoCo reads MUJOCO_GL only once.
    """
    done = run_python(*words, **options)
    if done.returncode and done.stderr.strip().removeprefix("error: ") == NO_GL:
        pytest.skip(NO_GL)
    assert done.returncode == 0, done.stderr
    return done.stdout


def interrupted(
    *words: object,
    when: Callable[[subprocess.Popen[str]], Any],
    by: signal.Signals = signal.SIGINT,
) -> tuple[int, list[str]]:
    """Exit code and lines of standard error of Python stopped by a signal when `when` returns."""
    with subprocess.Popen(
        [sys.executable, *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        # A shell that runs the tests in the background lets its children ignore Ctrl-C.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    ) as process:
        when(process)
        process.send_signal(by)
        _, err = process.communicate(timeout=300)
    return process.returncode, err.splitlines()


def write_map(folder: Path, picture: Any, suffix: str = ".png", **keys: Any) -> Path:
    """Writes a picture and its YAML as m.* into a folder; the picture's path. None omits a key."""
    path = folder / f"m{suffix}"
    assert cv2.imwrite(str(path), np.asarray(picture))
    document = {
        "image": path.name,
        "resolution": 0.05,
        "origin": [0.0, 0.0, 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
        **keys,
    }
    document = {key: value for key, value in document.items() if value is not None}
    path.with_suffix(".yaml").write_text(yaml.safe_dump(document))
    return path


def picture_at(path: Path) -> np.ndarray:
    """A picture (H, W, 3) that was written, blue green red."""
    picture = cv2.imread(str(path))
    assert picture is not None
    return picture
