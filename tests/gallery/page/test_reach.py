"""The gallery's page in a real Chromium, within everybody's reach: without a network, by name, dark, on a phone."""

import json
import shutil

import axe
import numpy as np
import pytest
from gallery_browser import CHROMIUM, DRIVER, Page

pytestmark = pytest.mark.skipif(
    not (CHROMIUM and DRIVER), reason="needs Chromium: `python tools/gallery_browser.py` gets it"
)


def test_it_loads_without_an_error_and_asks_the_network_for_nothing(page, browser):
    browser.get_log("browser"), browser.get_log("performance")
    page.open()
    page.wait_for("document.querySelector('#ball canvas') && document.querySelector('#sphere circle')")
    assert [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == []
    events = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    asked = [e["params"]["request"]["url"] for e in events if e["method"] == "Network.requestWillBeSent"]
    assert any(url.endswith("plotly.min.js") for url in asked)
    assert {url.split(":")[0] for url in asked} <= {"file", "data", "blob", "about"}
    assert "Network.webSocketCreated" not in {e["method"] for e in events}


ASKS = {
    "connect-src": "fetch('http://127.0.0.1:1').catch(() => {})",
    "img-src": "new Image().src = 'http://127.0.0.1:1/x'",
}


@pytest.mark.parametrize(("directive", "ask"), ASKS.items(), ids=ASKS)
def test_the_network_is_refused_by_the_pages_policy(page, directive, ask):
    page.open()
    refused = (
        "new Promise((resolve) => { setTimeout(resolve, 5000, 'nothing'); document.addEventListener("
        f"'securitypolicyviolation', (event) => resolve(event.effectiveDirective)); {ask}; }})"
    )
    assert page.run(refused) == directive


def test_what_can_be_used_has_a_name_and_pictures_say_what_they_show(page, browser):
    page.open(image="2/3")
    page.title("tetX · test 3")
    nodes = browser.execute_cdp_cmd("Accessibility.getFullAXTree", {})["nodes"]
    used = ("button", "combobox", "searchbox", "spinbutton", "checkbox", "listbox", "option", "image", "link", "dialog")
    found = [(n["role"]["value"], n["name"]["value"]) for n in nodes if not n["ignored"] and n["role"]["value"] in used]
    assert {"button", "combobox", "searchbox", "spinbutton", "checkbox", "listbox", "option", "image"} <= {
        r for r, _ in found
    }
    assert [role for role, name in found if not name.strip()] == []
    assert page.run("document.querySelectorAll('img:not([alt])').length") == 0
    assert page.run("document.getElementById('count').getAttribute('role')") == "status"
    assert "as rendered" in page.run("document.getElementById('image').alt")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_stands_out_in_light_and_dark(page, browser, scheme):
    media = {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", media)
    page.open()
    assert page.run("document.documentElement.dataset.theme") == scheme
    colours = {
        name: page.run("SYMSOL.theme.colour(arguments[0])", name) for name in ("ink", "quiet", "prediction", "accent")
    }
    for ground in ("paper", "panel"):
        behind = page.run("SYMSOL.theme.colour(arguments[0])", ground)
        assert all(contrast(colour, behind) >= 4.5 for colour in colours.values())
    assert axe.faults(browser) == []
    page.run("document.getElementById('theme').click()")  # automatic, then light, whatever the system says
    assert page.run("document.documentElement.dataset.theme") == "light"
    page.run("(() => { localStorage.clear(); SYMSOL.theme; })()")


def contrast(a, b):
    """WCAG's contrast of two colours like #1b1c1e."""

    def luminance(colour):
        levels = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
        linear = np.where(levels <= 0.04045, levels / 12.92, ((levels + 0.055) / 1.055) ** 2.4)
        return linear @ [0.2126, 0.7152, 0.0722]

    dark, light = sorted([luminance(a), luminance(b)])
    return (light + 0.05) / (dark + 0.05)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_on_a_narrow_screen_an_image_opens_over_the_list_and_nothing_sticks_out(page, browser, scheme):
    media = {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", media)
    size = {"width": 390, "height": 800, "deviceScaleFactor": 1, "mobile": True}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    try:
        page.open(object="tetX", split="test", run="")
        assert not page.run("document.getElementById('detail').checkVisibility()")
        assert not page.run("document.getElementById('order').checkVisibility()")
        page.run("document.getElementById('filters-open').click()")
        fields = (
            "[...document.querySelectorAll('#filters :is(input, select, button)')].filter((f) => f.checkVisibility())"
        )
        assert page.run(f"{fields}.length") >= 8
        assert page.run(f"Math.max(...{fields}.map((f) => f.getBoundingClientRect().right))") <= 390
        page.run("document.querySelector('.cell').click()")
        page.title("tetX · test 0")
        assert page.run("document.getElementById('detail').checkVisibility()")
        assert not page.run("document.getElementById('images').checkVisibility()")
        assert page.run("document.documentElement.scrollWidth") <= 390
        assert page.run("document.querySelector('main').scrollWidth") <= 390
        page.run("(document.scrollingElement.scrollBy(0, 5000), 1)")
        assert page.run("document.scrollingElement.scrollTop") == 0  # what is longer scrolls in its frame
        assert axe.faults(browser) == []
        page.run("document.getElementById('close').click()")
        assert page.run("document.getElementById('images').checkVisibility()")
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_a_folder_that_lost_a_file_says_which(browser, gallery, tmp_path):
    lost = Page(browser, shutil.copytree(gallery, tmp_path / "lost"))
    (lost.folder / "sets" / "02-tetX-test" / "00000" / "labels.js").unlink()
    lost.open(image="2/0")
    lost.wait_for("document.getElementById('count').textContent.includes('cannot be')")
    assert "labels.js cannot be loaded" in lost.text("count")
    (lost.folder / "data" / "index.js").unlink()
    browser.get("about:blank")
    browser.get((lost.folder / "index.html").as_uri())
    lost.wait_for("document.getElementById('count').textContent.includes('cannot be')")
    assert "cannot be shown" in lost.text("count")
