"""Which of the four an operation is."""

import pytest

from trueup.ledger.operation import JOBS, Operation, of_artifact, of_job
from trueup.model.kinds import KINDS
from trueup_service.actions.submit_job import SUBMIT

OPERATIONS = {
    "fit": "model correction", "diagnose": "model correction", "gate": "model correction",
    "calibrate": "monitoring", "watch": "monitoring",
    "validate": "monitoring", "blindtrial": "monitoring", "recompute": "monitoring",
    "compare": "monitoring", "openloop": "monitoring", "closedloop": "monitoring",
    "consistency": "monitoring",
    "randomise": "model correction",
    "excite": "monitoring",
}  # fmt: skip


@pytest.mark.parametrize("kind", [*SUBMIT, "watch"])
def test_every_job_is_one_of_the_four(kind):
    assert of_job(kind, {}) == OPERATIONS[kind]
    assert Operation.ADAPTATION not in JOBS.values()  # the controller is never changed


def test_a_fit_that_keeps_the_form_identifies():
    assert of_job("fit", {"method": "identify"}) == "parameter identification"
    assert of_job("fit", {"method": "residual"}) == "model correction"


def test_an_artifact_is_what_it_changes():
    by_name = {kind: of_artifact(kind, {"effects": [{"effect": "cogging"}]}) for kind in KINDS}
    assert by_name["nominal"] is None
    assert by_name["identified"] == "parameter identification"
    assert (
        by_name["residual"]
        == by_name["corrected"]
        == by_name["blind"]
        == by_name["conditioned"]
        == "model correction"
    )
    assert of_artifact("corrected", {"effects": []}) == "parameter identification"
    assert (
        of_artifact("corrected", {"effects": [{"effect": "sensor_quantization"}]})
        == "parameter identification"
    )
