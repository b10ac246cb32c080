"""The job engine, with one door of its shut: it never unpickles.

The engine reads a row as its column `serialization` says, whatever serializer it was given; a row
that says `py_pickle` would run code in whoever reads it. Ours are portable JSON alone. So nothing
else imports the engine, and here its pickling serializer is made to refuse before anything is read:
whoever can write a row cannot run code by it.
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
