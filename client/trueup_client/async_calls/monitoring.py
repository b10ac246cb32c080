"""The calls of trueup_client.calls.monitoring for an event loop.

Made by tools/make_async_client.py.
"""

from __future__ import annotations

from collections.abc import AsyncIterator

from trueup_client.calls.monitoring import MonitoringCalls
from trueup_client.pool import Pooled
from trueup_client.records import Alarm, Document, Episode, Monitor, MonitorState, Policy, Watch


class AsyncMonitoringCalls(Pooled):
    """Policies, telemetry, monitors and alarms. For an event loop."""

    async def declare_policy(self, plant: str, document: Document) -> Policy:
        """Declares what may happen without a person. It holds from then on."""
        return await self._pool.run(MonitoringCalls.declare_policy, plant, document)

    async def policy(self, plant: str) -> Policy:
        """Returns the update policy that holds."""
        return await self._pool.run(MonitoringCalls.policy, plant)

    async def send_telemetry(self, plant: str, batch: Document) -> Episode:
        """Sends a live batch, which becomes an episode that is watched.

        Fields: `start_ns` as text, `t_s`, `observations` and `commands` by channel.
        """
        return await self._pool.run(MonitoringCalls.send_telemetry, plant, batch)

    async def monitor(self, plant: str) -> MonitorState:
        """Returns whether the model that serves is watched, and the alarm that is open."""
        return await self._pool.run(MonitoringCalls.monitor, plant)

    def monitors(self, plant: str) -> AsyncIterator[Monitor]:
        """Yields every monitor there was with its calibration, the newest first."""
        return self._pool.each(MonitoringCalls.monitors, plant)

    def watches(self, plant: str, monitor: str) -> AsyncIterator[Watch]:
        """Yields what a monitor saw, episode by episode."""
        return self._pool.each(MonitoringCalls.watches, plant, monitor)

    def alarms(self, plant: str) -> AsyncIterator[Alarm]:
        """Yields every alarm, the newest first."""
        return self._pool.each(MonitoringCalls.alarms, plant)

    async def alarm(self, plant: str, alarm: str) -> Alarm:
        """Returns an alarm."""
        return await self._pool.run(MonitoringCalls.alarm, plant, alarm)

    async def close_alarm(self, plant: str, alarm: str, because: str) -> Alarm:
        """Closes an alarm with a reason. The next one may then be raised."""
        return await self._pool.run(MonitoringCalls.close_alarm, plant, alarm, because)
