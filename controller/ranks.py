"""Training in several processes: which of them this one is, and what they tell each other.

`torchrun` starts the processes, the ranks, on one machine or several. Each simulates its share of
the robots; rank 0 alone reads and writes the folder of the run.
"""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import timedelta
from typing import Any, TypeVar

import numpy as np
import torch
from torch import distributed
from torch.distributed.rendezvous import rendezvous

from controller.checkpoint import TrainingError

Value = TypeVar("Value")
GO_ON = "the folder holds the last whole checkpoint, go on from there with --resume"
# Rank 0 may be making a corpus, or writing to a slow disk. A rank that has died is noticed at once,
# by its closed connection; this is for a machine that went without closing anything.
SILENCE = timedelta(minutes=30)


@dataclass(frozen=True, kw_only=True)
class Ranks:
    """The ranks of a run as one of them sees them; by default it is alone.

    `rank` is from 0 to `count` - 1, over all machines; `local_rank` and `local_count` are the same
    on this machine. All ranks must call `gathered` and `from_first` in the same order.
    """

    rank: int = 0
    count: int = 1
    local_rank: int = 0
    local_count: int = 1
    store: Any = None

    @property
    def is_first(self) -> bool:
        """Whether this is the rank that reads and writes."""
        return self.rank == 0

    @property
    def multi_gpu(self) -> dict[str, int] | None:
        """What rsl-rl's PPO is told of the ranks; nothing if there is one."""
        if self.count == 1:
            return None
        return {
            "global_rank": self.rank,
            "local_rank": self.local_rank,
            "world_size": self.count,
        }

    def share(self, total: int) -> int:
        """This rank's part of a number; the parts of all ranks differ by at most one."""
        return total // self.count + (self.rank < total % self.count)

    def require_equal_shares(self, simulations: int) -> None:
        """Raises TrainingError unless the simulations divide among the ranks.

        Gradients are averaged: a rank with fewer robots would count as much as the others.
        """
        if simulations % self.count:
            numbers = [str(n) for n in range(1, 65) if simulations % n == 0]
            raise TrainingError(
                f"{simulations} simulations do not divide among {self.count} ranks: start "
                f"{', '.join(numbers)} of them, or give --simulations a multiple of {self.count}"
            )

    def seed_sequence(self, *entropy: int) -> np.random.SeedSequence:
        """Of this rank; alone it is that of the entropy itself."""
        return np.random.SeedSequence(
            entropy, spawn_key=() if self.count == 1 else (self.count, self.rank)
        )

    def gathered(self, value: Value) -> list[Value]:
        """The value of each rank, in their order, at every rank."""
        values: list[Any] = [value]
        if self.count > 1:
            values *= self.count
            distributed.all_gather_object(values, value)
        return values

    def from_first(self, make: Callable[[], Value]) -> Value:
        """What `make` gives at rank 0, at every rank; the others only wait for it."""
        values = [make() if self.is_first else None]
        if self.count > 1:
            distributed.broadcast_object_list(values, src=0)
        return values[0]  # type: ignore[return-value]  # it has come from rank 0

    def learner_threads(self, most: int) -> int:
        """Threads for the networks: alone all that are asked for, else the cores of a rank."""
        return most if self.count == 1 else min(most, self.physics_threads)

    @property
    def physics_threads(self) -> int:
        """Cores of this machine for each of its ranks, at least one."""
        return max(1, (os.cpu_count() or 1) // self.local_count)

    def is_first_to_fail(self) -> bool:
        """Whether no other rank has asked this before: one fault is told once."""
        if self.store is None:
            return True
        try:
            return self.store.add("failed", 1) == 1
        except (RuntimeError, OSError):  # the machine that has the store is gone
            return self.local_rank == 0


@contextlib.contextmanager
def joined_ranks(device: str = "cpu") -> Iterator[Ranks]:
    """The ranks that `torchrun` started, of which this process is one; otherwise one alone.

    They average gradients by gloo on CPUs and by nccl on GPUs. If the block raises, the first rank
    to fail raises the same; the others, which fail because of it, exit without a word.

    Raises:
        TrainingError: another rank has ended before its time, or `torchrun` was told to end.
    """
    if int(os.environ.get("WORLD_SIZE", "1")) == 1:
        yield Ranks()
        return
    store, rank, count = next(rendezvous("env://", timeout=SILENCE))
    ranks = Ranks(
        rank=rank,
        count=count,
        local_rank=int(os.environ.get("LOCAL_RANK", "0")),
        local_count=int(os.environ.get("LOCAL_WORLD_SIZE", "1")),
        store=store,
    )
    before = signal.signal(signal.SIGTERM, _end)
    try:
        on_gpus = device != "cpu" and torch.cuda.is_available()
        backend = "cpu:gloo,cuda:nccl" if on_gpus else "gloo"
        distributed.init_process_group(
            backend, store=store, rank=rank, world_size=count, timeout=SILENCE
        )
        yield ranks
    except BaseException as error:
        if not ranks.is_first_to_fail():
            raise SystemExit(1) from None
        if _is_lost_connection(error):
            raise TrainingError(
                "a rank of this run has ended, killed perhaps or for want of memory, and all end "
                f"with it; {GO_ON}"
            ) from error
        raise
    finally:
        signal.signal(signal.SIGTERM, before)
        if distributed.is_initialized():
            distributed.destroy_process_group()


def _end(number: int, frame: object) -> None:
    """What SIGTERM does: `torchrun` sends it for two reasons, which a rank cannot tell apart."""
    raise TrainingError(f"ended by torchrun, or with another rank that has ended; {GO_ON}")


def _is_lost_connection(error: BaseException) -> bool:
    """Whether a collective failed; gloo raises a RuntimeError that names its own source file."""
    return isinstance(error, distributed.DistError) or (
        isinstance(error, RuntimeError) and "gloo" in str(error)
    )


def find_device(name: str, ranks: Ranks) -> torch.device:
    """The device of the networks: `cpu`, `cuda`, or with `auto` a GPU where there is one.

    On a machine with several GPUs each rank takes another one in turn.

    Raises:
        TrainingError: cuda is asked for and torch finds no GPU.
    """
    found = torch.cuda.is_available() if name != "cpu" else False
    if name == "cuda" and not found:
        raise TrainingError(
            f"--device cuda: torch {torch.__version__} finds no GPU here; take --device cpu, or "
            "install a torch for CUDA and a driver (docs/scale.md)"
        )
    if not found:
        return torch.device("cpu")
    device = torch.device("cuda", ranks.local_rank % torch.cuda.device_count())
    torch.cuda.set_device(device)
    return device
