"""A report in words: the sentence, the shares, the digits of an uncertainty."""

import json

import pytest

from trueup.canonical import canonical_bytes
from trueup.collect.step_warning import off_step
from trueup.diagnose.number_text import percent, plus_minus, short
from trueup.diagnose.summary_text import composition, sentence, waterfall
from trueup.diagnose.summary_warnings import warnings


def report(
    effects=(),
    *,
    verdict="effect",
    before=0.21,
    same=0.21,
    numbers=0.12,
    after=0.013,
    floor=0.012,
    closed=0.99,
    rivals=(),
):
    return {
        "verdict": verdict,
        "effects": list(effects),
        "indistinguishable": list(rivals),
        "gap": {
            "before": before,
            "same_numbers": same,
            "parameters_only": numbers,
            "after": after,
            "floor": floor,
            "closed": closed,
            "ci95": [0.98, 1.0],
        },
    }


def recorded(*periods_s, step_s=0.005, **gap):
    episodes = [
        {"sha256": f"{i}" * 64, "role": "adaptation", "period_s": period}
        for i, period in enumerate(periods_s)
    ]
    return {**report(**gap), "where": {}, "evidence": {"timestep_s": step_s, "episodes": episodes}}


def friction(share=0.6, **more):
    level = {"value": 0.2104, "unit": "m/s^2", "ci95": [0.1904, 0.2304]}
    return {
        "effect": "coulomb_friction",
        "channel": "joint",
        "estimate": {"level": level},
        "share": share,
        **more,
    }


def test_an_effect_is_told_with_its_level_its_part_and_the_errors():
    assert sentence(report([friction()], numbers=0.2)) == (
        "Coulomb friction at the joint, level 0.210 ± 0.020 m/s², closes 91 % of the gap, refitted "
        "parameters 9.3 %. The held-out error falls from 0.21 to 0.013; noise alone makes 0.012."
    )


def test_an_effect_is_told_with_the_parameter_that_it_declares_first_however_json_is_sorted():
    hysteresis = friction() | {
        "effect": "hysteresis",
        "parameters": ["level", "distance"],
        "estimate": {
            "level": {"value": 0.221, "unit": "N*m", "ci95": [0.2, 0.242]},
            "distance": {"value": 0.5, "unit": "rad", "ci95": [0.4, 0.6]},
        },
    }
    stored = json.loads(canonical_bytes(hysteresis))
    assert list(stored["estimate"]) == ["distance", "level"]
    assert "level 0.221 ± 0.021" in sentence(report([hysteresis]))
    assert sentence(report([stored])) == sentence(report([hysteresis]))
    before = {k: v for k, v in stored.items() if k != "parameters"}
    assert "distance 0.50 ± 0.10" in sentence(report([before]))


def test_new_numbers_come_first_where_they_explain_most():
    told = sentence(report([friction()]))
    assert told.startswith(
        "Refitting the nominal parameters closes 68 % of the gap. Coulomb friction at the joint, "
    )


def test_a_robots_joint_is_named_and_so_is_what_cannot_be_told():
    rival = [{"effect": "stribeck_friction", "joint": "elbow"}]
    told = sentence(report([friction(joint="elbow")], numbers=0.2, rivals=[rival]))
    assert "Coulomb friction at elbow" in told
    assert told.endswith("The recordings cannot tell this from Stribeck friction at elbow.")


@pytest.mark.parametrize(
    ("verdict", "after", "words"),
    [
        ("no_gap", 0.013, "The nominal model already predicts as well as the noise allows."),
        (
            "unknown_effect",
            0.1,
            "A gap remains that no combination of known effects explains. The held-out error falls "
            "from 0.21 to 0.1; noise alone makes 0.012.",
        ),
        (
            "parameters_only",
            0.013,
            "Refitting the nominal parameters closes the gap. No effect is missing. The held-out "
            "error falls from 0.21 to 0.013; noise alone makes 0.012.",
        ),
        (
            "parameters_only",
            0.1,
            "Refitting the nominal parameters closes most of the gap. No known effect closes a "
            "material part of the rest. The held-out error falls from 0.21 to 0.1; noise alone "
            "makes 0.012.",
        ),
    ],
)
def test_other_verdicts_have_their_words(verdict, after, words):
    closed = None if verdict == "no_gap" else 0.9
    assert sentence(report(verdict=verdict, after=after, closed=closed)) == words


def test_the_waterfall_adds_up_to_the_whole():
    two = report([friction(0.3), {**friction(0.1), "effect": "backlash"}], same=0.2)
    parts = waterfall(two)
    assert [p["what"] for p in parts] == [
        "integration and start",
        "refitted parameters",
        "Coulomb friction",
        "backlash",
        "not explained",
        "noise floor",
    ]
    assert sum(p["share"] for p in parts) == pytest.approx(1.0)
    assert parts[2]["share"] == pytest.approx(3.0 * parts[3]["share"])
    assert parts[0]["share"] == pytest.approx(1.0 - (0.2 / 0.21) ** 2)
    assert parts[1]["share"] == pytest.approx((0.2**2 - 0.12**2) / 0.21**2)


def test_what_the_answers_integration_takes_is_not_told_as_new_numbers():
    text = sentence(report([friction()], same=0.12))
    assert "closes 32 % of the gap, integration and start 68 %." in text
    assert "refitted parameters" not in text
    text = sentence(report([friction()], same=0.18, numbers=0.05))
    assert text.startswith(
        "Refitting the nominal parameters closes 68 % of the gap, integration and start 27 %. "
    )
    text = sentence(report(verdict="parameters_only", same=0.1, numbers=0.013))
    assert text.startswith(
        "Refitting the nominal parameters closes 22 % of the gap, integration and start 78 %. No "
        "effect is missing."
    )
    text = sentence(report(verdict="parameters_only", same=0.21, after=0.2))
    assert text.startswith(
        "Refitting the nominal parameters closes 9.3 % of the gap. No known effect"
    )


def test_what_both_could_close_is_counted_for_the_one_that_closes_more_alone():
    imitated = report([friction()], numbers=0.1, after=0.013)
    imitated["gap"]["effects_only"] = 0.02
    parts = {p["what"]: p["share"] for p in waterfall(imitated)}
    assert list(parts)[1:3] == ["Coulomb friction", "refitted parameters"]
    assert parts["Coulomb friction"] == pytest.approx(1.0 - (0.02 / 0.21) ** 2)
    assert parts["refitted parameters"] == pytest.approx((0.02**2 - 0.013**2) / 0.21**2)
    assert sum(parts.values()) == pytest.approx(1.0)
    assert sentence(imitated).startswith(
        "Coulomb friction at the joint, level 0.210 ± 0.020 m/s², closes 99.4 % of the gap."
    )
    wrong = report([friction()], numbers=0.05, after=0.013)
    wrong["gap"]["effects_only"] = 0.18
    assert sentence(wrong).startswith("Refitting the nominal parameters closes 95 % of the gap.")
    only_together = report([friction()], same=0.1, numbers=0.15, after=0.02)
    only_together["gap"]["effects_only"] = 0.12
    parts = {p["what"]: p["share"] for p in waterfall(only_together)}
    assert parts["refitted parameters"] == 0.0
    assert parts["Coulomb friction"] == pytest.approx((0.1**2 - 0.02**2) / 0.21**2)


def test_the_effect_that_closes_most_comes_first():
    small = friction(0.2) | {"effect": "cogging"}
    text = sentence(report([small, friction(0.6)], numbers=0.2))
    assert 0 <= text.index("Coulomb") < text.index("ogging")


def test_a_part_of_the_whole_is_not_rounded_up_to_it():
    assert [percent(x) for x in (0.985, 0.9951, 0.99996, 1.0)] == [
        "98 %",
        "99.5 %",
        "99.9 %",
        "100 %",
    ]


def test_an_effect_that_takes_nothing_held_out_is_named_without_a_part():
    text = sentence(report([friction()], same=0.012, after=0.013))
    assert text.startswith("Coulomb friction at the joint, level 0.210 ± 0.020 m/s² acts. The")


def test_what_the_nearest_composition_takes_is_not_told_as_new_numbers():
    parts = {
        p["what"]: p["share"]
        for p in waterfall(report(verdict="unknown_effect", numbers=0.2, after=0.1))
    }
    assert parts["refitted parameters"] == pytest.approx(1.0 - (0.2 / 0.21) ** 2)
    assert parts["nearest combination"] == pytest.approx((0.2**2 - 0.1**2) / 0.21**2)


def test_a_model_that_is_only_integrated_or_started_otherwise_keeps_its_numbers():
    text = sentence(report(verdict="no_gap", same=0.014, numbers=0.013, after=0.013))
    assert text == (
        "No effect is missing and no parameter has to change. The integration scheme and the "
        "filtered start of this diagnosis close 99.9 % of the gap. The held-out error falls from "
        "0.21 to 0.013; noise alone makes 0.012."
    )


def test_a_report_of_before_tells_integration_and_numbers_as_one():
    old = report([friction()])
    del old["gap"]["same_numbers"]
    assert [p["what"] for p in waterfall(old)][:2] == ["refitted parameters", "Coulomb friction"]
    assert sentence(old) == sentence(report([friction()]))
    old = report(verdict="no_gap", after=0.014)
    del old["gap"]["same_numbers"]
    assert sentence(old).startswith("No effect is missing and no parameter has to change. The")


def test_shares_are_never_negative_however_the_errors_lie():
    for same, numbers, after, floor in (
        (0.21, 0.3, 0.1, 0.2),
        (0.4, 0.1, 0.2, 0.05),
        (0.05, 0.21, 0.21, 0.21),
    ):
        errors = {"same": same, "numbers": numbers, "after": after, "floor": floor}
        parts = waterfall(report([friction()], **errors))
        assert min(p["share"] for p in parts) >= 0.0
        assert sum(p["share"] for p in parts) == pytest.approx(1.0)


def test_without_a_gap_there_is_no_waterfall():
    assert waterfall(report(verdict="no_gap", closed=None)) == []


def test_numbers_are_written_to_their_uncertainty():
    assert plus_minus(0.23364, 0.01025) == "0.234 ± 0.010"
    assert plus_minus(-3.14159, 0.5) == "−3.14 ± 0.50"
    assert plus_minus(1234.5, 200.0) == "1230 ± 200"
    assert plus_minus(2.0, 0.0) == "2"
    assert short(None) == "–"
    assert composition([]) == "no effect"


@pytest.mark.parametrize("period_s", [0.005, 0.0051, 0.01, 0.0333, 0.00495])
def test_a_clock_of_whole_steps_is_passed_over(period_s):
    assert warnings(recorded(period_s)) == []


@pytest.mark.parametrize(
    ("period_s", "told"), [(0.0053, "5.3 ms"), (0.0083, "8.3 ms"), (0.004, "4 ms")]
)
def test_a_clock_off_the_declared_step_is_told(period_s, told):
    (warning,) = warnings(recorded(0.005, period_s))
    assert warning.startswith(f"{'1' * 12} is off the declared step: recorded every {told}, ")
    (named,) = warnings(recorded(0.005, period_s), {"1" * 64: "run-2"})
    assert named.startswith("run-2 is off")
    assert "declares steps of 5 ms" in warning


def test_new_numbers_that_do_worse_than_nominal_are_told_where_there_is_a_gap():
    (warning,) = warnings(recorded(0.005, before=0.21, numbers=0.3))
    assert "held-out predictions worse (0.3, was 0.21)" in warning
    assert warnings(recorded(0.005, before=0.013, numbers=0.02)) == []
    assert warnings(recorded(0.005, before=0.21, numbers=0.215)) == []


def test_a_report_of_before_says_nothing_of_its_clock():
    old = recorded(0.0053)
    del old["evidence"]["timestep_s"]
    assert warnings(old) == []


def test_recordings_of_one_loop_are_told_alike():
    assert off_step(0.005303, 0.005) == off_step(0.005326, 0.005)
    assert "every 120 ms" in off_step(0.1203, 0.1)


def test_the_sentence_names_the_numbers_that_certainly_moved():
    document = report(verdict="parameters_only", same=0.21, numbers=0.013) | {
        "parameters": {
            "frictionloss(elbow)": {"nominal": 0.078, "value": 0.168, "ci95": [0.109, 0.227]},
            "damping(elbow)": {"nominal": 0.001, "value": 0.0, "ci95": [0.0, 0.004]},
            "b": {"nominal": 1.0, "value": 1.25, "ci95": [1.24, 1.26]},
        }
    }
    text = sentence(document)
    assert "frictionloss(elbow) 0.078 to 0.168 ± 0.059, b 1 to 1.250 ± 0.010" in text
    assert "damping" not in text
    assert text.endswith(
        "No effect is missing. The held-out error falls from 0.21 to 0.013; noise alone makes "
        "0.012."
    )


def test_an_unknown_effect_says_what_comes_nearest():
    document = report(verdict="unknown_effect", after=0.1) | {
        "nearest": {"effects": ["backlash", "constant_force"], "leaves": 0.719}
    }
    assert (
        "The nearest is backlash with constant force, with which 72 % of the "
        "error after refitting remains" in sentence(document)
    )
    assert "nearest" not in sentence(report(verdict="unknown_effect", after=0.1))


def finding(fault="command_sign", **more):
    return {
        "finding": fault,
        "channel": "u",
        "joint": None,
        "episodes": ["0" * 64],
        "evidence": "the command drives the other way",
        "mend": "Change the sign of u.",
        "applied": False,
        **more,
    }


def test_a_fault_that_misleads_comes_before_the_answer():
    document = recorded(0.005) | {"findings": [finding(), finding("gap", applied=True)]}
    assert sentence(document).startswith("Mend the log first: command sign of u. As recorded: ")
    assert "Mend" not in sentence(recorded(0.005) | {"findings": [finding("gap", applied=True)]})


def test_faults_of_a_kind_are_told_once():
    gaps = [finding("gap", channel=None, evidence="no sample for 1 s", mend="Cut.", applied=True)]
    told = warnings(recorded(0.005) | {"findings": [finding(), *3 * gaps]})
    assert told[0] == ("Command sign of u: the command drives the other way. Change the sign of u.")
    assert told[1] == "Gap: no sample for 1 s; 2 more like it. Done: cut."


def test_what_is_served_is_told_where_nothing_is_better_than_the_nominal_model():
    document = recorded(0.005)
    document["evidence"]["served"] = "nominal"
    assert any("returns the nominal model" in w for w in warnings(document))


def test_a_part_that_certainly_acts_says_what_its_law_leaves():
    text = sentence(report([friction()]) | {"incomplete": 0.393})
    assert "The effect is certain, but its equation is incomplete" in text
    assert "39 % of the squared error after refitting remains" in text
    assert "certainly" not in sentence(report([friction()]) | {"incomplete": None})


def test_stuck_samples_are_called_so():
    told = warnings(recorded(0.005) | {"findings": [finding("stuck", channel="q")]})
    assert told[0].startswith("Stuck samples of q: ")


@pytest.mark.parametrize(
    ("number", "text"),
    [
        (0.0, "0"),
        (-0.0, "0"),
        (1234.5, "1230"),
        (123456.0, "123000"),
        (0.00123, "0.00123"),
        (-0.5, "−0.5"),
        (5.37e-5, "5.37 × 10⁻⁵"),
        (-1.34e-12, "−1.34 × 10⁻¹²"),
        (2.5e7, "2.5 × 10⁷"),
        (999.9, "1000"),
    ],
)
def test_numbers_are_written_as_engineers_write_them(number, text):
    assert short(number) == text


@pytest.mark.parametrize(
    ("value", "half", "text"),
    [
        (123456.0, 2345.0, "123500 ± 2300"),
        (5.37e-5, 1.2e-6, "(5.37 ± 0.12) × 10⁻⁵"),
        (0.0, 0.02, "0.000 ± 0.020"),
    ],
)
def test_an_uncertainty_and_its_value_share_their_digits(value, half, text):
    assert plus_minus(value, half) == text


def test_an_effect_that_hardly_matters_is_not_in_the_headline():
    slight = {**friction(0.01), "effect": "quadratic_drag"}
    text = sentence(report([friction(), slight], numbers=0.2))
    assert text.startswith("Coulomb friction at the joint")
    assert "Quadratic drag acts, too, but closes less than 5 % of the gap" in text
    assert "Quadratic drag at the joint" in sentence(report([slight], numbers=0.2))
