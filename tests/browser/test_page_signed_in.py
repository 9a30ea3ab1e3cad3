"""The page where tokens are needed, and where the server goes away: nobody is shown what is not there any more."""

from __future__ import annotations

import re

import pytest

from tests.browser.system import LIMIT_S, system
from tests.transport.test_contract import eventually

expect = pytest.importorskip("playwright.sync_api", reason="needs the Python package playwright").expect
expect.set_options(timeout=LIMIT_S * 1000)

pytestmark = pytest.mark.usefixtures("fleet")

POINTS = re.compile(r"^lidarcodec — [0-9]+ points$")


@pytest.fixture(scope="module")
def secured(running, tmp_path_factory):
    """A server of its own, because nobody gets in any more without a token; it sees the same vehicle."""
    with system(tmp_path_factory.mktemp("secured"), running.meeting) as made:
        yield made


@pytest.fixture(scope="module")
def tokens(secured):
    return {role: secured.token(f"{role}-1", role) for role in ("operator", "viewer")}


def sign_in(page, token):
    page.get_by_label("Token").fill(token)
    page.keyboard.press("Enter")


def test_a_page_without_a_token_asks_for_one_and_takes_none_that_is_wrong(secured, tokens, page_of):
    page = page_of(secured.url)
    expect(page.get_by_label("Token")).to_be_focused()
    assert page.complaints == []
    sign_in(page, "lct_" + "x" * 43)
    expect(page.get_by_role("alert")).to_have_text("This token is not valid.")
    assert eventually(lambda: page.wait_for_timeout(50) or page.complaints, LIMIT_S)
    page.complaints.clear()  # the browser tells of the 401, sometimes later than the page does
    sign_in(page, tokens["operator"])
    expect(page).to_have_title(POINTS)
    expect(page.get_by_role("banner")).to_contain_text("operator-1")
    page.reload()
    expect(page).to_have_title(POINTS)
    page.get_by_role("button", name="Sign out").click()
    expect(page.get_by_label("Token")).to_be_visible()
    page.reload()
    expect(page.get_by_label("Token")).to_be_visible()


def test_a_viewer_sees_everything_and_changes_nothing(secured, tokens, page_of):
    page = page_of(secured.url)
    sign_in(page, tokens["viewer"])
    expect(page).to_have_title(POINTS)
    expect(page.get_by_text("sign in with an operator's token")).to_be_visible()
    expect(page.get_by_label("Codec", exact=True)).to_be_disabled()
    expect(page.get_by_role("button", name="Key frame")).to_be_disabled()
    page.get_by_role("tab", name="Recordings").click()
    expect(page.get_by_role("button", name="Record car-7/lidar")).to_be_disabled()


def test_a_token_that_is_revoked_ends_the_session_and_says_so(secured, page_of):
    page = page_of(secured.url)
    sign_in(page, secured.token("guest", "viewer"))
    expect(page).to_have_title(POINTS)
    secured.revoke("guest")
    expect(page.get_by_role("alert")).to_have_text("This token is no longer valid.")
    expect(page.get_by_role("button", name="Sign in")).to_be_visible()
    expect(page).to_have_title("lidarcodec")
    page.complaints.clear()


@pytest.mark.sweep
def test_a_server_that_goes_away_is_said_to_be_away_and_is_found_again(secured, tokens, page_of):
    page = page_of(secured.url)
    sign_in(page, tokens["operator"])
    expect(page).to_have_title(POINTS)
    secured.stop_server()
    expect(page.get_by_text("No answer from the server")).to_be_visible()
    expect(page.locator(".notice")).to_contain_text(re.compile(r"last frame \d+ s ago"))
    secured.serve()
    expect(page.get_by_text("No answer from the server")).not_to_be_attached()
    expect(page.locator(".notice.none")).to_be_attached()
    page.complaints.clear()  # the browser tells of every address that did not answer
