"""YAML files that people write: every key is checked, and a mistake is told by file and key."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from maps.files import MOST_YAML_BYTES, from_yaml, read_limited

Made = TypeVar("Made")


class YamlFileError(ValueError):
    """A file is not what it should be: the message names file and key, and what would be right."""


@dataclass(frozen=True)
class Section:
    """Keys and values of a file or of a part of it.

    Attributes:
        path: The file.
        values: The values by key.
        within: What stands before a key in messages, such as `limits.`.
    """

    path: Path
    values: Mapping[str, Any]
    within: str = ""

    def __contains__(self, key: object) -> bool:
        return key in self.values

    def check_keys(self, needed: Collection[str], known: Collection[str] | None = None) -> None:
        """Raises YamlFileError unless all that are needed are there and, if told, all are known."""
        for key in needed:
            if key not in self.values:
                raise YamlFileError(f"{self.path}: key {self.within + key!r} is missing")
        for key in self.values if known is not None else ():
            if key not in (known or ()):
                raise YamlFileError(
                    f"{self.path}: key {self.within + key!r} is unknown; there are "
                    f"{', '.join(known or ())}"
                )

    def error(self, key: str, wanted: str) -> YamlFileError:
        """The error that a value is not what is wanted, such as `must be above 0`."""
        shown = f"{self.values[key]!r}"
        shown = shown if len(shown) < 60 else f"{shown[:56]} ..."
        return YamlFileError(f"{self.path}: {self.within}{key} {shown} {wanted}")

    def section(
        self, key: str, needed: Collection[str] = (), known: Collection[str] | None = None
    ) -> Section:
        """The keys and values below a key, checked as `check_keys` does."""
        values = self.values[key]
        if not isinstance(values, Mapping):
            wanted = ", ".join(needed or known or ("keys and values",))
            raise YamlFileError(f"{self.path}: {self.within}{key} must hold {wanted}")
        named = {str(name): value for name, value in values.items()}
        section = Section(self.path, named, f"{self.within}{key}.")
        section.check_keys(needed, known)
        return section

    def rows(self, key: str) -> tuple[Section, ...]:
        """The sections of a list of them."""
        rows = self.values[key]
        if not isinstance(rows, list) or not all(isinstance(row, Mapping) for row in rows):
            raise YamlFileError(
                f"{self.path}: {self.within}{key} must be a list of keys and values"
            )
        return tuple(
            Section(self.path, {str(k): v for k, v in row.items()}, f"{self.within}{key}[{n}].")
            for n, row in enumerate(rows)
        )

    def number(
        self,
        key: str,
        *,
        above: float = -math.inf,
        at_least: float = -math.inf,
        default: float | None = None,
    ) -> float:
        """A finite number within bounds; the default, if there is one, where the key is missing."""
        if key not in self.values and default is not None:
            return default
        value = finite(self.path, self.within + key, self.values[key])
        if value <= above:
            raise YamlFileError(
                f"{self.path}: {self.within}{key} {value:g} must be above {above:g}"
            )
        if value < at_least:
            raise self.error(key, f"must be at least {at_least:g}")
        return value

    def whole(self, key: str) -> int:
        """A whole number."""
        value = self.values[key]
        if finite(self.path, self.within + key, value) != int(value):
            raise self.error(key, "must be a whole number")
        return int(value)

    def text(self, key: str, default: str | None = None) -> str:
        """Some text; the default, if there is one, where the key is missing."""
        if key not in self.values and default is not None:
            return default
        value = self.values[key]
        if not isinstance(value, str) or not value.strip():
            raise self.error(key, "must be text")
        return value

    def texts(self, key: str, count: int, example: str) -> tuple[str, ...]:
        """So many different texts."""
        value = self.values[key]
        if (
            not isinstance(value, list)
            or len(value) != count
            or not all(isinstance(one, str) and one for one in value)
            or len(set(value)) != count
        ):
            raise self.error(key, f"must be {count} names, such as {example}")
        return tuple(value)

    def numbers(self, key: str, count: int, example: str) -> tuple[float, ...]:
        """So many finite numbers."""
        value = self.values[key]
        if not isinstance(value, list) or len(value) != count:
            words = {2: "two", 3: "three", 4: "four"}
            raise self.error(key, f"must be {words.get(count, count)} numbers, such as {example}")
        return tuple(finite(self.path, self.within + key, one) for one in value)

    def interval(self, key: str, example: str = "[-0.1, 0.3]") -> tuple[float, float]:
        """Two finite numbers."""
        low, high = self.numbers(key, 2, example)
        return low, high

    def points(self, key: str, width: int) -> tuple[Any, ...]:
        """Any number of rows of so many finite numbers."""
        rows = self.values[key]
        if not isinstance(rows, list) or not all(
            isinstance(row, list) and len(row) == width for row in rows
        ):
            raise YamlFileError(
                f"{self.path}: {self.within}{key} must be a list of lists of {width} numbers"
            )
        return tuple(
            tuple(finite(self.path, self.within + key, one) for one in row) for row in rows
        )

    def made(self, make: Callable[[], Made]) -> Made:
        """What `make` gives; its ValueError becomes one that names the file and the section."""
        try:
            return make()
        except YamlFileError:
            raise
        except ValueError as error:
            where = f"{self.within.rstrip('.')}: " if self.within else ""
            raise YamlFileError(f"{self.path}: {where}{error}") from None


def finite(path: Path, key: str, value: Any) -> float:
    """The value as a finite number; raises YamlFileError where it is none."""
    if not isinstance(value, bool) and isinstance(value, (int, float)):
        with contextlib.suppress(OverflowError):  # of whole numbers with hundreds of digits
            if math.isfinite(value):
                return float(value)
    shown = f"{value!r}"[:60]
    raise YamlFileError(f"{path}: {key} {shown} must be a finite number")


def read_yaml(path: Path) -> Section:
    """The keys and values of a YAML file.

    Raises:
        YamlFileError: It cannot be read, is not YAML, or holds something else.
    """
    try:
        document = from_yaml(read_limited(path, MOST_YAML_BYTES).decode("utf-8"))
    except OSError as error:
        raise YamlFileError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise YamlFileError(f"{path}: {' '.join(str(error).split())}") from None
    if not isinstance(document, Mapping):
        raise YamlFileError(f"{path}: must hold keys and values, holds {document!r:.40}")
    return Section(path, {str(key): value for key, value in document.items()})
