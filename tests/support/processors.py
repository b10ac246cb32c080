"""Diagnoses of the same recordings as on other processors, and the differences between them.

The environment of a child process chooses its BLAS kernels, the vector instructions of numpy and of
the C library, and the code of the compiled rollouts. `python -m tests.support.processors OUT CASE…`
diagnoses case folders and writes the reports to a file. If one of the folders holds a model, it is
judged on the first case.
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
# by how much processors may differ: shares of a half-width, of a width, of a held-out error
MOVED, WIDTH, ERROR = 0.02, 0.02, 0.01


PROBE = """
import hashlib, math, numpy
matrix = numpy.random.default_rng(0).normal(size=(200, 200))
sines = numpy.array([math.sin(x) * math.exp(x) for x in matrix.ravel()])
print(*(hashlib.sha256(x.tobytes()).hexdigest() for x in (matrix @ matrix, sines)))
"""


def environment(variant: Mapping[str, str]) -> dict[str, str]:
    """The environment of a child process that computes as a variant does."""
    return {k: v for k, v in os.environ.items() if not k.startswith(SET_BY_US)} | dict(variant)


def bits(variant: Mapping[str, str]) -> tuple[str, str]:
    """Digests of a product of matrices and of sines and exponentials, as a variant computes
    them."""
    command, env = [sys.executable, "-c", PROBE], environment(variant)
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=True)
    product, sines = done.stdout.split()
    return product, sines


def start(variant: Mapping[str, str], out: Path, cases: Sequence[Path]) -> subprocess.Popen[str]:
    """Starts a child process that diagnoses cases in the environment of a variant."""
    env = environment(variant)
    command = [sys.executable, "-m", "tests.support.processors", str(out), *map(str, cases)]
    return subprocess.Popen(command, cwd=ROOT, env=env, text=True, stderr=subprocess.PIPE)


@dataclass(frozen=True)
class Difference:
    """How two reports of one case differ: whether their answers are equal, and the largest of each
    difference.
    """

    alike: bool
    moved: float
    width: float
    error: float

    @property
    def is_negligible(self) -> bool:
        """Whether the answers are equal and each difference is within its limit."""
        return self.alike and self.moved <= MOVED and self.width <= WIDTH and self.error <= ERROR


def difference(one: Mapping, other: Mapping) -> Difference:
    """Compares two reports of one case."""
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
    """Returns each estimate with its interval, by effect, joint and name."""
    estimates = {
        ("", "", name): (p["value"], *p["ci95"]) for name, p in report["parameters"].items()
    }
    for e in report["effects"]:
        estimates |= {
            (e["effect"], e.get("joint", ""), name): (x["value"], *x["ci95"])
            for name, x in e["estimate"].items()
        }
    return estimates


def processor() -> str:
    """Returns the name of this machine's processor."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    return next(
        (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")),
        platform.processor(),
    )


def judge_model(model: Path, case: Path) -> dict:
    """Returns a gate's decision on a corrected model against the nominal one, on one case."""
    from trueup.artifact.model import load
    from trueup.control import closed_loop, courses
    from trueup.diagnose.case import read_case
    from trueup.episode.role import Role
    from trueup.fit.score import EVERY, Scoring
    from trueup.gate.decision import Gate
    from trueup.gate.judge import judge, run_trial
    from trueup.gate.rule import rules
    from trueup.model.predictor import Nominal

    # a short run each way is enough to see another arithmetic
    closed_loop.SEEDS, courses.TICKS = 1, 50
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
    """Diagnoses the cases on the command line, and writes the reports."""
    from trueup.artifact.artifact import pack
    from trueup.diagnose.case import read_case
    from trueup.diagnose.diagnosis import diagnose

    out, *cases = map(Path, sys.argv[1:])
    reports = {}
    for case in cases:
        if (case / "manifest.json").is_file():  # a model, to be judged on the case that comes first
            reports["decision"] = judge_model(case, cases[0])
        else:
            plant, episodes = read_case(case)
            diagnosis = diagnose(plant, episodes)
            reports[f"{case.parent.parent.name}/{case.name}"] = dict(diagnosis.document)
            artifact = pack(diagnosis.predictor, {"origin": "diagnosis"})
            model = out.with_suffix("") / case.name
            model.mkdir(parents=True, exist_ok=True)
            (model / "manifest.json").write_bytes(artifact.manifest)
            (model / "arrays.safetensors").write_bytes(artifact.arrays)
        out.write_text(json.dumps(reports))


if __name__ == "__main__":
    main()
