"""The watchdog."""

from trueup.control.watchdog import Watchdog, inject_sensor_failure


def test_a_living_sensor_never_trips_the_watchdog():
    failure = inject_sensor_failure(0.010, 0.050, 0.12, ticks=400, dies_at=400)
    assert (failure.first_trip_s, failure.forced) == (None, 0)
    assert failure.peak_age_s < 0.12


def test_a_sample_resets_the_age():
    watchdog = Watchdog(0.1, 0.0)
    assert watchdog.trips(0.2)
    assert not watchdog.sampled(0.15).trips(0.2)
