"""Frozen: a declaration that is named by the digest of its canonical document, and read back from
it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from functools import cached_property
from typing import Any, ClassVar, Self

from trueup.canonical import Json, digest_of
from trueup.errors import TrueupError


class Frozen:
    """Base of a frozen dataclass of JSON values that is declared: its `schema`, the error that
    refuses it, and its name in messages."""

    schema: ClassVar[str]
    refused: ClassVar[type[TrueupError]]
    noun: ClassVar[str]

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the canonical document."""
        return digest_of(self.document())

    def document(self) -> dict[str, Json]:
        """The declaration as JSON."""
        return {"schema": self.schema, **asdict(self)}  # type: ignore[call-overload]

    @classmethod
    def from_document(cls, document: Mapping[str, Any]) -> Self:
        """Read a declaration from JSON. Raises the class's own error."""
        values = dict(document)
        if values.pop("schema", None) != cls.schema:
            raise cls.refused(f"the schema of {cls.noun} is {cls.schema}", field="schema")
        try:
            return cls(**values)
        except TypeError as error:
            raise cls.refused(f"{cls.noun} cannot be read: {error}") from error
