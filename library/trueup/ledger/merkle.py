"""A Merkle tree over a log, as in RFC 9162 and RFC 6962: its stored nodes, its proofs, its root.

    leaf      SHA-256(0x00 || entry)
    node      SHA-256(0x01 || left || right)

A tree is kept as its perfect subtrees, named by level and position: node (level, position) covers
the 2^level leaves from position · 2^level on, and never changes once it is there. The roots of the
largest perfect subtrees, left to right, are the tree's frontier: appending and the root need no
more. `trueup_client.proof` verifies proofs without this module. Source: RFC 9162, sections 2.1.1 to
2.1.4.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

Node: TypeAlias = "tuple[int, int]"  # level and position of a perfect subtree
# for each hash of a proof, the perfect subtrees that it is made of, left to right
ProofPlan: TypeAlias = "list[list[Node]]"
HASH_BYTES = 32
POSITION_BITS = 48
EMPTY = hashlib.sha256(b"").digest()


def leaf_hash(entry: bytes) -> bytes:
    """The hash of an entry as a leaf."""
    return hashlib.sha256(b"\x00" + entry).digest()


def node_hash(left: bytes, right: bytes) -> bytes:
    """The hash of two subtrees as one."""
    return hashlib.sha256(b"\x01" + left + right).digest()


@dataclass(frozen=True, slots=True)
class Frontier:
    """A tree of `size` leaves by the roots of its largest perfect subtrees, left to right."""

    size: int
    hashes: tuple[bytes, ...]

    def append(self, leaf: bytes) -> tuple[Frontier, dict[Node, bytes]]:
        """The tree with one more leaf hash, and the perfect subtrees that it completes, the leaf
        itself among them."""
        hashes, completed, node = list(self.hashes), {(0, self.size): leaf}, leaf
        level, position = 0, self.size
        while position & 1:
            level, position, node = level + 1, position >> 1, node_hash(hashes.pop(), node)
            completed[level, position] = node
        return Frontier(self.size + 1, (*hashes, node)), completed

    def root(self) -> bytes:
        """The tree's hash."""
        return fold(self.hashes) if self.hashes else EMPTY

    def to_bytes(self) -> bytes:
        """The hashes, one after another."""
        return b"".join(self.hashes)

    @staticmethod
    def from_bytes(size: int, data: bytes) -> Frontier:
        """A tree of `size` leaves from what `to_bytes` returned."""
        return Frontier(
            size, tuple(data[i : i + HASH_BYTES] for i in range(0, len(data), HASH_BYTES))
        )


NOTHING = Frontier(0, ())


def number_of(node: Node) -> int:
    """The number under which a node is stored; the nodes of a level are neighbours."""
    return node[0] << POSITION_BITS | node[1]


def node_of(number: int) -> Node:
    """The node that is stored under a number."""
    return number >> POSITION_BITS, number & ((1 << POSITION_BITS) - 1)


def fold(hashes: Sequence[bytes]) -> bytes:
    """The hash of neighbouring perfect subtrees, ever smaller from left to right."""
    *rest, root = hashes
    for left in reversed(rest):
        root = node_hash(left, root)
    return root


def cover(low: int, high: int) -> list[Node]:
    """The largest perfect subtrees that make up the leaves from `low` to before `high`, where `low`
    begins one of them."""
    subtrees = []
    while low < high:
        level = (high - low).bit_length() - 1
        while low & ((1 << level) - 1):
            level -= 1
        subtrees.append((level, low >> level))
        low += 1 << level
    return subtrees


def inclusion(position: int, size: int) -> ProofPlan:
    """The proof that a leaf is in the tree of `size` leaves, from the leaf up."""
    return [cover(*part) for part in _inclusion(position, 0, size)]


def _inclusion(position: int, low: int, high: int) -> list[tuple[int, int]]:
    if high - low <= 1:
        return []
    middle = low + _split(high - low)
    if position < middle:
        return [*_inclusion(position, low, middle), (middle, high)]
    return [*_inclusion(position, middle, high), (low, middle)]


def consistency(old: int, size: int) -> ProofPlan:
    """The proof that the tree of `size` leaves begins with the tree of `old` ones."""
    return (
        [cover(*part) for part in _consistency(old, 0, size, known=True)] if 0 < old < size else []
    )


def _consistency(old: int, low: int, high: int, *, known: bool) -> list[tuple[int, int]]:
    """`known`: whether the subtree ending at `old` is the whole old tree, whose root the reader
    has."""
    if old == high:
        return [] if known else [(low, high)]
    middle = low + _split(high - low)
    if old <= middle:
        return [*_consistency(old, low, middle, known=known), (middle, high)]
    return [*_consistency(old, middle, high, known=False), (low, middle)]


def _split(leaves: int) -> int:
    """The largest power of two below a number of leaves, where the left subtree ends."""
    return 1 << ((leaves - 1).bit_length() - 1)


def prove(plan: ProofPlan, hashes: Mapping[Node, bytes]) -> list[bytes]:
    """The hashes of a proof, from those of the perfect subtrees that its plan names."""
    return [fold([hashes[node] for node in part]) for part in plan]
