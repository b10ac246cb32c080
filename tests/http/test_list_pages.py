"""Lists of what a plant has, by their addresses, on both storages: sorted, filtered, found by name
and tag."""

import re
from contextlib import closing

import pytest

from tests.http.test_http import request
from tests.support.made import episode_bytes, identified, plant_document, save
from tests.support.service import ADMIN
from trueup.episode.role import Role
from trueup_client import Client

PLANT = "listed"
LENGTHS = {"short": 100, "middle": 200, "long": 300}  # samples of each recording


@pytest.fixture(scope="module")
def digests(service, tmp_path_factory):
    """The digest of each recording, of which the long one is held out and the short one has a
    tag."""
    folder = tmp_path_factory.mktemp("logs")
    with closing(Client(service.url, token=ADMIN)) as client:
        client.register_plant(plant_document(PLANT))
        uploaded = {}
        for seed, (name, samples) in enumerate(LENGTHS.items()):
            role = Role.VALIDATION if name == "long" else Role.ADAPTATION
            data = episode_bytes(seed, samples=samples, role=role)
            path = save(folder, f"{name}.mcap", data)
            uploaded[name] = client.upload_episode(PLANT, path)["digest"]
        client.change_label(PLANT, "episode", uploaded["short"], name="Cold 50 %", tags=["rig 2"])
        made = identified(PLANT)
        client.add_artifact(PLANT, made.manifest, made.arrays)
    return uploaded


def shown(service, address):
    """The first cell of each line of a list's page, without its marks."""
    status, _, body = request(service, "GET", f"/plants/{PLANT}/{address}")
    assert status == 200, address
    table = body.decode().partition("<tbody")[2].partition("</tbody>")[0]
    cells = re.findall(r"<tr[^>]*>\s*<td[^>]*>(.*?)</td>", table, flags=re.DOTALL)
    return [re.sub(r"<[^>]+>", "", cell).split("\n")[0].strip() for cell in cells]


@pytest.mark.parametrize(
    ("query", "expected"),
    [
        ("sort=duration", ["Cold 50 %", "middle.mcap", "long.mcap"]),
        ("sort=-duration", ["long.mcap", "middle.mcap", "Cold 50 %"]),
        ("role=validation", ["long.mcap"]),
        ("sort=duration&role=adaptation", ["Cold 50 %", "middle.mcap"]),
        ("tag=rig+2", ["Cold 50 %"]),
        ("tag=rig", []),
        ("q=COLD", ["Cold 50 %"]),
        ("q=50+%25", ["Cold 50 %"]),
        ("q=%25", ["Cold 50 %"]),  # a sign of its own, and no wildcard
        ("q=_", []),
        ("q=%5C", []),
        ("sort=duration&page=1&role=x", ["Cold 50 %", "middle.mcap", "long.mcap"]),
    ],
)
def test_recordings_are_listed_as_the_address_says(service, digests, query, expected):
    assert shown(service, f"episodes?{query}") == expected


def test_a_recording_is_found_by_the_beginning_of_its_digest(service, digests):
    assert shown(service, f"episodes?q={digests['middle'][:12]}") == ["middle.mcap"]


def test_versions_and_decisions_are_listed(service, digests):
    assert len(shown(service, "versions?sort=version")) == 2
    assert shown(service, "decisions?verdict=accepted") == []
