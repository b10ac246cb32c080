"""Which characters text that others send may hold: none that a terminal or a page obeys instead of
showing it.

- C0 and C1 control characters and DEL: escape sequences begin with one, U+009B alone is as good as
  ESC [.
- Line and paragraph separators, and the embeddings, overrides and isolates of bidirectional text,
which show it in another order. Source: ECMA-48, section 5; Unicode Standard Annex 9, section 2.
"""

from __future__ import annotations

import re

OBEYED = r"\x00-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069"
LINE = rf"^[^{OBEYED}]+$"  # a pattern of JSON Schema, too
_OBEYED = re.compile(f"[{OBEYED}]")


def control_character(text: str, allowed: str = "") -> str | None:
    """The first character of text that is obeyed and not allowed, as its code point; None if all of
    it is shown."""
    found = next((c for c in _OBEYED.findall(text) if c not in allowed), None)
    return None if found is None else f"U+{ord(found):04X}"
