"""Digests as people type them: whole, or a prefix that names one record alone."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from trueup.canonical import is_digest
from trueup.errors import NoSuchDigest


def resolve_digest(
    prefix: str, records: Iterable[Mapping[str, Any]], noun: str, command: str
) -> str:
    """Returns the digest that begins with `prefix`, among records of one kind.

    `command` is the command that lists them. Raises NoSuchDigest if there is none, or several.
    """
    if is_digest(prefix):
        return prefix
    return resolve(prefix, (str(record["digest"]) for record in records), noun, command)


def resolve(prefix: str, names: Iterable[str], noun: str, command: str) -> str:
    """Returns the one of some digests or ids that begins with `prefix`. Raises NoSuchDigest if
    there is none, or several."""
    matching = sorted({name for name in names if name.startswith(prefix)})
    if len(matching) == 1:
        return matching[0]
    problem = f"{len(matching)} {noun}s begin" if matching else f"no {noun} begins"
    raise NoSuchDigest(f"{problem} with {prefix!r}", hint=f"`{command}` lists them.")
