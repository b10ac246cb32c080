"""Statuses of errors: one table for the problems of routes and for the pages that show one."""

from __future__ import annotations

from http import HTTPStatus

from trueup import errors
from trueup.blindtrial.commitment import CommitmentMismatch, LabelLeaked
from trueup.canonical import NotCanonical
from trueup.gate.evidence import BadEvidence
from trueup.gate.policy import BadPolicy
from trueup.ledger.archive_layout import BadArchive
from trueup.ledger.pointer import NotAccepted, NothingToRollBackTo, NotToRollBackTo
from trueup.ledger.signed_note import BadKey
from trueup_service import errors as service
from trueup_service.registry.blobs import BlobDamaged, BlobMissing, StoreAway

STATUS: dict[type[errors.TrueupError], HTTPStatus] = {
    errors.BadEpisode: HTTPStatus.UNPROCESSABLE_ENTITY,
    errors.BadPlant: HTTPStatus.UNPROCESSABLE_ENTITY,
    errors.BadEffect: HTTPStatus.UNPROCESSABLE_ENTITY,
    errors.BadSimulator: HTTPStatus.UNPROCESSABLE_ENTITY,
    errors.BadMapping: HTTPStatus.UNPROCESSABLE_ENTITY,
    errors.BadRandomisation: HTTPStatus.UNPROCESSABLE_ENTITY,
    errors.BadArtifact: HTTPStatus.UNPROCESSABLE_ENTITY,
    errors.BadGate: HTTPStatus.UNPROCESSABLE_ENTITY,
    errors.BadMonitor: HTTPStatus.UNPROCESSABLE_ENTITY,
    errors.NotInstalled: HTTPStatus.NOT_IMPLEMENTED,
    errors.NotExportable: HTTPStatus.UNPROCESSABLE_ENTITY,
    errors.NotImportable: HTTPStatus.UNPROCESSABLE_ENTITY,
    errors.NoSuchDigest: HTTPStatus.NOT_FOUND,
    errors.MlflowRefused: HTTPStatus.BAD_GATEWAY,
    errors.OciRefused: HTTPStatus.BAD_GATEWAY,
    errors.NotIdentifiable: HTTPStatus.UNPROCESSABLE_ENTITY,
    errors.RoleRefused: HTTPStatus.FORBIDDEN,
    errors.PointerMoved: HTTPStatus.CONFLICT,
    errors.BrokenChain: HTTPStatus.INTERNAL_SERVER_ERROR,
    LabelLeaked: HTTPStatus.UNPROCESSABLE_ENTITY,
    CommitmentMismatch: HTTPStatus.INTERNAL_SERVER_ERROR,
    NotCanonical: HTTPStatus.UNPROCESSABLE_ENTITY,
    NotAccepted: HTTPStatus.CONFLICT,
    NothingToRollBackTo: HTTPStatus.CONFLICT,
    NotToRollBackTo: HTTPStatus.CONFLICT,
    BlobDamaged: HTTPStatus.INTERNAL_SERVER_ERROR,
    BlobMissing: HTTPStatus.INTERNAL_SERVER_ERROR,
    StoreAway: HTTPStatus.SERVICE_UNAVAILABLE,
    service.NotFound: HTTPStatus.NOT_FOUND,
    service.Conflict: HTTPStatus.CONFLICT,
    service.LabelChanged: HTTPStatus.CONFLICT,
    service.KeyReused: HTTPStatus.CONFLICT,
    service.DigestMismatch: HTTPStatus.UNPROCESSABLE_ENTITY,
    service.TooLargeUpload: HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
    BadEvidence: HTTPStatus.UNPROCESSABLE_ENTITY,
    service.EvidenceMissing: HTTPStatus.CONFLICT,
    service.NeverServed: HTTPStatus.CONFLICT,
    BadPolicy: HTTPStatus.UNPROCESSABLE_ENTITY,
    service.HeldOutSpent: HTTPStatus.CONFLICT,
    service.GateFollows: HTTPStatus.CONFLICT,
    service.GateSuperseded: HTTPStatus.CONFLICT,
    service.RejectedBefore: HTTPStatus.CONFLICT,
    service.CannotBeDeleted: HTTPStatus.CONFLICT,
    service.BadRequest: HTTPStatus.BAD_REQUEST,
    service.SwitchbackFailed: HTTPStatus.CONFLICT,
    service.InspectionFailed: HTTPStatus.UNPROCESSABLE_ENTITY,
    service.NotEmpty: HTTPStatus.CONFLICT,
    service.KeyNotGiven: HTTPStatus.UNPROCESSABLE_ENTITY,
    service.NotWhole: HTTPStatus.UNPROCESSABLE_ENTITY,
    BadArchive: HTTPStatus.UNPROCESSABLE_ENTITY,
    service.UploadElsewhere: HTTPStatus.CONFLICT,
    service.NotSafeguarded: HTTPStatus.CONFLICT,
    service.InTheFuture: HTTPStatus.UNPROCESSABLE_ENTITY,
    service.MemoryFull: HTTPStatus.SERVICE_UNAVAILABLE,
    service.UploadsFull: HTTPStatus.TOO_MANY_REQUESTS,
    service.ApprovalMissing: HTTPStatus.CONFLICT,
    service.WebhookRefused: HTTPStatus.UNPROCESSABLE_ENTITY,
    service.UnknownHost: HTTPStatus.MISDIRECTED_REQUEST,
    service.SignInRefused: HTTPStatus.FORBIDDEN,
    service.ProviderAway: HTTPStatus.BAD_GATEWAY,
    service.Unauthenticated: HTTPStatus.UNAUTHORIZED,
    service.Forbidden: HTTPStatus.FORBIDDEN,
    service.LogRewound: HTTPStatus.INTERNAL_SERVER_ERROR,
    service.OtherKey: HTTPStatus.INTERNAL_SERVER_ERROR,
    BadKey: HTTPStatus.INTERNAL_SERVER_ERROR,
    service.Pickled: HTTPStatus.INTERNAL_SERVER_ERROR,
}


def status_of(error: errors.TrueupError) -> HTTPStatus:
    """The status of an error: that of the nearest class in the table."""
    return next(
        (STATUS[kind] for kind in type(error).__mro__ if kind in STATUS),
        HTTPStatus.INTERNAL_SERVER_ERROR,
    )
