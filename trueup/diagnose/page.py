"""Page: a diagnosis to look at, as one HTML file that needs nothing else.

From top to bottom: the answer in a sentence, how far the gap closes, measured against predicted, where the residual lies, what was
compared, estimates, what the data speak against and what they could not show, and what to do next.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trueup.episode.episode import Episode
from trueup.model.predictor import Nominal, Predictor
from trueup.model.state import is_observed
from trueup.model.windows import cut, starts_every

if TYPE_CHECKING:
    from trueup.diagnose.diagnosis import Diagnosis

Array = NDArray[np.float64]
WIDTH, PLOT, SMALL, MARGIN = 920, 220, 110, 56
MOST_POINTS = 1200  # of a drawn line: more than there are pixels
ROWS = 14  # of the table of comparisons
MOSTLY = "New numbers in the nominal form explain most of the gap; no effect of the catalogue takes a material part of what remains."
PLAINLY = 2.0  # times the floor: an error above that is no noise
WORDS = {
    "no_gap": "The nominal model already predicts as well as the noise allows.",
    "parameters_only": "New numbers in the nominal form explain the gap; no effect is missing.",
    "unknown_effect": "A gap remains that no composition of the catalogue explains.",
}
STYLE = """
:root{color-scheme:light dark;--ink:#1f2933;--pale:#697586;--line:#d9dee5;--card:#fff;--paper:#f5f7fa;--before:#c2570c;--after:#0b69a3;--bar:#7aa7c7;--good:#1d7a46}
@media(prefers-color-scheme:dark){:root{--ink:#e6eaef;--pale:#9aa5b1;--line:#39424e;--card:#1b222b;--paper:#12171d;--before:#f59e54;--after:#67b7ea;--bar:#3f6d8e;--good:#5fc48d}}
*{box-sizing:border-box}body{margin:0;background:var(--paper);color:var(--ink);font:15px/1.5 system-ui,sans-serif}
main{max-width:1000px;margin:0 auto;padding:24px 16px 64px}h1{font-size:24px;line-height:1.3;margin:8px 0 4px}h2{font-size:17px;margin:0 0 8px}
section{background:var(--card);border:1px solid var(--line);border-radius:10px;padding:18px 20px;margin:16px 0;overflow-x:auto}
p{margin:6px 0}.pale{color:var(--pale)}.figures{display:flex;flex-wrap:wrap;gap:12px 32px;margin-top:12px}.figures b{display:block;font-size:22px;font-variant-numeric:tabular-nums}
table{border-collapse:collapse;width:100%;font-variant-numeric:tabular-nums}th,td{text-align:left;padding:4px 12px 4px 0;border-bottom:1px solid var(--line);vertical-align:top}
th{font-weight:600;color:var(--pale);font-size:13px}td.n,th.n{text-align:right}tr.in td{font-weight:600}svg{max-width:100%;height:auto;display:block}
svg text{fill:var(--pale);font:12px system-ui,sans-serif}code{font-size:13px}.cols{display:grid;grid-template-columns:repeat(auto-fit,minmax(300px,1fr));gap:8px 32px}
"""


def sentence(document: Mapping[str, Any]) -> str:
    """The answer in a sentence or two."""
    verdict, gap = document["verdict"], document["gap"]
    if verdict != "effect":
        text = MOSTLY if verdict == "parameters_only" and gap["after"] > PLAINLY * gap["floor"] else WORDS[verdict]
    else:
        text = " and ".join(_effect_words(e) for e in document["effects"]) + "."
        text = text[0].upper() + text[1:]
    if gap["closed"] is not None:
        text += f" Held-out error falls from {_short(gap['before'])} to {_short(gap['after'])} of the motion; noise alone makes {_short(gap['floor'])}."
    others = document["indistinguishable"]
    if others:
        text += f" The data cannot tell this from {_either(others)}."
    return text


def _effect_words(entry: Mapping[str, Any]) -> str:
    name, estimate = entry["effect"].replace("_", " "), next(iter(entry["estimate"].items()), None)
    words = f"{name} at {entry['joint']}" if "joint" in entry else f"{name} at the {entry['channel']}"
    if estimate:
        low, high = estimate[1]["ci95"]
        words += f", {estimate[0].replace('_', ' ')} {_short(estimate[1]['value'])} ± {_short((high - low) / 2)} {_unit(estimate[1]['unit'])}".rstrip()
    return words + (f", {entry['share']:.0%} of the gap" if entry["share"] > 0.0 else "")


def _named(entry: Any) -> str:
    """An effect in words; where a report names its joint, at that joint."""
    if isinstance(entry, str):
        return entry.replace("_", " ")
    name = str(entry["effect"]).replace("_", " ")
    return f"{name} at {entry['joint']}" if entry.get("joint") else name


def _either(others: Sequence[Sequence[Any]]) -> str:
    names = [" with ".join(_named(n) for n in o) for o in others]
    return ", or ".join(names)


def _unit(text: str) -> str:
    return "" if text == "1" else text


def _short(x: float | None) -> str:
    return "–" if x is None else f"{x:.3g}"


def page(found: Diagnosis) -> str:
    """The report as one HTML page."""
    d: Mapping[str, Any] = found.document
    parts = [
        f"<header><p class=pale>Diagnosis of {escape(found.plant.name)}</p><h1>{escape(sentence(d))}</h1></header>",
        section("How far", _figures(d)),
        section("Measured against predicted, on a held-out episode", _traces(found)),
        section("Where", _where(d)),
        section("Which", _effects(d) + _hypotheses(d)),
        section("Parameters", _parameters(d)),
        *([section("The corrected model as MJCF", _mjcf(d["mjcf"]))] if "mjcf" in d else []),
        f"<div class=cols>{section('What the data speak against', _excluded(d))}{section('What they could not show', _unexcited(d))}</div>",
        section("What next", _next(d)),
        section("What this rests on", _evidence(d)),
    ]
    return whole(f"Diagnosis of {found.plant.name}", parts)


def whole(title: str, parts: Sequence[str], style: str = "") -> str:
    """A page that needs nothing else."""
    head = f"<meta charset=utf-8><meta name=viewport content='width=device-width'><title>{escape(title)}</title>"
    return (
        f"<!doctype html><html lang=en><head>{head}<style>{STYLE}{style}</style></head><body><main>{''.join(parts)}</main></body></html>\n"
    )


def section(title: str, body: str) -> str:
    """One card of a page."""
    return f"<section><h2>{escape(title)}</h2>{body}</section>"


def _figures(d: Mapping[str, Any]) -> str:
    gap = d["gap"]
    items = [
        ("before", gap["before"]), ("parameters only", gap["parameters_only"]), ("corrected", gap["after"]), ("noise floor", gap["floor"]),
    ]  # fmt: skip
    most = max(x for _, x in items) or 1.0
    bars = []
    for i, (name, value) in enumerate(items):
        y, w = 6 + 30 * i, 560 * value / most
        colour = "var(--before)" if i == 0 else "var(--good)" if i == 3 else "var(--after)"  # noqa: PLR2004
        bars.append(
            f"<text x=0 y={y + 16}>{name}</text><rect x=130 y={y} width={max(w, 1):.1f} height=20 rx=3 fill='{colour}'/>"
            f"<text x={138 + w:.0f} y={y + 15}>{_short(value)}</text>"
        )
    closed = "nothing to close" if gap["closed"] is None else f"{gap['closed']:.1%}"
    interval = "" if not gap["ci95"] else f"<span class=pale>95 %: {gap['ci95'][0]:.1%} to {gap['ci95'][1]:.1%}</span>"
    label = f"held-out error: before {_short(gap['before'])}, corrected {_short(gap['after'])}, floor {_short(gap['floor'])}"
    svg = f"<svg viewBox='0 0 {WIDTH} 130' role=img aria-label='{label}'>{''.join(bars)}</svg>"
    note = f"Root mean square error of rollouts over {gap['horizon_s']:g} s, in units of each channel's standard deviation, on validation episodes."
    if gap["beginnings"] != "counted":
        note += " The window with which a log begins is left out: no sample says what was before."
    return f"<div class=figures><div><b>{closed}</b>of the gap closed {interval}</div></div><p class=pale>{note}</p>{svg}"


def _traces(found: Diagnosis) -> str:
    plant = found.plant
    episode = max(found.validation, key=lambda e: float(np.nanstd(e.observations[:, 0])))
    models = [
        ("measured", None, "var(--ink)"),
        ("nominal", Nominal(found.plant), "var(--before)"),
        ("corrected", found.predictor, "var(--after)"),
    ]
    paths = [
        (name, episode.observations if m is None else _predicted(m, episode, found.plant.horizon_s), colour) for name, m, colour in models
    ]
    drawn = []
    told = {e.get("joint") for e in found.document["effects"]} or {found.document["where"].get("regions_of")}  # type: ignore[union-attr]
    for column, channel in enumerate(plant.layout.observations):
        if len(plant.joints) > 1 and plant.joint_name(plant.joint_of(channel)) not in told:
            continue
        lines = [(name, p[:, column], colour) for name, p, colour in paths]
        drawn.append(_plot(episode.t_s, lines, f"{channel.name} [{channel.unit or '1'}]", PLOT))
        missed = [(name, p[:, column] - episode.observations[:, column], colour) for name, p, colour in paths[1:]]
        drawn.append(_plot(episode.t_s, missed, f"error of {channel.name}", SMALL))
    key = " ".join(f"<span style='color:{colour}'>━ {name}</span>" for name, _, colour in paths)
    blind = "" if is_observed(found.plant, episode) else ", the first without a velocity, as none is observed"
    return f"<p>{key} <span class=pale>· rollouts start anew every {found.plant.horizon_s:g} s{blind}</span></p>{''.join(drawn)}"


def _predicted(model: Predictor, episode: Episode, horizon_s: float) -> Array:
    windows = cut(model.plant, episode, starts_every(episode.t_s, horizon_s))
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(model.plant.observe(model.rollout(windows))[windows.inside])


def _plot(t: Array, lines: Sequence[tuple[str, Array, str]], label: str, height: int) -> str:
    every = max(1, len(t) // MOST_POINTS)
    finite = np.concatenate([y[np.isfinite(y)] for _, y, _ in lines])
    low, high = float(np.quantile(finite, 0.001)), float(np.quantile(finite, 0.999))
    low, high = (low - 1.0, high + 1.0) if high <= low else (low - 0.05 * (high - low), high + 0.05 * (high - low))
    x = MARGIN + (t - t[0]) / (t[-1] - t[0]) * (WIDTH - MARGIN - 8)
    drawn = []
    for value in (low, 0.5 * (low + high), high):
        y = 8 + (high - value) / (high - low) * (height - 28)
        drawn.append(
            f"<line x1={MARGIN} x2={WIDTH - 8} y1={y:.1f} y2={y:.1f} stroke='var(--line)'/><text x={MARGIN - 6} y={y + 4:.1f} text-anchor=end>{value:.2g}</text>"
        )
    for _, values, colour in lines:
        heights = 8 + (high - np.clip(values, low, high)) / (high - low) * (height - 28)
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x[::every], heights[::every], strict=True) if np.isfinite(b))
        drawn.append(f"<polyline points='{points}' fill=none stroke='{colour}' stroke-width=1.4 />")
    ends = f"<text x={MARGIN} y={height - 4}>{t[0]:g} s</text><text x={WIDTH - 8} y={height - 4} text-anchor=end>{t[-1]:.3g} s</text>"
    return f"<p class=pale>{escape(label)}</p><svg viewBox='0 0 {WIDTH} {height}' role=img aria-label='{escape(label)} over time'>{''.join(drawn)}{ends}</svg>"


def _where(d: Mapping[str, Any]) -> str:
    where = d["where"]
    regions = [(r["region"], r["share"], f"{r['share']:.0%} of the residual in {r['of_time']:.0%} of the time") for r in where["regions"]]
    ports = [(p["port"], p["share"], f"{p['share']:.1%} by {p['by'].replace('_', ' ')}") for p in where["ports"]]
    bands = [(b["band"], b["share"], f"{b['share']:.0%} of the residual, {b['of_motion']:.0%} of the motion") for b in where["bands"]]
    channels = [(c["channel"], c["share"], f"{c['share']:.0%}") for c in where["channels"]]
    joints = [
        (j["joint"], j["force"], f"{j['force']:.0%} of the residual force, {j['acceleration']:.0%} of the acceleration that it makes")
        for j in where.get("joints", [])
    ]
    pushes = "".join(f"<li>{escape(push)}</li>" for push in pushed(d))
    by_joint = f"<p>Something outside pushes, as a contact does; it is not simulated:</p><ul>{pushes}</ul>" if pushes else ""
    if joints:
        by_joint += "<p class=pale>by joint, what only travels through the coupling taken out</p>" + _bars(joints)
    at = f", at {escape(where['regions_of'])}" if joints else ""
    return (
        f"<div class=cols><div>{by_joint}<p class=pale>by region{at}, the most telling first</p>{_bars(regions)}</div>"
        "<div><p class=pale>by port: what its best single effect takes away</p>"
        + _bars(ports)
        + "<p class=pale>by band of frequency, of the acceleration</p>"
        + _bars(bands)
        + "<p class=pale>by channel</p>"
        + _bars(channels)
        + "</div></div>"
    )


def pushed(d: Mapping[str, Any]) -> list[str]:
    """When something outside pushes a robot, in words."""
    roles = {e["sha256"]: e["role"] for e in d["evidence"]["episodes"]}
    found = []
    for push in d["where"].get("pushed", []):
        joints = " and ".join(f"{j['joint']} by {j['force']:.2g}" for j in push["joints"])
        found.append(f"{roles[push['episode']]} episode {push['episode'][:12]}, {push['from_s']:g} to {push['to_s']:g} s: {joints}")
    return found


def _bars(items: Sequence[tuple[str, float, str]]) -> str:
    rows = []
    for i, (name, share, words) in enumerate(items):
        y = 4 + 34 * i
        rows.append(
            f"<text x=0 y={y + 11}>{escape(name)} · {escape(words)}</text>"
            f"<rect x=0 y={y + 15} width=420 height=8 rx=3 fill='var(--line)'/><rect x=0 y={y + 15} width={max(0.0, min(share, 1.0)) * 420:.1f} height=8 rx=3 fill='var(--bar)'/>"
        )
    return f"<svg viewBox='0 0 480 {8 + 34 * len(items)}' role=img aria-label='shares of the residual'>{''.join(rows)}</svg>"


def _effects(d: Mapping[str, Any]) -> str:
    if not d["effects"]:
        return f"<p>{escape(WORDS.get(d['verdict'], ''))}</p>"
    rows = []
    for e in d["effects"]:
        for i, (name, v) in enumerate(e["estimate"].items()):
            first = f"<b>{escape(_named(e))}</b>" if i == 0 else ""
            share = f"{e['share']:.1%}" if i == 0 else ""
            low, high = v["ci95"]
            rows.append(
                f"<tr><td>{first}<td>{escape(name.replace('_', ' '))}<td class=n>{_short(v['value'])}<td class=n>{_short(low)} to {_short(high)}"
                f"<td>{escape(_unit(v['unit']))}<td class=n>{share}</tr>"
            )
    return (
        "<table><tr><th>effect<th>parameter<th class=n>estimate<th class=n>95 %<th>unit<th class=n>share of gap</tr>"
        + "".join(rows)
        + "</table>"
    )


def _hypotheses(d: Mapping[str, Any]) -> str:
    rows = []
    for h in sorted(d["evidence"]["hypotheses"], key=lambda h: (h["misfit"] is None, h["misfit"]))[:ROWS]:
        name = " + ".join(_named(e) for e in h["effects"]) or f"{h['parameters']} parameters alone"
        mark = " class=in" if h.get("in_set") else ""
        rows.append(f"<tr{mark}><td>{escape(name)}<td class=n>{_short(h['misfit'])}<td class=n>{_short(h['validation'])}</tr>")
    note = "Mean squared error in units of the noise's: 1 is noise alone. What the evidence cannot tell from the answer is bold as the answer is."
    return (
        f"<h2 style='margin-top:18px'>Compared</h2><p class=pale>{note}</p><table><tr><th>composition<th class=n>all episodes<th class=n>validation</tr>"
        + "".join(rows) + "</table>"
    )  # fmt: skip


def _parameters(d: Mapping[str, Any]) -> str:
    rows = [
        f"<tr><td>{escape(name)}<td class=n>{_short(p['nominal'])}<td class=n>{_short(p['value'])}<td class=n>{_short(p['ci95'][0])} to {_short(p['ci95'][1])}</tr>"
        for name, p in d["parameters"].items()
    ]
    return "<table><tr><th>parameter<th class=n>nominal<th class=n>fitted<th class=n>95 %</tr>" + "".join(rows) + "</table>"


def _mjcf(patch: Mapping[str, Any]) -> str:
    rows = "".join(
        f"<tr><td>{escape(c['joint'])}<td>{escape(c['element'])}<td><code>{_broken(c['attribute'], c['corrected'])}</code>"
        f"<td class=n>{_listed(c['nominal'])}<td class=n>{_listed(c['corrected'])}</tr>"
        for c in patch["changes"]
    )
    head = "<tr><th>joint<th>element<th>attribute<th class=n>nominal<th class=n>corrected</tr>"
    left = "".join(
        f"<tr><td>{escape(_named(x).strip() if x['effect'] else 'masses')}<td>{escape(x['instead'])}</tr>" for x in patch["not_expressed"]
    )
    beyond = f"<h2 style='margin-top:18px'>What MJCF has no element for</h2><table>{left}</table>" if left else ""
    return (f"<table>{head}{rows}</table>" if rows else "<p>Nothing changes.</p>") + beyond


def _broken(attribute: str, values: Any) -> str:
    """An attribute's name, or those of a list of values, a line each."""
    return "<br>".join(map(escape, attribute.split())) if isinstance(values, list) and " " in attribute else escape(attribute)


def _listed(x: Any) -> str:
    return "<br>".join(_short(v) for v in x) if isinstance(x, list) else _short(x)


def _excluded(d: Mapping[str, Any]) -> str:
    rows = []
    for b in d["excluded"]:
        side = "below" if "below" in b else "above"
        rows.append(
            f"<tr><td>{escape(_named(b))}<td>{escape(b['parameter'].replace('_', ' '))} {side} {_short(b[side])} {escape(_unit(b['unit']))}</tr>"
        )
    return "<table>" + "".join(rows) + "</table><p class=pale>With 95 % confidence, beside the answer above.</p>"


def _unexcited(d: Mapping[str, Any]) -> str:
    rows = "".join(f"<tr><td>{escape(_named(b))}<td>{escape(b['why'])}</tr>" for b in d["not_excited"])
    return f"<table>{rows}</table>" if rows else "<p>Nothing: every effect of the catalogue would have shown.</p>"


def _next(d: Mapping[str, Any]) -> str:
    e = d["next_experiment"]
    if e is None:
        return (
            "<p>Nothing is left to split. Promote the corrected model through its gate.</p>"
            if d["verdict"] == "effect"
            else "<p>No experiment is proposed.</p>"
        )
    between = " from ".join(" + ".join(_named(n) for n in s) for s in e["splits"])
    file = f"<p>Command file: <code>{escape(e['command'])}</code></p>" if e["command"] else ""
    return f"<p>To tell {escape(between)}: {escape(e['why'])}</p>{file}"


def _evidence(d: Mapping[str, Any]) -> str:
    v = d["evidence"]
    rows = "".join(f"<tr><td>{escape(e['role'])}<td><code>{escape(e['sha256'][:16])}</code></tr>" for e in v["episodes"])
    note = f"Validation episodes compared {v['uses_of_validation']} compositions and measured the gap; they were never fitted."
    if v.get("not_simulated"):
        note += f" The model's {' and '.join(v['not_simulated'])} are not simulated: episodes during which they act are not explained."
    return f"<p>{escape(note)}</p><table>{rows}</table><p class=pale>trueup {escape(v['version'])}, seed {v['seed']}</p>"
