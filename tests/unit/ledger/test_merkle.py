"""The tree, its proofs and its notes, against what golang.org/x/mod makes of the same entries
(tests/golden/tlog/main.go)."""

import base64
import hashlib
import json
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from hypothesis import given
from hypothesis import strategies as st

from trueup.ledger import merkle
from trueup.ledger.signed_note import BadKey, Signer
from trueup_client import ed25519, proof
from trueup_client.problem import NotSigned
from trueup_client.proof import Checkpoint, Key

GOLDEN = json.loads((Path(__file__).parents[2] / "golden" / "tlog" / "vectors.json").read_text())
SIGNER, KEY = Signer.from_text(GOLDEN["signer"]), Key.from_text(GOLDEN["verifier"])


def b64(text):
    return base64.b64decode(text)


def grown(size):
    tree, nodes = merkle.NOTHING, {}
    for i in range(size):
        tree, completed = tree.append(merkle.leaf_hash(b"entry %d" % i))
        nodes |= completed
    return tree, nodes


def test_roots_are_those_of_the_go_module():
    assert [grown(n + 1)[0].root() for n in range(len(GOLDEN["roots"]))] == [
        b64(r) for r in GOLDEN["roots"]
    ]


def test_proofs_are_those_of_the_go_module_and_verify():
    _, nodes = grown(len(GOLDEN["roots"]))
    roots = [b64(r) for r in GOLDEN["roots"]]
    for position, size, hashes in GOLDEN["inclusion"]:
        made = merkle.prove(merkle.inclusion(position, size), nodes)
        assert made == [b64(h) for h in hashes or []]
        assert proof.includes(roots[size - 1], size, position, nodes[0, position], made)
    for old, size, hashes in GOLDEN["consistency"]:
        made = merkle.prove(merkle.consistency(old, size), nodes)
        assert made == [b64(h) for h in hashes or []]
        assert proof.extends(old, roots[old - 1], size, roots[size - 1], made)


def test_the_empty_tree_has_the_hash_of_nothing():
    assert merkle.NOTHING.root() == hashlib.sha256(b"").digest()
    assert proof.extends(0, merkle.NOTHING.root(), 5, grown(5)[0].root(), [])


@given(st.integers(1, 300), st.data())
def test_a_tree_of_any_size_proves_every_leaf_and_no_other(size, data):
    tree, nodes = grown(size)
    position = data.draw(st.integers(0, size - 1))
    made = merkle.prove(merkle.inclusion(position, size), nodes)
    assert proof.includes(tree.root(), size, position, nodes[0, position], made)
    other = (
        data.draw(st.integers(0, size - 1).filter(lambda i: i != position)) if size > 1 else size
    )
    assert not proof.includes(tree.root(), size, other, nodes[0, position], made)
    assert not proof.includes(tree.root(), size, position, merkle.leaf_hash(b"forged"), made)
    if made:
        cut = data.draw(st.integers(0, len(made) - 1))
        assert not proof.includes(
            tree.root(), size, position, nodes[0, position], [*made[:cut], *made[cut + 1 :]]
        )
        assert not proof.includes(
            tree.root(),
            size,
            position,
            nodes[0, position],
            [*made[:cut], bytes(32), *made[cut + 1 :]],
        )


@given(st.integers(1, 300), st.data())
def test_a_tree_that_was_rewritten_extends_nothing(size, data):
    old = data.draw(st.integers(1, size))
    tree, nodes = grown(size)
    made = merkle.prove(merkle.consistency(old, size), nodes)
    before = grown(old)[0].root()
    assert proof.extends(old, before, size, tree.root(), made)
    rewritten = merkle.NOTHING
    for i in range(old):
        rewritten, _ = rewritten.append(
            merkle.leaf_hash(b"entry %d" % i if i != old // 2 else b"another")
        )
    assert not proof.extends(old, rewritten.root(), size, tree.root(), made)
    assert not proof.extends(size + 1, before, size, tree.root(), made)
    if made:
        assert not proof.extends(old, before, size, tree.root(), made[:-1])


def test_a_frontier_comes_back_from_its_bytes():
    tree, _ = grown(13)
    assert merkle.Frontier.from_bytes(13, tree.to_bytes()) == tree


def test_a_checkpoint_is_the_go_modules_note_byte_for_byte():
    root = b64(GOLDEN["roots"][-1])
    assert SIGNER.checkpoint(len(GOLDEN["roots"]), root) == GOLDEN["checkpoint"]
    assert SIGNER.verifier == GOLDEN["verifier"]
    assert SIGNER.text == GOLDEN["signer"]
    opened = Checkpoint.of(GOLDEN["checkpoint"], KEY)
    assert (opened.size, opened.root) == (len(GOLDEN["roots"]), root)


@pytest.mark.parametrize(
    "change", [("\n17\n", "\n18\n"), ("— log", "— lag"), ("\n\n", "\n"), ("robots\n", "robot\n")]
)
def test_a_note_that_was_changed_is_not_signed(change):
    with pytest.raises(NotSigned):
        Checkpoint.of(GOLDEN["checkpoint"].replace(*change), KEY)


def test_a_note_of_another_key_is_not_signed():
    with pytest.raises(NotSigned):
        Checkpoint.of(Signer(SIGNER.name, bytes(32)).checkpoint(3, bytes(32)), KEY)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "PRIVATE+KEY+a+b",
        GOLDEN["verifier"],
        GOLDEN["signer"].replace("robots", "robot"),
        "x" * 200,
    ],
)
def test_what_is_no_key_is_refused(text):
    with pytest.raises(BadKey):
        Signer.from_text(text)


def test_an_envelope_opens_with_its_key_as_its_type_alone():
    envelope = SIGNER.envelope("application/example", {"a": [1, "ä"]})
    assert KEY.payload(envelope, "application/example") == {"a": [1, "ä"]}
    assert envelope == SIGNER.envelope("application/example", {"a": [1, "ä"]})
    for forged in (
        envelope | {"payload": base64.b64encode(b'{"a":2}').decode()},
        envelope | {"payloadType": "application/other"},
        envelope | {"signatures": []},
        {},
    ):
        with pytest.raises(NotSigned):
            KEY.payload(forged, "application/example")
    with pytest.raises(NotSigned):
        KEY.payload(envelope, "application/other")


@given(
    st.binary(min_size=32, max_size=32),
    st.binary(max_size=200),
    st.integers(0, 63),
    st.integers(1, 255),
)
def test_signatures_hold_exactly_where_the_library_made_them(seed, message, at, flip):
    key = Ed25519PrivateKey.from_private_bytes(seed)
    public, signature = key.public_key().public_bytes_raw(), key.sign(message)
    assert ed25519.is_valid(public, signature, message)
    broken = bytearray(signature)
    broken[at] ^= flip
    assert not ed25519.is_valid(public, bytes(broken), message)
    assert not ed25519.is_valid(public, signature, message + b"!")


def test_the_first_vector_of_the_standard_holds():
    """RFC 8032, section 7.1, test 1."""
    public = bytes.fromhex("d75a980182b10ab7d54bfed3c964073a0ee172f3daa62325af021a68f707511a")
    signature = bytes.fromhex(
        "e5564300c360ac729086e2cc806e828a84877f1eb8e5d974d873e065224901555fb8821590a33bacc61e39701cf9b46bd25bf5f0595bbe24655141438e7a100b"
    )
    assert ed25519.is_valid(public, signature, b"")


def test_a_signature_with_a_number_beyond_the_order_is_refused():
    """RFC 8032, section 5.1.7: s is below the group's order, or the same signature would have many
    forms."""
    key = Ed25519PrivateKey.from_private_bytes(bytes(32))
    signature = key.sign(b"m")
    s = int.from_bytes(signature[32:], "little") + ed25519.ORDER
    assert not ed25519.is_valid(
        key.public_key().public_bytes_raw(), signature[:32] + s.to_bytes(32, "little"), b"m"
    )
