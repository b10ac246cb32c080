"""The page of a diagnosis: what is ranked above the line, and that nothing in a report can become
markup."""

import pytest

from trueup_pages.diagnosis import ALONE, INSEPARABLE, NOT_ENOUGH, ranking, report_page

HOSTILE = "</script><img src=x>"


def row(validation, *effects, answer=False, in_set=False, worse=(0.5, 1.5)):
    return {
        "effects": list(effects),
        "parameters": "fitted",
        "misfit": validation,
        "validation": validation,
        "worse_ci95": list(worse),
        "answer": answer,
        "in_set": in_set or answer,
    }


def report(*rows, verdict="effect", plant="p"):
    gap = {
        "before": 1.0,
        "parameters_only": 0.5,
        "after": 0.1,
        "floor": 0.05,
        "closed": 0.9,
        "ci95": [0.8, 1.0],
        "horizon_s": 1.0,
    }
    return {
        "plant": plant,
        "verdict": verdict,
        "effects": [],
        "indistinguishable": [],
        "excluded": [],
        "not_excited": [{"effect": "hard_stop", "why": HOSTILE}],
        "parameters": {HOSTILE: {"nominal": 1.0, "value": 1.1, "ci95": [1.0, 1.2]}},
        "where": {
            "channels": [{"channel": HOSTILE, "share": 1.0}],
            "ports": [],
            "regions": [],
            "bands": [],
        },
        "gap": {**gap, "beginnings": "counted"},
        "next_experiment": None,
        "evidence": {
            "episodes": [],
            "hypotheses": list(rows),
            "uses_of_validation": 3,
            "seed": 0,
            "version": "0",
        },
    }


def test_what_cannot_be_told_from_the_answer_is_above_the_line():
    rows = [
        row(9.0, "backlash"),
        row(2.1, "stribeck_friction", in_set=True),
        row(2.0, "coulomb_friction", answer=True),
        row(50.0),
    ]
    ranked = ranking(report(*rows))
    assert [r["name"] for r in ranked] == [
        "Coulomb friction",
        "Stribeck friction",
        "backlash",
        "refitted parameters alone",
    ]
    assert [r["divide"] for r in ranked] == ["", "", INSEPARABLE, ""]
    assert ranked[0]["note"] == "the answer"


@pytest.mark.parametrize(("verdict", "line"), [("effect", ALONE), ("unknown_effect", NOT_ENOUGH)])
def test_the_line_says_what_the_verdict_says(verdict, line):
    ranked = ranking(
        report(row(2.0, "coulomb_friction", answer=True), row(9.0, "backlash"), verdict=verdict)
    )
    assert ranked[1]["divide"] == line
    assert ("answer" in ranked[0]["note"]) == (verdict == "effect")


def test_what_fits_closer_and_is_not_the_answer_is_explained():
    ranked = ranking(
        report(row(2.0, "coulomb_friction", answer=True), row(1.9, "coulomb_friction", "backlash"))
    )
    assert "more numbers" in ranked[1]["note"]


def test_nothing_in_a_report_becomes_markup():
    trace = {
        "name": HOSTILE,
        "unit": HOSTILE,
        "measured": [0.0, 1.0],
        "nominal": [0.0, 2.0],
        "corrected": [0.0, 1.0],
    }
    trace["rms"] = {"nominal": 1.0, "corrected": 0.0}
    episode = {"sha256": "0" * 64, "t_s": [0.0, 1.0], "channels": [trace], "commands": []}
    figures = {
        "horizon_s": 1.0,
        "stride_s": 0.1,
        "episodes": [episode],
        "maps": [],
        "experiment": None,
    }
    page = report_page(report(row(2.0, HOSTILE, answer=True), plant=HOSTILE), figures)
    assert HOSTILE not in page
    assert "<img" not in page
    assert page.count("</script>") == 3  # the data's, and those of the two scripts


@pytest.mark.parametrize(("after", "is_said"), [(0.2, True), (0.06, False)])
def test_what_is_left_beside_the_noise_is_said_where_intervals_are(after, is_said):
    document = report(row(2.0, "coulomb_friction", answer=True))
    estimate = {"level": {"value": 0.2, "unit": "m/s^2", "ci95": [0.19, 0.21]}}
    document["effects"] = [
        {"effect": "coulomb_friction", "channel": "joint", "estimate": estimate, "share": 0.5}
    ]
    document["gap"] |= {"after": after, "floor": 0.05}
    assert (
        "What is left is 4 times what noise alone makes" in report_page(document, None)
    ) == is_said
