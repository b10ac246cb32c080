"""Who asks: tokens, and the sessions of browsers.

A token is `trueup_<prefix>_<secret>`. The prefix finds its row, the secret (32 random bytes) is
kept as its SHA-256 alone and compared in constant time. It is shown once, to whoever issued it.
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
from trueup_service.actions.stamp import Stamp, time_text
from trueup_service.actions.tokens import issue_token
from trueup_service.errors import Unauthenticated
from trueup_service.registry.database import Database
from trueup_service.registry.records import Role, TokenRecord
from trueup_service.registry.store import Reader, writing
from trueup_service.settings import Settings

PREFIX_BYTES, SECRET_BYTES = 6, 32
PARTS = 3  # of a token, between underscores
REMEMBERED = 10_000
ADMIN_FILE = "admin.token"
FROM_SETTINGS = "settings"  # stands for the prefix of the token in the settings


@dataclass(frozen=True, slots=True)
class Who:
    """Somebody who was recognised: by which token, with which roles, and what of the registry there
    is for them."""

    name: str
    token: str
    roles: frozenset[Role]
    project: str | None
    plant: str | None

    @property
    def everywhere(self) -> bool:
        """Whether all projects and plants are there for them."""
        return self.project is None and self.plant is None


def new_token() -> tuple[str, str, str]:
    """A fresh token: its text, its prefix and the digest of its secret."""
    prefix, secret = secrets.token_hex(PREFIX_BYTES), secrets.token_urlsafe(SECRET_BYTES)
    return f"trueup_{prefix}_{secret}", prefix, digest_of_secret(secret)


def digest_of_secret(secret: str) -> str:
    """What is kept of a secret. It is random and long, so a plain hash cannot be searched."""
    return hashlib.sha256(secret.encode()).hexdigest()


class Identities:
    """Recognises tokens and sessions, and remembers them for a moment."""

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
        self._known: dict[str, tuple[Who, float]] = {}

    def remembered(self, credential: str) -> Who | None:
        """Who was recognised by these very words a moment ago."""
        found = self._known.get(digest_of_secret(credential))
        return found[0] if found is not None and self._clock() < found[1] else None

    def by_token(self, text: str) -> Who:
        """Who a token is of. Raises Unauthenticated."""
        if self._admin is not None and hmac.compare_digest(text.encode(), self._admin.encode()):
            return self._remember(text, self._from_settings())
        _, prefix, secret = ([*text.split("_", PARTS - 1), "", ""])[:PARTS]
        with self._database.read() as connection:
            found = Reader(connection).token(prefix)
        held = (
            found.digest if found else digest_of_secret("")
        )  # compared also where there is none, so that time tells nothing
        if not hmac.compare_digest(digest_of_secret(secret), held) or found is None:
            raise Unauthenticated("the token is not known")
        return self._remember(text, _holder(found))

    def by_session(self, cookie: str) -> Who:
        """Who a browser's session is of. Raises Unauthenticated."""
        with self._database.read() as connection:
            reader = Reader(connection)
            prefix = reader.session(digest_of_secret(cookie), _now())
            found = None if prefix is None else reader.token(prefix)
        if prefix is not None and prefix == self._admin_prefix:
            return self._remember(cookie, self._from_settings())
        if found is None:
            raise Unauthenticated("the session has ended", hint="Sign in again.")
        return self._remember(cookie, _holder(found))

    def _from_settings(self) -> Who:
        """Who has the token of the settings; its stand-in for a prefix changes with it, and so ends
        the sessions that it began."""
        return Who("admin", str(self._admin_prefix), frozenset({Role.ADMIN}), None, None)

    def forget(self) -> None:
        """Ask the database again for everybody."""
        self._known.clear()

    def _remember(self, credential: str, who: Who) -> Who:
        if len(self._known) >= REMEMBERED:
            self._known.clear()
        if self._memory_s:
            self._known[digest_of_secret(credential)] = who, self._clock() + self._memory_s
        return who


def _holder(token: TokenRecord) -> Who:
    """Raises Unauthenticated for a token that has expired or was revoked."""
    if token.revoked_at is not None:
        raise Unauthenticated("the token was revoked", name=token.name)
    if token.expires_at is not None and token.expires_at <= _now():
        raise Unauthenticated("the token has expired", name=token.name, expires_at=token.expires_at)
    return Who(
        token.name, token.prefix, frozenset(map(Role, token.roles)), token.project, token.plant
    )


def _now() -> str:
    return time_text(datetime.now(UTC))


def first_admin(settings: Settings, database: Database) -> Path | None:
    """Make an admin's token where there is none; the file that it is in, None where it was not
    needed."""
    if settings.admin_token is not None:
        return None
    with writing(database) as writer:
        writer.lock_name("first admin")
        if any(
            Role.ADMIN in token.roles and token.revoked_at is None
            for token in writer.tokens("", 10**6)
        ):
            return None
        text, prefix, digest = new_token()
        path = settings.data_dir / ADMIN_FILE
        path.unlink(missing_ok=True)
        write_new(path, f"{text}\n".encode(), mode=0o600)
        token = TokenRecord(
            prefix, digest, "admin", [Role.ADMIN.value], None, None, _now(), "first start", None
        )
        issue_token(writer, token, Stamp("first start", token.created_at))
    return path
