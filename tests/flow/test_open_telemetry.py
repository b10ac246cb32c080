"""Traces and metrics over OTLP: from a request to the stages of its job, and only where an endpoint
is named."""

import json
import os
import re
import subprocess
import sys
import time
import urllib.request
from itertools import pairwise

import pytest
from opentelemetry.proto.collector.metrics.v1.metrics_service_pb2 import ExportMetricsServiceRequest
from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest

from tests.support.made import episode_bytes, plant_document, save
from tests.support.receiver import receiving
from tests.support.service import ADMIN, Service
from tests.support.storage import Storage, embedded
from trueup.episode.role import Role
from trueup_client import Client

TRACE, CALLER = "0af7651916cd43dd8448eb211c80319c", "b7ad6b7169203331"


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """The requests of a receiver of OTLP, and the client of a service that exports to it."""
    folder = tmp_path_factory.mktemp("data")
    with receiving() as receiver:
        environment = {
            **embedded(folder).environment,
            "OTEL_EXPORTER_OTLP_ENDPOINT": receiver.url.removesuffix("/events"),
            "OTEL_BSP_SCHEDULE_DELAY": "100",
            "OTEL_METRIC_EXPORT_INTERVAL": "500",
            "OTEL_RESOURCE_ATTRIBUTES": "deployment.environment=tests",
        }
        service = Service(Storage("exporting", environment))
        with service.running(), Client(service.url) as client:
            yield receiver, client, service


def spans(receiver):
    """The spans that have arrived, with the name of their service."""
    return [
        (attributes(resource.resource)["service.name"], span)
        for request in list(receiver.requests)
        if request.path == "/v1/traces"
        for resource in ExportTraceServiceRequest.FromString(request.body).resource_spans
        for scope in resource.scope_spans
        for span in scope.spans
    ]


def attributes(of):
    return {
        a.key: a.value.string_value or a.value.int_value or a.value.double_value
        for a in of.attributes
    }


def until(condition):
    end = time.monotonic() + 30
    while not (value := condition()):
        assert time.monotonic() < end
        time.sleep(0.1)
    return value


def test_a_trace_goes_from_a_callers_request_to_the_stages_of_its_diagnosis(exported, tmp_path):
    receiver, client, service = exported
    client.register_plant(plant_document("traced"))
    for seed, role in ((0, Role.ADAPTATION), (1, Role.VALIDATION)):
        client.upload_episode("traced", save(tmp_path, f"{seed}", episode_bytes(seed, role=role)))
    request = urllib.request.Request(
        f"{service.url}/v1/plants/traced/jobs",
        json.dumps({"kind": "diagnose"}).encode(),
        {
            "Authorization": f"Bearer {ADMIN}",
            "Content-Type": "application/json",
            "traceparent": f"00-{TRACE}-{CALLER}-01",
        },
    )
    with urllib.request.urlopen(request) as answer:
        job = json.load(answer)["id"]
    assert client.wait(job)["state"] == "succeeded"

    def of_trace():
        return [(s, span) for s, span in spans(receiver) if span.trace_id.hex() == TRACE]

    # each of the three processes exports its own spans, when it is ready
    ends = {"POST /v1/plants/{plant}/jobs", "job diagnose", "compute", "finish"}
    until(lambda: ends <= {span.name for _, span in of_trace()})
    by_name = {span.name: (name, span) for name, span in of_trace()}
    server, request_span = by_name["POST /v1/plants/{plant}/jobs"]
    worker, job_span = by_name["job diagnose"]
    _, compute = by_name["compute"]
    assert (server, worker) == ("trueup-server", "trueup-worker")
    assert request_span.parent_span_id.hex() == CALLER
    assert job_span.parent_span_id == request_span.span_id
    assert compute.parent_span_id == job_span.span_id
    assert attributes(request_span)["http.response.status_code"] == 201
    assert attributes(job_span)["trueup.job"] == job
    assert attributes(job_span)["trueup.job.state"] == "succeeded"
    assert attributes(job_span)["trueup.plant"] == "traced"
    stages = sorted(
        (s for _, s in of_trace() if s.parent_span_id == compute.span_id),
        key=lambda s: s.start_time_unix_nano,
    )
    assert stages[0].name == "reading episodes"
    assert len(stages) > 3
    for before, after in pairwise(stages):
        assert before.end_time_unix_nano <= after.start_time_unix_nano
    assert "finish" in by_name
    # who only reads begins no trace
    assert not [s for _, s in spans(receiver) if s.name.startswith("GET")]


def test_metrics_are_exported_under_the_names_of_the_conventions(exported):
    receiver, client, _ = exported
    client.whoami()

    def metrics():
        return {
            metric.name: metric
            for request in list(receiver.requests)
            if request.path == "/v1/metrics"
            for resource in ExportMetricsServiceRequest.FromString(request.body).resource_metrics
            for scope in resource.scope_metrics
            for metric in scope.metrics
        }

    until(
        lambda: (
            {"http.server.request.duration", "trueup.job.duration", "trueup.jobs"} <= set(metrics())
        )
    )
    assert metrics()["http.server.request.duration"].unit == "s"
    states = {attributes(p)["state"] for p in metrics()["trueup.jobs"].gauge.data_points}
    assert states == {"queued", "running", "cancelling"}


def test_lines_of_the_log_carry_the_trace(tmp_path):
    with receiving() as receiver:
        script = (
            "import logging\n"
            "from trueup_service import open_telemetry\n"
            "from trueup_service.logs import configure_logs\n"
            "configure_logs('INFO')\n"
            "logging.info('before')\n"
            "open_telemetry.start('t')\n"
            f"with open_telemetry.span('s', '00-{TRACE}-{CALLER}-01'):\n"
            "    logging.info('inside')\n"
            "logging.info('after')\n"
            "open_telemetry.flush()\n"
        )
        environment = {
            **os.environ,
            "OTEL_EXPORTER_OTLP_ENDPOINT": receiver.url.removesuffix("/events"),
        }
        done = subprocess.run(
            [sys.executable, "-c", script],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
    before, inside, after = map(json.loads, done.stderr.splitlines())
    assert inside["trace_id"] == TRACE
    assert re.fullmatch("[0-9a-f]{16}", inside["span_id"])
    assert "trace_id" not in before | after


def test_without_an_endpoint_nothing_is_loaded():
    script = (
        "import sys\n"
        "from trueup_service import open_telemetry\n"
        "open_telemetry.start('t')\n"
        "with open_telemetry.span('s', None): pass\n"
        "open_telemetry.observe('n', 'd', 1.0, {})\n"
        "assert not open_telemetry.is_on() and open_telemetry.traceparent() is None\n"
        "assert open_telemetry.ids() == {}\n"
        "print([m for m in sys.modules if m.startswith('opentelemetry')])\n"
    )
    environment = {k: v for k, v in os.environ.items() if not k.startswith("OTEL_")}
    for extra in ({}, {"OTEL_EXPORTER_OTLP_ENDPOINT": "http://x", "OTEL_SDK_DISABLED": "true"}):
        done = subprocess.run(
            [sys.executable, "-c", script],
            env=environment | extra,
            capture_output=True,
            text=True,
            check=True,
        )
        assert done.stdout.strip() == "[]"


def test_an_endpoint_without_the_sdk_is_told():
    script = (
        "import sys\n"
        "sys.modules['opentelemetry.sdk.trace'] = None\n"
        "from trueup.errors import NotInstalled\n"
        "from trueup_service import open_telemetry\n"
        "try: open_telemetry.start('t')\n"
        "except NotInstalled as error: print(error.hint)\n"
    )
    environment = {**os.environ, "OTEL_EXPORTER_OTLP_ENDPOINT": "http://127.0.0.1:9"}
    done = subprocess.run(
        [sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True
    )
    assert "trueup-service[otlp]" in done.stdout


def test_a_collector_that_is_away_delays_nothing(tmp_path):
    environment = {
        **embedded(tmp_path / "data").environment,
        "OTEL_EXPORTER_OTLP_ENDPOINT": "http://127.0.0.1:9",
        "OTEL_BSP_SCHEDULE_DELAY": "100",
    }
    with Service(Storage("away", environment)).running() as service, Client(service.url) as client:
        client.register_plant(plant_document("p"))
        for seed, role in ((0, Role.ADAPTATION), (1, Role.VALIDATION)):
            client.upload_episode("p", save(tmp_path, f"{seed}", episode_bytes(seed, role=role)))
        job = client.submit("p", {"kind": "fit", "method": "identify"})
        assert client.wait(job["id"])["state"] == "succeeded"
