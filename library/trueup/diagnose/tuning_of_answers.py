"""Tuning of answers: every number that steers what is said of the answer of a search and is not a
law of statistics.

Each has a unit and a reason, and is the same for every machine, as in `tuning`.
"""

from __future__ import annotations

from dataclasses import dataclass

from trueup.numbers import number


@dataclass(frozen=True, slots=True)
class FilterTuning:
    """The gain with which a corrected model follows an episode before it predicts."""

    doublings: int = number(24, "doublings", "Of the settling time: from one sample to days.")
    least_disturbance: float = number(
        -7.0, "decades of the motion's acceleration", "In each second, the least that is tried."
    )
    most_disturbance: float = number(
        5.0, "decades of the motion's acceleration", "In each second, the most that is tried."
    )
    coarse_decades: float = number(2.0, "decades", "Between the first sizes that are tried.")
    fine_decades: float = number(0.4, "decades", "Between the last ones.")
    beginning: int = number(24, "samples", "Until the steady gain is used.")
    alike: float = number(2.0, "standard errors", "Gains that differ by less predict alike.")


@dataclass(frozen=True, slots=True)
class EvidenceTuning:
    """What is said of the answer: bounds, regions, pushes, the floor, sentences."""

    bound_errors: float = number(
        3.0, "standard errors", "Of a bound: what the linear model neglects is among them."
    )
    linear_reach: float = number(
        1.5, "times an initial guess", "Up to there what was computed at the guess is believed."
    )
    ruled_out: float = number(0.5, "of a limit's whole effect", "A limit below is ruled out.")
    narrow: float = number(0.1, "of a number", "An interval no wider: it is identifiable.")
    wide: float = number(1.0, "of a number", "An interval no wider: it is shown, but weakly.")
    tied: float = number(0.95, "correlation", "Estimates closer to one than that are tied.")
    plain: float = number(
        0.2, "of a usual size", "Where so little of an effect shows, it is plain."
    )
    stride_s: float = number(
        0.1, "s", "Over which residuals are taken: one place's error is not carried to the next."
    )
    stride_samples: int = number(3, "samples", "At least, in a stride.")
    band_edges_hz: tuple[float, ...] = number((0.3, 1.0, 3.0), "Hz", "Between frequency bands.")
    pushed: float = number(
        8.0, "times what is usual", "A force of something outside that leans on a robot."
    )
    pushed_s: float = number(0.8, "s", "How long such a force lasts at least.")
    pushed_of_motion: float = number(
        0.2, "of the force of the joint's own motion", "A smaller push is not worth a word."
    )
    around_reversal_s: float = number(0.1, "s", "About a reversal of the motion.")
    resamples: int = number(400, "bootstrap resamples", "For the intervals of held-out errors.")
    at_the_floor: float = number(
        1.1, "times the floor's power", "An error below is not told from the noise."
    )
    clearly_above_floor: float = number(
        2.0, "times the floor", "An error above is clearly no noise."
    )
    misleading: float = number(
        1.05, "times the nominal error", "Refitted parameters that do worse are no improvement."
    )
    worth_naming: float = number(0.05, "of the gap", "A smaller part is not named in a sentence.")
    most_of_it: float = number(0.5, "of the gap", "More than that is called most of it.")
    differs: float = number(
        0.05, "probability", "By chance: estimates of recordings that differ so widen the interval."
    )
    contradicts: float = number(
        0.01, "probability", "By chance: recordings that differ so are said not to agree."
    )
    off_minimum: float = number(
        0.1, "half-widths", "A fit that ended further from its minimum is worth a word."
    )


@dataclass(frozen=True, slots=True)
class ExperimentTuning:
    """The commands among which the next experiment is chosen."""

    duration_s: float = number(6.0, "s", "Of the experiment.")
    rates_hz: tuple[float, ...] = number((0.15, 0.4, 1.0, 2.5), "Hz", "Of the waves.")
    sizes: tuple[float, ...] = number(
        (0.02, 0.07, 0.25, 0.5, 0.95), "of the command's limit", "Of the waves."
    )
    free: float = number(
        0.01, "of the travel", "A joint that moves less without a command rests at any position."
    )
    part_of_recorded: float = number(
        0.3, "of the largest recorded command", "The largest wave at a robot's joint."
    )


@dataclass(frozen=True, slots=True)
class SecondLookTuning:
    """Compositions compared by predictions of every recording, where none is the answer."""

    fewest: int = number(3, "recordings", "That are fitted, so that each may be left out once.")
    compositions: int = number(
        6, "of one effect", "Those that fit best; each is fitted as often as there are recordings."
    )
    on_most: float = number(
        0.7,
        "of the recordings",
        "The part must predict so many better than refitted parameters do.",
    )
    leaves: float = number(
        0.5,
        "of the squared error of refitted parameters",
        "Of all recordings: a part that leaves more is none to rely on.",
    )
    iterations: int = number(6, "steps", "From the fit to all recordings to that without one.")


@dataclass(frozen=True, slots=True)
class TrimmingTuning:
    """Windows of a machine's joint that something outside the model spoilt."""

    kept: float = number(
        0.85,
        "of the windows",
        "Compositions are fitted to so many; at most the rest is put aside.",
    )
    ordinary: float = number(
        4.0, "times the median cost of a window", "What costs less is kept in any case."
    )
    unexplained: float = number(
        100.0,
        "times the median cost of a window",
        "No law that is a little off misses by ten times the typical error.",
    )
    as_good: float = number(
        2.0, "times the best median", "Compositions whose typical window costs more do not count."
    )
    compositions: int = number(6, "of one effect", "Those with the best median.")
    beside: int = number(9, "terms", "Those that screen best beside the best of these.")
    looks: int = number(4, "fits", "Each without the windows that the one before explained worst.")
    iterations: int = number(12, "iterations", "Of each.")


@dataclass(frozen=True, slots=True)
class PayloadTuning:
    """When the change of a robot's numbers is said to be that of a mass on a link."""

    explains: float = number(
        0.9, "of the change, in the metric of its covariance", "What a mass must explain."
    )
    least_probable: float = number(
        1e-3, "probability", "Of what it leaves, by chance; a less probable rest is another change,"
    )
    nearly_all: float = number(
        0.99, "of the change", "unless the mass explains so much that laws of friction make it."
    )
    alike: float = number(
        9.0, "of the squared distance", "On links where it leaves no more, it looks the same."
    )
    lightest: float = number(0.01, "of the heaviest link", "A lighter mass is not sought.")
    heaviest: float = number(5.0, "of the heaviest link", "Nor a heavier one.")
    shown: float = number(
        0.5, "of the longest link", "A centre within no less is not shown along that axis."
    )


@dataclass(frozen=True, slots=True)
class DriveTuning:
    """When a logged effort shows what a drive does."""

    follows: float = number(
        0.95, "correlation", "With the command; a servo's torque follows its error instead."
    )
    latest_s: float = number(0.05, "s", "By which an effort may come after its command.")
    denied: float = number(
        0.05, "of the gain", "A drive whose gain differs by less has no such effect."
    )
    blocks: int = number(40, "parts", "Of the log, whose means are independent of each other.")


FILTER = FilterTuning()
EVIDENCE = EvidenceTuning()
EXPERIMENT = ExperimentTuning()
SECOND_LOOK = SecondLookTuning()
TRIMMING = TrimmingTuning()
PAYLOAD = PayloadTuning()
DRIVE = DriveTuning()
GROUPS = (FILTER, EVIDENCE, EXPERIMENT, SECOND_LOOK, TRIMMING, PAYLOAD, DRIVE)
