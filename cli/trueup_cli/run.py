"""Commands that run the service: serve, work, migrate, kernels."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import threading
from collections.abc import Mapping
from typing import Annotated

from cyclopts import Parameter

from trueup_cli.options import Json
from trueup_cli.show import as_json, err, progress, say

RESTART_PAUSE_S = 1.0


def serve(
    *,
    host: str | None = None,
    port: int | None = None,
    worker: Annotated[bool, Parameter(help="Run a worker beside the server")] = True,
) -> None:
    """Serve on embedded storage, or on what TRUEUP_DATABASE_URL and TRUEUP_S3_BUCKET name, with a
    worker beside.

    Parameters
    ----------
    host
        address to listen on; TRUEUP_HOST, else 127.0.0.1
    port
        port to listen on; TRUEUP_PORT, else 8321
    """
    from trueup_service.authentication import first_admin
    from trueup_service.http.serve import listen
    from trueup_service.http.serve import serve as run
    from trueup_service.logs import configure_logs
    from trueup_service.settings import Settings
    from trueup_service.wiring import build

    if worker:
        import trueup_worker  # noqa: F401  (said now where it is missing, not by the process beside)
    settings = Settings() if host is None else Settings(host=host)
    configure_logs(settings.log_level)
    parts = build(settings)
    made = first_admin(settings, parts.database)
    if made is not None:
        say(
            "An admin's token was made; it is in {}, which the command beside it reads.",
            made,
            to=err,
        )
    listening = listen(settings.host, settings.port if port is None else port)
    address = listening.getsockname()
    logging.getLogger("trueup").info(
        "listening",
        extra={
            "url": f"http://{address[0]}:{address[1]}",
            "data_dir": str(settings.data_dir.absolute()),
        },
    )
    beside = _Beside() if worker else None
    try:
        run(parts, listening)
    finally:
        if beside is not None:
            beside.stop()


class _Beside:
    """A worker as a child, started again when it dies; it ends with us, for it watches the pipe
    that we hold."""

    def __init__(self) -> None:
        self._stopping = threading.Event()
        self._child: subprocess.Popen[bytes] | None = None
        self._thread = threading.Thread(target=self._keep, daemon=True)
        self._thread.start()

    def _keep(self) -> None:
        while not self._stopping.is_set():
            command = [sys.executable, "-m", "trueup_cli.main", "work", "--with-parent"]
            self._child = subprocess.Popen(
                command, stdin=subprocess.PIPE, env=_without_secrets(os.environ)
            )
            self._child.wait()
            self._stopping.wait(RESTART_PAUSE_S)

    def stop(self) -> None:
        self._stopping.set()
        if self._child is not None:
            self._child.terminate()
        self._thread.join(timeout=10)


SERVERS_ALONE = ("TRUEUP_SIGNING_KEY", "TRUEUP_SIGNING_KEY_BEFORE", "TRUEUP_ADMIN_TOKEN")


def _without_secrets(environment: Mapping[str, str]) -> dict[str, str]:
    """An environment without the log's key and an admin's token: a worker reads what others wrote,
    and needs neither."""
    return {name: value for name, value in environment.items() if name not in SERVERS_ALONE}


def work(
    *,
    with_parent: Annotated[
        bool, Parameter(help="End when standard input closes", negative=())
    ] = False,
) -> None:
    """Run one worker: it takes jobs from the queue, and takes over those of workers that died."""
    from trueup_service.logs import configure_logs
    from trueup_service.settings import Settings
    from trueup_service.wiring import build
    from trueup_worker.main import work as run

    held = [name for name in SERVERS_ALONE if os.environ.pop(name, None) is not None]
    settings = Settings()
    configure_logs(settings.log_level)
    if held:
        logging.getLogger("trueup.worker").warning(
            "a worker needs no such secret: give it to servers alone", extra={"settings": held}
        )
    run(build(settings), with_parent=with_parent)


def migrate(*, as_json_: Json = False) -> None:
    """Bring the database's schema up to date, the registry's and the job engine's; servers do it
    when they start."""
    from trueup_migrations import HEAD
    from trueup_service.jobs import migrate_engine
    from trueup_service.settings import Settings
    from trueup_service.wiring import build

    settings = Settings()
    with progress("migrating"):
        build(settings).close()
        migrate_engine(settings.sqlalchemy_url)
    as_json({"schema": HEAD}) if as_json_ else say("the schema is at {}", HEAD)


def kernels(*, as_json_: Json = False) -> None:
    """Compile the rollout kernels into the cache, so that the first rollout is as quick as the
    others."""
    from trueup.fit.fitter import warm
    from trueup.model.family_kernel import compile_all

    with progress("compiling"):
        families, count = compile_all(), warm()
    said = f"compiled: {', '.join(families)}, and one kernel with {count} effects"
    as_json({"families": families, "effects": count}) if as_json_ else say("{}", said)


def keygen(name: str, *, as_json_: Json = False) -> None:
    """Make a signing key: set the first line as TRUEUP_SIGNING_KEY on every server, and give the
    second to robots and auditors.

    Parameters
    ----------
    name
        name of the log, such as registry.example.com/robots; it stands in every checkpoint
    """
    from trueup.ledger.signed_note import Signer
    from trueup_service.signed_log import new_signer

    made = Signer.from_text(new_signer(name).text)
    if as_json_:
        as_json({"signing_key": made.text, "verifier": made.verifier})
        return
    say("{}", made.text)
    say("{}", made.verifier)
