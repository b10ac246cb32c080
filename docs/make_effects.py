"""Write docs/effects.md from the effects themselves."""

import inspect
from pathlib import Path

from trueup.model.effect import Effect, Port, effects

HEAD = """# Effects

The catalogue of what a diagnosis looks for. Each effect is one file in
`library/trueup/model/effects/`. Adding a file is all it takes to add an effect: it is found by
itself, compiled into the rollout, tried by the search, and held to the laws in
`library/trueup/checks/effect_laws.py`.

Signals: `u` command, `q` position, `v` velocity, `a` acceleration of the nominal form, `h` step.
Within a port the effects act in the order given.
"""
TITLES = {
    Port.TIMING: "Timing",
    Port.COMMAND: "Command: between issued and applied",
    Port.FORCE: "Force: at the joint",
    Port.FRICTION: "Force: dry friction, by an implicit step; levels of several add up",
    Port.OBSERVATION: "Observation: between state and log",
}


def page() -> str:
    """The page's text."""
    parts = [HEAD]
    for port, title in TITLES.items():
        parts.append(f"\n## {title}\n")
        parts += [_entry(e) for e in effects().values() if e.port is port]
    return "".join(parts)


def _entry(effect: type[Effect]) -> str:
    text = inspect.getdoc(effect) or ""
    what, _, rest = text.partition("\n\n")
    fields = {"Equation": "", "Source": "", "Blind": ""}
    key = ""
    for line in rest.splitlines():
        word = line.strip().split(":", 1)
        if word[0] in fields:
            key = word[0]
            fields[key] = word[1].strip()
        elif key:
            fields[key] += " " + line.strip()
    numbers = ", ".join(f"`{n.name}` [{n.scale}]" for n in effect.params)
    rows = [
        f"\n### `{effect.name}`\n",
        " ".join(what.split()),
        (
            f"\n![{effect.name.replace('_', ' ')}: what it does to a motion, a command or a "
            f"log](pictures/effects/{effect.name}.svg)"
        ),
        f"\n- Equation: `{fields['Equation']}`",
        f"- Numbers, in units of the plant's own: {numbers}",
        f"- Category: {effect.category}",
        f"- Source: {fields['Source']}",
        f"- Blind: {fields['Blind']}",
    ]
    return "\n".join(rows) + "\n"


if __name__ == "__main__":
    (Path(__file__).parent / "effects.md").write_text(page())
