"""The chapter through the service: from uploaded episodes, over REST, on both storages. Studies
give one answer on the service and on a folder, and decisions disclose what a study has shown."""

import hashlib
import json

import pytest

from tests.support.service import ROOT, command
from trueup.chapter.data import SHIFTED
from trueup.chapter.published import PUBLISHED
from trueup_client import Client
from trueup_client.problem import Problem

CHAPTER = ROOT / "examples" / "chapter"
SINE = ["--seed", "7", "--amplitude", "0.55", "--frequency-hz", "0.15", "--effort", "0.02"]
REGIMES = {
    "nominal": "nominal plant",
    "shifted": "deployment plant",
    "delayed": "deployment + sensor delay of 3",
    "reduced_authority": "deployment + u_max 0.5",
}


def fit(client, **request):
    return client.wait(client.submit("chapter", {"kind": "fit", **request})["id"])["result"]


@pytest.fixture(scope="module")
def fitted(service):
    """The results of every fit of the chapter by its name, and the digest of its gate."""
    command(service, "plant", "register", str(CHAPTER))
    files = [CHAPTER / "training", *(CHAPTER / f"{n}.mcap" for n in ("adaptation", "validation"))]
    command(service, "upload", "chapter", *map(str, files), str(CHAPTER / "test.mcap"))
    mismatched = CHAPTER / "mismatched.mcap"
    with Client(service.url) as client:
        results = {
            name: fit(client, method=name)
            for name in ("identify", "blind", "conditioned", "residual")
        }
        command(service, "upload", "chapter", str(mismatched))
        rules = json.loads((CHAPTER / "gate.json").read_text())
        results["gate"] = client.declare_gate("chapter", rules)["digest"]
        digest = hashlib.sha256(mismatched.read_bytes()).hexdigest()
        results["b"] = fit(client, method="residual", episodes=[digest])
    return results


def study(service, name, target, folder, *options):
    out = folder / name
    command(service, name, str(target), "--out", str(out), *options)
    assert (out / "report.html").read_text().startswith("<!doctype html>")
    return json.loads((out / "report.json").read_text())


def by_regime(document):
    return {
        r["regime"]: {m["model"].split()[-1]: m["tracking"] for m in r["models"]}
        for r in document["regimes"]
    }


def models_of(fitted):
    chosen = (fitted[name]["artifact"][:12] for name in ("blind", "conditioned", "residual"))
    return [x for digest in ("1", *chosen) for x in ("--model", digest)]


def test_a_is_accepted_and_b_is_rejected_by_the_chapters_gate(service, fitted):
    printed, verdicts = PUBLISHED["Gate"], {}
    with Client(service.url) as client:
        for name, candidate in (("A", fitted["residual"]), ("B", fitted["b"])):
            job = {"kind": "gate", "candidate": candidate["artifact"], "gate": fitted["gate"]}
            result = client.wait(client.submit("chapter", job)["id"])["result"]
            decision = client.decision("chapter", result["decision"])["document"]
            verdicts[name] = decision["accepted"]
            errors = decision["figures"]["candidate"]
            assert f"{errors['one_step'][0]:.5f}" == printed[name]["one-step"]
            assert f"{errors['rollout'][0]:.5f}" == printed[name]["rollout mean"]
    assert verdicts == {"A": True, "B": False}


def test_the_closed_loops_of_the_service_are_the_chapters_tables(service, fitted, tmp_path):
    options = [*models_of(fitted), "--sweep-ticks", "0", "--sweep-ticks", "8", *SINE]
    report = study(service, "closedloop", "chapter", tmp_path, *options)
    assert report["machine"]["model"] == "v2 identified"  # the newest identification stands in
    assert report["artifacts"]["v2 identified"] == fitted["identify"]["artifact"]
    for regime, errors in by_regime(report).items():
        assert {m: f"{x:.5f}" for m, x in errors.items()} == (
            PUBLISHED["Tracking error"][REGIMES[regime]]
        )
    falls = [s["tracking"] for s in report["sweep"] if s["model"] == "v1 nominal"]
    assert falls[1] < falls[0]


def test_the_open_loops_of_the_service_are_the_chapters_table(service, fitted, tmp_path):
    report = study(service, "openloop", "chapter", tmp_path, *models_of(fitted))
    (episode,) = report["episodes"]
    assert episode["role"] == "test"  # what no decision reads is rolled out by default
    for model in report["models"]:
        printed = PUBLISHED["Open loop"][model["model"].split()[-1]]
        assert {str(e["steps"]): f"{e['mean']:.4f}" for e in model["errors"]} == printed


def test_a_study_of_a_folder_is_the_services(service, fitted, tmp_path):
    ours = study(service, "openloop", "chapter", tmp_path, "--model", "1", "--model", "2")
    locally = study(service, "openloop", CHAPTER, tmp_path / "local")
    # the folder holds the mismatched episode, too, so its stand-in, and the bound, are others
    here, there = (
        [(e["steps"], e["mean"], e["max"], e["windows"]) for e in of["models"][0]["errors"]]
        for of in (ours, locally)
    )
    assert here == there
    loops = study(service, "closedloop", CHAPTER, tmp_path, "--regime", "nominal", *SINE)
    nominal = PUBLISHED["Tracking error"]["nominal plant"]["nominal"]
    assert f"{by_regime(loops)['nominal']['nominal']:.5f}" == nominal


def test_a_family_is_drawn_on_the_service_and_answers_where_a_plant_lies(service, fitted, tmp_path):
    family = str(CHAPTER / "family.json")
    options = ["--family", family, "--seed", "20240517"]
    report = study(service, "randomise", "chapter", tmp_path, *options)
    blind = report["artifacts"]["blind"]
    with Client(service.url) as client:
        kinds = {d: client.artifact("chapter", d)["kind"] for d in report["artifacts"].values()}
        assert sorted(kinds.values()) == ["blind", "conditioned"]
        shifted = dict(zip("kcb", SHIFTED, strict=True))
        for numbers, inside in (
            (None, (True, True)),
            (shifted, (False, False)),
            ({"k": 0.65, "c": 0.5, "b": 1.0}, (True, False)),
            ({"k": 1.0}, (None, None)),
        ):
            answer = client.membership("chapter", blind, parameters=numbers)
            boxes = answer["family_box"]["inside"], answer["sample_box"]["inside"]
            assert boxes == inside, numbers
        # the training episodes that were uploaded are the same draws
        fitted_blind = client.membership("chapter", fitted["blind"]["artifact"])
        assert fitted_blind["family_box"] is None
        assert fitted_blind["sample_box"] == client.membership("chapter", blind)["sample_box"]
        with pytest.raises(Problem, match="no family") as refused:
            client.membership("chapter", fitted["residual"]["artifact"])
        assert refused.value.code == "not-found"


def test_what_a_context_costs_is_in_the_fits_report(fitted):
    report = fitted["conditioned"]["fit"]
    assert report["context"]["by"] == "identification"
    assert {n: f"{x:.3f}" for n, x in report["context"]["parameters"].items()} == {
        "k": "1.250",
        "c": "0.620",
        "b": "0.820",
    }
    own, *wrong = [r["rollout"] for r in report["context_cost"]]
    assert min(wrong) > 1000.0 * own


def test_a_decision_discloses_that_an_open_loop_had_shown_its_episodes(service, fitted):
    with Client(service.url) as client:
        (held_out,) = [e["digest"] for e in client.episodes("chapter") if e["role"] == "validation"]
        candidate = fitted["identify"]["artifact"]
        request = {"kind": "openloop", "versions": [candidate], "episodes": [held_out]}
        shown = client.wait(client.submit("chapter", request)["id"])
        assert shown["reads"][held_out] == "compare"
        later = {
            **json.loads((CHAPTER / "gate.json").read_text()),
            "rules": [{"rule": "rollout_improves", "ratio": 0.9}],
            "follows": fitted["gate"],
            "because": "a stricter one",
        }
        gate = client.declare_gate("chapter", later)
        job = {"kind": "gate", "candidate": candidate, "gate": gate["digest"]}
        decided = client.wait(client.submit("chapter", job)["id"])
        document = client.decision("chapter", decided["result"]["decision"])["document"]
    assert document["known"]["compared"] == [shown["id"]]
    command(service, "audit", "verify")


REFUSED = [
    ({"kind": "closedloop", "versions": ["0" * 64]}, "not-found"),
    ({"kind": "closedloop", "authority": 1.5}, "invalid-request"),
    ({"kind": "closedloop", "seeds": []}, "invalid-request"),
    ({"kind": "openloop", "horizons_steps": [0]}, "invalid-request"),
    ({"kind": "openloop", "machine": "f" * 64}, "not-found"),
    ({"kind": "randomise"}, "not-identifiable"),
    ({"kind": "randomise", "diagnosis": "0" * 32}, "not-found"),
    ({"kind": "fit", "method": "blind", "training": ["0" * 64]}, "not-found"),
]


def test_what_cannot_be_studied_is_refused_with_what_to_do(service, fitted):
    with Client(service.url) as client:
        for request, code in REFUSED:
            with pytest.raises(Problem) as refused:
                client.submit("chapter", request)
            assert refused.value.code == code, request
            assert refused.value.hint
        wrong = {
            "numbers": [{"number": "stiffness", "distribution": "uniform", "low": 0, "high": 1}]
        }
        job = client.submit("chapter", {"kind": "randomise", "randomisation": wrong})["id"]
        with pytest.raises(Problem) as failed:
            client.wait(job)
        assert failed.value.code == "bad-randomisation"
        assert "Parameters are k, c, b" in failed.value.hint
