"""Pictures of the steps of a diagnosis, from one of examples/emps that runs now."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.diagnose.candidate import Candidate
from trueup.diagnose.case import read_case
from trueup.diagnose.data_quality import assess
from trueup.diagnose.diagnosis import Diagnosis, diagnose
from trueup.diagnose.excitation_design import Allowed, design
from trueup.diagnose.processes import in_processes
from trueup.diagnose.traces import predicted
from trueup.diagnose.windowed_fits import trajectory
from trueup.model.hypothesis import Hypothesis
from trueup.model.predictor import Nominal
from trueup_cli.pictures.drawing import (
    INK,
    LEFT,
    PALE,
    RIGHT,
    SERIES,
    WIDTH,
    Panel,
    legend,
    nice,
    range_of,
    sheet,
    text,
)
from trueup_cli.pictures.excitation import excite_picture

Array = NDArray[np.float64]
HERE = Path(__file__).parent
CASE = HERE.parent / "examples" / "emps"
FOLDER = HERE / "pictures" / "method"
TOP, HEIGHT = 106, 250
DRAWN_S = 4.0  # of a recording
FOURTH = np.sqrt(70.0)  # a fourth difference of white noise, in its standard deviations
BINS, WIDEST = 61, 4.0  # of the histogram, to either side [standard deviations]
BLUE, ORANGE, GREEN, VIOLET, RED, _ = SERIES


def main() -> None:
    """Writes every picture."""
    plant, episodes = read_case(CASE)
    diagnosis = diagnose(plant, episodes, 0, solve=in_processes)
    FOLDER.mkdir(exist_ok=True)
    for name, made in {
        "noise": _noise(diagnosis),
        "windows": _windows(diagnosis),
        "search": _search(diagnosis),
        "selection": _selection(diagnosis),
        "measurement": _measurement(diagnosis),
        "intervals": _intervals(diagnosis),
    }.items():
        (FOLDER / f"{name}.svg").write_text(made + "\n")
    designed = design(
        plant,
        episodes,
        Allowed(duration_s=1.0),
        diagnosed=(diagnosis.predictor, diagnosis.document),
    )
    (FOLDER / "experiment.svg").write_text(excite_picture(plant, designed.excitation) + "\n")


def _noise(diagnosis: Diagnosis) -> str:
    """Fourth differences of the position, beside those of white noise of the estimated size."""
    channel = diagnosis.plant.layout.observations[0]
    quality = assess(diagnosis.plant, diagnosis.recordings.every)
    sigma = float(quality.noise[diagnosis.plant.state_columns[0]])
    differences = np.concatenate(
        [np.diff(e.observations[:, 0], 4) / FOURTH / sigma for e in diagnosis.recordings.every]
    )
    step = float(quality.lattice[diagnosis.plant.state_columns[0]]) / FOURTH / sigma
    step = 2.0 * step or 2.0 * WIDEST / BINS  # whole steps, where values lie on some
    edges = (np.arange(-np.ceil(WIDEST / step), np.ceil(WIDEST / step) + 2.0) - 0.5) * step
    share, _ = np.histogram(differences, edges)
    density = share / len(differences) / np.diff(edges)
    middle = (edges[1:] + edges[:-1]) / 2.0
    normal = np.exp(-(middle**2) / 2.0) / np.sqrt(2.0 * np.pi)
    panel = Panel(TOP, HEIGHT, nice(-WIDEST, WIDEST), nice(0.0, float(max(density.max(), 0.4))))
    parts = [
        legend([("recorded", BLUE), ("normal, of the estimated size", ORANGE)], 80),
        panel.frame("density", times=True),
        *(
            _bar(panel, float(a), float(b), float(d))
            for a, b, d in zip(edges[:-1], edges[1:], density, strict=True)
        ),
        panel.line(middle, normal, ORANGE, width=2.4),
        _below("fourth difference of the position, in estimated standard deviations"),
    ]
    return _sheet(
        "1. Data quality: noise is what differences of a smooth motion leave",
        f"the position of a linear drive: noise of {sigma:.2g} {channel.unit}",
        parts,
    )


def _windows(diagnosis: Diagnosis) -> str:
    """Rollouts of the refitted nominal form, each window from its own estimated start."""
    fits = diagnosis.search.problem.fits
    base = diagnosis.search.candidates[Hypothesis()].fit
    answer = diagnosis.choice.winner.fit
    series = fits.adaptation[0]
    speed = len(diagnosis.plant.joints)
    short = series.t_s <= series.t_s[0] + DRAWN_S
    t = series.t_s[short]
    starts = series.t_s[short & (series.resets >= 0)]
    measured = np.gradient(series.observed[:, 0], series.t_s)[short]
    base_path, answer_path = (
        trajectory(fits.fitter, fit, series)[short, speed] for fit in (base, answer)
    )
    panel = Panel(
        TOP, HEIGHT, nice(*range_of([t])), nice(*range_of([measured, base_path, answer_path]))
    )
    parts = [
        legend([("measured", PALE), ("refitted nominal form", ORANGE), ("the answer", BLUE)], 80),
        panel.frame("speed [m/s]", times=True),
        *(_upright(panel, float(at)) for at in starts),
        panel.line(t, measured, PALE, width=1.2),
        panel.line(t, base_path, ORANGE),
        panel.line(t, answer_path, BLUE),
        _below("time [s]; a dotted line where a window begins, from a start that is estimated"),
    ]
    return _sheet(
        "2 and 3. Setup and fit: multiple shooting",
        "every window is rolled out on the issued commands alone",
        parts,
    )


def _search(diagnosis: Diagnosis) -> str:
    """What every composition that was fitted leaves, by its number of effects."""
    candidates = list(diagnosis.search)
    answer = diagnosis.choice.winner
    sizes = np.array([len(c.hypothesis.effects) for c in candidates], float)
    left = np.array([c.total for c in candidates])
    rows = np.arange(np.floor(np.log10(left.min())), np.ceil(np.log10(left.max())) + 1)
    panel = Panel(TOP, HEIGHT, np.arange(-1.0, sizes.max() + 2.0), rows)
    parts = [
        legend(
            [("a composition", PALE), ("the best of its size", ORANGE), ("the answer", BLUE)], 80
        )
    ]
    parts += [
        f'<path d="M{LEFT} {panel.y(r):.1f}H{WIDTH - RIGHT}" stroke="#e4e7eb"/>'
        + text(LEFT - 10, panel.y(r) + 4, f"{10.0**r:g}", PALE, anchor="end")
        for r in rows
    ]
    parts.append(text(LEFT, TOP - 10, "reduced chi-square: 1 is noise alone", INK))
    for size in range(int(sizes.max()) + 1):
        some = [c for c in candidates if len(c.hypothesis.effects) == size]
        best = min(some, key=lambda c: c.total)
        for c in [*some, best, *([answer] if answer in some else [])]:
            colour = BLUE if c is answer else ORANGE if c is best else PALE
            parts.append(_dot(panel, size, float(np.log10(c.total)), colour))
        at = panel.y(float(np.log10(best.total))) + 4
        words = _called(best) or "refitted nominal form"
        last = size == sizes.max()
        x, anchor = panel.x(size) + (-12 if last else 12), "end" if last else "start"
        parts.append(text(x, at, words, INK, anchor=anchor))
        words = f"{size} effect{'s' if size != 1 else ''}: {len(some)} fitted"
        parts.append(text(panel.x(size), TOP + HEIGHT + 22, words, PALE, anchor="middle"))
    return _sheet(
        "3. Search: effects are added to the best compositions, then taken away again",
        f"{len(candidates)} compositions were fitted and kept",
        parts,
    )


def _selection(diagnosis: Diagnosis) -> str:
    """Every window's vote between the answer and the best smaller composition."""
    answer = diagnosis.choice.winner
    smaller = [
        c for c in diagnosis.search if len(c.hypothesis.effects) < len(answer.hypothesis.effects)
    ]
    rival = min(smaller, key=lambda c: c.total)
    votes = np.sort(np.log10(rival.costs / answer.costs))
    panel = Panel(TOP, HEIGHT, nice(0.0, float(len(votes))), nice(*range_of([votes, np.zeros(1)])))
    for_it = int((votes > 0.0).sum())
    parts = [
        panel.frame("log₁₀ of the cost without it, over the cost with it", times=True),
        *(_column(panel, i, float(v), BLUE if v > 0.0 else RED) for i, v in enumerate(votes)),
        _below("windows, sorted"),
    ]
    return _sheet(
        "4. Selection: every window has a vote",
        f"{_called(answer)} beside {_called(rival) or 'no effect'}: {for_it} of {len(votes)} "
        "windows are explained better by the former",
        parts,
    )


def _measurement(diagnosis: Diagnosis) -> str:
    """A held-out recording, and what the nominal and the corrected model predict of it."""
    plant, episode = diagnosis.plant, diagnosis.validation[0]
    gap: Any = diagnosis.document["gap"]
    short = episode.t_s <= episode.t_s[0] + 2.0 * DRAWN_S
    t = episode.t_s[short]
    lines = {
        "measured": (episode.observations[short, 0], PALE),
        "nominal": (predicted(Nominal(plant), episode)[short, 0], ORANGE),
        "corrected": (predicted(diagnosis.predictor, episode)[short, 0], BLUE),
    }
    panel = Panel(
        TOP, HEIGHT, nice(*range_of([t])), nice(*range_of([v for v, _ in lines.values()]))
    )
    channel = plant.layout.observations[0]
    starts = np.arange(t[0], t[-1], plant.horizon_s)
    parts = [
        legend([(name, colour) for name, (_, colour) in lines.items()], 80),
        panel.frame(f"{channel.name} [{channel.unit}]", times=True),
        *(panel.line(t, v, colour, breaks=starts) for v, colour in lines.values()),
        _below(f"time [s]; predictions begin anew every {plant.horizon_s:g} s"),
    ]
    closed = 100.0 * gap["closed"]
    return _sheet(
        "6. Measurement: rollouts over a recording that was not fitted",
        f"error {gap['before']:.3g} before and {gap['after']:.3g} after, in standard deviations of "
        f"the motion: {closed:.4g} % of the gap",
        parts,
    )


def _intervals(diagnosis: Diagnosis) -> str:
    """One number of the answer, as each recording alone gives it and as all of them give it."""
    compared: Any = diagnosis.document["between_recordings"]
    entry = max(compared, key=lambda n: len(n["recordings"]))
    rows = [(f"recording {i}", s["value"], s["ci95"]) for i, s in enumerate(entry["recordings"], 1)]
    rows.append(("all of them", entry["value"], entry["together"]))
    values = np.array([x for _, _, ci in rows for x in ci])
    panel = Panel(TOP, 34.0 * len(rows), nice(*range_of([values])), np.array([0.0, len(rows)]))
    parts = []
    for i, (name, value, (low, high)) in enumerate(rows):
        y, colour = TOP + 34.0 * i + 17.0, BLUE if i == len(rows) - 1 else PALE
        parts += [
            f'<path d="M{panel.x(low):.1f} {y:.1f}H{panel.x(high):.1f}" stroke="{colour}" '
            'stroke-width="3"/>',
            f'<circle cx="{panel.x(value):.1f}" cy="{y:.1f}" r="5" fill="{colour}"/>',
            text(panel.x(high) + 10, y + 4, name, INK),
        ]
    bottom = TOP + 34.0 * len(rows)
    parts += [
        text(panel.x(float(v)), bottom + 20, f"{v:g}", PALE, anchor="middle")
        for v in nice(*range_of([values]))
    ]
    words = f"{entry.get('effect') or ''} {entry['label']} [{entry['unit']}]".replace("_", " ")
    parts.append(text(WIDTH / 2, bottom + 42, words.strip(), PALE, anchor="middle"))
    return sheet(
        "7. Intervals: whether the recordings agree",
        "95 % intervals of one number, from each recording alone and from all of them",
        round(bottom + 56),
        parts,
    )


def _called(candidate: Candidate) -> str:
    return " + ".join(e.replace("_", " ") for e in candidate.hypothesis.effects)


def _sheet(title: str, words: str, parts: Sequence[str]) -> str:
    return sheet(title, words, TOP + HEIGHT + 56, parts)


def _below(words: str) -> str:
    return text(WIDTH / 2, TOP + HEIGHT + 42, words, PALE, anchor="middle")


def _bar(panel: Panel, left: float, right: float, height: float) -> str:
    x, y = panel.x(left), panel.y(height)
    size = f'width="{panel.x(right) - x - 1:.1f}" height="{panel.bottom - y:.1f}"'
    return f'<rect x="{x:.1f}" y="{y:.1f}" {size} fill="{BLUE}" opacity="0.45"/>'


def _column(panel: Panel, at: int, value: float, colour: str) -> str:
    x = panel.x(at + 0.5)
    return (
        f'<path d="M{x:.1f} {panel.y(0.0):.1f}V{panel.y(value):.1f}" stroke="{colour}" '
        f'stroke-width="{max(1.0, 0.7 * (panel.x(1) - panel.x(0))):.1f}"/>'
    )


def _dot(panel: Panel, x: float, y: float, colour: str) -> str:
    return f'<circle cx="{panel.x(x):.1f}" cy="{panel.y(y):.1f}" r="5" fill="{colour}"/>'


def _upright(panel: Panel, at: float) -> str:
    x = panel.x(at)
    return f'<path d="M{x:.1f} {panel.top}V{panel.bottom}" stroke="{PALE}" stroke-dasharray="2 4"/>'


if __name__ == "__main__":
    main()
