"""Recordings of each format, streamed into an episode: samples and bytes a second, beside MCAP's,
and the most memory that it takes."""

from __future__ import annotations

import json
import os
import sqlite3
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from bench.report import Figure, show
from trueup.episode.columns_writer import ColumnsWriter
from trueup.episode.joint_state import Columns
from trueup.episode.layout import Channel, Field
from trueup.episode.writer import ROS2_DEFINITION, encode_cdr

MEGABYTE = 1 << 20
BYTES = 1000 * MEGABYTE
MEMORY_LIMIT_MIB, LEAST_SHARE = 256.0, 0.5
PERIOD_NS, BLOCK = 1_000_000, 1 << 16
CHANNELS = (
    Channel("q", "rad", Field.POSITION, "elbow"),
    Channel("v", "rad/s", Field.VELOCITY, "elbow"),
)
COMMAND = (Channel("u", "N·m", Field.EFFORT, "elbow"),)

# Run in a process of its own, so that its memory is its own.
STREAM = """
import io, json, re, sys, time
from pathlib import Path
from trueup.recording.format import open_runs
from trueup.recording.guess import guess
from trueup.recording.mapping import layout_of
from trueup.recording.transcribe import Origin, transcribe
from trueup.episode.role import Role

class Sink(io.RawIOBase):
    at = 0
    def writable(self): return True
    def write(self, data): self.at += len(data); return len(data)
    def tell(self): return self.at

def run(path):
    (opened,) = open_runs(Path(path))
    mapping = guess(opened.recording)
    layout = layout_of(mapping, {})
    transcribe(opened.recording, mapping, layout, Sink(), role=Role.ADAPTATION, conditions={},
               origin=Origin("run", ""))

run(sys.argv[2])  # loads what is loaded once
began = time.process_time()
run(sys.argv[1])
cpu_s, status = time.process_time() - began, Path("/proc/self/status").read_text()
print(json.dumps({"cpu_s": cpu_s,
                  "mib": int(re.search(r"VmHWM:\\s+(\\d+)", status)[1]) / 1024}))
"""


def samples(rows, rng):
    """Blocks of stamps [ns] and of positions, velocities and commands."""
    for first in range(0, rows, BLOCK):
        count = min(BLOCK, rows - first)
        yield PERIOD_NS * np.arange(first, first + count), rng.normal(size=(3, count))


def as_mcap(path, rows, rng):
    with path.open("wb") as file:
        writer = ColumnsWriter(file, {"/joint_states": CHANNELS, "/joint_commands": COMMAND})
        for stamps, (q, v, u) in samples(rows, rng):
            writer.add("/joint_states", Columns(stamps, stamps, np.stack([q, v], axis=1)))
            writer.add("/joint_commands", Columns(stamps, stamps, u[:, None]))
        writer.finish({})


def as_parquet(path, rows, rng):
    import pyarrow as pa
    import pyarrow.parquet as pq

    names = ["time_s", "q_rad", "v_rad_s", "u_nm"]
    with pq.ParquetWriter(path, pa.schema([(n, pa.float64()) for n in names])) as writer:
        for stamps, (q, v, u) in samples(rows, rng):
            columns = [stamps / 1e9, q, v, u]
            writer.write_table(pa.table(dict(zip(names, columns, strict=True))))


def as_db3(path, rows, rng):
    kind = "sensor_msgs/msg/JointState"
    bag = sqlite3.connect(path)
    bag.executescript(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, "
        "serialization_format TEXT, offered_qos_profiles TEXT);"
        "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT, encoding TEXT, "
        "encoded_message_definition TEXT, type_description_hash TEXT);"
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
        "data BLOB);"
    )
    topics = (1, "/joint_states", kind), (2, "/joint_commands", kind)
    bag.executemany("INSERT INTO topics VALUES (?, ?, ?, 'cdr', '')", topics)
    bag.execute(
        "INSERT INTO message_definitions VALUES (1, ?, 'ros2msg', ?, '')", (kind, ROS2_DEFINITION)
    )
    insert = "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)"
    for stamps, values in samples(rows, rng):
        for at, q, v, u in zip(stamps.tolist(), *values.tolist(), strict=True):
            state = encode_cdr(at, ["elbow"], {"position": [q], "velocity": [v]})
            order = encode_cdr(at, ["elbow"], {"effort": [u]})
            bag.executemany(insert, [(1, at, state), (2, at, order)])
    bag.commit()
    bag.close()


def as_csv(path, rows, rng):
    with path.open("w") as file:
        file.write("time_s,q_rad,v_rad_s,u_nm\n")
        for stamps, values in samples(rows, rng):
            np.savetxt(file, np.column_stack([stamps / 1e9, *values]), "%.17g", ",")


def as_hdf5(path, rows, rng):
    import h5py

    names = ["time_s", "q_rad", "v_rad_s", "u_nm"]
    with h5py.File(path, "w") as file:
        sets = [file.create_dataset(n, (rows,), "f8", chunks=(min(rows, BLOCK),)) for n in names]
        at = 0
        for stamps, values in samples(rows, rng):
            for dataset, column in zip(sets, (stamps / 1e9, *values), strict=True):
                dataset[at : at + len(column)] = column
            at += len(stamps)


# of each format what writes it, the bytes of one sample in it, and the part of the size to measure
WRITERS = {
    "mcap": (as_mcap, 83.0, 1.0),
    "parquet": (as_parquet, 36.0, 1.0),
    "db3": (as_db3, 170.0, 1.0),
    "csv": (as_csv, 77.0, 0.2),
    "hdf5": (as_hdf5, 36.0, 0.2),
}


def measure(name, size, folder):
    """Samples and megabytes a CPU-second, and the most memory [MiB]."""
    write, per_sample, part = WRITERS[name]
    suffix = {"hdf5": "h5"}.get(name, name)
    path, small = folder / f"run.{suffix}", folder / f"small.{suffix}"
    rows = int(part * size / per_sample)
    write(path, rows, np.random.default_rng(0))
    write(small, 1000, np.random.default_rng(0))
    answer = subprocess.run(
        [sys.executable, "-c", STREAM, path, small], capture_output=True, check=True, text=True
    )
    said = json.loads(answer.stdout)
    megabytes = path.stat().st_size / MEGABYTE
    for file in (path, small):
        file.unlink()
    return rows / said["cpu_s"], megabytes / said["cpu_s"], said["mib"], megabytes


def main() -> None:
    size = int(os.environ.get("MEGABYTES", BYTES / MEGABYTE)) * MEGABYTE
    figures, own = [], {}
    with tempfile.TemporaryDirectory() as folder:
        for name in WRITERS:
            rate, speed, memory, megabytes = measure(name, size, Path(folder))
            own[name] = rate
            share, what = rate / own["mcap"], f"{name}, {megabytes:.0f} MiB"
            figures += [
                Figure(
                    f"{what}: most memory",
                    f"{memory:.0f} MiB",
                    f"< {MEMORY_LIMIT_MIB:g} MiB",
                    memory < MEMORY_LIMIT_MIB,
                ),
                Figure(
                    f"{what}: samples a CPU-second ({1e-3 * rate:.0f} k) beside MCAP's",
                    f"{share:.2f} x",
                    f">= {LEAST_SHARE:g} x",
                    share >= LEAST_SHARE,
                ),
                Figure(f"{what}: bytes", f"{speed:.0f} MiB/CPU-s"),
            ]
    show("formats: each streamed into an episode, in one pass", figures)


if __name__ == "__main__":
    main()
