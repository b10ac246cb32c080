"""Write docs/tuning.md from the numbers themselves."""

import inspect
from dataclasses import fields
from pathlib import Path

from trueup.diagnose.model_selection import PHYSICAL, ROBOT, SIMULATED, SelectionCriteria
from trueup.diagnose.tuning import GROUPS
from trueup.diagnose.tuning_of_answers import GROUPS as ANSWERS
from trueup.doctor.tuning import GROUPS as DOCTOR

HEAD = """# Tuning

Every number that steers a diagnosis and is not a law of statistics, from `tuning.py`,
`tuning_of_answers.py` and `model_selection.py` in `library/trueup/diagnose`. They are the same for
every machine, and were set on the open development set: simulated machines whose hidden effects are
known (`bench/diagnosis.py` draws them; the [figures](figures.md) say how often the answer is
right). Machines on which the method is judged had no part in it. Who changes a number runs that set
again.
"""
DOCTOR_HEAD = """# Tuning of the doctor

Every number that decides whether something is a [fault of a log](doctor.md), from
`library/trueup/doctor/tuning.py`. They were set so that sound logs, simulated and real, have none.
"""
CRITERIA = {"a simulated joint": SIMULATED, "a simulated robot": ROBOT, "a machine": PHYSICAL}


def page() -> str:
    """The page's text."""
    parts = [HEAD, *(_group(group) for group in (*GROUPS, *ANSWERS)), _criteria(), DOCTOR_HEAD]
    parts += [_group(group) for group in DOCTOR]
    return "\n".join(parts)


def _group(group: object) -> str:
    name = type(group).__name__.removesuffix("Tuning")
    rows = [
        f"| `{f.name}` | {_value(getattr(group, f.name))} | {f.metadata['unit']} "
        f"| {f.metadata['why']} |"
        for f in fields(group)
    ]
    head = ["| number | value | unit | why |", "|---|---|---|---|"]
    return "\n".join([f"## {_title(name)}", "", inspect.getdoc(group) or "", "", *head, *rows, ""])


def _criteria() -> str:
    rows = [
        f"| `{f.name}` | {' | '.join(_value(getattr(c, f.name)) for c in CRITERIA.values())} "
        f"| {f.metadata['unit']} | {f.metadata['why']} |"
        for f in fields(SelectionCriteria)
    ]
    head = [f"| number | {' | '.join(CRITERIA)} | unit | why |", "|---|---|---|---|---|---|"]
    text = (
        "How exact a law may be expected to be, by what was recorded. A simulator's laws and "
        "integration differ by about a thousandth; no textbook law holds on a machine to better "
        "than some per cent."
    )
    return "\n".join(["## Selection criteria", "", text, "", *head, *rows, ""])


def _title(name: str) -> str:
    words = "".join(f" {c.lower()}" if c.isupper() else c for c in name).strip()
    return words[0].upper() + words[1:]


def _value(value: object) -> str:
    if isinstance(value, tuple):
        return ", ".join(_value(x) for x in value)
    return f"{value:g}" if isinstance(value, float) else str(value).lower()


if __name__ == "__main__":
    (Path(__file__).parent / "tuning.md").write_text(page(), encoding="utf-8")
