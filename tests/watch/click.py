#!/usr/bin/env python3
"""Watches a run in a headless Chromium, and fails on any message of the console.

    python click.py URL [FOLDER]

Needs Playwright for Python and Debian's chromium. With FOLDER, screenshots at 390 and 1440 pixels are left there.
"""

import sys
from pathlib import Path

from playwright.sync_api import sync_playwright

def main(url, folder=None):
    complaints = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
        pages = [watch(browser, url, size, complaints) for size in ((390, 844), (1440, 900))]
        for page in pages:
            page.locator(".running .curve polyline").first.wait_for(state="attached", timeout=120_000)
        shoot(pages, folder, "running")
        for page in pages:
            page.locator("#summary", has_text="The run is over").wait_for(timeout=300_000)
        shoot(pages, folder, "ended")
        for page in pages:
            look_through(page)
        shoot(pages, folder, "picture")
        stranger(browser, url)
        browser.close()
    assert not complaints, complaints


def watch(browser, url, size, complaints):
    page = browser.new_context(viewport=dict(zip(("width", "height"), size))).new_page()
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("request", lambda request: complaints.append(request.url) if not request.url.startswith((url, "data:")) else None)
    page.goto(url)
    return page


def shoot(pages, folder, name):
    for page in pages:
        width = page.viewport_size["width"]
        wide = page.evaluate("document.documentElement.scrollWidth")
        assert wide <= width, f"the page is {wide} pixels wide on a screen of {width}"
        if folder:
            page.screenshot(path=str(Path(folder) / f"watch_{name}_{width}.png"), full_page=name != "picture")


def look_through(page):
    states = dict(page.eval_on_selector_all("#stages tbody tr", "rows => rows.map(row => [row.dataset.stage, row.className])"))
    assert states == {"scene": "done", "fit": "done", "render": "done", "evaluate": "done"}, states
    stages = page.eval_on_selector_all("#pictures section", "all => all.map(one => one.dataset.stage)")
    assert set(stages) == {"scene", "render", "evaluate"}, stages
    picture = page.locator("#pictures section[data-stage=render] button").first
    picture.focus()
    page.keyboard.press("Enter")
    page.locator("#full").wait_for()
    while page.evaluate("document.getElementById('large').naturalWidth") != 96:
        page.wait_for_timeout(50)


def stranger(browser, url):
    page = browser.new_page()
    for address in (url[:-4] + "xyz/", url.rsplit("/", 2)[0] + "/"):
        assert page.request.get(address).status == 404, address
    # A browser resolves `..` itself; tests/cli/watch.rs sends it as it is.
    assert page.request.get(url + "pictures/nobody").status == 404


main(*sys.argv[1:])
