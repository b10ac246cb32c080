"""Evidence: the result of one stage of the test ladder for an artifact, and what it can and cannot
show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from trueup.canonical import Json, canonical_bytes, is_digest
from trueup.episode.role import STAGES
from trueup.errors import TrueupError
from trueup.gate.frozen import Frozen

SCHEMA = "trueup.evidence/1"
LONGEST_BYTES = 1 << 20


class BadEvidence(TrueupError):
    """The evidence cannot be read."""

    code = "bad-evidence"
    hint = (
        "Evidence names its artifact, its stage, whether it was passed, what it shows, what "
        "it cannot show, and its figures."
    )


@dataclass(frozen=True)
class Evidence(Frozen):
    """A record of one stage: `passed` or not, `shows` and `cannot_show` in words, `figures` as
    JSON. Raises BadEvidence."""

    artifact: str
    stage: str
    passed: bool
    shows: str
    cannot_show: str
    figures: Mapping[str, Json]

    schema, refused, noun = SCHEMA, BadEvidence, "evidence"

    def __post_init__(self) -> None:
        if not (isinstance(self.artifact, str) and is_digest(self.artifact)):
            raise BadEvidence("the artifact must be named by its digest", field="artifact")
        if self.stage not in STAGES:
            raise BadEvidence(f"the stage must be one of {', '.join(STAGES)}", field="stage")
        if not isinstance(self.passed, bool) or not isinstance(self.figures, Mapping):
            raise BadEvidence("passed is true or false, and figures are a table", field="passed")
        for field in ("shows", "cannot_show"):
            if not isinstance(getattr(self, field), str) or not getattr(self, field).strip():
                raise BadEvidence(
                    f"{field} must say something: a record without its scope proves nothing",
                    field=field,
                )
        if len(canonical_bytes(dict(self.figures))) > LONGEST_BYTES:
            raise BadEvidence(
                "the figures are too long: keep the recordings as episodes, and name their digests",
                field="figures",
            )
