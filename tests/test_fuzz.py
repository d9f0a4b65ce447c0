"""Damaged and absurd input gets one line, as `benchmarks.fuzz` judges it."""

from __future__ import annotations

import pytest

from app.output import ExitCode, one_line
from benchmarks.copies import Answer
from benchmarks.fuzz import fault
from maps.files import from_json
from tests.programs import run_python


@pytest.mark.slow
def test_a_hundred_tries_are_answered_well():
    done = run_python("-m", "benchmarks.fuzz", "--count", "105", "--seed", "0")
    assert done.stdout.endswith("0 of 105 answered badly\n")
    assert done.returncode == 0


def answer(code: int, err: str, **values: float) -> Answer:
    took = {"cpu_s": 0.1, "memory_mb": 10.0} | values
    return Answer(code=code, out="", err=err, **took)


@pytest.mark.parametrize(
    "wrong",
    [
        answer(1, "Traceback (most recent call last):\nValueError: no\n"),
        answer(-9, ""),
        answer(ExitCode.BAD_INPUT, ""),
        answer(ExitCode.BAD_INPUT, "something is odd\n"),
        answer(ExitCode.BAD_INPUT, "error: one\nerror: two\n"),
        answer(ExitCode.BAD_INPUT, "error: one\n[ WARN:0] of a library\n"),
        answer(ExitCode.BAD_INPUT, "error: " + "x" * 9000 + "\n"),
        answer(ExitCode.BAD_INPUT, "error: one\n", cpu_s=5.0),
        answer(ExitCode.NO_PLAN, "", memory_mb=3000.0),
    ],
)
def test_a_bad_answer_is_told(wrong):
    assert fault(wrong)


def test_a_good_answer_is_not():
    assert not fault(answer(ExitCode.BAD_INPUT, "warning: note\nerror: X must be a number\n"))
    assert not fault(answer(ExitCode.DONE, "compiling the planner\n"))


@pytest.mark.parametrize("text", ["{", b"\xff", "[" * 100_000, b"", "1" * 5000])
def test_what_is_no_json_is_a_value_error(text):
    with pytest.raises(ValueError, match=r"Expecting|nested|decode|digits"):
        from_json(text)


def test_messages_leave_out_the_middle_of_what_is_too_long():
    told = one_line("file\n" + "x" * 5000 + " is\tmissing")
    assert told.startswith("file xxx")
    assert told.endswith("xxx is missing")
    assert len(told) < 450
    assert len(one_line("a b " * 3000)) <= 1000
    assert one_line("as it is") == "as it is"
