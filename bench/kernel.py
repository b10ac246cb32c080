"""The compiled rollout beside the same loop in C, and the command's start once its kernels are
cached."""

from __future__ import annotations

import ctypes
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from bench.report import Figure, show
from bench.servers import ROOT
from trueup.model import family_kernel
from trueup.model.family import families

VECTORS, SAMPLES, ROUNDS = 256, 2000, 25
ACCELERATION = {
    "oscillator": "-k*q-c*v+b*u",
    "pendulum": "-k*sin(q)-c*v+b*u",
    "inertia": "-c*v+b*u",
}
C = """
#include <math.h>
void rollout(long vectors, long samples, const double *K, const double *C, const double *B,
        double q0, double v0,
             const double *applied, const double *h_s, const long *steps, double *out) {
  for (long i = 0; i < vectors; i++) {
    double q = q0, v = v0, k = K[i], c = C[i], b = B[i];
    (void)k;
    for (long t = 0; t < samples; t++) {
      out[(2 * t) * vectors + i] = q; out[(2 * t + 1) * vectors + i] = v;
      double u = applied[t], h = h_s[t];
      for (long s = 0; s < steps[t]; s++) { v = v + h * (ACCELERATION); q = q + h * v; }
    }
  }
}
void blocked(long vectors, long samples, const double *K, const double *C, const double *B,
        double q0, double v0,
             const double *applied, const double *h_s, const long *steps, double *out) {
  for (long first = 0; first < vectors; first += 16) {
    double Q[16], V[16], k_[16], c_[16], b_[16];
    for (int l = 0; l < 16; l++) { Q[l] = q0; V[l] = v0; k_[l] = K[first + l];
        c_[l] = C[first + l]; b_[l] = B[first + l]; }
    for (long t = 0; t < samples; t++) {
      double *to_q = out + (2 * t) * vectors + first, *to_v = out + (2 * t + 1) * vectors + first;
      for (int l = 0; l < 16; l++) { to_q[l] = Q[l]; to_v[l] = V[l]; }
      double u = applied[t], h = h_s[t];
      for (long s = 0; s < steps[t]; s++)
        for (int l = 0; l < 16; l++) {
          double q = Q[l], v = V[l], k = k_[l], c = c_[l], b = b_[l];
          (void)k;
          v = v + h * (ACCELERATION); V[l] = v; Q[l] = q + h * v;
        }
    }
  }
}
"""


def main() -> None:
    figures = []
    with tempfile.TemporaryDirectory() as folder:
        for name in ACCELERATION:
            figures += _one(name, Path(folder))
    figures.append(_start())
    show(
        (
            "kernel: 256 parameter vectors x 2000 steps, best of 25, interleaved; C is gcc -O3 "
            "-march=native on one core"
        ),
        figures,
    )


def _one(name: str, folder: Path) -> list[Figure]:
    rng, family = np.random.default_rng(0), families()[name]
    parameters = rng.uniform(0.5, 1.5, (VECTORS, 3))[:, 3 - len(family.params) :]
    arguments = (
        rng.normal(size=(1, 2)),
        rng.uniform(-1, 1, (1, SAMPLES)),
        np.full((1, SAMPLES), 0.05),
        np.ones((1, SAMPLES), np.int64),
    )
    library = _compile(name, folder)
    columns = np.ascontiguousarray(
        np.hstack([np.zeros((VECTORS, 3 - parameters.shape[1])), parameters]).T
    )
    out, padded = np.empty((SAMPLES, 2, VECTORS)), np.ascontiguousarray(parameters.T)
    ours = np.empty((1, SAMPLES, 2, VECTORS))

    def in_c(function: str) -> None:
        pointers = [ctypes.c_void_p(a.ctypes.data) for a in (*columns,)]
        state = [ctypes.c_double(x) for x in arguments[0][0]]
        rest = [ctypes.c_void_p(a.ctypes.data) for a in (*arguments[1:], out)]
        getattr(library, function)(
            ctypes.c_long(VECTORS), ctypes.c_long(SAMPLES), *pointers, *state, *rest
        )

    run = family_kernel.kernel(family, family_kernel.BLOCK)
    tries = {
        "c": lambda: in_c("rollout"),
        "c in blocks": lambda: in_c("blocked"),
        "one core": lambda: run(padded, *arguments, ours, 0, VECTORS),
        "whole call, one core": lambda: _whole(family, parameters, arguments, 1),
        "whole call, both cores": lambda: _whole(family, parameters, arguments, 2),
    }
    best = dict.fromkeys(tries, np.inf)
    for _ in range(ROUNDS):
        for what, act in tries.items():
            began = time.perf_counter()
            act()
            best[what] = min(best[what], time.perf_counter() - began)
    in_c("rollout")
    assert np.allclose(out, ours[0], rtol=1e-9, atol=1e-9)
    ns = {what: 1e9 * s / (VECTORS * SAMPLES) for what, s in best.items()}
    return [
        Figure(
            f"{name}: one core, beside the same loop in C",
            f"{ns['c'] / ns['one core']:.2f} x",
            ">= 1 x",
            ns["c"] >= ns["one core"],
        ),
        Figure(
            f"{name}: one core, beside C in the same blocks",
            f"{ns['c in blocks'] / ns['one core']:.2f} x",
        ),
        Figure(
            f"{name}: whole call on both cores, beside one core",
            f"{ns['whole call, one core'] / ns['whole call, both cores']:.2f} x",
            "> 1 x",
            ns["whole call, both cores"] < ns["whole call, one core"],
        ),
        Figure(f"{name}: time", f"{ns['one core']:.2f} ns a lane-step"),
    ]


def _whole(family, parameters, arguments, cores):
    """The call as fits make it, allocation included, on so many cores."""
    family_kernel.cores = lambda: cores
    return family_kernel.rollout(family, parameters, *arguments)


def _compile(name: str, folder: Path) -> ctypes.CDLL:
    source, made = folder / f"{name}.c", folder / f"{name}.so"
    source.write_text(C.replace("ACCELERATION", ACCELERATION[name]))
    subprocess.run(
        ["gcc", "-O3", "-march=native", "-shared", "-fPIC", str(source), "-o", str(made), "-lm"],
        check=True,
    )
    return ctypes.CDLL(str(made))


def _start() -> Figure:
    """The whole command with compiled rollouts: a prediction of a real episode."""
    with tempfile.TemporaryDirectory() as folder:
        model = Path(folder) / "model"
        model.mkdir()
        code = (
            "import json,sys,pathlib;from trueup.model.plant import Plant;from "
            "trueup.artifact.artifact import nominal_artifact;"
            f"p=Plant.from_document(json.loads(pathlib.Path('examples/emps/plant.json').read_text()));pathlib.Path({str(model)!r},'manifest.json').write_bytes(nominal_artifact(p).manifest)"
        )
        subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)
        command = [
            sys.executable,
            "-m",
            "trueup_cli.main",
            "predict",
            "--model",
            str(model),
            "--episode",
            "examples/emps/3-validation.mcap",
            "--horizon",
            "1",
            "--out",
            f"{folder}/p.csv",
        ]
        seconds = []
        for _ in range(5):
            began = time.perf_counter()
            subprocess.run(command, check=True, cwd=ROOT)
            seconds.append(time.perf_counter() - began)
    median = sorted(seconds)[2]
    return Figure(
        "`trueup predict` from start to end, kernels cached, median of 5",
        f"{median:.2f} s",
        "< 2 s",
        median < 2.0,
    )
