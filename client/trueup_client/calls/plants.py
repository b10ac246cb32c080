"""Calls on plants, and on the episodes that were recorded of them."""

from __future__ import annotations

import base64
import hashlib
import json
import os
import time
import uuid
from collections.abc import Iterator, Mapping
from pathlib import Path
from urllib.parse import urlencode

from trueup_client.files import Progress, ReadProgress, digest_of, no_progress
from trueup_client.problem import Problem, Unreachable
from trueup_client.records import Document, Episode, EpisodeContext, Plant
from trueup_client.transport import Transport, url_path

RESUMABLE_FROM_BYTES = 32 << 20  # a longer upload goes in parts, and is resumed where it broke off
MEDIA_TYPES = {
    ".mcap": "application/mcap",
    ".csv": "text/csv",
    ".tsv": "text/tab-separated-values",
    ".parquet": "application/vnd.apache.parquet",
    ".h5": "application/x-hdf5",
    ".hdf5": "application/x-hdf5",
    ".npz": "application/x-npz",
    ".db3": "application/vnd.sqlite3",
    ".bag": "application/x-rosbag",
    ".zip": "application/zip",
}
PART_ATTEMPTS = 5  # in a row, none of which brings a byte further
PART_RETRY_S = 0.2


class PlantCalls(Transport):
    """Plants and episodes."""

    def register_plant(self, document: Document, project: str | None = None) -> Plant:
        """Registers a plant by the content of its plant.json.

        Registering it again changes nothing.
        """
        return self._post(url_path("plants", project=project or None), document)

    def plant(self, name: str) -> Plant:
        """Returns a plant."""
        return self._get(url_path("plants", name))

    def plants(self) -> Iterator[Plant]:
        """Yields every plant that this client may see."""
        return self._pages(url_path("plants"), "after")

    def upload_episode(
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
        digest, file = digest_of(path), Path(path)
        asked = {
            "role": role,
            "conditions": None if conditions is None else json.dumps(dict(conditions)),
            "mapping": None if mapping is None else json.dumps(mapping),
            "part": part,
        }
        said = {name: value for name, value in asked.items() if value is not None}
        said["name"] = file.name
        media_type = MEDIA_TYPES.get(file.suffix.lower(), "application/octet-stream")
        if os.path.getsize(path) > RESUMABLE_FROM_BYTES:
            upload = url_path("plants", plant, "uploads", digest)
            return self._upload_in_parts(upload, file, progress, said, media_type)
        sha256 = base64.b64encode(bytes.fromhex(digest)).decode()
        key = hashlib.sha256(json.dumps([digest, said], sort_keys=True).encode()).hexdigest()
        headers = {
            "Content-Digest": f"sha-256=:{sha256}:",
            "Content-Length": str(os.path.getsize(path)),
            "Content-Type": media_type,
            "Idempotency-Key": key,
        }
        return json.loads(
            self._connection.whole(
                "POST",
                url_path("plants", plant, "episodes", **said),
                lambda: ReadProgress(path, progress),
                headers,
            )
        )

    def _upload_in_parts(
        self,
        upload: str,
        file: Path,
        progress: Progress,
        said: Mapping[str, str] = {},
        media_type: str = "application/octet-stream",
    ) -> Episode:
        """Sends what is missing of a file to an upload's path, then finishes the upload with what
        is said of it.

        Raises Unreachable once PART_ATTEMPTS in a row brought nothing further.
        """
        size, failures = file.stat().st_size, 0
        while (offset := self._get(upload)["offset_bytes"]) < size:
            headers = {
                "Upload-Offset": str(offset),
                "Content-Length": str(size - offset),
                "Content-Type": "application/octet-stream",
            }
            try:
                self._connection.once(
                    "PATCH", upload, ReadProgress(file, progress, offset), headers
                )
            except (Unreachable, Problem) as error:
                if isinstance(error, Problem) and error.code != "upload-offset":
                    raise
                advanced = self._get(upload)["offset_bytes"] > offset
                failures = 0 if advanced else failures + 1
                if failures == PART_ATTEMPTS:
                    raise
                time.sleep(PART_RETRY_S * failures)
        progress(1.0)
        query = f"?{urlencode(said)}" if said else ""
        headers = {"Content-Type": media_type, "Idempotency-Key": uuid.uuid4().hex}
        answer = self._connection.whole("POST", f"{upload}/finish{query}", lambda: b"", headers)
        return json.loads(answer)

    def episodes(self, plant: str, role: str | None = None) -> Iterator[Episode]:
        """Yields the episodes of a plant, or those of one role."""
        return self._pages(url_path("plants", plant, "episodes"), "after", role=role or None)

    def episode(self, plant: str, digest: str) -> EpisodeContext:
        """Returns an episode, with what was serving while it was recorded."""
        return self._get(url_path("plants", plant, "episodes", digest))

    def download_episode(self, plant: str, digest: str, path: str | os.PathLike[str]) -> None:
        """Saves an episode's bytes. Raises DigestMismatch if they are not what the digest names."""
        self._save(url_path("plants", plant, "episodes", digest, "content"), digest, Path(path))

    def episode_parts(self, plant: str, digest: str) -> Iterator[bytes]:
        """Yields an episode's bytes in parts, not verified."""
        return self._connection.parts(url_path("plants", plant, "episodes", digest, "content"))
