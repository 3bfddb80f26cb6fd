# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The description of the API in OpenAPI 3.0, made from the routes."""

from __future__ import annotations

from typing import Iterable

from cassandra_ros.viewing.answers import Json
from cassandra_ros.viewing.route import KEYSPACE, KINDS, Parameter, Route

_SCHEMAS: dict[str, dict[str, Json]] = {
    "text": {"type": "string"},
    "texts": {"type": "array", "items": {"type": "string"}},
    "lines": {"type": "array", "items": {"type": "string"}},
    "time": {"type": "string"},
    "number": {"type": "number"},
    "count": {"type": "integer", "minimum": 0},
    "flag": {"type": "boolean"},
}
_ERROR: dict[str, Json] = {
    "type": "object",
    "required": ["error", "text"],
    "properties": {
        "error": {"type": "string", "description": "The name of an error of cassandra_ros."},
        "text": {"type": "string", "description": "Cause, place and remedy."},
        "position": {"type": "integer", "description": "InvalidQuery: position in the statement."},
    },
}
_INTRODUCTION = (
    "ROS topics that are stored in Apache Cassandra. Only POST changes what is stored. Times in "
    "answers are decimal texts of nanoseconds since 1970, because JavaScript's numbers cannot hold "
    "them; both ends of a time range are included. Errors are JSON: error (its name) and text."
)


def describe(routes: Iterable[Route]) -> Json:
    """Return the document, which has each route with all its parameters."""
    paths: dict[str, dict[str, Json]] = {}
    for route in routes:
        paths[route.path] = {"post" if route.writes else "get": _operation(route)}
    return {
        "openapi": "3.0.3",
        "info": {"title": "cassandra_ros viewer", "version": "1", "description": _INTRODUCTION},
        "paths": paths,
        "components": {
            "schemas": {"Error": _ERROR},
            "securitySchemes": {"token": {"type": "apiKey", "in": "query", "name": "token"}},
        },
    }


def _operation(route: Route) -> dict[str, Json]:
    error: Json = {"application/json": {"schema": {"$ref": "#/components/schemas/Error"}}}
    return {
        "summary": route.summary,
        "parameters": [_parameter(parameter) for parameter in (*route.parameters, KEYSPACE)],
        "responses": {
            "200": {"description": route.summary, "content": _content(route)},
            "default": {"description": "An error.", "content": error},
        },
    }


def _content(route: Route) -> dict[str, Json]:
    if route.kind == "json":
        return {"application/json": {"schema": {}}}
    return {route.kind: {"schema": {"type": "string", "format": "binary"}}}


def _parameter(parameter: Parameter) -> dict[str, Json]:
    schema = dict(_SCHEMAS[parameter.kind])
    default = parameter.default
    if default is not None:
        schema["default"] = list(default) if isinstance(default, tuple) else default
    entry: dict[str, Json] = {
        "name": parameter.name,
        "in": "query",
        "description": f"{parameter.summary} ({KINDS[parameter.kind]})",
        "required": parameter.required,
        "schema": schema,
    }
    if parameter.kind == "texts":
        entry.update(style="form", explode=False)
    return entry
