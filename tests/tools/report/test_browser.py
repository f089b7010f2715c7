"""The report opens in a browser as it is: nothing missing, nothing fetched, nothing complained."""

import shutil

import pytest

from tools.report import __main__ as tool

COMPLAINTS = ("Log.entryAdded", "Runtime.consoleAPICalled", "Runtime.exceptionThrown")


@pytest.fixture(scope="module", params=["flight", "campaign"])
def page(request, flown_dir, tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    for name in ("one", "two"):
        shutil.copytree(flown_dir, folder / name)
    source = folder / "one" if request.param == "flight" else folder
    return tool.report(source, tmp_path_factory.mktemp("alone"))


def test_it_opens_in_a_browser(browser, page):
    shutil.rmtree(page.with_name("figures"))  # the page alone must do
    session = browser.open(page)
    requests = [
        event["params"]["request"]["url"]
        for event in browser.events
        if event.get("method") == "Network.requestWillBeSent"
    ]
    assert [url for url in requests if not url.startswith("data:")] == [page.as_uri()]
    complaints = [event for event in browser.events if event.get("method") in COMPLAINTS]
    assert not complaints
    widths = browser.evaluate(session, "Array.from(document.images, i => i.naturalWidth)")
    assert len(widths) >= 2
    assert min(widths) > 300
    assert browser.evaluate(session, "document.documentElement.scrollWidth <= innerWidth")
    sections = browser.evaluate(session, "document.querySelectorAll('h2').length")
    links = browser.evaluate(session, "document.querySelectorAll('nav a').length")
    assert links == sections > 2
