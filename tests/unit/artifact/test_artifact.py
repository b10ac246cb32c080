"""Artifacts: data only, the same bits back, and no byte may be off."""

import json

import numpy as np
import pytest

from tests.support.made import plant_document
from trueup.artifact.arrays import arrays_from_bytes, arrays_to_bytes
from trueup.artifact.artifact import Artifact, pack, unpack
from trueup.canonical import NotCanonical, canonical_bytes, digest_of
from trueup.errors import BadArtifact
from trueup.model.plant import Plant
from trueup.model.predictor import LinearMap, Nominal, Residual

PLANT = Plant.from_document(plant_document())
RESIDUAL = Residual(
    PLANT, LinearMap(("q", "v", "1"), np.random.default_rng(0).normal(scale=0.01, size=(3, 2)))
)
ARTIFACT = pack(RESIDUAL, {"origin": "test"})


def test_the_same_predictor_and_provenance_have_the_same_name():
    assert pack(RESIDUAL, {"origin": "test"}) == ARTIFACT
    assert pack(RESIDUAL, {"origin": "elsewhere"}).digest != ARTIFACT.digest


def test_it_comes_back_bit_for_bit():
    back = unpack(ARTIFACT, ARTIFACT.digest)
    assert isinstance(back, Residual)
    assert back.map.weights.tobytes() == RESIDUAL.map.weights.tobytes()


def test_another_digest_is_refused():
    with pytest.raises(BadArtifact):
        unpack(ARTIFACT, "0" * 64)


@pytest.mark.parametrize("at", range(0, len(ARTIFACT.arrays), 7))
def test_a_flipped_bit_of_the_arrays_is_refused(at):
    spoiled = bytearray(ARTIFACT.arrays)
    spoiled[at] ^= 1
    with pytest.raises(BadArtifact):
        unpack(Artifact(ARTIFACT.manifest, bytes(spoiled)), ARTIFACT.digest)


@pytest.mark.parametrize("at", range(0, len(ARTIFACT.manifest), 41))
def test_a_flipped_bit_of_the_manifest_is_refused(at):
    spoiled = bytearray(ARTIFACT.manifest)
    spoiled[at] ^= 1
    with pytest.raises(BadArtifact):
        unpack(Artifact(bytes(spoiled), ARTIFACT.arrays), ARTIFACT.digest)


def test_missing_arrays_are_refused():
    with pytest.raises(BadArtifact):
        unpack(Artifact(ARTIFACT.manifest, b""))


def remade(change) -> Artifact:
    document = json.loads(ARTIFACT.manifest)
    change(document)
    return Artifact(canonical_bytes(document), ARTIFACT.arrays)


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d.update(kind="pickle"),
        lambda d: d.update(kind="nominal", arrays=None),
        lambda d: d["probe"]["after"][0].__setitem__(0, 9.0),
        lambda d: d["probe"].pop("issued"),
        lambda d: d["predictor"].update(features=["q", "v"]),
        lambda d: d["predictor"].update(features=["q", "v", "__class__"]),
        lambda d: d["plant"].update(sha256="0" * 64),
        lambda d: d["plant"]["document"]["nominal"]["parameters"].update(k=2.0),
        lambda d: d.pop("predictor"),
        lambda d: d.update(schema="trueup.artifact/9"),
    ],
)
def test_a_manifest_that_was_made_to_lie_is_refused_whatever_its_digest(change):
    with pytest.raises(BadArtifact):
        unpack(remade(change))


@pytest.mark.parametrize(
    "manifest",
    [b"", b"{", b"[]", b'{"schema":"trueup.artifact/1"} ', b"\x80\x04K\x01.", b"[" * 100_000],
)
def test_what_is_no_manifest_is_refused(manifest):
    with pytest.raises(BadArtifact):
        unpack(Artifact(manifest, b""))


def test_strided_and_fortran_ordered_arrays_survive():
    array = np.arange(24.0).reshape(4, 6)
    for given in (array.T, array[:, ::2], np.asfortranarray(array), array[::-1]):
        back = arrays_from_bytes(arrays_to_bytes({"a": given}))["a"]
        assert np.array_equal(back, given)


def test_array_bytes_do_not_depend_on_the_order_of_names():
    a, b = np.ones(3), np.zeros((2, 2))
    assert arrays_to_bytes({"a": a, "b": b}) == arrays_to_bytes({"b": b, "a": a})


def test_a_nominal_model_needs_no_arrays():
    made = pack(Nominal(PLANT), {})
    assert made.arrays == b""
    assert unpack(made).kind == "nominal"


@pytest.mark.parametrize(
    "value", [float("nan"), float("inf"), 2**53 + 1, 10**22, {"a": -float("inf")}]
)
def test_what_has_no_canonical_form_is_refused(value):
    with pytest.raises(NotCanonical):
        digest_of(value)


def test_canonical_bytes_follow_rfc_8785():
    assert (
        canonical_bytes({"b": [1e21, -0.0, 1e-7, 333333333.33333329], "a": "€\u0007"})
        == '{"a":"€\\u0007","b":[1e+21,0,1e-7,333333333.3333333]}'.encode()
    )


@pytest.mark.parametrize(
    "value", [1e17, 2.0**53, 123456789012345680000.0, -1e20, 1e21, 5e-324, {"a": [1e18, 1]}]
)
def test_canonical_bytes_are_read_back_as_themselves(value):
    written = canonical_bytes(value)
    assert canonical_bytes(json.loads(written)) == written
