"""One run of a simulated joint, written in every format that a team may have it in."""

from __future__ import annotations

import csv
import json
import sqlite3
from dataclasses import dataclass

import numpy as np

from trueup.episode.writer import ROS2_DEFINITION

T0_NS = 1_760_000_000_000_000_000
PERIOD_NS = 10_000_000
NAMES = ["time_s", "q_rad", "v_rad_s", "u_nm"]


@dataclass(frozen=True)
class Run:
    """Times [ns] `(n,)`, positions, velocities and commands `(n,)` of one joint."""

    stamps_ns: np.ndarray
    q: np.ndarray
    v: np.ndarray
    u: np.ndarray

    @property
    def t_s(self):
        """Times [s] from the first sample."""
        return (self.stamps_ns - self.stamps_ns[0]) / 1e9

    @property
    def columns(self):
        """The columns of a table of it."""
        return dict(zip(NAMES, (self.t_s, self.q, self.v, self.u), strict=True))


def simulated(samples=800, seed=0, friction=0.6):
    """A run of a joint with dry friction: v' = 8 u - 2 v - friction sign(v), and a spring."""
    rng = np.random.default_rng(seed)
    u = np.clip(np.convolve(rng.normal(size=samples), np.ones(40) / 12, "same"), -1.0, 1.0)
    q, v, h, steps = np.zeros(samples), np.zeros(samples), 1e-9 * PERIOD_NS, 20
    for i in range(samples - 1):
        x, w = q[i], v[i]
        for _ in range(steps):
            free = w + h / steps * (8.0 * u[i] - 2.0 * w - 9.0 * x)
            w = np.sign(free) * max(abs(free) - h / steps * friction, 0.0)
            x += h / steps * w
        q[i + 1], v[i + 1] = x, w
    noise = rng.normal(scale=1e-4, size=(2, samples))
    stamps = T0_NS + PERIOD_NS * np.arange(samples)
    return Run(stamps, q + noise[0], v + noise[1], u)


def as_csv(run, path, names=None, delimiter=",", decimal=".", scale=None):
    """The run as a table of text; `scale` multiplies columns."""
    columns = [np.asarray(c) for c in run.columns.values()]
    if scale is not None:
        columns = [c * s for c, s in zip(columns, scale, strict=True)]
    with path.open("w", newline="") as file:
        writer = csv.writer(file, delimiter=delimiter)
        writer.writerow(names or NAMES)
        for row in zip(*columns, strict=True):
            writer.writerow([repr(float(x)).replace(".", decimal) for x in row])
    return path


def as_npz(run, path):
    """The run as an archive of arrays."""
    np.savez_compressed(path, **run.columns)
    return path


def as_parquet(run, path, row_group_size=None):
    """The run as Parquet."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.table(run.columns), path, row_group_size=row_group_size)
    return path


def as_hdf5(runs, path):
    """Runs as demonstrations of one file, or one run as its datasets."""
    import h5py

    with h5py.File(path, "w") as file:
        for i, run in enumerate(runs):
            group = file.create_group(f"data/demo_{i}") if len(runs) > 1 else file
            for name, values in run.columns.items():
                group.create_dataset(name, data=values, compression="gzip")
    return path


def as_lerobot(runs, folder, *, names=("elbow.pos",), degrees=True, fps=100):
    """Runs as episodes of a LeRobotDataset: states and actions are positions."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    (folder / "data/chunk-000").mkdir(parents=True)
    (folder / "meta").mkdir()
    factor = 180.0 / np.pi if degrees else 1.0
    feature = {"dtype": "float32", "shape": [len(names)], "names": list(names)}
    info = {
        "codebase_version": "v3.0",
        "robot_type": "so101_follower",
        "fps": fps,
        "total_episodes": len(runs),
        "features": {"observation.state": feature, "action": feature},
    }
    (folder / "meta/info.json").write_text(json.dumps(info))
    tables = []
    for i, run in enumerate(runs):
        frames = np.arange(len(run.q))
        state, action = ((factor * x).astype("f4")[:, None] for x in (run.q, run.u))
        width = pa.list_(pa.float32(), len(names))
        tables.append(
            pa.table(
                {
                    "observation.state": pa.array(list(state), width),
                    "action": pa.array(list(action), width),
                    "timestamp": (frames / fps).astype("f4"),
                    "frame_index": frames,
                    "episode_index": np.full(len(frames), i),
                }
            )
        )
    pq.write_table(pa.concat_tables(tables), folder / "data/chunk-000/file-000.parquet")
    return folder


def typestore():
    """ROS 2 message types, with ros2_control's."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    from trueup.recording.ros_types import CONTROL_MESSAGES

    store = get_typestore(Stores.LATEST)
    for name in sorted(CONTROL_MESSAGES, key=lambda n: n.endswith(("Stamped", "JointState"))):
        store.register(get_types_from_msg(CONTROL_MESSAGES[name][0], name))
    return store


def header(store, stamp_ns):
    """A message's header."""
    time = store.types["builtin_interfaces/msg/Time"](
        sec=int(stamp_ns // 10**9), nanosec=int(stamp_ns % 10**9)
    )
    return store.types["std_msgs/msg/Header"](stamp=time, frame_id="base")


def joint_state(store, stamp_ns, names, position=(), velocity=(), effort=()):
    """A JointState."""
    return store.types["sensor_msgs/msg/JointState"](
        header=header(store, stamp_ns),
        name=list(names),
        position=np.array(position, float),
        velocity=np.array(velocity, float),
        effort=np.array(effort, float),
    )


def point(store, positions=(), velocities=(), effort=(), after_ns=0):
    """A point of a trajectory."""
    return store.types["trajectory_msgs/msg/JointTrajectoryPoint"](
        positions=np.array(positions, float),
        velocities=np.array(velocities, float),
        accelerations=np.zeros(0),
        effort=np.array(effort, float),
        time_from_start=store.types["builtin_interfaces/msg/Duration"](
            sec=int(after_ns // 10**9), nanosec=int(after_ns % 10**9)
        ),
    )


def controller_state(store, stamp_ns, joint, q, v, u):
    """A JointTrajectoryControllerState whose output is an effort."""
    none = store.types["trajectory_msgs/msg/MultiDOFJointTrajectoryPoint"](
        transforms=[], velocities=[], accelerations=[], time_from_start=point(store).time_from_start
    )
    empty = point(store)
    phases = dict.fromkeys(("reference", "error", "desired"), empty)
    seen = point(store, [q], [v])
    return store.types["control_msgs/msg/JointTrajectoryControllerState"](
        header=header(store, stamp_ns),
        joint_names=[joint],
        feedback=seen,
        actual=seen,
        output=point(store, effort=[u]),
        multi_dof_joint_names=[],
        **phases,
        **{
            f"multi_dof_{p}": none
            for p in ("reference", "feedback", "error", "output", "desired", "actual")
        },
    )


def as_db3(path, topics, *, defines=True):
    """A SQLite bag of `topics`: of each its type, messages with their log time [ns], and the type's
    definition."""
    bag = sqlite3.connect(path)
    bag.executescript(
        "CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);"
        "CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, "
        "metadata TEXT NOT NULL);"
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, "
        "serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL, "
        "type_description_hash TEXT NOT NULL);"
        "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, "
        "encoding TEXT NOT NULL, encoded_message_definition TEXT NOT NULL, "
        "type_description_hash TEXT NOT NULL);"
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, "
        "timestamp INTEGER NOT NULL, data BLOB NOT NULL);"
        "CREATE INDEX timestamp_idx ON messages (timestamp ASC);"
    )
    bag.execute("INSERT INTO schema VALUES (4, 'jazzy')")
    for i, (name, (kind, messages, definition)) in enumerate(topics.items(), 1):
        bag.execute("INSERT INTO topics VALUES (?, ?, ?, 'cdr', '', '')", (i, name, kind))
        if defines and definition:
            bag.execute(
                "INSERT INTO message_definitions VALUES (?, ?, 'ros2msg', ?, '')",
                (i, kind, definition),
            )
        bag.executemany(
            "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)",
            [(i, int(at), bytes(data)) for at, data in messages],
        )
    bag.commit()
    bag.close()
    return path


def joint_state_bag(run, path, joint="elbow"):
    """A SQLite bag with JointState on two topics."""
    store = typestore()
    kind = "sensor_msgs/msg/JointState"
    states, commands = (
        [
            (at, store.serialize_cdr(joint_state(store, at, [joint], **fields(i)), kind))
            for i, at in enumerate(run.stamps_ns)
        ]
        for fields in (
            lambda i: {"position": [run.q[i]], "velocity": [run.v[i]]},
            lambda i: {"effort": [run.u[i]]},
        )
    )
    return as_db3(
        path,
        {
            "/joint_states": (kind, states, ROS2_DEFINITION),
            "/joint_commands": (kind, commands, ROS2_DEFINITION),
        },
    )


def controller_bag(run, path, joint="elbow"):
    """A SQLite bag of a trajectory controller's state alone, without definitions."""
    store, kind = typestore(), "control_msgs/msg/JointTrajectoryControllerState"
    messages = [
        (
            at,
            store.serialize_cdr(
                controller_state(store, at, joint, run.q[i], run.v[i], run.u[i]), kind
            ),
        )
        for i, at in enumerate(run.stamps_ns)
    ]
    return as_db3(path, {"/arm_controller/controller_state": (kind, messages, None)})


def as_mcap(run, path, joint="elbow"):
    """An MCAP of `ros2 bag record`: JointState on two topics, and no metadata."""
    from trueup.episode.layout import Channel, Field, Layout
    from trueup.episode.writer import write_episode

    layout = Layout(
        (
            Channel("q", "rad", Field.POSITION, joint),
            Channel("v", "rad/s", Field.VELOCITY, joint),
        ),
        (Channel("u", "N·m", Field.EFFORT, joint),),
    )
    with path.open("wb") as file:
        write_episode(
            file,
            stamps_ns=run.stamps_ns,
            observations=np.stack([run.q, run.v], axis=1),
            commands=run.u[:, None],
            layout=layout,
            role=None,
            conditions={},
        )
    return path


def ros1_bag(run, path, joint="elbow"):
    """A ROS 1 bag with JointState on two topics."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store, kind = get_typestore(Stores.ROS1_NOETIC), "sensor_msgs/msg/JointState"
    path.unlink(missing_ok=True)

    def message(i, **fields):
        at = int(run.stamps_ns[i])
        stamp = store.types["builtin_interfaces/msg/Time"](sec=at // 10**9, nanosec=at % 10**9)
        head = store.types["std_msgs/msg/Header"](seq=i, stamp=stamp, frame_id="")
        none = np.zeros(0)
        values = {"position": none, "velocity": none, "effort": none, **fields}
        state = store.types[kind](header=head, name=[joint], **values)
        return store.serialize_ros1(state, kind)

    with Writer(path) as bag:
        states = bag.add_connection("/joint_states", kind, typestore=store)
        commands = bag.add_connection("/joint_commands", kind, typestore=store)
        for i, at in enumerate(run.stamps_ns):
            of = {"position": run.q[i : i + 1], "velocity": run.v[i : i + 1]}
            bag.write(states, int(at), message(i, **of))
            bag.write(commands, int(at), message(i, effort=run.u[i : i + 1]))
    return path
