"""What is installed alone runs alone: each wheel is built, and installed into an environment that
holds nothing else."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.parts import PARTS, ROOT

pytestmark = pytest.mark.slow  # whole diagnoses, designs or installations

UV = str(Path(sys.executable).parent / "uv")
WEB = {"fastapi", "starlette", "uvicorn", "pydantic", "httptools"}
DATABASE = {"sqlalchemy", "alembic", "psycopg", "psycopg-binary", "obstore", "dbos"}
COMPILERS = {"numba", "llvmlite", "mujoco", "onnx", "cython", "setuptools", "torch", "jax"}

REHEARSAL = """
import sys
from pathlib import Path
import trueup_service.http.app
print("numba" in sys.modules)
from trueup.artifact.artifact import pack
from trueup.diagnose.case import read_case
from trueup.fit.score import EVERY, Scoring
from trueup.model.predictor import Nominal
from trueup_service.actions.switchback import rehearse
from trueup_service.registry.records import ArtifactRecord
plant, episodes = read_case(Path(sys.argv[1]))
nominal = Nominal(plant)
packed = pack(nominal, {"origin": "test"})
known = {"digest": packed.digest, "manifest": packed.manifest.decode()}
back = ArtifactRecord(**{name: None for name in ArtifactRecord.__slots__} | known)
rehearse(None, back, plant.digest, nominal, episodes[-1], Scoring(plant.horizon_s, EVERY), "now")
print("numba" in sys.modules)
"""
MIGRATION = """
import sqlalchemy
import trueup_migrations
with sqlalchemy.create_engine("sqlite://").begin() as connection:
    trueup_migrations.upgrade(connection)
    print(sqlalchemy.inspect(connection).has_table("audit"))
"""


def ran(*command: str | Path) -> str:
    alone = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(("PYTHON", "VIRTUAL_ENV", "TRUEUP"))
    }
    done = subprocess.run(
        [str(word) for word in command],
        capture_output=True,
        text=True,
        check=False,
        cwd="/",
        env=alone,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.fixture(scope="module")
def wheels(tmp_path_factory):
    """The folder of the wheels of every part."""
    folder = tmp_path_factory.mktemp("wheels")
    for part in PARTS:
        ran(
            UV,
            "build",
            "--quiet",
            "--wheel",
            "--no-build-isolation",
            "--python",
            sys.executable,
            "--out-dir",
            folder,
            ROOT / part,
        )
    return folder


@pytest.fixture
def installed(wheels, tmp_path):
    """Install distributions of ours into an environment of their own: its Python, and the names of
    what it holds."""

    def install(*names: str) -> tuple[Path, set[str]]:
        python = tmp_path / "alone" / "bin" / "python"
        ran(UV, "venv", "--quiet", "--python", sys.executable, tmp_path / "alone")
        pinned = ("--constraint", ROOT / "requirements.txt", "--find-links", wheels)
        ran(UV, "pip", "install", "--quiet", "--python", python, *pinned, *names)
        return python, {
            line.partition("==")[0] for line in ran(UV, "pip", "freeze", "--python", python).split()
        }

    return install


def test_the_robots_client_brings_nothing_with_it(installed):
    python, there = installed("trueup-client")
    assert there == {"trueup-client"}
    assert (
        ran(python, "-c", "import trueup_client; print(trueup_client.Robot.__name__)") == "Robot\n"
    )


def test_the_library_reads_recordings_without_web_server_database_or_job_engine(installed):
    python, there = installed("trueup")
    assert not there & (WEB | DATABASE)
    assert {n for n in there if n.startswith("trueup")} == {"trueup"}
    code = (
        "from trueup.diagnose.case import read_case; from pathlib import Path; "
        "print(len(read_case(Path({!r}))[1]))"
    )
    assert ran(python, "-c", code.format(str(ROOT / "examples" / "emps"))).strip() == "5"


def test_migrations_need_a_database_and_nothing_of_ours(installed):
    python, there = installed("trueup-migrations")
    assert {n for n in there if n.startswith("trueup")} == {"trueup-migrations"}
    assert ran(python, "-c", MIGRATION).split() == ["True"]


def test_a_server_holds_one_compiler_and_runs_it_to_rehearse_a_promotion(installed):
    python, there = installed("trueup-service", "trueup-cli")
    assert "trueup-worker" not in there
    assert there & COMPILERS == {"numba", "llvmlite"}
    assert ran(python, "-c", REHEARSAL, ROOT / "examples" / "emps").split() == ["False", "True"]


def test_the_command_stands_without_a_service_and_says_what_serving_needs(installed):
    python, there = installed("trueup-cli")
    assert not there & (WEB | DATABASE)
    ran(
        python,
        "-c",
        (
            "import pkgutil, trueup_cli; [__import__('trueup_cli.' + m.name) for m in "
            "pkgutil.iter_modules(trueup_cli.__path__)]"
        ),
    )
    ran(python.parent / "trueup", "doctor")
    refused = subprocess.run(
        [python.parent / "trueup", "serve"], capture_output=True, text=True, check=False
    )
    assert refused.returncode == 1
    assert "trueup-cli[server]" in refused.stderr
