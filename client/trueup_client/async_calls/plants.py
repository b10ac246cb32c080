"""The calls of trueup_client.calls.plants for an event loop.

Made by tools/make_async_client.py.
"""

from __future__ import annotations

import os
from collections.abc import AsyncIterator, Mapping

from trueup_client.calls.plants import PlantCalls
from trueup_client.files import Progress, no_progress
from trueup_client.pool import Pooled
from trueup_client.records import Document, Episode, EpisodeContext, Plant


class AsyncPlantCalls(Pooled):
    """Plants and episodes. For an event loop."""

    async def register_plant(self, document: Document, project: str | None = None) -> Plant:
        """Registers a plant by the content of its plant.json.

        Registering it again changes nothing.
        """
        return await self._pool.run(PlantCalls.register_plant, document, project)

    async def plant(self, name: str) -> Plant:
        """Returns a plant."""
        return await self._pool.run(PlantCalls.plant, name)

    def plants(self) -> AsyncIterator[Plant]:
        """Yields every plant that this client may see."""
        return self._pool.each(PlantCalls.plants)

    async def upload_episode(
        self,
        plant: str,
        path: str | os.PathLike[str],
        progress: Progress = no_progress,
        *,
        role: str | None = None,
        conditions: Mapping[str, str] | None = None,
        mapping: Document | None = None,
        part: str | None = None,
    ) -> Episode:
        """Uploads a recording, streamed, with its digest; the same file again is the same episode.

        An MCAP file may declare its role itself. Of a file of another format (CSV, Parquet, HDF5,
        npz, a ROS bag, a zip of a LeRobot dataset) say the `role`, the `conditions` and, where
        names do not tell it, by a `mapping` which signals are meant; `part` names one of several
        runs in it. A file of more than 32 MiB goes in parts. Where the connection breaks, the
        upload resumes behind the bytes that arrived, in this call or the next.
        """
        return await self._pool.run(
            PlantCalls.upload_episode,
            plant,
            path,
            progress,
            role=role,
            conditions=conditions,
            mapping=mapping,
            part=part,
        )

    def episodes(self, plant: str, role: str | None = None) -> AsyncIterator[Episode]:
        """Yields the episodes of a plant, or those of one role."""
        return self._pool.each(PlantCalls.episodes, plant, role)

    async def episode(self, plant: str, digest: str) -> EpisodeContext:
        """Returns an episode, with what was serving while it was recorded."""
        return await self._pool.run(PlantCalls.episode, plant, digest)

    async def download_episode(self, plant: str, digest: str, path: str | os.PathLike[str]) -> None:
        """Saves an episode's bytes. Raises DigestMismatch if they are not what the digest names."""
        return await self._pool.run(PlantCalls.download_episode, plant, digest, path)

    def episode_parts(self, plant: str, digest: str) -> AsyncIterator[bytes]:
        """Yields an episode's bytes in parts, not verified."""
        return self._pool.each(PlantCalls.episode_parts, plant, digest)
