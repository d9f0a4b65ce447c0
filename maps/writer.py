"""Writing of a map: its pictures as they are, and a YAML that names them."""

from __future__ import annotations

import json
from pathlib import Path

from maps.map_files import MapMetadata

YAML, IMAGE, HEIGHTS = "map.yaml", "map", "map_height"


def copy_map(metadata: MapMetadata, folder: Path) -> None:
    """Copies a map into a folder: `map.yaml`, and its pictures byte for byte beside it.

    They are called `map` and `map_height`, with the endings they had; `load_map` reads the copy as
    it reads the map. Raises OSError where they cannot be read or written.
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
