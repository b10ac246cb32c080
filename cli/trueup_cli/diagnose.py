"""`trueup diagnose`: find where the gap lies, which effect causes it, and how far it shrinks."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

import trueup
from trueup.artifact.model import save
from trueup.cores import one_arena
from trueup.diagnose.case import names_of, read_case
from trueup.diagnose.diagnosis import Diagnosis, diagnose
from trueup.diagnose.figures import figures
from trueup.diagnose.processes import in_processes
from trueup.diagnose.report import COMMAND_FILE
from trueup.diagnose.summary_text import sentence
from trueup.diagnose.summary_warnings import warnings
from trueup.episode.episode import Episode
from trueup.model.mjcf_writer import write as write_corrected
from trueup.randomise.supported import RANDOMISATION_FILE, supported_ranges
from trueup_cli.init import CaseOptions, case_of, show_case
from trueup_cli.options import Json, Seed
from trueup_cli.show import as_json, progress, say, show_diagnosis
from trueup_pages.diagnosis import report_page


def run(
    case: Path,
    *,
    out: Path,
    options: CaseOptions | None = None,
    seed: Seed = 0,
    as_json_: Json = False,
) -> None:
    """Diagnose the gap between a case's nominal model and its recordings.

    Writes report.json, report.html, the corrected model and the randomisation ranges that its
    intervals support to a folder. For a robot it also writes
    the corrected MJCF, and the difference as a patch.

    Parameters
    ----------
    case
        folder with plant.json and *.mcap episodes; or recordings of any format that `trueup init`
        reads, from which such a folder is made first, by the same options
    out
        folder to write to
    """
    if not (case / "plant.json").is_file() and case.exists():
        made = case_of(case, out / "case", options or CaseOptions(), is_quiet=as_json_)
        case = made.folder
        if not as_json_:
            show_case(made)
    one_arena()
    with progress("diagnose") as bar:
        bar(0.0, "reading the episodes")
        plant, episodes = read_case(case)
        names = names_of(case, episodes)
        diagnosis = diagnose(
            plant, episodes, seed, lambda stage, part: bar(part, stage), in_processes
        )
    write(diagnosis, episodes, out, names)
    report = diagnosis.document
    files = {
        "report": out / "report.html",
        "model": out / "model",
        **write_mjcf(diagnosis, case, out),
    }
    if as_json_:
        as_json(
            {
                "sentence": sentence(report),
                "warnings": warnings(report, names),
                "report": dict(report),
                "files": {what: str(to) for what, to in files.items()},
            }
        )
        return
    show_diagnosis(report, names)
    if diagnosis.choice.rivals:
        say(
            "What would part the explanations: trueup excite {} --model {} --split --out {}",
            case,
            out,
            out / "experiment",
        )
    say("{}", "   ".join(f"{what}: {where}" for what, where in files.items()))


def write(
    diagnosis: Diagnosis, episodes: list[Episode], out: Path, names: Mapping[str, str]
) -> None:
    """Writes the report as JSON and as a page, the model, the randomisation ranges that it
    supports, and the next experiment's command."""
    save(diagnosis.artifact(episodes), out / "model")
    experiment, report = diagnosis.experiment, diagnosis.document
    if experiment is not None and experiment.command is not None:
        (out / COMMAND_FILE).write_text(experiment.csv(diagnosis.plant), newline="")
    ranges = supported_ranges(diagnosis.predictor, report)
    if ranges is not None:
        (out / RANDOMISATION_FILE).write_text(json.dumps(ranges, indent=1) + "\n")
    (out / "report.json").write_text(json.dumps(report, indent=1) + "\n")
    (out / "report.html").write_text(report_page(report, figures(diagnosis), names=names))


def write_mjcf(diagnosis: Diagnosis, case: Path, out: Path) -> dict[str, Path]:
    """Writes a robot's corrected MJCF and the difference as a patch, and returns the files.

    Writes nothing if the nominal model is not an MJCF file of the case.
    """
    nominal = json.loads((case / "plant.json").read_bytes())["nominal"]
    if "mjcf" not in nominal or not (case / nominal["mjcf"]).is_file():
        return {}
    source, report = case / nominal["mjcf"], (out / "report.json").read_bytes()
    heading = [
        (
            f"{source.name} (sha256 {hashlib.sha256(source.read_bytes()).hexdigest()}), "
            f"corrected by trueup {trueup.__version__}"
        ),
        f"from the diagnosis report.json (sha256 {hashlib.sha256(report).hexdigest()}):",
        sentence(diagnosis.document),
    ]
    written = write_corrected(source, diagnosis.patch, heading)
    files = {"MJCF": out / "corrected.xml"}
    files["MJCF"].write_text(written.text)
    if written.difference:
        files["patch"] = out / "corrected.patch"
        files["patch"].write_text(written.difference)
    return files
