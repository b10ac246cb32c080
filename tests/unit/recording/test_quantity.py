"""What names of columns tell: field, unit, joint, command or not."""

import pytest

from trueup.episode.layout import Field
from trueup.recording.quantity import quantity_of
from trueup.recording.recording import TABLE, Signal, Stream

P, V, E = Field.POSITION, Field.VELOCITY, Field.EFFORT
NAMES = {
    # name: (joint, field, unit, is it a command)
    "q": (None, P, None, False),
    "pos": (None, P, None, False),
    "q_deg": (None, P, "deg", False),
    "pos [rad]": (None, P, "rad", False),
    "Angle (deg)": (None, P, "deg", False),
    "motorAngle": ("motor", P, None, False),
    "elbow_pos_rad": ("elbow", P, "rad", False),
    "shoulder_pan.pos": ("shoulder_pan", P, None, False),
    "q1": ("joint1", P, None, False),
    "dq2": ("joint2", V, None, False),
    "joint_3_vel": ("joint3", V, None, False),
    "omega_rpm": (None, V, "rpm", False),
    "velocity [rad/s]": (None, V, "rad/s", False),
    "speed_m_s": (None, V, "m/s", False),
    "u": (None, E, None, True),
    "u_nm": (None, E, "N·m", True),
    "tau": (None, E, None, False),
    "cmd_pwm": (None, E, "pwm", True),
    "motor_current_mA": ("motor", E, "mA", False),
    "target_position": (None, P, None, True),
    "q_ref": (None, P, None, True),
    "action[elbow.pos]": ("elbow", P, None, True),
    "observation.state[elbow.pos]": ("elbow", P, None, False),
    "current_position": (None, P, None, False),
    "desired_velocity_deg_s": (None, V, "deg/s", True),
    "x_mm": ("x", P, "mm", False),
    "position_error": (None, None, None, False),
    "joint_acceleration": (None, None, None, False),
    "battery": ("battery", None, None, False),
}


@pytest.mark.parametrize("name", NAMES)
def test_a_name_tells_what_it_measures(name):
    stream = Stream(TABLE, "table", (), False)
    q = quantity_of(stream, Signal(name))
    assert (q.joint, q.field, q.unit, q.is_command) == NAMES[name]


@pytest.mark.parametrize(
    "name", ["t", "time", "time_s", "Time [ms]", "timestamp", "timestamp_ns", "elapsed"]
)
def test_a_time_is_a_time(name):
    assert quantity_of(Stream(TABLE, "table", (), False), Signal(name)).is_time
