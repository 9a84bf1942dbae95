"""Seeded ways to spoil a file: its bytes, its texts and numbers, its columns, or that it is a file at all."""

import json
import os
import random
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

TEXTS = (
    "nan", "inf", "-inf", "-1", "0", "1e308", "-1e308", "1e-320", "1e400", "9" * 25, "9" * 5000, "1_0", "é",
    "\0", "", " ", '"', "'", ",", "\n", "\r", "[", "[" * 2000, "{}", "[]", "null", "true", "!!bool maybe",
    "2024-13-45",
    "&a [*a]", "<script>", "x[/b]", "\ufeff", "%s%n", "../../etc/passwd", "a." * 3000, "x" * 100_000,
)  # fmt: skip
VALUES: tuple[Any, ...] = (
    None, True, -1, 0, 2**70, 1e308, -1e308, float("nan"), float("inf"), "", "x", "\n", [], {}, [[]],
    {"a": 1},
)  # fmt: skip


def spoil(path: Path, rng: random.Random) -> str:
    """Spoil a file, and say how."""
    if rng.random() < 0.06:
        return not_a_file(path, rng)
    if path.suffix == ".parquet" and rng.random() < 0.7:
        return columns(path, rng)
    if path.suffix == ".json" and rng.random() < 0.7:
        return tree(path, rng)
    if path.suffix in (".csv", ".toml", ".yaml", ".jsonl", ".json") and rng.random() < 0.8:
        return text(path, rng)
    return raw(path, rng)


def not_a_file(path: Path, rng: random.Random) -> str:
    kind = rng.choice(["missing", "folder", "pipe", "zeros", "loop", "sparse", "empty"])
    path.unlink()
    if kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind == "zeros":
        path.symlink_to("/dev/zero")
    elif kind == "loop":
        path.symlink_to(path)
    elif kind == "sparse":
        with path.open("wb") as stream:
            stream.truncate(rng.choice([1 << 34, 1 << 29]))
    elif kind == "empty":
        path.touch()
    return kind


def raw(path: Path, rng: random.Random) -> str:
    whole = path.read_bytes()
    # Headers decide how the rest is read.
    reach = rng.choice([len(whole), min(len(whole), 200)])
    at, length = rng.randrange(reach + 1), rng.choice([0, 1, 1, 4, 40, len(whole)])
    junk = rng.choice([b"", rng.randbytes(1), rng.randbytes(8), rng.choice(TEXTS).encode()])
    path.write_bytes(whole[:at] + junk + whole[at + length :])
    return f"bytes {at} to {at + length}: {junk[:20]!r}"


def text(path: Path, rng: random.Random) -> str:
    lines = path.read_text(encoding="utf-8").split("\n")
    row = rng.randrange(len(lines))
    how = rng.choice(["drop", "double", "swap", "cell", "cell", "cell", "cell"])
    if how == "drop":
        del lines[row]
    elif how == "double":
        lines.insert(row, lines[row])
    elif how == "swap":
        other = rng.randrange(len(lines))
        lines[row], lines[other] = lines[other], lines[row]
    else:
        separator = "," if "," in lines[row] else next((s for s in ("=", ":") if s in lines[row]), ",")
        cells = lines[row].split(separator)
        which, value = rng.randrange(len(cells)), rng.choice(TEXTS)
        how = f"{cells[which][:30]!r} -> {value[:20]!r}"
        cells[which] = value
        lines[row] = separator.join(cells)
    path.write_text("\n".join(lines), encoding="utf-8")
    return f"line {row + 1}: {how}"


def tree(path: Path, rng: random.Random) -> str:
    data = json.loads(path.read_text(encoding="utf-8"))
    place, key = {"": data}, ""
    while rng.random() < 0.75 and isinstance(place[key], dict | list) and place[key]:
        place = place[key]
        key = rng.choice(list(place)) if isinstance(place, dict) else rng.randrange(len(place))
    value = rng.choice([*VALUES, "delete"])
    if value == "delete" and key != "":
        del place[key]
    else:
        place[key] = value
    path.write_text(json.dumps(data if key != "" else place[""]), encoding="utf-8")
    return f"{key} -> {value!r}"


def columns(path: Path, rng: random.Random) -> str:
    table = pq.read_table(path)
    k = rng.randrange(table.num_columns)
    name, n = table.column_names[k], len(table)
    how = rng.choice(
        ["drop", "double", "retype", "null", "rename", "rows", "repeat", "value", "value", "metadata"]
    )
    if how == "drop":
        table = table.drop_columns([name])
    elif how == "double":
        table = table.append_column(name, table[name])
    elif how == "retype":
        value = rng.choice([b"x", "x", 1, 1.5, True, [1.0], {"a": 1}])
        table = table.set_column(k, name, pa.array([value] * n))
    elif how == "null":
        table = table.set_column(k, name, pa.nulls(n, table[name].type))
    elif how == "rename":
        table = table.rename_columns(
            [rng.choice(TEXTS[:20]) if i == k else c for i, c in enumerate(table.column_names)]
        )
    elif how == "rows":
        table = table.slice(rng.randrange(n + 1))
    elif how == "repeat":
        table = pa.concat_tables([table, table])
    elif how == "metadata":
        table = table.replace_schema_metadata({b"craternav": rng.choice([b"", b"{}", b"5", b"[]", b"\xff"])})
    else:
        values = table[name].to_pylist()
        row, value = rng.randrange(n) if n else 0, rng.choice(VALUES)
        if n:
            old = values[row]
            values[row] = [value] * len(old) if isinstance(old, list) else value
        try:
            table = table.set_column(k, name, pa.array(values, table[name].type))
        except (pa.ArrowException, TypeError, OverflowError):
            table = table.set_column(k, name, pa.nulls(n))
    pq.write_table(table, path, write_page_checksum=rng.random() < 0.5)
    return f"column {name}: {how}"
