"""An effect in a file of one's own: found in recordings that have it, named in the artifact by its
file's SHA-256, and refused where that is not at hand."""

import ast
import hashlib
import json
import os
import subprocess
import sys

import pytest

from tests.support.service import ROOT
from trueup.errors import BadEffect
from trueup.model.effect import known_effect, load_effect

OWN = ROOT / "examples" / "own-effect" / "magnetic_saturation.py"
DIAGNOSE = """
import sys
import numpy as np
import trueup

trueup.load_effect(sys.argv[1])
H, K, C, B, SOFT = 0.01, 30.0, 2.0, 30.0, 1.5


def run(seed, samples=1500):
    rng = np.random.default_rng(seed)
    u = np.clip(np.convolve(rng.normal(size=samples), np.ones(40) / 9, "same"), -1.0, 1.0)
    states = np.zeros((samples, 2))
    for i in range(samples - 1):
        q, v = states[i]
        for _ in range(10):
            v += H / 10 * (B * u[i] / (1.0 + SOFT * abs(u[i])) - K * q - C * v)
            q += H / 10 * v
        states[i + 1] = q, v
    states += rng.normal(scale=1e-4, size=states.shape)
    return {"t_s": H * np.arange(samples), "q_rad": states[:, 0], "v_rad_s": states[:, 1],
            "u_nm": u}


case = trueup.Case.from_table(
    [run(seed) for seed in range(3)],
    plant=trueup.Oscillator(k=K, c=C, b=B, limits={"u": (-1.0, 1.0)}),
    stage="SIL",
)
answer = trueup.diagnose(case)
answer.save(sys.argv[2])
print(answer.verdict, [(e.effect, e.estimates["softness"].value) for e in answer.effects])
"""


def python(*arguments, **environment):
    return subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        env={**os.environ, **environment},
        check=False,
    )


@pytest.fixture(scope="module")
def diagnosed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("own")
    said = python("-c", DIAGNOSE, str(OWN), str(folder))
    assert said.returncode == 0, said.stderr
    return folder, said.stdout


@pytest.mark.slow
def test_it_is_found_in_recordings_that_have_it(diagnosed):
    folder, said = diagnosed
    verdict, _, effects = said.partition(" ")
    ((name, softness),) = ast.literal_eval(effects)
    assert (verdict, name) == ("effect", "magnetic_saturation")
    assert softness == pytest.approx(1.5, rel=0.02)
    manifest = json.loads((folder / "model" / "manifest.json").read_text())
    acting = json.dumps(manifest)
    assert hashlib.sha256(OWN.read_bytes()).hexdigest() in acting


@pytest.mark.slow
def test_its_model_is_refused_where_it_is_not_at_hand(diagnosed):
    folder, _ = diagnosed
    load = f"import trueup; print(trueup.load({str(folder / 'model')!r}).digest)"
    refused = python("-c", load)
    assert refused.returncode == 1
    assert "magnetic_saturation" in refused.stderr
    loaded = python("-c", f"import trueup; trueup.load_effect({str(OWN)!r}); {load}")
    assert loaded.returncode == 0, loaded.stderr
    changed = folder / "magnetic_saturation.py"
    changed.write_text(OWN.read_text().replace("softness * abs", "2.0 * softness * abs"))
    other = python("-c", f"import trueup; trueup.load_effect({str(changed)!r}); {load}")
    assert other.returncode == 1


@pytest.mark.slow
def test_the_laws_check_it_on_the_command_line(tmp_path):
    kept = python("-m", "trueup_cli.main", "effects", str(OWN), "--laws", "--json")
    assert kept.returncode == 0, kept.stderr
    own = next(e for e in json.loads(kept.stdout) if e["effect"] == "magnetic_saturation")
    assert own["laws"] == []
    lawless = tmp_path / "lawless.py"
    text = OWN.read_text().replace("return u / (", "return 0.999 * u / (")
    lawless.write_text(text.replace("magnetic_saturation", "lawless"))
    broken = python("-m", "trueup_cli.main", "effects", "--laws", TRUEUP_EFFECTS=str(lawless))
    assert broken.returncode == 1
    assert "vanishes at its null" in broken.stdout


def test_it_cannot_come_once_the_effects_are_compiled():
    known_effect("coulomb_friction", None)
    with pytest.raises(BadEffect, match="too late"):
        load_effect(OWN)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (("magnetic_saturation", "Magnetic"), "words in small letters"),
        (("    port = Port.COMMAND\n", ""), "no port"),
        (("    port =", "    zoomed = 'softness'\n    port ="), "now called grid_refined"),
        (("    Source:", "    From:"), "no line Source:"),
        (("((0.3,), (1.0,)", "((0.3, 1.0), (1.0,)"), "a value for each"),
        (("class MagneticSaturation(Effect)", "class MagneticSaturation"), "0 effects"),
        (("import Effect", "import Efect"), "cannot be run"),
        (('"magnetic_saturation"', '"coulomb_friction"'), "already"),
    ],
)
def test_a_file_that_breaks_a_rule_is_refused_with_it(tmp_path, change, why):
    (tmp_path / "own.py").write_text(OWN.read_text().replace(*change))
    said = python("-m", "trueup_cli.main", "effects", str(tmp_path / "own.py"))
    assert said.returncode == 1
    assert "bad-effect" in said.stderr
    assert why in said.stderr
