"""`trueup consistency`: whether other recordings of the same machine give the same numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from trueup.diagnose.case import names_of, read_case
from trueup.diagnose.consistency import consistency as study
from trueup.diagnose.diagnosis import diagnose
from trueup.diagnose.processes import in_processes
from trueup.diagnose.summary_text import number_name
from trueup_cli.options import DEFAULT_URL, Json, Url
from trueup_cli.show import progress, table
from trueup_cli.study import Presentation, folder_of, is_case, load_model, remote_consistency
from trueup_pages import consistency as page


def consistency(
    target: str,
    *,
    out: Path | None = None,
    model: Annotated[
        str | None,
        Parameter(
            help="Whose numbers: the folder of a diagnosis or of a fetched model; of a plant on "
            "the service a version, or the first digits of its digest; default: a new "
            "diagnosis of the case, or the plant's newest"
        ),
    ] = None,
    diagnoses: Annotated[
        bool,
        Parameter(
            negative=(),
            help="Diagnose days, conditions or halves of the recordings from the start, too; takes "
            "as long as that many diagnoses",
        ),
    ] = False,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Tell whether recordings agree on the numbers of a model: each recording, day and condition
    by itself.

    Numbers that differ are not one number of one machine. Writes report.json and report.html.

    Parameters
    ----------
    target
        a case folder, or the name of a plant on the service
    out
        folder to write to; default: consistency-TARGET
    """
    if is_case(target):
        document = _run_locally(Path(target), model, diagnoses=diagnoses)
    else:
        document = remote_consistency(url, target, model, diagnoses=diagnoses)
    Presentation(page.report_page, page.sentence, _show).tell(
        document, out or folder_of(target, "consistency"), in_json=as_json_
    )


def _run_locally(case: Path, folder: str | None, *, diagnoses: bool) -> dict[str, Any]:
    with progress("consistency") as bar:
        bar(0.0, "reading the episodes")
        plant, episodes = read_case(case)

        def report(stage: str, part: float) -> None:
            bar(part, stage)

        return study(
            diagnose(plant, episodes, 0, report, in_processes).predictor
            if folder is None
            else load_model(plant, Path(folder)),
            episodes,
            report,
            diagnoses=diagnoses,
            names=names_of(case, episodes),
            solve=in_processes,
        )


def _show(document: dict[str, Any]) -> None:
    names = page.names_of(document)
    rows = [
        (
            number_name(n),
            b["grouping"],
            names.get(s["subset"], s["subset"]),
            s["value"],
            *s["ci95"],
            n["unit"],
        )
        for n in document["numbers"]
        for b in n["by"]
        if b["contradicts"]
        for s in b["subsets"]
    ]
    if rows:
        columns = ["number", "by", "recordings", "value", "from", "to", "unit"]
        table("Numbers that recordings do not agree on", columns, rows)
