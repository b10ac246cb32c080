"""Write client/trueup_client/async_calls/: for an event loop, what client/trueup_client/calls/ has.

Run it, then `ruff format client`, after a change of the client's calls.
"""

import ast
from pathlib import Path

CLIENT = Path(__file__).parent.parent / "client" / "trueup_client"
SOURCES, WRITTEN = CLIENT / "calls", CLIENT / "async_calls"
PACKAGE = '''"""The calls of `AsyncClient`, one file for each noun of the service.

Made by tools/make_async_client.py from trueup_client.calls.
"""
'''
MODULE = '''"""The calls of trueup_client.calls.{noun} for an event loop.

Made by tools/make_async_client.py.
"""

from __future__ import annotations

{imports}


class Async{name}(Pooled):
    """{doc} For an event loop."""
'''


def modules() -> dict[Path, str]:
    """Returns the text of every module by its path, before formatting."""
    sources = sorted(path for path in SOURCES.glob("*.py") if path.name != "__init__.py")
    texts = {WRITTEN / path.name: module(path) for path in sources}
    return {WRITTEN / "__init__.py": PACKAGE, **texts}


def module(path: Path) -> str:
    """Returns the asynchronous form of one module of calls."""
    tree = ast.parse(path.read_text())
    calls = next(node for node in tree.body if isinstance(node, ast.ClassDef))
    methods = [
        node
        for node in calls.body
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_")
    ]
    head = MODULE.format(
        doc=ast.get_docstring(calls),
        noun=path.stem,
        name=calls.name,
        imports=imports(tree, methods, f"trueup_client.calls.{path.stem}", calls.name),
    )
    return head + "".join(method(node, calls.name) for node in methods)


def imports(tree: ast.Module, methods: list[ast.FunctionDef], home: str, calls: str) -> str:
    """Returns the imports that the signatures of these methods need, sorted."""
    names = {
        "AsyncIterator" if node.id == "Iterator" else node.id
        for method in methods
        for part in (method.args, method.returns)
        for node in ast.walk(part)
        if isinstance(node, ast.Name)
    }
    outside, ours = [], [f"from {home} import {calls}", "from trueup_client.pool import Pooled"]
    for node in tree.body:
        if isinstance(node, ast.Import):
            outside += [f"import {alias.name}" for alias in node.names if alias.name in names]
        elif isinstance(node, ast.ImportFrom) and node.module != "__future__":
            imported = [alias.name.replace("Iterator", "AsyncIterator") for alias in node.names]
            used = ", ".join(sorted(set(imported) & names))
            own = node.module.startswith("trueup_client")
            (ours if own else outside).extend([f"from {node.module} import {used}"] if used else [])
    outside.sort(key=lambda line: (line.startswith("from"), line))
    return "\n".join(outside) + "\n\n" + "\n".join(sorted(ours))


def method(node: ast.FunctionDef, calls: str) -> str:
    """Returns one method: awaited, or iterated over where it yields."""
    positional = [a.arg for a in node.args.args[1:]]
    keywords = [f"{a.arg}={a.arg}" for a in node.args.kwonlyargs]
    arguments = ", ".join([f"{calls}.{node.name}", *positional, *keywords])
    signature = f"def {node.name}({ast.unparse(node.args)})"
    returns, doc = ast.unparse(node.returns), ast.get_docstring(node, clean=False)
    if returns.startswith("Iterator["):
        head, body = f"{signature} -> Async{returns}", f"return self._pool.each({arguments})"
    else:
        head, body = f"async {signature} -> {returns}", f"return await self._pool.run({arguments})"
    return f'\n    {head}:\n        """{doc}"""\n        {body}\n'


if __name__ == "__main__":
    WRITTEN.mkdir(exist_ok=True)
    for path, text in modules().items():
        path.write_text(text)
