"""Small files that claim much are refused in one line, before memory is taken for the claim."""

from __future__ import annotations

import io
import json
import os
import shutil
import struct
import tracemalloc
import zipfile
import zlib
from contextlib import contextmanager

import cv2
import numpy as np
import pytest

from controller.policy import POLICY_FOLDER
from maps.files import MOST_UNPACKED_BYTES, check_unpacked, from_json, from_yaml, read_limited
from planner.corpus.corpus import MANIFEST, PLANS, corpus_of
from tests.programs import ROOM, refusal

GOAL = ("--goal", "0.4,0.1,0")
KEYS = "resolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\n"
MOST_TAKEN_BYTES = 30_000_000


@contextmanager
def taking_little():
    """Holds what is allocated inside, by numpy and OpenCV too, to a small part of the claims."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < MOST_TAKEN_BYTES
    finally:
        tracemalloc.stop()


def png(cols, rows):
    """A PNG whose header has this size, with hardly any pixels."""

    def chunk(kind, data):
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", cols, rows, 8, 0, 0, 0, 0))
    body = chunk(b"IDAT", zlib.compress(bytes(1000)))
    return b"\x89PNG\r\n\x1a\n" + header + body + chunk(b"IEND", b"")


def with_size(suffix, cols, rows):
    """A small picture of OpenCV whose header has another size."""
    data = bytearray(cv2.imencode(suffix, np.zeros((8, 8), np.uint8))[1].tobytes())
    if suffix == ".jpg":
        at = data.index(b"\xff\xc0") + 5
        data[at : at + 4] = struct.pack(">HH", rows, cols)
    elif suffix == ".bmp":
        data[18:26] = struct.pack("<ii", cols, rows)
    else:  # TIFF: the entries of width, height and rows of a strip
        (at,) = struct.unpack("<I", data[4:8])
        for entry in range(at + 2, at + 2 + 12 * int.from_bytes(data[at : at + 2], "little"), 12):
            tag = int.from_bytes(data[entry : entry + 2], "little")
            if tag in (256, 257, 278):
                data[entry : entry + 12] = struct.pack("<HHII", tag, 4, 1, cols)
    return bytes(data)


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("m.png", png(60_000, 60_000)),
        ("m.png", png(2**31 - 1, 2**31 - 1)),
        ("m.png", png(20_000, 20_000)),
        ("m.pgm", b"P5\n60000 60000\n255\n" + bytes(100)),
        ("m.pgm", b"P2\n60000 60000\n255\n0 0 0"),
        ("m.pbm", b"P4\n60000 60000\n" + bytes(100)),
        ("m.jpg", with_size(".jpg", 60_000, 60_000)),
        ("m.jpg", with_size(".jpg", 12_000, 12_000)),
        ("m.tif", with_size(".tif", 60_000, 60_000)),
        ("m.bmp", with_size(".bmp", 20_000, 20_000)),
    ],
)
def test_a_picture_of_too_many_pixels_is_not_unpacked(tmp_path, capsys, name, data):
    path = tmp_path / name
    path.write_bytes(data)
    (tmp_path / "m.yaml").write_text(f"image: {name}\n{KEYS}")
    with taking_little():
        assert "too many pixels" in refusal(capsys, "plan", "--map", path, *GOAL)


ALIASES = "a0: &a0 x\n" + "".join(
    f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 12)
)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (f"{ALIASES}image: *a11\n{KEYS}", "an alias"),
        (f"image: &a [*a]\n{KEYS}", "an alias"),
        ("image: " + "[" * 50_000, "nested too deep"),
        ("image: " + "{a: " * 10_000 + "}" * 10_000, "nested too deep"),
        ("".join(" " * n + "a:\n" for n in range(300)), "nested too deep"),
        ("- " * 2000 + "a", "nested too deep"),
        (f"image: 0x{'f' * 5000}\n{KEYS}", "whole number"),
        (f"image: 1{':1' * 5000}\n{KEYS}", "whole number"),
        (f"image: {'9' * 5000}\n{KEYS}", "digits"),
        ("image: 2020-13-45\n", "month"),
        ("image: [" + "1," * 60_000 + "]", "larger than 0.1 MB"),
    ],
)
@pytest.mark.parametrize("option", ["--map", "--step-model"])
def test_yaml_that_grows_is_refused(tmp_path, capsys, option, text, problem):
    path = tmp_path / "m.yaml"
    path.write_text(text)
    words = (
        "plan",
        *GOAL,
        *((option, path) if option == "--map" else ("--map", ROOM, option, path)),
    )
    with taking_little():
        assert problem in refusal(capsys, *words)


def test_yaml_reads_as_deep_as_anybody_writes_it():
    assert from_yaml("a: [[1, {b: 2}], [3]]\nc:\n  d:\n  - e: 5\n") == {
        "a": [[1, {"b": 2}], [3]],
        "c": {"d": [{"e": 5}]},
    }


@pytest.fixture
def policy(tmp_path):
    """Files of a policy that may be spoiled: weights and metadata."""
    for file in POLICY_FOLDER.glob("jvrc1.*"):
        shutil.copy(file, tmp_path)
    return tmp_path / "jvrc1.safetensors", tmp_path / "jvrc1.json"


@pytest.mark.parametrize(
    ("which", "data"),
    [
        (0, (10**9).to_bytes(8, "little") + b"{"),
        (0, (2**63).to_bytes(8, "little") + b"{" * 100),
        (1, b"[" * 100_000),
        (1, b'{"format": ' + b"9" * 5000 + b"}"),
        (1, b'{"a":' * 100_000 + b"1" + b"}" * 100_000),
    ],
)
def test_headers_and_documents_of_policies_that_claim_much_are_refused(
    tmp_path, capsys, policy, which, data
):
    policy[which].write_bytes(data)
    with taking_little():
        refusal(capsys, "export", "--policy", policy[0], "--out", tmp_path / "policy.onnx")


def test_files_far_larger_than_any_of_their_kind_are_not_read(tmp_path, capsys, policy):
    def grown(path):
        with path.open("ab"):
            os.truncate(path, 100 * 10**9)  # takes no place on the disk
        return path

    grown(tmp_path / "m.png")
    grown(tmp_path / PLANS)
    (tmp_path / MANIFEST).write_text('{"format": "footstep-corpus/1"}')
    out = ("--out", tmp_path / "policy.onnx")
    with taking_little():
        picture = refusal(capsys, "plan", "--map", tmp_path / "m.png", "--resolution", 0.1, *GOAL)
        plans = refusal(capsys, "dataset", "check", tmp_path)
        grown(tmp_path / MANIFEST)
        manifest = refusal(capsys, "dataset", "check", tmp_path)
        grown(policy[1])
        facts = refusal(capsys, "export", "--policy", policy[0], *out)
        grown(policy[0])
        weights = refusal(capsys, "export", "--policy", policy[0], *out)
    for line in (picture, plans, manifest, facts, weights):
        assert "larger than" in line
    with pytest.raises(OSError, match=r"larger than 0\.001 MB"):
        read_limited(grown(tmp_path / "any"), 1000)


def npz(name, member, compression=zipfile.ZIP_STORED):
    """An empty corpus as bytes of an npz file, with another member in the place of one."""
    data = io.BytesIO(corpus_of([], "jvrc1")._to_npz())
    spoiled = io.BytesIO()
    with zipfile.ZipFile(data) as old, zipfile.ZipFile(spoiled, "w", compression) as new:
        for info in old.infolist():
            new.writestr(info.filename, member if info.filename == name else old.read(info))
    return spoiled.getvalue()


def header(shape, kind="<f8"):
    """The beginning of an array file, that names a shape and has no values."""
    file = io.BytesIO()
    about = {"descr": kind, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(file, about)
    return file.getvalue()


@pytest.mark.parametrize(
    "member",
    [
        header((10**13,)),
        header((10**6, 10**6)),
        header((10**15, 4)) + bytes(64),
        header((3,), "<U1000000000"),
        header((10**18, 0)),
        header((10**13,), "<U0"),
    ],
)
def test_arrays_whose_header_lies_are_refused(tmp_path, capsys, member):
    (tmp_path / MANIFEST).write_text(json.dumps({"format": "footstep-corpus/1", "robot": "jvrc1"}))
    (tmp_path / PLANS).write_bytes(npz("pose.npy", member))
    with taking_little():
        refusal(capsys, "dataset", "check", tmp_path)


def zeros_packed(size):
    """So many zeros as one member of a zip archive."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr("pose.npy", bytes(size))
    return file


def test_archives_that_unpack_to_far_more_are_not_unpacked(tmp_path, capsys):
    bomb = zeros_packed(MOST_UNPACKED_BYTES + 1)
    assert len(bomb.getvalue()) < MOST_UNPACKED_BYTES / 100
    (tmp_path / MANIFEST).write_text(json.dumps({"format": "footstep-corpus/1", "robot": "jvrc1"}))
    (tmp_path / PLANS).write_bytes(bomb.getvalue())
    with taking_little():
        assert "unpack to 100 MB" in refusal(capsys, "dataset", "check", tmp_path)
        with pytest.raises(ValueError, match="unpack"):
            check_unpacked(bomb)
    check_unpacked(zeros_packed(10**6))


def test_checkpoints_that_unpack_to_far_more_are_not_unpacked(tmp_path):
    from controller.checkpoint import CHECKPOINT, TrainingError, read_checkpoint
    from controller.ppo import TrainConfig
    from sim.robots import get_robot

    (tmp_path / CHECKPOINT).write_bytes(zeros_packed(MOST_UNPACKED_BYTES + 1).getvalue())
    with taking_little(), pytest.raises(TrainingError, match="damaged or no checkpoint"):
        read_checkpoint(tmp_path, TrainConfig(), get_robot("jvrc1"))


def test_a_floor_that_is_too_large_is_refused(tmp_path, capsys):
    for words in (("--goal-x", "0,1e9"), ("--goal-y", "-1e5,1e5"), ("--start", "1e12,0,0")):
        with taking_little():
            line = refusal(capsys, "dataset", "--count", 1, "--out", tmp_path / "corpus", *words)
        assert "too large" in line


@pytest.mark.parametrize("text", ["[" * 100_000, '{"a":' * 100_000, "[" + "9" * 5000 + "]"])
def test_json_that_python_does_not_read_is_a_value_error(text):
    with pytest.raises(ValueError, match=r"nested|digits"):
        from_json(text)
