# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The description of the API names what the router answers, no less and no more."""

from __future__ import annotations

import re

from viewers import running_viewer

from cassandra_ros.viewing.application import make_application
from cassandra_ros.viewing.openapi import describe
from cassandra_ros.viewing.routes import ROUTES
from cassandra_ros.viewing.viewer_settings import ViewerSettings

PAGES = {"/", "/studio/{name}", "/dygraphs/{name}", "/{name}"}


def test_every_route_of_the_router_is_described():
    router = make_application(ViewerSettings(), None).router
    answered = {
        (route.method, route.resource.canonical)
        for route in router.routes()
        if route.method != "HEAD" and route.resource.canonical not in PAGES
    }
    paths = describe(ROUTES)["paths"]
    described = {(method.upper(), path) for path, found in paths.items() for method in found}
    methods = {route.path: "POST" if route.writes else "GET" for route in ROUTES}
    assert described == answered == {(methods[path], path) for path in methods}
    assert len(ROUTES) == len(described)
    heads = {route.resource.canonical for route in router.routes() if route.method == "HEAD"}
    assert heads - PAGES == {route.path for route in ROUTES if not route.writes}


def test_every_parameter_is_described():
    paths = describe(ROUTES)["paths"]
    for route in ROUTES:
        (found,) = paths[route.path].values()
        assert found["responses"]["200"]["content"]
        shown = {each["name"]: each for each in found["parameters"]}
        assert list(shown) == [*(parameter.name for parameter in route.parameters), "keyspace"]
        for parameter in route.parameters:
            told = shown[parameter.name]
            assert told["required"] == parameter.required
            assert parameter.summary in told["description"]
            default = parameter.default
            wanted = list(default) if isinstance(default, tuple) else default
            assert told["schema"].get("default") == wanted


def references(value):
    if isinstance(value, dict):
        for name, part in value.items():
            yield from [part] if name == "$ref" else references(part)
    elif isinstance(value, list):
        for part in value:
            yield from references(part)


def test_the_document_is_served_and_whole():
    with running_viewer(None) as viewer:
        document = viewer.get("/api/openapi.json")
        for route in ROUTES:
            told = viewer.ask(route.path, {"no_such": 1}, "POST" if route.writes else "GET")
            assert told.status == 400, route.path
            assert "no parameter 'no_such'" in told.json()["text"]
    assert re.fullmatch(r"3\.0\.\d", document["openapi"])
    assert document["info"]["title"]
    for reference in references(document):
        found = document
        for part in reference.lstrip("#/").split("/"):
            found = found[part]
        assert found
