# SPDX-License-Identifier: Apache-2.0
"""Headless Chromium for the tests of pages: opening it, its complaints, axe's rules, a keyboard."""
import base64
import os
import shutil

SKIPPED = 77


def open_chromium(folder, size="1280,900"):
    """`folder`: for its profile. The caller quits it."""
    from selenium import webdriver
    options = webdriver.ChromeOptions()
    for flag in ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
                 "--disable-background-networking", f"--window-size={size}",
                 f"--user-data-dir={os.path.join(folder, 'profile')}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    options.binary_location = shutil.which("chromium")
    service = webdriver.ChromeService(executable_path=shutil.which("chromedriver")) if hasattr(
        webdriver, "ChromeService") else webdriver.chrome.service.Service(shutil.which("chromedriver"))
    browser = webdriver.Chrome(service=service, options=options)
    browser.set_page_load_timeout(60)
    return browser


def picture(browser, folder, name, width=960, of=None):
    """The screen as folder/name.png, and at most `width` wide as name.webp, for documents; `of`: this element, however far
    down it lies, in place of what is on the screen."""
    browser.save_screenshot(os.path.join(folder, name + ".png"))
    # In the document's coordinates: what is on the screen of one that was scrolled begins further down.
    x, y, wide, high = browser.execute_script("""
        if (!arguments[0]) return [scrollX, scrollY, innerWidth, innerHeight];
        const at = document.querySelector(arguments[0]).getBoundingClientRect();
        return [at.x + scrollX, at.y + scrollY, at.width, at.height];""", of)
    small = browser.execute_cdp_cmd("Page.captureScreenshot", {
        "format": "webp", "quality": 80, "captureBeyondViewport": of is not None,
        "clip": {"x": x, "y": y, "width": wide, "height": high, "scale": min(1, width / wide)}})
    with open(os.path.join(folder, name + ".webp"), "wb") as file:
        file.write(base64.b64decode(small["data"]))


def complaints(browser):
    return [entry for entry in browser.get_log("browser") if entry["level"] in ("SEVERE", "WARNING")]


def violations(browser, axe):
    """`axe`: the text of axe.min.js."""
    browser.execute_script(axe)  # by the debugger, which no policy of a page keeps out
    found = browser.execute_async_script(
        "const done = arguments[arguments.length - 1];"
        "axe.run(document).then(r => done(r.violations), e => done([{id: String(e), nodes: []}]));")
    return [f"{v['id']}: {[n.get('html') for n in v['nodes']]}" for v in found]


def media(browser, **features):
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia",
                            {"features": [{"name": name.replace("_", "-"), "value": value}
                                          for name, value in features.items()]})


def press(browser, key):
    from selenium.webdriver.common.action_chains import ActionChains
    ActionChains(browser).send_keys(key).perform()


def press_until(browser, key, reached, limit=80):
    """False: the keyboard does not get there."""
    for _ in range(limit):
        press(browser, key)
        if reached(browser.switch_to.active_element):
            return True
    return False
