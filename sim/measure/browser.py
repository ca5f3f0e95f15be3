"""A headless browser on a console's page, with its clock synchronised to the machine's."""

from __future__ import annotations

import shutil
import stat
import tempfile
import time
from pathlib import Path
from typing import Any

from smolbot.core.closeable import Closeable

CHROMIUM, DRIVER = "/usr/bin/chromium", "/usr/bin/chromedriver"

OPTIONS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--no-proxy-server",
)  # fmt: skip

CLOCK_READINGS = 5
"""Looks at the page's clock."""

CLOCK_TOLERANCE = 0.002
"""Seconds by which the wall's clock may have been set right since a page was loaded."""


def find_missing() -> str:
    """Return why there is no browser.

    Returns
    -------
    str
        Empty where there is one.
    """
    gone = [path for path in (CHROMIUM, DRIVER) if not Path(path).is_file()]
    try:
        import selenium  # noqa: F401
    except ImportError:
        gone.append("selenium")
    return f"{', '.join(gone)} is missing (make system-deps)" if gone else ""


class Browser(Closeable):
    """Chromium without a display, and without the rights to go before others, as a user's would be.

    Parameters
    ----------
    width, height : int
        Of the window, in pixels. Software rendering costs a processor.
    """

    def __init__(self, width: int = 1600, height: int = 1000) -> None:
        from selenium import webdriver
        from selenium.webdriver.chrome.options import Options
        from selenium.webdriver.chrome.service import Service

        self._profile = Path(tempfile.mkdtemp(prefix="smolbot-browser-"))
        options = Options()
        options.binary_location = CHROMIUM
        for option in (*OPTIONS, f"--user-data-dir={self._profile / 'profile'}", f"--window-size={width},{height}"):
            options.add_argument(option)
        options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
        self.driver: Any = webdriver.Chrome(options=options, service=Service(str(self._write_plain_driver())))

    def _write_plain_driver(self) -> Path:
        """A driver that cannot raise its priority, where root runs it: chromium would go before the mission."""
        path = self._profile / "driver"
        drop = "setpriv --bounding-set=-sys_nice --inh-caps=-sys_nice " if shutil.which("setpriv") else ""
        path.write_text(f'#!/bin/sh\nexec nice -n 5 {drop}{DRIVER} "$@"\n', encoding="utf-8")
        path.chmod(path.stat().st_mode | stat.S_IXUSR)
        return path

    def open(self, address: str, timeout: float = 60.0) -> None:
        """Load a page, and wait until its bar is connected to the console.

        Parameters
        ----------
        address : str
        timeout : float, in s
        """
        self.driver.get(address)
        end = time.monotonic() + timeout
        while self.read_text("state") in ("", "NO CONTACT"):
            if time.monotonic() > end:
                raise TimeoutError(f"The page at {address} has received nothing within {timeout:g} s.")
            time.sleep(0.1)
        self.driver.execute_script(  # viser's notice that drawing is slow here: nobody has it who has a screen
            "const style = document.createElement('style'); style.textContent = '.mantine-Notifications-root "
            "{ display: none }'; document.head.append(style);"
        )

    def read_text(self, name: str) -> str:
        """Return the text of an element.

        Parameters
        ----------
        name : str
            Its id.

        Returns
        -------
        str
        """
        found = self.driver.execute_script("return document.getElementById(arguments[0])?.textContent || ''", name)
        return str(found)

    def wait_for_text(self, name: str, texts: tuple[str, ...], timeout: float = 60.0) -> str:
        """Wait until an element shows one of some texts.

        Parameters
        ----------
        name : str
            Its id.
        texts : tuple of str
        timeout : float, in s

        Returns
        -------
        str
            The text.

        Raises
        ------
        TimeoutError
            If none appeared in time.
        """
        end = time.monotonic() + timeout
        while (found := self.read_text(name)) not in texts:
            if time.monotonic() > end:
                raise TimeoutError(f"#{name} shows '{found}', and none of {', '.join(texts)} within {timeout:g} s.")
            time.sleep(0.1)
        return found

    def compare_clocks(self) -> tuple[float, float]:
        """Compare the page's clock with the machine's monotonic clock.

        The page reports, by the wall clock, when its own clock began; the difference of the machine's two clocks gives
        the rest. The result is checked against the page's time between two readings of the machine's.

        Returns
        -------
        offset : float, in s
            To add to the page's times.
        uncertainty : float, in s

        Raises
        ------
        RuntimeError
            If they do not agree.
        """
        begun = 1e-3 * float(self.driver.execute_script("return performance.timeOrigin"))
        before, wall, after = time.monotonic(), time.time(), time.monotonic()
        offset = begun - wall + 0.5 * (before + after)
        for _ in range(CLOCK_READINGS):
            before = time.monotonic()
            reported = offset + 1e-3 * float(self.driver.execute_script("return performance.now()"))
            after = time.monotonic()
            if not before - CLOCK_TOLERANCE <= reported <= after + CLOCK_TOLERANCE:
                raise RuntimeError(
                    f"the page's clock is off: {reported:.4f} s is not within {before:.4f} and {after:.4f} s"
                )
        return offset, CLOCK_TOLERANCE

    def watch_clicks(self, *, then_leave: bool = False) -> None:
        """Note when the button is pressed, before any other handler; optionally leave the page right after.

        Parameters
        ----------
        then_leave : bool
        """
        self.driver.execute_script(
            "addEventListener('pointerdown', (event) => localStorage.setItem('pressed', event.timeStamp), true);"
            + ("addEventListener('pointerdown', () => location.replace('about:blank'));" if then_leave else "")
        )

    def press_stop(self) -> None:
        """A real click on STOP, by the driver."""
        from selenium.webdriver.common.action_chains import ActionChains
        from selenium.webdriver.common.by import By

        ActionChains(self.driver, duration=0).click(self.driver.find_element(By.ID, "stop")).perform()

    def read_press_time(self) -> float:
        """Return when the button was pressed.

        Returns
        -------
        float or None, in s
            On the page's clock.
        """
        return 1e-3 * float(self.driver.execute_script("return localStorage.getItem('pressed')"))

    def read_errors(self) -> list[str]:
        """Return the errors in the page's console.

        Returns
        -------
        list of str
        """
        return [entry["message"] for entry in self.driver.get_log("browser") if entry["level"] == "SEVERE"]

    def close(self) -> None:
        """End the browser."""
        self.driver.quit()
        shutil.rmtree(self._profile, ignore_errors=True)
