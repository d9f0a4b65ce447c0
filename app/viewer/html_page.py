"""The page's HTML: viser's, with this project's title and what it needs before all else."""

from __future__ import annotations

import gzip
import html
import re
import secrets
from urllib.parse import urlsplit

from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from app.viewer.access import Answer

# How much of a phone's height the panel takes at most.
PHONE_SHARE = 0.33
# Whether a browser shows pages dark; its value is 1 where it does.
DARK_COOKIE = "footfall-dark"
_KEPT_S = 365 * 24 * 3600
# Names the link that was opened to the socket that the page opens next.
LINK_COOKIE = "footfall-link"
_OPENS_FOR_S = 600
# So long after a file that was dropped the next one is sent, so that it does not come before it.
_NEXT_FILE_MS = 1000
_MOST_LINKS = 64
# Where browsers say that a link stands which is not this server's own, typed or a bookmark.
_OTHERS = ("cross-site", "same-site")
# On a phone held upright viser's panel lies over the lower part of the window: here over a third.
# `?darkMode` is the choice of the switch: viser's own would stay on whatever that says.
# Files that are dropped go to the button that sends maps, a YAML before the pictures that it names.
_HEAD = """
<style>
@media (max-width: 36em) {
  [style*="max-height: 60%"] { max-height: SHEET% !important; width: 100% !important; }
  [style*="max-height: 60%"] > *, [style*="max-height: 60%"] [style*="width: 20em"] {
    width: 100% !important;
  }
}
</style>
<script>
(() => {
  const address = new URL(location.href);
  if (!address.searchParams.has('darkMode')) return;
  KEEP_DARK
  history.replaceState(null, '', address.href.replace(/[?&]darkMode[^&#]*/, '')
    .replace(/^([^?]*?)&/, '$1?'));
})();
addEventListener('dragover', event => event.preventDefault());
addEventListener('drop', async event => {
  event.preventDefault();
  const files = [...event.dataTransfer.files].sort(
    (one, other) => /\\.ya?ml$/i.test(other.name) - /\\.ya?ml$/i.test(one.name));
  for (const [number, file] of files.entries()) {
    if (number) await new Promise(resolve => setTimeout(resolve, NEXT_MS));
    const input = document.querySelector('input[type=file]'), sent = new DataTransfer();
    if (input === null) return;
    sent.items.add(file);
    input.files = sent.files;
    input.dispatchEvent(new Event('change', {bubbles: true}));
  }
});
</script>
"""


def keep_dark(*, is_dark: bool) -> str:
    """JavaScript that has the browser keep the choice between light and dark."""
    age_s = _KEPT_S if is_dark else 0
    return f"document.cookie = '{DARK_COOKIE}=1; path=/; SameSite=Strict; max-age={age_s}';"


class OpenedLinks:
    """The queries of links that were opened a moment ago, each by a name that nobody can guess.

    Only pages that were really opened have one: no picture, frame or script of another page.
    """

    def __init__(self) -> None:
        self._queries: dict[str, tuple[str, bool]] = {}

    def cookie(self, request: Request) -> str:
        """The cookie for a page that is asked for; one without a query ends that before.

        Browsers say where a link stands (Sec-Fetch-Site), but not to other machines without
        encryption; those let nobody in without a key.
        """
        told, query, name = request.headers, urlsplit(request.path).query, ""
        is_visit = told.get("Sec-Fetch-Dest", "document") == "document"
        if query and is_visit and "Sec-Purpose" not in told:
            name = secrets.token_urlsafe(16)
            is_others = told.get("Sec-Fetch-Site", "none") in _OTHERS
            self._queries[name] = query, is_others
            while len(self._queries) > _MOST_LINKS:
                self._queries.pop(next(iter(self._queries)))
        age_s = _OPENS_FOR_S if name else 0
        return f"{LINK_COOKIE}={name}; HttpOnly; SameSite=Strict; Path=/; Max-Age={age_s}"

    def taken(self, name: str) -> tuple[str, bool]:
        """The query of this name, once, and whether the link stood on another site's page."""
        return self._queries.pop(name, ("", False))


def dressed(answer: Answer, title: str, links: OpenedLinks) -> Answer:
    """The answers of a server, those that are pages with this title and head; keeps their links."""
    head = _HEAD.replace("KEEP_DARK", keep_dark(is_dark=True))
    head = head.replace("NEXT_MS", f"{_NEXT_FILE_MS}")
    head = head.replace("SHEET", f"{100 * PHONE_SHARE:.0f}")
    named = f"<title>{html.escape(title)}</title>{head}".encode()
    made: dict[bytes, bytes] = {}  # pages that were asked for, and as they are answered

    def answered(connection: ServerConnection, request: Request) -> Response | None:
        response = answer(connection, request)
        if response is None or "text/html" not in response.headers.get("Content-Type", ""):
            return response
        body = bytes(response.body)
        if body not in made:
            is_zipped = response.headers.get("Content-Encoding") == "gzip"
            page = gzip.decompress(body) if is_zipped else body
            page = re.sub(rb"<title>[^<]*</title>", lambda _: named, page, count=1)
            made[body] = gzip.compress(page) if is_zipped else page
        response.body = made[body]
        response.headers["Set-Cookie"] = links.cookie(request)
        del response.headers["Content-Length"]
        response.headers["Content-Length"] = str(len(response.body))
        return response

    return answered
