# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A Chromium without a window, driven by a program: takes pictures of the viewer's pages.

What it needs is Debian's chromium and chromium-driver, and selenium (requirements/dev.txt); make
setup brings them. The project's own tests look at the pages by it, too.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Iterator

import psutil
from selenium import webdriver
from selenium.common.exceptions import JavascriptException
from selenium.webdriver.chrome.service import Service

PROGRAMS = ("chromium", "chromedriver")
SCRIPT_SEC = 120
"""Maximum time of a script on a busy machine, s; selenium's own bound is 30 s."""
# WebGL without a graphics card: slow, and right.
WEBGL = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")
# Nothing but what a page itself does.
QUIET = (
    *("--no-first-run", "--disable-extensions", "--disable-sync", "--mute-audio"),
    *("--disable-background-networking", "--disable-component-update", "--hide-scrollbars"),
)


def missing_programs() -> list[str]:
    """Return which of the programs are not on the path."""
    return [name for name in PROGRAMS if shutil.which(name) is None]


class Browser:
    """One window and its page.

    Args:
        driver: Selenium's.
        size: Width and height of the page, pixels.
    """

    def __init__(self, driver: webdriver.Chrome, size: tuple[int, int]) -> None:
        self.driver = driver
        driver.set_script_timeout(SCRIPT_SEC)
        self.resize(size)

    def resize(self, size: tuple[int, int]) -> None:
        """Make the page so many pixels wide and high, whatever frame the window has."""
        width, height = size
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)

    def prefer(self, scheme: str) -> None:
        """Have pages drawn as whoever prefers ``light`` or ``dark`` sees them."""
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})

    def run(self, script: str, *arguments: object) -> Any:
        """Return what the body of a JavaScript function returns."""
        return self.driver.execute_script(script, *arguments)

    def wait_for(self, script: str, *arguments: object, timeout_sec: float = 180.0) -> Any:
        """Return what a function's body returns once that is true.

        Raises:
            TimeoutError: It never was; the page's console is told with it.
        """
        deadline = time.monotonic() + timeout_sec
        failure = "it was never true"
        while time.monotonic() < deadline:
            try:
                value = self.run(script, *arguments)
            except JavascriptException as error:
                failure = str(error.msg)  # the page is not made yet, or another one is coming
            else:
                if value:
                    return value
            time.sleep(0.1)
        told = "\n".join(self.errors()) or "nothing"
        raise TimeoutError(f"{script}: {failure}; the console says: {told}")

    def settled(self, selector: str = "body", timeout_sec: float = 180.0) -> bytes:
        """Return a PNG of an element once it has looked the same for half a second.

        Raises:
            TimeoutError: It never stopped changing.
        """
        deadline = time.monotonic() + timeout_sec
        before = b""
        while time.monotonic() < deadline:
            picture = self.picture(selector)
            if picture == before:
                return picture
            before = picture
            time.sleep(0.5)
        raise TimeoutError(f"{selector} changes for ever")

    def picture(self, selector: str = "body") -> bytes:
        """Return a PNG of the first element that a CSS selector finds."""
        if selector == "body":
            return self.driver.get_screenshot_as_png()
        return self.driver.find_element("css selector", selector).screenshot_as_png

    def errors(self) -> list[str]:
        """Return the errors of the page's console that this was not asked for before."""
        log = self.driver.get_log("browser")
        return [entry["message"] for entry in log if entry["level"] == "SEVERE"]

    def heap_bytes(self) -> int:
        """Return what JavaScript holds of the page, typed arrays included and garbage left out."""
        self.driver.execute_cdp_cmd("HeapProfiler.collectGarbage", {})
        usage = self.driver.execute_cdp_cmd("Runtime.getHeapUsage", {})
        return int(usage["usedSize"] + usage.get("backingStorageSize", 0))

    def resident_bytes(self) -> int:
        """Return what the browser's processes hold of the memory, shared pages once each."""
        processes = psutil.Process(self.driver.service.process.pid).children(recursive=True)
        return sum(process.memory_full_info().pss for process in processes)


@contextmanager
def chromium(size: tuple[int, int] = (1280, 800)) -> Iterator[Browser]:
    """Start a browser with a profile of its own; end it, and what it has started.

    Raises:
        FileNotFoundError: Chromium or its driver is not installed.
    """
    missing = missing_programs()
    if missing:
        raise FileNotFoundError(
            f"{' and '.join(missing)} not found; on Debian: apt-get install chromium "
            "chromium-driver (make setup does it)"
        )
    with tempfile.TemporaryDirectory(prefix="cassandra_ros_chromium_") as home:
        driver = webdriver.Chrome(_options(Path(home)), Service(shutil.which("chromedriver")))
        try:
            yield Browser(driver, size)
        finally:
            driver.quit()


def _options(home: Path) -> webdriver.ChromeOptions:
    options = webdriver.ChromeOptions()
    options.binary_location = str(shutil.which("chromium"))
    for argument in ("--headless=new", f"--user-data-dir={home}", *WEBGL, *QUIET):
        options.add_argument(argument)
    # In a container /dev/shm is small, and root may not have the sandbox that others have.
    options.add_argument("--disable-dev-shm-usage")
    if os.geteuid() == 0:
        options.add_argument("--no-sandbox")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    return options
