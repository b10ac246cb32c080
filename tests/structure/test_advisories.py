"""What is said of the pinned packages: what is known of them, or that nobody could be asked."""

import importlib.util
import json
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent
SPEC = importlib.util.spec_from_file_location("advisories", ROOT / "tools" / "advisories.py")
advisories = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(advisories)

SOUND = {"name": "sound", "version": "1.0", "vulns": []}
HOLED = {"name": "holed", "version": "2.0", "vulns": [{"id": "PYSEC-1", "fix_versions": ["2.1"]}]}
UNKNOWN = {"name": "unknown", "skip_reason": "not found"}


@pytest.mark.parametrize(
    ("packages", "says", "ends"),
    [
        ([SOUND, SOUND], ["advisories: 2 of 2 pinned packages looked up, none is known"], 0),
        ([SOUND, UNKNOWN], ["advisories: 1 of 2 pinned packages looked up, none is known"], 0),
        (
            [SOUND, HOLED],
            ["advisories: 2 of 2 pinned packages looked up", "  holed 2.0: PYSEC-1, mended in 2.1"],
            1,
        ),
        (
            [UNKNOWN],
            [
                (
                    "advisories: not one pinned package could be looked up, their source "
                    "does not answer here"
                )
            ],
            3,
        ),
        (
            [],
            [
                (
                    "advisories: not one pinned package could be looked up, their source "
                    "does not answer here"
                )
            ],
            3,
        ),
    ],
)
def test_what_is_known_is_told_and_what_could_not_be_asked(packages, says, ends):
    assert advisories.summary(packages) == (says, ends)


@pytest.mark.slow
def test_every_pinned_package_is_asked_for():
    pinned = {
        line.partition("==")[0]
        for name in advisories.PINNED
        for line in (ROOT / name).read_text().splitlines()
        if "==" in line
    }
    packages = advisories.look_up(ROOT)
    assert not packages or len(
        {p["name"].lower().replace("_", "-") for p in packages}
    ) >= 0.8 * len(pinned)  # others are for other platforms


@pytest.fixture
def auditor(tmp_path, monkeypatch):
    """What stands in for pip-audit notes what it was asked, and prints what it is given."""

    def prints(text):
        script = tmp_path / "pip_audit.py"
        script.write_text(
            f"import sys\nfrom pathlib import Path\n"
            f"Path({str(tmp_path / 'asked')!r}).write_text(' '.join(sys.argv[1:]))\n"
            f"print({text!r})\n"
        )
        monkeypatch.setenv("PYTHONPATH", str(tmp_path))
        return tmp_path / "asked"

    return prints


def test_every_file_of_pinned_packages_is_asked_for(auditor):
    asked = auditor(json.dumps({"dependencies": [SOUND, HOLED]}))
    assert advisories.look_up(ROOT) == [SOUND, HOLED]
    for name in ("requirements.txt", "requirements-dev.txt"):
        assert f"--requirement {ROOT / name}" in asked.read_text()
        assert (ROOT / name).read_text().count("==") > 50


def test_a_source_that_does_not_answer_is_no_packages(auditor):
    auditor("no JSON")
    assert advisories.look_up(ROOT) == []
