"""The chapter through the service: from uploaded episodes, over REST. Studies give one answer on
the service and on a folder, and decisions disclose what a study has shown.

On embedded storage `test_docs` takes the same steps: it runs `docs/howto-chapter.md`.
"""

import hashlib
import json

import pytest

from tests.support.service import ROOT, command
from trueup.chapter.data import SHIFTED
from trueup.chapter.published import PUBLISHED
from trueup_cli.replay import Agreed
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
def service(scaled_service):
    return scaled_service


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


@pytest.fixture(scope="module")
def decided(service, fitted):
    """The decisions on candidates A and B, by name."""
    decisions = {}
    with Client(service.url) as client:
        for name, candidate in (("A", fitted["residual"]), ("B", fitted["b"])):
            job = {"kind": "gate", "candidate": candidate["artifact"], "gate": fitted["gate"]}
            result = client.wait(client.submit("chapter", job)["id"])["result"]
            decisions[name] = client.decision("chapter", result["decision"])
    return decisions


def test_a_is_accepted_and_b_is_rejected_by_the_chapters_gate(decided):
    for name, accepted in (("A", True), ("B", False)):
        assert decided[name]["accepted"] is accepted
        errors, printed = decided[name]["document"]["figures"]["candidate"], PUBLISHED["Gate"][name]
        assert f"{errors['one_step'][0]:.5f}" == printed["one-step"]
        assert f"{errors['rollout'][0]:.5f}" == printed["rollout mean"]


def test_a_decision_is_replayed_by_its_first_digits(service, decided):
    replayed = command(service, "replay", decided["B"]["digest"][:12]).stdout
    assert "agrees" in replayed
    refused = command(service, "replay", "0123", check=False)
    assert refused.returncode == 1
    assert "no decision begins with '0123'" in refused.stderr


def test_a_prediction_errs_by_what_the_gate_says_to_the_last_digit(service, decided, tmp_path):
    document, model = decided["A"]["document"], tmp_path / "model"
    command(service, "fetch", "chapter", str(model), "--artifact", document["candidate"][:12])
    gate = json.loads((CHAPTER / "gate.json").read_text())["scoring"]
    options = ["--model", str(model), "--episode", str(CHAPTER / "validation.mcap")]
    options += ["--horizon", str(gate["horizon_s"]), "--out", str(tmp_path / "p.csv"), "--json"]
    told = json.loads(command(service, "predict", *options).stdout)
    assert told["gate"][gate["windows"]] == document["figures"]["candidate"]["rollout"][0]


def verified(service, *options):
    printed = json.loads(command(service, "audit", "verify", "--json", *options).stdout)
    assert printed["findings"] == []
    return printed["decisions"], printed["recomputed"]


def test_a_verification_recomputes_at_once_and_only_what_did_not_agree_before(service, decided):
    everything, _ = verified(service)
    assert everything >= len(decided)
    assert verified(service) == (everything, 0)
    assert verified(service, "--again") == (everything, everything)
    assert verified(service, "--again", "--since", "2999-01-01") == (0, 0)
    assert verified(service, "--again", "--since", "2000-01-01T00:00") == (everything, everything)
    assert "agreed before" in command(service, "audit", "verify").stdout
    refused = command(service, "audit", "verify", "--since", "yesterday", check=False)
    assert refused.returncode == 1
    assert "not-a-time" in refused.stderr


def test_agreements_of_other_code_do_not_count_and_a_broken_file_keeps_nothing(tmp_path):
    file = tmp_path / "kept.json"
    Agreed(file).add("a" * 64)
    assert "a" * 64 in Agreed(file)
    file.write_text(file.read_text().replace('"code": "', '"code": "0'))
    assert "a" * 64 not in Agreed(file)
    file.write_text("{")
    assert "a" * 64 not in Agreed(file)
    blocked = tmp_path / "file"
    blocked.write_text("")
    Agreed(blocked / "kept.json").add("a" * 64)  # where nothing can be written, nothing is kept


def test_the_closed_loops_of_the_service_are_the_chapters_tables(service, fitted, tmp_path):
    options = [*models_of(fitted), "--sweep-ticks", "0", "--sweep-ticks", "8", *SINE]
    report = study(service, "closedloop", "chapter", tmp_path, *options)
    assert report["machine"]["model"] == "v2 identified"  # the newest identification stands in
    assert report["artifacts"]["v2 identified"] == fitted["identify"]["artifact"]
    assert list(by_regime(report)) == list(REGIMES)
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
    assert [m["model"].split()[-1] for m in report["models"]] == list(PUBLISHED["Open loop"])
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
        for wrong in (float("nan"), float("inf"), 10**400, True, "1"):
            with pytest.raises(Problem, match="no JSON object of numbers") as refused:
                client.membership("chapter", blind, parameters={"k": wrong})
            assert (refused.value.status, refused.value.code) == (422, "bad-randomisation")
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


def test_the_service_designs_the_excitation_that_the_command_designs(service, fitted, tmp_path):
    """The named episodes are those of the case folder, and every file agrees."""
    case = tmp_path / "case"
    case.mkdir()
    for name in ("plant.json", "adaptation.mcap"):
        (case / name).write_bytes((CHAPTER / name).read_bytes())
    options = ("--spread", "0.2", "--duration-s", "2", "--seed", "3")
    command(service, "excite", str(case), "--out", str(tmp_path / "here"), *options)
    digest = hashlib.sha256((case / "adaptation.mcap").read_bytes()).hexdigest()
    request = {"kind": "excite", "spread": 0.2, "duration_s": 2.0, "seed": 3, "episodes": [digest]}
    with Client(service.url) as client:
        job = client.wait(client.submit("chapter", request)["id"])
        report = job["result"]["report"]
        for name in ("excitation.csv", "excitation.mcap", "excitation.json"):
            assert client.output(job["id"], name) == (tmp_path / "here" / name).read_bytes()
    assert report["breaches"] == 0
    assert "drawn" not in report
    design = json.loads((tmp_path / "here" / "excitation.json").read_text())
    assert report["check_first"] == design["check_first"]
    command(service, "excite", "chapter", "--out", str(tmp_path / "there"), *options)
    page = (tmp_path / "there" / "report.html").read_text()
    assert page.count('<svg class="curves"') == 1 + 2  # the command, position and velocity
    assert "hand on an emergency stop" in page


REFUSED = [
    ({"kind": "closedloop", "versions": ["0" * 64]}, "not-found"),
    ({"kind": "closedloop", "authority": 1.5}, "invalid-request"),
    ({"kind": "closedloop", "seeds": []}, "invalid-request"),
    ({"kind": "openloop", "horizons_steps": [0]}, "invalid-request"),
    ({"kind": "openloop", "machine": "f" * 64}, "not-found"),
    ({"kind": "consistency", "version": "f" * 64}, "not-found"),
    ({"kind": "randomise"}, "not-identifiable"),
    ({"kind": "randomise", "diagnosis": "0" * 32}, "not-found"),
    ({"kind": "excite", "goal": "split", "spread": 0.1}, "not-identifiable"),
    ({"kind": "excite", "diagnosis": "0" * 32}, "not-found"),
    ({"kind": "excite", "duration_s": 0}, "invalid-request"),
    ({"kind": "excite", "episodes": ["0" * 64]}, "not-found"),
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


def test_recordings_that_another_plant_made_are_told_apart(service, fitted, tmp_path):
    """The mismatched recording of the chapter is of a plant with other numbers."""
    version = fitted["identify"]["artifact"][:12]
    report = study(service, "consistency", "chapter", tmp_path, "--model", version)
    assert report["model"] == "v2 identified"
    assert [r["role"] for r in report["recordings"]].count("adaptation") == 2
    differing = {n["parameter"] for n in report["numbers"] for b in n["by"] if b["contradicts"]}
    assert "k" in differing
    fetched = str(tmp_path / "fetched")
    command(service, "fetch", "chapter", fetched, "--artifact", version)
    again = study(service, "consistency", CHAPTER, tmp_path / "local", "--model", fetched)
    names = {r["name"] for r in again["recordings"]}
    assert names == {"adaptation", "mismatched", "validation"}  # a test recording is kept apart
    assert [n["value"] for n in again["numbers"]] == [n["value"] for n in report["numbers"]]
