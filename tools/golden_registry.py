"""Write tests/golden/registries/: the data folder of a small registry, and an archive of its plant,
as the present code leaves them.

Run it with every change of the schema or of the archive's layout, and keep what it wrote before:
the tests bring each registry to the present schema and import each archive.
"""

import json
import os
import socket
import sqlite3
import subprocess
import sys
import tarfile
import tempfile
import time
from contextlib import closing, suppress
from pathlib import Path

from tests.support.made import episode_bytes, plant_document, save
from trueup.episode.role import Role
from trueup.ledger.signed_note import Signer
from trueup_client import Client
from trueup_migrations import HEAD

ROOT = Path(__file__).parent.parent
FOLDER = ROOT / "tests" / "golden" / "registries"
ADMIN = "an-admins-token-that-the-tests-know"
HOOK = "https://hooks.example.com/trueup"
KEPT = "blobs", "checkpoint", "signing.key", "trueup.sqlite"


def main():
    """Makes the registry by HTTP, and packs its folder."""
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "data"
        with socket.create_server(("127.0.0.1", 0)) as free:
            port = free.getsockname()[1]
        environment = {
            **os.environ,
            "TRUEUP_DATA_DIR": str(data),
            "TRUEUP_ADMIN_TOKEN": ADMIN,
            "TRUEUP_WEBHOOK_HOSTS": "hooks.example.com",
            "TRUEUP_WEBHOOK_RETRY_S": "1",
        }
        command = [sys.executable, "-m", "trueup_cli.main", "serve", "--port", str(port)]
        with subprocess.Popen(command, env=environment) as server:
            until_listening(port)
            try:
                with Client(f"http://127.0.0.1:{port}", actor="tester", token=ADMIN) as client:
                    make(client, Path(folder))
            finally:
                server.terminate()
        pack(data, FOLDER / f"{HEAD}.tar.gz")
        archive = FOLDER / f"{HEAD}.archive.tar"
        archive.unlink(missing_ok=True)
        export = [sys.executable, "-m", "trueup_cli.main", "export", "p", str(archive)]
        subprocess.run(export, env=environment, check=True)
        key = Signer.from_text((data / "signing.key").read_text()).verifier
        archive.with_suffix(".key").write_text(f"{key}\n")


def until_listening(port):
    """Waits until somebody listens on a port."""
    while True:
        with suppress(OSError):
            socket.create_connection(("127.0.0.1", port)).close()
            return
        time.sleep(0.1)


def make(client, folder):
    """Makes a history: two candidates that a gate accepts, a promotion, a rollback, a diagnosis, a
    comparison, a project, a token and a webhook."""
    client.register_plant(plant_document("p"))
    for seed, role in ((0, Role.ADAPTATION), (1, Role.VALIDATION)):
        data = episode_bytes(seed, samples=120, role=role)
        client.upload_episode("p", save(folder, f"{seed}.mcap", data))
    gate, decisions = client.declare_gate("p")["digest"], []
    for method in ("identify", "residual"):
        fit = ended(client, {"kind": "fit", "method": method})
        trial = {"kind": "gate", "candidate": fit["artifact"], "gate": gate}
        decisions.append(ended(client, trial)["decision"])
    client.promote("p", decisions[0], 1)
    client.roll_back("p", 2)
    ended(client, {"kind": "diagnose"})
    first, second = (client.version("p", n)["digest"] for n in (1, 2))
    ended(client, {"kind": "compare", "first": first, "second": second})
    client.create_project("lab")
    client.issue_token("ada", ["engineer"], "lab")
    client.declare_webhook("hook", HOOK, ["alarm"])
    client.remove_webhook("hook")


def ended(client, request):
    """The result of a job that succeeds."""
    job = client.wait(client.submit("p", request)["id"])
    assert job["state"] == "succeeded", json.dumps(job)
    return job["result"]


def pack(data, to):
    """Packs a data folder, whose database is one file then."""
    whole = data / "whole.sqlite"
    with closing(sqlite3.connect(data / "trueup.sqlite")) as database:
        database.execute("VACUUM INTO ?", (str(whole),))
    to.parent.mkdir(parents=True, exist_ok=True)
    with tarfile.open(to, "w:gz") as tar:
        for name in KEPT:
            if (data / name).exists():
                tar.add(whole if name == "trueup.sqlite" else data / name, name)
    whole.unlink()
    print(to)


if __name__ == "__main__":
    main()
