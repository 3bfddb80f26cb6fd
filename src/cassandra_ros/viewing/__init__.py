# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The viewer's HTTP server: what is stored, for a browser.

A path of its API is a line in the table ROUTES of a module ``…_routes``, and a plain function; from
the tables come the router (application.py) and the description (openapi.py).
"""
