"""Errors that only the service raises; `http/problems.py` gives each its status."""

from __future__ import annotations

from trueup.errors import TrueupError


class NotFound(TrueupError):
    """There is no such thing here."""

    code = "not-found"
    hint = "List the collection to see what there is."


class Conflict(TrueupError):
    """It exists already, and is different."""

    code = "conflict"
    hint = "What is registered never changes: choose another name."


class LabelChanged(TrueupError):
    """Somebody changed the label since it was read."""

    code = "label-changed"
    hint = "Read the label again, and send what should stand in it now."


class KeyReused(TrueupError):
    """The idempotency key was used for another request."""

    code = "idempotency-key-reused"
    hint = "Send a new Idempotency-Key for a new request; the same key only repeats the same one."


class DigestMismatch(TrueupError):
    """The bytes received are not those that the digest names."""

    code = "digest-mismatch"
    hint = "The upload was damaged on its way, or the digest is of other bytes: send it again."


class TooLargeUpload(TrueupError):
    """The upload is larger than the service takes."""

    code = "upload-too-large"
    hint = "Split the recording, or raise TRUEUP_UPLOAD_LIMIT_BYTES."


class CannotBeDeleted(TrueupError):
    """What was registered is kept: it serves, a decision names it, or somebody may have to
    recompute from it."""

    code = "kept"
    hint = "Roll back or promote to change what serves; nothing has to be deleted for that."


class HeldOutSpent(TrueupError):
    """The held-out episodes were used as often as the gate allows."""

    code = "held-out-spent"
    hint = (
        "Record a new episode with the role validation: repeated selection on the same one "
        "overfits to it."
    )


class GateFollows(TrueupError):
    """Candidates of this plant have been scored already: another gate names the one that it
    follows, and says why."""

    code = "gate-follows"
    hint = (
        "Judge by the gate that is in force, or declare yours with the digest of that gate in "
        "`follows` and a reason in `because` "
        "(the command: --because REASON). Every decision by it will state what was known."
    )


class GateSuperseded(TrueupError):
    """Another gate has been declared since: the last one of a plant judges."""

    code = "gate-superseded"
    hint = (
        "Judge by the gate in force (GET /v1/plants/PLANT/gate), or declare these rules "
        "again as what follows it."
    )


class RejectedBefore(TrueupError):
    """The candidate was rejected before, and nothing fresh speaks for it."""

    code = "rejected-before"
    hint = (
        "Record held-out episodes after the gate was declared and after the rejection, and "
        "judge on those alone; "
        "or let somebody else approve the decision with a reason: `trueup approve PLANT "
        "DECISION --because REASON`."
    )


class EvidenceMissing(TrueupError):
    """The channel requires evidence that the artifact has not."""

    code = "evidence-missing"
    hint = (
        "Test it at the named stages and add what was found (`trueup evidence PLANT --add "
        "FILE`); or move a channel that requires less."
    )


class NeverServed(TrueupError):
    """A channel serves only what the plant itself serves or has served."""

    code = "never-served"
    hint = "Judge the artifact by a gate and promote it first."


class BadRequest(TrueupError):
    """The request cannot be understood."""

    code = "bad-request"
    hint = "Compare the request with /openapi.json."


class SwitchbackFailed(TrueupError):
    """The artifact to go back to did not pass its switchback test; the pointer has not moved."""

    code = "switchback-failed"
    hint = "Keep what serves, and promote a sound artifact instead."


class InTheFuture(TrueupError):
    """The time that was asked for has not come yet."""

    code = "in-the-future"
    hint = "Ask for a time that has passed, or without `at` for everything up to now."


class NotSafeguarded(TrueupError):
    """The plant's policy requires safeguards that a recording does not show."""

    code = "not-safeguarded"
    hint = (
        "Declare `safeguards` and `stop_criterion` in the recording's metadata as "
        "docs/continual.md says, or leave the episode out."
    )


class MemoryFull(TrueupError):
    """The service holds as many bytes of other requests as it may."""

    code = "memory-full"
    hint = (
        "Send it again in a second, with the same Idempotency-Key; "
        "TRUEUP_BODIES_LIMIT_BYTES is how much the service holds at once."
    )


class InspectionFailed(TrueupError):
    """The inspection of the upload was ended at its limit."""

    code = "inspection-limit"
    hint = (
        "The file needs more memory or time than a sound recording of its size: check it, "
        "or raise the inspection limits."
    )


class LogRewound(TrueupError):
    """The log is shorter than, or other than, the one whose head was published."""

    code = "log-rewound"
    hint = (
        "Somebody restored or edited the database: compare it with a mirror, then put "
        "data_dir/checkpoint away if that was meant to be."
    )


class OtherKey(TrueupError):
    """The log is signed with another key than this server's."""

    code = "other-key"
    hint = (
        "Give every server of one database the same TRUEUP_SIGNING_KEY; restore "
        "data_dir/signing.key if it was lost. "
        "To replace the key, give the one before as TRUEUP_SIGNING_KEY_BEFORE, too."
    )


class Pickled(TrueupError):
    """A row of the job engine is pickled. Nothing of ours is: somebody else wrote it."""

    code = "pickled-row"
    hint = (
        "Somebody wrote into the engine's tables: find out who may write to the database, "
        "then delete the row."
    )


class NotEmpty(TrueupError):
    """The registry holds something already."""

    code = "registry-not-empty"
    hint = (
        "Restore into a fresh database and an empty folder or bucket; `trueup import` adds "
        "one plant to a registry in use."
    )


class NotWhole(TrueupError):
    """What came does not agree with its own log, or is not signed by the key that was given."""

    code = "archive-not-whole"
    hint = (
        "Nothing was taken over. Fetch the archive again, and compare the key with the one "
        "of the site that it came from."
    )


class KeyNotGiven(TrueupError):
    """An archive says itself which key it is signed with, and nobody else has said which it should
    be."""

    code = "key-not-given"
    hint = (
        "Ask whoever runs the log that it comes from for its public key (`trueup audit "
        "key`), and give it with --key. --any-key believes "
        "the key that the archive names: that shows that it is whole, and not whose it is."
    )


class UploadElsewhere(TrueupError):
    """The upload is not where this part begins."""

    code = "upload-offset"
    hint = "Ask how far it came (GET the upload), and go on from `offset_bytes`."


class UploadsFull(TrueupError):
    """The plant has as many uploads in parts under way as it may."""

    code = "uploads-full"
    hint = (
        "Finish those that are under way; an abandoned one is removed after TRUEUP_UPLOADS_KEPT_S."
    )


class ApprovalMissing(TrueupError):
    """The plant's policy takes more people for a promotion."""

    code = "approval-missing"
    hint = (
        "Somebody else must approve it first, with a token of their own name: `trueup "
        "approve PLANT DECISION`."
    )


class UnknownHost(TrueupError):
    """The service is not known by the host that the request names."""

    code = "unknown-host"
    hint = "Ask it by its address or its name; whoever runs it adds a name to TRUEUP_ALLOWED_HOSTS."


class WebhookRefused(TrueupError):
    """The service may not send to that address."""

    code = "webhook-refused"
    hint = (
        "Whoever runs the service allows hosts in TRUEUP_WEBHOOK_HOSTS, and private addresses in "
        "TRUEUP_WEBHOOK_PRIVATE_RANGES."
    )


class Unauthenticated(TrueupError):
    """The request carries no valid token or session."""

    code = "unauthenticated"
    hint = (
        "Send `Authorization: Bearer <token>` (the command: `trueup login`, or "
        "TRUEUP_TOKEN); an admin issues tokens."
    )


class SignInRefused(TrueupError):
    """The provider's answer does not let anybody sign in."""

    code = "sign-in-refused"
    hint = "Begin again at the sign-in page."


class ProviderAway(TrueupError):
    """The OpenID provider does not answer as one."""

    code = "provider-away"
    hint = "Try again, or sign in with a token; the operator should check TRUEUP_OPENID_…."


class Forbidden(TrueupError):
    """The token may not do this."""

    code = "forbidden"
    hint = "Ask an admin for a token with one of the roles that `facts` names."
