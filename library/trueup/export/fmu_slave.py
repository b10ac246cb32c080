"""What runs inside a functional mock-up unit: the model's ONNX graph, a period at a time.

This file is copied into the unit beside `model.onnx`, and needs numpy and onnxruntime where the
unit is run. Inputs are the commands, outputs the observations, parameters where each joint starts.
A communication step is one period or several whole ones. Source: FMI 3.0, co-simulation.
"""

from __future__ import annotations

import json
import re
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
from pythonfmu3 import Float64, Fmi3Causality, Fmi3Slave, Fmi3Variability
from pythonfmu3 import Fmi3Status as Status
from pythonfmu3 import Fmi3StepResult as StepResult

WHOLE = 1e-6  # of a period: what a step may be off
MODEL = "model.onnx"


def identifier(name: str) -> str:
    """Returns a name as C has it: letters, digits and underscores, and no digit first."""
    plain = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_")
    return plain if plain[:1].isalpha() else f"x{plain}"


class TrueupModel(Fmi3Slave):  # type: ignore[misc]
    """A corrected model of a machine, written by trueup."""

    def __init__(self, **given: Any) -> None:
        super().__init__(**given)
        self._session = onnxruntime.InferenceSession(str(Path(self.resources) / MODEL))
        known = self._session.get_modelmeta().custom_metadata_map
        self._period_s, self._states = float(known["period_s"]), json.loads(known["state"])
        answer = json.loads(known.get("diagnosis", "{}")).get("answer", "")
        made = f"{known['plant']}, artifact {known['artifact']}, written by trueup"
        self.description = f"{made}. {answer}" if answer else made
        self.modelName = identifier(known["plant"])
        self._state: Any = None
        inputs, outputs = (json.loads(known[name]) for name in ("command", "observation"))
        self._limits = np.array([c["limits"] for c in inputs], float)
        self._commands, self._seen = np.zeros(len(inputs)), np.zeros(len(outputs))
        self._held = [c["of"] for c in inputs]  # by which a state's beginning names them
        starts = [state["name"] for state in self._states if list(state["of"]) == [state["name"]]]
        self._starts = dict.fromkeys(starts, 0.0)
        time = Fmi3Causality.independent, Fmi3Variability.continuous
        self.time = 0.0
        self.register_variable(Float64("time", causality=time[0], variability=time[1]))
        for i, command in enumerate(inputs):
            self._add(command, Fmi3Causality.input, self._commands, i)
        for i, observation in enumerate(outputs):
            self._add(observation, Fmi3Causality.output, self._seen, i)
        for name in self._starts:
            start = {"name": f"start_{name}", "unit": ""}
            self._add(start, Fmi3Causality.parameter, self._starts, name)

    def _add(self, channel: dict[str, Any], causality: Any, kept: Any, at: Any) -> None:
        """Registers a number that is kept in an array or a dictionary."""
        is_parameter = causality == Fmi3Causality.parameter
        name, taken = identifier(channel["name"]), {v.name for v in self.vars.values()}
        while name in taken:
            name += "_"
        self.register_variable(
            Float64(
                name,
                causality=causality,
                variability=Fmi3Variability.fixed if is_parameter else Fmi3Variability.continuous,
                description=f"{channel['name']} [{channel['unit']}]".removesuffix(" []"),
                getter=lambda: float(kept[at]),
                setter=partial(kept.__setitem__, at),
            )
        )

    def exit_initialization_mode(self) -> None:
        """Begins at the start's positions and velocities, under the commands given so far."""
        held = np.clip(self._commands, *self._limits.T)
        begins = {**self._starts, **dict(zip(self._held, held, strict=True))}
        self._state = np.array(
            [[sum(f * begins.get(of, 0.0) for of, f in s["of"].items()) for s in self._states]]
        )
        self._seen[:], _ = self._run()

    def do_step(self, current_time: float, step_size: float) -> Any:
        """Moves on by whole periods."""
        count = round(step_size / self._period_s)
        if count < 1 or abs(step_size - count * self._period_s) > WHOLE * self._period_s:
            self.log(f"a step is a whole number of periods of {self._period_s} s", Status.error)
            return StepResult(status=Status.error)
        for _ in range(count):
            _, self._state = self._run()
        self._seen[:], _ = self._run()
        self.time = current_time + step_size
        return StepResult()

    def _run(self) -> tuple[Any, Any]:
        """What is observed, and the next state."""
        seen, after = self._session.run(
            None, {"state": self._state, "command": self._commands[None]}
        )
        return seen[0], after
