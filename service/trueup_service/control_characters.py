"""Control characters, which text from others may not hold: a terminal or a page obeys them instead
of showing them.

- C0 and C1 control characters and DEL: escape sequences begin with one, U+009B alone is as good as
  ESC [.
- Line and paragraph separators, and the embeddings, overrides and isolates of bidirectional text,
which show it in another order. Source: ECMA-48, section 5; Unicode Standard Annex 9, section 2.
"""

from __future__ import annotations

import re

CONTROL = r"\x00-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069"
LINE = rf"^[^{CONTROL}]+$"  # a pattern of JSON Schema, too
_CONTROL = re.compile(f"[{CONTROL}]")


def control_character(text: str, allowed: str = "") -> str | None:
    """The code point of the first control character in a text that is not allowed, None where there
    is none."""
    character = next((c for c in _CONTROL.findall(text) if c not in allowed), None)
    return None if character is None else f"U+{ord(character):04X}"


def without_control_characters(text: str) -> str:
    """A text with each control character replaced."""
    return _CONTROL.sub("\N{REPLACEMENT CHARACTER}", text)
