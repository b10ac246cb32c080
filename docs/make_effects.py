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

## An effect of your own

An effect that the catalogue does not have is one file as well, wherever it lies:
[`examples/own-effect/magnetic_saturation.py`](../examples/own-effect/magnetic_saturation.py) is
one. It takes part in every search beside the others.

- In Python, `trueup.load_effect("magnetic_saturation.py")` first of all: effects are compiled
  together, so it comes before any case or model.
- For the command, `TRUEUP_EFFECTS` names files, as `PATH` does folders.
- A package brings effects by entry points of the group `trueup.effects`, each of which names a
  class. This is the way for servers and workers.

`trueup effects FILE --laws` checks it by the laws that every effect obeys: it vanishes at its null
bit for bit, every number of it matters, compiled and uncompiled it gives the same, it looks only
back, a simulated value is found again. Its model names the file by its SHA-256, and loads only
where that very file is at hand. The first rollout with a new set of effects compiles them, once.
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
