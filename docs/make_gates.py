"""Write gates.md from the rules themselves."""

import inspect
from dataclasses import MISSING, fields
from pathlib import Path

from trueup.gate.rule import rules

HEAD = """# Gates

A gate says, before anything is scored, what a candidate must show. Its digest freezes it; the decision holds every figure, so that
anybody can [recompute](audit.md) it.

```json
{
  "schema": "trueup.gate/1",
  "rules": [
    {"rule": "rollout_improves", "ratio": 0.98},
    {"rule": "one_step_no_worse", "slack": 1.0},
    {"rule": "no_worse_anywhere", "slack": 1.0}
  ],
  "scoring": {"horizon_s": 1.0, "windows": "every"},
  "conditions": ["payload"],
  "held_out_uses": 20
}
```

`trueup gate PLANT CANDIDATE --rules gate.json` declares it and judges. Every rule must pass. Without a file the default is declared:
`rollout_improves` and `one_step_no_worse`
as they stand below, over every window of the plant's own horizon.

- **What is scored**: held-out episodes (the roles validation and retained) that no fit has seen. The candidate and the incumbent, which
  is what serves at that moment, roll out from the start of
  each window over `horizon_s` on commands alone. `windows` is `every`, or `first` for the first of each episode alone, which says nothing
  of what comes after it.
- **The error** of a rollout is the mean over its samples of the Euclidean distance of what is predicted from what was observed, each
  channel in units of the `scale` that plant.json declares for it.
  (A diagnosis counts in each channel's own standard deviations instead: its figures and a gate's are not to be compared.) A figure that
  is not a number never passes.
- `conditions` make the cells of `retained_conditions`; after `held_out_uses` trials an episode is spent, for whoever chooses by it again
  and again fits to it.

| rule | passes if | bounds |
|---|---|---|
"""


def page() -> str:
    """The page."""
    rows = []
    for name, kind in sorted(rules().items()):
        bounds = ", ".join(f"`{f.name}` = {f.default:g}" for f in fields(kind) if f.default is not MISSING)
        rows.append(f"| `{name}` | {' '.join((inspect.getdoc(kind) or '').split())} | {bounds} |")
    return HEAD + "\n".join(rows) + "\n"


if __name__ == "__main__":
    (Path(__file__).parent / "gates.md").write_text(page())
