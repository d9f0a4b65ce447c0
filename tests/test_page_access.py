"""Who may steer the robot of a page: bare requests and sockets, as browsers and strangers send."""

from __future__ import annotations

import contextlib
import http.client
import io
import math
import random
import re
import time
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest
import viser
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from app.viewer.access import COOKIE, LOOPBACK
from app.viewer.server import PageServer, open_server
from benchmarks.hostile import CAMERA

PROTOCOL = Subprotocol(f"viser-v{viser.__version__}")
UPGRADE = {
    "Connection": "Upgrade",
    "Upgrade": "websocket",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
    "Sec-WebSocket-Protocol": PROTOCOL,
}


@pytest.fixture(scope="module")
def local() -> Iterator[PageServer]:
    server = open_server(title="local", names=["robot.lab", "gate.lab:8443"])
    yield server
    server.stop()


@pytest.fixture(scope="module")
def public() -> Iterator[PageServer]:
    server = open_server(title="public", host="0.0.0.0")
    yield server
    server.stop()


def answer(server: PageServer, path: str = "/", **headers: str) -> http.client.HTTPResponse:
    """What a server answers to a request with these headers."""
    connection = http.client.HTTPConnection("127.0.0.1", server.get_port(), timeout=60)
    connection.request("GET", path, headers=headers)
    response = connection.getresponse()
    if response.status != 101:
        response.read()
    connection.close()
    return response


def socket_answer(server: PageServer, **headers: str) -> int:
    """The status with which a socket is let in (101) or not, from a page of `Origin`."""
    return answer(server, **UPGRADE, **headers).status


def test_its_own_pages_may_open_a_socket(local):
    port = local.get_port()
    for name in LOOPBACK:
        place = f"[{name}]:{port}" if ":" in name else f"{name}:{port}"
        assert answer(local, Host=place).status == 200
        assert socket_answer(local, Host=place, Origin=f"http://{place}") == 101
    assert socket_answer(local, Host=f"localhost:{port}") == 101  # a program, and no browser


@pytest.mark.parametrize(
    "origin",
    [
        "http://evil.example",
        "https://localhost.evil.example",
        "http://localhost",
        "http://localhost:3000",
        "http://127.0.0.1:{port}",
        "null",
        "",
        "http://[",
        "file://",
    ],
)
def test_pages_from_elsewhere_may_not(local, origin):
    port = local.get_port()
    asked = f"localhost:{port}"
    assert socket_answer(local, Host=asked, Origin=origin.format(port=port)) == 403


@pytest.mark.parametrize("name", ["evil.example", "localhost.evil.example", "127.0.0.1.nip.io", ""])
def test_a_name_that_is_turned_to_this_machine_is_not_its_own(local, name):
    place = f"{name}:{local.get_port()}"
    assert answer(local, Host=place).status == 403
    assert socket_answer(local, Host=place, Origin=f"http://{place}") == 403


def test_a_proxy_that_is_named_may(local):
    port = local.get_port()
    assert socket_answer(local, Host="robot.lab", Origin="https://robot.lab") == 101
    assert socket_answer(local, Host=f"127.0.0.1:{port}", Origin="https://robot.lab") == 101
    assert socket_answer(local, Host="robot.lab", Origin="https://robot.lab:444") == 403
    assert socket_answer(local, Host="robot.lab:81", Origin="https://robot.lab:8443") == 403
    assert socket_answer(local, Host="gate.lab:8443", Origin="https://gate.lab:8443") == 101
    assert socket_answer(local, Host="127.0.0.1:1", Origin="https://gate.lab:8443") == 101
    assert socket_answer(local, Host="127.0.0.1:1", Origin="https://gate.lab") == 403
    assert socket_answer(local, Host="other.lab", Origin="https://other.lab") == 403


def test_a_page_that_others_can_reach_wants_the_key_of_its_link(public):
    port, place = public.get_port(), f"127.0.0.1:{public.get_port()}"
    link = re.fullmatch(rf"http://localhost:{port}(/\?key=([\w-]{{22}}))", public.url)
    assert link
    path, key = link.groups()
    assert answer(public, Host=place).status == 403
    assert answer(public, "/?key=", Host=place).status == 403
    assert answer(public, f"/?key={key[:-1]}x", Host=place).status == 403
    assert socket_answer(public, Host=place, Origin=f"http://{place}") == 403
    opened = answer(public, path, Host=place)
    assert opened.status == 200
    cookies = [c.split(";")[0] for c in opened.headers.get_all("Set-Cookie") or []]
    (cookie,) = (c for c in cookies if c.startswith(COOKIE))
    assert cookie == f"{COOKIE}={key}"
    assert socket_answer(public, Host=place, Origin=f"http://{place}", Cookie=cookie) == 101
    assert socket_answer(public, Host=place, Origin="http://evil.example", Cookie=cookie) == 403
    assert socket_answer(public, Host=f"evil.example:{port}", Cookie=cookie) == 403


def test_every_link_has_a_key_of_its_own(public):
    other = open_server(title="other", host="0.0.0.0")
    try:
        assert other.url.split("key=")[1] != public.url.split("key=")[1]
    finally:
        other.stop()


def said_when(server: PageServer, data: str | bytes) -> str:
    """What is said when a page sends this, by which its socket must end."""
    url = f"ws://127.0.0.1:{server.get_port()}"
    said = io.StringIO()  # capfd would lose what the server writes while it is being read
    with contextlib.redirect_stderr(said):
        with connect(url, subprotocols=[PROTOCOL], max_size=None) as page:
            page.send(data)
            with contextlib.suppress(ConnectionClosed):
                while True:
                    page.recv(timeout=60)  # what a page gets first; no end is a TimeoutError
        for _ in range(200):  # the server may tell of it when the socket is closed already
            if "\n" in said.getvalue():
                break
            time.sleep(0.05)
    told = said.getvalue()
    assert told.startswith("warning: "), data[:40]
    assert told.count("\n") == 1
    assert "Traceback" not in told
    return told


def test_nonsense_ends_its_own_socket_with_one_line(local):
    draw = random.Random(1)
    nonsense: list[str | bytes] = [
        "text",
        b"",
        b"\x00",
        b"\xff" * 100,
        draw.randbytes(1000),
        b"\x81\xa4type\xa4None",
        b"\x81\xa4type\xb0GuiUpdateMessage",
        b"\x91" * 5000,
        bytes(5 * 1024 * 1024),
    ]
    for data in nonsense:
        said_when(local, data)
    assert answer(local, Host=f"127.0.0.1:{local.get_port()}").status == 200


@pytest.mark.parametrize(
    ("field", "value"),
    [("position", (0.0, math.nan, 1.0)), ("fov", math.inf), ("look_at", (1e300, 0.0, 0.0))],
)
def test_numbers_that_are_not_finite_end_the_socket(local, field, value):
    told = said_when(local, msgspec.msgpack.encode({**CAMERA, field: value}))
    assert "the number" in told


@pytest.mark.filterwarnings("ignore:.*does not match annotation")
@pytest.mark.parametrize("field", [field for field in CAMERA if field != "type"])
@pytest.mark.parametrize("value", ["x", [], None])
def test_cameras_of_another_kind_end_the_socket(local, field, value):
    said_when(local, msgspec.msgpack.encode({**CAMERA, field: value}))


@pytest.fixture(scope="module")
def controls(local) -> dict[str, Any]:
    gui = local.gui
    return {
        "number": gui.add_number("number", 0.5),
        "slider": gui.add_slider("slider", 0.0, 1.0, 0.1, 0.5),
        "text": gui.add_text("text", "as it was"),
        "switch": gui.add_checkbox("switch", initial_value=True),
        "choice": gui.add_dropdown("choice", ["one", "two"]),
        "vector": gui.add_vector3("vector", (1.0, 2.0, 3.0)),
    }


def change(controls: dict[str, Any], name: str, **updates: Any) -> bytes:
    """The message with which a page changes a control."""
    uuid = controls[name]._impl.uuid
    return msgspec.msgpack.encode({"type": "GuiUpdateMessage", "uuid": uuid, "updates": updates})


@pytest.mark.parametrize(
    ("name", "updates"),
    [
        ("number", {"value": math.nan}),
        ("number", {"value": "1"}),
        ("number", {"value": True}),
        ("slider", {"value": None}),
        ("text", {"value": 3}),
        ("text", {"value": "x" * 200_000}),
        ("switch", {"value": "yes"}),
        ("choice", {"value": ["one"]}),
        ("vector", {"value": [1.0, 2.0]}),
        ("vector", {"value": [1.0, 2.0, "3"]}),
        ("vector", {"value": [1.0, 2.0, math.inf]}),
        ("number", {"update_cb": []}),
        ("number", {"value": 1.0, "removed": True}),
        ("number", {}),
    ],
)
def test_values_that_no_page_gives_a_control_end_the_socket(local, controls, name, updates):
    before = controls[name].value
    said_when(local, change(controls, name, **updates))
    assert controls[name].value == before
    assert controls[name]._impl.update_cb == []
    assert not controls[name]._impl.removed


def test_choices_that_are_gone_are_passed_over_and_others_are_taken(local, controls):
    url = f"ws://127.0.0.1:{local.get_port()}"
    with connect(url, subprotocols=[PROTOCOL], max_size=None) as page:
        page.send(change(controls, "choice", value="three"))
        page.send(change(controls, "slider", value=1.5))
        page.send(change(controls, "choice", value="two"))
        page.send(change(controls, "vector", value=[4, 5, 6]))
        page.send(change(controls, "number", value=2))
        for _ in range(1000):
            if controls["number"].value == 2.0:
                break
            time.sleep(0.05)
    values = {name: control.value for name, control in controls.items()}
    assert values == {
        "number": 2.0,
        "slider": 0.5,
        "text": "as it was",
        "switch": True,
        "choice": "two",
        "vector": (4.0, 5.0, 6.0),
    }


@pytest.mark.parametrize("size", [-1, 10**10])
def test_files_larger_than_maps_are_not_taken(local, size):
    button = local.gui.add_upload_button("send")
    start = {
        "type": "FileTransferStartUpload",
        "source_component_uuid": button._impl.uuid,
        "transfer_uuid": "one",
        "filename": "map.png",
        "mime_type": "image/png",
        "part_count": 1,
        "size_bytes": size,
    }
    assert f"a file of {size} bytes" in said_when(local, msgspec.msgpack.encode(start))
    assert not local.gui._current_file_upload_states
