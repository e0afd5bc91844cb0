"""Where the numbers lie that an HDF5 file in the oldest format is held together by, and damage to exactly those.

A random bit of a shard is nearly always a pixel's. Sizes, counts and addresses are what HDF5 follows: the fields of the
superblock, of object headers and their messages, of B-trees, heaps and symbol tables, after the format's specification
(https://support.hdfgroup.org/documentation/hdf5/latest/_f_m_t11.html).
"""

import struct
from collections import defaultdict
from typing import NamedTuple

_MESSAGES = {
    0x01: "dataspace",
    0x03: "datatype",
    0x05: "fill value",
    0x08: "layout",
    0x0B: "filters",
    0x0C: "attribute",
    0x10: "continuation",
    0x11: "symbol table",
    0x12: "time",
}
_NOWHERE = 2**64 - 1


class Field(NamedTuple):
    """A number in a file, or a run of bytes of a message.

    Attributes:
        kind: what it is.
        offset: where it begins.
        size: in bytes; a run's is larger than 8.
    """

    kind: str
    offset: int
    size: int


def fields_of(content):
    """Return all fields of a whole file, each once."""
    return sorted(_Walk(bytes(content)).fields)


class _Walk:
    def __init__(self, content):
        self._content, self._seen, self.fields = content, set(), set()
        names = ("group leaf k", "group internal k")
        self._add("superblock", (8, 1), (9, 1), (10, 1), (12, 1), (13, 1), (14, 1), (20, 4), (24, 8), (32, 8), (48, 8))
        for name, at in zip(names, (16, 18), strict=True):
            self._add(name, (at, 2))
        self._add("end of file", (40, 8))
        self._symbol(56)
        self._global_heaps()

    def _number(self, at, size):
        return int.from_bytes(self._content[at : at + size], "little")

    def _add(self, kind, *places):
        self.fields |= {Field(kind, offset, size) for offset, size in places}

    def _is_new(self, at, signature=b""):
        is_there = at != _NOWHERE and self._content[at : at + len(signature)] == signature
        if at in self._seen or not is_there:
            return False
        self._seen.add(at)
        return True

    def _symbol(self, at):
        """Follow a symbol table entry."""
        self._add("symbol: name", (at, 8))
        self._add("symbol: address", (at + 8, 8))
        self._add("symbol: cache", (at + 16, 4), (at + 24, 8), (at + 32, 8))
        self._header(self._number(at + 8, 8))

    def _header(self, at):
        if not self._is_new(at):
            return
        self._add("header", (at, 1), (at + 2, 2), (at + 4, 4), (at + 8, 4))
        blocks = [(at + 16, self._number(at + 8, 4))]
        while blocks:
            start, length = blocks.pop()
            here = start
            while here + 8 <= start + length:
                blocks += self._message(here)
                here += 8 + self._number(here + 2, 2)

    def _message(self, at):
        """Follow a message of an object header; return the blocks that it continues in."""
        kind, size, body = self._number(at, 2), self._number(at + 2, 2), at + 8
        name = _MESSAGES.get(kind, "other message")
        self._add("message: kind", (at, 2))
        self._add("message: size", (at + 2, 2))
        self._add("message: flags", (at + 4, 1))
        if name == "continuation":
            self._add("continuation", (body, 8), (body + 8, 8))
            return [(self._number(body, 8), self._number(body + 8, 8))]
        if name == "symbol table":
            self._add("symbol table", (body, 8), (body + 8, 8))
            self._tree(self._number(body, 8), 0)
            self._heap(self._number(body + 8, 8))
        elif name == "layout" and self._content[body : body + 2] == b"\3\2":
            dimensions = self._number(body + 2, 1)
            self._add("layout", (body, 1), (body + 1, 1), (body + 2, 1))
            self._add("layout: address", (body + 3, 8))
            self._add("layout: chunk side", *((body + 11 + 4 * i, 4) for i in range(dimensions)))
            self._tree(self._number(body + 3, 8), dimensions)
        elif size:
            self._add(name, (body, size))
        return []

    def _tree(self, at, dimensions):
        """Follow a B-tree: of a group (0 dimensions), or of chunks."""
        if not self._is_new(at, b"TREE"):
            return
        level, used = self._number(at + 5, 1), self._number(at + 6, 2)
        self._add("tree: kind", (at + 4, 1))
        self._add("tree: level", (at + 5, 1))
        self._add("tree: count", (at + 6, 2))
        self._add("tree: sibling", (at + 8, 8), (at + 16, 8))
        key_size, here = 8 + 8 * dimensions, at + 24
        for _ in range(used):
            if dimensions:
                self._add("chunk: size", (here, 4))
                self._add("chunk: filter mask", (here + 4, 4))
                self._add("chunk: offset", *((here + 8 + 8 * i, 8) for i in range(dimensions)))
            else:
                self._add("tree: key", (here, 8))
            self._add("tree: child", (here + key_size, 8))
            child = self._number(here + key_size, 8)
            if level:
                self._tree(child, dimensions)
            elif not dimensions:
                self._symbols(child)
            here += key_size + 8

    def _symbols(self, at):
        if not self._is_new(at, b"SNOD"):
            return
        self._add("symbols", (at + 4, 1))
        self._add("symbols: count", (at + 6, 2))
        for number in range(self._number(at + 6, 2)):
            self._symbol(at + 8 + 40 * number)

    def _heap(self, at):
        if not self._is_new(at, b"HEAP"):
            return
        self._add("heap", (at + 4, 1), (at + 8, 8), (at + 16, 8), (at + 24, 8))
        self._add("heap: names", (self._number(at + 24, 8), self._number(at + 8, 8)))

    def _global_heaps(self):
        """Find the heaps that the texts of attributes lie in."""
        at = self._content.find(b"GCOL")
        while at >= 0:
            self._add("global heap: size", (at + 8, 8))
            here, end = at + 16, at + self._number(at + 8, 8)
            while here + 16 <= end and self._number(here, 2):
                self._add("global heap: object", (here, 2), (here + 2, 2))
                self._add("global heap: length", (here + 8, 8))
                here += 16 + -(-self._number(here + 8, 8) // 8) * 8
            at = self._content.find(b"GCOL", at + 4)


# Damage


def damage_fields(content, fields, rng):
    """Damage one to three fields of a file in place, every kind as likely as any other; return what was done."""
    by_kind, done = defaultdict(list), []
    for field in fields:
        by_kind[field.kind].append(field)
    addresses = [0, 8, len(content), _NOWHERE, *(field.offset & ~7 for field in fields[:: max(1, len(fields) // 60)])]
    for _ in range(rng.choice([1, 1, 2, 3])):
        kind = sorted(by_kind)[rng.integers(len(by_kind))]
        field = by_kind[kind][rng.integers(len(by_kind[kind]))]
        other = by_kind[kind][rng.integers(len(by_kind[kind]))]
        if rng.random() < 0.2 and other.size == field.size and other != field:
            _swap(content, field, other)
            done.append(f"swapped {kind} at {field.offset} and {other.offset}")
        else:
            offset, size = _part_of(field, rng)
            before = bytes(content[offset : offset + size])
            after = _other(before, len(content), addresses, rng)
            content[offset : offset + size] = after
            done.append(f"{kind} at {offset}: {before.hex()} to {after.hex()}")
    return done


def _swap(content, a, b):
    first = bytes(content[a.offset : a.offset + a.size])
    content[a.offset : a.offset + a.size] = content[b.offset : b.offset + b.size]
    content[b.offset : b.offset + b.size] = first


def _part_of(field, rng):
    if field.size in (1, 2, 4, 8):
        return field.offset, field.size
    size = min(int(rng.choice([1, 1, 2, 4, 8])), field.size)
    return field.offset + size * int(rng.integers(field.size // size)), size


def _other(before, end, addresses, rng):
    """Return other bytes for a field: a flipped bit, a neighbour, or a number at which sizes and addresses break."""
    size, number = len(before), int.from_bytes(before, "little")
    around = [number ^ 1 << int(rng.integers(8 * size)), number + 1, number - 1, number * 2, number // 2, -number]
    limits = [0, 1, -1, 2 ** (8 * size - 1), 2 ** (8 * size - 1) - 1, end, end - 1, 2**16, 2**31, 2**32 - 1]
    pool = [around, around, limits, addresses][rng.integers(4)]
    other = int(pool[rng.integers(len(pool))]) % 2 ** (8 * size)
    return (other if other != number else number ^ 1).to_bytes(size, "little")


# Files in the newer formats, whose blocks carry checksums


def with_right_checksums(content):
    """Give object headers of the newer format (OHDR) the checksums of what is in them; nothing else is changed."""
    content = bytearray(content)
    at = content.find(b"OHDR")
    while at >= 0:
        flags = content[at + 5]
        start = at + 6 + (16 if flags & 0x20 else 0) + (4 if flags & 0x10 else 0)
        width = 1 << (flags & 3)
        end = start + width + int.from_bytes(content[start : start + width], "little")
        if end + 4 <= len(content):
            struct.pack_into("<I", content, end, lookup3(bytes(content[at:end])))
        at = content.find(b"OHDR", at + 4)
    return content


def lookup3(data):
    """Return Bob Jenkins' lookup3 hash (hashlittle), HDF5's checksum of metadata."""
    mask = 0xFFFFFFFF
    a = b = c = (0xDEADBEEF + len(data)) & mask

    def turn(x, by):
        return (x << by | x >> 32 - by) & mask

    padded = data + bytes(-len(data) % 12)
    words = struct.unpack(f"<{len(padded) // 4}I", padded)
    for at in range(0, len(words), 3):
        a, b, c = (a + words[at]) & mask, (b + words[at + 1]) & mask, (c + words[at + 2]) & mask
        if at + 3 < len(words):
            for by, first, second, third in (
                (4, *"acb"),
                (6, *"bac"),
                (8, *"cba"),
                (16, *"acb"),
                (19, *"bac"),
                (4, *"cba"),
            ):
                values = {"a": a, "b": b, "c": c}
                values[first] = (values[first] - values[second]) & mask ^ turn(values[second], by)
                values[second] = (values[second] + values[third]) & mask
                a, b, c = values["a"], values["b"], values["c"]
        else:
            for x, by in (("cb", 14), ("ac", 11), ("ba", 25), ("cb", 16), ("ac", 4), ("ba", 14), ("cb", 24)):
                values = {"a": a, "b": b, "c": c}
                values[x[0]] = ((values[x[0]] ^ values[x[1]]) - turn(values[x[1]], by)) & mask
                a, b, c = values["a"], values["b"], values["c"]
    return c if data else (0xDEADBEEF + len(data)) & mask
