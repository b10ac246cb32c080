"""Traces and metrics over OTLP, by the environment variables of OpenTelemetry. Nothing is loaded or
recorded unless one of them names an endpoint.

A trace goes from a request to the jobs that it submits, and in a job from stage to stage: whoever
queues a job passes the trace on in the W3C form `traceparent`.
Source: OpenTelemetry 1.45, "OTLP Exporter Configuration"; its semantic conventions for HTTP; W3C
Trace Context, section 3.2.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from typing import Any

from trueup import __version__
from trueup.errors import NotInstalled

ENDPOINTS = (
    "OTEL_EXPORTER_OTLP_ENDPOINT",
    "OTEL_EXPORTER_OTLP_TRACES_ENDPOINT",
    "OTEL_EXPORTER_OTLP_METRICS_ENDPOINT",
)
DISABLED, SERVICE_NAME = "OTEL_SDK_DISABLED", "OTEL_SERVICE_NAME"
HEADER = "traceparent"
SCOPE = "trueup"
FLUSH_S = 1.0  # of a process that ends
Gauge = tuple[Mapping[str, str], float]  # of these labels, this value


class _Recording:
    """What is loaded of OpenTelemetry: the tracer, and the histograms by name."""

    def __init__(self, tracer: Any, meter: Any, flush: Callable[[], object]) -> None:
        self.tracer, self.meter, self.flush = tracer, meter, flush
        self.histograms: dict[str, Any] = {}


_recording: _Recording | None = None


def start(service: str) -> None:
    """Record and export from now on, where the environment names an endpoint. `service` is the name
    that the exports carry, unless the environment gives one. Raises NotInstalled."""
    global _recording  # noqa: PLW0603  (of a process, as the SDK's own providers are)
    is_disabled = os.environ.get(DISABLED, "").lower() == "true"
    if _recording is not None or is_disabled or not any(map(os.environ.get, ENDPOINTS)):
        return
    try:
        from opentelemetry.exporter.otlp.proto.http.metric_exporter import (  # noqa: PLC0415
            OTLPMetricExporter,
        )
        from opentelemetry.exporter.otlp.proto.http.trace_exporter import (  # noqa: PLC0415
            OTLPSpanExporter,
        )
        from opentelemetry.sdk.metrics import MeterProvider  # noqa: PLC0415
        from opentelemetry.sdk.metrics.export import PeriodicExportingMetricReader  # noqa: PLC0415
        from opentelemetry.sdk.resources import Resource  # noqa: PLC0415
        from opentelemetry.sdk.trace import TracerProvider  # noqa: PLC0415
        from opentelemetry.sdk.trace.export import BatchSpanProcessor  # noqa: PLC0415
    except ImportError as error:
        raise NotInstalled(
            "traces and metrics over OTLP need the SDK of OpenTelemetry",
            hint="Install it with `pip install 'trueup-service[otlp]'`, or unset the variables "
            "OTEL_EXPORTER_OTLP_….",
        ) from error
    name = {"service.name": os.environ.get(SERVICE_NAME, service), "service.version": __version__}
    resource = Resource.create(name)
    traces = TracerProvider(resource=resource)
    traces.add_span_processor(BatchSpanProcessor(OTLPSpanExporter()))
    metrics = MeterProvider(
        [PeriodicExportingMetricReader(OTLPMetricExporter())], resource=resource
    )
    _recording = _Recording(
        traces.get_tracer(SCOPE, __version__),
        metrics.get_meter(SCOPE, __version__),
        lambda: (traces.force_flush(), metrics.force_flush()),
    )


def environment() -> dict[str, str]:
    """What another process needs to export as this one does."""
    return {name: value for name, value in os.environ.items() if name.startswith("OTEL_")}


def is_on() -> bool:
    """Whether anything is recorded."""
    return _recording is not None


def span(name: str, trace: str | None = None, **attributes: Any) -> AbstractContextManager[Any]:
    """A span for the block: inside the present one, or in the trace that was passed on. An error
    that leaves the block stands in it."""
    return nullcontext() if _recording is None else _span(_recording, name, trace, attributes)


@contextmanager
def _span(
    recording: _Recording, name: str, trace: str | None, attributes: Mapping[str, Any]
) -> Iterator[Any]:
    context = None if trace is None else _propagator().extract({HEADER: trace})
    with recording.tracer.start_as_current_span(
        name, context=context, attributes={k.replace("__", "."): v for k, v in attributes.items()}
    ) as current:
        yield current


def server_span(method: str, trace: str | None) -> AbstractContextManager[Any]:
    """A span of a request, in the caller's trace where it sent one."""
    assert _recording is not None
    from opentelemetry.trace import SpanKind  # noqa: PLC0415

    context = _propagator().extract({HEADER: trace} if trace else {})
    span: AbstractContextManager[Any] = _recording.tracer.start_as_current_span(
        method,
        context=context,
        kind=SpanKind.SERVER,
        attributes={"http.request.method": method},
    )
    return span


class Stages:
    """Spans that follow each other: one begins where the one before ends."""

    def __init__(self) -> None:
        self._open = ExitStack()

    def enter(self, name: str) -> None:
        """End the stage before, and begin this one."""
        self.end()
        self._open.enter_context(span(name))

    def end(self) -> None:
        """End the stage."""
        self._open.close()


def traceparent() -> str | None:
    """The present trace as it is passed on, None where there is none."""
    if _recording is None:
        return None
    carrier: dict[str, str] = {}
    _propagator().inject(carrier)
    return carrier.get(HEADER)


def ids() -> dict[str, str]:
    """The ids of the present trace and span, for a line of the log."""
    if _recording is None:
        return {}
    from opentelemetry.trace import get_current_span  # noqa: PLC0415

    context = get_current_span().get_span_context()
    if not context.is_valid:
        return {}
    return {"trace_id": f"{context.trace_id:032x}", "span_id": f"{context.span_id:016x}"}


def observe(name: str, description: str, seconds: float, labels: Mapping[str, Any]) -> None:
    """Add a duration [s] to the histogram of a name."""
    if _recording is None:
        return
    if name not in _recording.histograms:
        _recording.histograms[name] = _recording.meter.create_histogram(name, "s", description)
    _recording.histograms[name].record(seconds, labels)


def gauge(name: str, description: str, read: Callable[[], Sequence[Gauge]]) -> None:
    """Export what `read` returns, each time that metrics are exported."""
    if _recording is None:
        return
    from opentelemetry.metrics import Observation  # noqa: PLC0415

    _recording.meter.create_observable_gauge(
        name, [lambda _: [Observation(value, labels) for labels, value in read()]], "1", description
    )


def flush() -> None:
    """Export what was recorded so far, before the process ends. It takes FLUSH_S at most, so that a
    collector that is away delays nothing."""
    if _recording is not None:
        exporting = threading.Thread(target=_recording.flush, daemon=True)
        exporting.start()
        exporting.join(FLUSH_S)


def _propagator() -> Any:
    from opentelemetry.trace.propagation.tracecontext import (  # noqa: PLC0415
        TraceContextTextMapPropagator,
    )

    return TraceContextTextMapPropagator()
