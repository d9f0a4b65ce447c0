"""Work over processes. Little is imported here: each new process imports this file."""

from __future__ import annotations

import os

import pytest

from app.output import InputError
from app.workers import in_order, portions


def test_portions_hold_every_number_once():
    for count in (1, 7, 100, 1001):
        runs = portions(count, 2, 25)
        assert [n for run in runs for n in run] == list(range(count))
        assert max(map(len, runs)) <= 25


def _square_or_die(number: int) -> int:
    if number == 5:
        os._exit(1)
    return number * number


def test_results_come_in_order_and_a_dead_process_is_told():
    assert list(in_order(_square_or_die, [3, 1, 2], 2)) == [9, 1, 4]
    with pytest.raises(InputError, match="a process died"):
        list(in_order(_square_or_die, [1, 5], 2))
