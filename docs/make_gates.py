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

`trueup gate PLANT CANDIDATE --rules gate.json` declares it and judges. Every rule must pass. Without a file the plant's gate in force
judges, or where there is none the default: `rollout_improves` and `one_step_no_worse` as they stand below, over every window of the
plant's own horizon.

- **What is scored**: held-out episodes (the roles validation and retained) that no fit has seen. The candidate and the incumbent, which
  is what serves at that moment, roll out from the start of each window over `horizon_s` on commands alone. `windows` is `every`, or
  `first` for the first of each episode alone, which says nothing of what comes after it.
- **The error** of a rollout is the mean over its samples of the Euclidean distance of what is predicted from what was observed, each
  channel in units of the `scale` that plant.json declares for it. (A diagnosis counts in each channel's own standard deviations instead:
  its figures and a gate's are not to be compared.) A figure that is not a number never passes.
- `conditions` make the cells of `retained_conditions`.
- **Every verdict carries an interval**: 95 % of the ratio of both errors, by a paired bootstrap over blocks of neighbouring windows, or
  over episodes where each has one window, or over paired runs in closed loop. A rule with `"require": "bound"` must stay within its bound
  at the interval's upper end, not at the mean.
- `trueup gate … --scales` also says how the verdict moves when the reporting scale of each channel is halved and doubled. It should not
  hang on a unit of reporting.

## A gate cannot be shopped for

- *Declare a gate that nothing can fail.* Refused (`vacuous-gate`): an equal candidate must be rejected, and one ten times as wrong must
  fail every rule. Before each trial the incumbent itself, a copy of it and the incumbent with noise added are judged, and stand in the
  decision. With `"vacuous": true` and a reason in `because` (`--vacuous --because REASON`) it is taken, and told.
- *Declare another gate once a candidate was judged.* Refused (`gate-follows`), unless it names the gate in force in `follows` and says
  why in `because` (`--because REASON`). What is looser in it is worked out and told.
- *Judge by an older gate.* Refused (`gate-superseded`): the last one declared judges.
- *Promote a candidate that was rejected before.* Refused (`rejected-before`), unless every episode of the accepted decision came in after
  its gate was declared and after the rejection; or somebody else has approved it with a reason (`trueup approve PLANT DECISION --because
  REASON`). A policy with `"on_rejected": "forbid"` takes fresh episodes alone.
- *Pack the same model anew, or register the plant anew.* Episodes are known by their bytes in all plants of a project, and a model by the
  errors that it makes on them: the same holds.
- *Judge on the same episodes again and again.* Each is good for `held_out_uses` trials, 20 unless the gate says otherwise, counted over
  all plants; then it is spent.

Every decision carries in `known` how its candidate and its episodes had been judged when its gate was declared, and in `uses` how often
each episode had been used. The decision's page, `trueup gate`, `trueup replay` and the JSON (`disclosure`) say it in one sentence;
`trueup audit verify` works it out from the log again, and finds a decision that says something else.

What this does not keep: whoever records a new episode for each attempt may go on until one passes, and every attempt is told. Recordings
are what was sent; the log says whose token sent them. Two names that an admin gave to one person are two people here.

## Rules

| rule | passes if | bounds |
|---|---|---|
"""


def page() -> str:
    """The page."""
    rows = []
    for name, kind in sorted(rules().items()):
        bounds = ", ".join(f"`{f.name}` = {f.default:g}" for f in fields(kind) if f.default is not MISSING and f.name != "require")
        rows.append(f"| `{name}` | {' '.join((inspect.getdoc(kind) or '').split())} | {bounds} |")
    return HEAD + "\n".join(rows) + "\n"


if __name__ == "__main__":
    (Path(__file__).parent / "gates.md").write_text(page())
