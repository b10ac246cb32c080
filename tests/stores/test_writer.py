"""Actions that write share a commit where they wait for each other, and nothing else."""

import asyncio
import contextvars
import sqlite3
import threading
from contextlib import contextmanager

import pytest
from sqlalchemy import event
from sqlalchemy.exc import OperationalError

from tests.support.made import plant_document
from trueup.errors import BrokenChain
from trueup_service.actions.register_plant import register_plant
from trueup_service.actor_context import ActorContext
from trueup_service.errors import Conflict
from trueup_service.registry.transaction import reading

CONTEXT = ActorContext("tester", "2026-01-01T00:00:00.000000Z")


def register(name):
    return lambda tx: register_plant(tx, plant_document(name), CONTEXT)[0].name


def failing(tx):
    register("refused")(tx)
    raise Conflict("so that what was written is taken back")


def plants(parts):
    with reading(parts.database) as tx:
        return [plant.name for plant in tx.plants.page("", 100)], tx.log.size()


@contextmanager
def commits(parts):
    """How often the database was told to commit."""
    counted = []

    def count(connection):
        counted.append(connection)

    event.listen(parts.database.engine, "commit", count)
    yield counted
    event.remove(parts.database.engine, "commit", count)


def at_once(parts, *acts):
    """Lets actions wait behind one that is held, and returns what each returned or raised."""
    held, begun = threading.Event(), threading.Event()

    def first(tx):
        begun.set()
        assert held.wait(10)
        return register("first")(tx)

    ended = {}

    def run(number, act):
        try:
            ended[number] = parts.writer.run(act)
        except (Conflict, OperationalError) as error:
            ended[number] = error

    threads = [threading.Thread(target=run, args=(n, act)) for n, act in enumerate((first, *acts))]
    threads[0].start()
    assert begun.wait(10)
    for thread in threads[1:]:
        thread.start()
    while parts.database.is_sqlite and parts.writer._waiting.qsize() < len(acts):
        pass
    held.set()
    for thread in threads:
        thread.join(10)
    return [ended[number] for number in range(len(threads))]


def test_those_that_wait_share_a_commit_and_one_that_fails_takes_back_its_own_alone(
    parts, monkeypatch
):
    monkeypatch.setattr("trueup_service.registry.writer.LONGEST_S", 60.0)
    with commits(parts) as counted:
        ended = at_once(parts, register("second"), failing, register("third"))
    assert [*ended[:2], ended[3]] == ["first", "second", "third"]
    assert isinstance(ended[2], Conflict)
    assert plants(parts) == (["first", "second", "third"], 3)
    assert len(counted) == (1 if parts.database.is_sqlite else 3)


def test_what_the_log_does_not_tell_of_is_taken_back(parts):
    parts.writer.run(register("known"))

    def untold(tx):
        gateway = tx.plants._gateway
        gateway.note(tx.plants.table, {**vars_of(tx, "known"), "name": "untold"})

    with pytest.raises(BrokenChain):
        parts.writer.run(untold)
    assert plants(parts) == (["known"], 1)


def vars_of(tx, name):
    """The row of a plant as it is stored."""
    table = tx.plants.table
    return dict(tx.connection.execute(table.select().where(table.c.name == name)).mappings().one())


@pytest.mark.parametrize("storage", ["embedded"], indirect=True)
def test_a_commit_that_fails_fails_all_that_share_it_and_the_next_one_is_as_ever(
    parts, monkeypatch
):
    monkeypatch.setattr("trueup_service.registry.writer.LONGEST_S", 60.0)

    def broken(connection):
        event.remove(parts.database.engine, "commit", broken)
        raise OperationalError("COMMIT", {}, sqlite3.OperationalError("disk I/O error"))

    event.listen(parts.database.engine, "commit", broken)
    ended = at_once(parts, register("second"), failing)
    # a refusal, too, may rest on what the others wrote
    assert [type(each) for each in ended] == [OperationalError] * 3
    assert plants(parts) == ([], 0)
    assert parts.writer.run(register("next")) == "next"
    assert plants(parts) == (["next"], 1)


@pytest.mark.parametrize("storage", ["embedded"], indirect=True)
def test_where_sqlite_gives_up_the_transaction_nobody_in_it_is_answered_well(parts, monkeypatch):
    monkeypatch.setattr("trueup_service.registry.writer.LONGEST_S", 60.0)

    def giving_up(tx):
        register("lost")(tx)
        tx.connection.exec_driver_sql("ROLLBACK")  # as SQLite does when its disk fails
        raise OperationalError("INSERT", {}, sqlite3.OperationalError("disk I/O error"))

    ended = at_once(parts, giving_up)
    assert [type(each) for each in ended] == [OperationalError, OperationalError]
    assert plants(parts) == ([], 0)
    assert parts.writer.run(register("next")) == "next"


def test_the_event_loop_goes_on_meanwhile_and_the_caller_s_context_is_the_action_s(parts):
    who = contextvars.ContextVar("who", default="nobody")

    async def both():
        who.set("somebody")
        ticks, seen = 0, []

        def act(tx):
            seen.append(who.get())
            return register("plant")(tx)

        task = asyncio.create_task(parts.writer.run_async(act))
        while not task.done():
            ticks += 1
            await asyncio.sleep(0)
        return ticks, seen, task.result()

    ticks, seen, name = asyncio.run(both())
    assert ticks > 1
    assert (seen, name) == (["somebody"], "plant")


@pytest.mark.parametrize("storage", ["embedded"], indirect=True)
def test_what_is_cancelled_while_it_waits_is_not_done_and_what_has_begun_is(parts):
    held, begun = threading.Event(), threading.Event()

    def first(tx):
        begun.set()
        assert held.wait(10)
        return register("first")(tx)

    async def both():
        tasks = [asyncio.create_task(parts.writer.run_async(first))]
        while not begun.is_set():
            await asyncio.sleep(0.001)
        tasks.append(asyncio.create_task(parts.writer.run_async(register("second"))))
        await asyncio.sleep(0.01)
        for task in tasks:
            task.cancel()
        ended = await asyncio.gather(*tasks, return_exceptions=True)
        held.set()
        return ended, await parts.writer.run_async(register("third"))

    ended, third = asyncio.run(both())
    assert [type(each) for each in ended] == [asyncio.CancelledError] * 2
    assert third == "third"
    assert plants(parts) == (["first", "third"], 2)


def test_closing_waits_for_what_was_asked(parts):
    ended = at_once(parts, register("second"))
    parts.writer.close()
    assert ended == ["first", "second"]
    assert parts.writer.run(register("third")) == "third"  # it begins anew
