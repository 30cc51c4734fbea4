"""A browser, and a page that notes every fault: console errors, requests that leave the machine, refused styles."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import pytest
from playwright.sync_api import Browser, Page, ViewportSize, sync_playwright

from tests.support.processes import browser as chromium
from tests.support.processes.cli_process import Server

LOCAL = ("127.0.0.1", "localhost")


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """Chromium, once a worker."""
    program = chromium.program()
    if program is None:
        pytest.skip(chromium.MISSING)
    with sync_playwright() as playwright:
        made = playwright.chromium.launch(executable_path=program, args=list(chromium.ARGUMENTS))
        yield made
        made.close()


class Watched:
    """A page and what went wrong on it; `expected` are parts of console errors that belong to a test."""

    def __init__(self, page: Page, address: str) -> None:
        self.page, self.address = page, address
        self.faults: list[str] = []
        self.expected: list[str] = []
        page.on("console", lambda m: self._note(m.text) if m.type in ("error", "warning") else None)
        page.on("pageerror", lambda e: self._note(str(e)))
        page.on("request", self._request)

    def _note(self, text: str) -> None:
        # Software WebGL is slow, and chromium says so.
        if "GPU stall" not in text and "swiftshader" not in text.lower():
            self.faults.append(text)

    def _request(self, request: Any) -> None:
        host = urlsplit(request.url).hostname
        if host not in LOCAL and not request.url.startswith(("data:", "blob:")):
            self.faults.append(f"a request leaves the machine: {request.url}")

    def open(self, fragment: str = "") -> Page:
        """Go to a view."""
        self.page.goto(f"{self.address}/{fragment}")
        return self.page

    def check(self) -> None:
        """Nothing went wrong."""
        assert [f for f in self.faults if not any(e in f for e in self.expected)] == []


@pytest.fixture
def view(browser: Browser, server: Server, client: httpx.Client) -> Iterator[Callable[..., Watched]]:
    """Open a page of a size: ``view(390, 844)``; its faults are looked at when the test ends."""
    made: list[Watched] = []

    def opened(width: int = 1280, height: int = 900, **more: Any) -> Watched:
        size: ViewportSize = {"width": width, "height": height}
        context = browser.new_context(viewport=size, **more)
        context.set_default_timeout(30_000)
        made.append(Watched(context.new_page(), server.address))
        return made[-1]

    yield opened
    for one in made:
        one.page.context.close()
        one.check()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Where a test puts its files."""
    return tmp_path
