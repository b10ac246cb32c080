"""FMU: a model as a co-simulation unit of FMI 3.0, by the pythonfmu3 project.

The unit holds the model's ONNX graph and a few lines of Python that step it (`fmu_slave.py`), so it
runs wherever Python with numpy and onnxruntime is at hand.
"""

from __future__ import annotations

import importlib
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path

from trueup.artifact.onnx import to_onnx
from trueup.canonical import Json
from trueup.errors import NotInstalled
from trueup.model.predictor import Predictor

SLAVE, MODEL = "fmu_slave.py", "model.onnx"


def write_fmu(
    predictor: Predictor, artifact: str, to: Path, diagnosis: Mapping[str, Json] | None = None
) -> None:
    """Write a predictor as a unit; its description names the artifact by the digest `artifact`, and
    says what a `diagnosis` answers. Raises NotExportable of a simulator, NotInstalled without
    pythonfmu3, onnx or onnxruntime."""
    content = to_onnx(predictor, artifact, diagnosis)
    try:
        builder = importlib.import_module("pythonfmu3.builder")
        importlib.import_module("onnxruntime")
    except ImportError as error:
        raise NotInstalled(
            "writing a functional mock-up unit needs pythonfmu3 and onnxruntime",
            hint="Install them with `pip install 'trueup[fmu]'`.",
        ) from error
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / MODEL).write_bytes(content)
        shutil.copy(Path(__file__).with_name(SLAVE), folder)
        written = builder.FmuBuilder.build_FMU(
            Path(folder) / SLAVE, dest=Path(folder) / "out", project_files=[Path(folder) / MODEL]
        )
        shutil.move(written, to)
