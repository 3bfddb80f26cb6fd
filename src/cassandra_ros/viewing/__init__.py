# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The viewer's HTTP server, which shows stored messages in a browser.

Each path of its API is an entry in the table ROUTES of a module ``…_routes``, with a plain function
as its handler. The router (application.py) and the API description (openapi.py) are made from these
tables.
"""
