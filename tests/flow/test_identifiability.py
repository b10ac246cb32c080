"""`trueup identifiability` on a case folder: the table, as JSON and as text."""

import json
from pathlib import Path

from tests.flow.test_diagnose import run

EMPS = Path(__file__).parents[2] / "examples" / "emps"


def test_a_case_says_what_it_can_show():
    document = json.loads(run("identifiability", EMPS, "--json").stdout)
    assert document["schema"] == "trueup.identifiability/1"
    assert {p["parameter"] for p in document["parameters"]} == {"b", "c"}
    effects = {e["effect"]: e for e in document["effects"]}
    assert effects["coulomb_friction"]["shown"] == "identifiable"
    assert effects["coulomb_friction"]["unit"] == "m/s^2"
    # no force depends on the position of a free axis, and no velocity is logged
    for hidden in ("sensor_bias", "velocity_lag"):
        assert effects[hidden]["shown"] == "not_identifiable"
        assert effects[hidden]["why"]
    text = run("identifiability", EMPS).stdout
    assert "smallest detectable" in text
    assert "coulomb_friction\tidentifiable\tlevel" in text
