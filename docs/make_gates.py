"""Write gates.md from the rules themselves."""

import inspect
from dataclasses import MISSING, fields
from pathlib import Path

from trueup.gate.rule import rules

HEAD = """# Gates

A gate declares the criteria for a candidate before any candidate is scored. It is identified by
its digest and cannot be changed. A decision contains every figure, so that anybody can
[recompute](audit.md) the decision.

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

`trueup gate PLANT CANDIDATE --rules gate.json` declares it and judges. Every rule must pass.
Without a file the gate in force for the plant is used or, if there is none, the default:
`rollout_improves` and `one_step_no_worse` as they stand below, over every window of the plant's own
horizon.

- **What is scored**: held-out episodes (the roles validation and retained). One whose samples are
  also in an adaptation episode is refused, because a fit may have used them. The candidate and the
  incumbent (the version that serves at that moment) roll out from the start of each window over
  `horizon_s` on commands alone. `windows` is `every`, or `first` for the first of each episode
  only, which says nothing about the rest of the episode.
- **The error** of a rollout is the mean over its samples of the Euclidean distance of what is
  predicted from what was observed, each channel in units of the `scale` that plant.json declares
  for it. (A diagnosis counts in each channel's own standard deviations instead: its figures and a
  gate's are not to be compared.) A figure that is not a number never passes.
- `conditions` make the cells of `retained_conditions`.
- **Every verdict carries a 95 % confidence interval** of the candidate's error divided by the
  incumbent's, by a paired bootstrap over blocks of neighbouring windows, or over episodes where
  each has one window, or over paired runs in closed loop. A rule with `"require": "bound"` must
  stay within its bound at the interval's upper end, not at the mean.
- `trueup gate … --scales` also says how the verdict moves when the reporting scale of each channel
  is halved and doubled. The verdict should not depend on a unit of reporting.

## Protection against choosing the gate or the episodes afterwards

- *Declare a gate that nothing can fail.* Refused (`vacuous-gate`): an equal candidate must be
  rejected, and one ten times as wrong must fail every rule. Before each trial the incumbent itself,
  a copy of it and the incumbent with added noise are judged and recorded in the decision. A
  gate with `"vacuous": true` and a reason in `because` (`--vacuous --because REASON`) is accepted
  in spite of this. Its decisions then state that the gate accepted one of these controls.
- *Declare another gate once a candidate was judged, or while one is.* Refused (`gate-follows`),
  unless it names the gate in force in `follows` and says why in `because` (`--because REASON`).
  The service determines where it is looser than any earlier gate, and reports this.
- *Judge by an older gate.* Refused (`gate-superseded`): the last one declared judges.
- *Promote a candidate that was rejected before.* Refused (`rejected-before`), unless every episode
  of the accepted decision came in after its gate was declared and after the rejection, with samples
  of its own; or somebody else has approved it with a reason (`trueup approve PLANT DECISION
  --because REASON`). A policy with `"on_rejected": "forbid"` takes fresh episodes alone.
  A rejection says whether more recordings could settle it: where the 95 % interval of the ratio of
  errors includes the bound, chance in the choice of recordings may have decided. Upload held-out
  recordings and judge on these alone: `trueup gate PLANT CANDIDATE --episode DIGEST`, or the button
  on the page of the decision.
- *Pack the same model anew, or nudge its numbers.* The newest twenty candidates of the plant that
  were rejected, or still wait, are scored beside each new one, on its episodes and over its
  horizon. One whose errors differ by less than 1 % in every episode is the same model: the decision
  says so, and the new candidate is treated like the rejected one.
- *Register the plant again, even in another project.* On the same episodes a model is recognised by
  its errors, so the same rule applies.
- *Send the same recording as another file.* An episode is known by its samples: other metadata,
  another encoding or another clock offset does not make it fresh, and its use count continues.
- *Judge repeatedly on the same episodes, or on a selection.* Each episode can be used for
  `held_out_uses` trials, 20 unless the gate says otherwise, counted over all plants; then it is
  spent. The decision states how many held-out episodes it used and how many existed, how many
  decisions on other candidates used them since the gate was declared, and how many comparisons
  showed errors on them (`selection`).

Every decision records:

- `known`: how its candidate and its episodes had been judged when its gate was declared;
- `uses`: how often each episode has been used, including this trial;
- `selection`: the use of the held-out episodes, as listed above;
- `figures.beside`: the comparison with rejected and waiting candidates, as listed above.

The decision's page, `trueup gate`, `trueup replay` and the JSON (`disclosure`) state this in a few
sentences. `trueup audit verify` derives these records from the log again, and reports a decision
that differs. For a plant that was imported from another registry it cannot do this, because the
earlier history is not in this log; the page and the command still show the records.

What this does not prevent:

- Somebody can record a new episode for each attempt until one passes; every attempt is reported.
  Recordings are taken as sent, and the log says whose token sent them: a recording that was cut in
  two, or changed in one sample, counts as a different recording.
- A model whose errors differ by more than 1 % is another candidate. So is one that somebody tuned
  elsewhere on a copy of the held-out episodes, which the service cannot detect.
- If an admin gives one person two names, they count as two people.
- A channel may be moved back to a version that has served, even if a later decision rejected it.

## Rules

| rule | passes if | bounds |
|---|---|---|
"""


def page() -> str:
    """The page."""
    rows = []
    for name, kind in sorted(rules().items()):
        bounds = ", ".join(
            f"`{f.name}` = {f.default:g}"
            for f in fields(kind)
            if f.default is not MISSING and f.name != "require"
        )
        rows.append(f"| `{name}` | {' '.join((inspect.getdoc(kind) or '').split())} | {bounds} |")
    return HEAD + "\n".join(rows) + "\n"


if __name__ == "__main__":
    (Path(__file__).parent / "gates.md").write_text(page())
