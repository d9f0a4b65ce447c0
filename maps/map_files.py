"""Map files: images with the YAML of the ROS map server and Nav2, read and copied.

p is the occupancy of a pixel: 1 - luminance / 255, or luminance / 255 with negate. Occupied where
p >= occupied_thresh, free where p <= free_thresh, else unknown. A pixel that is not opaque is
unknown in the modes trinary and scale, which differ only in values that this project does not use.
In mode raw the grey value 0..100 is the occupancy in per cent, anything above is unknown.

Beyond the format of the map server a YAML may name a second image of the same size, the elevation:
the floor of a cell is at elevation_offset + elevation_scale * grey value, 0..255 or 0..65535.
"""

from __future__ import annotations

import contextlib
import json
import math
import re
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maps.files import MOST_YAML_BYTES, from_yaml, read_limited
from maps.grid import HIGHEST_M, Cell, OccupancyGrid
from maps.images import ImageError, grey_and_opaque, read_grey_values, read_image

# Of a pixel and of a grey value: the feet of any robot are lost in more.
MOST_M = 100.0
REQUIRED_KEYS = ("image", "resolution", "origin", "negate")
OPTIONAL_KEYS = ("occupied_thresh", "free_thresh", "mode")
ELEVATION_KEYS = ("elevation", "elevation_scale", "elevation_offset")
MODES = ("trinary", "scale", "raw")
COMES_ALONG = Path(__file__).parent
YAML_SUFFIXES = (".yaml", ".yml")
UNKNOWN_GREY = 205
_ROWS = 256  # of a picture that are read at once
Pose = tuple[float, float, float]


class MapError(ValueError):
    """A map that cannot be read; the message is one line that says what would be right."""


class MapWarning(UserWarning):
    """A map that can be read but is probably not as intended."""


@dataclass(frozen=True, kw_only=True)
class MapMetadata:
    """Contents of the YAML beside an image. image is the path of the image.

    elevation: path of the picture of heights, None for a floor at z = 0; elevation_scale_m: metres
    per grey value; elevation_offset_m: the height of black.
    """

    image: Path
    resolution_m: float
    origin: Pose = (0.0, 0.0, 0.0)
    negate: bool = False
    occupied_thresh: float = 0.65
    free_thresh: float = 0.196
    mode: str = "trinary"
    elevation: Path | None = None
    elevation_scale_m: float = 1.0
    elevation_offset_m: float = 0.0


def load_map(
    path: str | Path, *, resolution_m: float | None = None, origin: Pose | None = None
) -> OccupancyGrid:
    """Occupancy grid of a map image with its YAML beside it, or of the YAML itself.

    resolution_m and origin win over the YAML; with resolution_m an image needs no YAML.
    Raises MapError for anything wrong; warns with MapWarning where unknown grey reads as free.
    """
    metadata = find_map(path, resolution_m=resolution_m, origin=origin)
    try:
        grid = grid_from_image(read_image(metadata.image), metadata)
        if metadata.elevation is None:
            return grid
        return replace(grid, elevation_m=_read_elevation(metadata, metadata.elevation, grid.shape))
    except ImageError as error:
        raise MapError(str(error)) from None


def find_map(
    path: str | Path, *, resolution_m: float | None = None, origin: Pose | None = None
) -> MapMetadata:
    """The metadata with which `load_map` reads the images. Raises MapError."""
    file = Path(path)
    if not file.exists() and file.parts[:1] == (COMES_ALONG.name,):
        # An installed program has the maps that come along beside this file.
        file = COMES_ALONG.parent / file
    if not file.exists():
        file = Path(path)
        raise MapError(f"map {file}: no such file; give an image (PNG, PGM, BMP, JPEG) or its YAML")
    if not file.is_file():
        raise MapError(f"map {file}: not a file; give an image (PNG, PGM, BMP, JPEG) or its YAML")
    metadata = _metadata_for(file, resolution_m)
    if resolution_m is not None:
        metadata = replace(metadata, resolution_m=_number("resolution", resolution_m, file))
    if origin is not None:
        metadata = replace(metadata, origin=_origin(origin, file))
    _require_length("resolution", metadata.resolution_m, "pixel", file)
    return metadata


def _metadata_for(file: Path, resolution_m: float | None) -> MapMetadata:
    """Metadata from the YAML `file` or the one beside the image `file`."""
    if file.suffix.lower() in YAML_SUFFIXES:
        return read_metadata(file)
    for suffix in YAML_SUFFIXES:
        beside = file.with_suffix(suffix)
        if beside.is_file():
            return replace(read_metadata(beside), image=file)
    if resolution_m is not None:
        return MapMetadata(image=file, resolution_m=resolution_m)
    raise MapError(
        f"map {file}: no {file.with_suffix('.yaml').name} beside it; give --resolution, "
        f"or write that file with these four lines:\n{yaml_lines(file.name)}"
    )


def yaml_lines(image_name: str) -> str:
    """The four lines that the YAML beside an image needs at least, as an example to edit."""
    return "\n".join(
        (
            f"image: {image_name}",
            "resolution: 0.05  # metres per pixel",
            "origin: [0.0, 0.0, 0.0]  # x, y, yaw of the lower-left corner",
            "negate: 0  # 1 where white means occupied",
        )
    )


def _at_home(name: str) -> Path:
    """The path of that name; `~` at its beginning is the home folder, where that is known."""
    with contextlib.suppress(RuntimeError):
        return Path(name).expanduser()
    return Path(name)


def read_metadata(file: Path) -> MapMetadata:
    """Contents of a map YAML. Raises MapError naming the key, its value and what would be right."""
    try:
        text = read_limited(file, MOST_YAML_BYTES).decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise MapError(
            f"map {file}: cannot be read as text ({' '.join(str(error).split())})"
        ) from None
    try:
        # The map server's own reader takes a tab after the colon for a space.
        document = from_yaml(re.sub(r"(?m)^(\w+:)[ \t]*\t[ \t]*", r"\1 ", text))
    except ValueError as error:
        raise MapError(f"map {file}: {error}") from None
    if not isinstance(document, dict):
        raise MapError(f"map {file}: must hold keys such as `image:` and `resolution:`")
    for key in REQUIRED_KEYS:
        if key not in document:
            raise MapError(f"map {file}: key `{key}` is missing")
    for key in document.keys() - {*REQUIRED_KEYS, *OPTIONAL_KEYS, *ELEVATION_KEYS}:
        _warn(f"map {file}: key `{key}` means nothing here")
    image = document["image"]
    if not isinstance(image, str) or not image:
        raise MapError(f"map {file}: image {image!r} must be the name of a picture")
    negate = document["negate"]
    if not isinstance(negate, bool) and negate not in (0, 1):
        raise MapError(f"map {file}: negate {negate!r} must be 0, 1, true or false")
    metadata = MapMetadata(
        image=file.parent / _at_home(image),
        resolution_m=_number("resolution", document["resolution"], file),
        origin=_origin(document["origin"], file),
        negate=bool(negate),
        occupied_thresh=_number("occupied_thresh", document.get("occupied_thresh", 0.65), file),
        free_thresh=_number("free_thresh", document.get("free_thresh", 0.196), file),
        mode=str(document.get("mode", "trinary")).lower(),
        **_elevation_metadata(document, file),
    )
    _require_length("resolution", metadata.resolution_m, "pixel", file)
    if metadata.mode not in MODES:
        raise MapError(f"map {file}: mode {metadata.mode!r} must be one of {', '.join(MODES)}")
    if not 0 <= metadata.free_thresh < metadata.occupied_thresh <= 1:
        raise MapError(
            f"map {file}: free_thresh {metadata.free_thresh:g} and occupied_thresh "
            f"{metadata.occupied_thresh:g} must satisfy 0 <= free_thresh < occupied_thresh <= 1"
        )
    return metadata


def _elevation_metadata(document: dict[Any, Any], file: Path) -> dict[str, Any]:
    """The fields of `MapMetadata` about heights; none where the YAML names no picture of them."""
    if "elevation" not in document:
        for key in document.keys() & set(ELEVATION_KEYS):
            _warn(f"map {file}: key `{key}` means nothing without `elevation`")
        return {}
    image = document["elevation"]
    if not isinstance(image, str) or not image:
        raise MapError(f"map {file}: elevation {image!r} must be the name of a picture of heights")
    if "elevation_scale" not in document:
        raise MapError(
            f"map {file}: key `elevation_scale` is missing: metres per grey value of {image}"
        )
    scale_m = _number("elevation_scale", document["elevation_scale"], file)
    _require_length("elevation_scale", scale_m, "grey value", file)
    offset_m = _number("elevation_offset", document.get("elevation_offset", 0.0), file)
    return {
        "elevation": file.parent / _at_home(image),
        "elevation_scale_m": scale_m,
        "elevation_offset_m": offset_m,
    }


def _read_elevation(
    metadata: MapMetadata, file: Path, shape: tuple[int, int]
) -> NDArray[np.float64]:
    """Heights (H, W) of the floor, row 0 at the smallest y. Raises MapError, ImageError."""
    grey = read_grey_values(file)
    if grey.shape != shape:
        (rows, cols), (map_rows, map_cols) = grey.shape, shape
        raise MapError(
            f"map image {file}: {cols} x {rows} pixels, but the map {metadata.image.name} "
            f"has {map_cols} x {map_rows}: the heights need one pixel for each of its cells"
        )
    heights_m = metadata.elevation_offset_m + metadata.elevation_scale_m * grey
    if np.abs(heights_m).max() > HIGHEST_M:
        raise MapError(
            f"map image {file}: a height of {np.abs(heights_m).max():g} m; elevation_scale "
            f"{metadata.elevation_scale_m:g} is in metres per grey value"
        )
    return np.ascontiguousarray(heights_m[::-1])


def _warn(text: str) -> None:
    warnings.warn(text, MapWarning, stacklevel=4)


def _require_length(name: str, value_m: float, per: str, file: Path) -> None:
    if value_m <= 0:
        raise MapError(f"map {file}: {name} {value_m:g} must be above 0 (metres per {per})")
    if value_m > MOST_M:
        raise MapError(
            f"map {file}: {name} {value_m:g} must be at most {MOST_M:g} (metres per {per})"
        )


def _number(name: str, value: Any, file: Path) -> float:
    # YAML 1.1 reads 5e-2 as text; the map server's own reader takes it for a number.
    try:
        number = float(value) if not isinstance(value, bool) else math.nan
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise MapError(f"map {file}: {name} {value!r} must be a finite number")
    return number


def _origin(value: Any, file: Path) -> Pose:
    if not isinstance(value, list | tuple) or len(value) != 3:
        raise MapError(f"map {file}: origin {value!r} must be three numbers [x, y, yaw]")
    x_m, y_m, yaw_rad = (_number("origin", entry, file) for entry in value)
    return x_m, y_m, yaw_rad


def grid_from_image(image: NDArray[Any], metadata: MapMetadata) -> OccupancyGrid:
    """Occupancy grid of a picture (H, W[, channels]) read with the metadata's rules."""
    grey, opaque = grey_and_opaque(image)
    full = int(np.iinfo(image.dtype).max)
    cell_of = _cell_of_grey(metadata, full)
    cells = np.empty(grey.shape, np.uint8)
    for row in range(0, len(grey), _ROWS):  # an index takes eight bytes a pixel
        cells[row : row + _ROWS] = cell_of[grey[row : row + _ROWS]]
    if metadata.mode != "raw" and opaque is not None:
        cells[~opaque] = Cell.UNKNOWN
    is_unknown = np.rint(np.arange(full + 1) * (255.0 / full)) == UNKNOWN_GREY
    count = 0
    if np.any(is_unknown & (cell_of == Cell.FREE)):
        count = int(np.count_nonzero(is_unknown[grey[cells == Cell.FREE]]))
    if count and metadata.mode != "raw" and not metadata.negate:
        _warn(
            f"map {metadata.image}: free_thresh {metadata.free_thresh:g} reads {count} pixels of "
            f"the usual unknown grey ({UNKNOWN_GREY}) as free; 0.196 keeps them unknown"
        )
    if opaque is not None and metadata.mode != "raw" and not opaque.any():
        _warn(
            f"map {metadata.image}: every pixel is a little transparent at least (alpha below "
            f"{full}), which reads as unknown; save it without transparency"
        )
    elif not np.any(cells == Cell.FREE):
        _warn(f"map {metadata.image}: no free cell at all; check negate and free_thresh")
    return OccupancyGrid(
        cells=cells[::-1], resolution_m=metadata.resolution_m, origin=metadata.origin
    )


def _cell_of_grey(metadata: MapMetadata, full: int) -> NDArray[np.uint8]:
    """What each luminance from 0 to `full` (full + 1,) stands for."""
    grey = np.arange(full + 1, dtype=np.float64)
    known = np.ones(full + 1, np.bool_)
    if metadata.mode == "raw":
        percent = np.rint(grey * (255.0 / full))
        occupancy = percent / 100.0
        known = percent <= 100
    else:
        occupancy = grey / full if metadata.negate else 1.0 - grey / full
    cell = np.full(full + 1, Cell.UNKNOWN, np.uint8)
    cell[known & (occupancy <= metadata.free_thresh)] = Cell.FREE
    cell[known & (occupancy >= metadata.occupied_thresh)] = Cell.OCCUPIED
    return cell


YAML, IMAGE, HEIGHTS = "map.yaml", "map", "map_height"


def copy_map(metadata: MapMetadata, folder: Path) -> None:
    """Copies a map into a folder: `map.yaml`, and its pictures byte for byte beside it.

    They are named `map` and `map_height`, with their suffixes; `load_map` reads the copy like the
    original. Raises OSError where they cannot be read or written.
    """
    image = Path(IMAGE).with_suffix(metadata.image.suffix)
    (folder / image).write_bytes(metadata.image.read_bytes())
    keys: dict[str, object] = {
        "image": str(image),
        "resolution": float(metadata.resolution_m),
        "origin": [float(v) for v in metadata.origin],
        "negate": int(metadata.negate),
        "occupied_thresh": float(metadata.occupied_thresh),
        "free_thresh": float(metadata.free_thresh),
        "mode": metadata.mode,
    }
    if metadata.elevation is not None:
        heights = Path(HEIGHTS).with_suffix(metadata.elevation.suffix)
        (folder / heights).write_bytes(metadata.elevation.read_bytes())
        keys["elevation"] = str(heights)
        keys["elevation_scale"] = float(metadata.elevation_scale_m)
        keys["elevation_offset"] = float(metadata.elevation_offset_m)
    # Every value of JSON is one of YAML; numbers keep all their digits.
    lines = [f"{key}: {json.dumps(value)}" for key, value in keys.items()]
    (folder / YAML).write_text("\n".join(lines) + "\n", encoding="utf-8")
