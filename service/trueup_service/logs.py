"""Logs on standard error as JSON in ASCII, one object per line. Text from others cannot end a line,
and reaches a terminal escaped. Where traces are exported, a line carries the ids of its own."""

from __future__ import annotations

import json
import logging
import sys
from datetime import UTC, datetime

from trueup_service import open_telemetry

_PLAIN = set(vars(logging.makeLogRecord({}))) | {"message", "asctime", "taskName", "color_message"}


class JsonLines(logging.Formatter):
    """Formats the time, level, logger and message of a record, its `extra` fields, and its
    traceback."""

    def format(self, record: logging.LogRecord) -> str:
        line = {
            "at": datetime.fromtimestamp(record.created, UTC).isoformat(),
            "level": record.levelname,
            "logger": record.name,
            "message": record.getMessage(),
        }
        line |= open_telemetry.ids()
        line |= {key: value for key, value in vars(record).items() if key not in _PLAIN}
        if record.exc_info:
            line["traceback"] = self.formatException(record.exc_info)
        return json.dumps(line, default=str)


def configure_logs(level: str) -> None:
    """Send the records of every logger through JsonLines."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonLines())
    logging.basicConfig(level=level, handlers=[handler], force=True)
    for quiet in ("alembic", "dbos"):
        logging.getLogger(quiet).setLevel(logging.WARNING)
    engine = logging.getLogger("dbos")  # it would print in its own format
    engine.handlers, engine.propagate = [handler], False
