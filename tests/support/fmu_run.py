"""Runs a functional mock-up unit by FMPy in a process of its own, for a unit brings its own Python:
`python fmu_run.py UNIT GIVEN.npz SEEN.npy`."""

import os
import sys

import fmpy
import numpy as np
from fmpy.fmi3 import FMU3Slave


def run(path, given):
    """Returns the outputs at each sample under commands; prints whether half a step is refused."""
    described = fmpy.read_model_description(path)
    at = {v.name: v.valueReference for v in described.modelVariables}
    unit = FMU3Slave(
        guid=described.guid,
        unzipDirectory=fmpy.extract(path),
        modelIdentifier=described.coSimulation.modelIdentifier,
        instanceName="one",
    )
    unit.instantiate()
    unit.enterInitializationMode()
    unit.setFloat64([at[name] for name in given["starts"]], list(given["start"]))
    inputs, outputs = ([at[name] for name in given[what]] for what in ("inputs", "outputs"))
    unit.setFloat64(inputs, list(given["issued"][0]))
    unit.exitInitializationMode()
    rows, period_s = [], float(given["period_s"])
    for i, command in enumerate(given["issued"]):
        rows.append(unit.getFloat64(outputs))
        unit.setFloat64(inputs, list(command))
        unit.doStep(i * period_s, period_s)
    try:
        unit.doStep(len(rows) * period_s, 0.5 * period_s)
    except fmpy.fmi1.FMICallException:
        print("refused")
    unit.freeInstance()
    return np.array(rows)


if __name__ == "__main__":
    np.save(sys.argv[3], run(sys.argv[1], np.load(sys.argv[2])))
    sys.stdout.flush()
    os._exit(0)  # the unit's own Python is taken down in no order: now and then that aborts
