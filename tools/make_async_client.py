"""Write client/trueup_client/asynchronous.py: the client for an event loop, method by method what
the client has."""

import ast
from pathlib import Path

ROOT = Path(__file__).parent.parent
SOURCE, MADE = (
    ROOT / "client" / "trueup_client" / "client.py",
    ROOT / "client" / "trueup_client" / "asynchronous.py",
)
APART = ("close", "abort", "aborted")
HEAD = '''"""The client for an event loop: the methods of `Client`, to be awaited or iterated over.

    async with AsyncClient("http://127.0.0.1:8321") as client:
        serving = await client.serving("emps")
        async for moved in client.watch("emps"):
            ...

Made by tools/make_async_client.py from the client itself.
"""

from __future__ import annotations

import os
from collections.abc import AsyncIterator, Callable
from pathlib import Path

from trueup_client.client import Client, Share, silent
from trueup_client.pool import Pool
from trueup_client.proof import Checkpoint
{records}
from trueup_client.witness import Witness


class AsyncClient:
    """Talks to one service, with at most `at_once` requests on their way.

    The other arguments are those of `Client`.

    `progress` and `confirmed` are called in the thread that asks. A call that is cancelled is
    broken off, and what it asked for may have been done: ask, or repeat it with its key. A watch
    holds one of the requests for as long as it lasts.
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
        """Close every connection; what still asks or waits for its turn ends with Unreachable."""
        await self._pool.close()
'''


def module() -> str:
    """The module's text."""
    tree = ast.parse(SOURCE.read_text())
    client = next(
        node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == "Client"
    )
    records = next(
        n
        for n in tree.body
        if isinstance(n, ast.ImportFrom) and n.module == "trueup_client.records"
    )
    return HEAD.replace("{records}", ast.unparse(records)) + "".join(
        method(node)
        for node in client.body
        if isinstance(node, ast.FunctionDef) and node.name not in APART
    )


def method(node: ast.FunctionDef) -> str:
    """One method, "" for what is not public."""
    if node.name.startswith("_"):
        return ""
    names = [a.arg for a in node.args.args[1:]]
    named = [f"{a.arg}={a.arg}" for a in node.args.kwonlyargs]
    given = ", ".join([f"Client.{node.name}", *names, *named])
    answer, doc = ast.unparse(node.returns), ast.get_docstring(node, clean=False)
    told = f'        """{doc}"""\n' if doc else ""
    if answer.startswith("Iterator["):
        return (
            f"\n    def {node.name}({ast.unparse(node.args)}) -> Async{answer}:\n{told}      "
            f"  return self._pool.each({given})\n"
        )
    return (
        f"\n    async def {node.name}({ast.unparse(node.args)}) -> {answer}:\n{told}        "
        f"return await self._pool.run({given})\n"
    )


if __name__ == "__main__":
    MADE.write_text(module())
