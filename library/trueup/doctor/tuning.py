"""Tuning of the doctor: every number that decides whether something in a log is a fault.

They were set so that the clean development logs (simulated joints and arms, and the open real
machines) have no finding; what they find is counted on logs that were spoilt on purpose.
"""

from __future__ import annotations

from dataclasses import dataclass

from trueup.numbers import number


@dataclass(frozen=True, slots=True)
class BalanceTuning:
    """How the equation of motion is regressed."""

    spans: tuple[int, ...] = number(
        (9, 17, 33, 65, 129),
        "samples",
        "Lengths of the averages: noise wants long ones, fast machines short ones.",
    )
    fewest_rows: int = number(30, "averages", "Fewer determine no equation of motion.")


@dataclass(frozen=True, slots=True)
class KinematicsTuning:
    """How a velocity is held against the derivative of its position."""

    span: int = number(33, "samples", "Length of the averages: encoder noise is gone, motion not.")
    fewest: int = number(40, "samples", "Fewer in an episode tell nothing.")
    longest_lag_s: float = number(0.2, "s", "A later velocity belongs to another motion.")
    correlated: float = number(
        0.7, "correlation", "Below it the two show too little of one motion to be compared."
    )
    closely: float = number(
        0.95, "correlation", "Below it a lag and an offset are not what parts the two."
    )
    moving: float = number(
        0.2,
        "standard deviations of the velocity",
        "An episode in which it varies less tells nothing by itself.",
    )
    slope: float = number(
        2.0, "times", "A sensor's scale may be off by less; beyond it is another unit."
    )
    matches: float = number(1.25, "times", "How near a slope must be to that of a unit.")
    lag_s: float = number(0.03, "s", "A servo's own filter makes its velocity later by up to this.")
    lag_samples: float = number(2.5, "samples", "A difference of positions is late by up to this.")
    plainer: float = number(
        3.0, "times", "So much more a lag must leave unexplained where it is not taken out."
    )
    offset: float = number(
        0.25,
        "standard deviations of the velocity",
        "A smaller mean difference comes from noise and from the ends of a log.",
    )


@dataclass(frozen=True, slots=True)
class PriorTuning:
    """What is expected of a log and of a nominal model before they are looked at."""

    usual: float = number(
        0.02,
        "probability",
        "That a log has a common fault: degrees, millimetres, a sign, an order.",
    )
    unusual: float = number(
        0.002, "probability", "That it has a rare one: a unit that few logs are in."
    )
    scale: float = number(
        0.005, "probability", "That a command has another scale, which its limits do not show."
    )
    off: float = number(
        3.0,
        "times",
        "By so much nominal numbers are off, as one standard deviation of a logarithm.",
    )
    most: float = number(
        8.0, "nats", "No number counts for more: an unmodelled effect may move it anywhere."
    )
    fit: float = number(
        2.0, "nats", "What a residual that is smaller by a factor e speaks for an explanation."
    )
    most_fit: float = number(6.0, "nats", "And no more than this.")
    range: float = number(
        5.0, "nats", "What commands or positions far outside the declared range speak for a unit."
    )
    certain: float = number(0.5, "probability", "A less probable fault is not reported.")
    sound: float = number(
        0.95, "squared partial correlation", "A command so plain in the motion wants no other sign."
    )
    little: float = number(1.0, "nats", "Nominal numbers so little off want no other unit.")


@dataclass(frozen=True, slots=True)
class CommandTuning:
    """When a command is not what it was declared to be."""

    certainty: float = number(
        5.0, "standard errors", "A sign is doubted where the command's effect is so plain."
    )
    part: float = number(
        0.15, "squared partial correlation", "The least that command and acceleration must have."
    )
    scale_part: float = number(
        0.6, "squared partial correlation", "The same for a scale, which a delay may imitate."
    )
    others: float = number(
        5.0, "times", "So near their nominal values are the other numbers where a scale is wrong."
    )
    far: float = number(
        2.0, "times the limit", "No drive is commanded so far beyond it on purpose."
    )
    often: float = number(0.2, "of the samples", "So often beyond the limits is another scale.")
    beyond: float = number(
        0.01, "of the range", "Rounding of a limit is less; and a sample beyond it was clipped."
    )
    some: float = number(0.001, "of the samples", "Fewer beyond the limits make no difference.")


@dataclass(frozen=True, slots=True)
class ClockTuning:
    """When stamps are wrong."""

    missing_periods: float = number(1.5, "median periods", "A longer interval lacks a sample.")
    regular: float = number(
        0.9, "of the intervals", "So many must be regular for a sample to be missed."
    )
    jitter: float = number(0.1, "of the period", "A regular interval deviates by less.")
    missing: float = number(0.005, "of the samples", "Fewer lost make no difference.")
    off_step: float = number(
        0.1, "of the step", "Rollouts take the stamps; a loop at another rate is further off."
    )
    offset_periods: float = number(
        1.05, "median periods", "Topics of one loop begin and end within this of each other."
    )
    alike: float = number(
        0.1, "of the offset", "How alike the offsets at both ends of a log must be."
    )
    early_s: float = number(0.002, "s", "No message is logged before it is stamped, but for this.")


@dataclass(frozen=True, slots=True)
class SampleTuning:
    """When values are wrong."""

    stuck_samples: int = number(10, "samples", "A shorter run of one value is lost frames.")
    stuck_s: float = number(0.5, "s", "A shorter one is lost frames, too.")
    stuck_speed: float = number(
        0.25,
        "standard deviations of the velocity",
        "A joint at rest has a velocity of noise and rounding, and no more.",
    )
    stuck_travel: float = number(
        0.02,
        "of the channel's range",
        "The joint must have gone so far meanwhile, by its velocity or by where it reappears.",
    )
    jump: float = number(
        6.0, "times the largest usual step", "Where a channel reappears after it was stuck."
    )
    usual: float = number(
        0.95, "of the steps that are not 0", "The largest usual one; a fault makes larger ones."
    )
    fine: float = number(
        20.0, "quantization steps", "A joint that moves so far in a sample repeats no value."
    )
    stop: float = number(
        0.3,
        "of the largest usual step",
        "The last step before a channel froze: a joint that comes to rest makes smaller ones.",
    )
    outlier: float = number(12.0, "standard deviations of the noise", "A spike this large is none.")
    outlier_range: float = number(0.05, "of the channel's range", "And it must be this large.")
    quanta: float = number(3.5, "quantization steps", "Rounding alone moves a value by one or two.")
    shown: float = number(
        0.5, "of a spike of velocity", "So much of it a position shows where it was an impact."
    )
    outlier_width: int = number(2, "samples", "A longer one is a motion.")
    edge: float = number(
        0.15,
        "of the largest usual step",
        "A channel is cut off where it comes and goes so fast; a joint comes to rest slower.",
    )
    clipped_runs: int = number(2, "runs", "So often a clipped channel stays at one end.")
    clipped_run: int = number(3, "samples", "Length of such a run at least.")
    clipped: float = number(0.02, "of the samples", "Fewer at one end make no difference.")
    repeats: float = number(
        0.005, "of the samples", "A channel that repeats fewer values is finer than its noise."
    )
    clipped_distinct: int = number(
        200, "values", "A channel with fewer distinct ones is quantized, and repeats its ends."
    )
    repeated: float = number(
        0.2, "of the samples", "More repeated frames than that are no losses: a slower sensor."
    )
    beat: float = number(0.6, "of the frames", "So many come at one beat where a sensor is slower.")


@dataclass(frozen=True, slots=True)
class LoopTuning:
    """When a command is seen to answer a sensor."""

    part: float = number(0.2, "of the position's part", "A smaller damping is no gain of the loop.")
    certain: float = number(
        0.96,
        "of the command's fast changes",
        "So much a loop explains. A machine that answers white commands reaches 0.94.",
    )
    longest_s: float = number(0.1, "s", "Stamps are not further off than the loop is stable.")
    samples: int = number(2, "samples", "An answer that is so little early comes from averaging.")


BALANCE = BalanceTuning()
KINEMATICS = KinematicsTuning()
PRIOR = PriorTuning()
COMMAND = CommandTuning()
CLOCK = ClockTuning()
SAMPLE = SampleTuning()
LOOP = LoopTuning()
GROUPS = (BALANCE, KINEMATICS, PRIOR, COMMAND, CLOCK, SAMPLE, LOOP)
