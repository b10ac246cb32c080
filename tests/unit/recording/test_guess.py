"""Which signals are meant: by name, unit and reach, for one joint, several, or a declared plant."""

import numpy as np
import pytest

from tests.support import recorded
from trueup.episode.layout import Channel, Field, Layout
from trueup.errors import BadMapping
from trueup.recording.asked import Asked
from trueup.recording.guess import guess
from trueup.recording.in_memory import table_recording
from trueup.recording.mapping import Part, layout_of, read_mapping
from trueup.recording.recording import Clock

RUN = recorded.simulated(200)
N = len(RUN.q)


def guessed(columns, asked=None, **known):
    return guess(table_recording(columns), asked or Asked(), **known)


def signals(mapping):
    """The signal and unit of each channel."""
    return [(str(s.part), s.signal, s.unit) for s in mapping.sources]


def test_names_with_units_leave_nothing_to_guess():
    mapping = guessed(RUN.columns)
    assert mapping.guesses == ()
    assert signals(mapping) == [
        ("observations", "q_rad", "rad"),
        ("observations", "v_rad_s", "rad/s"),
        ("commands", "u_nm", "N·m"),
    ]


def test_what_no_name_tells_is_said_to_be_a_guess():
    mapping = guessed({"t": RUN.t_s, "q": RUN.q, "u": RUN.u})
    assert signals(mapping)[0] == ("observations", "q", "rad")
    assert mapping.guesses == ("the unit of q (rad)",)
    assert mapping.confirmed().guesses == ()


def test_angles_beyond_two_turns_are_taken_to_be_degrees():
    mapping = guessed({"t": RUN.t_s, "pos": 200.0 * RUN.q, "vel": RUN.v, "cmd": RUN.u})
    assert [s.unit for s in mapping.sources] == ["deg", "deg/s", ""]


@pytest.mark.parametrize(
    ("name", "times", "unit"),
    [
        ("time", RUN.t_s, "s"),
        ("time_ms", 1e3 * RUN.t_s, "ms"),
        ("time", np.arange(N) * 10, "ms"),
        ("t", np.arange(N) * 10_000, "us"),
        ("timestamp", RUN.stamps_ns, "ns"),
        ("timestamp", RUN.stamps_ns // 1000, "us"),
        ("stamp", RUN.stamps_ns.astype("M8[ns]"), "s"),
    ],
)
def test_the_unit_of_time_is_told_by_its_name_or_its_size(name, times, unit):
    mapping = guessed({name: times, "q_rad": RUN.q, "u_nm": RUN.u})
    assert mapping.clock == Clock(name, unit)


def test_a_rate_serves_where_there_is_no_time():
    columns = {"q_rad": RUN.q, "u_nm": RUN.u}
    with pytest.raises(BadMapping, match="time") as refused:
        guessed(columns)
    assert "--rate" in refused.value.hint
    assert guessed(columns, Asked(clock=Clock(rate_hz=100.0))).clock.rate_hz == 100.0


def test_what_is_asked_for_is_taken_as_it_is():
    columns = {"t": RUN.t_s, "a": RUN.q, "b": RUN.u, "q": RUN.v}
    mapping = guessed(columns, Asked(signals={"q": "a", "u": "b"}, units={"q": "deg"}))
    assert signals(mapping) == [("observations", "a", "deg"), ("commands", "b", "")]
    assert mapping.guesses == ()


def test_two_that_may_be_meant_are_both_named():
    columns = {"t": RUN.t_s, "q_rad": RUN.q, "cmd_left": RUN.u, "cmd_right": RUN.u}
    with pytest.raises(BadMapping, match="2 signals look like the command") as refused:
        guessed(columns)
    assert "cmd_left, cmd_right" in refused.value.hint
    assert "--signal.u" in refused.value.hint


def test_one_joint_of_several_is_asked_for():
    columns = {"t": RUN.t_s} | {
        f"{j}_{what}": values
        for j in ("hip", "knee")
        for what, values in (("pos_rad", RUN.q), ("vel_rad_s", RUN.v), ("cmd_nm", RUN.u))
    }
    with pytest.raises(BadMapping, match="2 joints") as refused:
        guessed(columns)
    assert "hip, knee" in refused.value.hint
    mapping = guessed(columns, Asked(joint="knee"))
    assert [s.signal for s in mapping.sources] == ["knee_pos_rad", "knee_vel_rad_s", "knee_cmd_nm"]
    both = guessed(columns, joints=("hip", "knee"))
    assert [s.joint for s in both.sources] == ["hip"] * 3 + ["knee"] * 3
    assert [c.name for c in layout_of(both, {}).commands] == ["u_hip", "u_knee"]


def test_a_declared_plant_says_what_to_look_for():
    layout = Layout(
        (Channel("angle", "rad", Field.POSITION, "hinge"),),
        (Channel("torque", "N·m", Field.EFFORT, "hinge"),),
    )
    columns = {"t_s": RUN.t_s, "pos_deg": RUN.q, "vel": RUN.v, "cmd_mNm": RUN.u}
    mapping = guessed(columns, layout=layout)
    assert signals(mapping) == [
        ("observations", "pos_deg", "deg"),
        ("commands", "cmd_mNm", "mN·m"),
    ]
    assert mapping.sources[0].factor_to(layout.observations[0]) == pytest.approx(np.pi / 180.0)
    assert mapping.sources[1].factor_to(layout.commands[0]) == 1e-3


def test_a_unit_that_measures_something_else_is_refused():
    layout = Layout((Channel("q", "m", Field.POSITION),), (Channel("u", "N", Field.EFFORT),))
    mapping = guessed({"t_s": RUN.t_s, "pos_deg": RUN.q, "cmd_nm": RUN.u}, layout=layout)
    with pytest.raises(BadMapping, match="deg, and q is declared in m"):
        mapping.sources[0].factor_to(layout.observations[0])


def test_a_measured_effort_is_the_command_where_nothing_else_is():
    mapping = guessed({"t": RUN.t_s, "q_rad": RUN.q, "motor_current_mA": RUN.u})
    assert signals(mapping)[-1] == ("commands", "motor_current_mA", "mA")


def test_a_measured_effort_beside_a_command_is_kept_as_what_it_is():
    mapping = guessed({"t": RUN.t_s, "q_rad": RUN.q, "cmd_nm": RUN.u, "measured_torque_nm": RUN.u})
    assert [s.signal for s in mapping.of(Part.EFFORTS)] == ["measured_torque_nm"]
    assert [s.signal for s in mapping.of(Part.COMMANDS)] == ["cmd_nm"]


def test_a_mapping_is_read_as_it_was_written():
    import orjson

    mapping = guessed({"t": RUN.t_s, "q": RUN.q, "u": RUN.u})
    assert read_mapping(orjson.dumps(mapping.document())).document() == ({**mapping.document()})


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"schema": "other"}, "schema"),
        ({"more": 1}, "more"),
        ({"commands": []}, "commands"),
        ({"time": {"signal": "t", "unit": "weeks"}}, "time.unit"),
        ({"time": {"rate_hz": -1}}, "time.rate_hz"),
        ({"observations": [{"signal": "q"}]}, "observations[0].field"),
        ({"observations": [{"field": "color", "signal": "q"}]}, "observations[0].field"),
        (
            {"observations": [{"field": "position", "signal": "q", "factor": 0}]},
            "observations[0].factor",
        ),
        (
            {"observations": [{"field": "position", "signal": "q", "unti": "deg"}]},
            "observations[0].unti",
        ),
    ],
)
def test_a_mapping_that_breaks_a_rule_is_refused_at_its_field(change, field):
    import orjson

    document = guessed({"t": RUN.t_s, "q": RUN.q, "u": RUN.u}).document() | change
    with pytest.raises(BadMapping) as refused:
        read_mapping(orjson.dumps(document))
    assert refused.value.facts["field"] == field


@pytest.mark.parametrize(
    ("asked", "why"),
    [
        (Asked(units={"q": "furlong"}), "'furlong' is no unit of q"),
        (Asked(units={"pos": "rad"}), "no channel 'pos'"),
        (Asked(signals={"x": "pos"}), "no channel 'x'"),
    ],
)
def test_what_is_asked_for_and_cannot_be_is_refused(asked, why):
    with pytest.raises(BadMapping, match=why):
        guessed({"t": RUN.t_s, "pos": RUN.q, "cmd": RUN.u}, asked)


def test_the_unit_of_time_may_be_told_alone():
    columns = {"t": 1e3 * RUN.t_s, "q_rad": RUN.q, "u_nm": RUN.u}
    assert guessed(columns, Asked(clock=Clock(unit="ms"))).clock == Clock("t", "ms")
