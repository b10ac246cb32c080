"""Calls on what serves: a plant's pointer, and its channels."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from trueup_client.records import Channel, ChannelPosition, Envelope, Serving
from trueup_client.transport import Transport, url_path


class ServingCalls(Transport):
    """The serving pointer and channels."""

    def serving(self, plant: str) -> Serving:
        """Returns what serves now."""
        return Serving(**self._get(url_path("plants", plant, "serving")))

    def watch(
        self, plant: str, wait_s: float = 30.0, confirmed: Callable[[], None] = lambda: None
    ) -> Iterator[Serving]:
        """Yields what serves now, then again at each move, without end.

        Each request waits up to `wait_s` [s] at the service. A service that is away is asked again,
        ever less often, and the watch goes on where it was. `confirmed` is called at every answer,
        also where nothing has changed. Raises Problem for a refusal.
        """
        positions = self._changes(url_path("plants", plant, "serving"), wait_s, confirmed)
        return (Serving(**position) for position in positions)

    def watch_channel(
        self,
        plant: str,
        channel: str,
        wait_s: float = 30.0,
        confirmed: Callable[[], None] = lambda: None,
    ) -> Iterator[ChannelPosition]:
        """Yields what a channel serves now, then again at each move, without end.

        The channel must have served something. The arguments are those of `watch`.
        """
        return self._changes(
            url_path("plants", plant, "channels", channel, "serving"), wait_s, confirmed
        )

    def history(self, plant: str) -> Iterator[Serving]:
        """Yields every position of the pointer, in order."""
        positions = self._pages(url_path("plants", plant, "serving", "history"), "after")
        return (Serving(**position) for position in positions)

    def served_at(self, plant: str, at: str) -> Serving | None:
        """Returns what served at a time in UTC, ISO 8601, ending in Z; None before the first."""
        positions = self._get(url_path("plants", plant, "serving", "history", at=at))["items"]
        return Serving(**positions[0]) if positions else None

    def promote(
        self, plant: str, decision: str, expected_generation: int, key: str | None = None
    ) -> Serving:
        """Serves the candidate of an accepted decision, if the pointer has not moved since.

        Repeated under the same `key`, it is done once.
        """
        body = {"decision": decision, "expected_generation": expected_generation}
        return Serving(**self._post(url_path("plants", plant, "serving", "promote"), body, key))

    def roll_back(
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
        body = {"expected_generation": expected_generation}
        if to_generation is not None:
            body["to_generation"] = to_generation
        return Serving(**self._post(url_path("plants", plant, "serving", "rollback"), body, key))

    def serving_envelope(self, plant: str) -> Envelope:
        """Returns what serves in a signed envelope, which `Robot` verifies."""
        return self._get(url_path("plants", plant, "serving", "envelope"))

    def declare_channel(self, plant: str, name: str, requires: list[str]) -> Channel:
        """Declares a channel of serving that requires passed evidence of these stages."""
        return self._post(
            url_path("plants", plant, "channels"), {"name": name, "requires": requires}
        )

    def channels(self, plant: str) -> Iterator[Channel]:
        """Yields the channels of a plant."""
        return self._pages(url_path("plants", plant, "channels"), "after")

    def channel_serving(self, plant: str, channel: str) -> ChannelPosition:
        """Returns what a channel serves now."""
        return self._get(url_path("plants", plant, "channels", channel, "serving"))

    def move_channel(
        self, plant: str, channel: str, artifact: str, expected_generation: int
    ) -> ChannelPosition:
        """Serves an artifact on a channel, if the channel has not moved since.

        A channel's first move expects generation 0.
        """
        body = {"artifact": artifact, "expected_generation": expected_generation}
        return self._post(url_path("plants", plant, "channels", channel, "move"), body)
