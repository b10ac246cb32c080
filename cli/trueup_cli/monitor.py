"""Commands on monitors, alarms and update policies."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from trueup.gate.policy import BadPolicy
from trueup_cli.digests import resolve
from trueup_cli.options import DEFAULT_URL, Json, PlantName, Url, connect, read_json
from trueup_cli.registry import result_of, run_job
from trueup_cli.show import as_json, moment, say, table
from trueup_client import Client
from trueup_client.problem import Problem
from trueup_client.records import Alarm, Policy

LATEST = 12  # episodes that are printed


def calibrate(
    plant: PlantName,
    *,
    promise_h: Annotated[
        float,
        Parameter(
            help="Operating hours in which one false alarm is allowed, of all joints together"
        ),
    ] = 100.0,
    detectors: Annotated[str | None, Parameter(help="Comma-separated; default: all")] = None,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Calibrate a monitor of what serves, on the plant's reference episodes. Then it watches."""
    client = connect(url)
    request: dict[str, Any] = {
        "kind": "calibrate",
        "promise_h": promise_h,
        **({"detectors": detectors.split(",")} if detectors else {}),
    }
    job = run_job(client, plant, request, "calibrate")
    if as_json_:
        as_json(job)
        return
    monitor = next(m for m in client.monitors(plant) if m["digest"] == result_of(job)["monitor"])
    show_calibration(monitor["document"])


def show_calibration(document: dict[str, Any]) -> None:
    """Prints the measured rate and delay of each detector, and what its promise rests on."""
    figures = document["figures"]["detectors"]
    rows = []
    for d in document["detectors"]:
        f = figures[d["detector"]]
        low, high = f["alarms_per_h_ci95"]
        rate = f"{f['alarms_per_h']:.3g} [{low:.3g}, {high:.3g}]"
        rows.append(
            (
                d["detector"],
                d["level"],
                f"{f['promised_per_h']:.3g}",
                rate,
                f"{f['exceedance']:.4f}",
                _delays(f["delays"]),
            )
        )
    table(
        "Monitor",
        [
            "detector",
            "level",
            "promised/h",
            "held out/h",
            "exceedance",
            "drifts found, median delay",
        ],
        rows,
    )
    hours = document["figures"]["reference_h"]
    promise_h = document["promise_h"]
    say(
        (
            "reference: {:.2f} h; one false alarm in {:g} h is promised, of all detectors and "
            "joints together"
        ),
        hours,
        promise_h,
    )
    if not document["figures"]["promise_shown"]:
        say(
            "[yellow]The reference is too short to show the promised rate: the alarm thresholds "
            "rest on an assumed tail of the distribution.[/]"
        )
    for d in document["detectors"]:
        say("[dim]{}: {}[/]", d["detector"], d["rests_on"])


def _delays(delays: dict[str, Any]) -> str:
    return "; ".join(
        f"{100 * d['found']:.0f} %" + (f", {d['median_s']:.0f} s" if d["median_s"] else "")
        for d in delays.values()
    )


def monitor(
    plant: PlantName,
    *,
    picture: Annotated[
        Path | None, Parameter(help="Write what the monitor saw as an SVG file")
    ] = None,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Show whether a plant's model is watched, what was seen last, and which alarm is open."""
    client = connect(url)
    state = client.monitor(plant)
    watches = list(client.watches(plant, state["monitor"])) if state["monitor"] else []
    if picture is not None:
        _draw(client, plant, picture)
    if as_json_:
        as_json(state)
        return
    watched = "watched" if state["watches"] else "not watched"
    say("{}: {}, {} episodes seen. {}", plant, watched, state["episodes"], state["hint"] or "")
    watches = [w for w in watches if "channels" in w["seen"]]
    if watches:
        names = list(watches[0]["seen"]["channels"])
        rows = [
            (w["sequence"], w["episode"][:12], moment(w["at"]), *_row(w["seen"], names))
            for w in watches[-LATEST:]
        ]
        table("", ["", "episode", "seen", *(f"{n} error" for n in names), "alarms"], rows)
    if state["alarm"]:
        show_alarm(state["alarm"])


def _draw(client: Client, plant: str, to: Path) -> None:
    from trueup_cli.pictures.watched import Watched, watch_picture

    monitors = reversed(list(client.monitors(plant)))
    watched = [
        Watched(
            client.artifact(plant, m["artifact"])["version"],
            m["document"],
            list(client.watches(plant, m["digest"])),
        )
        for m in monitors
    ]
    if any("channels" in one["seen"] for w in watched for one in w.watches):
        to.write_text(watch_picture(plant, watched))
    else:
        say("nothing was watched yet: there is nothing to draw")


def _row(seen: dict[str, Any], names: list[str]) -> tuple[object, ...]:
    return *(round(seen["channels"][n]["rms"], 2) for n in names), "; ".join(
        f"{d}: {a['leading']}" for d, a in seen["alarms"].items()
    )


def alarms(
    plant: PlantName,
    *,
    close: Annotated[
        str | None, Parameter(help="Id of an alarm to close, or its first digits")
    ] = None,
    because: Annotated[str | None, Parameter(help="Reason for closing it")] = None,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """List a plant's alarms, or close one."""
    client: Client = connect(url)
    listed = (
        [client.close_alarm(plant, _alarm(client, plant, close), because or "no reason was given")]
        if close is not None
        else list(client.alarms(plant))
    )
    if as_json_:
        as_json(listed)
        return
    for alarm in listed:
        show_alarm(alarm)
    if not listed:
        say("no alarms")


def _alarm(client: Client, plant: str, prefix: str) -> str:
    """Returns the id of an alarm by its first digits. Raises NoSuchDigest."""
    ids = (str(alarm["id"]) for alarm in client.alarms(plant))
    return resolve(prefix, ids, "alarm", f"trueup alarms {plant}")


def policy(
    plant: PlantName,
    file: Path | None = None,
    *,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Show or declare what may happen to a plant's model without a person.

    Parameters
    ----------
    file
        policy as JSON: schema, gate, on_alarm, on_diagnosis, on_acceptance, promise_h,
        reference_episodes, validate_every_h
    """
    client = connect(url)
    held = (
        _policy(client, plant)
        if file is None
        else client.declare_policy(plant, read_json(file, BadPolicy))
    )
    if as_json_:
        as_json(held)
        return
    if held is None:
        say(
            (
                "{} has no policy: every step is a person's. Declare one with [bold]trueup "
                "policy {} FILE[/]."
            ),
            plant,
            plant,
        )
        return
    say(
        "policy [bold]{}[/], the {}. of {}, since {}",
        held["digest"],
        held["sequence"],
        plant,
        moment(held["created_at"]),
    )
    table(
        "",
        ["", ""],
        [(name, value) for name, value in held["document"].items() if name != "schema"],
    )


def _policy(client: Client, plant: str) -> Policy | None:
    """Returns the policy that holds; None if none was declared. Raises Problem."""
    try:
        return client.policy(plant)
    except Problem as problem:
        if (problem.code, problem.facts.get("noun")) == ("not-found", "policy"):
            return None
        raise


def show_alarm(alarm: Alarm) -> None:
    """Prints an alarm: what changed, and the diagnosis that it opened."""
    if alarm["closed_at"]:
        say(
            "alarm [bold]{}[/] {}, closed: {}",
            alarm["id"],
            moment(alarm["raised_at"]),
            alarm["closed_because"],
        )
    else:
        say("alarm [bold]{}[/] {}, [bold red]open[/]", alarm["id"], moment(alarm["raised_at"]))
    for name, at in alarm["document"]["detectors"].items():
        say("  {}: {}", name, at["leading"])
    for words in alarm["document"]["change"]["words"]:
        say("  {}", words)
    if alarm["job"]:
        say("  diagnosis: job {}", alarm["job"])
    else:
        say(
            "  no diagnosis yet: upload an adaptation and a validation episode recorded "
            "since the change began"
        )
