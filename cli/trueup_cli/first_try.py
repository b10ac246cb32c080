"""`trueup try`: the main job on recordings of one's own, step by step, asking at each."""

from __future__ import annotations

import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import orjson

from trueup.diagnose.case import names_of, read_case, recordings_of
from trueup.doctor.examine import examine
from trueup.errors import BadMapping, BadPlant
from trueup.model.nominal_form import resolved
from trueup_cli.embedded_service import admin_token, embedded_service
from trueup_cli.examination import affected
from trueup_cli.init import CaseOptions, case_of, show_case
from trueup_cli.registry import result_of, run_job, show_decision
from trueup_cli.serving import show_serving
from trueup_cli.show import ask, progress, say, show_diagnosis
from trueup_client import Client, Problem
from trueup_pages.diagnosis import report_page

CASE, REGISTRY, REPORT = "case", "registry", "report.html"
FIGURES = "figures.json"


def first_try(
    log: Path | None = None,
    *,
    out: Path = Path("first-try"),
    options: CaseOptions | None = None,
) -> None:
    """Walk through the main job on your own recordings: read them, look for faults, diagnose, judge
    the correction by a gate, serve it.

    It asks before each step, says which command does the same, and writes to one folder. The
    registry is a server on this computer, which ends with the walk.

    Parameters
    ----------
    log
        file or folder of recordings, or a case folder; asked for where it is not given
    out
        folder to write to, which must be new or empty
    """
    chosen = options or CaseOptions()
    if not sys.stdin.isatty() and not (chosen.yes and log is not None):
        raise BadMapping(
            "`trueup try` asks at each step, and nobody is there to answer",
            field="yes",
            hint="Name the recordings and give --yes, which takes every step and every guess.",
        )
    if out.exists() and any(out.iterdir()):
        raise BadPlant(f"{out} is not empty", hint="Name a new folder with --out.")
    walk = Walk(log or Path(input("Recordings (a file or a folder): ").strip()), out, chosen)
    if not walk.goes():
        say("stopped here; what was made is in {}", out)


class Walk:
    """One walk: from a log to a correction that serves."""

    def __init__(self, log: Path, out: Path, options: CaseOptions) -> None:
        self.log, self.out, self.options = log, out, options
        self.folder = log if (log / "plant.json").is_file() else out / CASE

    def goes(self) -> bool:
        """Takes the steps in their order, and returns whether it came to the end."""
        self._read()
        if not self._continues("Is this your machine, with these signals and roles?"):
            say("Correct {}, then: trueup diagnose {}", self.folder / "plant.json", self.folder)
            return False
        self._look_for_faults()
        if not self._continues("Diagnose the gap between this model and the recordings?"):
            return False
        with embedded_service(self.out / REGISTRY) as (url, _):
            client = Client(url, actor="try", token=admin_token(self.out / REGISTRY))
            came_to_the_end = self._on_the_service(client)
        look = f"trueup look --data {self.out / REGISTRY}"
        say("\nThe registry with everything that happened, in a browser: {}", look)
        return came_to_the_end

    def _continues(self, question: str) -> bool:
        return self.options.yes or ask(question)

    def _heading(self, step: int, what: str, command: str) -> None:
        say("\n[bold]{}  {}[/]  [dim]{}[/]", step, what, command)

    def _read(self) -> None:
        if self.folder == self.log:
            self._heading(1, "Read the recordings", "")
            say("{} is a case folder: plant.json and recordings are taken as they are", self.log)
            return
        self._heading(1, "Read the recordings", f"trueup init {self.log} --out {self.folder}")
        self.out.mkdir(parents=True, exist_ok=True)
        show_case(case_of(self.log, self.folder, self.options, is_quiet=False))

    def _look_for_faults(self) -> None:
        self._heading(2, "Look for faults in the log", f"trueup doctor {self.folder}")
        with progress("doctor"):
            plant, episodes = read_case(self.folder)
            findings = examine(plant, episodes)
        names = names_of(self.folder, episodes)
        if not findings:
            say("none found")
        for f in findings:
            say("[yellow]{}[/] in {}: {}. {}", f.fault, affected(f, names), f.evidence, f.advice)

    def _on_the_service(self, client: Client) -> bool:
        """Registers, diagnoses, judges and promotes."""
        document = orjson.loads((self.folder / "plant.json").read_bytes())
        plant = resolved(document, self.folder)
        name = str(plant["name"])
        self._heading(
            3,
            "Register the plant, upload the recordings, and declare the gate before any score",
            f"trueup plant register {self.folder}; trueup upload {name} {self.folder}",
        )
        client.register_plant(plant)
        with progress("uploading") as bar:
            files = recordings_of(self.folder)
            for done, file in enumerate(files, 1):
                client.upload_episode(name, file)
                bar(done / len(files), file.name)
        gate = client.declare_gate(name, None)
        rules = ", ".join(r["rule"].replace("_", " ") for r in gate["document"]["rules"])
        say("{} recordings; gate {}: {}", len(files), gate["digest"][:12], rules)
        self._heading(4, "Diagnose", f"trueup diagnosis {name}")
        job = run_job(client, name, {"kind": "diagnose"}, "diagnose")
        result = result_of(job)
        self._keep_report(client, str(job["id"]), result["report"])
        if result["report"]["verdict"] == "no_gap":
            say("There is nothing to correct: the declared model keeps serving.")
            return True
        if not self._continues("Judge the corrected model by the gate?"):
            return False
        return self._judge(client, name, str(result["artifact"]), gate["digest"])

    def _keep_report(self, client: Client, job: str, report: dict[str, Any]) -> None:
        """Prints a diagnosis and writes its page."""
        names = names_of(self.folder, read_case(self.folder)[1])
        show_diagnosis(report, names)
        drawn = None
        with suppress(Problem):  # a report without pictures is still one
            drawn = orjson.loads(client.output(job, FIGURES))
        page = self.out / REPORT
        page.write_text(report_page(report, drawn, None, names))
        say("report, with pictures: {}", page)

    def _judge(self, client: Client, plant: str, candidate: str, gate: str) -> bool:
        self._heading(5, "Judge", f"trueup gate {plant} {candidate[:12]}")
        request = {"kind": "gate", "candidate": candidate, "gate": gate}
        digest = str(result_of(run_job(client, plant, request, "judge"))["decision"])
        decision = client.decision(plant, digest)
        show_decision(decision, client.gate_in_line(plant, gate))
        if not decision["accepted"]:
            say("The declared model keeps serving.")
            return True
        if not self._continues("Serve the corrected model?"):
            return False
        self._heading(6, "Promote", f"trueup promote {plant} {digest[:12]}")
        client.promote(plant, digest, decision["generation"])
        show_serving([client.serving(plant)], as_json_=False)
        say(
            "To go back, after a test of the older version: trueup rollback {}. To use the model "
            "in your own code: trueup fetch {} FOLDER",
            plant,
            plant,
        )
        return True
