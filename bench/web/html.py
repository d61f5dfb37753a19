"""HTML text in which everything is escaped that is not HTML already."""

from __future__ import annotations

import html
from collections.abc import Iterable


class Html(str):
    """Text that is HTML and is not escaped again."""

    __slots__ = ()


def escaped(value: object) -> Html:
    """``value`` as HTML; only `Html` passes as it is."""
    return value if isinstance(value, Html) else Html(html.escape(str(value), quote=True))


def fill(template: str, *values: object, **named: object) -> Html:
    """``template`` with its fields filled by escaped values.

    Examples
    --------
    >>> fill("<td>{}</td>", "a < b")
    '<td>a &lt; b</td>'
    """
    return Html(template.format(*(escaped(v) for v in values), **{k: escaped(v) for k, v in named.items()}))


def join(parts: Iterable[object], between: str = "") -> Html:
    """Parts, escaped, one after the other."""
    return Html(between.join(escaped(part) for part in parts))
