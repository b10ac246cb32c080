"""Metrics of the registry, read when somebody asks for them: by Prometheus, and over OTLP."""

from __future__ import annotations

import logging
import math
import shutil
import time
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime

from prometheus_client.core import GaugeMetricFamily, Metric
from sqlalchemy.exc import SQLAlchemyError

from trueup_service import open_telemetry
from trueup_service.registry.gauges import Gauge, gauges
from trueup_service.registry.transaction import reading
from trueup_service.wiring import Parts

RECENT_S = 0.5  # metrics are exported every few seconds at most
log = logging.getLogger("trueup.http")


class RegistryMetrics:
    """A Prometheus collector of the registry's gauges, the room for uploads, and whether the
    database answers. Where it does not, the registry's gauges are left out."""

    def __init__(self, parts: Parts) -> None:
        self._parts = parts

    def collect(self) -> Iterable[Metric]:
        """The metrics as they are now."""
        for gauge in read_gauges(self._parts):
            family = GaugeMetricFamily(
                gauge.name, gauge.meaning, labels=[gauge.label] if gauge.label else []
            )
            for value, number in gauge.values.items():
                family.add_metric([value] if gauge.label else [], number)
            yield family


def read_gauges(parts: Parts) -> list[Gauge]:
    """The gauges as they are now."""
    read: list[Gauge] = []
    try:
        with reading(parts.database) as tx:
            read = gauges(tx, datetime.now(UTC))
    except SQLAlchemyError:
        log.exception("the registry's metrics could not be read")
    free = float(shutil.disk_usage(parts.spool).free)
    up = {"": float(bool(read))}
    return [
        *read,
        Gauge("trueup_database_up", "Whether the database answers", "", up),
        Gauge("trueup_spool_free_bytes", "Room for uploads on disk [bytes]", "", {"": free}),
    ]


class _RecentGauges:
    """The gauges, read once for all that are exported together."""

    def __init__(self, parts: Parts) -> None:
        self._parts = parts
        self._read: list[Gauge] = []
        self._at = -math.inf

    def read(self) -> list[Gauge]:
        """The gauges, RECENT_S old at most."""
        if time.monotonic() - self._at > RECENT_S:
            self._read, self._at = read_gauges(self._parts), time.monotonic()
        return self._read


def export_gauges(parts: Parts) -> None:
    """Export the gauges over OTLP, where anything is."""
    if not open_telemetry.is_on():
        return
    recent = _RecentGauges(parts)
    for gauge in recent.read():

        def read(name: str = gauge.name) -> Sequence[open_telemetry.Gauge]:
            return [
                ({one.label: value} if one.label else {}, number)
                for one in recent.read()
                if one.name == name
                for value, number in one.values.items()
            ]

        open_telemetry.gauge(gauge.name.replace("trueup_", "trueup.", 1), gauge.meaning, read)
