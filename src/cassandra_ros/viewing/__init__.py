# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The viewer: an HTTP server that shows stored messages in a browser, and its pictures.

Each path of its API is an entry in the table ROUTES of a module ``…_routes``, with a plain function
as its handler. The router (application.py) and the API description (openapi.py) are made from these
tables. ``security`` says who may ask; ``handler_threads`` runs a handler on a thread and sends what
it returns. The pages that the browser loads are in the folder *web*. Folders:

- ``drawing/``: pictures by Pillow and matplotlib: images, contact sheets, plots over time.
- ``mapping/``: occupancy grids of stored scans and clouds, and the poses of the sensors.
- ``web/``: the pages, HTML, CSS and JavaScript, as the browser loads them.

In: requests of a browser. Out: JSON, pictures, files.
This room imports files/bag/, stores/fleet/, client/ and what client/ imports. aiohttp, matplotlib
and Pillow come in here.
"""
