"""Commands that run the service: serve, work, migrate, kernels."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import threading
from collections.abc import Mapping
from typing import Annotated

from cyclopts import Parameter, validators

from trueup_cli.options import Json
from trueup_cli.show import as_json, err, progress, say

RESTART_PAUSE_S = 1.0


def serve(
    *,
    host: str | None = None,
    port: int | None = None,
    processes: Annotated[int, Parameter(validator=validators.Number(gte=1))] = 1,
    worker: Annotated[bool, Parameter(help="Run a worker beside the server")] = True,
) -> None:
    """Serve on embedded storage, or on what TRUEUP_DATABASE_URL and TRUEUP_S3_BUCKET name.

    Parameters
    ----------
    host
        address to listen on; TRUEUP_HOST, else 127.0.0.1
    port
        port to listen on; TRUEUP_PORT, else 8321
    processes
        how many processes serve on that port, for a machine with several cores
    """
    from trueup_service.authentication import first_admin
    from trueup_service.http.serve import listen, serve_by_processes
    from trueup_service.http.serve import serve as run
    from trueup_service.logs import configure_logs
    from trueup_service.settings import Settings
    from trueup_service.wiring import build

    if worker:
        import trueup_worker  # noqa: F401  (fails here if it is missing, not in the child)
    settings = Settings() if host is None else Settings(host=host)
    configure_logs(settings.log_level)
    parts = build(settings)
    token_file = first_admin(settings, parts.database)
    if token_file is not None:
        say(
            "An admin's token was made; it is in {}, which the command beside it reads.",
            token_file,
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
    child = _ChildWorker() if worker else None
    try:
        if processes == 1:
            run(parts, listening)
        else:
            parts.close()
            serve_by_processes(settings, listening, processes)
    finally:
        if child is not None:
            child.stop()


class _ChildWorker:
    """A worker as a child process, started again when it dies.

    It ends with this process, because it watches the pipe between them.
    """

    def __init__(self) -> None:
        self._stopping = threading.Event()
        self._child: subprocess.Popen[bytes] | None = None
        self._thread = threading.Thread(target=self._supervise, daemon=True)
        self._thread.start()

    def _supervise(self) -> None:
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


SERVER_SECRETS = ("TRUEUP_SIGNING_KEY", "TRUEUP_SIGNING_KEY_BEFORE", "TRUEUP_ADMIN_TOKEN")


def _without_secrets(environment: Mapping[str, str]) -> dict[str, str]:
    """Returns an environment without the secrets of a server, which a worker does not need."""
    return {name: value for name, value in environment.items() if name not in SERVER_SECRETS}


def work(
    *,
    with_parent: Annotated[
        bool, Parameter(help="End when standard input closes", negative=())
    ] = False,
) -> None:
    """Run one worker: it takes jobs from the queue, and resumes those of workers that died."""
    from trueup_service.logs import configure_logs
    from trueup_service.settings import Settings
    from trueup_service.wiring import build
    from trueup_worker.main import work as run

    held = [name for name in SERVER_SECRETS if os.environ.pop(name, None) is not None]
    settings = Settings()
    configure_logs(settings.log_level)
    if held:
        logging.getLogger("trueup.worker").warning(
            "a worker needs no such secret: give it to servers alone", extra={"settings": held}
        )
    run(build(settings), with_parent=with_parent)


def migrate(*, as_json_: Json = False) -> None:
    """Bring the schemas of the registry and of the job engine up to date.

    A server does it when it starts.
    """
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
    """Compile the rollout kernels into the cache, so that the first rollout is quick."""
    from trueup.fit.fitter import warm
    from trueup.model.family_kernel import compile_all

    with progress("compiling"):
        families, count = compile_all(), warm()
    if as_json_:
        as_json({"families": families, "effects": count})
        return
    say("compiled: {}, and one kernel with {} effects", ", ".join(families), count)


def keygen(name: str, *, as_json_: Json = False) -> None:
    """Make a signing key.

    Set the first line as TRUEUP_SIGNING_KEY on every server, and give the second line to robots and
    auditors.

    Parameters
    ----------
    name
        name of the log, such as registry.example.com/robots; it stands in every checkpoint
    """
    from trueup.ledger.signed_note import Signer
    from trueup_service.signed_log import new_signer

    signer = Signer.from_text(new_signer(name).text)
    if as_json_:
        as_json({"signing_key": signer.text, "verifier": signer.verifier})
        return
    say("{}", signer.text)
    say("{}", signer.verifier)
