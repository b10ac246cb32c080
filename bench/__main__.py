"""`make bench`, or `python -m bench NAME…` for some."""

import importlib
import sys

ALL = (
    "kernel",
    "footprint",
    "ingest",
    "formats",
    "malformed",
    "hostile",
    "openapi",
    "serving",
    "registry",
    "tampering",
    "kills",
    "linearizable",
    "growth",
    "pages",
    "load",
    "scaled",
    "capacity",
    "idle",
    "spreading",
    "diagnosis",
    "own_robot",
    "own_simulator",
    "spoilt",
    "robots",
    "drift",
    "excitation",
    "splitting",
    "processors",
    "noises",
    "nuisances",
    "machines",
    "agreement",
    "continual",
)

for name in sys.argv[1:] or ALL:
    importlib.import_module(f"bench.{name}").main()
