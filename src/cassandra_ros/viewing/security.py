# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Whom the viewer answers, and what a page of it may do in a browser.

Who listens on loopback only is asked by every page that a browser on this machine shows: the Host
header tells a name that somebody let point here (DNS rebinding) from ours. Who listens elsewhere is
asked for a token: in the address once, afterwards a cookie. Other sites read nothing but what
``allow_origin`` names.
"""

from __future__ import annotations

import hmac
import ipaddress
from urllib.parse import urlencode, urlsplit

from aiohttp import web
from aiohttp.typedefs import Handler

from cassandra_ros.errors import InvalidOption
from cassandra_ros.viewing.settings import ViewerSettings

PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self'; "
    "worker-src 'self' blob:; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
"""What our pages may load. Styles may be inline: plots and the Studio set them by script."""
POLICIES: dict[str, str] = {}
"""Of pages that need another one, by path."""
_COOKIE_SEC = 30 * 86_400
_EXPOSED = "Accept-Ranges, Content-Length, Content-Range, Content-Disposition, ETag"


def is_loopback(host: str) -> bool:
    """Say whether an address is reached from this machine only."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def check_settings(settings: ViewerSettings) -> None:
    """Refuse to listen for others without a token.

    Raises:
        InvalidOption: So it would be, or an origin is none.
    """
    if not (is_loopback(settings.host) or settings.token):
        raise InvalidOption(
            f"--host {settings.host} can be reached by others, who could read all that is stored: "
            "give --token SECRET too, or --token auto to have one made"
        )
    for origin in settings.allow_origin:
        parts = urlsplit(origin)
        if not (parts.scheme and parts.netloc) or parts.path or parts.query:
            raise InvalidOption(
                f"--allow-origin {origin!r} is no origin: write scheme and host, as "
                "https://app.foxglove.dev, without a path"
            )


class Guard:
    """Lets a request through, or not, and adds the headers that protect who asked.

    Args:
        settings: Of the viewer.
    """

    def __init__(self, settings: ViewerSettings) -> None:
        self._settings = settings
        self._loopback = is_loopback(settings.host)

    @web.middleware
    async def check(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Answer a request by ``handler`` if it may be answered; the outermost of all."""
        self._check_host(request)
        self._check_site(request)
        if request.method == "OPTIONS" and self._allowed(request):
            return web.Response(status=204)
        if self._settings.token and not self._knows_token(request):
            raise web.HTTPUnauthorized(
                text="this viewer asks for a token: open the address that it printed when it was "
                "started, which ends with ?token=…\n"
            )
        if self._settings.token and "token" in request.query and _is_page(request):
            return self._keep_token(request)
        return await handler(request)

    async def protect(self, request: web.Request, response: web.StreamResponse) -> None:
        """Add the headers; aiohttp calls it before an answer of any kind is sent."""
        headers = response.headers
        headers["X-Content-Type-Options"] = "nosniff"
        headers["Referrer-Policy"] = "no-referrer"
        headers["Content-Security-Policy"] = POLICIES.get(request.path, PAGE_POLICY)
        headers["Vary"] = "Origin"
        origin = self._allowed(request)
        if not origin:
            headers["Cross-Origin-Resource-Policy"] = "same-origin"
            return
        headers["Cross-Origin-Resource-Policy"] = "cross-origin"
        headers["Access-Control-Allow-Origin"] = origin
        headers["Access-Control-Expose-Headers"] = _EXPOSED
        if request.method == "OPTIONS":
            headers["Access-Control-Allow-Methods"] = "GET, HEAD"
            headers["Access-Control-Allow-Headers"] = "Range, If-Range"
            headers["Access-Control-Allow-Private-Network"] = "true"
            headers["Access-Control-Max-Age"] = "600"

    def _allowed(self, request: web.Request) -> str:
        origin = request.headers.get("Origin", "")
        return origin if origin in self._settings.allow_origin else ""

    def _check_host(self, request: web.Request) -> None:
        host = urlsplit(f"//{request.host}").hostname or ""
        if self._loopback and not is_loopback(host) and host != self._settings.host:
            raise web.HTTPForbidden(
                text=f"this viewer is for this machine only and does not answer as {host!r}: open "
                "it as localhost, or start it with --host and --token\n"
            )

    def _check_site(self, request: web.Request) -> None:
        """Refuse what another site's page asks for behind the user's back."""
        origin = request.headers.get("Origin", "")
        foreign = bool(origin) and urlsplit(origin).netloc != request.host
        cross = request.headers.get("Sec-Fetch-Site") == "cross-site"
        navigates = request.headers.get("Sec-Fetch-Mode") == "navigate" and request.method == "GET"
        if (foreign or (cross and not navigates)) and not self._allowed(request):
            raise web.HTTPForbidden(
                text=f"a page of {origin or 'another site'} may not read this viewer: start it "
                "with --allow-origin ORIGIN to let it\n"
            )

    def _cookie(self) -> str:
        return f"cassandra_ros_{self._settings.port}"  # browsers know no ports of cookies

    def _knows_token(self, request: web.Request) -> bool:
        scheme, _, bearer = request.headers.get("Authorization", "").partition(" ")
        given = (
            request.query.get("token", ""),
            request.cookies.get(self._cookie(), ""),
            bearer if scheme.lower() == "bearer" else "",
        )
        wanted = self._settings.token.encode()
        # All three are compared, each in constant time.
        return any([hmac.compare_digest(text.encode(), wanted) for text in given])

    def _keep_token(self, request: web.Request) -> web.Response:
        """Put the token into a cookie, and send the browser to the address without it."""
        rest = [(name, text) for name, text in request.query.items() if name != "token"]
        query = f"?{urlencode(rest)}" if rest else ""
        # Relative, of one name: whatever the path, it leads to no other site.
        there = f"./{request.rel_url.raw_name}{query}"
        response = web.Response(status=303, headers={"Location": there})
        response.set_cookie(
            self._cookie(),
            self._settings.token,
            max_age=_COOKIE_SEC,
            httponly=True,
            samesite="Strict",
        )
        return response


def _is_page(request: web.Request) -> bool:
    """Say whether a person opens a page, rather than a program a file or an answer."""
    return request.method == "GET" and (request.path == "/" or request.path.endswith(".html"))
