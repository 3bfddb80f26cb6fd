# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The access rules of the viewer, and the policy for its pages in a browser.

A viewer on loopback can be reached by every page that a browser on this machine shows: the Host
header shows whether the page used a foreign name that points here (DNS rebinding). A viewer that
other machines can reach requires a token, and by default one of a store with a login, for loopback
is open to all users of the machine: in the address once, afterwards as a cookie. Pages of
other sites can read answers only if ``allow_origin`` lists their site.
"""

from __future__ import annotations

import hmac
import ipaddress
from urllib.parse import urlencode, urlsplit

from aiohttp import web
from aiohttp.typedefs import Handler

from cassandra_ros.errors import InvalidOption
from cassandra_ros.printable import shown
from cassandra_ros.viewing.viewer_settings import ViewerSettings

PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self'; "
    "worker-src 'self' blob:; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
"""Content security policy of the viewer's pages. Plots and the Studio need inline styles."""
POLICIES: dict[str, str] = {
    "/look.html": f"{PAGE_POLICY}; frame-src 'self'",
    # The Studio, which Look shows in a frame, compiles its own texts and runs WebAssembly. Stored
    # data never becomes code: definitions are sent as data, and links have no scripts.
    "/studio.html": PAGE_POLICY.replace(
        "script-src 'self'", "script-src 'self' 'unsafe-eval'"
    ).replace("frame-ancestors 'none'", "frame-ancestors 'self'"),
}
"""Content security policies of pages that need another one, by path."""
_ANSWERS = ("/api/", "/window")
"""Beginnings of paths that are answered by handlers instead of files."""
COOKIE_SEC = 30 * 86_400
"""Time for which a browser keeps the cookie, s."""
_READABLE = (
    "Accept-Ranges, Content-Disposition, Content-Length, Content-Range, ETag, X-Map, X-Missing"
)
_REFUSED = (
    "this viewer asks for a token: open the address that it printed when it was started, which "
    "ends with ?token=…"
)


def is_loopback(host: str) -> bool:
    """Return whether an address can be reached from this machine only."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def check_settings(settings: ViewerSettings) -> None:
    """Check that a viewer that other machines can reach has a token.

    Raises:
        InvalidOption: It has no token, or an allowed origin cannot be read.
    """
    if not (is_loopback(settings.host) or settings.token):
        raise InvalidOption(
            f"other machines reach {settings.host} and could read all stored messages: set a token"
        )
    for origin in settings.allow_origin:
        parts = urlsplit(origin)
        if not (parts.scheme and parts.netloc) or parts.path or parts.query or parts.fragment:
            raise InvalidOption(
                f"--allow-origin {origin!r} is not an origin: write scheme and host without a "
                "path, as https://app.foxglove.dev"
            )


def policy_of(path: str) -> str:
    """Return the content security policy of a path; workers have that of their script."""
    return POLICIES.get("/studio.html" if path.startswith("/studio/") else path, PAGE_POLICY)


class Guard:
    """A check of all requests, which also adds the security headers to answers.

    Args:
        settings: Settings of the viewer.
    """

    def __init__(self, settings: ViewerSettings) -> None:
        self._host = settings.host
        self._loopback = is_loopback(settings.host)
        self._token = settings.token
        self._origins = settings.allow_origin
        # The cookie is derived from the token, which cannot be computed from it. Cookies of all
        # ports are shared, so those of two viewers need different names.
        self._kept = hmac.new(self._token.encode(), b"cookie", "sha256").hexdigest()
        self._cookie = f"cassandra_ros_{self._kept[:8]}"

    @web.middleware
    async def check(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Answer a request by ``handler`` if the access rules allow it."""
        self._check_host(request)
        self._check_site(request)
        if request.method == "OPTIONS" and self._allowed_origin(request):
            return web.Response(status=204)
        if self._token:
            if not self._knows_token(request):
                return _refuse(request)
            if "token" in request.query and _is_page(request):
                return self._keep_token(request)
        return await handler(request)

    async def protect(self, request: web.Request, response: web.StreamResponse) -> None:
        """Add the security headers; aiohttp calls this before an answer is sent."""
        headers = response.headers
        headers["X-Content-Type-Options"] = "nosniff"
        headers["Referrer-Policy"] = "no-referrer"
        headers["Content-Security-Policy"] = policy_of(request.path)
        headers["Vary"] = "Origin"
        origin = self._allowed_origin(request)
        headers["Cross-Origin-Resource-Policy"] = "cross-origin" if origin else "same-origin"
        if not origin:
            return
        headers["Access-Control-Allow-Origin"] = origin
        headers["Access-Control-Expose-Headers"] = _READABLE
        if request.method == "OPTIONS":
            headers["Access-Control-Allow-Methods"] = "GET, HEAD"
            headers["Access-Control-Allow-Headers"] = "Authorization, If-Range, Range"
            # Chrome requires it before a page of the internet may reach a private network.
            headers["Access-Control-Allow-Private-Network"] = "true"
            headers["Access-Control-Max-Age"] = "600"

    def _allowed_origin(self, request: web.Request) -> str:
        """Return the origin of the requesting page if it is allowed, else ''."""
        origin = request.headers.get("Origin", "")
        return origin if origin in self._origins else ""

    def _may_lead_here(self, request: web.Request) -> bool:
        """Return whether the page with the followed link belongs to an allowed site.

        Browsers send no Origin then; a page that hides its referrer is refused.
        """
        referrer = request.headers.get("Referer", "")
        return any(f"{referrer}/".startswith(f"{origin}/") for origin in self._origins)

    def _check_host(self, request: web.Request) -> None:
        try:
            host = urlsplit(f"//{request.host}").hostname or ""
        except ValueError:  # [:
            host = ""
        if self._loopback and not is_loopback(host) and host != self._host:
            raise web.HTTPForbidden(
                text=f"this viewer is for this machine only, and does not answer as {host!r}: open "
                "it as localhost, or start it with --host\n"
            )

    def _check_site(self, request: web.Request) -> None:
        """Refuse requests that a page of another site makes without its reader's knowledge.

        Pages of other sites never write, also if they are allowed to read.

        A link on such a page may lead to the viewer's pages, but not to an answer: the page could
        have many expensive answers made by opening them. Clients that do not send their origin
        (curl, old browsers) are accepted.
        """
        headers = request.headers
        origin = headers.get("Origin", "")
        foreign = bool(origin) and origin.partition("://")[2] != request.host
        cross = headers.get("Sec-Fetch-Site") in ("cross-site", "same-site")
        if request.method == "POST" and (foreign or cross):
            raise web.HTTPForbidden(
                text=f"a page of {shown(origin) or 'another site'} may not change what is stored: "
                "--allow-origin only lets it read\n"
            )
        navigates = request.method == "GET" and headers.get("Sec-Fetch-Mode") == "navigate"
        follows_link = navigates and not request.path.startswith(_ANSWERS)
        if not foreign and (not cross or follows_link):
            return
        if not self._allowed_origin(request) and not (navigates and self._may_lead_here(request)):
            raise web.HTTPForbidden(
                text=f"a page of {shown(origin) or 'another site'} may not read this viewer: "
                "start it with --allow-origin and the origin of that page to let it\n"
            )

    def _knows_token(self, request: web.Request) -> bool:
        scheme, _, bearer = request.headers.get("Authorization", "").partition(" ")
        given = (
            (request.query.get("token", ""), self._token),
            (bearer if scheme.lower() == "bearer" else "", self._token),
            (request.cookies.get(self._cookie, ""), self._kept),
        )
        return any(hmac.compare_digest(_bytes(text), _bytes(secret)) for text, secret in given)

    def _keep_token(self, request: web.Request) -> web.Response:
        """Set the cookie and redirect the browser to the address without the token."""
        rest = [(name, text) for name, text in request.query.items() if name != "token"]
        query = f"?{urlencode(rest)}" if rest else ""
        # Relative, with one name: it cannot lead to another site.
        there = f"./{request.rel_url.raw_name}{query}"
        response = web.Response(status=303, headers={"Location": there})
        response.set_cookie(
            self._cookie, self._kept, max_age=COOKIE_SEC, httponly=True, samesite="Strict"
        )
        return response


def _refuse(request: web.Request) -> web.Response:
    """Refuse a client without the token.

    Browsers do not send a strict cookie when a link on another site was followed. The page answered
    then reloads itself: now the request comes from this site, with the cookie if there is one.
    """
    if not _is_page(request):
        raise web.HTTPUnauthorized(text=_REFUSED + "\n")
    followed = request.headers.get("Sec-Fetch-Site") in ("cross-site", "same-site")
    again = '<meta http-equiv="refresh" content="0">' if followed else ""
    page = (
        f"<!DOCTYPE html><html lang=en><meta charset=utf-8>{again}<title>cassandra_ros</title>"
        f"<p>{_REFUSED}</p></html>\n"
    )
    return web.Response(status=401, text=page, content_type="text/html")


def _is_page(request: web.Request) -> bool:
    """Return whether the request is for a page, rather than for a file or an answer."""
    return request.method == "GET" and (request.path == "/" or request.path.endswith(".html"))


def _bytes(text: str) -> bytes:
    return text.encode("utf-8", "surrogateescape")  # headers may hold any bytes
