"""Records of an MCAP file that define its channels, or describe and count what it holds.

Source: MCAP format specification, https://mcap.dev/spec (2026).
"""

from __future__ import annotations

import zlib
from collections.abc import Collection

from trueup.episode.container import Contents, Limits, Metadata, Op, Schema, Topic
from trueup.episode.fields import Fields
from trueup.errors import MalformedMcap, TooLarge


class RecordReader:
    """Takes records into `contents`, within limits. Of the metadata it keeps the records named in
    `wanted`.

    `at` is the byte of a record in the file, or of the chunk that holds it.
    """

    def __init__(self, contents: Contents, limits: Limits, wanted: Collection[str]) -> None:
        self.contents = contents
        self._limits, self._wanted = limits, wanted
        self._defined = 0

    def read(self, at: int, op: int, body: bytes) -> None:
        """Take in a record of the data section or of a chunk that is no message."""
        if op == Op.SCHEMA:
            self.schema(at, body)
        elif op == Op.CHANNEL:
            self.channel(at, body)
        elif op == Op.METADATA:
            self._metadata(Fields(body, at))
        elif op == Op.ATTACHMENT:
            self._attachment(at, body)
        elif op == Op.MESSAGE_INDEX:
            fields = Fields(body, at)
            fields.uint(2)
            if len(fields.block()) % 16:
                raise MalformedMcap(
                    "a message index is no whole number of entries", rule="index", byte=at
                )

    def _metadata(self, fields: Fields) -> None:
        self.contents.metadata_records += 1
        name = fields.text()
        if name in self._wanted:
            self.contents.metadata.append(Metadata(name, fields.text_map()))
        else:
            fields.block()

    def statistics(self, at: int, fields: Fields) -> None:
        """Raises MalformedMcap unless the statistics agree with what was counted."""
        contents = self.contents
        declared = tuple(fields.uint(width) for width in (8, 2, 4, 4, 4, 4))
        counted = (
            contents.messages,
            declared[1],
            declared[2],
            contents.attachments,
            contents.metadata_records,
            contents.chunks,
        )
        if declared != counted:
            raise MalformedMcap(
                (
                    f"the statistics declare {declared[0]} messages and {declared[5]} chunks, "
                    f"counted were {counted[0]} and {counted[5]}"
                ),
                rule="index",
                byte=at,
            )

    def schema(self, at: int, body: bytes) -> None:
        """Take in a schema. Raises MalformedMcap if it is redefined, TooLarge beyond the
        limits."""
        fields = Fields(body, at)
        schema = Schema(fields.uint(2), fields.text(), fields.text(), bytes(fields.block()))
        if schema.id == 0:
            raise MalformedMcap("a schema has the id 0, which means none", rule="known", byte=at)
        if self.contents.schemas.setdefault(schema.id, schema) != schema:
            raise MalformedMcap(
                f"schema {schema.id} is defined twice, differently", rule="known", byte=at
            )
        self._limit_definitions(len(self.contents.schemas), len(body), at)

    def channel(self, at: int, body: bytes) -> None:
        """Take in a channel. Raises MalformedMcap if it is redefined or its schema is not known,
        TooLarge beyond the limits."""
        fields = Fields(body, at)
        channel, schema = fields.uint(2), fields.uint(2)
        if schema and schema not in self.contents.schemas:
            raise MalformedMcap(
                f"channel {channel} names schema {schema}, which is not known yet",
                rule="known",
                byte=at,
            )
        topic = Topic(
            channel,
            self.contents.schemas.get(schema),
            fields.text(),
            fields.text(),
            fields.text_map(),
        )
        if self.contents.topics.setdefault(channel, topic) != topic:
            raise MalformedMcap(
                f"channel {channel} is defined twice, differently", rule="known", byte=at
            )
        self._limit_definitions(len(self.contents.topics), len(body), at)

    def _limit_definitions(self, count: int, size: int, at: int) -> None:
        self._defined += size
        if self._defined > self._limits.definition_bytes:
            raise TooLarge(
                f"schemas and channels of more than {self._limits.definition_bytes} bytes",
                limit="definition_bytes",
                byte=at,
            )
        if count > self._limits.channels:
            raise TooLarge(
                f"more than {self._limits.channels} channels or schemas", limit="channels", byte=at
            )

    def _attachment(self, at: int, body: bytes) -> None:
        self.contents.attachments += 1
        fields = Fields(body, at)
        fields.uint(8), fields.uint(8), fields.text(), fields.text()
        fields.skip(fields.uint(8))
        covered = fields.at
        declared = fields.uint(4)
        if declared and declared != zlib.crc32(body[:covered]):
            raise MalformedMcap("the checksum of an attachment does not hold", rule="crc", byte=at)

    def count(self, records: int, at: int) -> None:
        """Count records. Raises TooLarge beyond the limit."""
        self.contents.records += records
        if self.contents.records > self._limits.records:
            raise TooLarge(f"more than {self._limits.records} records", limit="records", byte=at)
