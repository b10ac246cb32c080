"""People: who is behind a token. Two tokens of one name are one person, and whoever's token was revoked is nobody."""

from __future__ import annotations

from trueup.ledger.person import folded
from trueup_service.registry.store import Reader

ADMIN = "admin"  # whose token stands in the settings, and in no row


def person_of(reader: Reader, token: str) -> str | None:
    """The person behind a token's prefix, by name, however it is written; None where the token was revoked."""
    found = reader.token(token)
    if found is None:
        return ADMIN
    return None if found.revoked_at is not None else folded(found.name)
