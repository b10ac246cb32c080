"""Requests drawn from the OpenAPI document, well-formed and not, alone and in chains: does any
answer differ from what it says?"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from contextlib import closing
from pathlib import Path

from bench.report import Figure, show
from bench.servers import ROOT, TOKEN
from tests.support.postgres import start_postgres
from tests.support.s3 import start_s3
from tests.support.service import Service
from tests.support.storage import Storage, embedded, scaled
from tests.support.tampering import promoted
from trueup_client import Client

EXAMPLES = os.environ.get("EXAMPLES", "100")
PHASES = "coverage,fuzzing,stateful"
CHECKS = (
    "not_a_server_error",
    "status_code_conformance",
    "content_type_conformance",
    "response_schema_conformance",
    "response_headers_conformance",
    "unsupported_method",
    "use_after_free",
    "ensure_resource_availability",
    "ignored_auth",
    "negative_data_rejection",
)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder, start_postgres() as postgres, start_s3() as s3:
        data = Path(folder)
        figures = [
            _run(storage, data / storage.name)
            for storage in (embedded(data / "a"), scaled(data / "b", postgres, s3))
        ]
    show("OpenAPI", figures)


def _run(storage: Storage, folder: Path) -> Figure:
    folder.mkdir()
    with Service(storage, long_poll_limit_s=1).running() as service:
        with closing(Client(service.url, token=TOKEN)) as client:
            _tell(folder, _filled(client, folder))
        said = folder / "said.json"
        options = [
            "--phases",
            PHASES,
            "--max-examples",
            EXAMPLES,
            "--seed",
            "1",
            "--continue-on-failure",
            "--no-color",
        ]
        known = [
            *(f"-c{check}" for check in CHECKS),
            "-H",
            f"Authorization: Bearer {TOKEN}",
            "--report-json-path",
            str(said),
        ]
        command = [
            sys.executable,
            "-m",
            "schemathesis.cli",
            "run",
            f"{service.url}/openapi.json",
            *options,
            *known,
        ]
        done = subprocess.run(
            command,
            cwd=folder,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            capture_output=True,
            text=True,
            check=False,
        )
    report = json.loads(said.read_text())
    cases, failures = report["test_cases"]["generated"], report["failures"]
    for failure in failures:
        print(json.dumps(failure)[:1000])
    unseen = report["warnings"]["missing_test_data"]
    print(f"{storage.name}: answered with nothing but 404: {', '.join(unseen)}")
    what = (
        f"{storage.name}: answers that differ from the document, of {cases} over "
        f"{report['operations']['tested']} operations"
    )
    return Figure(what, str(len(failures)), "0", done.returncode == 0 and not failures)


def _filled(client: Client, folder: Path) -> dict[str, list[str]]:
    """A registry in use: what there is, by the parameter that names it."""
    candidate, decision = promoted(client, folder)
    job = client.submit("p", {"kind": "fit", "method": "identify"})["id"]
    client.declare_channel("p", "field", [])
    episodes = [e["digest"] for e in client.episodes("p")]
    return {
        "plant": ["p"],
        "digest": [*episodes, candidate, decision],
        "version": ["1", "2"],
        "job": [job],
        "channel": ["field"],
        "table": ["plants", "episodes", "audit_tree"],
        "tile": ["000.p/3"],
    }


def _tell(folder: Path, known: dict[str, list[str]]) -> None:
    """What there is, as dictionaries: nine of ten names are drawn from them."""
    lines = [
        f"[dictionaries.{name}]\nvalues = {json.dumps(words)}" for name, words in known.items()
    ]
    lines += [
        "[parameters]",
        *(f'"path.{name}" = {{ dictionary = "{name}", probability = 0.9 }}' for name in known),
    ]
    (folder / "schemathesis.toml").write_text("\n".join(lines) + "\n")
