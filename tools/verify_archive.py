#!/usr/bin/env python3
"""Verify an exported archive offline, with the standard library alone and without trueup.

    python verify_archive.py ARCHIVE [KEY]

ARCHIVE is what `trueup export` or `trueup backup` wrote, a folder or a tar file; KEY is the log's
public key as its operator gave it to you (<name>+<hash>+<base64>). Without it the archive is
believed to name its own, which shows that it is whole and not whose it is, and this program says
so. Exit 0 if all of this holds, 4 with a list otherwise:

- every part of the archive is what its digest names;
- the head of the log, and the archive itself, are signed by the key (Ed25519, C2SP signed note);
- every entry is in that log (RFC 9162): a plant's by its proof, a whole registry's by rebuilding
  the tree;
- every row is as the last entry that names it left it, every row is named, and every named row is
  there;
- artifacts, gates, decisions and episodes have the content that names them, and every byte that a
  row names is there;
- every move of a pointer is told by an entry that may tell of one.

Whatever holds, it lists on standard error what a reader should know of the gates: which took the
place of another, and which decisions were made by a gate that was declared after their candidate
had been judged.

Written apart from the service and its library, so that one mistake is not made twice.
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
    "channel_moves": "plant channel generation",
}  # fmt: skip
ENDORSEMENT = "trueup: the log is signed from here on by"
APART = ("projects", "tokens")
BY_DOCUMENT = ("plants", "gates", "decisions", "monitors", "policies", "evidence")
TELL_OF_MOVES = {
    "moves": ("pointer:moved", "plant:registered"),
    "channel_moves": ("channel:moved",),
}
TELL_OF_ALL = ("log:migrated", "plant:imported")
NAMES_BYTES = {
    "episodes": "digest",
    "artifacts": "arrays",
    "imports": "entries",
    "outputs": "digest",
}
LONGEST_NOTE, MOST_SIGNERS, MOST_KEYS = (
    4096,
    8,
    100,
)  # checking a signature takes this program a hundredth of a second
HEADER, LARGEST_EXTENSION = (
    512,
    8192,
)  # bytes of a tar file's header, and of one that only names the next or tells its size
FINAL = ("succeeded", "failed", "cancelled")


# -- canonical JSON (RFC 8785)


def canonical(value):
    """The canonical text of a JSON value."""
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
    """A number as ECMAScript writes it: the shortest digits that give it back, plain from 1e-6 to
    below 1e21."""
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
    """SHA-256 of bytes or of a document's canonical text, hexadecimal."""
    return hashlib.sha256(data if isinstance(data, bytes) else canonical(data).encode()).hexdigest()


# -- Ed25519 (RFC 8032)

P, ORDER = 2**255 - 19, 2**252 + 27742317777372353535851937790883648493
CURVE = -121665 * pow(121666, P - 2, P) % P


def add(one, other):
    """The sum of two points, given as x and y."""
    (a, b), (c, d) = one, other
    k = CURVE * a * b * c * d % P
    return (a * d + b * c) * pow(1 + k, P - 2, P) % P, (b * d + a * c) * pow(1 - k, P - 2, P) % P


def times(count, point):
    """A point added to itself so many times."""
    found = (0, 1)
    while count:
        if count & 1:
            found = add(found, point)
        point, count = add(point, point), count >> 1
    return found


def point(encoded):
    """A point from its 32 bytes, None where there is none."""
    found = int.from_bytes(encoded, "little")
    y, odd = found % 2**255, found >> 255
    square = (y * y - 1) * pow(CURVE * y * y + 1, P - 2, P) % P
    x = pow(square, (P + 3) // 8, P)
    if (x * x - square) % P:
        x = x * pow(2, (P - 1) // 4, P) % P
    if y >= P or (x * x - square) % P or (x == 0 and odd):
        return None
    return (x if x & 1 == odd else P - x), y


BASE = point((4 * pow(5, P - 2, P) % P).to_bytes(32, "little"))


def signed(key, signature, message):
    """Whether a signature of a message holds."""
    begun, public, s = point(signature[:32]), point(key), int.from_bytes(signature[32:], "little")
    if begun is None or public is None or s >= ORDER or len(signature) != 64:
        return False
    h = int.from_bytes(hashlib.sha512(signature[:32] + key + message).digest(), "little") % ORDER
    return times(s, BASE) == add(begun, times(h, public))


def opened(note, key):
    """The text of a note that the key signed, None where it did not."""
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
    """The last of the keys that take over from one another, each endorsed by the one before."""
    for note in endorsements[:MOST_KEYS]:
        first, _, then = (opened(note, key) or "").partition("\n")
        if first == ENDORSEMENT and then.split("+")[0] == key.split("+")[0]:
            key = then
    return key


# -- the log's tree (RFC 9162)


def leaf(entry):
    """An entry as a leaf of the tree."""
    told = {name: entry[name] for name in ("sequence", "at", "kind", "actor", "plant", "subject")}
    told |= {"facts_sha256": sha256(entry["facts"]), "rows_sha256": sha256(entry["rows"])}
    return hashlib.sha256(b"\0" + canonical(told).encode()).digest()


def join(left, right):
    """Two subtrees as one."""
    return hashlib.sha256(b"\1" + left + right).digest()


def root_of(leaves):
    """The root of a tree."""
    if len(leaves) < 2:
        return leaves[0] if leaves else hashlib.sha256(b"").digest()
    half = 1 << ((len(leaves) - 1).bit_length() - 1)
    return join(root_of(leaves[:half]), root_of(leaves[half:]))


def root_by(proof, found, position, size):
    """The root that a leaf's proof leads to, None where the proof has another length than it
    must."""
    if size == 1:
        return found if not proof else None
    if not proof:
        return None
    half = 1 << ((size - 1).bit_length() - 1)
    if position < half:
        inner = root_by(proof[:-1], found, position, half)
        return inner and join(inner, proof[-1])
    inner = root_by(proof[:-1], found, position - half, size - half)
    return inner and join(proof[-1], inner)


# -- the archive


class Broken(Exception):
    """The archive cannot be read on."""


def regular(path):
    """The bytes of a file, if it is one: a pipe would wait, and a device never end."""
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    with os.fdopen(handle, "rb") as file:
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise Broken(f"{path.name} is no regular file")
        return file.read()


def require_plain_tar(path):
    """Walk the headers of a tar file before anything makes members of them: no long extension, none
    for all members."""
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
        """A file of the layout."""
        try:
            return (
                regular(self.path / name) if self.tar is None else self.tar.extractfile(name).read()
            )
        except (OSError, KeyError) as error:
            raise Broken(f"{name} is missing") from error

    def blob(self, digest):
        """A part, which must be what its digest names."""
        data = self.read("blobs/" + digest.replace(":", "/"))
        if f"sha256:{sha256(data)}" != digest:
            raise Broken(f"{digest} is not what it names")
        return data

    def lines(self, title):
        """The documents of a layer."""
        return (
            [json.loads(line) for line in self.blob(self.layers[title]).splitlines()]
            if title in self.layers
            else []
        )


def findings(archive, key):
    """What does not hold."""
    key = followed(key or archive.config["key"], archive.config.get("endorsements", ()))
    plant, head = archive.config["plant"], opened(archive.config["checkpoint"], key)
    if head is None or head.split("\n")[0] != key.split("+")[0]:
        return ["the head of the log is not signed by the key"]
    if opened(archive.signature, key) != f"trueup.archive/1\n{archive.digest}":
        return ["the archive is not signed by the key"]
    size, root = int(head.split("\n")[1]), base64.b64decode(head.split("\n")[2])
    told = archive.lines("log/entries.jsonl")
    named = {}
    for line in told:
        named |= {name: (digest, line["entry"]) for name, digest in line["entry"]["rows"].items()}
    if plant is None:
        in_order = len(told) == size and all(
            line["entry"]["sequence"] == at for at, line in enumerate(told, 1)
        )
        whole = in_order and root_of([leaf(line["entry"]) for line in told]) == root
        found = (
            []
            if whole
            else [f"{len(told)} entries do not have the root that was signed for {size}"]
        )
    else:
        proofs = [(line["entry"], [base64.b64decode(h) for h in line["proof"]]) for line in told]
        found = [
            f"entry {e['sequence']} is not proven"
            for e, p in proofs
            if root_by(p, leaf(e), e["sequence"] - 1, size) != root
        ]
        found += [
            f"entry {e['sequence']} is of another plant" for e, _ in proofs if e["plant"] != plant
        ]
        order = [e["sequence"] for e, _ in proofs]
        found += [] if order == sorted(set(order)) else ["the entries are not in order"]
    return found + rows_that_differ(archive, named, plant) + bytes_that_are_missing(archive)


def rows_that_differ(archive, named, plant):
    """Rows that are not as the log names them."""
    found, seen = [], set()
    for table, key in KEYS.items():
        for row in archive.lines(f"rows/{table}.jsonl"):
            name = "/".join([table, *(str(row[column]) for column in key.split())])
            seen.add(name)
            if plant and row["name" if table == "plants" else "plant"] != plant:
                found.append(f"{name}: it is of another plant")
            if name not in named:
                if table != "jobs" or row["state"] in FINAL:
                    found.append(f"{name}: no entry tells of it")
                continue
            digest, entry = named[name]
            if (
                sha256({"table": table, "row": {k: v for k, v in row.items() if v is not None}})
                != digest
            ):
                found.append(f"{name}: it is not as entry {entry['sequence']} left it")
            if entry["kind"] not in (*TELL_OF_MOVES.get(table, (entry["kind"],)), *TELL_OF_ALL):
                found.append(f"{name}: entry {entry['sequence']} cannot tell of a move")
            content = (
                row["manifest"]
                if table == "artifacts"
                else row["document"]
                if table in BY_DOCUMENT
                else None
            )
            if content is not None and sha256(content.encode()) != row["digest"]:
                found.append(f"{name}: it is not what its digest names")
    jobs = {row["id"] for row in archive.lines("rows/jobs.jsonl")}
    strays = [row for row in archive.lines("rows/outputs.jsonl") if row["job"] not in jobs]
    found += [
        f"outputs/{row['job']}/{row['name']}: its job is not in the archive" for row in strays
    ]
    left_out = APART if plant else ()
    return found + [
        f"{name}: the log names it, and it is not there"
        for name in sorted(set(named) - seen)
        if name.split("/")[0] not in left_out
    ]


def bytes_that_are_missing(archive):
    """Parts that are not what they name, and bytes that a row names and that are not there."""
    held, found = set(), []
    for title, digest in archive.layers.items():
        try:
            archive.blob(digest)
            held.add(digest.partition(":")[2])
        except Broken as error:
            found.append(f"{title}: {error}")
    for table, column in NAMES_BYTES.items():
        rows = archive.lines(f"rows/{table}.jsonl")
        found += [
            f"{table} {row[column]}: its bytes are not there"
            for row in rows
            if row[column] and row[column] not in held
        ]
    return found


def to_know(archive):
    """Gates that took the place of another, and decisions by a gate that was declared after their
    candidate had been judged."""
    said = []
    for row in archive.lines("rows/gates.jsonl"):
        gate = json.loads(row["document"])
        if "follows" in gate:
            said.append(
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
            said.append(
                f"decision {row['digest'][:12]}: its gate was declared after its candidate "
                f"had been judged: {before or 'compared'}"
            )
    return said


def visible(text):
    """Text that others wrote, for a terminal: what it would obey stands as an escape."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in str(text))


def main(arguments):
    """Verify, and say so."""
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
        found = findings(archive, arguments[1] if len(arguments) > 1 else None)
        for line in to_know(archive):
            print(visible(line), file=sys.stderr)
    except Exception as error:  # noqa: BLE001  (whatever it is, it does not hold)
        found = [f"the archive cannot be read: {type(error).__name__} {error}"]
    print(*map(visible, found or ["holds"]), sep="\n")
    return 4 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
