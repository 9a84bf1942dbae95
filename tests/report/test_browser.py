"""Clicking through a report in a real browser; skipped where there is none."""

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from axe_core_python.selenium import Axe
from selenium import webdriver
from selenium.common.exceptions import StaleElementReferenceException
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webelement import WebElement
from selenium.webdriver.support.ui import WebDriverWait

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


def drawn(browser: webdriver.Chrome, chart: str) -> None:
    """Wait until a chart has been drawn, which happens when it comes near the screen."""
    plot = browser.find_element(By.ID, f"{chart}-plot")
    browser.execute_script("arguments[0].scrollIntoView()", plot)
    WebDriverWait(browser, 60).until(lambda _: "waiting" not in str(plot.get_attribute("class")))


def value(browser: webdriver.Chrome, script: str) -> Any:
    return browser.execute_script(f"return {script}")


def trace_names(browser: webdriver.Chrome, chart: str) -> list[str]:
    """Names of the traces that a chart shows."""
    shown_ones = f"document.getElementById('{chart}-plot').data.filter(t => t.visible !== false)"
    return value(browser, f"{shown_ones}.map(t => t.name)")


def test_nothing_is_asked_of_the_network_and_nothing_fails(browser: webdriver.Chrome) -> None:
    requested = [
        entry["message"]
        for entry in browser.get_log("performance")
        if "requestWillBeSent" in entry["message"]
    ]
    assert requested
    assert not [message for message in requested if '"url":"http' in message]
    drawn(browser, "errors")
    assert [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == []


def test_the_first_paint_does_not_wait_for_the_charts(browser: webdriver.Chrome) -> None:
    paint_ms = value(browser, "performance.getEntriesByName('first-contentful-paint')[0].startTime")
    assert 0.0 < paint_ms < 2000.0


def test_a_button_hides_an_estimator_everywhere_and_no_other_one(browser: webdriver.Chrome) -> None:
    button = series_button(browser, "ekf")
    row, other_row = (f'tr[data-row="{identifier(name)}"]' for name in ("ekf", "ekf_paper"))
    drawn(browser, "errors")
    top = "document.getElementById('errors-plot')._fullLayout.yaxis.range[1]"
    before = value(browser, top)
    assert trace_names(browser, "errors").count("ekf") == 3
    click(browser, button)
    assert trace_names(browser, "errors").count("ekf") == 0
    assert shown(browser, row) == [False]
    assert trace_names(browser, "errors").count("ekf_paper") == 3
    assert shown(browser, other_row) == [True]
    # A chart that is drawn later knows it, too.
    drawn(browser, "consistency")
    assert "ekf" not in trace_names(browser, "consistency")
    click(browser, button)
    assert trace_names(browser, "errors").count("ekf") == 3
    assert shown(browser, row) == [True]
    others = [series_button(browser, name) for name in ("ekf", "ekf_paper", "dead_reckoning")]
    for other in others:
        click(browser, other)
    # The axes rescale to what is left.
    assert value(browser, top) < before
    for other in others:
        click(browser, other)
    assert value(browser, top) == before


def series_button(browser: webdriver.Chrome, name: str) -> WebElement:
    return browser.find_element(By.CSS_SELECTOR, f'button[data-series="{identifier(name)}"]')


def click(browser: webdriver.Chrome, element: WebElement) -> None:
    """Click where neither the menu nor the slider covers the element."""
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", element)
    element.click()


def test_tabs_show_one_estimator_at_a_time(browser: webdriver.Chrome) -> None:
    panels = "#bounds [role=tabpanel]"
    assert shown(browser, panels).count(True) == 1
    tabs = browser.find_elements(By.CSS_SELECTOR, "#bounds [role=tab]")
    click(browser, tabs[1])
    assert shown(browser, panels) == [k == 1 for k in range(len(tabs))]
    assert tabs[1].get_attribute("aria-selected") == "true"
    assert tabs[0].get_attribute("aria-selected") == "false"


def test_a_heading_sorts_by_number_and_again_the_other_way_round(browser: webdriver.Chrome) -> None:
    heading = browser.find_elements(By.CSS_SELECTOR, "#residuals th button")[3]
    column = "#residuals tbody td:nth-child(4)"
    click(browser, heading)
    values = [float(cell.text) for cell in browser.find_elements(By.CSS_SELECTOR, column)]
    assert values == sorted(values)
    click(browser, heading)
    again = [float(cell.text) for cell in browser.find_elements(By.CSS_SELECTOR, column)]
    assert again == sorted(values, reverse=True)


def test_one_time_moves_slider_lines_markers_and_frames(browser: webdriver.Chrome) -> None:
    for chart in ("errors", "track", "scene"):
        drawn(browser, chart)
    slider = browser.find_element(By.CSS_SELECTOR, '.time input[type="range"]')
    output = browser.find_element(By.CSS_SELECTOR, ".time output")
    line = "document.querySelector('#errors .cursor').getBoundingClientRect().left"
    marker = "document.getElementById('track-plot').data.at(-1).x[0]"
    browser.execute_script("arguments[0].value = 0; arguments[0].dispatchEvent(new Event('input'))", slider)
    before = value(browser, line), value(browser, marker)
    browser.find_element(By.CSS_SELECTOR, '[aria-label="next frame"]').click()
    slider.send_keys(Keys.ARROW_RIGHT)
    assert output.text.startswith("frame 2,")
    assert value(browser, line) > before[0]
    assert value(browser, marker) != before[1]
    assert shown(browser, "#frames figure") == [False, False, True]


def test_hovering_a_chart_sets_the_time(browser: webdriver.Chrome) -> None:
    drawn(browser, "errors")
    plot = browser.find_element(By.ID, "errors-plot")
    axis = "document.getElementById('errors-plot')._fullLayout.xaxis"
    x = value(browser, f"{axis}._offset + {axis}.d2p(charts.errors.data[0].x[1])")
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", plot)
    across = round(x - plot.size["width"] / 2)
    ActionChains(browser).move_to_element_with_offset(
        plot, across, round(-0.4 * plot.size["height"])
    ).perform()
    output = browser.find_element(By.CSS_SELECTOR, ".time output")
    WebDriverWait(browser, 10).until(lambda _: output.text.startswith("frame 1,"))
    assert shown(browser, "#frames figure") == [False, True, False]


def test_a_picture_is_enlarged_by_a_click(browser: webdriver.Chrome) -> None:
    button = next(b for b in browser.find_elements(By.CSS_SELECTOR, ".pictures button") if b.is_displayed())
    click(browser, button)
    dialog = browser.find_element(By.CSS_SELECTOR, "dialog")
    assert dialog.is_displayed()
    dialog.find_element(By.CSS_SELECTOR, "img").click()
    assert not dialog.is_displayed()


def test_dark_and_light(browser: webdriver.Chrome) -> None:
    drawn(browser, "errors")
    ground = "getComputedStyle(document.body).backgroundColor"
    text = "document.getElementById('errors-plot')._fullLayout.font.color"
    light = value(browser, ground), value(browser, text)
    button = browser.find_element(By.CSS_SELECTOR, ".theme")
    click(browser, button)
    dark = value(browser, ground), value(browser, text)
    assert dark[0] != light[0]
    assert dark[1] != light[1]
    click(browser, button)
    assert (value(browser, ground), value(browser, text)) == light


def test_axe_finds_no_barrier_light_or_dark(browser: webdriver.Chrome) -> None:
    browser.set_script_timeout(300)
    for chart in ("errors", "consistency", "track", "scene"):
        drawn(browser, chart)
    for _ in ("light", "dark"):
        found = Axe().run(browser)["violations"]
        assert [(one["impact"], one["id"], one["nodes"][0]["html"][:200]) for one in found] == []
        click(browser, browser.find_element(By.CSS_SELECTOR, ".theme"))


def test_everything_that_can_be_used_has_a_name_and_a_size(browser: webdriver.Chrome) -> None:
    controls = "document.querySelectorAll('button, input, select, summary, a, [role=region]')"
    nameless = f"""Array.from({controls}).filter(e =>
        !(e.getAttribute('aria-label') || e.textContent.trim() || e.labels?.length ||
          e.getAttribute('aria-labelledby'))).map(e => e.outerHTML.slice(0, 90))"""
    own = """Array.from(document.querySelectorAll('.series button, .theme, .time button')).filter(e =>
        e.checkVisibility() && e.getBoundingClientRect().height < 24).length"""
    assert value(browser, nameless) == []
    assert value(browser, own) == 0
    assert value(browser, "document.querySelectorAll('img:not([alt])').length") == 0
    assert value(browser, "document.documentElement.lang") == "en"


def test_the_menu_leads_to_its_section(browser: webdriver.Chrome) -> None:
    browser.find_element(By.CSS_SELECTOR, 'nav a[href="#residuals"]').click()
    assert browser.current_url.endswith("#residuals")


def test_a_telephone_shows_it_without_scrolling_sideways(browser: webdriver.Chrome) -> None:
    telephone = {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", telephone)
    try:
        assert browser.execute_script("return document.documentElement.scrollWidth") == 390
        drawn(browser, "errors")
        drawing = browser.find_element(By.CSS_SELECTOR, "#errors svg.main-svg")
        WebDriverWait(browser, 10).until(lambda _: 300 < drawing.size["width"] <= 390)
        # No column is hidden: a row is a card.
        cells = browser.find_elements(By.CSS_SELECTOR, "#summary tbody tr:first-child td")
        assert all(cell.rect["x"] >= 0 and cell.rect["x"] + cell.rect["width"] <= 390 for cell in cells)
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def _width_px(plot: WebElement, selector: str) -> float:
    return float(plot.find_element(By.CSS_SELECTOR, selector).size["width"])


def test_charts_follow_the_window(browser: webdriver.Chrome) -> None:
    tabs = browser.find_elements(By.CSS_SELECTOR, ".choice [role=tab]")
    plots = browser.find_elements(By.CSS_SELECTOR, ".choice .plot")
    browser.execute_script("arguments[0].scrollIntoView()", tabs[0])
    for tab, plot in ((tabs[1], plots[1]), (tabs[0], plots[0])):
        click(browser, tab)
        WebDriverWait(browser, 20).until(lambda _, plot=plot: plot.find_elements(By.TAG_NAME, "svg"))
    narrow = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", narrow)
    try:
        # One that is on the page, and one whose tab is opened when the window is narrow already.
        for tab, plot in ((tabs[0], plots[0]), (tabs[1], plots[1])):
            click(browser, tab)
            # Drawn anew while it is looked at.
            waiting = WebDriverWait(browser, 10, ignored_exceptions=(StaleElementReferenceException,))
            waiting.until(lambda _, one=plot: 300 < _width_px(one, "svg.main-svg") <= 390)
            waiting.until(lambda _, one=plot: 200 < _width_px(one, ".scatterlayer path.js-line") < 390)
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
        click(browser, tabs[0])


def test_hostile_names_run_no_script(browser: webdriver.Chrome, hostile_page: Path) -> None:
    browser.get_log("browser")
    browser.get(hostile_page.as_uri())
    for chart in ("errors", "residuals-chart"):
        drawn(browser, chart)
    assert browser.title == "Run <img src=x onerror=document.title=2>"
    for button in browser.find_elements(By.CSS_SELECTOR, "button[data-series]"):
        click(browser, button)
        click(browser, button)
    plot = browser.find_element(By.ID, "residuals-chart-plot")
    browser.execute_script("Plotly.Fx.hover(arguments[0], [{curveNumber: 0, pointNumber: 0}])", plot)
    assert browser.title == "Run <img src=x onerror=document.title=2>"
    # The page's own and Plotly.
    assert len(browser.find_elements(By.CSS_SELECTOR, "script:not([type])")) == 2
    assert len(browser.find_elements(By.TAG_NAME, "script")) == 3
    assert not browser.find_elements(By.CSS_SELECTOR, "[onerror], [onload]")
    assert [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == []
