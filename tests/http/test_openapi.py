"""The OpenAPI document: complete, readable, and true, as a tool that knows nothing else of us sees
it."""

import json
import subprocess
import sys
import urllib.request
from contextlib import closing

import pytest

from tests.support.made import plant_document
from tests.support.service import ADMIN, Service
from trueup_client import Client


def document(service):
    with urllib.request.urlopen(f"{service.url}/openapi.json") as answer:
        return json.load(answer)


def test_every_operation_has_a_summary_a_tag_and_documented_refusals(service):
    for path, operations in document(service)["paths"].items():
        for method, operation in operations.items():
            assert operation["summary"], (method, path)
            assert operation["tags"], (method, path)
            assert {"4XX", "5XX"} <= set(operation["responses"]), (method, path)


def test_every_noun_is_under_v1(service):
    described = document(service)["paths"]
    assert {path for path in described if not path.startswith("/v1/")} == {
        "/healthz",
        "/readyz",
        "/metrics",
    }
    nouns = {path.split("/")[-1] for path in described if path.startswith("/v1/plants/{plant}/")}
    assert {
        "episodes",
        "artifacts",
        "gates",
        "jobs",
        "decisions",
        "serving",
        "history",
        "promote",
        "rollback",
    } <= nouns


@pytest.mark.parametrize("storage", ["scaled"], indirect=True)  # the stricter of the two databases
def test_schemathesis_finds_no_answer_that_the_document_does_not_know(storage, tmp_path):
    checks = [
        "not_a_server_error",
        "status_code_conformance",
        "content_type_conformance",
        "response_schema_conformance",
    ]
    # a guessed If-None-Match and wait_s together are a long poll, and a good one: a second of it is
    # as true as a minute
    with Service(storage, long_poll_limit_s=1).running() as service:
        with closing(Client(service.url)) as client:
            client.register_plant(plant_document("emps-like"))
        known = ["-H", f"Authorization: Bearer {ADMIN}", *(f"-c{c}" for c in checks)]
        arguments = [
            "--max-examples",
            "10",
            "--phases",
            "coverage,fuzzing",
            "--seed",
            "1",
            "--no-color",
            *known,
        ]
        command = [
            sys.executable,
            "-m",
            "schemathesis.cli",
            "run",
            f"{service.url}/openapi.json",
            *arguments,
        ]
        done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 0, done.stdout[-3000:]
