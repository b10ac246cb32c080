"""`trueup diagnose`: where the gap lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import trueup
from trueup.artifact.artifact import pack
from trueup.diagnose.case import read_case
from trueup.diagnose.diagnosis import Diagnosis, diagnose
from trueup.diagnose.figures import figures
from trueup.diagnose.report import COMMAND_FILE
from trueup.diagnose.summary_text import sentence, warnings
from trueup.episode.episode import Episode
from trueup.model.mjcf_writer import write as write_corrected
from trueup_cli.options import Json, Seed
from trueup_cli.show import answer, as_json, progress, say
from trueup_pages.diagnosis import report_page


def run(case: Path, *, out: Path, seed: Seed = 0, as_json_: Json = False) -> None:
    """Diagnose the gap between a case's nominal model and its recordings.

    Writes report.json, report.html and the corrected model to a folder; of a robot also its MJCF,
    corrected, and the difference as a patch.

    Parameters
    ----------
    case
        folder with plant.json and *.mcap episodes; or a recording or a ROS 2 bag, of which a case
    is made first out
        folder to write to
    """
    if not (case / "plant.json").is_file() and (case.is_file() or any(case.glob("*.mcap"))):
        from trueup_cli.init import Wanted, make_case, tell

        made = make_case(case, out / "case", Wanted())
        case = made.folder
        if not as_json_:
            tell(made)
    with progress("diagnose") as bar:
        bar(0.0, "reading the episodes")
        plant, episodes = read_case(case)
        found = diagnose(plant, episodes, seed, lambda stage, part: bar(part, stage))
    write(found, episodes, out)
    files = {"report": out / "report.html", "model": out / "model", **write_mjcf(found, case, out)}
    if as_json_:
        as_json(
            {
                "sentence": sentence(found.document),
                "warnings": warnings(found.document),
                "report": dict(found.document),
                "files": {what: str(to) for what, to in files.items()},
            }
        )
        return
    answer(found.document)
    if found.choice.rivals:
        say(
            "What would part the explanations: trueup excite {} --model {} --split --out {}",
            case,
            out,
            out / "experiment",
        )
    say("{}", "   ".join(f"{what}: {where}" for what, where in files.items()))


def write(found: Diagnosis, episodes: list[Episode], out: Path) -> None:
    """The report as JSON and as a page, the corrected model, and the next experiment's command."""
    model = out / "model"
    model.mkdir(parents=True, exist_ok=True)
    artifact = pack(
        found.predictor,
        {
            "origin": "diagnosis",
            "episodes": [e.digest for e in episodes],
            "verdict": str(found.document["verdict"]),
        },
    )
    (model / "manifest.json").write_bytes(artifact.manifest)
    (model / "arrays.safetensors").write_bytes(artifact.arrays)
    if found.experiment is not None and found.experiment.command is not None:
        (out / COMMAND_FILE).write_text(found.experiment.csv(found.plant), newline="")
    (out / "report.json").write_text(json.dumps(found.document, indent=1) + "\n")
    (out / "report.html").write_text(report_page(found.document, figures(found, episodes)))


def write_mjcf(found: Diagnosis, case: Path, out: Path) -> dict[str, Path]:
    """A robot's MJCF with what was found written into it, and the difference as a patch; nothing
    where the model is no file."""
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
        sentence(found.document),
    ]
    written = write_corrected(source, found.patch, heading)
    files = {"MJCF": out / "corrected.xml"}
    files["MJCF"].write_text(written.text)
    if written.difference:
        files["patch"] = out / "corrected.patch"
        files["patch"].write_text(written.difference)
    return files
