"""Another map for the page: one of those that come along, or one that is sent through the page."""

from __future__ import annotations

import math
import os
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path

import viser
from viser import UploadedFile

from app.output import one_line
from maps.grid import OccupancyGrid
from maps.map_files import COMES_ALONG, YAML_SUFFIXES, MapError, load_map, read_metadata

IMAGE_SUFFIXES = (".png", ".pgm", ".bmp", ".jpg", ".jpeg")


def maps_that_come_along() -> dict[str, Path]:
    """The maps of this project by name."""
    return {file.stem: file for file in sorted(COMES_ALONG.glob("*.yaml"))}


class MapInbox:
    """Files of a map as they come, one by one: a YAML and the pictures that it names, or an image.

    Nothing but what was sent is read, whatever a YAML names: each file keeps its bare name, in a
    folder that goes with this object.
    """

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="footfall-map-")
        self._yaml: Path | None = None

    def close(self) -> None:
        """Removes the files."""
        self._folder.cleanup()

    def named(self, text: str) -> str:
        """What is said of files, by the names under which they were sent."""
        return text.replace(f"{self._folder.name}{os.sep}", "")

    def take(
        self, file: UploadedFile, *, resolution_m: float, origin: tuple[float, float, float]
    ) -> OccupancyGrid | str:
        """The map that is complete with this file, or what is still to be sent, in words.

        resolution_m and origin hold for an image without a YAML.

        Raises:
            MapError: The file is no map, or the map cannot be read.
        """
        name = Path(file.name.replace("\\", "/")).name
        suffix = Path(name).suffix.lower()
        if suffix not in YAML_SUFFIXES + IMAGE_SUFFIXES:
            raise MapError(f"map {name}: send an image (PNG, PGM, BMP, JPEG), or a YAML first")
        path = Path(self._folder.name, name)
        try:
            path.write_bytes(file.content)
        except (OSError, ValueError) as error:
            raise MapError(f"map {name}: cannot be kept ({error})") from None
        if suffix in YAML_SUFFIXES:
            self._yaml = path
        if self._yaml is None:
            return load_map(path, resolution_m=resolution_m, origin=origin)
        return self._with_yaml(self._yaml)

    def _with_yaml(self, path: Path) -> OccupancyGrid | str:
        self._yaml = None
        try:
            metadata = read_metadata(path)
            pictures = [file for file in (metadata.image, metadata.elevation) if file is not None]
            for file in pictures:
                if file.parent != path.parent:
                    raise MapError(f"map {path.name}: {file}: name the image without its folder")
        except MapError:
            path.unlink()  # an image of its name, sent later, would be read with it
            raise
        missing = [picture.name for picture in pictures if not picture.is_file()]
        if missing:
            self._yaml = path
            return f"{path.name} is here: now send {' and '.join(missing)}"
        return load_map(path)


class MapChooser:
    """The controls for it. What is wrong with a map is said, and the one that is there stays."""

    def __init__(
        self,
        gui: viser.GuiApi,
        *,
        maps: dict[str, Path],
        chosen: str,
        on_map: Callable[[str, OccupancyGrid], None],
        say: Callable[[str], None],
    ) -> None:
        self._maps, self._on_map, self._say = maps, on_map, say
        self._inbox = MapInbox()
        names = (chosen, *(name for name in maps if name != chosen))
        self._names = gui.add_dropdown("Map", names, initial_value=chosen)
        self._names.on_update(lambda _event: self.choose(self._names.value))
        self._resolution = gui.add_number("m per pixel", 0.05, min=0.001, step=0.005)
        self._origin = gui.add_vector3(
            "x, y, °",
            (0.0, 0.0, 0.0),
            step=0.1,
            hint="Lower-left corner of an image that comes without a YAML: metres and degrees.",
        )
        self._upload = gui.add_upload_button(
            "Send a map",
            hint="An image; or its YAML, then the image that it names. Both may be dropped here.",
        )
        self._upload.on_upload(lambda _event: self.take(self._upload.value))

    def close(self) -> None:
        """Removes what was sent."""
        self._inbox.close()

    def has(self, name: str) -> bool:
        """Whether there is a map of this name to choose."""
        return name in self._maps

    def choose(self, name: str) -> None:
        """Takes a map that comes along."""
        if self.has(name):
            self._take(name, lambda: load_map(self._maps[name]))

    def take(self, file: UploadedFile) -> None:
        """Takes a file that was sent."""
        x_m, y_m, yaw_deg = self._origin.value
        origin = (float(x_m), float(y_m), math.radians(yaw_deg))
        resolution_m = float(self._resolution.value)
        self._take(
            file.name, lambda: self._inbox.take(file, resolution_m=resolution_m, origin=origin)
        )

    def _take(self, name: str, read: Callable[[], OccupancyGrid | str]) -> None:
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always", UserWarning)
            try:
                grid = read()
            except MapError as error:
                self._say(one_line(self._inbox.named(str(error))))
                return
        for warning in told:
            self._say(one_line(self._inbox.named(str(warning.message))))
        if isinstance(grid, str):
            self._say(grid)
        else:
            self._on_map(name, grid)
