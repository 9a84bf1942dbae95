"""Clicking through a report in a real browser; skipped where there is none."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from selenium import webdriver
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

from craternav_fg.reports.page import write_page
from craternav_fg.reports.run_page import run_page
from craternav_fg.reports.svg import identifier
from craternav_fg.runs.read import read_run

CHROMIUM = shutil.which("chromium")
DRIVER = shutil.which("chromedriver")
pytestmark = pytest.mark.skipif(
    CHROMIUM is None or DRIVER is None,
    reason="needs Chromium and its driver (Debian: chromium, chromium-driver)",
)

FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--window-size=1200,900",
)  # fmt: skip


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory, made_run: Path) -> Iterator[webdriver.Chrome]:
    page = tmp_path_factory.mktemp("page") / "report.html"
    write_page(run_page(read_run(made_run)), page)
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM or ""
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(flag)
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    try:
        driver.get(page.as_uri())
        yield driver
    finally:
        driver.quit()


def shown(browser: webdriver.Chrome, selector: str) -> list[bool]:
    return [element.is_displayed() for element in browser.find_elements(By.CSS_SELECTOR, selector)]


def test_nothing_is_asked_of_the_network_and_nothing_fails(browser: webdriver.Chrome) -> None:
    requested = [
        entry["message"]
        for entry in browser.get_log("performance")
        if "requestWillBeSent" in entry["message"]
    ]
    assert requested
    assert not [message for message in requested if '"url":"http' in message]
    assert browser.get_log("browser") == []


def test_a_button_hides_an_estimator_everywhere_and_no_other_one(browser: webdriver.Chrome) -> None:
    ekf, paper = identifier("ekf"), identifier("ekf_paper")
    button = browser.find_element(By.CSS_SELECTOR, f'button[data-series="{ekf}"]')
    # The bounds are in tabs, of which one is shown.
    own, other = (f'section:not(#bounds) g[id*="series--{one}--"]' for one in (ekf, paper))
    assert len(shown(browser, own)) >= 4
    button.click()
    assert not any(shown(browser, own))
    assert shown(browser, f'tr[data-row="{ekf}"]') == [False]
    assert all(shown(browser, other))
    assert shown(browser, f'tr[data-row="{paper}"]') == [True]
    button.click()
    assert all(shown(browser, own))
    assert shown(browser, f'tr[data-row="{ekf}"]') == [True]


def test_tabs_show_one_estimator_at_a_time(browser: webdriver.Chrome) -> None:
    panels = "#bounds [role=tabpanel]"
    assert shown(browser, panels).count(True) == 1
    tabs = browser.find_elements(By.CSS_SELECTOR, "#bounds [role=tab]")
    tabs[1].click()
    assert shown(browser, panels) == [k == 1 for k in range(len(tabs))]
    assert tabs[1].get_attribute("aria-selected") == "true"
    assert tabs[0].get_attribute("aria-selected") == "false"


def test_a_heading_sorts_by_number_and_again_the_other_way_round(browser: webdriver.Chrome) -> None:
    heading = browser.find_elements(By.CSS_SELECTOR, "#residuals th button")[3]
    column = "#residuals tbody td:nth-child(4)"
    heading.click()
    values = [float(cell.text) for cell in browser.find_elements(By.CSS_SELECTOR, column)]
    assert values == sorted(values)
    heading.click()
    again = [float(cell.text) for cell in browser.find_elements(By.CSS_SELECTOR, column)]
    assert again == sorted(values, reverse=True)


def test_frames_are_leafed_through_by_button_and_by_key(browser: webdriver.Chrome) -> None:
    frames = "#frames figure"
    assert shown(browser, frames) == [True, False, False]
    browser.find_element(By.CSS_SELECTOR, '[aria-label="next frame"]').click()
    assert shown(browser, frames) == [False, True, False]
    browser.find_element(By.CSS_SELECTOR, '#frames input[type="range"]').send_keys(Keys.ARROW_RIGHT)
    assert shown(browser, frames) == [False, False, True]


def test_the_menu_leads_to_its_section(browser: webdriver.Chrome) -> None:
    browser.find_element(By.CSS_SELECTOR, 'nav a[href="#residuals"]').click()
    assert browser.current_url.endswith("#residuals")


def test_a_telephone_shows_it_without_scrolling_sideways(browser: webdriver.Chrome) -> None:
    telephone = {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", telephone)
    try:
        assert browser.execute_script("return document.documentElement.scrollWidth") == 390
        drawing = browser.find_element(By.CSS_SELECTOR, "#errors svg")
        assert drawing.size["width"] > 300
        label = browser.find_element(By.CSS_SELECTOR, "#errors svg text")
        assert label.rect["height"] >= 8
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_hostile_names_run_no_script(browser: webdriver.Chrome, hostile_page: Path) -> None:
    browser.get_log("browser")
    browser.get(hostile_page.as_uri())
    assert browser.title == "Run <img src=x onerror=document.title=2>"
    for button in browser.find_elements(By.CSS_SELECTOR, "button[data-series]"):
        button.click()
        button.click()
    assert browser.title == "Run <img src=x onerror=document.title=2>"
    assert len(browser.find_elements(By.TAG_NAME, "script")) == 1
    assert not browser.find_elements(By.CSS_SELECTOR, "[onerror], [onload]")
    assert browser.get_log("browser") == []
