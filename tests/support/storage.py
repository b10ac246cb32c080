"""The two storages as environments of the service."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.support.postgres import Postgres
from tests.support.s3 import S3
from trueup.ledger.signed_note import Signer
from trueup_service.settings import Settings
from trueup_service.wiring import Parts, build

SIGNING_KEY = Signer("trueup-tests", bytes(32)).text  # one for all servers of a database


@dataclass(frozen=True)
class Storage:
    """A storage, by the environment variables that configure a service for it."""

    name: str
    environment: dict[str, str]

    def settings(self) -> Settings:
        """Returns the settings of a service on this storage."""
        return Settings(
            **{
                key.removeprefix("TRUEUP_").lower(): value
                for key, value in self.environment.items()
            }
        )

    def build(self) -> Parts:
        """Opens the storage as the service does."""
        return build(self.settings())


def embedded(folder: Path) -> Storage:
    """Returns SQLite and a folder."""
    return Storage(
        "embedded",
        {
            "TRUEUP_DATA_DIR": str(folder),
            "TRUEUP_JOB_POLL_INTERVAL_S": "0.05",
            "TRUEUP_TAKEOVER_INTERVAL_S": "0.2",
        },
    )


def scaled(folder: Path, postgres: Postgres, s3: S3) -> Storage:
    """Returns a new database of PostgreSQL and a new bucket of an S3 store."""
    more = {
        "TRUEUP_DATABASE_URL": postgres.new_database(),
        "TRUEUP_S3_BUCKET": s3.new_bucket(),
        "TRUEUP_S3_ENDPOINT": s3.endpoint,
        "TRUEUP_S3_ACCESS_KEY": "test",
        "TRUEUP_S3_SECRET_KEY": "test",
        "TRUEUP_SIGNING_KEY": SIGNING_KEY,
    }
    return Storage("scaled", embedded(folder).environment | more)


def requested(request: pytest.FixtureRequest, folder: Path) -> Storage:
    """Returns a fresh storage of the kind that is the parameter of a fixture: `embedded`, or
    `scaled` on the servers of the tests."""
    if request.param == "embedded":
        return embedded(folder)
    return scaled(folder, request.getfixturevalue("postgres"), request.getfixturevalue("s3"))
