"""The calls of trueup_client.calls.serving for an event loop.

Made by tools/make_async_client.py.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable

from trueup_client.calls.serving import ServingCalls
from trueup_client.pool import Pooled
from trueup_client.records import Channel, ChannelPosition, Envelope, Serving


class AsyncServingCalls(Pooled):
    """The serving pointer and channels. For an event loop."""

    async def serving(self, plant: str) -> Serving:
        """Returns what serves now."""
        return await self._pool.run(ServingCalls.serving, plant)

    def watch(
        self, plant: str, wait_s: float = 30.0, confirmed: Callable[[], None] = lambda: None
    ) -> AsyncIterator[Serving]:
        """Yields what serves now, then again at each move, without end.

        Each request waits up to `wait_s` [s] at the service. A service that is away is asked again,
        ever less often, and the watch goes on where it was. `confirmed` is called at every answer,
        also where nothing has changed. Raises Problem for a refusal.
        """
        return self._pool.each(ServingCalls.watch, plant, wait_s, confirmed)

    def watch_channel(
        self,
        plant: str,
        channel: str,
        wait_s: float = 30.0,
        confirmed: Callable[[], None] = lambda: None,
    ) -> AsyncIterator[ChannelPosition]:
        """Yields what a channel serves now, then again at each move, without end.

        The channel must have served something. The arguments are those of `watch`.
        """
        return self._pool.each(ServingCalls.watch_channel, plant, channel, wait_s, confirmed)

    def history(self, plant: str) -> AsyncIterator[Serving]:
        """Yields every position of the pointer, in order."""
        return self._pool.each(ServingCalls.history, plant)

    async def served_at(self, plant: str, at: str) -> Serving | None:
        """Returns what served at a time in UTC, ISO 8601, ending in Z; None before the first."""
        return await self._pool.run(ServingCalls.served_at, plant, at)

    async def promote(
        self, plant: str, decision: str, expected_generation: int, key: str | None = None
    ) -> Serving:
        """Serves the candidate of an accepted decision, if the pointer has not moved since.

        Repeated under the same `key`, it is done once.
        """
        return await self._pool.run(ServingCalls.promote, plant, decision, expected_generation, key)

    async def roll_back(
        self,
        plant: str,
        expected_generation: int,
        key: str | None = None,
        to_generation: int | None = None,
    ) -> Serving:
        """Serves what served before, or at an older generation, after its switchback test.

        Where the test fails, the Problem's fact `next` names the next older artifact that passes
        it. Repeated under the same `key`, it is done once.
        """
        return await self._pool.run(
            ServingCalls.roll_back, plant, expected_generation, key, to_generation
        )

    async def serving_envelope(self, plant: str) -> Envelope:
        """Returns what serves in a signed envelope, which `Robot` verifies."""
        return await self._pool.run(ServingCalls.serving_envelope, plant)

    async def declare_channel(self, plant: str, name: str, requires: list[str]) -> Channel:
        """Declares a channel of serving that requires passed evidence of these stages."""
        return await self._pool.run(ServingCalls.declare_channel, plant, name, requires)

    def channels(self, plant: str) -> AsyncIterator[Channel]:
        """Yields the channels of a plant."""
        return self._pool.each(ServingCalls.channels, plant)

    async def channel_serving(self, plant: str, channel: str) -> ChannelPosition:
        """Returns what a channel serves now."""
        return await self._pool.run(ServingCalls.channel_serving, plant, channel)

    async def move_channel(
        self, plant: str, channel: str, artifact: str, expected_generation: int
    ) -> ChannelPosition:
        """Serves an artifact on a channel, if the channel has not moved since.

        A channel's first move expects generation 0.
        """
        return await self._pool.run(
            ServingCalls.move_channel, plant, channel, artifact, expected_generation
        )
