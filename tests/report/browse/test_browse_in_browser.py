"""The pages in a headless Chromium: from the table to the moment of a failure, on a screen and on a telephone."""

import re
import time

import pytest

from browsed import made_run
from trocar.eval.folder import load_trials
from trocar.report.browse import addresses
from trocar.report.failures import LEAD_S
from trocar.report.files import report_of, write_report

pytest.importorskip("viser")
from browser import NAMES, browser, find_chromium

pytestmark = pytest.mark.skipif(
    find_chromium() is None, reason=f"no Chromium found ({', '.join(NAMES)}): the pages are not looked at"
)
REPLAY = "document.querySelector('iframe').contentDocument.querySelector('.mantine-Slider-thumb')"
TIME_S = f"Number({REPLAY}.getAttribute('aria-valuenow'))"
PAGES = ("", "runs/day%2Fbad/", "runs/torn/", "compare?run=day%2Fgood&run=day%2Fbad", "compare?run=begun")


def go(page, address):
    page.call("Page.navigate", url=address)
    page.until(f"location.href === '{address}' && document.readyState === 'complete'")


def click(page, begins, leads_to):
    """Click the first link whose text begins so, and wait until an expression is true on the page that comes."""
    page.evaluate(f"[...document.links].find(link => link.textContent.startsWith('{begins}')).click()")
    page.until(leads_to)


def test_three_clicks_lead_from_the_table_to_the_moment_of_a_failure(served, folder):
    trial = load_trials(folder / "day" / "good")[0][1]
    begin_s = report_of(trial).failed_s(trial, trial.scores[4]) - LEAD_S
    with browser(1400, 900) as page:
        go(page, served.address)
        click(page, "day/good", "document.querySelector('h1').innerText === 'day/good'")
        click(page, "transfer 5", "document.querySelector('iframe') !== null")
        page.until(f"{REPLAY} && {TIME_S} > {begin_s - 0.1}")
        assert begin_s - 0.1 < page.evaluate(TIME_S) < begin_s + 5.0
        click(page, "transfer 12", f"{TIME_S} > 52.9")
        assert page.evaluate("location.pathname") == "/runs/day%2Fgood/session_01/trial_000/", "it is the same page"
        assert page.errors == []
        here = re.compile(rf"{served.address}|data:|blob:|about:")
        assert [address for address in page.requests if not here.match(address)] == []


def test_two_ticks_and_a_button_lead_to_two_runs_side_by_side(served):
    with browser(1400, 900) as page:
        go(page, served.address)
        page.evaluate("document.querySelectorAll('input[value^=\"day/\"]').forEach(box => box.click())")
        page.evaluate("document.querySelector('button').click()")
        page.until("document.querySelector('h1').innerText === 'day/bad beside day/good'")
        assert "3 sessions that both have" in page.evaluate("document.body.innerText")


def test_on_a_telephone_nothing_is_cut_off_and_the_dark_is_dark(served):
    with browser(390, 844) as page:
        page.call("Emulation.setDeviceMetricsOverride", width=390, height=844, deviceScaleFactor=1, mobile=True)
        shades = {}
        for shade in ("light", "dark"):
            page.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": shade}])
            for address in PAGES:
                go(page, served.address + address)
                assert page.evaluate("document.documentElement.scrollWidth") == 390, address
            shades[shade] = page.picture().mean()
        assert shades["light"] > 200 and shades["dark"] < 80
        go(page, served.address)
        assert page.evaluate(
            "getComputedStyle(document.querySelector('tbody td:nth-child(3)'), '::before').content"
        ) == ('"task"'), "each line of a card has its name"


def test_a_report_opened_from_its_file_plays_its_replay_and_runs_no_script(tmp_path):
    run = made_run(tmp_path / "run", {(1, 0): {1: "NOT_GRASPED"}}, sessions=2)
    write_report(run, load_trials(run)[0])
    with browser(1000, 800) as page:
        go(page, (run / addresses.REPORT).as_uri())
        page.evaluate("document.querySelector('iframe').scrollIntoView()")
        page.until("[...document.images].every(image => image.naturalWidth > 100)")
        inside = page.call("Page.getFrameTree")["frameTree"]["childFrames"][0]["frame"]["id"]
        slider = "document.querySelector('.mantine-Slider-thumb') !== null"
        for _ in range(600):
            world = page.call("Page.createIsolatedWorld", frameId=inside)["executionContextId"]
            found = page.call("Runtime.evaluate", expression=slider, contextId=world)["result"].get("value")
            if found:
                break
            time.sleep(0.2)
        assert found and page.errors == []
        page.evaluate("document.body.insertAdjacentHTML('beforeend', '<img src=x onerror=\"window.ran = 1\">')")
        time.sleep(0.5)
        assert page.evaluate("window.ran") is None, "whatever a file smuggles into the page does nothing"
        click(page, "transfer 2", "location.pathname.endsWith('/session_01/trial_000/replay.html')")
        begins_s = float(page.evaluate("location.hash").removeprefix("#t="))
        assert 7.9 < begins_s < 9.5, "two seconds before the transfer ended"
