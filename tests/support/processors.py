"""Diagnoses of the same recordings as other processors would make them, and by how much they
differ.

A child process takes the kernels of linear algebra, the vector instructions of numpy, those of the
C library and the code of the compiled rollouts from its environment. `python -m
tests.support.processors OUT CASE…` diagnoses case folders and writes the reports to a file; a
folder of a model among them is judged on the first case.
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parent.parent.parent
SET_BY_US = ("OPENBLAS", "NUMBA_CPU", "NPY_DISABLE", "GLIBC_TUNABLES")
NO_AVX512 = "AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL AVX512_SPR"
OLD_LIBC = "glibc.cpu.hwcaps=-AVX512F,-AVX2,-AVX2_Usable,-FMA,-FMA_Usable,-FMA4"
VARIANTS: Mapping[str, Mapping[str, str]] = {
    "as the machine is": {},
    "BLAS for Haswell": {"OPENBLAS_CORETYPE": "Haswell"},
    "BLAS for Nehalem": {"OPENBLAS_CORETYPE": "Nehalem"},
    "BLAS for SkylakeX": {"OPENBLAS_CORETYPE": "SkylakeX"},
    "BLAS for Sandybridge": {"OPENBLAS_CORETYPE": "Sandybridge"},
    "BLAS on one thread": {"OPENBLAS_NUM_THREADS": "1"},
    "BLAS on two threads": {"OPENBLAS_NUM_THREADS": "2"},
    "rollouts for any processor": {"NUMBA_CPU_NAME": "generic"},
    "numpy without AVX-512": {"NPY_DISABLE_CPU_FEATURES": NO_AVX512},
    "C library without FMA": {"GLIBC_TUNABLES": OLD_LIBC},
}
MOVED, WIDTH, ERROR = (
    0.02,
    0.02,
    0.01,
)  # of a half-width, of a width, of a held-out error: what two processors may differ by


def start(variant: Mapping[str, str], out: Path, cases: Sequence[Path]) -> subprocess.Popen[str]:
    """A child process of a variant that diagnoses cases."""
    env = {k: v for k, v in os.environ.items() if not k.startswith(SET_BY_US)} | dict(variant)
    command = [sys.executable, "-m", "tests.support.processors", str(out), *map(str, cases)]
    return subprocess.Popen(command, cwd=ROOT, env=env, text=True, stderr=subprocess.PIPE)


@dataclass(frozen=True)
class Difference:
    """By how much two reports of one case differ: whether they answer alike, and the largest of
    each difference."""

    alike: bool
    moved: float
    width: float
    error: float

    @property
    def met(self) -> bool:
        """Whether they are one report, but for what nobody would see."""
        return self.alike and self.moved <= MOVED and self.width <= WIDTH and self.error <= ERROR


def difference(one: Mapping, other: Mapping) -> Difference:
    """Of two reports."""
    ours, its = (_answer(report) for report in (one, other))
    here, there = (_estimates(report) for report in (one, other))
    shared = [(here[name], there[name]) for name in here.keys() & there.keys()]
    halves = [((b - a) / 2.0, (d - c) / 2.0, abs(x - y)) for (x, a, b), (y, c, d) in shared]
    moved = max((by / half if half else float(by > 0.0) for half, _, by in halves), default=0.0)
    width = max(
        (abs(second / half - 1.0) if half else float(second > 0.0) for half, second, _ in halves),
        default=0.0,
    )
    after = one["gap"]["after"], other["gap"]["after"]
    return Difference(
        ours == its and here.keys() == there.keys(),
        moved,
        width,
        abs(after[1] / after[0] - 1.0) if after[0] else 0.0,
    )


def _answer(report: Mapping) -> tuple:
    named = [(e["effect"], e.get("joint")) for e in report["effects"]]
    others = sorted(json.dumps(a, sort_keys=True) for a in report["indistinguishable"])
    return report["verdict"], named, others


def _estimates(report: Mapping) -> dict[tuple, tuple[float, float, float]]:
    """Each estimate with its interval, by effect, joint and name."""
    found = {("", "", name): (p["value"], *p["ci95"]) for name, p in report["parameters"].items()}
    for e in report["effects"]:
        found |= {
            (e["effect"], e.get("joint", ""), name): (x["value"], *x["ci95"])
            for name, x in e["estimate"].items()
        }
    return found


def processor() -> str:
    """What this machine calls its own."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    return next(
        (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")),
        platform.processor(),
    )


def judged(model: Path, case: Path) -> dict:
    """The decision of a gate on a corrected model against the nominal one, on a case's validation
    episodes."""
    from trueup.artifact.model import load
    from trueup.control import closed_loop
    from trueup.diagnose.case import read_case
    from trueup.episode.role import Role
    from trueup.fit.score import EVERY, Scoring
    from trueup.gate.decision import Gate
    from trueup.gate.judge import judge, run_trial
    from trueup.gate.rule import rules
    from trueup.model.predictor import Nominal

    closed_loop.SEEDS = 1  # a run each way is enough to see another arithmetic
    plant, episodes = read_case(case)
    held_out = [e for e in episodes if e.role is Role.VALIDATION]
    gate = Gate(
        (rules()["rollout_improves"](0.98), rules()["tracking_no_worse"](1.05)),
        Scoring(plant.horizon_s, EVERY),
    )
    trial = run_trial(gate, load(model).predictor, Nominal(plant), held_out).trial
    return judge(
        gate, trial, plant="plant", candidate="candidate", incumbent="incumbent", generation=1
    ).document()


def main() -> None:
    from trueup.artifact.artifact import pack
    from trueup.diagnose.case import read_case
    from trueup.diagnose.diagnosis import diagnose

    out, *cases = map(Path, sys.argv[1:])
    found = {}
    for case in cases:
        if (case / "manifest.json").is_file():  # a model, to be judged on the case that comes first
            found["decision"] = judged(case, cases[0])
        else:
            plant, episodes = read_case(case)
            made = diagnose(plant, episodes)
            found[f"{case.parent.parent.name}/{case.name}"] = dict(made.document)
            artifact = pack(made.predictor, {"origin": "diagnosis"})
            model = out.with_suffix("") / case.name
            model.mkdir(parents=True, exist_ok=True)
            (model / "manifest.json").write_bytes(artifact.manifest)
            (model / "arrays.safetensors").write_bytes(artifact.arrays)
        out.write_text(json.dumps(found))


if __name__ == "__main__":
    main()
