"""The client for an event loop: the methods of `Client`, to be awaited or iterated over.

async with AsyncClient("http://127.0.0.1:8321") as client:
    serving = await client.serving("emps")
    async for moved in client.watch("emps"):
        ...

"""

from __future__ import annotations

from trueup_client.async_calls.access import AsyncAccessCalls
from trueup_client.async_calls.artifacts import AsyncArtifactCalls
from trueup_client.async_calls.audit import AsyncAuditCalls
from trueup_client.async_calls.gates import AsyncGateCalls
from trueup_client.async_calls.jobs import AsyncJobCalls
from trueup_client.async_calls.labels import AsyncLabelCalls
from trueup_client.async_calls.monitoring import AsyncMonitoringCalls
from trueup_client.async_calls.plants import AsyncPlantCalls
from trueup_client.async_calls.serving import AsyncServingCalls
from trueup_client.async_calls.webhooks import AsyncWebhookCalls
from trueup_client.client import Client
from trueup_client.pool import Pool


class AsyncClient(
    AsyncPlantCalls,
    AsyncArtifactCalls,
    AsyncGateCalls,
    AsyncJobCalls,
    AsyncServingCalls,
    AsyncLabelCalls,
    AsyncMonitoringCalls,
    AsyncAccessCalls,
    AsyncAuditCalls,
    AsyncWebhookCalls,
):
    """Talks to one service, with at most `at_once` requests on their way.

    The other arguments are those of `Client`. `progress` and `confirmed` are called in the thread
    that asks. A call that is cancelled is broken off, and what it asked for may have been done:
    ask, or repeat it with its key. A watch holds one of the requests for as long as it lasts.
    """

    def __init__(
        self,
        url: str | None = None,
        actor: str | None = None,
        timeout_s: float = 120.0,
        token: str | None = None,
        *,
        at_once: int = 8,
    ) -> None:
        self._pool = Pool(lambda: Client(url, actor, timeout_s, token), at_once)

    async def __aenter__(self) -> AsyncClient:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Closes every connection. Calls that run or wait for their turn end with Unreachable."""
        await self._pool.close()
