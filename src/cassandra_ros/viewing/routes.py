# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""All routes of the viewer. The router and the API's description are made from them."""

from __future__ import annotations

from cassandra_ros.viewing import (
    ask_routes,
    catalog_routes,
    event_routes,
    image_routes,
    look_routes,
    map_routes,
    near_routes,
    timeline_routes,
    window_routes,
)
from cassandra_ros.viewing.answers import Json
from cassandra_ros.viewing.api_call import ApiCall
from cassandra_ros.viewing.openapi import describe
from cassandra_ros.viewing.route import Route


def _describe(call: ApiCall) -> Json:
    return describe(ROUTES)


ROUTES: tuple[Route, ...] = (
    *catalog_routes.ROUTES,
    *event_routes.ROUTES,
    *timeline_routes.ROUTES,
    *ask_routes.ROUTES,
    *look_routes.ROUTES,
    *window_routes.ROUTES,
    *image_routes.ROUTES,
    *near_routes.ROUTES,
    *map_routes.ROUTES,
    Route("/api/openapi.json", _describe, "This description of the API, in OpenAPI 3."),
)
