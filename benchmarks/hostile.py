"""Hostile clients of a page: `python -m benchmarks.hostile --minutes N --seed S`.

First requests that must be refused: sockets from pages of foreign places, foreign names for this
machine, and no key or a wrong one where others can reach the page.

Then a robot walks to and fro while clients in another process open sockets and send what no page
sends: frames that are no message, unknown types, wrong fields, nan, frames of 100 MB, half a frame,
thousands of messages at once; others never read what they are sent. The laws:

- All foreign requests are refused.
- Every socket over which nonsense came is ended; nothing is said of it but one line for each.
- The robot's pace is that of the clock, within PACE, and it walks on.
- Memory at the end is what it was after a tenth of the time, within MEMORY_MB.

Prints what was seen, and exits with 1 if a law was broken. Memory is read from /proc (Linux).
"""

from __future__ import annotations

import contextlib
import http.client
import json
import math
import os
import random
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import tyro
import viser
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.sync.connection import Connection

from app.controllers import load_walker
from app.viewer.access import COOKIE
from app.viewer.page import Page, open_page
from app.viewer.server import PageServer, open_server
from benchmarks.page_watcher import painted_in_background, wait
from benchmarks.soak import memory_mb
from maps.map_files import load_map

MAP = Path(__file__).resolve().parent.parent / "maps" / "room.yaml"
GOALS = ((2.0, 1.0, 1.57), (0.0, 0.0, 3.1))
PACE, MEMORY_MB = 0.05, 10.0
SAMPLE_S, REST_S = 0.5, 5.0
# A server ends those that never read after a while: so often one opens a socket anew.
LAZY_S = 90.0
# A socket that has not ended so long after nonsense will not.
ENDS_S = 30.0
PROTOCOL = f"viser-v{viser.__version__}"
UPGRADE = {
    "Connection": "Upgrade",
    "Upgrade": "websocket",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
    "Sec-WebSocket-Protocol": PROTOCOL,
}


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Hostile clients of a page.

    minutes: how long. seed: of what is sent. requests: foreign ones of each kind. clients: those
    that send nonsense. lazy: those that never read. attack: the page to attack; what the benchmark
    starts itself.
    """

    minutes: float = 30.0
    seed: int = 0
    requests: int = 100
    clients: int = 20
    lazy: int = 5
    attack: str = ""


# Requests that must be refused.


def status(server: PageServer, path: str = "/", **headers: str) -> int:
    """With what a server answers a request that has these headers."""
    connection = http.client.HTTPConnection("127.0.0.1", server.get_port(), timeout=60)
    try:
        connection.request("GET", path, headers=headers)
        return connection.getresponse().status
    finally:
        connection.close()


def foreign_name(draw: random.Random) -> str:
    """A host that is not this page's."""
    letters = "".join(draw.choices("abcdefghijklmnopqrstuvwxyz0123456789", k=draw.randint(1, 20)))
    forms = ("{}.example", "localhost.{}", "127.0.0.1.{}.io", "{}", "127.0.0.1{}", "xn--{}-9qa.de")
    return draw.choice(forms).format(letters)


def refusals(draw: random.Random, requests: int) -> dict[str, int]:
    """How many foreign requests of each kind are refused, page and socket."""
    local = open_server(title="local")
    public = open_server(title="public", host="0.0.0.0")
    refused: Counter[str] = Counter()
    try:
        own, reached = (f"127.0.0.1:{server.get_port()}" for server in (local, public))
        key = public.access.key
        assert status(local, Host=own, Origin=f"http://{own}", **UPGRADE) == 101
        assert status(public, f"/?key={key}", Host=reached) == 200
        for _ in range(requests):
            name = foreign_name(draw)
            origin = draw.choice(
                (f"http://{name}", f"https://{name}:{local.get_port()}", "null", "http://localhost")
            )
            refused["foreign Origin"] += (
                status(local, Host=own, Origin=origin, **UPGRADE) == http.HTTPStatus.FORBIDDEN
            )
            host = f"{name}:{local.get_port()}"
            refused["foreign Host"] += {
                status(local, Host=host),
                status(local, Host=host, Origin=f"http://{host}", **UPGRADE),
            } == {http.HTTPStatus.FORBIDDEN}
            at = draw.randrange(len(key))
            wrong = draw.choice(("", key[:at], key[:at] + "~" + key[at + 1 :], key + "x"))
            cookie = {"Cookie": f"{COOKIE}={wrong}"} if draw.random() < 0.5 else {}
            refused["no key"] += {
                status(public, draw.choice(("/", f"/?key={wrong}")), Host=reached),
                status(public, Host=reached, Origin=f"http://{reached}", **UPGRADE, **cookie),
            } == {http.HTTPStatus.FORBIDDEN}
    finally:
        local.stop()
        public.stop()
    return dict(refused)


# Clients that send what no page sends.


def packed(**message: Any) -> bytes:
    """A message as pages send it."""
    return msgspec.msgpack.encode(message)


CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    "position": (0.0, -5.0, 5.0),
    "fov": 0.9,
    "near": 0.01,
    "far": 1000.0,
    "image_height": 600,
    "image_width": 900,
    "look_at": (0.0, 0.0, 0.0),
    "up_direction": (0.0, 0.0, 1.0),
}
CLICK = {
    "type": "SceneNodeClickMessage",
    "name": "/floor",
    "instance_index": None,
    "ray_origin": (0.0, 0.0, 5.0),
    "ray_direction": (0.0, 0.0, -1.0),
    "screen_pos": (0.5, 0.5),
    "modifier": None,
}


def frame(draw: random.Random) -> tuple[str, str | bytes]:
    """A kind of nonsense that must end its socket, and what is sent."""
    field = draw.choice([key for key in CAMERA if key != "type"])
    less = {key: value for key, value in CAMERA.items() if key != field}
    frames: dict[str, Callable[[], str | bytes]] = {
        "text": lambda: "x" * draw.randrange(1000),
        "bytes": lambda: draw.randbytes(draw.randrange(5000)),
        "nested": lambda: b"\x91" * draw.randrange(1, 5000),
        "unknown type": lambda: packed(type=f"Message{draw.randrange(1000)}"),
        "no type": lambda: packed(**{key: v for key, v in CAMERA.items() if key != "type"}),
        "no field": lambda: packed(**less),
        "odd field": lambda: packed(**less, **{field: draw.choice(["x", [], {}, None, "1" * 999])}),
        "cut": lambda: packed(**CAMERA)[: draw.randrange(1, 100)],
        "large": lambda: bytes(draw.choice((5_000_000, 5_000_000, 100_000_000))),
    }
    kind = draw.choice(list(frames))
    return kind, frames[kind]()


def rude(draw: random.Random, page: Connection) -> str:
    """Does what costs a server but is a page's right, and leaves; the kind of it."""
    kind = draw.choice(("nan", "flood", "half a frame", "nothing", "no such node"))
    if kind == "nan":
        number = draw.choice((math.nan, math.inf, -math.inf, 1e300))
        page.send(packed(**CAMERA | {"position": (number,) * 3, "fov": number}))
        page.send(packed(**CLICK | {"ray_origin": (number,) * 3}))
    elif kind == "flood":
        for _ in range(2000):
            page.send(packed(**CAMERA))
    elif kind == "half a frame":
        page.socket.sendall(b"\x82\xfe\xff\xff\x00\x00\x00\x00abc")
    elif kind == "no such node":
        page.send(packed(**CLICK | {"name": "/" + "x" * draw.randrange(100_000)}))
    if draw.random() < 0.5:
        page.socket.shutdown(2)
    return kind


def one_attack(url: str, draw: random.Random, seen: Counter[str]) -> None:
    """Opens a socket and sends nonsense over it; notes whether it was ended."""
    with connect(url, subprotocols=[PROTOCOL], max_size=None, compression=None) as page:  # type: ignore[list-item]
        if draw.random() < 0.3:
            seen[f"rude: {rude(draw, page)}"] += 1
            return
        kind, data = frame(draw)
        seen["nonsense"] += 1
        until_s = time.monotonic() + ENDS_S
        try:
            page.send(data)
            while time.monotonic() < until_s:
                page.recv(timeout=ENDS_S)  # what every page gets comes first
        except (ConnectionClosed, OSError):
            seen["ended"] += 1
            return
    seen[f"not ended: {kind}"] += 1


def attack(arguments: Arguments) -> None:
    """Attacks a page until standard input ends; tells what was seen as JSON."""
    url = arguments.attack.replace("http", "ws", 1)
    seen: Counter[str] = Counter()
    over = threading.Event()

    def lazy() -> None:
        while not over.is_set():
            with contextlib.suppress(ConnectionClosed, OSError, TimeoutError):
                # Without pings of its own, which nobody would read the answers to.
                page = connect(url, subprotocols=[PROTOCOL], ping_interval=None)  # type: ignore[list-item]
                seen["lazy"] += 1
                page.send(packed(**CAMERA))
                over.wait(LAZY_S)
                page.socket.shutdown(2)

    def client(number: int) -> None:
        draw = random.Random(f"{arguments.seed} {number}")
        while not over.wait(draw.uniform(0.0, 2.0)):
            try:
                one_attack(url, draw, seen)
            except (ConnectionClosed, OSError, TimeoutError) as error:
                seen[f"no socket: {type(error).__name__}"] += 1

    threads = [threading.Thread(target=client, args=(n,)) for n in range(arguments.clients)]
    threads += [threading.Thread(target=lazy) for _ in range(arguments.lazy)]
    for thread in threads:
        thread.start()
    sys.stdin.read()
    over.set()
    for thread in threads:
        thread.join()
    print(json.dumps(seen))


@contextlib.contextmanager
def standard_error(into: Path) -> Iterator[None]:
    """Lets what is written to standard error go to a file meanwhile."""
    sys.stderr.flush()
    kept = os.dup(2)
    file = os.open(into, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(file, 2)
    try:
        yield
    finally:
        sys.stderr.flush()
        os.dup2(kept, 2)
        os.close(kept)
        os.close(file)


class Walk:
    """A robot that walks to and fro, in real time; how much it walked, and in what time."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.goals = self.ended = 0
        self.walked_s = self.took_s = 0.0
        self.ends: Counter[str] = Counter()

    @property
    def pace(self) -> float:
        """Simulated over real time, while it walked."""
        return self.walked_s / self.took_s if self.took_s else 0.0

    def walk_for(self, seconds: float, look: Callable[[float], None] = lambda _: None) -> None:
        """Walks for so long; `look` is called now and then with the time that has passed."""
        session = self.page.session
        began_s = time.monotonic()
        before, at_s = session.snapshot, began_s
        while time.monotonic() < began_s + seconds:
            if session.snapshot.status not in ("walking", "planning", "stopping"):
                self._next_goal()
            time.sleep(SAMPLE_S)
            now, now_s = session.snapshot, time.monotonic()
            if before.walk == now.walk and before.status == now.status == "walking":
                self.walked_s += now.time_s - before.time_s
                self.took_s += now_s - at_s
            before, at_s = now, now_s
            look(now_s - began_s)

    def _next_goal(self) -> None:
        session = self.page.session
        if session.failure is not None:
            raise session.failure
        if session.snapshot.requested is not None:
            return
        if self.goals:
            self.ends[session.snapshot.status.partition(":")[0]] += 1
        session.go_to(GOALS[self.goals % 2])
        self.goals += 1
        until_s = time.monotonic() + 60.0
        while session.snapshot.status not in ("walking", "planning"):
            if time.monotonic() > until_s:
                raise TimeoutError(f"no plan for a goal: {session.snapshot.status}")
            time.sleep(0.01)


def attacked(arguments: Arguments, told: Path) -> list[str]:
    """Lets a robot walk while clients attack its page; prints what was seen, gives the wrongs."""
    robot, policy = load_walker("jvrc1")
    wrong: list[str] = []
    memories: list[tuple[float, float]] = []
    seconds = 60 * arguments.minutes
    with (
        standard_error(told),
        open_page(load_map(MAP), robot, policy, title="hostile") as page,
        painted_in_background(page),
    ):
        page.session.start()
        wait(lambda: page.session.failure is not None or not page.session.snapshot.loading)
        quiet, walk = Walk(page), Walk(page)
        quiet.walk_for(min(60.0, seconds / 4))
        words = ("-m", "benchmarks.hostile", "--attack", page.server.url)
        counts = ("--clients", arguments.clients, "--lazy", arguments.lazy)
        clients = subprocess.Popen(
            [sys.executable, *words, *map(str, counts), "--seed", str(arguments.seed)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        walk.walk_for(seconds, lambda passed: memories.append((passed, memory_mb())))
        out, _ = clients.communicate()
        time.sleep(REST_S)
        walk.walk_for(min(20.0, seconds / 4))
        last_mb = memory_mb()
    seen = json.loads(out)
    lines = told.read_text(errors="replace").splitlines()
    warnings = sum(line.startswith("warning: ") for line in lines)
    first_mb = max(mb for passed, mb in memories if passed <= max(seconds / 10, memories[0][0]))
    print(f"sockets: {seen}; {len(lines)} lines were said, {warnings} of them warnings")
    print(f"walks: {dict(walk.ends)}; pace {walk.pace:.3f} over {walk.took_s:.0f} s of walking, ")
    print(f"    without clients {quiet.pace:.3f} over {quiet.took_s:.0f} s")
    print(f"memory: {first_mb:.1f} MB at first, {last_mb:.1f} MB at the end, most ", end="")
    print(f"{max(mb for _, mb in memories):.1f} MB")
    if any("Traceback" in line for line in lines):
        wrong.append("a traceback:\n" + "\n".join(lines[-30:]))
    sockets = sum(n for kind, n in seen.items() if kind.startswith(("nonsense", "rude")))
    if len(lines) > sockets:
        wrong.append(f"{len(lines)} lines were said of {sockets} sockets: {lines[:3]}")
    wrong += [
        f"{count} sockets {kind}" for kind, count in seen.items() if kind.startswith("not ended")
    ]
    if abs(walk.pace - 1.0) > PACE:
        wrong.append(f"the pace was {walk.pace:.3f}")
    if set(walk.ends) - {"reached"}:
        wrong.append(f"walks ended as {dict(walk.ends)}")
    if last_mb > first_mb + MEMORY_MB:
        wrong.append(f"memory grew from {first_mb:.1f} to {last_mb:.1f} MB")
    return wrong


def main(arguments: Arguments) -> int:
    """Runs it all and prints how it went; how many laws were broken."""
    if arguments.attack:
        attack(arguments)
        return 0
    wrong = []
    refused = refusals(random.Random(arguments.seed), arguments.requests)
    for kind, count in refused.items():
        print(f"{kind}: {count} of {arguments.requests} refused", flush=True)
        if count != arguments.requests:
            wrong.append(f"{kind}: {arguments.requests - count} were let in")
    with tempfile.TemporaryDirectory() as scratch:
        wrong += attacked(arguments, Path(scratch, "told"))
    for law in wrong:
        print(law)
    print(f"{len(wrong)} laws were broken")
    return len(wrong)


if __name__ == "__main__":
    sys.exit(1 if main(tyro.cli(Arguments, description=__doc__)) else 0)
