"""One log, one answer: a diagnosis, and a gate's decision, are the same under other processors'
arithmetic.

The kernels that a child process is given are other processors' own; `python -m bench processors`
holds more of them against each other, on more cases.
"""

import json
from pathlib import Path

import pytest

from tests.support.case import write_case
from tests.support.processors import VARIANTS, bits, difference, start
from tests.support.simulated import recorded_twice
from trueup.gate.recompute import differences
from trueup.simulate.noise import NoiseModel

OTHERS = ("BLAS for Haswell", "BLAS for Nehalem", "C library without FMA")


@pytest.fixture(scope="module")
def answers(tmp_path_factory):
    """Reports and decisions of each processor; all judge the model that the first of them made."""
    folder = tmp_path_factory.mktemp("cases")
    plant, episodes, _ = recorded_twice("A1", ["coulomb_friction"], 11, law=NoiseModel(0.7))
    case = folder / "cases" / "pendulum"
    case.mkdir(parents=True)
    write_case(case, plant, episodes)
    model, names = folder / "0" / case.name, ("as the machine is", *OTHERS)
    begun = [
        lambda i=i, name=name: start(VARIANTS[name], folder / f"{i}.json", [case, model])
        for i, name in enumerate(names)
    ]
    _done(begun[0]())  # it leaves its model where all of them look for it, itself included
    for child in [begin() for begin in begun[1:]]:
        _done(child)
    return {name: json.loads((folder / f"{i}.json").read_text()) for i, name in enumerate(names)}


@pytest.mark.skipif(
    " fma " not in Path("/proc/cpuinfo").read_text(), reason="a processor without FMA has no other"
)
def test_the_children_compute_as_other_processors_do():
    haswell, nehalem, plain = (bits(VARIANTS[name]) for name in OTHERS)
    assert haswell[0] != nehalem[0]
    assert plain[1] != haswell[1]


def _done(child):
    _, said = child.communicate(timeout=300)
    assert child.returncode == 0, said


@pytest.mark.parametrize("name", OTHERS)
def test_a_diagnosis_is_the_same_under_the_arithmetic_of(name, answers):
    ours, theirs = (
        next(report for key, report in answers[of].items() if key != "decision")
        for of in ("as the machine is", name)
    )
    assert [e["effect"] for e in ours["effects"]] == ["coulomb_friction"]
    found = difference(ours, theirs)
    assert found.is_negligible, found


@pytest.mark.parametrize("name", OTHERS)
def test_a_decision_is_recomputed_under_the_arithmetic_of(name, answers):
    ours, theirs = answers["as the machine is"]["decision"], answers[name]["decision"]
    assert ours["accepted"]
    assert differences(ours, theirs) == []
