"""Authentication by tokens, and by the sessions of browsers.

A token is `trueup_<prefix>_<secret>`. The prefix finds its row. Of the secret (32 random bytes)
only the SHA-256 is stored, and compared in constant time. A token is shown once, to whoever issued
it.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from trueup.files import write_new
from trueup_service.actions.tokens import issue_token
from trueup_service.actor_context import ActorContext, time_text
from trueup_service.errors import Unauthenticated
from trueup_service.registry.database import Database
from trueup_service.registry.records import Role, TokenRecord
from trueup_service.registry.transaction import reading, writing
from trueup_service.settings import Settings

PREFIX_BYTES, SECRET_BYTES = 6, 32
PARTS = 3  # of a token, between underscores
REMEMBERED = 10_000
ADMIN_FILE = "admin.token"
FROM_SETTINGS = "settings"  # stands for the prefix of the token in the settings


@dataclass(frozen=True, slots=True)
class Principal:
    """Who was authenticated: the name and prefix of the token, its roles, and the project and plant
    that it sees, None for all."""

    name: str
    token: str
    roles: frozenset[Role]
    project: str | None
    plant: str | None

    @property
    def everywhere(self) -> bool:
        """Whether the token sees all projects and plants."""
        return self.project is None and self.plant is None


def new_token() -> tuple[str, str, str]:
    """A fresh token: its text, its prefix and the digest of its secret."""
    prefix, secret = secrets.token_hex(PREFIX_BYTES), secrets.token_urlsafe(SECRET_BYTES)
    return f"trueup_{prefix}_{secret}", prefix, digest_of_secret(secret)


def digest_of_secret(secret: str) -> str:
    """The digest that is stored of a secret. The secret is random and long, so a plain hash cannot
    be searched."""
    return hashlib.sha256(secret.encode()).hexdigest()


class Authenticator:
    """Authenticates tokens and sessions, and remembers them for a moment."""

    def __init__(
        self, settings: Settings, database: Database, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._database, self._clock, self._memory_s = database, clock, settings.token_memory_s
        self._admin = settings.admin_token.get_secret_value() if settings.admin_token else None
        self._admin_prefix = (
            None
            if self._admin is None
            else FROM_SETTINGS + digest_of_secret(self._admin)[: len(FROM_SETTINGS)]
        )
        self._known: dict[str, tuple[Principal, float]] = {}

    def remembered(self, credential: str) -> Principal | None:
        """Who was authenticated by the same credential a moment ago."""
        entry = self._known.get(digest_of_secret(credential))
        return entry[0] if entry is not None and self._clock() < entry[1] else None

    def by_token(self, text: str) -> Principal:
        """The principal of a token. Raises Unauthenticated."""
        if self._admin is not None and hmac.compare_digest(text.encode(), self._admin.encode()):
            return self._remember(text, self._from_settings())
        _, prefix, secret = ([*text.split("_", PARTS - 1), "", ""])[:PARTS]
        with reading(self._database) as tx:
            token = tx.tokens.get(prefix)
        # Digests are compared also for an unknown prefix, so that timing reveals nothing.
        held = token.digest if token else digest_of_secret("")
        if not hmac.compare_digest(digest_of_secret(secret), held) or token is None:
            raise Unauthenticated("the token is not known")
        return self._remember(text, _holder(token))

    def by_session(self, cookie: str) -> Principal:
        """The principal of a browser's session. Raises Unauthenticated."""
        with reading(self._database) as tx:
            prefix = tx.sessions.token(digest_of_secret(cookie), _now())
            token = None if prefix is None else tx.tokens.get(prefix)
        if prefix is not None and prefix == self._admin_prefix:
            return self._remember(cookie, self._from_settings())
        if token is None:
            raise Unauthenticated("the session has ended", hint="Sign in again.")
        return self._remember(cookie, _holder(token))

    def _from_settings(self) -> Principal:
        """The principal of the admin's token in the settings. The stand-in for its prefix changes
        with the token, which ends the sessions that an older token began."""
        return Principal("admin", str(self._admin_prefix), frozenset({Role.ADMIN}), None, None)

    def forget(self) -> None:
        """Forget every remembered credential, so that the database is asked again."""
        self._known.clear()

    def _remember(self, credential: str, principal: Principal) -> Principal:
        if len(self._known) >= REMEMBERED:
            self._known.clear()
        if self._memory_s:
            self._known[digest_of_secret(credential)] = principal, self._clock() + self._memory_s
        return principal


def _holder(token: TokenRecord) -> Principal:
    """The principal of a token. Raises Unauthenticated where it has expired or was revoked."""
    if token.revoked_at is not None:
        raise Unauthenticated("the token was revoked", name=token.name)
    if token.expires_at is not None and token.expires_at <= _now():
        raise Unauthenticated("the token has expired", name=token.name, expires_at=token.expires_at)
    return Principal(
        token.name, token.prefix, frozenset(map(Role, token.roles)), token.project, token.plant
    )


def _now() -> str:
    return time_text(datetime.now(UTC))


def first_admin(settings: Settings, database: Database) -> Path | None:
    """Make an admin's token where there is no admin. Returns the file that holds it, None where it
    was not needed."""
    if settings.admin_token is not None:
        return None
    with writing(database) as tx:
        tx.lock_name("first admin")
        if any(
            Role.ADMIN in token.roles and token.revoked_at is None
            for token in tx.tokens.page("", 10**6)
        ):
            return None
        text, prefix, digest = new_token()
        path = settings.data_dir / ADMIN_FILE
        path.unlink(missing_ok=True)
        write_new(path, f"{text}\n".encode(), mode=0o600)
        token = TokenRecord(
            prefix=prefix,
            digest=digest,
            name="admin",
            roles=[Role.ADMIN.value],
            project=None,
            plant=None,
            created_at=_now(),
            created_by="first start",
            expires_at=None,
        )
        issue_token(tx, token, ActorContext("first start", token.created_at))
    return path
