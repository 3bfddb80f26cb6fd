# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Who is let in, and what a page of the viewer may do: hosts, sites, tokens, folders."""

from __future__ import annotations

import pytest
from viewers import running_viewer

from cassandra_ros.errors import InvalidOption
from cassandra_ros.viewing.application import make_application
from cassandra_ros.viewing.route import Route
from cassandra_ros.viewing.security import is_loopback
from cassandra_ros.viewing.viewer_settings import ViewerSettings

SECRET = "s3cret-/ü"  # noqa: S105
LICHTBLICK = "https://lichtblick.example"


def one(call):
    return 1


ROUTES = [
    Route("/api/one", one, "One."),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder of pages, with a secret beside it."""
    parent = tmp_path_factory.mktemp("pages")
    (parent / "secret.txt").write_text("hush")
    web = parent / "web"
    (web / "modules").mkdir(parents=True)
    (web / "index.html").write_text("<p>home")
    (web / "look.html").write_text("<p>look")
    (web / ".hidden").write_text("hush")
    (web / "modules" / "a.js").write_text("export {};")
    (web / "linked.css").symlink_to(parent / "style.css")
    (parent / "style.css").write_text("p {}")
    return web


@pytest.fixture(scope="module")
def open_viewer(folder):
    # As if the Studio held what the folder of modules holds.
    with running_viewer(None, ROUTES, web=folder, studio=folder / "modules") as viewer:
        yield viewer


@pytest.fixture(scope="module")
def closed_viewer(folder):
    options = {"web": folder, "token": SECRET, "allow_origin": (LICHTBLICK,)}
    with running_viewer(None, ROUTES, **options) as viewer:
        yield viewer


def test_it_answers_on_this_machine_only_under_its_own_names(open_viewer):
    port = open_viewer.port
    for host in ("localhost", "127.0.0.1", "[::1]", "127.1.2.3", f"localhost:{port}"):
        assert open_viewer.ask("/api/one", Host=host).data == b"1", host
    for host in ("evil.example", f"evil.example:{port}", "localhost.evil.example", "[", "10.0.0.1"):
        found = open_viewer.ask("/api/one", Host=host)
        assert found.status == 403, host
        assert "this machine only" in found.json()["text"]
        assert b"home" not in open_viewer.ask("/", Host=host).data


def test_pages_of_other_sites_ask_for_nothing(open_viewer):
    own = {"Origin": open_viewer.url, "Host": f"127.0.0.1:{open_viewer.port}"}
    assert open_viewer.ask("/api/one", **own).status == 200
    assert open_viewer.ask("/api/one", method="POST", body="{}", **own).status == 405
    strange = ("http://\xb5.example", "http://[x")  # bytes that are not UTF-8; no address
    for origin in ("https://evil.example", "null", "http://127.0.0.1:1", *strange):
        found = open_viewer.ask("/api/one", Origin=origin)
        assert found.status == 403
        assert "--allow-origin" in found.json()["text"]
        assert "Access-Control-Allow-Origin" not in found.headers
        assert open_viewer.ask("/api/one", method="POST", body="{}", Origin=origin).status == 403
        assert open_viewer.ask("/api/one", method="OPTIONS", Origin=origin).status == 403
    cross = {"Sec-Fetch-Site": "cross-site"}
    assert open_viewer.ask("/api/one", **cross, **{"Sec-Fetch-Mode": "no-cors"}).status == 403
    followed = open_viewer.ask("/look.html", **cross, **{"Sec-Fetch-Mode": "navigate"})
    assert followed.text == "<p>look"  # links may be sent
    assert found.headers["Cross-Origin-Resource-Policy"] == "same-origin"


OPENED = {"Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "document"}


@pytest.mark.parametrize("path", ["/api/one", "/window.bag", "/window.mcap"])
def test_a_page_of_another_site_opens_no_answer(open_viewer, closed_viewer, path):
    answered = open_viewer.ask(path).status  # curl and old browsers say nothing of a site
    for site in ("cross-site", "same-site"):
        opened = {**OPENED, "Sec-Fetch-Site": site}
        found = open_viewer.ask(path, **opened)
        assert (found.status, "--allow-origin" in found.text) == (403, True), site
        assert open_viewer.ask(path, Referer="https://evil.example/", **opened).status == 403
        assert open_viewer.ask("/look.html", **opened).status == 200  # a link to a page
        let_in = closed_viewer.ask(path, {"token": SECRET}, Referer=f"{LICHTBLICK}/x", **opened)
        assert let_in.status == answered
        for evil in (f"{LICHTBLICK}.evil.example/", f"https://evil.example/?{LICHTBLICK}/", ""):
            found = closed_viewer.ask(path, {"token": SECRET}, Referer=evil, **opened)
            assert found.status == 403, evil
    # Requests from the address bar, a bookmark, and our own pages.
    for site in ("none", "same-origin"):
        assert open_viewer.ask(path, **OPENED, **{"Sec-Fetch-Site": site}).status == answered


def test_a_site_that_is_named_reads(closed_viewer):
    asked = {"Origin": LICHTBLICK, "Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "cors"}
    preflight = {"Access-Control-Request-Private-Network": "true", **asked}
    found = closed_viewer.ask("/api/one", method="OPTIONS", **preflight)
    assert found.status == 204
    assert "Range" in found.headers["Access-Control-Allow-Headers"]
    assert found.headers["Access-Control-Allow-Private-Network"] == "true"
    found = closed_viewer.ask("/api/one", {"token": SECRET}, **asked)
    assert (found.status, found.headers["Access-Control-Allow-Origin"]) == (200, LICHTBLICK)
    assert "Content-Range" in found.headers["Access-Control-Expose-Headers"]
    assert found.headers["Vary"] == "Origin"
    assert closed_viewer.ask("/api/one", **asked).status == 401  # the token is asked of it, too
    assert closed_viewer.ask("/api/one", {"token": SECRET}, Origin="https://x.y").status == 403


def test_nothing_is_answered_without_the_token(closed_viewer):
    for length in range(len(SECRET)):
        part = SECRET[:length]
        assert closed_viewer.ask("/api/one", {"token": part}).status == 401
        bearer = "Bearer " + part.encode().decode("latin-1")
        assert closed_viewer.ask("/api/one", Authorization=bearer).status == 401
    for path in ("/", "/look.html", "/modules/a.js", "/api/one", "/none", "/window.bag"):
        for given in ({}, {"token": ""}, {"token": "wrong"}, {"token": SECRET + "x"}):
            found = closed_viewer.ask(path, given)
            assert found.status == 401, (path, given)
            assert "?token=" in found.text
            assert SECRET not in found.text
    assert closed_viewer.ask("/api/one").json()["error"] == "HTTPUnauthorized"
    assert closed_viewer.ask("/api/one", Authorization="Bearer \xff\xfe").status == 401
    assert closed_viewer.ask("/api/one", {"token": SECRET}).data == b"1"
    bearer = "Bearer " + SECRET.encode().decode("latin-1")
    assert closed_viewer.ask("/api/one", Authorization=bearer).data == b"1"


def test_the_token_goes_from_the_address_into_a_cookie(closed_viewer):
    given = {"token": SECRET, "q": "select a from /b", "topics": "/a,/b"}
    found = closed_viewer.ask("/look.html", given)
    assert found.status == 303
    assert found.headers["Location"] == "./look.html?q=select+a+from+%2Fb&topics=%2Fa%2C%2Fb"
    cookie = found.headers["Set-Cookie"]
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie
    kept = cookie.split(";")[0]
    assert SECRET not in cookie
    assert closed_viewer.ask("/look.html", Cookie=kept).text == "<p>look"
    assert closed_viewer.ask("/api/one", Cookie=kept).data == b"1"
    assert closed_viewer.ask("/api/one", Cookie=kept.replace("=", "x=")).status == 401
    name, value = kept.split("=")
    for length in range(len(value)):
        assert closed_viewer.ask("/api/one", Cookie=f"{name}={value[:length]}").status == 401
    assert closed_viewer.ask("/", {"token": SECRET}).headers["Location"] == "./"
    for path in ("//evil.example/x.html", "/\\evil.example/x.html", "/%2f/evil.example/x.html"):
        there = closed_viewer.ask(path, {"token": SECRET}).headers.get("Location", "./")
        assert there.startswith("./")
        assert "evil" not in there or "/" not in there[2:]


def test_a_link_on_another_site_finds_the_cookie(closed_viewer):
    """A strict cookie comes only when a page of ours asks: the answer loads itself again."""
    followed = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"}
    found = closed_viewer.ask("/look.html", {"time": "1"}, **followed)
    assert found.status == 401
    assert 'http-equiv="refresh"' in found.text
    again = closed_viewer.ask("/look.html", {"time": "1"}, **{"Sec-Fetch-Site": "same-origin"})
    assert again.status == 401
    assert "refresh" not in again.text


@pytest.mark.parametrize(
    "path",
    [
        "/../secret.txt",
        "/modules/../../secret.txt",
        "/%2e%2e/secret.txt",
        "/..%2fsecret.txt",
        "/modules/..%2f..%2fsecret.txt",
        "/%2e%2e%2fsecret.txt",
        "//secret.txt",
        "/modules//a.js",
        "/./secret.txt",
        "/.hidden",
        "/modules",
        "/modules/",
        "/a%00b",
        "/" + "x" * 5000,
        "/studio/../secret.txt",
        "/studio/..%2f..%2fsecret.txt",
        "/studio/react/umd/react.js",
        "/dygraphs/..%2f..%2f..%2f..%2f..%2fetc%2fpasswd",
    ],
)
def test_only_files_of_the_folder_are_sent(open_viewer, path):
    found = open_viewer.ask(path)
    assert found.status == 404
    assert b"hush" not in found.data
    assert found.headers["X-Content-Type-Options"] == "nosniff"


def test_pages_are_sent_with_what_they_may_do(open_viewer):
    found = open_viewer.ask("/")
    assert found.text == "<p>home"
    assert found.headers["Content-Type"].startswith("text/html")
    policy = found.headers["Content-Security-Policy"]
    assert "script-src 'self';" in policy
    assert "frame-ancestors 'none'" in policy
    assert found.headers["X-Content-Type-Options"] == "nosniff"
    assert "javascript" in open_viewer.ask("/modules/a.js").headers["Content-Type"]
    assert open_viewer.ask("/linked.css").text == "p {}"  # as a workspace of catkin has it
    tag = found.headers["ETag"]
    assert open_viewer.ask("/", If_None_Match=tag).status == 304
    assert open_viewer.ask("/look.html", method="HEAD").status == 200
    assert "Access-Control-Allow-Origin" not in found.headers
    # Ours may change with the next start; of the Studio a browser keeps what it made of them.
    assert found.headers["Cache-Control"] == "no-cache"
    assert open_viewer.ask("/studio/a.js").headers["Cache-Control"] == "private, max-age=86400"


def test_a_page_is_found_without_the_ending_of_its_file(open_viewer, closed_viewer):
    for asked, leads in (
        ("/look", "/look.html"),
        ("/look?q=a%20b&start=1", "/look.html?q=a%20b&start=1"),
    ):
        answer = open_viewer.ask(asked)
        assert (answer.status, answer.headers["Location"]) == (302, leads)
    for path in ("//look", "/loo", "/look/", "/../secret.txt", "/.hidden", "/%2e%2e/web/look"):
        assert open_viewer.ask(path).status == 404, path
    assert closed_viewer.ask("/look").status == 401


def test_a_viewer_for_other_machines_needs_a_token():
    for host in ("0.0.0.0", "10.0.0.1", "::", "robot", ""):  # noqa: S104 -- only checked
        with pytest.raises(InvalidOption, match="set a token"):
            make_application(ViewerSettings(host=host), None, ROUTES)
        make_application(ViewerSettings(host=host, token="x"), None, ROUTES)  # noqa: S106
    assert is_loopback("127.0.0.5")
    assert is_loopback("::1")
    for origin in ("lichtblick.example", "*", "https://x.y/path", "https://", ""):
        with pytest.raises(InvalidOption, match="is not an origin"):
            make_application(ViewerSettings(allow_origin=(origin,)), None, ROUTES)


def test_who_listens_for_others_is_asked_under_any_name(folder):
    with running_viewer(None, ROUTES, web=folder, host="0.0.0.0", token="x") as viewer:  # noqa: S104, S106
        assert viewer.ask("/api/one", {"token": "x"}, Host="robot.lab").data == b"1"
