"""Tuning: every number that steers the search of a diagnosis and is not a law of statistics.

What is said of its answer is in `tuning_of_answers`. Each number has a unit and a reason. They were
set on the open development set (simulated machines whose effects are known, `bench/diagnosis.py`)
and are the same for every machine; what is expected of the laws themselves is in
`model_selection.SelectionCriteria`. `docs/tuning.md` is made from these files.
"""

from __future__ import annotations

from dataclasses import dataclass

from trueup.numbers import number


@dataclass(frozen=True, slots=True)
class DataQualityTuning:
    """What is noise, what is quantization, and what is missing, before anything is fitted."""

    numerical_floor: float = number(
        3e-4, "standard deviations of the channel", "Smaller errors come from integration."
    )
    lattice_fit: float = number(
        0.02, "quantization steps", "How far a value may lie off the lattice of a quantizer."
    )
    lattice_values: float = number(
        0.5, "of the samples", "A quantizer leaves fewer distinct values than that."
    )
    coarse: float = number(
        0.01, "standard deviations of the channel", "A finer quantizer makes no gap worth naming."
    )
    held_frames: float = number(
        0.005, "of the samples", "Fewer repeated frames make no gap worth naming."
    )
    trimmed: float = number(
        0.8, "of the differences", "The largest ones hold kinks and lost frames, not noise."
    )
    trimmed_residuals: float = number(
        0.995, "of the differences", "A model's residuals have few kinks: outliers count."
    )
    strides: tuple[int, ...] = number(
        (1, 2, 3, 4), "samples", "Distances at which differences tell a correlation in a motion."
    )
    residual_strides: tuple[int, ...] = number(
        (1, 2, 4, 8, 16), "samples", "Residuals have little motion in them: longer ones tell more."
    )
    correlations: tuple[float, ...] = number(
        (0.0, 0.4, 0.5, 0.6, 0.7, 0.75, 0.8, 0.85, 0.88, 0.9, 0.92, 0.94, 0.96),
        "1",
        "From one sample to the next: the values that are tried.",
    )
    motion_growth: tuple[int, ...] = number(
        (2, 8), "powers of the stride", "How differences of a kink and of a smooth motion grow."
    )
    coloured: float = number(
        1.5,
        "times the power over one sample",
        "Noise with a third of the sample before has that over two; less is called white.",
    )
    clearly_coloured: float = number(
        4.0, "times the squared error", "So much better must correlated noise fit the differences."
    )
    fewest_differences: int = number(200, "differences", "Fewer do not tell a correlation.")
    below_noise: float = number(
        0.8, "reduced chi-square", "A composition that leaves so little shows that noise is less."
    )
    noise_changed: float = number(
        1.1, "times the standard deviation", "A quarter more power would be no noise any more."
    )
    correlation_changed: float = number(
        0.15, "1", "Residuals with a correlation that differs more start the search again."
    )
    most_outliers: float = number(
        2.0, "times the noise's power", "What leaves more is no outlier of a sensor."
    )
    mostly_noise: float = number(
        4.0, "times the noise's power", "Of larger residuals noise is no good part."
    )


@dataclass(frozen=True, slots=True)
class SetupTuning:
    """How episodes are cut into windows, thinned, and chosen for screening."""

    window_s: float = number(
        2.0, "s", "Windows of one simulated joint: long against its motion, short against drift."
    )
    screening_window_s: float = number(
        0.5, "s", "Short windows, in which a linear model reaches further."
    )
    pieces: int = number(
        4,
        "of one window",
        "A robot's windows are screened, and their starts found, in such parts: the further the "
        "nominal form is off, the shorter a linear model reaches.",
    )
    halvings: int = number(
        3, "times", "How often windows in which the nominal form runs away are halved."
    )
    fewest_samples: int = number(16, "samples", "A shorter window shows nothing but noise.")
    screening_episodes: int = number(
        2, "episodes", "A robot's terms are screened where the nominal form explains least."
    )
    screening_rows: int = number(
        15_000, "samples of all joints", "At most, on which a robot's terms are screened."
    )
    enough_samples: int = number(
        6000, "samples", "More than twice as many are thinned where they are close together."
    )
    finest_step: float = number(
        0.02,
        "of the time in which the joint crosses its travel",
        "A step of that length still integrates well.",
    )
    evident: float = number(
        0.3,
        "of the force that is missing at a joint",
        "What repeats with the position and is so much of it is screened in any case.",
    )
    periods_kept: int = number(5, "spatial periods", "The most promising go on.")
    period_steps: float = number(
        4.0, "for each wave over the travel", "How densely spatial periods are scanned."
    )
    shortest_period: float = number(0.02, "of the largest deflection", "The scan's lower end.")
    longest_period: float = number(1.0, "of the largest deflection", "The scan's upper end.")
    period_noise: float = number(
        0.2,
        "of the acceleration",
        "Spans are so long that the noise of a mean acceleration is no larger.",
    )
    longest_span: int = number(12, "samples", "Over which the scan takes mean accelerations.")
    period_samples: int = number(6000, "samples", "At most, of all episodes, in the scan.")


@dataclass(frozen=True, slots=True)
class SearchTuning:
    """How compositions of effects are screened, fitted, grown and refined."""

    glance_iterations: int = number(2, "iterations", "After which half of the guesses are left.")
    screen_iterations: int = number(
        6, "iterations", "Of each initial guess, before the best go on."
    )
    fit_iterations: int = number(16, "iterations", "Of the best guesses.")
    converge_iterations: int = number(25, "iterations", "Until nothing moves.")
    short_iterations: int = number(2, "iterations", "Of a parent on short windows.")
    grid_iterations: int = number(2, "iterations", "At each point of a grid, all else free.")
    after_grid_iterations: int = number(4, "iterations", "Once the grid's number is free again.")
    screen_tolerance: float = number(1e-2, "of the cost", "A smaller decrease ends a short fit.")
    fit_tolerance: float = number(1e-3, "of the cost", "A smaller decrease ends a fit.")
    converge_tolerance: float = number(
        1e-6, "of the cost", "A smaller decrease ends a fit that goes on until nothing moves."
    )
    final_tolerance: float = number(1e-7, "of the cost", "The limit in the final refit.")
    rough_tolerance: float = number(
        1e-4, "of the cost", "The limit of either where laws are not exact enough for more."
    )
    guesses: int = number(3, "guesses", "Tried of each term; twice as many where it has many.")
    many_guesses: int = number(50, "guesses", "Of so many, twice as many are tried.")
    neighbours: int = number(
        50, "neighbourhoods", "Guesses are split into so many: of neighbours one is tried."
    )
    guesses_kept: int = number(2, "guesses", "That go on from screening.")
    same_place: float = number(0.02, "of a value", "Nearer fits are one.")
    same_cost: float = number(1e-3, "of the cost", "Nearer fits are one.")
    grids: tuple[float, ...] = number(
        (0.04, 0.013, 0.004, 0.0013),
        "of a value",
        "Half-widths of ever finer grids around a number between whose corners the error is flat.",
    )
    grid_points: tuple[float, ...] = number(
        (-1.0, -0.66, -0.33, 0.33, 0.66, 1.0), "half-widths", "Where a grid is tried."
    )
    optional_worth: float = number(
        18.0, "squared standard errors", "What an optional number of an effect must be worth."
    )
    pasts: tuple[float, ...] = number(
        (
            0.0,
            *(sign * x for x in (0.03, 0.07, 0.12, 0.18, 0.25, 0.35, 0.5) for sign in (1.0, -1.0)),
        ),
        "of a hidden state's scale",
        "What a state with corners may have begun with: descent does not find it.",
    )
    robot_looks: int = number(8, "looks", "Of a robot's fit towards its minimum: each takes long.")
    start_iterations: int = number(10, "iterations", "For the starts of validation windows.")
    partners: int = number(
        2,
        "terms",
        "That screened best, tried with further parents, and so many of the parents' own: where "
        "two effects act, many may stand for the one, and the other is the same.",
    )
    explained: float = number(
        1.5, "reduced chi-square", "Screening that leaves so little is over; poor ones are dropped."
    )
    poor: float = number(30.0, "reduced chi-square", "Poor once another one explained the log.")
    part_does_as_well: float = number(
        4.0, "times the reduced chi-square", "A part of a composition that does about as well."
    )
    spread: int = number(
        2, "compositions", "Tried at every joint, where the gap is not explained at one."
    )
    hopeless: float = number(
        0.25, "of the gap", "Where the best two effects leave more, no third is tried."
    )
    hopeless_pair: float = number(
        0.5, "of the gap", "Where the best pair leaves more, none of its effects is exchanged."
    )
    hopeless_on_machine: float = number(
        0.6, "of the gap", "Where the best effect of a real robot leaves more, no second is tried."
    )
    looks: int = number(
        4,
        "searches",
        "At most: each with the noise, or without the stretches, that the last one showed.",
    )
    finer_steps: int = number(4, "for one of the search", "In the final refit.")
    exchanged: int = number(5, "terms", "That each effect of the best composition may give way to.")
    far_behind: float = number(4.0, "times the best reduced chi-square", "Not followed further.")
    shortened: tuple[float, ...] = number(
        (1.0, 0.5, 0.25, 0.125),
        "of the length of windows",
        "Tried in turn where a cost on whole windows is too rough for a proven minimum.",
    )
    worth_following: float = number(
        0.5,
        "of a robot's reduced chi-square",
        "Another integration, or an effect at every joint, must leave less.",
    )
    went_astray: float = number(
        2.0, "times the reduced chi-square", "A final refit that does so much worse is dropped."
    )
    refits: int = number(
        4, "rounds", "At most, until all that a choice names is fitted to its minimum."
    )
    alias_rounds: int = number(
        2, "rounds", "In which aliases of the answer are tried: a better one may have another."
    )
    beside_late: float = number(
        0.9, "of the cost", "Where a late topic leaves less, effects are chosen again beside it."
    )
    plainly_better: float = number(
        0.6,
        "of the reduced chi-square beyond noise",
        "So much less a fit leaves where commands are ramps; an effect of the "
        "command leaves a tenth less, a sampled analogue signal two thirds.",
    )
    on_most: float = number(0.75, "of the windows", "And it must leave less on so many of them.")


@dataclass(frozen=True, slots=True)
class SelectionTuning:
    """When one composition is better than another, whatever the recordings."""

    log_likelihood: float = number(
        9.0, "units of log-likelihood", "Separate two compositions whose windows agree."
    )
    certain: float = number(
        3.0, "times log_likelihood", "Separate two compositions whose windows do not agree."
    )
    agreement: float = number(
        3.0, "of the evidence against a difference", "So much windows must have for it to agree."
    )
    next_to: float = number(
        1.02,
        "times the reduced chi-square",
        "An alias within this factor of the answer is reported beside it.",
    )
    least_chi_square: float = number(
        0.5, "reduced chi-square", "Noise is known to some per cent: none is far below 1."
    )
    finished: float = number(
        0.2, "of what was left", "A composition that leaves no more explains it."
    )
    noise_power: float = number(
        0.06, "of the noise's power", "The least that an effect must remove."
    )
    adequate: float = number(1.25, "reduced chi-square", "Up to it, noise is all that is left.")
    clearly_no_noise: float = number(
        0.5, "of the reduced chi-square", "What is removed beyond it was clearly no noise."
    )
    scraps: float = number(
        0.1, "of what was left", "A composition that leaves less was not found by accident."
    )
    most_measured: int = number(
        4, "compositions", "Whose predictions are measured: each takes a filter and a rollout."
    )
    much_better: float = number(
        0.9, "of the held-out error", "So much better an alternative predicts to be the answer."
    )
    chance: float = number(
        0.01, "probability", "So rarely would windows prefer an effect that does nothing."
    )
    no_better: float = number(
        1.01, "of the held-out error", "An answer that predicts worse by more is none."
    )


DATA_QUALITY = DataQualityTuning()
SETUP = SetupTuning()
SEARCH = SearchTuning()
SELECTION = SelectionTuning()
GROUPS = (DATA_QUALITY, SETUP, SEARCH, SELECTION)
