"""What an operator watches: the metrics, and that dashboard and alerts ask for those that there
are."""

import json
import re
import urllib.request
from itertools import combinations

import promql_parser
import pytest
import yaml
from prometheus_client.parser import text_string_to_metric_families

from tests.support.made import episode_bytes, plant_document, save
from tests.support.receiver import receiving
from tests.support.service import ADMIN, ROOT, Service
from tests.support.storage import requested
from trueup_client import Client, Problem

DASHBOARD = json.loads((ROOT / "deploy" / "grafana" / "trueup.json").read_text())
ALERTS = yaml.safe_load((ROOT / "deploy" / "prometheus" / "alerts.yaml").read_text())
RULES = [rule for group in ALERTS["groups"] for rule in group["rules"]]
PANELS = [panel for panel in DASHBOARD["panels"] if panel["type"] != "row"]
EXPRESSIONS = [t["expr"] for panel in PANELS for t in panel["targets"]] + [
    rule["expr"] for rule in RULES
]
OF_SCRAPE = {"job", "instance", "le"}  # labels that whoever scrapes adds, and those of buckets
OF_PROMETHEUS = {"up"}


@pytest.fixture(scope="module", params=["embedded", "scaled"])
def service(request, tmp_path_factory):
    storage = requested(request, tmp_path_factory.mktemp("service"))
    settings = {"webhook_hosts": "127.0.0.1", "webhook_private_ranges": "127.0.0.0/8"}
    with Service(storage, **settings).running() as running:
        yield running


def scraped(service):
    """Samples by name: labels and value."""
    request = urllib.request.Request(
        f"{service.url}/metrics", headers={"Authorization": f"Bearer {ADMIN}"}
    )
    samples = {}
    with urllib.request.urlopen(request) as answer:
        for family in text_string_to_metric_families(answer.read().decode()):
            for sample in family.samples:
                samples.setdefault(sample.name, []).append((sample.labels, sample.value))
    return samples


def value(service, name, **labels):
    return next(v for k, v in scraped(service)[name] if k == labels)


def selectors(expression):
    """The metrics that an expression reads, with the labels that it names of each."""
    here = [expression] if isinstance(expression, promql_parser.VectorSelector) else []
    inner = [
        part
        for name in ("expr", "lhs", "rhs", "vector_selector", "args")
        for part in _listed(getattr(expression, name, None))
    ]
    return here + [selector for part in inner for selector in selectors(part)]


def _listed(value):
    return value if isinstance(value, list) else [] if value is None else [value]


def grouped_by(expression):
    """The labels that results keep."""
    return {
        label.strip()
        for labels in re.findall(r"by \(([^)]*)\)", expression)
        for label in labels.split(",")
    }


def parsed(expression):
    return promql_parser.parse(expression.replace("$__rate_interval", "5m"))


def test_dashboard_and_alerts_ask_for_metrics_and_labels_that_there_are(service, client, tmp_path):
    client.register_plant(plant_document("watched"))
    with pytest.raises(Problem):
        client.plant("nobody")
    with receiving() as receiver:
        client.declare_webhook("hook", receiver.url, ["episode"])
        samples = scraped(service)
        client.remove_webhook("hook")
    labels = {name: {key for named, _ in of for key in named} for name, of in samples.items()}
    for expression in EXPRESSIONS:
        read = selectors(parsed(expression))
        assert read
        for selector in read:
            if selector.name in OF_PROMETHEUS:
                continue
            assert selector.name in samples, expression
            named = {m.name for m in selector.matchers.matchers} | grouped_by(expression)
            assert named - OF_SCRAPE <= labels[selector.name], expression


def test_routes_that_the_dashboard_names_are_routes(service):
    routes = set(re.findall(r'route="([^"]+)"', " ".join(EXPRESSIONS)))
    with urllib.request.urlopen(
        urllib.request.Request(
            f"{service.url}/openapi.json", headers={"Authorization": f"Bearer {ADMIN}"}
        )
    ) as answer:
        assert routes <= set(json.load(answer)["paths"])


def test_the_dashboard_is_drawn_without_overlap_by_any_prometheus():
    ids = [panel["id"] for panel in DASHBOARD["panels"]]
    assert len(ids) == len(set(ids))
    for a, b in combinations([p["gridPos"] for p in DASHBOARD["panels"]], 2):
        assert (
            a["x"] + a["w"] <= b["x"]
            or b["x"] + b["w"] <= a["x"]
            or a["y"] + a["h"] <= b["y"]
            or b["y"] + b["h"] <= a["y"]
        )
    assert all(p["gridPos"]["x"] + p["gridPos"]["w"] <= 24 for p in DASHBOARD["panels"])
    assert {p["datasource"]["uid"] for p in PANELS} == {"${datasource}"}
    assert {v["name"] for v in DASHBOARD["templating"]["list"]} == {"datasource", "job"}


def test_every_alert_says_what_it_means_and_what_to_do():
    for rule in RULES:
        assert set(rule) <= {"alert", "expr", "for", "labels", "annotations"}
        assert rule["labels"]["severity"] in {"critical", "warning", "info"}
        texts = [rule["annotations"][part] for part in ("summary", "description")]
        assert min(map(len, texts)) > 20
    assert len({rule["alert"] for rule in RULES}) == len(RULES)


def test_the_gauges_are_what_happened(storage, tmp_path):
    settings = {"webhook_hosts": "127.0.0.1", "webhook_private_ranges": "127.0.0.0/8"}
    service = Service(storage, **settings)
    with (
        service.running(worker=False),
        Client(service.url) as client,
        receiving() as receiver,
    ):
        client.register_plant(plant_document("p"))
        client.upload_episode("p", save(tmp_path, "a.mcap", episode_bytes()))
        client.declare_webhook("hook", receiver.url, ["episode"])
        assert value(service, "trueup_database_up") == 1
        assert value(service, "trueup_spool_free_bytes") > 1e6
        entries = value(service, "trueup_log_entries")
        assert entries == len(list(client.audit()))
        assert value(service, "trueup_jobs", state="queued") == 0
        client.submit("p", {"kind": "fit", "method": "identify"})
        assert value(service, "trueup_jobs", state="queued") == 1
        assert 0 <= value(service, "trueup_job_waiting_seconds") < 60
        assert value(service, "trueup_webhook_behind_entries", webhook="hook") == 2
        assert value(service, "trueup_webhook_failing", webhook="hook") == 0
        assert value(service, "trueup_alarms_open") == 0
        assert value(service, "trueup_jobs_failed_last_hour") == 0
