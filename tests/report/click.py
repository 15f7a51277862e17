#!/usr/bin/env python3
"""Clicks through a report in a headless Chromium, and fails on any message of the console.

    python click.py report.html [FOLDER]

needs Playwright for Python and Debian's chromium. With FOLDER, screenshots at 390 and 1440 pixels are left there.
"""

import sys
from pathlib import Path

from playwright.sync_api import sync_playwright

PAINTED = """() => document.getElementById("main").toDataURL()"""


def main(report, folder=None):
    complaints = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
        for width, height in ((390, 844), (1440, 900)):
            page = browser.new_page(viewport={"width": width, "height": height})
            page.on("console", lambda message: complaints.append(message.text))
            page.on("pageerror", lambda error: complaints.append(str(error)))
            page.on("request", lambda request: complaints.append(request.url) if request.url.startswith("http") else None)
            page.goto(Path(report).resolve().as_uri())
            page.wait_for_selector("#viewer:not([hidden])")
            click_through(page)
            wide = page.evaluate("document.documentElement.scrollWidth")
            assert wide <= width, f"the page is {wide} pixels wide on a screen of {width}"
            if folder:
                page.evaluate("scrollTo(0, 0)")
                page.wait_for_timeout(200)
                page.screenshot(path=str(Path(folder) / f"report_{width}.png"), full_page=True)
            page.close()
        without_script(browser, report)
        browser.close()
    assert not complaints, complaints


def click_through(page):
    page.wait_for_timeout(500)
    main_canvas = page.locator("#main")
    main_canvas.scroll_into_view_if_needed()

    def changes(what, act):
        before = page.evaluate(PAINTED)
        act()
        page.wait_for_timeout(250)
        assert page.evaluate(PAINTED) != before, f"{what} changes nothing"

    for name in ("reference", "difference", "flip"):
        changes(name, lambda: page.click(f"#{name}"))
        changes(f"{name} again", lambda: page.click(f"#{name}"))
    main_canvas.focus()
    for key in ("r", "r", "d", "d", "f", "f", "]", "0", "+", "0"):
        changes(f"key {key}", lambda: page.keyboard.press(key))
    # Arms that have not run are there, but have nothing to show.
    cells = page.locator(".cell").all()
    seen = [number for number, cell in enumerate(cells) if cell.is_enabled()]
    for number in seen[:9]:
        page.keyboard.press(str(number + 1))
        page.wait_for_timeout(50)
        assert page.input_value("#a") == str(number)
    cells[seen[-1]].click()
    assert page.input_value("#a") == str(seen[-1])
    cells[seen[0]].click(modifiers=["Shift"])
    assert page.input_value("#b") == str(seen[0])
    view = page.input_value("#view")
    main_canvas.focus()
    page.keyboard.press("ArrowRight")
    assert page.input_value("#view") != view
    box = main_canvas.bounding_box()
    page.mouse.move(box["x"] + box["width"] / 3, box["y"] + box["height"] / 3)
    assert "photo" in page.inner_text("#readout")
    changes("the wheel", lambda: page.mouse.wheel(0, -400))

    def drag(to):
        page.mouse.down()
        page.mouse.move(box["x"] + to * box["width"], box["y"] + box["height"] / 2, steps=4)
        page.mouse.up()

    changes("dragging", lambda: drag(0.25))
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    changes("the wipe", lambda: drag(0.8))
    for details in page.locator("summary").all():
        details.click()
    page.click("#reset")


def without_script(browser, report):
    page = browser.new_context(java_script_enabled=False).new_page()
    page.goto(Path(report).resolve().as_uri())
    assert page.locator("table").count() > 0
    assert page.locator("#thumbs .pic").first.is_visible()
    assert not page.locator("#viewer").is_visible()


if __name__ == "__main__":
    main(*sys.argv[1:])
