"""Every format obeys the same laws: a run comes back as it was written, with its irregular times
and its gaps, and whatever is wrong with a file is refused with a rule, and quickly."""

import io
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from tests.support import recorded
from trueup.episode.container import Limits
from trueup.episode.mcap import read_episode
from trueup.episode.role import Role
from trueup.errors import BadEpisode, BadMapping, NotAnEpisode, TooLarge
from trueup.recording.format import known_formats, open_runs
from trueup.recording.guess import guess
from trueup.recording.in_memory import table_recording
from trueup.recording.mapping import layout_of
from trueup.recording.transcribe import Origin, origin_of, transcribe

RUN = recorded.simulated(300)
LIMITS = Limits(file_bytes=32 << 20)
WRITERS = {
    "csv": lambda run, folder: recorded.as_csv(run, folder / "run.csv"),
    "npz": lambda run, folder: recorded.as_npz(run, folder / "run.npz"),
    "parquet": lambda run, folder: recorded.as_parquet(run, folder / "run.parquet", 64),
    "hdf5": lambda run, folder: recorded.as_hdf5([run], folder / "run.h5"),
    "rosbag2": lambda run, folder: recorded.joint_state_bag(run, folder / "run.db3"),
    "rosbag1": lambda run, folder: recorded.ros1_bag(run, folder / "run.bag"),
    "mcap": lambda run, folder: recorded.as_mcap(run, folder / "run.mcap"),
}
IN_MEMORY = ("dict", "structured", "pandas", "arrow")
FILES = sorted(WRITERS)


def episode_of(recording, origin=None, **cut):
    """The episode that a recording becomes, by the mapping that its names tell."""
    mapping = guess(recording)
    layout = layout_of(mapping, {})
    stream = io.BytesIO()
    transcribe(
        recording,
        mapping,
        layout,
        stream,
        role=Role.ADAPTATION,
        conditions={"stage": "SIL"},
        origin=origin or Origin("run", "0" * 64),
        **cut,
    )
    return read_episode(stream.getvalue(), layout)


def written(name, run, tmp_path):
    (opened,) = open_runs(WRITERS[name](run, tmp_path), LIMITS)
    return opened


def table(kind, run):
    """The run as a table in memory."""
    if kind == "structured":
        names = list(run.columns)
        rows = np.zeros(len(run.q), [(n, "f8") for n in names])
        for n in names:
            rows[n] = run.columns[n]
        return rows
    if kind == "pandas":
        import pandas as pd

        return pd.DataFrame(run.columns)
    if kind == "arrow":
        import pyarrow as pa

        return pa.table(run.columns)
    return run.columns


def test_every_format_is_under_these_laws():
    assert {f.name for f in known_formats()} == {*WRITERS, "lerobot"}


@pytest.mark.parametrize("name", FILES)
def test_a_run_comes_back_sample_by_sample(name, tmp_path):
    opened = written(name, RUN, tmp_path)
    episode = episode_of(opened.recording, origin_of(opened.path))
    np.testing.assert_array_equal(np.round(episode.t_s * 1e9), RUN.stamps_ns - RUN.stamps_ns[0])
    np.testing.assert_array_equal(episode.observations, np.stack([RUN.q, RUN.v], axis=1))
    np.testing.assert_array_equal(episode.commands[:, 0], RUN.u)
    assert episode.source["format"] == name
    assert len(episode.source["sha256"]) == 64
    assert not episode.missing


def test_one_run_has_one_digest_in_every_format(tmp_path):
    digests = {episode_of(written(n, RUN, tmp_path).recording).samples_digest for n in FILES}
    digests |= {episode_of(table_recording(table(k, RUN))).samples_digest for k in IN_MEMORY}
    assert len(digests) == 1


@pytest.mark.parametrize("name", FILES)
def test_the_same_file_gives_the_same_bytes(name, tmp_path):
    opened = written(name, RUN, tmp_path)
    origin = origin_of(opened.path)
    assert len({episode_of(opened.recording, origin).digest for _ in range(2)}) == 1


@pytest.mark.parametrize("name", FILES)
def test_irregular_times_and_gaps_are_kept(name, tmp_path):
    rng = np.random.default_rng(1)
    steps = recorded.PERIOD_NS + rng.integers(-2_000_000, 2_000_000, len(RUN.q))
    steps[150] += 400_000_000
    run = replace(RUN, stamps_ns=recorded.T0_NS + np.cumsum(steps))
    episode = episode_of(written(name, run, tmp_path).recording)
    np.testing.assert_array_equal(np.round(episode.t_s * 1e9), run.stamps_ns - run.stamps_ns[0])
    assert list(episode.gaps) == [150]


@pytest.mark.parametrize("name", FILES)
def test_a_lost_value_is_lost_and_named(name, tmp_path):
    q = RUN.q.copy()
    q[7] = np.nan
    episode = episode_of(written(name, replace(RUN, q=q), tmp_path).recording)
    assert len(episode.t_s) == len(RUN.q) - 1
    assert [o.messages for o in episode.omissions] == [1]


@pytest.mark.parametrize("name", FILES)
def test_a_clock_that_runs_back_is_refused(name, tmp_path):
    stamps = RUN.stamps_ns.copy()
    stamps[100] -= 50_000_000
    recording = written(name, replace(RUN, stamps_ns=stamps), tmp_path).recording
    if name == "rosbag1":  # whose index gives its messages in the order of their times
        assert (np.diff(episode_of(recording).t_s) > 0.0).all()
        return
    with pytest.raises(NotAnEpisode) as refused:
        episode_of(recording)
    assert refused.value.facts["rule"] == "clock"


@pytest.mark.parametrize("name", FILES)
def test_a_part_of_a_run_is_cut_by_its_times(name, tmp_path):
    recording = written(name, RUN, tmp_path).recording
    stream = guess(recording).sources[0].stream
    span = recording.span(stream, guess(recording).clock)
    cut = span.first_ns + 100 * recorded.PERIOD_NS
    before, after = episode_of(recording, end_ns=cut), episode_of(recording, begin_ns=cut)
    assert (len(before.t_s), len(after.t_s), span.rows) == (100, 200, 300)


@pytest.mark.parametrize("name", FILES)
def test_a_signal_that_is_not_there_is_named_with_those_that_are(name, tmp_path):
    recording = written(name, RUN, tmp_path).recording
    mapping = guess(recording)
    wrong = replace(
        mapping, sources=(replace(mapping.sources[0], signal="nothing"), *mapping.sources[1:])
    )
    with pytest.raises(BadMapping) as refused:
        wrong.require(recording)
    assert mapping.sources[0].signal in refused.value.hint


@pytest.mark.parametrize("name", FILES)
def test_a_file_beyond_the_limit_is_refused(name, tmp_path):
    path = WRITERS[name](RUN, tmp_path)
    with pytest.raises(TooLarge):
        for run in open_runs(path, Limits(file_bytes=100, unfold_free_bytes=100)):
            episode_of(run.recording)


@pytest.mark.parametrize("name", FILES)
def test_damaged_files_are_refused_and_nothing_else_happens(name, tmp_path):
    path = WRITERS[name](RUN, tmp_path)
    whole, rng, refusals = path.read_bytes(), np.random.default_rng(2), 0
    for attempt in range(60):
        spoilt = bytearray(whole)
        if attempt % 3 == 0:
            del spoilt[int(rng.integers(1, len(whole))) :]
        else:
            for at in rng.integers(0, len(whole), 1 + attempt // 6):
                spoilt[at] = int(rng.integers(256))
        path.write_bytes(spoilt)
        try:
            for run in open_runs(path, LIMITS):
                episode_of(run.recording)
        except (BadEpisode, BadMapping):
            refusals += 1
    assert refusals


def test_a_bomb_of_zeros_is_refused_before_it_unfolds(tmp_path):
    size = 256 << 20
    path = tmp_path / "bomb.npz"
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive,
        archive.open("q.npy", "w", force_zip64=True) as entry,
    ):
        head = io.BytesIO()
        declared = {"descr": "<f8", "fortran_order": False, "shape": (size // 8,)}
        np.lib.format.write_array_header_1_0(head, declared)
        entry.write(head.getvalue())
        for _ in range(size >> 20):
            entry.write(bytes(1 << 20))
    with pytest.raises(TooLarge):
        open_runs(path, LIMITS)


def test_a_parquet_bomb_is_refused(tmp_path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    zeros = np.zeros(1 << 22)
    path = tmp_path / "bomb.parquet"
    pq.write_table(
        pa.table({"time_s": zeros, "q": zeros, "u": zeros}),
        path,
        use_dictionary=False,
        compression="zstd",
        row_group_size=1 << 22,
    )
    (run,) = open_runs(path, Limits(unfold_ratio=100.0))
    with pytest.raises(TooLarge):
        episode_of(run.recording)


def test_an_hdf5_bomb_is_refused(tmp_path):
    import h5py

    path = tmp_path / "bomb.h5"
    with h5py.File(path, "w") as file:
        for name in ("time_s", "q", "u"):
            file.create_dataset(name, shape=(1 << 27,), dtype="f8", chunks=(1 << 16,))
    (run,) = open_runs(path, LIMITS)
    with pytest.raises(TooLarge):
        episode_of(run.recording)


def test_a_bag_with_sql_of_its_own_is_refused(tmp_path):
    import sqlite3

    path = recorded.joint_state_bag(RUN, tmp_path / "run.db3")
    with sqlite3.connect(path) as bag:
        bag.executescript(
            "ALTER TABLE messages RENAME TO hidden;"
            "CREATE VIEW messages AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id + 1 "
            "FROM n) SELECT n.id, topic_id, timestamp, data FROM n, hidden;"
        )
    (run,) = open_runs(path, LIMITS)
    with pytest.raises(BadEpisode, match="views"):
        episode_of(run.recording)
