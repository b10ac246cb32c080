"""The watchdog and the monitor's alarms."""

import numpy as np

from trueup.control.watchdog import Watchdog, inject_sensor_failure
from trueup.monitor.thresholds import Alarm, QuantileThreshold


def test_a_living_sensor_never_trips_the_watchdog():
    found = inject_sensor_failure(0.010, 0.050, 0.12, ticks=400, dies_at=400)
    assert (found.first_trip_s, found.forced) == (None, 0)
    assert found.peak_age_s < 0.12


def test_a_sample_resets_the_age():
    watchdog = Watchdog(0.1, 0.0)
    assert watchdog.trips(0.2)
    assert not watchdog.sampled(0.15).trips(0.2)


def test_a_run_of_exceedances_does_not_reach_over_an_episodes_end():
    threshold = QuantileThreshold(1.0, run=3)
    assert threshold.alarms([np.array([0.0, 2.0, 2.0]), np.array([2.0, 0.0, 2.0])]) == []
    assert threshold.alarms([np.array([0.0, 2.0, 2.0, 2.0, 2.0, 0.0, 2.0, 2.0, 2.0])]) == [Alarm(0, 1, 3), Alarm(0, 6, 8)]


def test_exceedance_and_alarm_are_two_things():
    threshold = QuantileThreshold.calibrate([np.linspace(0.0, 1.0, 1000)])
    scattered = np.tile([0.0, 2.0], 50)
    assert threshold.exceedance([scattered]) == 0.5
    assert threshold.alarms([scattered]) == []
