"""Without a mouse: the content is reached at once, and everything that can be done is reached in turn."""

from playwright.sync_api import Page
from playwright.sync_api import expect as shown

from browser.served import Served, loose
from browser.visits import Browse, Visits

ABLE = (
    "a[href], button:not(:disabled):not([tabindex='-1']), input:not(:disabled), select, textarea, summary, "
    "[tabindex='0']"
)
COUNT = """able => [...document.querySelectorAll(able)]
  .filter((node) => node.checkVisibility({ visibilityProperty: true })).length"""
LOOK = """() => {
  const node = document.activeElement;
  if (node === document.body) return "body";
  const reached = window.reached ??= new Set();
  if (reached.has(node)) return "again";
  reached.add(node);
  const { outlineStyle, outlineWidth } = getComputedStyle(node);
  return outlineStyle !== "none" && outlineWidth !== "0px" ? "seen" : `not seen: ${node.outerHTML.slice(0, 90)}`;
}"""


def test_the_content_is_one_key_away(site: Served, visit: Visits) -> None:
    page = visit(site.url, "#/workers")
    shown(page.locator("table.workers tbody tr")).to_be_visible()
    page.evaluate("document.activeElement.blur()")
    page.keyboard.press("Tab")
    link = page.get_by_role("link", name="Skip to the content")
    shown(link).to_be_focused()
    shown(link).to_be_in_viewport()
    page.keyboard.press("Enter")
    shown(page.get_by_role("main")).to_be_focused()
    shown(page.get_by_role("heading", name="Workers")).to_be_visible()
    assert page.url.endswith("#/workers")


def test_the_tab_key_reaches_everything_and_shows_where_it_is(site: Served, browse: Browse) -> None:
    page = browse(loose(site.urban, "results"))
    shown(page.locator("section[aria-label='The boundary'] tbody tr").first).to_be_visible()
    many = page.evaluate(COUNT, ABLE)
    assert many > 40
    assert walk(page, many) == many


def walk(page: Page, many: int) -> int:
    """Press Tab until it comes round, and return how many places it reached; each has to be seen."""
    page.evaluate("document.activeElement.blur()")
    reached = 0
    for _ in range(many + 2):
        page.keyboard.press("Tab")
        where = page.evaluate(LOOK)
        if where == "again":
            break
        assert where in ("seen", "body"), where
        reached += where == "seen"
    return reached
