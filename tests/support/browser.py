"""A real browser, the system's Chromium, installed first where that is possible; and somebody who
sits at it."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from playwright.sync_api import Browser, sync_playwright

from tests.support.service import ADMIN

A_MINUTE = 120_000  # and another, on a slow machine [ms]
FOCUSED = (
    "[document.activeElement].map(e => e.getAttribute('aria-label') || e.innerText || "
    "e.name || '')[0]"
)
NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
QUIET = (
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)


def chromium() -> str:
    """Returns the path of Chromium. As root on a Debian system it installs a missing one."""
    path = next(filter(None, map(shutil.which, NAMES)), None)
    if path is None and os.geteuid() == 0 and shutil.which("apt-get"):
        for command in (
            ["apt-get", "update", "-qq"],
            ["apt-get", "install", "-y", "-qq", "--no-install-recommends", "chromium"],
        ):
            subprocess.run(command, check=False, capture_output=True, timeout=600)
        path = next(filter(None, map(shutil.which, NAMES)), None)
    return path or pytest.fail(
        "a Chromium is needed: install it (Debian: apt-get install chromium)"
    )


@contextmanager
def browsing() -> Iterator[Browser]:
    """Yields a browser without a window."""
    sandbox = ("--no-sandbox",) if os.geteuid() == 0 else ()
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), args=[*QUIET, *sandbox])
        try:
            yield browser
        finally:
            browser.close()


class Seat:
    """Somebody at a browser; what the page complains of is kept.

    `cookies` are those of somebody who has signed in.
    """

    def __init__(self, browser, service, width=1280, *, cookies=None, scripts=True):
        self.url, self.faults, self.loaded = service.url, [], []
        self.context = browser.new_context(
            viewport={"width": width, "height": 900},
            color_scheme="light",
            java_script_enabled=scripts,
            storage_state=cookies,
        )
        # a browser that has a twelfth of one core gets there, too
        self.context.set_default_timeout(3 * A_MINUTE)
        self.page = self.context.new_page()
        self.page.on("pageerror", lambda error: self.faults.append(str(error)))
        self.page.on(
            "console",
            lambda message: (
                self.faults.append(message.text) if message.type in ("error", "warning") else None
            ),
        )
        self.page.on("response", lambda response: self.loaded.extend([response]))

    def sign_in(self):
        self.go("/sign-in")
        self.page.get_by_label("Token").fill(ADMIN)
        self.page.get_by_role("button", name="Sign in").click()
        self.page.wait_for_url(f"{self.url}/")

    def go(self, path):
        self.page.goto(self.url + path)
        self.page.wait_for_load_state("networkidle")

    def expect_refusal(self, status):
        """A browser notes every refusal as an error of its own; this one is meant."""
        self.faults[:] = [fault for fault in self.faults if str(status) not in fault]

    def press(self, *keys):
        for key in keys:
            self.page.keyboard.press(key)

    def tab_to(self, name):
        """Go on by Tab until what has the focus is called so."""
        for _ in range(200):
            self.press("Tab")
            focused = self.page.evaluate(FOCUSED)
            if name in focused:
                return
        pytest.fail(f"no Tab leads to {name!r}")
