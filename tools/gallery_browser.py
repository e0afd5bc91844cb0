"""The gallery's page in a headless Chromium, as somebody sees and uses it.

python tools/gallery_browser.py installs Chromium where it is missing and this user may.
"""

import argparse
import contextlib
import shutil
import time
from urllib.parse import urlencode

PACKAGES = {"chromium": "chromium", "chromedriver": "chromium-driver"}  # program: its Debian package
CHROMIUM, DRIVER = (shutil.which(program) for program in PACKAGES)
OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--enable-unsafe-swiftshader",  # plotly's three dimensions without a GPU
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--force-prefers-reduced-motion",  # the ball stands still
    "--window-size=1300,900",
)
WAIT_S = 60
KEYS = {
    "Enter": "\ue007",
    "Escape": "\ue00c",
    "PageUp": "\ue00e",
    "PageDown": "\ue00f",
    "End": "\ue010",
    "Home": "\ue011",
    "ArrowLeft": "\ue012",
    "ArrowUp": "\ue013",
    "ArrowRight": "\ue014",
    "ArrowDown": "\ue015",
}


@contextlib.contextmanager
def chromium(profile):
    """Start one with a folder of its own; it keeps a log of its console and of what it asks for."""
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for option in (*OPTIONS, f"--user-data-dir={profile}"):
        options.add_argument(option)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    try:
        yield driver
    finally:
        driver.quit()


class Page:
    """The page, as somebody sees and uses it."""

    def __init__(self, driver, folder):
        self.driver, self.folder = driver, folder

    def open(self, **address):
        self.driver.get("about:blank")
        self.driver.get(f"{(self.folder / 'index.html').as_uri()}#{urlencode(address)}")
        self.wait_for("document.body.dataset.ready")
        return self

    def run(self, script, *arguments):
        return self.driver.execute_script(f"return {script}", *arguments)

    def wait_for(self, script, *arguments):
        end = time.monotonic() + WAIT_S
        while not (found := self.run(script, *arguments)):
            assert time.monotonic() < end, f"never came true: {script}"
            time.sleep(0.02)
        return found

    def set(self, field, value):
        script = "(() => { const f = document.getElementById(arguments[0]); f.value = arguments[1];"
        self.run(f"{script} f.dispatchEvent(new Event('input', {{bubbles: true}})); }})()", field, value)

    def text(self, field):
        return self.run("document.getElementById(arguments[0]).innerText", field)

    def count(self):
        return int(self.text("count").split()[0].replace(",", ""))

    def press(self, *keys):
        """Press keys by their names, or type characters."""
        self.driver.switch_to.active_element.send_keys(*(KEYS.get(key, key) for key in keys))

    def position(self):
        """Of the image chosen, in the order shown."""
        return int(self.run("document.querySelector('[aria-selected=true]').dataset.position"))

    def camera(self):
        """From where the ball is seen, once it is drawn."""
        eye = "document.getElementById('ball')._fullLayout?.scene?._scene?.getCamera().eye"
        return self.wait_for(f"(({{x, y, z}}) => [x, y, z])({eye} || {{}}).every(Number.isFinite) && {eye}")

    def focused(self):
        return self.run("document.activeElement.id")

    def title(self, wanted):
        """Wait until an image is the one shown, with everything about it."""
        self.wait_for(
            "document.getElementById('detail-title').textContent === arguments[0] && "
            "Boolean(document.getElementById('detail').dataset.shown) && !document.querySelector('#detail').hidden",
            wanted,
        )

    def options(self):
        """The titles of the thumbnails that are in the document, in their order."""
        cells = (
            "[...document.querySelectorAll('[role=option]')].sort((a, b) => a.dataset.position - b.dataset.position)"
        )
        return self.run(f"{cells}.map((c) => c.querySelector('.cell-title').firstChild.textContent)")


def install_missing():
    from symsol_annot.rendering import doctor

    doctor.install([package for program, package in PACKAGES.items() if shutil.which(program) is None])


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    install_missing()
