"""The page of JSON answers, from their schemas: ``python docs/reference/schemas/page.py > docs/reference/json.md``."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
HEAD = """# JSON answers

Every command takes `--json FILE` (`-`: standard output, and nothing else there). Names of keys end in their unit
(`_hz`, `_s`, `_us`, `_mps2`); what does not exist is `null`, never NaN. Each answer has a
[JSON schema](https://json-schema.org) in `docs/reference/schemas/`, from which this page is made and against which the
tests hold real answers. A dot leads into an object, `[]` into each item of a list, `*` to any key.
"""


def rows(schema: dict[str, Any], path: str = "") -> Iterator[tuple[str, str, str]]:
    """Path, type and description of every key below ``schema``."""
    items = schema.get("items")
    if items:
        yield from rows(items, f"{path}[]")
    for name, own in schema.get("properties", {}).items():
        place = f"{path}.{name}" if path else name
        kinds = own.get("type", "any")
        words = " or ".join(kinds) if isinstance(kinds, list) else kinds
        yield place, words, own.get("description", "")
        yield from rows(own, place)
    deeper = schema.get("additionalProperties")
    if isinstance(deeper, dict) and deeper.get("properties"):
        yield from rows(deeper, f"{path}.*" if path else "*")


def page() -> str:
    """The whole page."""
    parts = [HEAD]
    for file in sorted(HERE.glob("*.json")):
        schema = json.loads(file.read_text(encoding="utf-8"))
        table = "\n".join(f"| `{place}` | {words} | {text} |" for place, words, text in rows(schema))
        head = f"## `{schema['title']}`\n\n`schemas/{file.name}`"
        parts.append(f"{head}\n\n| key | type | meaning |\n|---|---|---|\n{table}\n")
    return "\n".join(parts)


if __name__ == "__main__":
    sys.stdout.write(page())
