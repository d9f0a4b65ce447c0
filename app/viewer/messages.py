"""Which messages of a page are carried out: viser takes whatever comes over the socket."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import viser
from viser._messages import (
    FileTransferPart,
    FileTransferStartUpload,
    GuiSliderProps,
    GuiUpdateMessage,
    ViewerCameraMessage,
)

from maps.images import MOST_BYTES

# Metres, pixels, seconds since 1970: no page has larger numbers, nor longer lists of waypoints.
MOST_NUMBER, MOST_LETTERS = 1e15, 100_000
# The kinds of numbers that a camera has; viser warns of others, and takes them.
_POINT = (0.0, 0.0, 0.0)
_CAMERA = {
    "position": _POINT,
    "look_at": _POINT,
    "up_direction": _POINT,
    "wxyz": (0.0, *_POINT),
    "fov": 0.0,
    "near": 0.0,
    "far": 0.0,
    "image_height": 0,
    "image_width": 0,
}
MOST_UPLOADED, MOST_UPLOADS = MOST_BYTES, 3


def may_be_carried_out(server: viser.ViserServer, client_id: int, message: Any) -> bool:
    """Whether a message of a page is to be carried out: a choice must still be one of those there.

    viser takes any number, any property of its controls, and files of any size.

    Raises:
        ValueError: No page of this server sends such a message.
    """
    check_numbers(vars(message))
    if isinstance(message, ViewerCameraMessage):
        odd = [name for name, was in _CAMERA.items() if not is_alike(getattr(message, name), was)]
        if odd:
            raise ValueError(f"a camera of another {', '.join(odd)}")
    if isinstance(message, FileTransferStartUpload | FileTransferPart):
        _check_upload(server, client_id, message)
    if not isinstance(message, GuiUpdateMessage):
        return True
    clients: Mapping[int, viser.ClientHandle] = {**server.get_clients()}
    apis = [server.gui, *([clients[client_id].gui] if client_id in clients else [])]
    inputs = (api._gui_input_handle_from_uuid.get(message.uuid) for api in apis)
    handle = next((found for found in inputs if found is not None), None)
    if message.updates.keys() != {"value"}:
        raise ValueError(f"a change of {', '.join(map(str, message.updates))}")
    if handle is None:
        return True
    value, props = message.updates["value"], handle._impl.props
    if not is_alike(value, handle._impl.value):
        raise ValueError(f"a value of {type(value).__name__} for {type(props).__name__}")
    if isinstance(props, GuiSliderProps):
        return bool(props.min <= value <= props.max)
    # Another visitor may have changed what there is to choose from.
    return value in getattr(props, "options", (value,))


def check_numbers(value: object) -> None:
    """Raises ValueError where a message has numbers that are not finite, or beyond any page's."""
    if isinstance(value, int | float) and not abs(value) <= MOST_NUMBER:
        raise ValueError(f"the number {value}")
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list | tuple):
        for part in value:
            check_numbers(part)


def is_alike(value: object, now: object) -> bool:
    """Whether a value is of the kind that a control has now."""
    if isinstance(now, tuple):
        if not isinstance(value, list | tuple) or len(value) != len(now):
            return False
        return all(is_alike(part, part_now) for part, part_now in zip(value, now, strict=True))
    if isinstance(now, int | float) and not isinstance(now, bool):
        return isinstance(value, int | float) and not isinstance(value, bool)
    if isinstance(now, str):
        return isinstance(value, str) and len(value) <= MOST_LETTERS
    return type(value) is type(now)


def _check_upload(
    server: viser.ViserServer, client_id: int, message: FileTransferStartUpload | FileTransferPart
) -> None:
    """Raises ValueError for more than a page may send: few files at a time, as large as maps."""
    under_way = server.gui._current_file_upload_states
    if isinstance(message, FileTransferStartUpload):
        mine = sum(state["client_id"] == client_id for state in under_way.values())
        if mine >= MOST_UPLOADS or not 0 <= message.size_bytes <= MOST_UPLOADED:
            raise ValueError(f"a file of {message.size_bytes} bytes beside {mine} others")
    elif message.transfer_uuid in under_way:
        state = under_way[message.transfer_uuid]
        if state["transferred_bytes"] + len(message.content) > state["total_bytes"]:
            raise ValueError("more of a file than was told")
