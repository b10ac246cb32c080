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
# orjson writes the same bytes as rfc8785, many times as fast, but for
#   - NaN and infinities, as null
#   - floats that are whole, as `1.0`, and -0.0
#   - floats that it writes with an exponent
#   - characters beyond 16 bits, by which it sorts keys otherwise
# and it raises for what it does not know, such as subclasses and mappings that are no dict.
_AS_CANONICAL = (
    orjson.OPT_SORT_KEYS
    | orjson.OPT_STRICT_INTEGER
    | orjson.OPT_PASSTHROUGH_SUBCLASS
    | orjson.OPT_PASSTHROUGH_DATACLASS
    | orjson.OPT_PASSTHROUGH_DATETIME
)
# Exponents from -7 downwards are written as RFC 8785 writes them.
_EXPONENT = re.compile(rb"[0-9]e(?:[+0-9]|-[1-6](?![0-9]))")
_TEXTS = re.compile(rb'("[^"\\]*(?:\\.[^"\\]*)*")')
_WHOLE = re.compile(rb"([0-9])\.0(?![0-9])")
_MINUS_ZERO = re.compile(rb"-0(?![0-9.])")
_BEYOND_16_BITS = re.compile(rb"[\xf0-\xff]")
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
    written = _quickly(value)
    return _by_the_letter(value) if written is None else written


def _quickly(value: Json) -> bytes | None:
    """The bytes as orjson writes them, None where they may not be canonical."""
    try:
        written = orjson.dumps(value, _plain_text, _AS_CANONICAL)
    except TypeError:
        return None
    if (not written.isascii() and _BEYOND_16_BITS.search(written)) or (
        b"null" in written and orjson.loads(written) != value  # a NaN is no null
    ):
        return None
    if b".0" in written or _EXPONENT.search(written):
        return _with_whole_numbers(written)
    return written


def _with_whole_numbers(written: bytes) -> bytes | None:
    """The bytes with whole numbers without their point, None where a number has an exponent that
    RFC 8785 writes in another way. Texts stay as they are."""
    pieces = _TEXTS.split(written)  # every other one is a text
    between = b'"'.join(pieces[::2])
    if _EXPONENT.search(between):
        return None
    if b".0" not in between:
        return written
    pieces[::2] = _MINUS_ZERO.sub(b"0", _WHOLE.sub(rb"\1", between)).split(b'"')
    return b"".join(pieces)


def _plain_text(value: object) -> str:
    """A text of a class of its own, such as a name of an enumeration, as text. Raises TypeError for
    anything else."""
    if isinstance(value, str):
        return str.__str__(value)
    raise TypeError


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
