"""What is deployed with: held against the published schemas, and against the settings and files
that there are."""

import json
import re
from pathlib import Path

import check_jsonschema
import jsonschema
import kubernetes_validate
import pytest
import yaml

from tests.support.parts import PARTS
from trueup import __version__
from trueup_cli.main import _COMMANDS
from trueup_service.settings import Settings

DEPLOY = Path(__file__).parents[2] / "deploy"
ROOT = DEPLOY.parent
MANIFESTS = [
    (path.name, document)
    for path in sorted((DEPLOY / "kubernetes").glob("*.yaml"))
    if path.name != "kustomization.yaml"
    for document in yaml.safe_load_all(path.read_text())
]
COMPOSE = yaml.safe_load((DEPLOY / "compose.yaml").read_text())
SETTINGS = {f"TRUEUP_{name.upper()}" for name in Settings.model_fields}


def containers():
    for _, document in MANIFESTS:
        template = document.get("spec", {}).get("template")
        yield from (c for c in (template or {}).get("spec", {}).get("containers", []))


def test_the_compose_file_is_one():
    schemas = Path(check_jsonschema.__file__).parent / "builtin_schemas" / "vendor"
    jsonschema.validate(COMPOSE, json.loads((schemas / "compose-spec.json").read_text()))


@pytest.mark.parametrize(
    ("name", "document"), MANIFESTS, ids=lambda x: x if isinstance(x, str) else x["kind"]
)
def test_a_manifest_is_what_kubernetes_takes(name, document):
    kubernetes_validate.validate(document, kubernetes_validate.latest_version(), strict=True)


def test_the_kustomization_names_every_manifest():
    named = yaml.safe_load((DEPLOY / "kubernetes" / "kustomization.yaml").read_text())["resources"]
    assert set(named) == {name for name, _ in MANIFESTS}


def test_every_setting_that_is_set_is_one():
    named = set(
        re.findall(
            r"TRUEUP_[A-Z0-9_]+", "".join(p.read_text() for p in DEPLOY.rglob("*") if p.is_file())
        )
    )
    assert named <= SETTINGS
    assert {
        "TRUEUP_DATABASE_URL",
        "TRUEUP_SIGNING_KEY",
        "TRUEUP_ADMIN_TOKEN",
        "TRUEUP_S3_BUCKET",
    } <= named


def test_every_command_that_is_run_is_one():
    run = [
        service["command"][0]
        for service in COMPOSE["services"].values()
        if service.get("image", "").startswith("trueup")
    ]
    run += [container["args"][0] for container in containers()]
    assert set(run) == {"serve", "work", "migrate"} <= set(_COMMANDS)


def pods(document):
    """The pod that a document describes, if it does."""
    template = (document.get("spec") or {}).get("template")
    return [template["spec"]] if template else []


def test_nothing_runs_as_root_and_probes_ask_what_there_is():
    found = list(containers())
    assert len(found) == 3
    contexts = [
        pod["securityContext"]
        for path in (DEPLOY / "kubernetes").glob("*.yaml")
        for document in yaml.safe_load_all(path.read_text())
        for pod in pods(document)
    ]
    assert [(c["runAsNonRoot"], c["runAsUser"]) for c in contexts] == [(True, 10001)] * 3
    for container in found:
        assert container["securityContext"]["readOnlyRootFilesystem"]
        assert not container["securityContext"]["allowPrivilegeEscalation"]
        assert container["securityContext"]["capabilities"] == {"drop": ["ALL"]}
    server = next(c for c in found if c["name"] == "server")
    assert {
        server[f"{kind}Probe"]["httpGet"]["path"] for kind in ("startup", "liveness", "readiness")
    } == {"/healthz", "/readyz"}
    assert "USER 10001" in (DEPLOY / "Dockerfile").read_text()


def test_workers_hold_neither_the_logs_key_nor_an_admins_token():
    secret = {"TRUEUP_SIGNING_KEY", "TRUEUP_ADMIN_TOKEN"}
    held = {
        name: secret & set(service.get("environment", {}))
        for name, service in COMPOSE["services"].items()
    }
    assert held == {name: secret if name == "server" else set() for name in COMPOSE["services"]}
    named = {
        c["name"]: {source["secretRef"]["name"] for source in c["envFrom"] if "secretRef" in source}
        for c in containers()
    }
    assert named == {
        "server": {"trueup", "trueup-server"},
        "worker": {"trueup"},
        "migrate": {"trueup"},
    }


def test_the_image_copies_what_there_is():
    lines = (DEPLOY / "Dockerfile").read_text().splitlines()
    copied = [
        source
        for line in lines
        if line.startswith("COPY ") and "--from" not in line
        for source in line.split()[1:-1]
    ]
    assert set(copied) == {*PARTS, "deploy/server.txt", "deploy/worker.txt"}
    assert all((ROOT / source).exists() for source in copied)


def test_the_image_has_the_version_that_this_is():
    images = {
        name: service["image"]
        for name, service in COMPOSE["services"].items()
        if "build" in service
    }
    ours = {"server": "trueup-server", "worker": "trueup-worker", "migrate": "trueup-server"}
    assert images == {name: f"{image}:{__version__}" for name, image in ours.items()}
    tags = {
        image["name"]: image["newTag"]
        for image in yaml.safe_load((DEPLOY / "kubernetes" / "kustomization.yaml").read_text())[
            "images"
        ]
    }
    assert tags == dict.fromkeys(ours.values(), __version__)
    assert {c["name"]: c["image"] for c in containers()} == ours
