"""Build the parts of the service from the settings. Only this module does."""

from __future__ import annotations

import os
import tempfile
import uuid
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path

from trueup.canonical import digest_of_bytes
from trueup_service.jobs import JobQueue
from trueup_service.locks import own_folder
from trueup_service.permissions import make_private
from trueup_service.registry.blobs import Blobs
from trueup_service.registry.database import Database, copy_sqlite
from trueup_service.registry.folder_blobs import FolderBlobs
from trueup_service.registry.schema import migrate
from trueup_service.registry.writer import Writer
from trueup_service.settings import Settings

STORE_RETRIES = 3  # of a request; then the caller repeats it with its idempotency key
STORE_CONNECT, STORE_PATIENCE = timedelta(seconds=5), timedelta(seconds=15)


@dataclass(frozen=True)
class Parts:
    """The parts that the server and the worker are made of."""

    settings: Settings
    database: Database
    writer: Writer
    blobs: Blobs
    queue: JobQueue
    spool: Path

    def close(self) -> None:
        """Close every connection."""
        self.writer.close()
        self.database.close()


def build(settings: Settings) -> Parts:
    """Build the parts, with an up-to-date schema and a spool folder of this process."""
    make_private(settings.data_dir, settings.sqlite_file)
    database = Database(settings.sqlalchemy_url, settings.database_pool)
    migrate(database)
    return Parts(
        settings,
        database,
        Writer(database),
        _blobs(settings),
        JobQueue(settings.sqlalchemy_url, database.engine),
        own_folder(settings.data_dir / "spool"),
    )


@contextmanager
def build_to_read(settings: Settings) -> Iterator[Parts]:
    """Build the parts for a process that only reads. Where the data folder cannot be written, such
    as a mounted snapshot, they are over a copy of its database, and nothing is written there."""
    with ExitStack() as ended:
        if os.access(settings.data_dir, os.W_OK) or not settings.data_dir.is_dir():
            parts = build(settings)
        else:
            folder = Path(ended.enter_context(tempfile.TemporaryDirectory(prefix="trueup-")))
            url = (
                settings.sqlalchemy_url
                if settings.sqlite_file is None
                else f"sqlite:///{copy_sqlite(settings.sqlite_file, folder)}"
            )
            database = Database(url, settings.database_pool)
            migrate(database)
            parts = Parts(
                settings,
                database,
                Writer(database),
                _blobs(settings),
                JobQueue(url, database.engine),
                own_folder(folder / "spool"),
            )
        ended.callback(parts.close)
        yield parts


def keep_bytes(parts: Parts, data: bytes) -> str:
    """Put bytes into the blob store, and return their digest. Repeating it changes nothing."""
    digest, path = digest_of_bytes(data), parts.spool / uuid.uuid4().hex
    path.write_bytes(data)
    try:
        parts.blobs.put(digest, path)
    finally:
        path.unlink(missing_ok=True)
    return digest


def _blobs(settings: Settings) -> Blobs:
    if settings.s3_bucket is None:
        return FolderBlobs(settings.data_dir / "blobs")
    from obstore.store import S3Store  # noqa: PLC0415  (only a scaled installation has a store)

    from trueup_service.registry.s3_blobs import S3Blobs  # noqa: PLC0415

    options = {
        "endpoint": settings.s3_endpoint,
        "region": settings.s3_region,
        "access_key_id": settings.s3_access_key,
        "secret_access_key": settings.s3_secret_key and settings.s3_secret_key.get_secret_value(),
    }
    is_plain = bool(settings.s3_endpoint and settings.s3_endpoint.startswith("http:"))
    config = {key: value for key, value in options.items() if value is not None}
    store = S3Store(
        settings.s3_bucket,
        prefix=settings.s3_prefix,
        client_options={"allow_http": is_plain, "connect_timeout": STORE_CONNECT},
        retry_config={"max_retries": STORE_RETRIES, "retry_timeout": STORE_PATIENCE},
        **config,
    )
    return S3Blobs(store)
