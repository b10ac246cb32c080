"""Which signals messages hold: of ROS 2 and ros2_control, of ROS 1, in protobuf and JSON."""

import io

import numpy as np
import orjson
import pytest
from mcap.writer import Writer

from tests.support import recorded
from trueup.episode.layout import Field
from trueup.errors import BadMapping, NotAnEpisode
from trueup.recording.asked import Asked
from trueup.recording.controllers import read_controllers
from trueup.recording.format import open_runs
from trueup.recording.guess import guess
from trueup.recording.mapping import Part

RUN = recorded.simulated(50)
STORE = recorded.typestore()


def bag(tmp_path, topics, *, defines=False):
    """The recording of a bag of topics: of each its type, and messages."""
    definitions = {
        kind: STORE.generate_msgdef(kind, ros_version=2)[0] if defines else None
        for kind, _ in topics.values()
    }
    path = recorded.as_db3(
        tmp_path / "run.db3",
        {
            name: (
                kind,
                [(at, STORE.serialize_cdr(message, kind)) for at, message in messages],
                definitions[kind],
            )
            for name, (kind, messages) in topics.items()
        },
    )
    return open_runs(path)[0].recording


def states(names=("elbow",), columns=None):
    """JointState of some joints over the run."""
    kind = "sensor_msgs/msg/JointState"
    q = columns if columns is not None else [RUN.q] * len(names)
    return kind, [
        (at, recorded.joint_state(STORE, at, names, [c[i] for c in q], [RUN.v[i]] * len(names)))
        for i, at in enumerate(RUN.stamps_ns)
    ]


def read(recording, stream, *signals):
    """The rows of some signals of a stream."""
    parts = [c for name, c in recording.read({stream: signals}, None) if name == stream]
    return np.concatenate([c.log_ns for c in parts]), np.concatenate([c.values for c in parts])


def named(recording, part, of):
    """The signals of a part in a field that are guessed."""
    return [s.signal for s in guess(recording).of(part) if s.field is of]


@pytest.mark.parametrize("defines", [True, False], ids=["defined", "not defined"])
def test_dynamic_joint_state_names_what_it_measures(tmp_path, defines):
    kind = "control_msgs/msg/DynamicJointState"
    value = STORE.types["control_msgs/msg/InterfaceValue"]
    interfaces = ["position", "velocity", "temperature"]
    messages = [
        (
            at,
            STORE.types[kind](
                header=recorded.header(STORE, at),
                joint_names=["shoulder", "elbow"],
                interface_values=[
                    value(interface_names=interfaces, values=np.array([1.0, 2.0, 30.0])),
                    value(interface_names=interfaces, values=np.array([RUN.q[i], RUN.v[i], 31.0])),
                ],
            ),
        )
        for i, at in enumerate(RUN.stamps_ns)
    ]
    recording = bag(tmp_path, {"/dynamic_joint_states": (kind, messages)}, defines=defines)
    (stream,) = recording.streams
    assert [s.name for s in stream.signals] == [
        f"{joint}/{what}" for joint in ("shoulder", "elbow") for what in interfaces
    ]
    elbow = stream.signal("elbow/velocity")
    assert (elbow.joint, elbow.field) == ("elbow", Field.VELOCITY)
    times, values = read(recording, "/dynamic_joint_states", "elbow/position", "elbow/temperature")
    np.testing.assert_array_equal(values[:, 0], RUN.q)
    np.testing.assert_array_equal(times, RUN.stamps_ns)
    assert set(values[:, 1]) == {31.0}


def test_a_controllers_state_is_read_by_its_feedback_and_its_output(tmp_path):
    (run,) = open_runs(recorded.controller_bag(RUN, tmp_path / "run.db3"))
    assert named(run.recording, Part.OBSERVATIONS, Field.POSITION) == ["feedback/elbow/position"]
    assert named(run.recording, Part.COMMANDS, Field.EFFORT) == ["output/elbow/effort"]


def test_the_older_form_of_a_controllers_state_is_told_by_its_bytes(tmp_path):
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    from trueup.recording.ros_types import CONTROL_MESSAGES

    kind = "control_msgs/msg/JointTrajectoryControllerState"
    store = get_typestore(Stores.LATEST)
    store.register(get_types_from_msg(CONTROL_MESSAGES[kind][3], kind))

    def message(i, at):
        return store.types[kind](
            header=recorded.header(store, at),
            joint_names=["elbow"],
            desired=recorded.point(store, [RUN.u[i]]),
            actual=recorded.point(store, [RUN.q[i]], [RUN.v[i]]),
            error=recorded.point(store, [0.0]),
        )

    messages = [
        (at, store.serialize_cdr(message(i, at), kind)) for i, at in enumerate(RUN.stamps_ns)
    ]
    path = recorded.as_db3(tmp_path / "run.db3", {"/state": (kind, messages, None)})
    recording = open_runs(path)[0].recording
    assert named(recording, Part.OBSERVATIONS, Field.POSITION) == ["actual/elbow/position"]
    assert named(recording, Part.COMMANDS, Field.POSITION) == ["desired/elbow/position"]
    np.testing.assert_array_equal(
        read(recording, "/state", "actual/elbow/position")[1][:, 0], RUN.q
    )


def test_a_pid_controllers_state_is_read_by_its_names(tmp_path):
    kind, one = "control_msgs/msg/MultiDOFStateStamped", "control_msgs/msg/SingleDOFState"
    messages = [
        (
            at,
            STORE.types[kind](
                header=recorded.header(STORE, at),
                dof_states=[
                    STORE.types[one](
                        name="elbow",
                        reference=0.5,
                        feedback=RUN.q[i],
                        feedback_dot=RUN.v[i],
                        error=0.5 - RUN.q[i],
                        error_dot=0.0,
                        time_step=0.01,
                        output=RUN.u[i],
                    )
                ],
            ),
        )
        for i, at in enumerate(RUN.stamps_ns)
    ]
    recording = bag(tmp_path, {"/pid/controller_state": (kind, messages)})
    mapping = guess(recording)
    assert [(s.signal, s.field) for s in mapping.sources] == [
        ("elbow/feedback", Field.POSITION),
        ("elbow/feedback_dot", Field.VELOCITY),
        ("elbow/output", Field.EFFORT),
    ]
    assert "signal" in mapping.sources[0].guessed


def test_a_list_without_names_is_named_by_a_person(tmp_path):
    kind = "std_msgs/msg/Float64MultiArray"
    layout = STORE.types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    messages = [
        (at + 1000, STORE.types[kind](layout=layout, data=np.array([0.1, RUN.u[i]])))
        for i, at in enumerate(RUN.stamps_ns)
    ]
    recording = bag(
        tmp_path,
        {
            "/joint_states": states(("shoulder", "elbow"), [RUN.v, RUN.q]),
            "/forward_effort_controller/commands": (kind, messages),
        },
    )
    with pytest.raises(BadMapping, match="2 entries of") as refused:
        guess(recording, Asked(joint="elbow"))
    assert "--names" in refused.value.hint
    mapping = guess(recording, Asked(joint="elbow", names=("shoulder", "elbow")))
    command = mapping.of(Part.COMMANDS)[0]
    assert (command.signal, command.field, command.joint) == ("1", Field.EFFORT, "elbow")
    times, values = read(recording, command.stream, command.signal)
    np.testing.assert_array_equal(values[:, 0], RUN.u)
    np.testing.assert_array_equal(times, RUN.stamps_ns + 1000)


def test_a_controllers_parameters_name_the_entries_of_its_commands(tmp_path):
    kind = "std_msgs/msg/Float64MultiArray"
    layout = STORE.types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    messages = [
        (at, STORE.types[kind](layout=layout, data=np.array([RUN.u[i], 0.5])))
        for i, at in enumerate(RUN.stamps_ns)
    ]
    recording = bag(
        tmp_path,
        {
            "/joint_states": states(("shoulder", "elbow"), [RUN.v, RUN.q]),
            "/lab/arm_controller/commands": (kind, messages),
        },
    )
    file = tmp_path / "controllers.yaml"
    file.write_text(
        "controller_manager:\n  ros__parameters:\n    update_rate: 100\n"
        "lab:\n  arm_controller:\n    ros__parameters:\n      joints: [elbow, shoulder]\n"
        "      interface_name: effort\n"
    )
    asked = Asked(joint="elbow", controllers=read_controllers(file))
    command = guess(recording, asked).of(Part.COMMANDS)[0]
    assert (command.signal, command.joint) == ("0", "elbow")
    file.write_text("controller_manager:\n  ros__parameters:\n    update_rate: 100\n")
    with pytest.raises(BadMapping, match="no controller"):
        read_controllers(file)


def test_a_trajectory_is_a_row_for_each_point_until_another_takes_its_place(tmp_path):
    kind, second = "trajectory_msgs/msg/JointTrajectory", 1_000_000_000
    start = recorded.T0_NS

    def trajectory(at, targets):
        return at, STORE.types[kind](
            header=recorded.header(STORE, 0),
            joint_names=["elbow"],
            points=[
                recorded.point(STORE, [x], after_ns=(k + 1) * second) for k, x in enumerate(targets)
            ],
        )

    messages = [
        trajectory(start, [1.0, 2.0, 3.0, 4.0]),
        trajectory(start + int(1.5 * second), [9.0, 8.0]),
    ]
    recording = bag(tmp_path, {"/arm/joint_trajectory": (kind, messages)})
    times, values = read(recording, "/arm/joint_trajectory", "elbow/position")
    assert ((times - start) / second).tolist() == [1.0, 2.0, 2.5, 3.5]
    assert values[:, 0].tolist() == [1.0, 2.0, 9.0, 8.0]


def test_joints_of_several_publishers_on_one_topic_are_all_seen(tmp_path):
    kind, arm = states(("elbow",))
    _, hand = states(("finger",), [RUN.v])
    both = [m for pair in zip(arm, hand, strict=True) for m in pair]
    recording = bag(tmp_path, {"/joint_states": (kind, both)})
    (stream,) = recording.streams
    assert {s.joint for s in stream.signals} == {"elbow", "finger"}
    _, values = read(recording, "/joint_states", "elbow/position", "finger/position")
    assert np.isnan(values).sum(axis=0).tolist() == [50, 50]


def json_log(tmp_path, messages, schema="", topic="/motor"):
    """The recording of an MCAP of JSON messages, with their log times [ns]."""
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start()
    of = writer.register_schema(schema, "jsonschema", b"{}") if schema else 0
    channel = writer.register_channel(topic, "json", of)
    for at, message in messages:
        writer.add_message(
            channel, int(at), orjson.dumps(message, option=orjson.OPT_SERIALIZE_NUMPY), int(at)
        )
    writer.finish()
    path = tmp_path / "log.mcap"
    path.write_bytes(stream.getvalue())
    return open_runs(path)[0].recording


def test_json_without_a_schema_is_read_by_its_names(tmp_path):
    messages = [
        (at, {"motor": {"angle_deg": 57.3 * RUN.q[i], "cmd_pwm": RUN.u[i]}, "note": "on"})
        for i, at in enumerate(RUN.stamps_ns)
    ]
    recording = json_log(tmp_path, messages)
    mapping = guess(recording)
    assert [(s.signal, s.unit) for s in mapping.sources] == [
        ("motor/angle_deg", "deg"),
        ("motor/cmd_pwm", "pwm"),
    ]
    np.testing.assert_array_equal(read(recording, "/motor", "motor/cmd_pwm")[1][:, 0], RUN.u)


def test_foxgloves_joint_states_are_read_by_name_and_timestamp(tmp_path):
    messages = [
        (
            at,
            {
                "timestamp": {"sec": int(at) // 10**9, "nsec": int(at) % 10**9 + 5},
                "joints": [{"name": "elbow", "position": RUN.q[i], "effort": RUN.u[i]}],
            },
        )
        for i, at in enumerate(RUN.stamps_ns)
    ]
    recording = json_log(tmp_path, messages, "foxglove.JointStates", "/joint_states")
    signals = recording.streams[0].signals
    assert {(s.name, s.joint) for s in signals} == {
        ("elbow/position", "elbow"),
        ("elbow/effort", "elbow"),
    }
    (block,) = [c for _, c in recording.read({"/joint_states": ["elbow/position"]}, None)]
    np.testing.assert_array_equal(block.stamp_ns, RUN.stamps_ns + 5)


def test_protobuf_is_read_with_what_it_leaves_out(tmp_path):
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    file = descriptor_pb2.FileDescriptorProto(name="m.proto", package="m", syntax="proto3")
    kind = file.message_type.add(name="Drive")
    for number, name in enumerate(("angle_rad", "command"), 1):
        kind.field.add(name=name, number=number, label=1, type=1)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    message = message_factory.GetMessageClass(pool.FindMessageTypeByName("m.Drive"))
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start()
    schema = writer.register_schema(
        "m.Drive", "protobuf", descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()
    )
    channel = writer.register_channel("/drive", "protobuf", schema)
    for i, at in enumerate(RUN.stamps_ns.tolist()):
        data = message(angle_rad=RUN.q[i], command=0.0).SerializeToString()
        writer.add_message(channel, at, data, at)
    writer.finish()
    (tmp_path / "log.mcap").write_bytes(stream.getvalue())
    recording = open_runs(tmp_path / "log.mcap")[0].recording
    _, values = read(recording, "/drive", "angle_rad", "command")
    np.testing.assert_array_equal(values[:, 0], RUN.q)
    assert not values[:, 1].any()


def test_a_message_that_is_not_of_its_type_is_refused_with_its_topic(tmp_path):
    kind, messages = states()
    rows = [(at, STORE.serialize_cdr(m, kind)) for at, m in messages]
    rows[30] = (rows[30][0], b"\0\1\0\0short")
    path = recorded.as_db3(tmp_path / "run.db3", {"/joint_states": (kind, rows, None)})
    recording = open_runs(path)[0].recording
    with pytest.raises(NotAnEpisode) as refused:
        read(recording, "/joint_states", "elbow/position")
    assert refused.value.facts["rule"] == "message"
    assert refused.value.facts["topic"] == "/joint_states"


def test_a_type_that_nobody_defined_is_named_among_what_was_not_read(tmp_path):
    path = recorded.as_db3(
        tmp_path / "run.db3",
        {"/odd": ("acme_msgs/msg/Odd", [(recorded.T0_NS, b"\0\1\0\0\1")], None)},
    )
    recording = open_runs(path)[0].recording
    assert recording.streams == ()
    assert "acme_msgs/msg/Odd" in recording.unread["/odd"]
