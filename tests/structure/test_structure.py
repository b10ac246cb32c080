"""Rules on the code and on what surrounds it."""

import ast
import importlib
import inspect
import pkgutil
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import text

import trueup
from tests.support.parts import PARTS, ROOT
from trueup import errors
from trueup.ledger.merkle import NOTHING
from trueup_migrations import FOLDER, HEAD, upgrade
from trueup_service.http import statuses
from trueup_service.registry.database import Database
from trueup_service.registry.schema import current
from trueup_service.registry.tables import metadata
from trueup_service.registry.transaction import ReadTransaction
from trueup_service.settings import Settings

PACKAGES = (
    "trueup",
    "trueup_client",
    "trueup_pages",
    "trueup_service",
    "trueup_worker",
    "trueup_cli",
)
SOURCES = sorted(
    p for part in PARTS for p in (ROOT / part).rglob("*.py") if "versions" not in p.parts
)
LONGEST_FILE = 400  # lines


def tracked() -> list[Path]:
    listed = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.splitlines()
    return [ROOT / name for name in listed if (ROOT / name).is_file()]


def run(*command: str) -> str:
    done = subprocess.run(
        [str(Path(sys.executable).parent / command[0]), *command[1:]],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]
    return done.stdout


def all_errors() -> list[type[errors.TrueupError]]:
    for package in PACKAGES:
        for module in pkgutil.walk_packages(
            importlib.import_module(package).__path__, f"{package}."
        ):
            if not module.name.endswith(("cli.main", "worker.main")):
                importlib.import_module(module.name)
    found, left = [], [errors.TrueupError]
    while left:
        kind = left.pop()
        found.append(kind)
        left += kind.__subclasses__()
    return [k for k in found if k.__module__.split(".")[0] in PACKAGES]


def test_the_layers_hold():
    run("lint-imports")


def test_the_page_of_the_architecture_shows_the_librarys_layers_and_packages():
    page = (ROOT / "docs" / "architecture.md").read_text()
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    (layers,) = (c["layers"] for c in contracts["contracts"] if c.get("containers") == ["trueup"])
    drawn = page.partition("or environment\n")[2].partition("\n\n")[0]
    assert [{name.strip() for name in layer.split(",")} for layer in drawn.split("<")] == [
        {name.strip() for name in layer.split("|")} for layer in reversed(layers)
    ]
    packages = {path.parent.name for path in (ROOT / "library" / "trueup").glob("*/__init__.py")}
    assert {name for name in packages if f"`{name}/`" not in page} == set()


def test_the_code_is_formatted_and_linted():
    run("ruff", "format", "--check", ".")
    run("ruff", "check", ".")


def test_the_types_hold():
    run("mypy")


def test_the_migrations_add_up_to_the_tables(storage):
    settings = storage.settings()
    settings.data_dir.mkdir(parents=True)
    database = Database(settings.sqlalchemy_url, 2)
    with database.write() as connection:
        upgrade(connection)
    with database.read() as connection:
        assert (
            compare_metadata(
                MigrationContext.configure(connection, opts={"compare_type": True}), metadata
            )
            == []
        )
        migrated = connection.execute(text("SELECT id, size, frontier FROM audit_head")).all()
    database.close()
    assert [(row.id, row.size, bytes(row.frontier)) for row in migrated] == [(1, 0, b"")]


def test_an_empty_database_is_made_as_the_migrations_would(storage):
    parts = storage.build()
    with parts.database.read() as connection:
        assert (
            compare_metadata(
                MigrationContext.configure(connection, opts={"compare_type": True}), metadata
            )
            == []
        )
        assert ReadTransaction(connection).log.tree() == NOTHING
    assert current(parts.database) == HEAD == ScriptDirectory(str(FOLDER)).get_current_head()
    parts.close()


def test_every_error_has_a_code_a_hint_and_a_docstring_and_no_two_share_a_code():
    found = all_errors()
    assert len(found) > 20
    for kind in found:
        assert inspect.getdoc(kind), kind
        assert kind.hint, kind
        assert re.fullmatch(r"[a-z][a-z0-9-]+", kind.code), kind
    codes = [k.code for k in found]
    assert sorted(set(codes)) == sorted(codes)


def test_every_error_stands_in_the_tree_of_the_librarys_errors():
    tree = inspect.getdoc(errors)
    for name, kind in vars(errors).items():
        if inspect.isclass(kind) and issubclass(kind, errors.TrueupError):
            assert name in tree


def test_every_error_that_the_service_can_answer_with_has_a_status():
    ours = {k for k in all_errors() if k.__module__.startswith(("trueup.", "trueup_service."))}
    without = {k for k in ours if not any(c in statuses.STATUS for c in k.__mro__)}
    assert {k.__name__ for k in without} <= {"TrueupError", "LedgerError", "LawBroken"}


def test_every_setting_is_documented():
    assert all(setting.description for setting in Settings.model_fields.values())


@pytest.mark.parametrize(
    "page",
    [
        "commands",
        "settings",
        "effects",
        "access",
        "api",
        "gates",
        "python",
        "figures",
        "capacity",
        "scoreboard",
        "tuning",
    ],
)
def test_pages_made_from_the_code_are_up_to_date(page):
    written = subprocess.run(
        [sys.executable, "-c", f"import make_{page}; print(make_{page}.page(), end='')"],
        cwd=ROOT / "docs",
        capture_output=True,
        text=True,
        check=True,
    )
    assert (ROOT / "docs" / f"{page}.md").read_text() == written.stdout, "run `make docs`"


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_public_name_is_documented_and_typed(path):
    tree = ast.parse(path.read_text())
    if path.stat().st_size:
        assert ast.get_docstring(tree), "the module says nothing of itself"
    for node in tree.body:
        if isinstance(
            node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
        ) and not node.name.startswith("_"):
            is_route = path.parent.name == "routers"  # its summary documents it
            assert ast.get_docstring(node) or is_route, node.name


def _classes():
    """Every public class of ours, with the modules imported that hold them."""
    for package in PACKAGES:
        path = importlib.import_module(package).__path__
        for module in pkgutil.walk_packages(path, f"{package}."):
            if module.name.endswith(("cli.main", "worker.main")):
                continue
            for name, kind in vars(importlib.import_module(module.name)).items():
                if inspect.isclass(kind) and kind.__module__ == module.name and name[0] != "_":
                    yield kind


def test_every_public_method_is_documented_where_it_is_declared():
    bare = []
    for kind in _classes():
        for name, member in vars(kind).items():
            function = getattr(member, "__func__", getattr(member, "fget", member))
            if name.startswith("_") or not inspect.isfunction(function) or function.__doc__:
                continue
            declared = (
                hasattr(base, name) or name in inspect.get_annotations(base)
                for base in kind.__mro__[1:]
            )
            if not any(declared):
                bare.append(f"{kind.__module__}.{kind.__name__}.{name}")
    assert bare == []


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: str(p.relative_to(ROOT)))
def test_a_file_is_short_and_its_names_and_docstrings_can_be_read_alone(path):
    text = path.read_text()
    assert text.count("\n") <= LONGEST_FILE
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            assert not (ast.get_docstring(node) or "").startswith("The same"), node.name
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            names = {n.id for n in ast.walk(node) if isinstance(n, ast.Name)}
            names |= {n.arg for n in ast.walk(node) if isinstance(n, ast.arg)}
            assert not names & {"found", "told"}, f"{node.name}: found or told of what?"


def test_the_readmes_commands_are_what_ci_runs():
    readme, ci = (ROOT / "README.md").read_text(), (ROOT / ".ci" / "run").read_text()
    assert "make demo" in readme
    assert "make test" in readme
    commands = [
        line for line in ci.splitlines() if line and not line.startswith(("#", "set ", "cd "))
    ]
    assert commands == ["make test"]
    targets = set(re.findall(r"^([a-z]+):.*##", (ROOT / "Makefile").read_text(), re.MULTILINE))
    assert set(re.findall(r"\bmake ([a-z]+)\b", readme)) <= targets


def test_no_package_registry_is_named():
    hosts = [
        b"py" + b"pi.org",
        b"pythonhosted" + b".org",
        b"crates" + b".io",
        b"registry." + b"npmjs",
        b"maven." + b"org",
    ]
    for path in tracked():
        if path.suffix not in {".mcap", ".png"}:
            content = path.read_bytes()
            assert not [h for h in hosts if h in content], path


def test_no_path_of_the_machine_it_was_written_on_is_named():
    of_here = [str(ROOT).encode() + b"/", str(Path.home()).encode() + b"/"]
    for path in tracked():
        assert not [found for found in of_here if found in path.read_bytes()], path


def test_a_command_prints_through_show_alone_in_forms_that_stand_in_its_code():
    """Else what others wrote could be taken for markup, or reach the terminal as it is."""
    for path in sorted((ROOT / "cli").rglob("*.py")):
        if path.name == "show.py":
            continue
        for call in (
            node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)
        ):
            name = getattr(call.func, "attr", getattr(call.func, "id", ""))
            assert name not in {"print", "print_json", "from_markup"}, f"{path.name}:{call.lineno}"
            assert not ast.unparse(call.func).startswith(
                ("sys.stdout.write", "sys.stderr.write")
            ), f"{path.name}:{call.lineno}"
            if name == "say":
                form = call.args[0]
                forms = (form.body, form.orelse) if isinstance(form, ast.IfExp) else (form,)
                assert all(
                    isinstance(f, ast.Constant) and isinstance(f.value, str) for f in forms
                ), f"{path.name}:{call.lineno}"


def test_the_robots_client_imports_the_standard_library_alone():
    code = "import sys, trueup_client; print(*{m.split('.')[0] for m in sys.modules})"
    loaded = set(
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT
        ).stdout.split()
    )
    assert not loaded & {"numpy", "orjson", "trueup", "pydantic", "httpx", "rich"}


def test_a_server_that_only_serves_loads_no_heavy_library():
    code = "import sys, trueup_service.http.serve; print(*{m.split('.')[0] for m in sys.modules})"
    loaded = set(
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT
        ).stdout.split()
    )
    assert not loaded & {"numpy", "numba", "scipy", "dbos", "alembic", "safetensors", "obstore"}


def test_the_job_engine_is_imported_in_one_place():
    """Whoever imports it elsewhere would have it unpickle what a row says is pickled."""
    every = (path for part in PARTS for path in (ROOT / part).rglob("*.py"))
    importing = [
        path
        for path in every
        if re.search(r"^\s*(from|import) dbos\b", path.read_text(), re.MULTILINE)
    ]
    assert [p.relative_to(ROOT).as_posix() for p in importing] == [
        "service/trueup_service/engine.py"
    ]


def test_links_in_the_documentation_lead_somewhere():
    for page in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]:
        for link in re.findall(r"\]\((?!https?:|#)([^)#]+)", page.read_text()):
            assert (page.parent / link).exists(), f"{page.name}: {link}"


@pytest.mark.parametrize("part", PARTS)
def test_the_version_is_one_and_every_part_needs_the_others_of_its_own(part):
    project = tomllib.loads((ROOT / part / "pyproject.toml").read_text())["project"]
    needed = [
        *project["dependencies"],
        *(n for more in project.get("optional-dependencies", {}).values() for n in more),
    ]
    assert project["version"] == trueup.__version__
    assert all(n.endswith(f"=={trueup.__version__}") for n in needed if n.startswith("trueup"))
