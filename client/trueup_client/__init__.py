"""What a robot, a CI job or a script needs of trueup: ask, send, fetch, verify.

It needs the standard library alone.

from trueup_client import Client

client = Client("http://127.0.0.1:8321")
serving = client.serving("emps")
client.fetch("emps", serving.artifact, "model")
"""

from typing import TYPE_CHECKING, Any

from trueup_client.client import Client
from trueup_client.freshness import Ages, Freshness
from trueup_client.problem import DigestMismatch, LogForked, NotSigned, Problem, Unreachable
from trueup_client.records import Serving
from trueup_client.robot import Robot
from trueup_client.witness import Witness

if TYPE_CHECKING:
    from trueup_client.asynchronous import AsyncClient

__all__ = [
    "Ages",
    "AsyncClient",
    "Client",
    "DigestMismatch",
    "Freshness",
    "LogForked",
    "NotSigned",
    "Problem",
    "Robot",
    "Serving",
    "Unreachable",
    "Witness",
]


def __getattr__(name: str) -> Any:
    """Imports `AsyncClient` when it is asked for: a robot has no use for an event loop."""
    if name != "AsyncClient":
        raise AttributeError(f"module 'trueup_client' has no attribute {name!r}")
    from trueup_client.asynchronous import AsyncClient  # noqa: PLC0415

    return AsyncClient
