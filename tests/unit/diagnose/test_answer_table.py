"""The answer table: which effect, where, how large, how much, how sure, and what is left."""

import pytest

from tests.unit.diagnose.test_summary_text import friction, report
from trueup.diagnose.answer_table import equations, left_over, rows, symbols, title


def answered(*effects, rivals=(), hypotheses=(), parameters=None, **gap):
    return {
        **report(effects, rivals=rivals, **gap),
        "parameters": parameters or {},
        "evidence": {"hypotheses": list(hypotheses)},
    }


def hypothesis(validation, *effects, parameters="fitted", answer=False):
    return {
        "effects": list(effects),
        "validation": validation,
        "parameters": parameters,
        "answer": answer,
    }


FRICTION = hypothesis(1.0, "coulomb_friction", answer=True)
MOVED = {"b": {"nominal": 0.37, "value": 0.378, "ci95": [0.372, 0.384], "unit": "m/s^2/V"}}


def test_the_table_answers_which_where_how_large_how_much_and_how_sure():
    told = answered(
        friction(port="force"),
        numbers=0.2,
        hypotheses=[FRICTION, hypothesis(4.0, "backlash"), hypothesis(9.0, parameters="nominal")],
    )
    first, *_ = rows(told)
    assert (first.what, first.where) == ("Coulomb friction", "force at the joint")
    assert first.sizes == (("level", "0.210 ± 0.020 m/s²"),)
    assert first.share == "91 %"
    assert first.sure == "certain: the next best explanation, backlash, errs 2 times as much"


def test_what_closes_most_comes_first_and_shares_add_up():
    told = rows(answered(friction(), parameters=MOVED, numbers=0.1, hypotheses=[FRICTION]))
    assert [row.what for row in told] == ["nominal parameters", "Coulomb friction"]
    assert told[0].sizes == (("b", "0.3780 ± 0.0060 m/s²/V, was 0.37"),)
    assert sum(float(row.share.split()[0]) for row in told) == pytest.approx(100.0, abs=1.0)


@pytest.mark.parametrize(
    ("rivals", "hypotheses", "sure"),
    [
        ([["stribeck_friction"]], [FRICTION], "not told from Stribeck friction"),
        ([], [FRICTION], "no explanation without it was compared"),
        (
            [],
            [FRICTION, hypothesis(0.9, "backlash", "deadband")],
            "likely: backlash with deadband fits as well, with more effects",
        ),
        (
            [],
            [FRICTION, hypothesis(1.21, "backlash")],
            "certain: the next best explanation, backlash, errs 10 % more",
        ),
    ],
)
def test_how_sure_an_effect_is(rivals, hypotheses, sure):
    told = rows(answered(friction(), numbers=0.2, rivals=rivals, hypotheses=hypotheses))
    assert told[0].sure == sure


def test_what_is_slight_stands_below_and_what_is_not_explained_last():
    slight = {**friction(0.01), "effect": "quadratic_drag"}
    told = rows(answered(slight, friction(), numbers=0.2, after=0.06, hypotheses=[FRICTION]))
    assert [(row.what, row.is_slight) for row in told][-2:] == [
        ("quadratic drag", True),
        ("not explained", True),
    ]
    assert not told[0].is_slight


def test_without_a_gap_there_is_no_row():
    assert rows(answered(verdict="no_gap", closed=None)) == []


@pytest.mark.parametrize(
    ("verdict", "after", "words"),
    [
        ("parameters_only", 0.013, "The nominal parameters are off, and no effect is missing"),
        (
            "parameters_only",
            0.1,
            "The nominal parameters are off, and no known effect explains the rest",
        ),
        ("no_gap", 0.013, "The nominal model already predicts as well as the noise allows"),
        (
            "unknown_effect",
            0.1,
            "A gap remains that no combination of known effects explains",
        ),
    ],
)
def test_each_verdict_has_a_title(verdict, after, words):
    assert title(answered(verdict=verdict, after=after)) == words


def test_the_title_names_the_effects_and_says_where_parameters_do_most():
    assert title(answered(friction(), numbers=0.2)) == "Coulomb friction"
    assert title(answered(friction(), numbers=0.1)) == (
        "The nominal parameters are off, and Coulomb friction is missing"
    )


@pytest.mark.parametrize(
    ("after", "words"),
    [
        (0.03, "3.0 % of its motion, which hardly matters"),
        (0.2, "a controller that replans sooner meets smaller errors"),
        (0.5, "do not rely on predictions over this horizon"),
    ],
)
def test_what_is_left_is_said_in_units_and_whether_it_matters(after, words):
    told = answered(friction(), before=0.9, numbers=0.8, after=after)
    told["gap"] |= {
        "horizon_s": 2.0,
        "channels": {"q": {"before": 0.9, "after": after, "deviation": 0.4, "unit": "rad"}},
    }
    text = left_over(told)
    assert text.startswith("Over 2 s the corrected model still errs by ")
    assert f"{0.4 * after:.3g} rad in q" in text
    assert words in text


def test_nothing_is_said_to_be_left_where_only_noise_is():
    assert left_over(answered(friction(), after=0.013)) == ""


def test_the_corrected_model_is_written_with_its_numbers():
    told = answered(
        friction(equation="|friction| <= level"), parameters=MOVED, hypotheses=[FRICTION]
    )
    told["equation"] = "a = -c v + b u, per unit mass"
    assert equations(told) == [
        ("nominal form", "a = −c v + b u, per unit mass", "b = 0.3780 ± 0.0060 m/s²/V"),
        ("Coulomb friction", "|friction| ≤ level", "level = 0.210 ± 0.020 m/s²"),
    ]
    assert symbols("a - c q^3") == "a − c q³"


def test_an_older_report_has_no_equations():
    assert equations(answered(friction())) == []
