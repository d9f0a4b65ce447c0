"""A walk written down as it happens: an MCAP file, which Foxglove opens, or a ROS 2 bag."""

from __future__ import annotations

import contextlib
import importlib.util
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from app.output import InputError, replacing, require_writable, say
from controller.gait import CONTROL_PERIOD_S
from maps.files import folder_beside

if TYPE_CHECKING:
    from app.navigation.navigator import Navigator
    from app.navigation.replanner import Replanner
    from app.ros.messages import Told
    from app.ros.walk_stream import WalkStream
    from maps.grid import OccupancyGrid
    from sim.robot import Robot

_TICK_NS = round(CONTROL_PERIOD_S * 1e9)
# Who takes the messages, at the simulated time in nanoseconds.
Sink = Callable[["Told", int], None]


def require_recordable(record: Path | None, bag: Path | None) -> None:
    """Checks before the walk that what it tells can be written.

    Raises:
        InputError: A library is missing, or the place is not one that can be written to.
    """
    require_writable(record, option="--record", endings=(".mcap",))
    for option, path, library in (("--record", record, "mcap"), ("--bag", bag, "rosbags")):
        if path is not None:
            for name in {library, "rosbags"}:
                if importlib.util.find_spec(name) is None:
                    raise InputError(
                        f"{option} needs the package {name}: python -m pip install -e '.[record]'"
                    )
    if bag is None:
        return
    if bag.exists():
        raise InputError(f"--bag: {bag} exists already; name a folder that does not")
    require_writable(bag / "metadata.yaml" if bag.is_dir() else bag, option="--bag")


class Recorder:
    """Writes what a navigator tells, after each tick, to the sinks; see `recording`."""

    def __init__(self, navigator: Navigator, sinks: list[Sink]) -> None:
        # Here and not above: it loads rosbags, which not every installation has.
        from app.ros.walk_stream import WalkStream

        self._navigator, self._sinks = navigator, sinks
        self._stream = WalkStream(navigator)
        for told in self._stream.latched(navigator.grid, 0):
            self._write(told)

    def ticked(self) -> None:
        """Notes the state that the last tick led to."""
        for told in self._stream.ticked(self._navigator, self._time_ns):
            self._write(told)

    def ended(self, report: str) -> None:
        """Notes the report: the text of report.json."""
        from app.ros.messages import Told, text

        for told in self._stream.changes(self._navigator, self._time_ns):
            self._write(told)
        self._write(Told("report", "std_msgs/msg/String", text(report), is_latched=True))

    @property
    def _time_ns(self) -> int:
        return round(self._navigator.time_s * 1e9)

    def _write(self, told: Told) -> None:
        for sink in self._sinks:
            sink(told, self._time_ns)


@contextlib.contextmanager
def recording(
    navigator: Navigator, *, record: Path | None, bag: Path | None
) -> Iterator[Recorder | None]:
    """Gives what writes the walk to an MCAP file and a bag; None where neither is wanted.

    The files have their names once the walk is over; after an error there are none.
    """
    with contextlib.ExitStack() as stack:
        sinks = []
        if record is not None:
            sinks.append(stack.enter_context(_mcap(record)))
        if bag is not None:
            sinks.append(stack.enter_context(_bag(bag)))
        yield Recorder(navigator, sinks) if sinks else None


class SessionRecorder:
    """Writes what a robot does that is steered, and the one that takes its place, on any map.

    Time is simulated: it stands still while the robot rests.
    """

    def __init__(self, sink: Sink) -> None:
        self._sink: Sink | None = sink
        self._stream: WalkStream | None = None
        self._robot: Robot | None = None
        self._grid: OccupancyGrid | None = None
        self._ticks = 0

    def ticked(self, replanner: Replanner) -> None:
        """Notes the state that the last tick led to; where that cannot be written, says so once."""
        try:
            for told in self._told(replanner):
                if self._sink is not None:
                    self._sink(told, self._ticks * _TICK_NS)
        except OSError as error:
            self._sink = None
            say(f"warning: the recording ends here, it cannot be written: {error.strerror}")

    def _told(self, replanner: Replanner) -> Iterator[Told]:
        from app.ros.messages import told_map
        from app.ros.walk_stream import WalkStream

        navigator = replanner.navigator
        self._ticks += 1
        time_ns = self._ticks * _TICK_NS
        if self._stream is None or navigator.robot is not self._robot:
            self._stream, self._robot = WalkStream(navigator), navigator.robot
            yield from self._stream.latched(None, time_ns)
        if navigator.grid is not self._grid:
            self._grid = navigator.grid
            yield told_map(navigator.grid, time_ns)
        plan, _ = replanner.shown_plan
        yield from self._stream.ticked(navigator, time_ns, plan)


@contextlib.contextmanager
def session_recording(path: Path | None) -> Iterator[SessionRecorder | None]:
    """Gives what writes to an MCAP file what happens until Ctrl-C; None where none is wanted.

    The file has its name at the end; after an error there is none.
    """
    if path is None:
        yield None
        return
    stopped = None
    with _mcap(path) as sink:
        try:
            yield SessionRecorder(sink)
        except KeyboardInterrupt as error:
            stopped = error
    if stopped is not None:
        raise stopped


@contextlib.contextmanager
def _mcap(path: Path) -> Iterator[Sink]:
    from mcap.writer import Writer

    from app.ros.messages import definition, encoded

    with replacing(path) as temporary, temporary.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="footfall")
        channels: dict[str, int] = {}
        schemas: dict[str, int] = {}

        def write(told: Told, time_ns: int) -> None:
            if told.kind not in schemas:
                words = definition(told.kind).encode()
                schemas[told.kind] = writer.register_schema(told.kind, "ros2msg", words)
            if told.topic not in channels:
                channels[told.topic] = writer.register_channel(
                    f"/{told.topic}", "cdr", schemas[told.kind]
                )
            data = encoded(told.kind, told.message)
            writer.add_message(channels[told.topic], time_ns, data, time_ns)

        yield write
        writer.finish()


@contextlib.contextmanager
def _bag(folder: Path) -> Iterator[Sink]:
    from rosbags.rosbag2 import Writer

    from app.ros.messages import definition, encoded, type_hash

    folder.parent.mkdir(parents=True, exist_ok=True)
    # The files in a bag are called like its folder.
    with folder_beside(folder) as beside:
        with Writer(beside / folder.name, version=9) as writer:
            connections: dict[str, Any] = {}

            def write(told: Told, time_ns: int) -> None:
                if told.topic not in connections:
                    connections[told.topic] = writer.add_connection(
                        f"/{told.topic}",
                        told.kind,
                        msgdef=definition(told.kind),
                        rihs01=type_hash(told.kind),
                        offered_qos_profiles=[_qos(told.is_latched)],
                    )
                writer.write(connections[told.topic], time_ns, encoded(told.kind, told.message))

            yield write
        os.rename(beside / folder.name, folder)


def _qos(is_latched: bool) -> Any:
    """Reliable; what is latched is played back so that late comers get it too."""
    from rosbags.interfaces import (
        Qos,
        QosDurability,
        QosHistory,
        QosLiveliness,
        QosReliability,
        QosTime,
    )

    endless = QosTime(sec=0, nsec=0)
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=1 if is_latched else 10,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL if is_latched else QosDurability.VOLATILE,
        deadline=endless,
        lifespan=endless,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=endless,
        avoid_ros_namespace_conventions=False,
    )
