"""Calls on what watches a plant: update policies, live telemetry, monitors and alarms."""

from __future__ import annotations

from collections.abc import Iterator

from trueup_client.records import Alarm, Document, Episode, Monitor, MonitorState, Policy, Watch
from trueup_client.transport import Transport, url_path


class MonitoringCalls(Transport):
    """Policies, telemetry, monitors and alarms."""

    def declare_policy(self, plant: str, document: Document) -> Policy:
        """Declares what may happen without a person. It holds from then on."""
        return self._post(url_path("plants", plant, "policies"), document)

    def policy(self, plant: str) -> Policy:
        """Returns the update policy that holds."""
        return self._get(url_path("plants", plant, "policy"))

    def send_telemetry(self, plant: str, batch: Document) -> Episode:
        """Sends a live batch, which becomes an episode that is watched.

        Fields: `start_ns` as text, `t_s`, `observations` and `commands` by channel.
        """
        return self._post(url_path("plants", plant, "telemetry"), batch)

    def monitor(self, plant: str) -> MonitorState:
        """Returns whether the model that serves is watched, and the alarm that is open."""
        return self._get(url_path("plants", plant, "monitor"))

    def monitors(self, plant: str) -> Iterator[Monitor]:
        """Yields every monitor there was with its calibration, the newest first."""
        return self._pages(url_path("plants", plant, "monitors"), "before")

    def watches(self, plant: str, monitor: str) -> Iterator[Watch]:
        """Yields what a monitor saw, episode by episode."""
        return self._pages(url_path("plants", plant, "monitors", monitor, "watches"), "after")

    def alarms(self, plant: str) -> Iterator[Alarm]:
        """Yields every alarm, the newest first."""
        return self._pages(url_path("plants", plant, "alarms"), "before")

    def alarm(self, plant: str, alarm: str) -> Alarm:
        """Returns an alarm."""
        return self._get(url_path("plants", plant, "alarms", alarm))

    def close_alarm(self, plant: str, alarm: str, because: str) -> Alarm:
        """Closes an alarm with a reason. The next one may then be raised."""
        return self._post(url_path("plants", plant, "alarms", alarm, "close"), {"because": because})
