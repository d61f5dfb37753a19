"""The frame of every page: head, navigation and main part."""

from __future__ import annotations

from collections.abc import Sequence

from starlette.requests import Request

from bench.web.html import Html, fill, join

FRAME = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title} - shakerbench</title>
<link rel="icon" href="data:,">
<link rel="stylesheet" href="/static/web/desk.css">{styles}
<script src="/static/web/theme.js"></script>{scripts}
</head>
<body class="{name}">
<header class="bar">
<a class="skip" href="#main">to the content</a>
<a class="brand" href="/">shakerbench</a>
<nav aria-label="sections">{links}</nav>
<span class="grow"></span>{tools}
<button type="button" id="theme" class="quiet" title="light or dark">light / dark</button>
</header>
<main id="main">{body}</main>
</body>
</html>
"""


def page(
    request: Request,
    title: str,
    body: Html,
    *,
    scripts: Sequence[str] = (),
    styles: Sequence[str] = (),
    name: str = "plain",
    tools: Html | None = None,
) -> Html:
    """A whole page.

    Parameters
    ----------
    request
        Of which the navigation marks the present section.
    title
        Of the window; escaped.
    body
        Main part, HTML (`bench.web.html.fill`).
    scripts, styles
        Addresses of ES modules and style sheets of the own server; inline ones do not run.
    name
        Class of the body, for styles.
    tools
        HTML at the right end of the bar.
    """
    path = request.url.path
    links = [
        fill(
            '<a href="{}"{}>{}</a>', one.href, Html(' aria-current="page"' if path.startswith(one.href) else ""),
            one.title,
        )
        for one in request.app.state.sections
    ]  # fmt: skip
    return fill(
        FRAME,
        title=title,
        name=name,
        body=body,
        tools=tools or Html(""),
        links=join(links, "\n"),
        styles=join(fill('\n<link rel="stylesheet" href="{}">', one) for one in styles),
        scripts=join(fill('\n<script type="module" src="{}"></script>', one) for one in scripts),
    )
