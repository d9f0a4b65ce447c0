"""Files about the walk that is seen, for whoever watches: plan, report, picture and replay."""

from __future__ import annotations

import dataclasses
import tempfile
import threading
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import viser

from app.navigation.navigator import Navigator
from app.output import InputError
from app.pictures.walk_pictures import outcome_of, path_picture, recording_of
from app.viewer.replay import Story, write_replay
from app.viewer.session import Session

PLAN, REPORT, PATH, REPLAY = "plan.json", "report.json", "path.png", "walk.html"
# What there must be before a file can be.
_WAITS_FOR = {PLAN: "a goal", PATH: "a goal", REPORT: "the end of the walk"}
_WAITS_FOR[REPLAY] = _WAITS_FOR[REPORT]
_TOLD_FOR_S = 5.0


class Downloads:
    """A button for each file; one that is not there yet is said to be so."""

    def __init__(self, gui: viser.GuiApi, session: Session) -> None:
        self._session = session
        # Replays are recorded by a server of their own, one at a time.
        self._recording = threading.Lock()
        for name in _WAITS_FOR:
            gui.add_button(name).on_click(partial(self._send, name))

    def content(self, name: str) -> bytes | None:
        """What is in the file of this name now; None where there is none yet.

        Raises:
            InputError: The file cannot be made.
        """
        walk = self._session.walk()
        if not walk.plans or (name in (REPORT, REPLAY) and walk.outcome is None):
            return None
        setup = self._session.setup
        plan = dataclasses.replace(walk.plans[-1], robot=walk.robot.name, map=setup.map_name)
        if name == PLAN:
            return (plan.to_json() + "\n").encode()
        if name == REPORT:
            return walk.report(map=setup.map_name).to_json().encode()
        if name == PATH:
            return cv2.imencode(".png", path_picture(walk, plan))[1].tobytes()
        return self._replay(walk, setup.map_name)

    def _replay(self, walk: Navigator, map_name: str) -> bytes:
        story = Story(
            recording=recording_of(walk),
            plans=tuple(walk.followed),
            placed=tuple(walk.placed),
            goal=walk.goal,
            title=f"Footfall: {walk.robot.title} on {map_name}",
            outcome=outcome_of(walk),
        )
        with self._recording, tempfile.TemporaryDirectory(prefix="footfall-") as folder:
            file = Path(folder, REPLAY)
            write_replay(file, walk.grid, walk.robot, story)
            return file.read_bytes()

    def _send(self, name: str, event: viser.GuiEvent[Any]) -> None:
        client = event.client
        if client is None:
            return
        try:
            content = self.content(name)
        except InputError as error:
            client.add_notification(name, str(error), auto_close_seconds=_TOLD_FOR_S)
            return
        if content is None:
            text = f"There is none before {_WAITS_FOR[name]}."
            client.add_notification(name, text, auto_close_seconds=_TOLD_FOR_S)
        else:
            client.send_file_download(name, content, save_immediately=True)
