"""Labels: what people call plants, episodes, versions and decisions. They change nothing that is
judged, and the log keeps what they were."""

from contextlib import closing

import pytest

from tests.support.made import episode_bytes, plant_document, save
from tests.support.service import ADMIN, command
from trueup_client import Client, Problem

PLANT = "labelled"


@pytest.fixture(scope="module")
def client(service):
    with closing(Client(service.url, token=ADMIN)) as client:
        client.register_plant(plant_document(PLANT))
        yield client


@pytest.fixture(scope="module")
def episode(client, tmp_path_factory):
    path = save(tmp_path_factory.mktemp("logs"), "monday-run.mcap", episode_bytes(seed=1))
    return client.upload_episode(PLANT, path)["digest"]


def newest_entry(client):
    return list(client.audit(plant=PLANT))[-1]


def test_a_recording_is_called_as_its_file(client, episode):
    assert client.label(PLANT, "episode", episode)["name"] == "monday-run.mcap"
    entry = next(e for e in client.audit(plant=PLANT) if e["kind"] == "episode:ingested")
    assert entry["facts"]["name"] == "monday-run.mcap"


def test_the_same_bytes_under_another_name_keep_their_first(client, episode, tmp_path):
    again = save(tmp_path, "copy.mcap", episode_bytes(seed=1))
    assert client.upload_episode(PLANT, again)["digest"] == episode
    assert client.label(PLANT, "episode", episode)["name"] == "monday-run.mcap"


def test_a_label_changes_in_parts_and_the_log_tells_what_it_was(client, episode):
    made = client.change_label(
        PLANT, "episode", episode, tags=["Cold", "bench  2", "cold"], note="Spring\nloose."
    )
    assert made["name"] == "monday-run.mcap"
    assert made["tags"] == ["cold", "bench 2"]
    assert made["note"] == "Spring\nloose."
    entry = newest_entry(client)
    assert (entry["kind"], entry["subject"]) == ("label:changed", episode)
    assert entry["facts"]["tags"] == ["cold", "bench 2"]
    cleared = client.change_label(PLANT, "episode", episode, note="")
    assert (cleared["note"], cleared["tags"]) == (None, ["cold", "bench 2"])
    before = newest_entry(client)["sequence"]
    client.change_label(PLANT, "episode", episode, note="")  # nothing differs
    assert newest_entry(client)["sequence"] == before


def test_every_kind_has_labels_and_they_are_listed_by_tag(client, episode):
    version = client.serving(PLANT).artifact
    client.change_label(PLANT, "plant", PLANT, name="Left bench", tags=["cold"])
    client.change_label(PLANT, "version", version, name="as declared")
    client.change_label(PLANT, "episode", episode, tags=["cold"])
    tagged = [(one["kind"], one["subject"]) for one in client.labels(PLANT, tag="COLD")]
    assert tagged == [("episode", episode), ("plant", PLANT)]
    assert [one["name"] for one in client.labels(PLANT, "version")] == ["as declared"]
    assert list(client.labels(PLANT, tag="col")) == []


def test_a_label_that_changed_since_it_was_read_is_refused(client):
    read = client.change_label(PLANT, "plant", PLANT, name="Bench")
    with pytest.raises(Problem) as refused:
        client.change_label(PLANT, "plant", PLANT, note="late", updated_at="")
    assert (refused.value.status, refused.value.code) == (409, "label-changed")
    assert refused.value.facts["updated_at"] == read["updated_at"]
    made = client.change_label(PLANT, "plant", PLANT, note="in time", updated_at=read["updated_at"])
    assert (made["name"], made["note"]) == ("Bench", "in time")


@pytest.mark.parametrize(
    ("kind", "subject"),
    [("episode", "0" * 64), ("version", "0" * 64), ("decision", "0" * 64), ("plant", "another")],
)
def test_what_does_not_exist_has_no_label(client, kind, subject):
    with pytest.raises(Problem) as refused:
        client.change_label(PLANT, kind, subject, name="x")
    assert refused.value.code == "not-found"


@pytest.mark.parametrize(
    "change", [{"tags": ["a,b"]}, {"tags": ["x" * 41]}, {"tags": [""]}, {"name": "a\x1b[31m"}]
)
def test_a_bad_label_is_refused_with_what_to_do(client, change):
    with pytest.raises(Problem) as refused:
        client.change_label(PLANT, "plant", PLANT, **change)
    assert refused.value.status in (400, 422)
    assert refused.value.hint


def test_an_auditor_reads_labels_and_changes_none(service, client):
    token = client.issue_token("reader", ["auditor"])["token"]
    with closing(Client(service.url, token=token)) as auditor:
        assert auditor.label(PLANT, "plant", PLANT)["plant"] == PLANT
        with pytest.raises(Problem) as refused:
            auditor.change_label(PLANT, "plant", PLANT, name="mine")
    assert refused.value.code == "forbidden"


def test_labels_are_given_by_the_command_and_stand_in_its_lists(service, client, episode):
    def run(*arguments):
        return command(service, *arguments).stdout

    assert "data sheet" in run(
        "label", PLANT, "--version", "1", "--name", "data sheet", "--tag", "old"
    )
    run("label", PLANT, "--version", "1", "--tag", "Older", "--untag", "OLD")
    version = client.serving(PLANT).artifact
    assert client.label(PLANT, "version", version)["tags"] == ["older"]
    assert "data sheet" in run("versions", PLANT)
    assert episode[:12] in run("label", PLANT)


def test_the_log_vouches_for_labels(service, client, episode):
    client.change_label(PLANT, "episode", episode, name="renamed")
    command(service, "audit", "verify")
