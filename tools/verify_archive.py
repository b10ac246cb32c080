#!/usr/bin/env python3
"""Verify an exported archive offline, with the standard library alone and without trueup.

    python verify_archive.py ARCHIVE [KEY]

ARCHIVE is the folder or tar file that `trueup export` or `trueup backup` wrote. KEY is the log's
public key from its operator (<name>+<hash>+<base64>). Without KEY the key that the archive names is
used, which shows that the archive is whole, not whose it is; this program then says so. It exits
with 0 if all of this holds, and otherwise with 4 and a list:

- every part of the archive is what its digest names;
- the head of the log, and the archive itself, are signed by the key (Ed25519, C2SP signed note);
- every entry is in that log (RFC 9162): a plant's by its proof, a whole registry's by rebuilding
  the tree;
- every row is as the last entry that names it left it, every row is named by an entry, and every
  named row is there;
- artifacts, gates, decisions and episodes have the content that names them, and every byte that a
  row names is there;
- every move of a pointer is named by an entry of a kind that may move one.

On standard error it lists what a reader should know of the gates: which one replaced another, and
which decisions were made by a gate that was declared after their candidate had been judged.

It shares no code with the service and its library, so that no mistake is made twice.
"""

import base64
import hashlib
import json
import os
import stat
import sys
import tarfile
from pathlib import Path

MANIFEST_TYPE = "application/vnd.trueup.archive.v1"
TITLE = "org.opencontainers.image.title"
KEYS = {
    "projects": "name", "tokens": "prefix", "plants": "name", "episodes": "plant digest",
    "artifacts": "plant version",
    "gates": "plant digest",
    "jobs": "id", "outputs": "job name",
    "decisions": "digest", "serving": "plant", "moves": "plant generation",
    "approvals": "plant decision token",
    "imports": "plant", "monitors": "plant digest", "watching": "plant",
    "watches": "plant monitor sequence", "alarms": "id",
    "policies": "plant sequence", "evidence": "plant digest", "channels": "plant name",
    "channel_moves": "plant channel generation", "webhooks": "name",
    "labels": "plant kind subject",
}  # fmt: skip
ENDORSEMENT = "trueup: the log is signed from here on by"
OF_NO_PLANT = ("projects", "tokens", "webhooks")
NAMED_BY_DOCUMENT = ("plants", "gates", "decisions", "monitors", "policies", "evidence")
MOVING_KINDS = {
    "moves": ("pointer:moved", "plant:registered"),
    "channel_moves": ("channel:moved",),
}
KINDS_OF_ANY_ROW = ("log:migrated", "plant:imported")
NAMES_BYTES = {
    "episodes": "digest",
    "artifacts": "arrays",
    "imports": "entries",
    "outputs": "digest",
}
LONGEST_NOTE, MOST_SIGNERS, MOST_KEYS = 4096, 8, 100  # checking a signature takes about 10 ms
# bytes of a tar file's header, and of an extension that names the next header or its size
HEADER, LARGEST_EXTENSION = 512, 8192
FINAL = ("succeeded", "failed", "cancelled")


# -- canonical JSON (RFC 8785)


def canonical(value):
    """Returns the canonical text of a JSON value."""
    if value is None or isinstance(value, bool):
        return json.dumps(value)
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return number(value)
    if isinstance(value, list):
        return "[" + ",".join(map(canonical, value)) + "]"
    pairs = sorted(value.items(), key=lambda pair: pair[0].encode("utf-16-be"))
    return "{" + ",".join(f"{canonical(name)}:{canonical(item)}" for name, item in pairs) + "}"


def number(value):
    """Returns a number as ECMAScript writes it.

    It has the shortest digits that give it back, without exponent from 1e-6 to below 1e21.
    """
    if value == 0:
        return "0"
    sign, text = ("-" if value < 0 else ""), repr(abs(value))
    digits, _, exponent = text.partition("e")
    whole, _, part = digits.partition(".")
    shift = int(exponent or 0) + len(whole)
    digits = (whole + part).lstrip("0")
    shift -= len(whole + part) - len(digits)
    digits = digits.rstrip("0")
    if -6 < shift <= 0:
        return f"{sign}0.{'0' * -shift}{digits}"
    if 0 < shift <= 21:
        return sign + (
            digits.ljust(shift, "0")
            if len(digits) <= shift
            else f"{digits[:shift]}.{digits[shift:]}"
        )
    rest = f".{digits[1:]}" if len(digits) > 1 else ""
    return f"{sign}{digits[0]}{rest}e{'+' if shift > 0 else '-'}{abs(shift - 1)}"


def sha256(data):
    """Returns the SHA-256 of bytes or of a document's canonical text, in hexadecimal."""
    return hashlib.sha256(data if isinstance(data, bytes) else canonical(data).encode()).hexdigest()


# -- Ed25519 (RFC 8032)

P, ORDER = 2**255 - 19, 2**252 + 27742317777372353535851937790883648493
CURVE = -121665 * pow(121666, P - 2, P) % P


def add(one, other):
    """Returns the sum of two points (x, y)."""
    (a, b), (c, d) = one, other
    k = CURVE * a * b * c * d % P
    return (a * d + b * c) * pow(1 + k, P - 2, P) % P, (b * d + a * c) * pow(1 - k, P - 2, P) % P


def times(count, point):
    """Returns a point multiplied by a number."""
    product = (0, 1)
    while count:
        if count & 1:
            product = add(product, point)
        point, count = add(point, point), count >> 1
    return product


def point(encoded):
    """Returns the point of 32 bytes; None if there is none."""
    value = int.from_bytes(encoded, "little")
    y, odd = value % 2**255, value >> 255
    square = (y * y - 1) * pow(CURVE * y * y + 1, P - 2, P) % P
    x = pow(square, (P + 3) // 8, P)
    if (x * x - square) % P:
        x = x * pow(2, (P - 1) // 4, P) % P
    if y >= P or (x * x - square) % P or (x == 0 and odd):
        return None
    return (x if x & 1 == odd else P - x), y


BASE = point((4 * pow(5, P - 2, P) % P).to_bytes(32, "little"))


def signed(key, signature, message):
    """Whether a signature of a message is valid under the key."""
    commitment, public, s = (
        point(signature[:32]),
        point(key),
        int.from_bytes(signature[32:], "little"),
    )
    if commitment is None or public is None or s >= ORDER or len(signature) != 64:
        return False
    h = int.from_bytes(hashlib.sha512(signature[:32] + key + message).digest(), "little") % ORDER
    return times(s, BASE) == add(commitment, times(h, public))


def opened(note, key):
    """Returns the text of a note; None if the key did not sign it."""
    if len(note) > LONGEST_NOTE:
        return None
    name, named, encoded = key.strip().split("+", 2)
    public = base64.b64decode(encoded)
    if (
        public[:1] != b"\x01"
        or hashlib.sha256(name.encode() + b"\n" + public).hexdigest()[:8] != named
    ):
        return None
    text, _, lines = note.rpartition("\n\n")
    for line in lines.splitlines()[:MOST_SIGNERS]:
        signer, _, signature = line.removeprefix("— ").partition(" ")
        data = base64.b64decode(signature)
        if (
            signer == name
            and data[:4].hex() == named
            and signed(public[1:], data[4:], f"{text}\n".encode())
        ):
            return text
    return None


def followed(key, endorsements):
    """Returns the last key in the chain in which each key endorses the next."""
    for note in endorsements[:MOST_KEYS]:
        first, _, then = (opened(note, key) or "").partition("\n")
        if first == ENDORSEMENT and then.split("+")[0] == key.split("+")[0]:
            key = then
    return key


# -- the log's tree (RFC 9162)


def leaf(entry):
    """Returns an entry's hash as a leaf of the tree."""
    named = {name: entry[name] for name in ("sequence", "at", "kind", "actor", "plant", "subject")}
    named |= {"facts_sha256": sha256(entry["facts"]), "rows_sha256": sha256(entry["rows"])}
    return hashlib.sha256(b"\0" + canonical(named).encode()).digest()


def join(left, right):
    """Returns the hash of two subtrees as one."""
    return hashlib.sha256(b"\1" + left + right).digest()


def root_of(leaves):
    """Returns the root of a tree."""
    if len(leaves) < 2:
        return leaves[0] if leaves else hashlib.sha256(b"").digest()
    half = 1 << ((len(leaves) - 1).bit_length() - 1)
    return join(root_of(leaves[:half]), root_of(leaves[half:]))


def root_by(proof, leaf_hash, position, size):
    """Returns the root that a leaf's proof leads to; None if the proof has the wrong length."""
    if size == 1:
        return leaf_hash if not proof else None
    if not proof:
        return None
    half = 1 << ((size - 1).bit_length() - 1)
    if position < half:
        inner = root_by(proof[:-1], leaf_hash, position, half)
        return inner and join(inner, proof[-1])
    inner = root_by(proof[:-1], leaf_hash, position - half, size - half)
    return inner and join(proof[-1], inner)


# -- the archive


class Broken(Exception):
    """The archive cannot be read."""


def regular(path):
    """Returns the bytes of a regular file. Raises Broken for a pipe or a device."""
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    with os.fdopen(handle, "rb") as file:
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise Broken(f"{path.name} is no regular file")
        return file.read()


def require_plain_tar(path):
    """Checks the headers of a tar file before tarfile reads them.

    Raises Broken for a long extension, or one that holds for all members.
    """
    whole, at = path.stat().st_size, 0
    with path.open("rb") as file:
        while at + HEADER <= whole:
            file.seek(at)
            header = file.read(HEADER)
            if not any(header):
                return
            size, kind = tarfile.nti(header[124:136]), header[156:157]
            if kind == b"g" or not 0 <= size <= (
                LARGEST_EXTENSION if kind in (b"x", b"L", b"K", b"X") else whole
            ):
                raise Broken(
                    f"a header of the tar file says {size} bytes, or speaks for all others"
                )
            at += HEADER * (1 - (-size // HEADER))


class Archive:
    """A folder or a tar file in the form of an OCI image layout."""

    def __init__(self, path):
        self.tar = None
        if path.is_file():
            require_plain_tar(path)
            self.tar = tarfile.open(path, "r:")
        self.path = path
        for member in self.tar.getmembers() if self.tar else ():
            plain = member.isdir() or (member.isreg() and member.sparse is None)
            if not plain or member.offset_data + member.size > path.stat().st_size:
                raise Broken(f"{member.name} is no plain file that lies in the tar file whole")
        index = json.loads(self.read("index.json"))
        described = next(m for m in index["manifests"] if m["artifactType"] == MANIFEST_TYPE)
        self.digest, self.signature = (
            described["digest"],
            described["annotations"][f"{MANIFEST_TYPE}.signature"],
        )
        manifest = json.loads(self.blob(described["digest"]))
        self.config = json.loads(self.blob(manifest["config"]["digest"]))
        self.layers = {layer["annotations"][TITLE]: layer["digest"] for layer in manifest["layers"]}

    def read(self, name):
        """Returns a file of the layout."""
        try:
            return (
                regular(self.path / name) if self.tar is None else self.tar.extractfile(name).read()
            )
        except (OSError, KeyError) as error:
            raise Broken(f"{name} is missing") from error

    def blob(self, digest):
        """Returns a part. Raises Broken if it is not what its digest names."""
        data = self.read("blobs/" + digest.replace(":", "/"))
        if f"sha256:{sha256(data)}" != digest:
            raise Broken(f"{digest} is not what it names")
        return data

    def lines(self, title):
        """Returns the documents of a layer."""
        return (
            [json.loads(line) for line in self.blob(self.layers[title]).splitlines()]
            if title in self.layers
            else []
        )


def findings(archive, key):
    """Returns what does not hold."""
    key = followed(key or archive.config["key"], archive.config.get("endorsements", ()))
    plant, head = archive.config["plant"], opened(archive.config["checkpoint"], key)
    if head is None or head.split("\n")[0] != key.split("+")[0]:
        return ["the head of the log is not signed by the key"]
    if opened(archive.signature, key) != f"trueup.archive/1\n{archive.digest}":
        return ["the archive is not signed by the key"]
    size, root = int(head.split("\n")[1]), base64.b64decode(head.split("\n")[2])
    lines = archive.lines("log/entries.jsonl")
    named = {}
    for line in lines:
        named |= {name: (digest, line["entry"]) for name, digest in line["entry"]["rows"].items()}
    if plant is None:
        in_order = len(lines) == size and all(
            line["entry"]["sequence"] == at for at, line in enumerate(lines, 1)
        )
        whole = in_order and root_of([leaf(line["entry"]) for line in lines]) == root
        wrong = (
            []
            if whole
            else [f"{len(lines)} entries do not have the root that was signed for {size}"]
        )
    else:
        proofs = [(line["entry"], [base64.b64decode(h) for h in line["proof"]]) for line in lines]
        wrong = [
            f"entry {e['sequence']} is not proven"
            for e, p in proofs
            if root_by(p, leaf(e), e["sequence"] - 1, size) != root
        ]
        wrong += [
            f"entry {e['sequence']} is of another plant" for e, _ in proofs if e["plant"] != plant
        ]
        order = [e["sequence"] for e, _ in proofs]
        wrong += [] if order == sorted(set(order)) else ["the entries are not in order"]
    return wrong + rows_that_differ(archive, named, plant) + bytes_that_are_missing(archive)


def rows_that_differ(archive, named, plant):
    """Returns rows that are not as the log names them."""
    wrong, seen = [], set()
    for table, key in KEYS.items():
        for row in archive.lines(f"rows/{table}.jsonl"):
            name = "/".join([table, *(str(row[column]) for column in key.split())])
            seen.add(name)
            if plant and row["name" if table == "plants" else "plant"] != plant:
                wrong.append(f"{name}: it is of another plant")
            if name not in named:
                if table != "jobs" or row["state"] in FINAL:
                    wrong.append(f"{name}: no entry tells of it")
                continue
            digest, entry = named[name]
            if (
                sha256({"table": table, "row": {k: v for k, v in row.items() if v is not None}})
                != digest
            ):
                wrong.append(f"{name}: it is not as entry {entry['sequence']} left it")
            if entry["kind"] not in (*MOVING_KINDS.get(table, (entry["kind"],)), *KINDS_OF_ANY_ROW):
                wrong.append(f"{name}: entry {entry['sequence']} cannot tell of a move")
            content = (
                row["manifest"]
                if table == "artifacts"
                else row["document"]
                if table in NAMED_BY_DOCUMENT
                else None
            )
            if content is not None and sha256(content.encode()) != row["digest"]:
                wrong.append(f"{name}: it is not what its digest names")
    jobs = {row["id"] for row in archive.lines("rows/jobs.jsonl")}
    strays = [row for row in archive.lines("rows/outputs.jsonl") if row["job"] not in jobs]
    wrong += [
        f"outputs/{row['job']}/{row['name']}: its job is not in the archive" for row in strays
    ]
    left_out = OF_NO_PLANT if plant else ()
    return wrong + [
        f"{name}: the log names it, and it is not there"
        for name in sorted(set(named) - seen)
        if name.split("/")[0] not in left_out
    ]


def bytes_that_are_missing(archive):
    """Returns parts that are not what they name, and missing bytes that a row names."""
    held, wrong = set(), []
    for title, digest in archive.layers.items():
        try:
            archive.blob(digest)
            held.add(digest.partition(":")[2])
        except Broken as error:
            wrong.append(f"{title}: {error}")
    for table, column in NAMES_BYTES.items():
        rows = archive.lines(f"rows/{table}.jsonl")
        wrong += [
            f"{table} {row[column]}: its bytes are not there"
            for row in rows
            if row[column] and row[column] not in held
        ]
    return wrong


def to_know(archive):
    """Returns what to know of the gates.

    These are gates that replaced another, and decisions by a gate that was declared after their
    candidate had been judged.
    """
    notes = []
    for row in archive.lines("rows/gates.jsonl"):
        gate = json.loads(row["document"])
        if "follows" in gate:
            notes.append(
                f"gate {row['digest'][:12]} took the place of {gate['follows'][:12]}: "
                f"{gate['because']}"
            )
    for row in archive.lines("rows/decisions.jsonl"):
        known = json.loads(row["document"]).get("known", {})
        if known.get("candidate") or known.get("compared"):
            before = ", ".join(
                f"{'passed' if d['accepted'] else 'failed'} by gate {d['gate'][:12]}"
                for d in known["candidate"]
            )
            notes.append(
                f"decision {row['digest'][:12]}: its gate was declared after its candidate "
                f"had been judged: {before or 'compared'}"
            )
    return notes


def visible(text):
    """Returns text that others wrote with control characters escaped, for a terminal."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in str(text))


def main(arguments):
    """Verifies an archive, prints what does not hold, and returns the exit code."""
    if len(arguments) not in (1, 2):
        print(__doc__)
        return 2
    try:
        archive = Archive(Path(arguments[0]))
        if len(arguments) == 1:
            own = visible(archive.config["key"])
            print(
                (
                    "whose it is, nobody has shown: no key was given, and the archive names its "
                    f"own, {own}"
                ),
                file=sys.stderr,
            )
        wrong = findings(archive, arguments[1] if len(arguments) > 1 else None)
        for line in to_know(archive):
            print(visible(line), file=sys.stderr)
    except Exception as error:  # noqa: BLE001  (then the archive does not hold)
        wrong = [f"the archive cannot be read: {type(error).__name__} {error}"]
    print(*map(visible, wrong or ["holds"]), sep="\n")
    return 4 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
