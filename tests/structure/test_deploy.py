"""What is deployed with: held against the published schemas, and against the settings and files
that there are."""

import json
import os
import re
import subprocess
import sys
import tempfile
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
CHART = DEPLOY / "helm" / "trueup"
# of the operators that a cluster may have, whose schemas Kubernetes does not know
CUSTOM = {"ServiceMonitor", "PrometheusRule", "ScaledObject"}


def helm(*arguments, check=True):
    """The command `helm`, with caches of its own."""
    with tempfile.TemporaryDirectory() as home:
        environment = {**os.environ, **dict.fromkeys(("HELM_CACHE_HOME", "HELM_CONFIG_HOME"), home)}
        binary = Path(sys.executable).parent / "helm"
        return subprocess.run(
            [binary, *arguments], env=environment, capture_output=True, text=True, check=check
        )


def rendered(values="", name="trueup"):
    """The manifests of a release with these values, given as YAML."""
    with tempfile.NamedTemporaryFile("w", suffix=".yaml") as file:
        file.write(values)
        file.flush()
        text = helm("template", name, CHART, "--namespace", "robots", "-f", file.name).stdout
    return [document for document in yaml.safe_load_all(text) if document]


MANIFESTS = rendered()
EVERYTHING = """
image: {registry: registry.example.com/robotics/, tag: "1.2.3", pullSecrets: [pull]}
settings: {TRUEUP_WEBHOOK_HOSTS: hooks.slack.com, OTEL_EXPORTER_OTLP_ENDPOINT: "http://otel:4318"}
server: {processes: 2, storageClass: fast, autoscaling: {enabled: true}, nodeSelector: {disk: ssd}}
worker: {autoscaling: {enabled: true}, tolerations: [{key: batch, operator: Exists}]}
ingress: {enabled: true, className: nginx, host: r.example.com, tlsSecret: tls, annotations: {a: b}}
networkPolicy: {from: [{podSelector: {matchLabels: {app: proxy}}}]}
monitoring: {serviceMonitor: true, rules: true, dashboard: true}
"""
ALL = rendered(EVERYTHING, "lab")
KEDA = rendered("worker: {autoscaling: {enabled: true, kind: keda}}")
RELEASES = {"default": MANIFESTS, "everything": ALL, "keda": KEDA}
COMPOSE = yaml.safe_load((DEPLOY / "compose.yaml").read_text())
SETTINGS = {f"TRUEUP_{name.upper()}" for name in Settings.model_fields}


def containers():
    for document in MANIFESTS:
        template = document.get("spec", {}).get("template")
        yield from (c for c in (template or {}).get("spec", {}).get("containers", []))


def test_the_compose_file_is_one():
    schemas = Path(check_jsonschema.__file__).parent / "builtin_schemas" / "vendor"
    jsonschema.validate(COMPOSE, json.loads((schemas / "compose-spec.json").read_text()))


@pytest.mark.parametrize(
    "document",
    [
        pytest.param(document, id=f"{name}-{document['kind']}-{document['metadata']['name']}")
        for name, documents in RELEASES.items()
        for document in documents
        if document["kind"] not in CUSTOM
    ],
)
def test_a_manifest_is_what_kubernetes_takes(document):
    kubernetes_validate.validate(document, kubernetes_validate.latest_version(), strict=True)


def of_kind(documents, kind, end=""):
    (found,) = [d for d in documents if d["kind"] == kind and d["metadata"]["name"].endswith(end)]
    return found


def test_the_chart_is_sound_and_of_the_version_that_this_is():
    assert "0 chart(s) failed" in helm("lint", "--strict", CHART).stdout
    chart = yaml.safe_load((CHART / "Chart.yaml").read_text())
    assert chart["version"] == chart["appVersion"] == __version__


@pytest.mark.parametrize(
    "wrong",
    [
        "servers: 3",
        "image: {registry: no-slash}",
        "settings: {trueup_s3_bucket: x}",
        "settings: {TRUEUP_ADMIN_TOKEN: in-a-config-map}",
        "worker: {autoscaling: {kind: magic}}",
        "server: {replicas: 0}",
        "networkPolicy: {database: {cidr: everywhere, port: 5432}}",
        "ingress: {enabled: true}",
    ],
)
def test_values_that_would_not_work_are_refused(wrong, tmp_path):
    values = tmp_path / "values.yaml"
    values.write_text(wrong)
    done = helm("template", "trueup", CHART, "-f", values, check=False)
    assert done.returncode != 0
    assert "Error" in done.stderr


def test_every_pod_is_selected_by_what_is_for_it():
    for documents in RELEASES.values():
        labels = {
            d["metadata"]["name"]: d["spec"]["template"]["metadata"]["labels"]
            for d in documents
            if pods(d)
        }
        for d in documents:
            spec = d.get("spec", {})
            selector = spec.get("selector") or spec.get("podSelector")
            if not selector or d["kind"] in CUSTOM:
                continue
            wanted = selector.get("matchLabels", selector)
            if "matchExpressions" in wanted:
                wanted = {e["key"]: e["values"] for e in wanted["matchExpressions"]}
            assert [
                name
                for name, of_pod in labels.items()
                if all(of_pod[k] in (v if isinstance(v, list) else [v]) for k, v in wanted.items())
            ], d["metadata"]["name"]


def test_workers_scale_by_the_jobs_that_wait():
    scaler = of_kind(ALL, "HorizontalPodAutoscaler", "worker")["spec"]
    metric = scaler["metrics"][0]["external"]
    assert metric["metric"] == {
        "name": "trueup_jobs_unfinished",
        "selector": {"matchLabels": {"namespace": "robots"}},
    }
    assert scaler["behavior"]["scaleDown"]["stabilizationWindowSeconds"] == 1800
    assert "replicas" not in of_kind(ALL, "Deployment")["spec"]
    object_ = of_kind(KEDA, "ScaledObject")["spec"]
    # of one server, for each exports the count of the whole registry
    query = 'max(sum by (instance) (trueup_jobs{namespace="robots"}))'
    assert object_["triggers"][0]["metadata"]["query"] == query
    assert query.replace("robots", "…") in (CHART / "values.yaml").read_text()
    assert object_["scaleTargetRef"]["name"] == of_kind(KEDA, "Deployment")["metadata"]["name"]


def test_nobody_connects_to_a_worker_and_it_connects_to_what_it_needs():
    policy = of_kind(MANIFESTS, "NetworkPolicy", "worker")["spec"]
    assert policy["ingress"] == []
    assert [p["port"] for rule in policy["egress"] for p in rule["ports"]] == [
        53,
        53,
        5432,
        443,
        443,
    ]
    server = of_kind(ALL, "NetworkPolicy", "server")["spec"]
    assert server["ingress"][0]["from"] == [{"podSelector": {"matchLabels": {"app": "proxy"}}}]


def test_the_service_knows_the_names_by_which_it_is_asked():
    settings = of_kind(ALL, "ConfigMap", "lab-trueup")["data"]
    assert settings["TRUEUP_ALLOWED_HOSTS"].split(",") == [
        "lab-trueup",
        "lab-trueup.robots",
        "*.svc.cluster.local",
        "r.example.com",
    ]
    assert settings["TRUEUP_PUBLIC_URL"] == "https://r.example.com"
    migration = of_kind(ALL, "Job")["spec"]["template"]["spec"]["containers"][0]
    assert {e["name"]: e["value"] for e in migration["env"]} == settings


def test_large_numbers_are_written_as_settings_take_them():
    documents = rendered(
        "settings: {TRUEUP_INSPECTION_MEMORY_BYTES: 2147483648, TRUEUP_SESSION_S: 1.5}"
    )
    settings = of_kind(documents, "ConfigMap")["data"]
    assert settings["TRUEUP_INSPECTION_MEMORY_BYTES"] == "2147483648"
    assert settings["TRUEUP_SESSION_S"] == "1.5"


def test_a_changed_setting_starts_pods_anew():
    def stamp(documents):
        pod = of_kind(documents, "Deployment")["spec"]["template"]
        return pod["metadata"]["annotations"]["checksum/settings"]

    assert stamp(MANIFESTS) == stamp(rendered())
    assert stamp(MANIFESTS) != stamp(rendered("settings: {TRUEUP_LOG_LEVEL: DEBUG}"))


def test_the_chart_holds_the_alerts_and_the_dashboard_that_there_are():
    alerts = yaml.safe_load((DEPLOY / "prometheus" / "alerts.yaml").read_text())
    assert of_kind(ALL, "PrometheusRule")["spec"] == alerts
    board = of_kind(ALL, "ConfigMap", "dashboard")["data"]["trueup.json"]
    assert json.loads(board) == json.loads((DEPLOY / "grafana" / "trueup.json").read_text())
    monitor = of_kind(ALL, "ServiceMonitor")["spec"]
    service = of_kind(ALL, "Service")
    assert monitor["jobLabel"] == "app.kubernetes.io/name"  # by which the alerts find servers
    assert service["metadata"]["labels"]["app.kubernetes.io/name"] == "trueup"
    assert monitor["endpoints"][0]["port"] == service["spec"]["ports"][0]["name"]
    assert monitor["selector"]["matchLabels"].items() <= service["metadata"]["labels"].items()


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
    contexts = [pod["securityContext"] for document in MANIFESTS for pod in pods(document)]
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
    assert {c["name"]: c["image"] for c in containers()} == {
        name: f"{image}:{__version__}" for name, image in ours.items()
    }
