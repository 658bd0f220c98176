"""The page that asks for the token of the console."""

from html import escape

STYLE = "/enter.css"
GET_LINK = (
    "Run `dr console` in the working folder: it opens the page with its token. "
    "`dr-start-viewer` prints the link."
)

_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">{again}
<title>DeepRacer console</title>
<link rel="icon" href="data:,">
<link rel="stylesheet" href="{style}">
</head>
<body>
<main>
<h1>DeepRacer console</h1>
<p role="alert">{sentence}</p>
<p>On the machine where the console runs, type this in the working folder:</p>
<p class="command"><code>dr console</code></p>
<p>It opens the page with its token; <code>dr-start-viewer</code> only prints the link. A browser
that has opened the link keeps the token for a year, so a bookmark works without it.</p>
<form action="/enter" method="get">
<label for="token">Token, the end of the link</label>
<input id="token" name="token" autocomplete="off" required>
<button>Open</button>
</form>
</main>
</body>
</html>
"""


def enter_page(sentence: str, *, asks_again: bool = False) -> str:
    """`asks_again`: the browser asks for the front page once more."""
    again = '\n<meta http-equiv="refresh" content="0; url=/">' if asks_again else ""
    return _PAGE.format(again=again, style=STYLE, sentence=escape(sentence))
