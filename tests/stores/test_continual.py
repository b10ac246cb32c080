"""Monitors, alarms and policies in both storages: what they promise."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest

from tests.support.made import plant_document
from trueup.episode.role import WATCHED
from trueup.gate.decision import default_gate
from trueup.gate.policy import BadPolicy, UpdatePolicy
from trueup_service.actions.add_monitor import add_monitor
from trueup_service.actions.alarms import close_alarm, raise_alarm
from trueup_service.actions.continue_cycle import Cycle
from trueup_service.actions.declare_gate import declare_gate
from trueup_service.actions.declare_policy import declare_policy
from trueup_service.actions.record_decision import record_decision
from trueup_service.actions.record_watch import Followed, record_watch
from trueup_service.actions.register_plant import register_plant
from trueup_service.actions.submission import Submission
from trueup_service.actions.submit_trial import submit_gate
from trueup_service.actor_context import ActorContext, time_text
from trueup_service.errors import Conflict, HeldOutSpent, NotFound
from trueup_service.registry.records import ArtifactRecord, EpisodeRecord, JobState, Watch
from trueup_service.registry.transaction import ReadTransaction, Transaction
from trueup_worker.schedule import submit_due

NOW = datetime(2026, 1, 1, tzinfo=UTC)
FOUND = {
    "episode": "e" * 64,
    "document": {"since_ns": "0", "detectors": {}, "change": {"words": []}},
}


def at(second: float) -> ActorContext:
    return ActorContext("tester", time_text(NOW + timedelta(seconds=second)))


@pytest.fixture
def parts(storage):
    found = storage.build()
    found.queue.prepare()
    with found.database.write() as connection:
        register_plant(Transaction(connection), plant_document("p"), at(0))
    yield found
    found.close()


def add_episode(parts, name: str, role: str, second: float, start_ns: int = 0) -> str:
    digest = name * 64
    summary = {"conditions": {}, "ranges": {}, "period_s": 0.1}
    with parts.database.write() as connection:
        Transaction(connection).episodes.add(
            EpisodeRecord(
                "p", digest, 1, role, start_ns, start_ns, summary, at(second).now, "robot"
            )
        )
    return digest


def add_monitor_of(parts, artifact: str, second: float) -> str:
    document = {"artifact": artifact, "promise_h": 1.0, "made": second}
    with parts.database.write() as connection:
        tx = Transaction(connection)
        add_monitor(tx, "p", document, {"detector": [0.0]}, None, at(second).now, at(second))
        return tx.watches.current("p").monitor


def serving(parts) -> str:
    with parts.database.read() as connection:
        return ReadTransaction(connection).serving.now("p").artifact


def serving_of(tx: Transaction) -> str:
    return tx.serving.now("p").artifact


def jobs(parts) -> list[str]:
    with parts.database.read() as connection:
        return [j.kind for j in ReadTransaction(connection).jobs.page("p", "9999", 100)]


def go_on(parts, second: float) -> None:
    ids = iter(f"{i:032x}" for i in range(int(second * 100), 10**9))
    with parts.database.write() as connection:
        Cycle(Transaction(connection), parts.queue, lambda: next(ids), at(second)).go_on("p")


def finish(parts, kind: str, **result: object) -> None:
    with parts.database.write() as connection:
        tx = Transaction(connection)
        job = tx.jobs.last("p", kind)
        tx.jobs.update(job.id, now=at(0).now, state=JobState.SUCCEEDED, result=result)


def diagnosed(parts, second: float) -> str:
    """The last diagnosis has named an effect, and its corrected model is a candidate with which the
    cycle goes on."""
    candidate = "f" * 64
    with parts.database.write() as connection:
        tx = Transaction(connection)
        tx.artifacts.add(
            ArtifactRecord(
                "p", 2, candidate, "corrected", "{}", None, None, at(second).now, "worker"
            )
        )
        cycle = Cycle(tx, parts.queue, lambda: "3" * 32, at(second))
        cycle.diagnosed(tx.jobs.last("p", "diagnose"), candidate, "effect")
    return candidate


def test_a_monitor_moves_on_once_over_what_it_has_not_seen(parts):
    add_episode(parts, "a", "reference", 1)
    monitor = add_monitor_of(parts, serving(parts), 2)
    later, earlier = (
        add_episode(parts, "b", "telemetry", 3, start_ns=9),
        add_episode(parts, "c", "adaptation", 4, start_ns=5),
    )
    add_episode(parts, "d", "test", 5)
    with parts.database.write() as connection:
        tx = Transaction(connection)
        before = tx.watches.current("p")
        assert [e.digest for e in tx.episodes.unwatched(before, WATCHED, 10)] == [earlier, later]
        seen = [
            Watch("p", monitor, i + 1, d, {"seconds": 1.0}, at(6).now)
            for i, d in enumerate([earlier, later])
        ]
        followed = Followed(before, {"detector": [1.5]}, seen, None)
        assert record_watch(tx, followed, "0" * 32, at(6))
        assert not record_watch(tx, followed, "1" * 32, at(6))
        now = tx.watches.current("p")
        assert (now.sequence, now.kept) == (2, {"detector": [1.5]})
        assert tx.episodes.unwatched(now, WATCHED, 10) == []
        assert [w.episode for w in tx.watches.page("p", monitor, 1, 10)] == [later]


def test_while_an_alarm_is_open_no_other_is_raised(parts):
    with parts.database.write() as connection:
        tx = Transaction(connection)
        first = raise_alarm(tx, "0" * 32, "p", None, serving_of(tx), FOUND, at(1))
        assert raise_alarm(tx, "1" * 32, "p", None, serving_of(tx), FOUND, at(2)) is None
        close_alarm(tx, "p", first.id, "mended", at(3))
        with pytest.raises(Conflict):
            close_alarm(tx, "p", first.id, "again", at(4))
        assert raise_alarm(tx, "2" * 32, "p", None, serving_of(tx), FOUND, at(5)) is not None
        with pytest.raises(NotFound):
            close_alarm(tx, "q", first.id, "another's", at(6))


def test_a_look_is_asked_for_once_and_not_of_a_monitor_of_another_model(parts):
    add_monitor_of(parts, serving(parts), 2)
    add_episode(parts, "b", "telemetry", 3)
    go_on(parts, 4)
    go_on(parts, 5)
    assert jobs(parts) == ["watch"]
    finish(parts, "watch")
    add_monitor_of(parts, "f" * 64, 6)
    add_episode(parts, "c", "telemetry", 7)
    go_on(parts, 8)
    assert jobs(parts) == ["watch"]


def test_an_alarm_is_diagnosed_once_there_is_something_to_diagnose_and_again_at_twice_as_much(
    parts,
):
    add_episode(parts, "a", "adaptation", 1, start_ns=-5)  # from before the change
    with parts.database.write() as connection:
        raise_alarm(
            tx := Transaction(connection), "0" * 32, "p", None, serving_of(tx), FOUND, at(2)
        )
    add_episode(parts, "b", "adaptation", 3, start_ns=1)
    go_on(parts, 4)
    assert jobs(parts) == []
    add_episode(parts, "c", "validation", 5, start_ns=2)
    go_on(parts, 6)
    go_on(parts, 7)
    assert jobs(parts) == ["diagnose"]
    finish(parts, "diagnose", report={"verdict": "no_gap"})
    add_episode(parts, "d", "adaptation", 8, start_ns=3)
    go_on(parts, 9)
    assert jobs(parts) == ["diagnose"]
    add_episode(parts, "e", "validation", 10, start_ns=4)
    go_on(parts, 11)
    assert jobs(parts) == ["diagnose"] * 2
    with parts.database.read() as connection:
        tx = ReadTransaction(connection)
        assert tx.jobs.get(tx.alarms.open("p").job).request["episodes"] == [d * 64 for d in "bcde"]
    finish(parts, "diagnose", report={"verdict": "effect"}, artifact="f" * 64)
    for i, d in enumerate("0123"):
        add_episode(parts, d, "validation", 12 + i, start_ns=6 + i)
    go_on(parts, 20)
    assert jobs(parts) == ["diagnose"] * 2


def test_a_policy_that_asks_at_an_alarm_leaves_the_diagnosis_to_a_person(parts):
    with parts.database.write() as connection:
        tx = Transaction(connection)
        gate, _ = declare_gate(tx, "p", None, at(1))
        held, new = declare_policy(
            tx, "p", UpdatePolicy(gate.digest, on_alarm="ask").document(), at(2)
        )
        assert new
        assert not declare_policy(tx, "p", held.document, at(3))[1]
        raise_alarm(tx, "0" * 32, "p", None, serving_of(tx), FOUND, at(4))
    add_episode(parts, "b", "adaptation", 5)
    add_episode(parts, "c", "validation", 6)
    go_on(parts, 7)
    assert jobs(parts) == []


@pytest.mark.parametrize(
    ("step", "tried", "generation"),
    [({"on_diagnosis": "ask"}, False, 1), ({"on_acceptance": "ask"}, True, 1), ({}, True, 2)],
)
def test_a_policy_that_asks_at_a_later_step_leaves_that_one_to_a_person(
    parts, step, tried, generation
):
    with parts.database.write() as connection:
        tx = Transaction(connection)
        gate, _ = declare_gate(tx, "p", None, at(1))
        policy = UpdatePolicy(gate.digest, **{"on_acceptance": "promote", **step})
        declare_policy(tx, "p", policy.document(), at(2))
        raise_alarm(tx, "0" * 32, "p", None, serving_of(tx), FOUND, at(3))
    add_episode(parts, "b", "adaptation", 4, start_ns=1)
    add_episode(parts, "c", "validation", 5, start_ns=2)
    go_on(parts, 6)
    candidate = diagnosed(parts, 7)
    with parts.database.write() as connection:
        tx = Transaction(connection)
        trial = tx.alarms.open("p").trial
        assert (trial is not None) == tried
        if trial is not None:
            document = {
                "gate": gate.digest,
                "candidate": candidate,
                "accepted": True,
                "incumbent": serving_of(tx),
                "generation": 1,
                "episodes": ["c" * 64],
            }
            made = record_decision(tx, "p", document, trial, at(8))
            cycle = Cycle(tx, parts.queue, lambda: "8" * 32, at(8))
            cycle.judged(tx.jobs.get(trial), made, {"seconds": 0.0})
        assert tx.serving.now("p").generation == generation
        assert (tx.alarms.open("p") is None) == (generation == 2)


def test_a_policy_names_a_gate_that_was_declared(parts):
    with parts.database.write() as connection, pytest.raises(NotFound):
        declare_policy(Transaction(connection), "p", UpdatePolicy("a" * 64).document(), at(1))


def test_a_spent_held_out_episode_is_not_judged_on_again(parts):
    spent, fresh = (
        add_episode(parts, "a", "validation", 1),
        add_episode(parts, "b", "validation", 2),
    )
    with parts.database.write() as connection:
        tx = Transaction(connection)
        default, _ = declare_gate(tx, "p", None, at(3))
        gate, _ = declare_gate(tx, "p", {**default.document, "held_out_uses": 1}, at(3))
        candidate = tx.serving.now("p").artifact
        request = {"candidate": candidate, "gate": gate.digest}

        def submit(job, request, context):
            return submit_gate(Submission(tx, parts.queue, job, "p", request, context))

        submit("1" * 32, {**request, "episodes": [spent]}, at(4))
        left = submit("2" * 32, request, at(5))
        assert (left.request["episodes"], left.request["spent"]) == ([fresh], [spent])
        with pytest.raises(HeldOutSpent, match="2 held-out episodes were used 1 times"):
            submit("3" * 32, {**request, "episodes": [spent, fresh]}, at(6))
        with pytest.raises(HeldOutSpent):
            submit("4" * 32, request, at(7))


def test_validation_is_due_without_any_alarm_and_not_before_its_time(parts):
    with parts.database.write() as connection:
        tx = Transaction(connection)
        gate, _ = declare_gate(tx, "p", None, at(1))
        declare_policy(tx, "p", UpdatePolicy(gate.digest, validate_every_h=1.0).document(), at(2))
    # nothing was held out since the model serves
    assert submit_due(parts, NOW + timedelta(seconds=3)) == []
    for i, name in enumerate("abcd"):
        add_episode(parts, name, "validation", 4 + 0.1 * i)
    assert submit_due(parts, NOW + timedelta(seconds=5)) == []  # four differ by luck alone
    add_episode(parts, "e", "validation", 5)
    assert submit_due(parts, NOW + timedelta(seconds=6)) == ["p"]
    assert submit_due(parts, NOW + timedelta(minutes=59)) == []
    assert submit_due(parts, NOW + timedelta(minutes=61)) == ["p"]
    assert jobs(parts) == ["validate"] * 2


@pytest.mark.parametrize(
    ("spoil", "field"),
    [
        ({"on_alarm": "panic"}, "on_alarm"),
        ({"on_acceptance": "judge"}, "on_acceptance"),
        ({"gate": "the best one"}, "gate"),
        ({"gate": 7}, None),
        ({"promise_h": 0.0}, "promise_h"),
        ({"promise_h": "long"}, None),
        ({"validate_every_h": float("nan")}, "promise_h"),
        ({"validate_every_h": 1e9}, "promise_h"),
        ({"reference_episodes": 1}, "promise_h"),
        ({"schema": "other"}, "schema"),
        ({"more": 1}, None),
    ],
)
def test_a_policy_that_cannot_be_followed_is_refused(spoil, field):
    sound = UpdatePolicy("a" * 64).document()
    assert UpdatePolicy.from_document(sound).digest == replace(UpdatePolicy("a" * 64)).digest
    with pytest.raises(BadPolicy) as refused:
        UpdatePolicy.from_document({**sound, **spoil})
    assert refused.value.facts.get("field") == field


def test_a_monitor_that_watches_again_goes_on_counting_where_it_was(parts):
    monitor = add_monitor_of(parts, serving(parts), 1)
    add_episode(parts, "a", "telemetry", 2)
    with parts.database.write() as connection:
        tx = Transaction(connection)
        seen = [Watch("p", monitor, 1, "a" * 64, {"seconds": 1.0}, at(3).now)]
        record_watch(tx, Followed(tx.watches.current("p"), {}, seen, None), "0" * 32, at(3))
    assert add_monitor_of(parts, serving(parts), 1) == monitor
    with parts.database.read() as connection:
        tx = ReadTransaction(connection)
        assert tx.watches.current("p").sequence == 1
        assert tx.episodes.unwatched(tx.watches.current("p"), WATCHED, 10) == []


def test_only_the_trial_that_the_cycle_asked_for_promotes_and_only_by_the_policys_gate(parts):
    with parts.database.write() as connection:
        tx = Transaction(connection)
        strict_document = default_gate(2.0).document()
        meant = {
            "rules": [{"rule": "rollout_improves", "ratio": 1e9}],
            "vacuous": True,
            "because": "any serves",
        }
        lax, _ = declare_gate(tx, "p", {**strict_document, **meant}, at(1))
        strict, _ = declare_gate(tx, "p", strict_document, at(1))
        declare_policy(
            tx, "p", UpdatePolicy(strict.digest, on_acceptance="promote").document(), at(2)
        )
        raise_alarm(tx, "0" * 32, "p", None, serving_of(tx), FOUND, at(3))
    for i, role in enumerate(["adaptation", "validation", "validation"]):
        add_episode(parts, "bcd"[i], role, 4 + i, start_ns=1 + i)
    go_on(parts, 8)
    candidate = diagnosed(parts, 9)
    with parts.database.write() as connection:
        tx = Transaction(connection)
        trial = tx.jobs.get(tx.alarms.open("p").trial)
        assert (trial.kind, trial.request["gate"], trial.request["episodes"]) == (
            "gate",
            strict.digest,
            ["c" * 64, "d" * 64],
        )
        request = {"candidate": candidate, "gate": strict.digest}
        by_hand = submit_gate(Submission(tx, parts.queue, "9" * 32, "p", request, at(10)))
    for job, gate, promoted in (
        (by_hand, lax, 1),
        (by_hand, strict, 1),
        (trial, lax, 1),
        (trial, strict, 2),
    ):
        with parts.database.write() as connection:
            tx = Transaction(connection)
            now = tx.serving.now("p")
            against = {
                "incumbent": now.artifact,
                "generation": now.generation,
                "episodes": trial.request["episodes"],
            }
            document = {
                "gate": gate.digest,
                "candidate": candidate,
                "accepted": True,
                "by": job.id,
                **against,
            }
            made = record_decision(tx, "p", document, job.id, at(11))
            Cycle(tx, parts.queue, lambda: "8" * 32, at(12)).judged(job, made, {"seconds": 0.0})
            assert tx.serving.now("p").generation == promoted
    with parts.database.read() as connection:
        assert ReadTransaction(connection).alarms.open("p") is None


def test_a_refused_trial_is_tried_again_with_twice_as_much(parts):
    with parts.database.write() as connection:
        tx = Transaction(connection)
        gate, _ = declare_gate(tx, "p", None, at(1))
        declare_policy(tx, "p", UpdatePolicy(gate.digest).document(), at(2))
        raise_alarm(tx, "0" * 32, "p", None, serving_of(tx), FOUND, at(3))
    add_episode(parts, "b", "adaptation", 4, start_ns=1)
    add_episode(parts, "c", "validation", 5, start_ns=2)
    go_on(parts, 6)
    finish(parts, "diagnose", report={"verdict": "effect"}, artifact="f" * 64)
    diagnosed(parts, 7)
    add_episode(parts, "d", "adaptation", 8, start_ns=3)
    add_episode(parts, "e", "validation", 9, start_ns=4)
    go_on(parts, 10)
    assert jobs(parts).count("diagnose") == 1  # the trial is under way
    finish(parts, "gate", accepted=False)
    go_on(parts, 11)
    assert jobs(parts).count("diagnose") == 2
