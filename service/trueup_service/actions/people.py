"""People: who is behind a token. Two tokens of one name are one person, and whoever's token was
revoked is nobody."""

from __future__ import annotations

from trueup.ledger.person import folded, name_of
from trueup_service.registry.transaction import ReadTransaction


def person_of(tx: ReadTransaction, token: str, actor: str) -> str | None:
    """The person behind a token's prefix, by name, however it is written; None where the token was
    revoked.

    A token that is not known here, as the admin's of the settings or one of the site where a plant
    comes from, is its actor's.
    """
    found = tx.tokens.get(token)
    if found is None:
        return folded(name_of(actor))
    return None if found.revoked_at is not None else folded(found.name)
