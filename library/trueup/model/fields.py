"""Read a JSON document field by field; every refusal names the field."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import orjson

from trueup.canonical import Json
from trueup.errors import BadPlant

NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,62}")


def _finite(number: float) -> bool:
    try:
        return math.isfinite(number)
    except OverflowError:  # JSON knows integers that no float can hold
        return False


@dataclass(frozen=True, slots=True)
class Reader:
    """An object of the document and the path that leads to it."""

    value: Mapping[str, Json]
    path: str = ""

    @staticmethod
    def of(document: object, path: str = "") -> Reader:
        """A reader of a JSON object that stands at a path. Raises BadPlant where it is none."""
        if not isinstance(document, Mapping):
            raise BadPlant(f"{path or 'the document'} must be an object", field=path)
        return Reader(document, path)

    @staticmethod
    def of_text(text: str, path: str = "") -> Reader:
        """A reader of the JSON object that a text holds. Raises BadPlant where it holds none."""
        try:
            return Reader.of(orjson.loads(text), path)
        except orjson.JSONDecodeError as error:
            raise BadPlant(f"{path or 'the document'} is no JSON: {error}", field=path) from error

    def at(self, key: str) -> str:
        """The path to a key."""
        return f"{self.path}.{key}" if self.path else key

    def _get(self, key: str) -> Json:
        if key not in self.value:
            raise BadPlant(f"{self.at(key)} is missing", field=self.at(key))
        return self.value[key]

    def child(self, key: str, *, optional: bool = False) -> Reader:
        """The object at `key`; empty if it is optional and missing."""
        return Reader.of({} if optional and key not in self.value else self._get(key), self.at(key))

    def children(self, key: str) -> list[Reader]:
        """The objects of the non-empty list at `key`."""
        entries = self._get(key)
        if not isinstance(entries, list) or not entries:
            raise BadPlant(
                f"{self.at(key)} must be a list with one object at least", field=self.at(key)
            )
        return [Reader.of(item, f"{self.at(key)}[{i}]") for i, item in enumerate(entries)]

    def no_more(self, *known: str) -> None:
        """Refuse any key that is not known: a misspelt field would be silently ignored."""
        for key in self.value:
            if key not in known:
                raise BadPlant(
                    f"{self.at(key)} is not a field; known are {', '.join(known)}",
                    field=self.at(key),
                )

    def number(self, key: str, *, above: float = -math.inf, default: float | None = None) -> float:
        """A finite number greater than `above`."""
        value = default if key not in self.value and default is not None else self._get(key)
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or not _finite(value)
            or not value > above
        ):
            wanted = "a finite number" if above == -math.inf else f"a finite number above {above:g}"
            raise BadPlant(f"{self.at(key)} must be {wanted}", field=self.at(key))
        return float(value)

    def every_number(self) -> dict[str, float]:
        """All fields as finite numbers, by name."""
        return {name: self.number(name) for name in self.value}

    def text(self, key: str, default: str | None = None) -> str:
        """A printable string of 1 to 256 characters. Raises BadPlant."""
        text = default if key not in self.value and default is not None else self._get(key)
        if (
            not isinstance(text, str)
            or (not text and default is None)
            or not text.isprintable()
            or len(text) > 256  # noqa: PLR2004 - the message says it
        ):
            raise BadPlant(
                f"{self.at(key)} must be a printable string of 1 to 256 characters",
                field=self.at(key),
            )
        return text

    def name(self, key: str) -> str:
        """A name: lower-case letters, digits, - and _, 63 at most. Never a path."""
        name = self.text(key)
        if not NAME.fullmatch(name):
            raise BadPlant(
                (
                    f"{self.at(key)} must be 1 to 63 of a-z, 0-9, - and _, beginning with a "
                    "letter or digit"
                ),
                field=self.at(key),
            )
        return name

    def choice(self, key: str, options: Sequence[str], default: str | None = None) -> str:
        """One of some options. Raises BadPlant."""
        choice = default if key not in self.value and default is not None else self._get(key)
        if not isinstance(choice, str) or choice not in options:
            raise BadPlant(
                f"{self.at(key)} must be one of {', '.join(options)}", field=self.at(key)
            )
        return str(choice)

    def interval(self, key: str) -> tuple[float, float]:
        """Two finite numbers, the lower one first."""
        bounds = self._get(key)
        if not isinstance(bounds, list) or len(bounds) != 2:  # noqa: PLR2004
            raise BadPlant(f"{self.at(key)} must be [lower, upper]", field=self.at(key))
        pair = Reader({"lower": bounds[0], "upper": bounds[1]}, self.at(key))
        lower = pair.number("lower")
        return lower, pair.number("upper", above=lower)

    def names(self, key: str) -> list[str]:
        """The different words of the non-empty list at `key`."""
        words = self._get(key)
        if (
            not isinstance(words, list)
            or not all(isinstance(w, str) and w for w in words)
            or not words
            or len(set(map(str, words))) < len(words)
        ):
            raise BadPlant(f"{self.at(key)} must be a list of names", field=self.at(key))
        return [str(w) for w in words]

    def numbers(self, key: str, count: int | None = None) -> list[float]:
        """A list of so many finite numbers, or of any."""
        numbers = self._get(key)
        if not isinstance(numbers, list) or len(numbers) != (
            len(numbers) if count is None else count
        ):
            raise BadPlant(
                f"{self.at(key)} must be a list of {'' if count is None else f'{count} '}numbers",
                field=self.at(key),
            )
        items = Reader({str(i): x for i, x in enumerate(numbers)}, self.at(key))
        return [items.number(str(i)) for i in range(len(numbers))]
