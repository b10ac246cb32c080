"""Write the reference part of docs/python.md from the signatures and docstrings themselves."""

import inspect
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import trueup
import trueup_client
from trueup.artifact.model import Model
from trueup.notebook.diagnosis import diagnose
from trueup.notebook.models import NominalModel
from trueup.notebook.plots import Plots
from trueup_client.freshness import Freshness
from trueup_client.robot import Model as RobotModel

PAGE = Path(__file__).parent / "python.md"
BEGIN = "<!-- reference: written by make_python.py -->\n"
WIDEST = 88  # of a signature on one line
EVERY: tuple[str, ...] = ("*",)


@dataclass(frozen=True)
class Entry:
    """Something that is described: its name as it is imported, itself, and which of its members."""

    name: str
    what: Any
    members: tuple[str, ...] = ()


def entries(package: Any, **members: tuple[str, ...]) -> list[Entry]:
    """What a package offers by these names, each with the members that are described."""
    return [Entry(f"{package.__name__}.{n}", getattr(package, n), of) for n, of in members.items()]


NOTEBOOK = [
    *entries(trueup, Case=("from_table", "from_recordings", "read", "save", "findings", "guesses")),
    Entry("trueup.notebook.models.NominalModel", NominalModel),
    *entries(
        trueup,
        Pendulum=(),
        Oscillator=(),
        Inertia=(),
        Robot=(),
        Simulator=(),
        FirstModel=(),
    ),
    Entry("trueup.diagnose", diagnose),
    *entries(
        trueup,
        Diagnosis=(
            "verdict",
            "sentence",
            "warnings",
            "effects",
            "alternatives",
            "parameters",
            "gap",
            "where",
            "model",
            "plot",
            "export",
            "save",
        ),
    ),
    Entry("trueup.notebook.plots.Plots", Plots, ("where", "ranking", "predictions")),
    *entries(
        trueup,
        convert=(),
        compare=(),
        Comparison=("sentence",),
        blind_trial=(),
        BlindTrial=("exact", "misses"),
        excite=(),
        Experiment=("t_s", "commands", "check_first", "save"),
        Allowed=(),
        load_effect=(),
        load_simulator=(),
    ),
]
SECTIONS: dict[str, tuple[str, list[Entry]]] = {
    "A notebook": ("", NOTEBOOK),
    "A fetched model": ("", [*entries(trueup, load=()), Entry("trueup.Model", Model, EVERY)]),
    "The service": ("On the standard library alone.", entries(trueup_client, Client=EVERY)),
    "The service, awaited": (
        "It has every method of `Client`, awaited, or iterated over with `async for`.",
        entries(trueup_client, AsyncClient=("close",)),
    ),
    "A robot": (
        "",
        [
            *entries(trueup_client, Robot=EVERY),
            Entry("trueup_client.robot.Model", RobotModel, EVERY),
            Entry("trueup_client.Freshness", Freshness, EVERY),
        ],
    ),
}


def page() -> str:
    """The page: what stands there before the reference, and the reference."""
    return PAGE.read_text().split(BEGIN)[0] + BEGIN + "\n" + reference()


def reference() -> str:
    """The reference as Markdown."""
    lines: list[str] = []
    for title, (words, listed) in SECTIONS.items():
        lines += [
            f"## Reference: {title[0].lower()}{title[1:]}",
            "",
            *([words, ""] if words else []),
        ]
        for entry in listed:
            lines += _described(entry.name, entry.what, 3)
            for name, member in _members(entry):
                lines += _described(f"{entry.name.rsplit('.', 1)[-1]}.{name}", member, 4)
    return "\n".join(lines).rstrip() + "\n"


def _members(entry: Entry) -> Iterator[tuple[str, Any]]:
    known = inspect.classify_class_attrs(entry.what) if inspect.isclass(entry.what) else []
    attributes = {a.name: a.object for a in known if a.kind != "data" or a.name in entry.members}
    names = (
        [n for n, o in attributes.items() if not n.startswith("_") and inspect.getdoc(o)]
        if entry.members == EVERY
        else [n for n in entry.members if n in attributes]
    )
    return ((name, attributes[name]) for name in names)


def _described(name: str, what: Any, level: int) -> list[str]:
    """A heading, the signature as Python, and the docstring."""
    of = what.__func__ if isinstance(what, classmethod | staticmethod) else what
    words = inspect.getdoc(of) or ""
    heading = [f"{'#' * level} `{name}`", ""]
    if isinstance(of, property) and of.fget is not None:
        gives = inspect.get_annotations(of.fget).get("return", "")
        return [*heading, f"*{gives}*", "", words, ""] if gives else [*heading, words, ""]
    if not callable(of):
        return [*heading, words, ""]
    # Indented, for a fence would say that it can be run.
    signature = [f"    {line}" for line in _signature(name, of).splitlines()]
    return [*heading, *signature, "", words, ""]


def _signature(name: str, of: Any) -> str:
    """The signature on one line, or a line for each parameter where that is too wide."""
    short = name.rsplit(".", maxsplit=1)[-1]
    try:
        signature = inspect.signature(of)
    except ValueError:
        return f"{short}()"
    parts, keyword = [], False
    for p in signature.parameters.values():
        if p.name in ("self", "cls"):
            continue
        if p.kind is p.KEYWORD_ONLY and not keyword:
            parts.append("*")
            keyword = True
        star = "*" if p.kind is p.VAR_POSITIONAL else "**" if p.kind is p.VAR_KEYWORD else ""
        keyword = keyword or p.kind is p.VAR_POSITIONAL
        parts.append(f"{star}{p.name}{_annotation(p)}{_default(p)}")
    gives = signature.return_annotation
    back = "" if inspect.isclass(of) or gives is signature.empty else f" -> {_text(gives)}"
    line = f"{short}({', '.join(parts)}){back}"
    if len(line) <= WIDEST:
        return line
    return f"{short}(\n" + "".join(f"    {part},\n" for part in parts) + f"){back}"


def _annotation(p: inspect.Parameter) -> str:
    return "" if p.annotation is p.empty else f": {_text(p.annotation)}"


def _text(annotation: Any) -> str:
    return annotation if isinstance(annotation, str) else inspect.formatannotation(annotation)


def _default(p: inspect.Parameter) -> str:
    if p.default is p.empty:
        return ""
    written = repr(p.default)
    return " = …" if written.startswith("<") else f" = {written}"


if __name__ == "__main__":
    PAGE.write_text(page())
