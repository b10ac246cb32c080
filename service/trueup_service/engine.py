"""The job engine, changed so that it never unpickles.

The engine reads a row as its column `serialization` says, whatever serializer it was configured
with, and a row that says `py_pickle` would run code in its reader. This service writes portable
JSON alone. So this module is the only one that imports the engine, and it makes the pickling
serializer refuse before anything is read: whoever can write a row cannot run code by it.
"""

from __future__ import annotations

from typing import NoReturn

from dbos import (
    DBOS,
    DBOSClient,
    DBOSConfig,
    DBOSPortableJSONSerializer,
    EnqueueOptions,
    SetWorkflowID,
    StepOptions,
)
from dbos._serialization import DBOSDefaultSerializer, DefaultSerializer

from trueup_service.errors import Pickled

__all__ = [
    "DBOS",
    "DBOSClient",
    "DBOSConfig",
    "DBOSPortableJSONSerializer",
    "EnqueueOptions",
    "Pickled",
    "SetWorkflowID",
    "StepOptions",
]


def _refuse(_serializer: object, _data: object) -> NoReturn:
    raise Pickled


DefaultSerializer.deserialize = _refuse
DefaultSerializer.serialize = _refuse
if type(DBOSDefaultSerializer) is not DefaultSerializer:
    raise TypeError("the engine unpickles by a class that is not shut here")
