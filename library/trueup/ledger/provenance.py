"""Where an artifact comes from, and what a gate decided, as in-toto statements for other tools of a
supply chain.

An artifact's statement is SLSA provenance: episodes, plant and parent are its dependencies, the
job's configuration its parameters, the code its builder. A decision's is a test result: the gate
and the held-out episodes are its configuration, the rules its tests. Source: in-toto attestation
framework, Statement v1; SLSA v1.0, provenance; in-toto predicate test-result v0.1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from trueup.canonical import Json

PAYLOAD_TYPE = "application/vnd.in-toto+json"
STATEMENT = "https://in-toto.io/Statement/v1"
SLSA = "https://slsa.dev/provenance/v1"
TEST_RESULT = "https://in-toto.io/attestation/test-result/v0.1"


def of_artifact(
    manifest: Mapping[str, Any], digest: str, facts: Mapping[str, Json]
) -> dict[str, Json]:
    """The statement of an artifact from its manifest; `facts` say where the registry keeps it:
    plant, version, job, when, by whom.

    An artifact that no job made is called uploaded, whatever its manifest claims of its making.
    """
    made = _document(manifest.get("provenance"))
    configuration, code = _document(made.get("configuration")), _document(made.get("code"))
    dependencies = [
        _resource("plant", str(manifest["plant"]["name"]), str(manifest["plant"]["sha256"]))
    ]
    episodes = [_document(e) for e in _list(made.get("episodes"))]
    named = [("episode", str(e.get("role")), e.get("sha256")) for e in episodes]
    named += [
        ("artifact", "parent", made.get("parent")),
        ("configuration", "request", configuration.get("sha256")),
    ]
    dependencies += [
        _resource(kind, name, digest) for kind, name, digest in named if isinstance(digest, str)
    ]
    return _statement(
        [
            {
                "name": f"{manifest['plant']['name']}/v{facts['version']}",
                "digest": {"sha256": digest},
            },
            *_arrays(manifest),
        ],
        SLSA,
        {
            "buildDefinition": {
                "buildType": f"urn:trueup:{manifest['kind']}",
                "externalParameters": _document(configuration.get("document")),
                "internalParameters": {"seed": made.get("seed"), "origin": made.get("origin")},
                "resolvedDependencies": dependencies,
            },
            "runDetails": {
                "builder": {
                    "id": "urn:trueup:worker" if facts["job"] else "urn:trueup:uploaded",
                    "version": code,
                },
                "metadata": {"invocationId": facts["job"], "finishedOn": facts["created_at"]},
                "byproducts": [{"name": "registration", "annotations": dict(facts)}],
            },
        },
    )


def of_decision(
    document: Mapping[str, Any], digest: str, facts: Mapping[str, Json]
) -> dict[str, Json]:
    """The statement of a decision, whose subject is the candidate."""
    verdicts: Sequence[Mapping[str, Any]] = document["verdicts"]
    configuration = [
        _resource("gate", "rules and scoring", document["gate"]),
        _resource("artifact", "incumbent", document["incumbent"]),
    ]
    configuration += [_resource("episode", "held out", e) for e in document["episodes"]]
    return _statement(
        [{"name": f"{facts['plant']}/candidate", "digest": {"sha256": str(document["candidate"])}}],
        TEST_RESULT,
        {
            "result": "PASSED" if document["accepted"] else "FAILED",
            "configuration": [
                *configuration,
                _resource("decision", "every figure", digest, dict(facts)),
            ],
            "passedTests": [v["rule"] for v in verdicts if v["passed"]],
            "failedTests": [v["rule"] for v in verdicts if not v["passed"]],
        },
    )


def _document(value: object) -> Mapping[str, Any]:
    """A mapping in a manifest; empty where the uploader put anything else there."""
    return value if isinstance(value, Mapping) else {}


def _list(value: object) -> Sequence[object]:
    return value if isinstance(value, list) else []


def _statement(
    subject: list[dict[str, Json]], predicate_type: str, predicate: dict[str, Json]
) -> dict[str, Json]:
    return {
        "_type": STATEMENT,
        "subject": subject,
        "predicateType": predicate_type,
        "predicate": predicate,
    }


def _resource(
    kind: str, name: str, digest: str, annotations: Mapping[str, Json] | None = None
) -> dict[str, Json]:
    resource: dict[str, Json] = {
        "name": name,
        "uri": f"urn:trueup:{kind}:{digest}",
        "digest": {"sha256": digest},
    }
    return resource | ({"annotations": annotations} if annotations else {})


def _arrays(manifest: Mapping[str, Any]) -> list[dict[str, Json]]:
    arrays = manifest["arrays"]
    return (
        []
        if arrays is None
        else [{"name": "arrays.safetensors", "digest": {"sha256": str(arrays["sha256"])}}]
    )
