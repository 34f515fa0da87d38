"""The page in a real browser: it plays, it is found by its links, and it asks for nothing."""

import json
import re
import shutil
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from selenium import webdriver
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import WebDriverWait

from behavexplor.campaign.store import Store
from behavexplor.repair.pairs import AT_FAULT, Pairs
from behavexplor.report.gallery import pack
from behavexplor.report.reading import read_run
from behavexplor.report.run_page import page
from tests.report.test_packing import wandering

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
DRIVER = shutil.which("chromedriver")
PATIENCE = 15  # [s]

pytestmark = pytest.mark.skipif(
    not (BROWSER and DRIVER), reason="needs a browser: apt-get install chromium chromium-driver"
)

PIXELS = """
const canvas = arguments[0], width = canvas.width, height = canvas.height;
return Array.from(new Uint32Array(canvas.getContext("2d").getImageData(0, 0, width, height).data.buffer));
"""


@pytest.fixture(scope="module")
def chrome():
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    for argument in ("headless=new", "no-sandbox", "disable-gpu", "disable-dev-shm-usage", "window-size=1200,900"):
        options.add_argument(f"--{argument}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    yield driver
    driver.quit()


@pytest.fixture(scope="module")
def url(run, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "report.html"
    path.write_text(page([read_run(run)], 100))
    return path.as_uri()


@pytest.fixture
def browser(chrome, url):
    """The page, freshly loaded; in the end nothing was asked for and nothing was complained about."""
    chrome.get("about:blank")
    chrome.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    chrome.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})
    for kind in ("performance", "browser"):
        chrome.get_log(kind)
    chrome.get(url)
    yield chrome
    asked = [json.loads(entry["message"])["message"] for entry in chrome.get_log("performance")]
    sent = [event["params"]["request"]["url"] for event in asked if event["method"] == "Network.requestWillBeSent"]
    assert [address for address in sent if not address.startswith(("file:", "data:", "about:"))] == []
    assert len({address.split("#")[0] for address in sent if address.startswith("file:")}) <= 1
    complaints = [entry for entry in chrome.get_log("browser") if entry["source"] != "rendering"]  # of `PIXELS`
    assert complaints == []


def wait(browser, condition):
    return WebDriverWait(browser, PATIENCE, poll_frequency=0.05).until(lambda _: condition())


class Card:
    """One card of the gallery, as a person uses it."""

    def __init__(self, browser, index=0):
        self.browser = browser
        self.element = browser.find_elements("css selector", ".card")[index]
        self.canvas, self.scrub, self.button, self.output, self.view = (
            self.element.find_element("css selector", name) for name in ("canvas", ".scrub", ".play", ".time", ".view")
        )
        browser.execute_script("arguments[0].scrollIntoView({block: 'center', behavior: 'instant'})", self.element)
        wait(browser, lambda: self.output.text)

    @property
    def time(self):
        return float(re.match(r"([\d.]+) s", self.output.text)[1])

    @property
    def speed(self):
        return float(re.search(r"([\d.]+) m/s", self.output.text)[1])

    def pixels(self):
        return np.array(self.browser.execute_script(PIXELS, self.canvas), dtype=np.uint32)

    def put(self, frame):
        script = "arguments[0].value = arguments[1]; arguments[0].dispatchEvent(new Event('input'))"
        self.browser.execute_script(script, self.scrub, frame)

    def press(self, *keys):
        self.browser.execute_script("arguments[0].focus({preventScroll: true})", self.canvas)
        self.canvas.send_keys(*keys)


def background(browser):
    return browser.execute_script("return getComputedStyle(document.body).backgroundColor")


def light(color):
    return sum(map(int, re.findall(r"\d+", color)[:3])) > 600


def test_a_replay_plays_and_pauses(browser):
    card = Card(browser)
    assert len(np.unique(card.pixels())) > 20
    card.put(0)
    start = card.pixels()
    assert card.time == 0
    card.button.click()
    assert card.button.get_attribute("aria-label") == "Pause"
    wait(browser, lambda: card.time > 0.5)
    card.button.click()
    paused = card.time
    assert card.button.get_attribute("aria-label") == "Play"
    assert not np.array_equal(card.pixels(), start)
    assert len(np.unique(card.pixels())) > 20
    assert card.time == paused


def test_the_scrub_shows_the_recorded_time_and_speed(browser, run):
    card = Card(browser)
    number = int(card.element.find_element("css selector", ".pick").get_attribute("value"))
    store = Store.read(run)
    trace = store.execution(number).load_trace()
    store.close()
    speed = np.hypot(*trace.velocity[:, 0].T)
    before = None
    for frame in (0, 20, 45):
        card.put(frame)
        assert card.time == pytest.approx(frame * 0.1, abs=0.051)
        assert card.speed == pytest.approx(speed[np.searchsorted(trace.time, frame * 0.1 - 1e-9)], abs=0.051)
        assert before is None or not np.array_equal(card.pixels(), before)
        before = card.pixels()


@pytest.mark.parametrize(("frames", "span"), [(1, 300.0), (400, 300.0), (90, 9000.0)])
def test_the_script_unpacks_what_was_packed(browser, frames, span):
    """Wandering vehicles, whose differences need all 16 bits, and headings that turn round and round."""
    given = wandering(frames, span=span)
    packed = pack(given, 0)
    source = (files("behavexplor.report") / "page.js").read_text()
    function = re.search(r"  async function unpack.*?\n  }\n", source, re.DOTALL)[0]
    plain = "({time: [...m.time], speed: [...m.speed], cars: m.cars.map((c) => [[...c.x], [...c.y], [...c.heading]])})"
    script = f"{function} unpack(arguments[0]).then((m) => arguments[1]({plain}));"
    motion = browser.execute_async_script(script, packed.values())
    x, y, heading = np.array(motion["cars"]).transpose(1, 2, 0)
    assert np.abs(np.stack([x, y], -1) - given.position[packed.kept]).max() <= 0.501 * packed.unit
    assert np.abs(np.array(motion["time"]) - given.time[packed.kept]).max() <= 0.0051
    assert np.abs(np.array(motion["speed"]) - np.hypot(*given.velocity[packed.kept, 0].T)).max() <= 0.0051
    turned = (heading - given.heading[packed.kept]) / (2 * np.pi)
    assert np.abs(turned - np.rint(turned)).max() <= 1e-5


def test_the_keyboard_drives_the_replay(browser):
    card = Card(browser)
    card.press(Keys.HOME)
    assert card.time == 0
    card.press(Keys.ARROW_RIGHT, Keys.ARROW_RIGHT, Keys.ARROW_RIGHT, Keys.ARROW_LEFT)
    assert card.time == pytest.approx(0.2)
    following = card.pixels()
    card.press("f")
    assert card.view.get_attribute("aria-pressed") == "false"
    assert not np.array_equal(card.pixels(), following)
    card.press(Keys.END)
    end = card.time
    card.press("v")
    assert card.time == pytest.approx(max(end - 5, 0), abs=0.1)
    card.press(Keys.SPACE)
    wait(browser, lambda: card.time > end - 4.5)
    card.press(Keys.SPACE)
    assert card.button.get_attribute("aria-label") == "Play"


def test_all_can_be_reached_with_the_tab_key(browser):
    Card(browser)
    browser.execute_script("scrollTo({top: 0, behavior: 'instant'}); document.querySelector('.skip').focus()")
    reached = ["skip"]
    for _ in range(14):
        browser.switch_to.active_element.send_keys(Keys.TAB)
        element = browser.switch_to.active_element
        reached.append(element.get_attribute("class") or element.get_attribute("id") or element.tag_name)
    places = [reached.index(name) for name in ("skip", "theme", "anchor", "canvas", "scrub", "play", "view")]
    assert places == sorted(places)


@pytest.mark.parametrize("form", ["#1/{class_id}/{execution}", "#1/{execution}"])
def test_a_deep_link_opens_its_replay(browser, url, run, form):
    """Of the last class, and of an execution that is not the one shown first where there is another."""
    findings = list(read_run(run).classes.values())[-1]
    link = form.format(class_id=findings[0].class_id, execution=findings[-1].id)
    browser.get("about:blank")
    browser.get(url + link)
    here = wait(browser, lambda: browser.find_elements("css selector", ".card.here"))[0]
    assert here.get_attribute("data-class") == findings[0].class_id
    wait(browser, lambda: here.find_element("css selector", ".time").text)
    assert here.find_element("css selector", ".pick").get_attribute("value") == str(findings[-1].id)
    settled = "const box = arguments[0].getBoundingClientRect(); return box.top < innerHeight && box.bottom > 0"
    wait(browser, lambda: browser.execute_script(settled, here))


def test_a_link_to_nowhere_does_no_harm(browser, url):
    for link in ("#1/nothing/99999", "#%E0%A4%A", "#7/1", "#1/__proto__"):
        browser.get("about:blank")
        browser.get(url + link)
        assert Card(browser).time > 0
        assert browser.find_elements("css selector", ".card.here") == []


def test_it_is_dark_or_light_as_the_system_is_and_as_one_wants(browser):
    def prefer(scheme):
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})

    prefer("light")
    card = Card(browser)
    bright = card.pixels()
    assert light(background(browser))
    prefer("dark")
    wait(browser, lambda: not light(background(browser)))
    wait(browser, lambda: not np.array_equal(card.pixels(), bright))
    theme = browser.find_element("id", "theme")
    theme.click()
    assert light(background(browser))
    wait(browser, lambda: np.array_equal(card.pixels(), bright))
    theme.click()
    assert not light(background(browser))
    assert theme.text == "Colors: dark"


def test_a_phone_shows_it_without_scrolling_sideways(browser):
    metrics = {"width": 360, "height": 740, "deviceScaleFactor": 2, "mobile": True}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    card = Card(browser)
    assert browser.execute_script("return document.documentElement.scrollWidth") == 360
    assert card.canvas.size["width"] > 280
    assert len(np.unique(card.pixels())) > 20


def test_with_reduced_motion_pictures_follow_each_other_slowly(browser):
    features = [{"name": "prefers-reduced-motion", "value": "reduce"}]
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
    card = Card(browser)
    card.put(0)
    script = """
    const done = arguments[1], output = arguments[0].querySelector(".time"), seen = new Set([output.textContent]);
    const note = () => seen.add(output.textContent);
    new MutationObserver(note).observe(output, {childList: true, characterData: true, subtree: true});
    arguments[0].querySelector(".play").click();
    setTimeout(() => done(seen.size), 1800);
    """
    assert 2 <= browser.execute_async_script(script, card.element) <= 5
    smooth = browser.execute_script("return getComputedStyle(document.documentElement).scrollBehavior")
    assert smooth == "auto"


def test_two_drivers_play_together_from_the_same_moment(chrome, run, tmp_path):
    found = read_run(run)
    numbers = tuple(one.id for one in found.findings[:2])
    pairs = [Pairs(AT_FAULT, only_first=numbers, only_second=(), both=0, neither=24 - len(numbers))]
    path = tmp_path / "comparison.html"
    path.write_text(page([found, found], 10, pairs))
    chrome.get(path.as_uri())
    one, other = Card(chrome, 0), Card(chrome, 1)
    wait(chrome, lambda: one.time == other.time > 0)
    one.put(0)
    assert one.time == other.time == 0
    other.button.click()
    wait(chrome, lambda: min(one.time, other.time) > 0.5)
    one.button.click()
    assert {one.button.get_attribute("aria-label"), other.button.get_attribute("aria-label")} == {"Play"}
    assert one.time == pytest.approx(other.time, abs=0.2)
    closed = chrome.find_elements("css selector", ".pair:not([open])")
    assert len(closed) == 1
    chrome.get(f"{path.as_uri()}#1/{numbers[1]}")
    wait(chrome, lambda: closed[0].get_attribute("open"))


def test_hostile_names_run_nothing(chrome, browser, evil_run, tmp_path):
    path = Path(tmp_path / "evil.html")
    path.write_text(page([read_run(evil_run)], 100))
    chrome.get_log("performance")
    chrome.get(path.as_uri())
    card = Card(chrome)
    assert len(np.unique(card.pixels())) > 10
    assert chrome.title.startswith("behavexplor: ")
    assert chrome.find_elements("css selector", "img") == []


def test_charts_have_tables_and_replays_have_names(browser):
    summaries = browser.find_elements("css selector", "figure details summary")
    assert len(summaries) >= 5
    browser.execute_script("arguments[0].scrollIntoView({block: 'center', behavior: 'instant'})", summaries[0])
    summaries[0].click()
    assert browser.find_element("css selector", "figure details[open] td").is_displayed()
    unnamed = """
    const named = (e) => e.getAttribute("aria-label") || e.textContent.trim() || e.labels?.length;
    const wanted = "button, input, select, svg[role=img], canvas[role=img], article";
    return [...document.querySelectorAll(wanted)].filter((e) => !named(e)).length;
    """
    assert browser.execute_script(unnamed) == 0


def test_arrow_keys_step_anywhere_in_a_card(browser):
    card = Card(browser)
    before = card.time
    browser.execute_script("arguments[0].focus({preventScroll: true})", card.element)
    card.element.send_keys(Keys.ARROW_LEFT * 5)
    wait(browser, lambda: card.time < before)
    assert re.search(r"state [A-J]$", card.output.text)


def test_a_filter_leaves_the_cards_with_its_words(browser):
    cards = browser.find_elements("css selector", ".card")
    field = browser.find_element("css selector", ".filter input")
    kinds = [card.get_attribute("data-class") for card in cards]
    field.send_keys("R1 RIGHT")
    shown = [card.get_attribute("data-class") for card in cards if card.is_displayed()]
    assert shown == [kind for kind in kinds if kind.startswith("R1") and "right" in kind]
    assert 0 < len(shown) < len(kinds)
    output = browser.find_element("css selector", ".filter output").text
    assert output == f"{len(shown)} of {len(kinds)} cards"
    hidden = next(kind for kind in kinds if kind not in shown)
    browser.execute_script(f"location.hash = '#1/{hidden}'")
    wait(browser, cards[kinds.index(hidden)].is_displayed)
