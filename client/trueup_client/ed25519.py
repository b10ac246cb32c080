"""Ed25519 signatures, verified with integers of the standard library, in about 10 ms each.

Nothing secret is touched.

A signature (R, s) of a message under the key A holds if s·B = R + h·A, h being SHA-512 of R, A and
the message. Points are (X, Y, Z, T) with x = X/Z, y = Y/Z, xy = T/Z on -x² + y² = 1 + d·x²y² modulo
2^255 - 19. Source: RFC 8032, sections 5.1.3 (points from bytes), 5.1.4 (addition) and 5.1.7
(verification).
"""

from __future__ import annotations

import hashlib
from typing import TypeAlias

Point: TypeAlias = "tuple[int, int, int, int]"
P = 2**255 - 19
ORDER = 2**252 + 27742317777372353535851937790883648493
D = -121665 * pow(121666, -1, P) % P
ROOT_OF_MINUS_1 = pow(2, (P - 1) // 4, P)
KEY_BYTES, SIGNATURE_BYTES = 32, 64


def _point(encoded: bytes) -> Point | None:
    """Returns the point with this y and sign of x; None if there is none on the curve."""
    number = int.from_bytes(encoded, "little")
    y, sign = number & ((1 << 255) - 1), number >> 255
    if y >= P:
        return None
    square = (y * y - 1) * pow(D * y * y + 1, -1, P) % P
    x = pow(square, (P + 3) // 8, P)
    if (x * x - square) % P:
        x = x * ROOT_OF_MINUS_1 % P
    if (x * x - square) % P or (x == 0 and sign):
        return None
    x = P - x if x & 1 != sign else x
    return x, y, 1, x * y % P


def _add(left: Point, right: Point) -> Point:
    a = (left[1] - left[0]) * (right[1] - right[0]) % P
    b = (left[1] + left[0]) * (right[1] + right[0]) % P
    c = 2 * D * left[3] * right[3] % P
    d = 2 * left[2] * right[2] % P
    e, f, g, h = b - a, d - c, d + c, b + a
    return e * f % P, g * h % P, f * g % P, e * h % P


def _times(number: int, point: Point) -> Point:
    product = (0, 1, 1, 0)
    while number:
        if number & 1:
            product = _add(product, point)
        point, number = _add(point, point), number >> 1
    return product


def _same(left: Point, right: Point) -> bool:
    return (left[0] * right[2] - right[0] * left[2]) % P == 0 and (
        left[1] * right[2] - right[1] * left[2]
    ) % P == 0


_BASE = _point((4 * pow(5, -1, P) % P).to_bytes(32, "little"))


def is_valid(public_key: bytes, signature: bytes, message: bytes) -> bool:
    """Whether the signature of a message is valid under the public key."""
    if len(public_key) != KEY_BYTES or len(signature) != SIGNATURE_BYTES:
        return False
    key, commitment = _point(public_key), _point(signature[:32])
    s = int.from_bytes(signature[32:], "little")
    if key is None or commitment is None or s >= ORDER or _BASE is None:
        return False
    hashed = (
        int.from_bytes(hashlib.sha512(signature[:32] + public_key + message).digest(), "little")
        % ORDER
    )
    return _same(_times(s, _BASE), _add(commitment, _times(hashed, key)))
