# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Pages of a viewer of several stores, of which one does not answer."""

from __future__ import annotations

from fleet.test_fleet import fill, place
from viewers import running_viewer

from cassandra_ros import Fleet


def test_pages_name_who_is_missing_and_offer_what_they_can(window, fresh):
    away = "127.0.0.1:9/ros"
    with fresh() as first, fresh() as second:
        fill(first, "/s", range(5))
        fill(second, "/s", range(5, 9))
        with Fleet([place(first), place(second), away], answer_sec=60.0) as fleet:
            with running_viewer(fleet) as viewer:
                window.errors()
                window.driver.get(viewer.url)
                missing = "return document.querySelector('.missing')?.textContent"
                assert f"Store {away} did not answer" in window.wait_for(missing)
                rows = "return [...document.querySelectorAll('#tables td')].map(e => e.textContent)"
                assert "9" in window.wait_for(f"const r = (() => {{ {rows} }})(); return r[0] && r")
                links = (
                    "return document.querySelector('#head nav a[aria-disabled]') && "
                    "[...document.querySelectorAll('#links a')].map(e => e.textContent)"
                )
                assert window.wait_for(links) == ["Look", "Ask"]
                window.driver.get(f"{viewer.url}/ask.html?q=select+data+from+/s")
                count = "return document.getElementById('ask-rows').dataset.rows"
                assert window.wait_for(count) == "9"
                assert f"Store {away} did not answer" in window.wait_for(missing)
                banner = "return document.getElementById('banner')?.textContent ?? ''"
                assert (window.run(banner), window.errors()) == ("", [])
                window.driver.get(f"{viewer.url}/map.html")
                note = "return document.getElementById('one-store')?.textContent"
                assert "--store-host" in window.wait_for(note)
                window.driver.get("about:blank")
                window.errors()
