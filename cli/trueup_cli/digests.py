"""Digests as people give them: whole, or as many digits as tell one from the others."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from trueup.canonical import is_digest
from trueup.errors import NoSuchDigest


def whole(given: str, records: Iterable[Mapping[str, Any]], noun: str, command: str) -> str:
    """The digest that begins as given, among records of one kind that a command lists. Raises
    NoSuchDigest for none, or several."""
    if is_digest(given):
        return given
    found = sorted(
        {str(record["digest"]) for record in records if str(record["digest"]).startswith(given)}
    )
    if len(found) == 1:
        return found[0]
    told = f"{len(found)} {noun}s begin" if found else f"no {noun} begins"
    raise NoSuchDigest(f"{told} with {given!r}", hint=f"`{command}` lists them.")
