"""CSV as teams have it: other delimiters, decimal commas, dates, empty cells; what is refused."""

import numpy as np
import pytest

from tests.laws.test_formats import episode_of
from tests.support import recorded
from trueup.errors import MalformedRecording
from trueup.recording.format import open_runs
from trueup.recording.guess import guess

RUN = recorded.simulated(200)


def opened(path):
    (run,) = open_runs(path)
    return run.recording


def text(tmp_path, content, name="run.csv"):
    path = tmp_path / name
    path.write_text(content)
    return path


@pytest.mark.parametrize(
    ("delimiter", "decimal"), [(",", "."), (";", "."), (";", ","), ("\t", ".")]
)
def test_delimiters_and_decimal_commas_are_seen(tmp_path, delimiter, decimal):
    path = recorded.as_csv(RUN, tmp_path / "run.csv", delimiter=delimiter, decimal=decimal)
    np.testing.assert_array_equal(episode_of(opened(path)).observations[:, 0], RUN.q)


def test_other_units_become_the_coherent_ones(tmp_path):
    path = recorded.as_csv(
        RUN,
        tmp_path / "run.csv",
        ["Time [ms]", "Angle (deg)", "Speed (rpm)", "Torque cmd [mNm]"],
        scale=[1e3, 180.0 / np.pi, 30.0 / np.pi, 1e3],
    )
    episode = episode_of(opened(path))
    np.testing.assert_allclose(episode.observations[:, 0], RUN.q, atol=1e-12)
    np.testing.assert_allclose(episode.observations[:, 1], RUN.v, atol=1e-12)
    np.testing.assert_allclose(episode.commands[:, 0], RUN.u, atol=1e-12)
    assert [c.unit for c in episode.layout.observations] == ["rad", "rad/s"]


def test_dates_are_times(tmp_path):
    stamps = np.datetime_as_string(RUN.stamps_ns.astype("M8[ns]"))
    rows = "\n".join(f"{s}Z,{q},{u}" for s, q, u in zip(stamps, RUN.q, RUN.u, strict=True))
    episode = episode_of(opened(text(tmp_path, f"stamp,q_rad,u_nm\n{rows}\n")))
    assert episode.start_ns == RUN.stamps_ns[0]
    np.testing.assert_array_equal(np.round(episode.t_s * 1e9), RUN.stamps_ns - RUN.stamps_ns[0])


def test_signals_at_rates_of_their_own_leave_cells_empty(tmp_path):
    rows = []
    for i in range(0, 200):
        rows.append(f"{RUN.t_s[i]},{RUN.q[i]},")
        if i % 2 == 0:
            rows.append(f"{RUN.t_s[i] + 0.001},,{RUN.u[i]}")
    content = "t_s,q_rad,u_nm\n" + "\n".join(rows) + "\n"
    episode = episode_of(opened(text(tmp_path, content)))
    assert len(episode.t_s) == 199  # the first sample lies before the first command
    assert not episode.omissions


def test_columns_of_words_are_no_signals(tmp_path):
    path = text(tmp_path, "t_s,q_rad,mode,u_nm\n0,1,run,2\n0.1,1.5,run,1\n0.2,1,stop,3\n")
    assert [s.name for s in opened(path).streams[0].signals] == ["t_s", "q_rad", "u_nm"]


@pytest.mark.parametrize(
    ("content", "rule", "line"),
    [
        ("0.0,1.0,2.0\n0.1,1.0,2.0\n", "header", 1),
        ("", "header", 1),
        ("t_s,q_rad,u_nm\n0,1,2\n0.1,1\n0.2,1,2\n", "row", 3),
        ("t_s,q_rad,u_nm\n0,1,2\n" + "1,1,1\n" * 150 + "1,broken,2\n", "number", 153),
        ('t_s,q_rad,u_nm\n0,1,2\n0,"1,2\n', "row", None),
    ],
)
def test_a_rule_that_is_broken_is_named_with_its_line(tmp_path, content, rule, line):
    with pytest.raises(MalformedRecording) as refused:
        episode_of(opened(text(tmp_path, content)))
    assert refused.value.facts["rule"] == rule
    assert line is None or refused.value.facts["line"] == line


def test_a_byte_order_mark_is_no_part_of_the_first_name(tmp_path):
    path = tmp_path / "run.csv"
    path.write_bytes(b"\xef\xbb\xbftime_s,q_rad,u_nm\n0,1,2\n0.1,2,3\n")
    assert guess(opened(path)).clock.signal == "time_s"
