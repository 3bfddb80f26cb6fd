# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The Studio in the page Look, as a person handles it."""

from __future__ import annotations

import base64
import contextlib
import json
import time
import zlib

from browser.looking import pixels

BODY = "document.querySelector('iframe#studio')?.contentDocument?.body"
CLOCK = "[data-testid=PlaybackTime-text] input"


class Studio:
    """The Studio in the page, as a person handles it.

    Args:
        window: The browser, with the page Look.
    """

    def __init__(self, window):
        self._window = window
        window.wait_for(f"return {BODY}?.dataset.presence === 'PRESENT'")

    def data(self, name):
        """What the page notes of its player: time (ns), messages (so far), playing."""
        return self._window.run(f"return {BODY}.dataset[arguments[0]]", name)

    @property
    def time_ns(self):
        return int(self.data("time"))

    def await_time(self, condition, timeout_sec=180):
        """Wait until a condition holds of the moment that is shown."""
        await_true(lambda: condition(self.time_ns), lambda: f"it is {self.time_ns}", timeout_sec)

    @contextlib.contextmanager
    def _inside(self):
        driver = self._window.driver
        driver.switch_to.frame("studio")
        try:
            yield driver
        finally:
            driver.switch_to.default_content()

    def press(self, title):
        with self._inside() as driver:
            driver.find_element("css selector", f"button[title='{title}']").click()

    def go_to(self, ns):
        """Type a moment into the player's clock."""
        with self._inside() as driver:
            field = driver.find_element("css selector", CLOCK)
            field.click()
            field.send_keys("\ue009a\ue000", f"{ns // 10**9}.{ns % 10**9:09d}", "\ue007")
            driver.execute_script("document.activeElement.blur()")
        self.await_time(lambda now: now == ns)

    def picture(self, kind):
        """Return the pixels of the first panel of a kind."""
        with self._inside() as driver:
            found = driver.find_element(
                "css selector", f'[data-testid^="panel-mouseenter-container {kind}"]'
            )
            return pixels(found.screenshot_as_png)

    def await_picture(self, kind, condition):
        """Wait until a condition holds of a panel's pixels; return them."""
        found = []

        def holds():
            found[:] = [self.picture(kind)]
            return condition(found[0])

        await_true(holds, lambda: f"{kind} never looked so: {found[0].shape}")
        return found[0]


def await_true(condition, told, timeout_sec=180):
    """Wait until a condition holds; fail with what is told."""
    deadline = time.monotonic() + timeout_sec
    while not condition():
        assert time.monotonic() < deadline, told()
        time.sleep(0.1)


def packed(layout):
    """Return a layout as an address carries it."""
    deflate = zlib.compressobj(wbits=-zlib.MAX_WBITS)
    data = deflate.compress(json.dumps(layout).encode()) + deflate.flush()
    return base64.urlsafe_b64encode(data).decode().rstrip("=")
