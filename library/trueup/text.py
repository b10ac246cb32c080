"""The visible part of a text: invisible characters make no other name, and no reason."""

from __future__ import annotations

import unicodedata

FORMATS = ("Cc", "Cf")  # Unicode's categories of controls and formats
# and variation selectors
FILLERS = frozenset("\u034f\u115f\u1160\u17b4\u17b5\u2800\u3164\uffa0") | {
    chr(c) for c in range(0xFE00, 0xFE10)
}


def seen(text: str) -> str:
    """A text without invisible characters, its spaces folded; empty where nothing of it is
    visible."""
    return " ".join(
        "".join(
            c
            for c in text
            if c.isspace() or not (c in FILLERS or unicodedata.category(c) in FORMATS)
        ).split()
    )
