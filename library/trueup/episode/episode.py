"""Episode: the record of one run, on one clock."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from trueup.episode.layout import Layout
from trueup.episode.omission import Omission, TopicOffset
from trueup.episode.role import Role
from trueup.errors import NotAnEpisode, RoleRefused

LEAST_SAMPLES = 2
NAME = "recording"  # the collection condition that says what a recording is called
GAP_PERIODS = 5.0  # an interval this many median periods long is a gap


@dataclass(frozen=True, slots=True, eq=False)
class Episode:
    """Time-aligned commands and observations.

    `t_s` [s] counts from the first sample, strictly increasing, `(samples,)`. `observations` is
    `(samples, observation channels)`, `commands` `(samples, command channels)`: row i acts from
    `t_s[i]` to the next sample, and is the mean of those in force where the command changed in
    between. These are the commands that were issued; `applied` `(samples, command channels)` is
    what the drive reports to have applied of them, None where no log says so, nan before its first
    message; `effort` `(samples, command channels)` what was measured at the commanded joints, in
    the log's own unit, None where it was not. A channel that the log lacks is a column of nan,
    named in `missing`. `clock_doubts` says where the log's own clocks contradict each other;
    `omissions` which messages were left out because they say nothing; `offset` how the topics lie
    against each other, None where the episode was not read from a recording. A part of a recording
    begins `begins_s` [s] after it, and its digest is the recording's with what it is a part of.
    `source` says what a recording was made from that came in another format: the original's file,
    `sha256`, `format` and `mapping`; empty where it came as it is. The arrays cannot be written to.
    """

    t_s: NDArray[np.float64]
    commands: NDArray[np.float64]
    observations: NDArray[np.float64]
    layout: Layout
    role: Role
    conditions: Mapping[str, str]
    start_ns: int
    digest: str
    clock_doubts: tuple[str, ...] = ()
    applied: NDArray[np.float64] | None = None
    omissions: tuple[Omission, ...] = ()
    offset: TopicOffset | None = None
    begins_s: float = 0.0
    effort: NDArray[np.float64] | None = None
    source: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        samples = len(self.t_s)
        shapes = (samples, len(self.layout.commands)), (samples, len(self.layout.observations))
        if samples < LEAST_SAMPLES or (self.commands.shape, self.observations.shape) != shapes:
            raise NotAnEpisode(
                f"an episode needs two aligned samples at least, this has {samples}", rule="samples"
            )
        if self.applied is not None and self.applied.shape != self.commands.shape:
            raise NotAnEpisode("applied commands have the shape of issued ones", rule="samples")
        if self.effort is not None and self.effort.shape != self.commands.shape:
            raise NotAnEpisode("efforts have the shape of commands", rule="samples")
        for array in (self.t_s, self.commands, self.observations, self.applied, self.effort):
            if array is not None:
                array.setflags(write=False)
        object.__setattr__(self, "conditions", MappingProxyType(dict(self.conditions)))
        object.__setattr__(self, "source", MappingProxyType(dict(self.source)))

    @property
    def missing(self) -> tuple[str, ...]:
        """Names of the declared channels that the log has no values of."""
        channels = self.layout.observations + self.layout.commands
        columns = np.hstack([self.observations, self.commands])
        return tuple(
            c.name for c, column in zip(channels, columns.T, strict=True) if np.isnan(column).all()
        )

    @property
    def within_limits(self) -> NDArray[np.float64]:
        """What the declared limits leave of the issued commands, `(samples, command channels)`."""
        ends = [c.limits or (-np.inf, np.inf) for c in self.layout.commands]
        low, high = np.array(ends, float).reshape(-1, 2).T
        return np.asarray(np.clip(self.commands, low, high))

    @property
    def applied_commands(self) -> NDArray[np.float64]:
        """The applied commands `(samples, command channels)`: as recorded, else what the declared
        limits leave of the issued ones."""
        return self.within_limits if self.applied is None else self.applied

    @property
    def samples_digest(self) -> str:
        """SHA-256 of the samples alone, 64 hexadecimal digits. It does not change with the encoding
        of the recording, its metadata, or the time of its clock at the beginning.

        Instants are counted in nanoseconds from the first; every nan counts alike.
        """
        hashed = hashlib.sha256(np.round(self.t_s * 1e9).astype("<i8").tobytes())
        for values in (self.observations, self.commands):
            hashed.update(np.where(np.isnan(values), np.nan, values + 0.0).astype("<f8").tobytes())
        return hashed.hexdigest()

    @property
    def name(self) -> str | None:
        """What the recording is called, None where nothing says so."""
        return self.conditions.get(NAME)

    @property
    def recording(self) -> str:
        """The digest of the recording that this is, or is a part of."""
        return recording_of(self.digest)

    def part(self, first: int, last: int) -> Episode:
        """The samples from `first` to before `last`, as an episode."""
        if (first, last) == (0, len(self.t_s)):
            return self
        kept = slice(first, last)
        return replace(
            self,
            t_s=self.t_s[kept] - self.t_s[first],
            commands=self.commands[kept].copy(),
            observations=self.observations[kept].copy(),
            applied=None if self.applied is None else self.applied[kept].copy(),
            effort=None if self.effort is None else self.effort[kept].copy(),
            begins_s=self.begins_s + float(self.t_s[first]),
            digest=f"{self.digest}, samples {first} to {last}",
        )

    @property
    def period_s(self) -> float:
        """Median time between samples [s]."""
        return float(np.median(np.diff(self.t_s)))

    @property
    def gaps(self) -> NDArray[np.int64]:
        """Samples before which more than GAP_PERIODS median periods passed, `(gaps,)`."""
        return np.flatnonzero(np.diff(self.t_s) > GAP_PERIODS * self.period_s) + 1

    def require(self, *roles: Role) -> Episode:
        """This episode, if its role is one of `roles`. Raises RoleRefused."""
        if self.role not in roles:
            allowed = " or ".join(roles)
            raise RoleRefused(
                f"episode {self.digest[:12]} has the role {self.role}, {allowed} is needed",
                role=str(self.role),
                digest=self.digest,
            )
        return self


def recording_of(digest: str) -> str:
    """The digest of the recording that an episode of this digest is, or is a part of."""
    return digest.split(",", 1)[0]


def is_physical(episodes: Sequence[Episode]) -> bool:
    """Whether any episode was recorded on a machine: its declared stage is physical, or HIL."""
    return any(e.conditions.get("stage") in ("physical", "HIL") for e in episodes)
