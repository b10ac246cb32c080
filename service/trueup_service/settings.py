"""Every setting of the service and the worker, read from the environment (`TRUEUP_…`), typed, with
its unit."""

from __future__ import annotations

import ipaddress
from functools import cached_property
from pathlib import Path
from typing import Literal, Self

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    SecretStr,
    field_validator,
    model_validator,
)
from pydantic_settings import BaseSettings, SettingsConfigDict

from trueup_service.host_names import listed


class GroupGrant(BaseModel):
    """What the people of a provider's group may do: roles, in one project or in all."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    roles: tuple[Literal["engineer", "operator", "auditor", "admin"], ...] = Field(min_length=1)
    project: str | None = None


class Settings(BaseSettings):
    """The settings. The defaults are embedded storage, SQLite and a folder, with one server and one
    worker."""

    model_config = SettingsConfigDict(env_prefix="TRUEUP_", frozen=True, extra="forbid")

    data_dir: Path = Field(
        Path(".trueup"),
        description="Folder of the embedded database, of the blobs and of unfinished uploads.",
    )
    database_url: str | None = Field(
        None, description="postgresql+psycopg://… for PostgreSQL; unset: SQLite in data_dir."
    )
    database_pool: int = Field(16, ge=1, description="Connections that one process may hold.")
    s3_bucket: str | None = Field(
        None, description="Bucket of the blobs; unset: the folder data_dir/blobs."
    )
    s3_prefix: str = Field("trueup", description="Key prefix inside the bucket.")
    s3_endpoint: str | None = Field(
        None, description="URL of an S3-compatible store; unset: the region's own."
    )
    s3_region: str = Field("us-east-1", description="Region of the bucket.")
    s3_access_key: str | None = Field(
        None, description="Access key id; unset: the machine's own credentials."
    )
    s3_secret_key: SecretStr | None = Field(None, description="Secret access key.")
    host: str = Field("127.0.0.1", description="Address to listen on.")
    port: int = Field(8321, ge=0, le=65535, description="Port to listen on; 0 for any free one.")
    public_url: str | None = Field(
        None,
        description=(
            "Address under which browsers reach the service, such as "
            "https://registry.example.com; unset: as they ask."
        ),
    )
    connections: int | None = Field(
        None,
        ge=1,
        description="Connections held at once; unset: the limit on open files (`ulimit -n`) less "
        "those reserved for database, blobs and checkpoint, "
        "which are at least a quarter.",
    )
    header_limit_s: float = Field(
        20.0, gt=0, description="Time in which a request's head must arrive [s]."
    )
    keep_alive_s: float = Field(
        75.0,
        gt=0,
        description=(
            "How long a connection is kept without a request [s]; a robot that asks twice a "
            "minute keeps its own."
        ),
    )
    silence_limit_s: float = Field(
        60.0,
        gt=0,
        description=(
            "How long a request's body may arrive, or an answer be read, at less than "
            "100 bytes a second [s]; then the connection is closed."
        ),
    )
    allowed_hosts: str | None = Field(
        None,
        description="Host names under which the service answers, beside addresses, localhost, the "
        "machine's own name, `host` and that of "
        "`public_url`: comma-separated, `*.example.com` for every name below it, `*` "
        "for any. Others are refused, so that a page whose own "
        "name leads to this address (DNS rebinding) cannot read its answers. /healthz "
        "and /readyz answer by any name.",
    )
    upload_limit_bytes: int = Field(2 << 30, ge=1, description="Largest upload [bytes].")
    arrays_limit_bytes: int = Field(
        128 << 20, ge=1, description="Largest arrays of an artifact [bytes]."
    )
    bodies_limit_bytes: int = Field(
        64 << 20,
        ge=4 << 20,
        description="Bytes of the bodies that are held in memory at once, uploads aside, each of "
        "which may have 4 MiB [bytes]; beyond that "
        "a request is told to retry.",
    )
    uploads_under_way: int = Field(
        64, ge=1, description="Uploads in parts that a plant may have under way at one server."
    )
    uploads_under_way_bytes: int = Field(
        8 << 30,
        ge=1,
        description="Bytes of the uploads in parts that a plant has under way [bytes].",
    )
    uploads_kept_s: float = Field(
        604_800.0,
        gt=0,
        description=(
            "How long an upload in parts that nobody goes on with is kept, since its last part [s]."
        ),
    )
    answers_kept_s: float = Field(
        604_800.0,
        gt=0,
        description=(
            "How long the answer to an Idempotency-Key is kept [s]; a request that is "
            "repeated later is a new one."
        ),
    )
    answers_kept: int = Field(
        10_000,
        ge=1,
        description=(
            "Answers to Idempotency-Keys that are kept for one token: of more, the oldest "
            "go within a minute."
        ),
    )
    inspection_memory_bytes: int = Field(
        1 << 30,
        ge=256 << 20,
        description="Address space of the process that inspects an upload [bytes].",
    )
    inspection_timeout_s: float = Field(
        120.0, gt=0, description="Time that the inspection of an upload may take [s]."
    )
    inspections: int = Field(2, ge=1, description="Inspections at once.")
    long_poll_limit_s: float = Field(
        60.0, gt=0, description="Longest that a request may wait for a change [s]."
    )
    watch_interval_s: float = Field(
        0.2,
        gt=0,
        description="Time between looks for other processes' moves, while somebody waits [s].",
    )
    job_poll_interval_s: float = Field(
        0.1,
        gt=0,
        description="Time between a worker's looks at the queue while there are jobs [s]; "
        "without any it sleeps until one is queued.",
    )
    job_attempts: int = Field(
        5,
        ge=1,
        description="Attempts at a job whose process or worker dies; after the last the job fails. "
        "A worker that is stopped in an orderly way does not count.",
    )
    job_memory_limit_bytes: int | None = Field(
        None,
        ge=512 << 20,
        description="Data that a process may hold that computes a job [bytes]; unset: what the "
        "machine has. A diagnosis forks one process more for each core. macOS does not enforce it.",
    )
    job_time_limit_s: float | None = Field(
        None, gt=0, description="Time that a job, or a part of one, may take [s]; unset: any."
    )
    jobs_kept_s: float = Field(
        604_800.0,
        gt=0,
        description="How long the job engine keeps its entries of jobs that have ended [s]; the "
        "jobs themselves and their results stay.",
    )
    takeover_interval_s: float = Field(
        1.0, gt=0, description="Time between a worker's looks for dead workers [s]."
    )
    schedule_interval_s: float = Field(
        30.0, gt=0, description="Time between a worker's looks for validations that are due [s]."
    )
    webhook_hosts: str | None = Field(
        None,
        description="Hosts that webhooks may be declared for: comma-separated names, "
        "`*.example.com` for every name below it; unset: no webhooks.",
    )
    webhook_private_ranges: str | None = Field(
        None,
        description="Ranges of private addresses that webhooks may reach, and without TLS, such "
        "as 10.0.0.0/8: comma-separated; unset: public addresses by https alone.",
    )
    webhook_retry_s: float = Field(
        259_200.0,
        gt=0,
        description="How long a webhook is retried that fails, at most an hour apart [s]; then "
        "it is stopped, until somebody resumes it.",
    )
    signing_key: SecretStr | None = Field(
        None,
        description="Private key that signs the log, one line of `trueup keygen`; unset: "
        "data_dir/signing.key, made at the first start. "
        "All servers of one database need the same.",
    )
    signing_key_before: SecretStr | None = Field(
        None,
        description="Previous private key, when signing_key replaces it; needed for one start. For "
        "a key in a file: "
        "data_dir/signing.key.before.",
    )
    admin_token: SecretStr | None = Field(
        None,
        min_length=32,
        description=(
            "An admin's token, 32 characters at least; unset: one is made at the first "
            "start, in data_dir/admin.token."
        ),
    )
    token_memory_s: float = Field(
        1.0,
        ge=0,
        description=(
            "How long a server believes a token without asking the database again, so how "
            "late it may be to refuse one [s]."
        ),
    )
    openid_issuer: str | None = Field(
        None,
        description="Address of an OpenID provider whose people may sign in, such as "
        "https://accounts.example.com; unset: people sign in with tokens alone.",
    )
    openid_client_id: str | None = Field(None, description="Client id at the OpenID provider.")
    openid_client_secret: SecretStr | None = Field(
        None, description="Client secret there; unset: a public client, which PKCE protects."
    )
    openid_groups: dict[str, GroupGrant] = Field(
        {},
        description="What the people of each group of the provider may do, as JSON: "
        '`{"robotics": {"roles": ["engineer"]}, "cell-7": {"roles": ["operator"], "project": '
        '"cell-7"}}`. Who is in none may not sign in.',
    )
    openid_groups_claim: str = Field(
        "groups",
        description="Claim with somebody's groups, a list or one as text, in the ID token or "
        "userinfo.",
    )
    openid_name_claim: str = Field(
        "email",
        description="Claim by which the log names somebody. It must be of one person alone, who "
        "cannot set it; an email that the provider does not call verified is refused.",
    )
    openid_scope: str = Field(
        "openid profile email", description="Scope that is asked for; some providers add `groups`."
    )
    openid_label: str = Field(
        "Sign in with your organisation", description="Words on the button of the sign-in page."
    )
    session_s: float = Field(43_200.0, gt=0, description="How long a browser stays signed in [s].")
    checkpoint_interval_s: float = Field(
        10.0,
        gt=0,
        description=(
            "Time between writes of the log's signed head to data_dir/checkpoint, if it has "
            "grown [s]."
        ),
    )
    serving_lease_s: float = Field(
        86_400.0, gt=0, description="How long a robot may rely on a signed serving answer [s]."
    )
    log_level: str = Field("INFO", description="Least severe level that is logged.")

    @field_validator("webhook_private_ranges")
    @classmethod
    def _require_ranges(cls, value: str | None) -> str | None:
        """Raises ValueError for a range that is none."""
        for text in listed(value):
            ipaddress.ip_network(text)
        return value

    @model_validator(mode="after")
    def _require_client(self) -> Self:
        """Raises ValueError for a provider without a client, or whose people may do nothing."""
        if self.openid_issuer is not None and not (self.openid_client_id and self.openid_groups):
            raise ValueError(
                "TRUEUP_OPENID_ISSUER needs TRUEUP_OPENID_CLIENT_ID and TRUEUP_OPENID_GROUPS"
            )
        return self

    @cached_property
    def sqlalchemy_url(self) -> str:
        """The URL of the database."""
        return self.database_url or f"sqlite:///{self.sqlite_file}"

    @property
    def sqlite_file(self) -> Path | None:
        """The file of the embedded database, None where the database is another one."""
        return (self.data_dir / "trueup.sqlite").absolute() if self.embedded else None

    @property
    def embedded(self) -> bool:
        """Whether the database is the embedded one."""
        return self.database_url is None
