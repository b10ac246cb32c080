"""One way to bytes, one way to a digest.

Canonical bytes are RFC 8785 (JSON Canonicalization Scheme); a digest is SHA-256 in lower-case
hexadecimal.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from typing import TypeAlias

import orjson
import rfc8785

from trueup.errors import TrueupError

Json: TypeAlias = "bool | int | float | str | Sequence[Json] | Mapping[str, Json] | None"

# integers that JSON holds exactly, and what is written without an exponent
EXACT, LARGEST_PLAIN = (2**53 - 1, 10**21)
# orjson writes the same bytes as rfc8785, twenty times as fast, but for
#   - null, which may have been a NaN
#   - floats that it writes with an exponent, or with `.0`
#   - characters beyond 16 bits, by which it sorts keys otherwise
# and it raises for what it does not know, such as subclasses and mappings that are no dict.
_AS_CANONICAL = (
    orjson.OPT_SORT_KEYS
    | orjson.OPT_STRICT_INTEGER
    | orjson.OPT_PASSTHROUGH_SUBCLASS
    | orjson.OPT_PASSTHROUGH_DATACLASS
    | orjson.OPT_PASSTHROUGH_DATETIME
)
_OTHERWISE = re.compile(rb"null|(?:^|[:,\[])-?[0-9]+(?:\.0(?![0-9])|(?:\.[0-9]+)?e)|[\xf0-\xff]")
_DIGEST = re.compile(r"[0-9a-f]{64}")


class NotCanonical(TrueupError):
    """The value has no canonical form."""

    code = "not-canonical"
    hint = (
        "RFC 8785 knows no NaN, no infinity and no integer that a float does not hold "
        "exactly: send such integers as strings."
    )


def canonical_bytes(value: Json) -> bytes:
    """The RFC 8785 bytes of a JSON value. Raises NotCanonical.

    A float such as 1e17 is written without a point and read back as an integer: it is the same
    number, and has the same bytes again.
    """
    try:
        written = orjson.dumps(value, option=_AS_CANONICAL)
    except TypeError:
        return _by_the_letter(value)
    return _by_the_letter(value) if _OTHERWISE.search(written) else written


def _by_the_letter(value: Json) -> bytes:
    """The bytes as rfc8785 writes them. Raises NotCanonical."""
    try:
        try:
            return rfc8785.dumps(value)
        except rfc8785.IntegerDomainError:
            return rfc8785.dumps(_as_written(value))
    except (rfc8785.CanonicalizationError, UnicodeEncodeError, RecursionError) as error:
        raise NotCanonical(
            f"the value has no canonical form: {type(error).__name__}: {ascii(str(error))[:200]}"
        ) from error


def _as_written(value: Json) -> Json:
    """The value with every large integer that is how a float is written as that float."""
    if isinstance(value, Mapping):
        return {key: _as_written(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_as_written(item) for item in value]
    if (
        isinstance(value, int)
        and EXACT < abs(value) < LARGEST_PLAIN
        and rfc8785.dumps(float(value)).decode() == str(value)
    ):
        return float(value)
    return value


def digest_of_bytes(data: bytes | memoryview) -> str:
    """SHA-256 of the bytes, 64 lower-case hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()


def digest_of(value: Json) -> str:
    """SHA-256 of the canonical bytes of a JSON value."""
    return digest_of_bytes(canonical_bytes(value))


def is_digest(text: str) -> bool:
    """Whether the text has the form of a digest."""
    return _DIGEST.fullmatch(text) is not None
