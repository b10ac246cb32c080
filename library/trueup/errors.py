"""Every error that trueup raises, as one tree.

    TrueupError
    ├── BadEpisode               the bytes are no episode
    │   ├── MalformedMcap        a rule of the MCAP container is broken, at a byte
    │   ├── MalformedRecording   a rule of another format's container is broken
    │   ├── TooLarge             a declared limit on size is exceeded
    │   └── NotAnEpisode         a sound file, but not what an episode must hold
    ├── BadPlant                 plant.json breaks a rule, at a field
    ├── BadMapping               a mapping of signals to channels breaks a rule, at a field
    ├── BadEffect                an effect from outside breaks a rule, or is not at hand
    ├── BadSimulator             a user's step function breaks a rule, or is not at hand
    ├── BadRandomisation         a family of plants breaks a rule, at a field
    ├── NotInstalled             an optional part of the installation is needed
    ├── NotExportable            this model has no form in what was asked for
    ├── NotImportable            what another registry keeps of a model makes no predictor
    ├── MlflowRefused            an MLflow registry did not do what it was asked for
    ├── OciRefused               an OCI registry did not do what it was asked for
    ├── NoSuchDigest             no digest, or several, begin as one was given
    ├── BadArtifact              a manifest, an array or a digest does not hold
    ├── BadGate                  a gate that cannot judge
    ├── BadMonitor               a monitor that cannot watch
    ├── RoleRefused              data used for what its role forbids
    ├── NotIdentifiable          the data do not determine what was asked
    └── LedgerError              what we did cannot be explained
        ├── PointerMoved         the serving pointer is no longer where the caller believes
        └── BrokenChain          the audit log does not add up

An error's docstring is its message when none is given. `code` is stable and machine-readable;
`hint` says what to do next; `facts` are the values that a program may want (byte, field, expected,
found).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

# a message may quote what somebody sent, and not more of it than one reads
MESSAGE_CHARACTERS = 500


class TrueupError(Exception):
    """Something went wrong in trueup."""

    code = "trueup-error"
    hint = "Read the message; if it does not help, report it with the request id."

    def __init__(
        self, message: str | None = None, *, hint: str | None = None, **facts: object
    ) -> None:
        self.message = (message or (type(self).__doc__ or "").splitlines()[0])[:MESSAGE_CHARACTERS]
        self.hint = hint or type(self).hint
        self.facts = facts
        super().__init__(self.message)
        self.add_note(f"hint: {self.hint}")  # a traceback ends with it


@contextmanager
def of_file(name: str) -> Iterator[None]:
    """What goes wrong within names this file, beside others that did not."""
    try:
        yield
    except TrueupError as error:
        error.facts.setdefault("file", name)
        raise


class BadEpisode(TrueupError):
    """The bytes are not an episode."""

    code = "bad-episode"
    hint = "Record again, or convert with a tool that writes MCAP (ros2 bag record -s mcap)."


class MalformedMcap(BadEpisode):
    """The file breaks a rule of the MCAP container format."""

    code = "malformed-mcap"
    hint = "Repair it with `mcap recover`, or record again; `byte` is where the rule is broken."


class MalformedRecording(BadEpisode):
    """The file is not what its format demands."""

    code = "malformed-recording"
    hint = "Write the file again, or export it in another format; docs/recordings.md lists them."


class TooLarge(BadEpisode):
    """The file exceeds a declared limit."""

    code = "too-large"
    hint = "Split the recording, or raise the named limit in the settings."


class NotAnEpisode(BadEpisode):
    """The file is sound but holds no episode."""

    code = "not-an-episode"
    hint = (
        "An episode needs JointState messages on the plant's observation and command topics "
        "and a metadata record named `episode`."
    )


class BadPlant(TrueupError):
    """The plant's description breaks a rule."""

    code = "bad-plant"
    hint = "Correct the field named in `field`; docs/plant.md lists every field."


class BadMapping(TrueupError):
    """The mapping of signals to channels breaks a rule."""

    code = "bad-mapping"
    hint = "Correct the field named in `field`; docs/recordings.md shows a mapping."


class BadEffect(TrueupError):
    """The effect cannot take part."""

    code = "bad-effect"
    hint = "docs/effects.md shows an effect of your own; `trueup effects --laws` checks it."


class BadSimulator(TrueupError):
    """The simulator cannot be a nominal model."""

    code = "bad-simulator"
    hint = "docs/simulators.md says what a step function takes and returns."


class BadRandomisation(TrueupError):
    """The document describes no family of plants."""

    code = "bad-randomisation"
    hint = "Correct the named field; docs/randomisation.md lists what a family may say."


class NotInstalled(TrueupError):
    """An optional part of the installation is needed."""

    code = "not-installed"
    hint = "Install it with `pip install 'trueup[mujoco]'`; `trueup doctor` says what is there."


class NotExportable(TrueupError):
    """This model cannot be written in the format that was asked for."""

    code = "not-exportable"
    hint = "docs/export.md lists the formats in which each kind of model can be written."


class NotImportable(TrueupError):
    """What another registry keeps of this model makes no predictor of the plant."""

    code = "not-importable"
    hint = (
        "Log the plant's parameters, as its plant.json names them, as params of the run "
        "that the model came from."
    )


class OciRefused(TrueupError):
    """The OCI registry did not do what it was asked for."""

    code = "oci-refused"
    hint = (
        "Name it as HOST/REPOSITORY:TAG, and log in with `oras login HOST` or `docker login HOST`."
    )


class MlflowRefused(TrueupError):
    """The MLflow registry did not do what it was asked for."""

    code = "mlflow-refused"
    hint = (
        "Name the registry with --registry or MLFLOW_TRACKING_URI; log in as for MLflow's own "
        "client (MLFLOW_TRACKING_TOKEN)."
    )


class NoSuchDigest(TrueupError):
    """Nothing, or more than one thing, has a digest that begins so."""

    code = "no-such-digest"
    hint = "Give more digits, or all of them."


class BadArtifact(TrueupError):
    """The artifact is damaged or does not fit."""

    code = "bad-artifact"
    hint = (
        "If you fetched it, fetch it again; if the digest still differs, the stored copy is "
        "damaged and must not be served. If you made it, send the bytes that "
        "`trueup.artifact.artifact.pack` wrote, unchanged."
    )


class BadGate(TrueupError):
    """The gate cannot judge."""

    code = "bad-gate"
    hint = "A gate names at least one rule, and a trial holds at least one held-out episode."


class BadMonitor(TrueupError):
    """The monitor cannot watch."""

    code = "bad-monitor"
    hint = "A monitor needs a promise in operating hours, and detectors from docs/continual.md."


class RoleRefused(TrueupError):
    """The episode's role forbids this use."""

    code = "role-refused"
    hint = "Fit from adaptation episodes, gate on validation episodes, report on test episodes."


class NotIdentifiable(TrueupError):
    """The data do not determine what was asked of them."""

    code = "not-identifiable"
    hint = (
        "Record an episode that excites the joint more: other speeds, both directions, the "
        "whole command range."
    )


class LedgerError(TrueupError):
    """The ledger cannot explain the state."""

    code = "ledger-error"
    hint = "Stop promoting; run `trueup audit verify`."


class PointerMoved(LedgerError):
    """The serving pointer is not at the generation that the caller expects."""

    code = "pointer-moved"
    hint = "Look up what serves now, judge again against it, and send the new generation."


class BrokenChain(LedgerError):
    """An audit entry does not follow from the one before it."""

    code = "broken-chain"
    hint = "The log was edited from `sequence` on; compare with an exported copy."
