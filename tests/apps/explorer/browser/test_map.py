"""The map under a pointer and under keys."""

import re
import time

import pytest


@pytest.fixture
def page(open_page, site):
    """The map."""
    page = open_page(viewport={"width": 1280, "height": 1000})
    page.goto(f"{site}/map")
    page.locator("svg.world.moves").wait_for()
    return page


def seen(page):
    """The map's place and zoom, once it has been drawn."""
    page.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    found = page.locator("svg.world .view").get_attribute("transform") or "translate(0 0) scale(1)"
    left, top, zoom = map(float, re.findall(r"-?[\d.]+", found))
    return left, top, zoom


def until(page, expression):
    """Wait until something holds; the site's policy forbids Playwright's own way."""
    end = time.monotonic() + 20
    while not page.evaluate(expression):
        assert time.monotonic() < end, expression
        page.wait_for_timeout(20)


def centre(dot):
    box = dot.bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def dot_of(page, label):
    return page.locator("svg.world a", has_text=label).first.locator("circle")


OVERLAPS = """() => {
  const boxes = (names) => [...document.querySelectorAll(names)].filter(e => e.checkVisibility())
    .map(e => e.getBoundingClientRect());
  const groups = boxes('svg.world .regions text');
  const dots = boxes('svg.world .dots > :not(.far) text');
  const meet = (a, b) => a.left < b.right - 1 && b.left < a.right - 1
    && a.top < b.bottom - 2 && b.top < a.bottom - 2;
  const covers = (a, i) => [...groups.slice(i + 1), ...dots].some(b => meet(a, b));
  return [groups.length, groups.filter(covers).length];
}"""


@pytest.mark.parametrize("width", [380, 1280])
def test_names_of_groups_cover_no_other_name(page, width):
    page.set_viewport_size({"width": width, "height": 900})
    page.wait_for_timeout(500)
    shown, covering = page.evaluate(OVERLAPS)
    assert (shown >= 3, covering) == (True, 0)


def test_dragging_moves_the_map_and_opens_nothing(page):
    dot = dot_of(page, "bread")
    x, y = centre(dot)
    before = page.url
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 40, y + 20, steps=4)
    page.mouse.up()
    left, top, zoom = seen(page)
    assert left > 0
    assert top == pytest.approx(left / 2, rel=0.01)
    assert zoom == 1
    assert centre(dot) == pytest.approx((x + 40, y + 20), abs=0.5)
    assert page.url == before


def test_a_click_on_a_dot_chooses_it(page):
    dot_of(page, "bread").click()
    page.wait_for_url("**entity=bread")
    assert page.locator("svg.world a.chosen text").text_content() == "bread"
    assert page.locator("svg.world .links path").count() >= 2


@pytest.mark.parametrize("has_keys", [False, True])
def test_buttons_and_keys_zoom_and_move_the_map(page, has_keys):
    def do(name, key):
        page.keyboard.press(key) if has_keys else page.get_by_role("button", name=name).click()
        return seen(page)

    page.locator("svg.world").focus()
    assert do("Zoom in", "+")[2] == pytest.approx(1.4, abs=0.01)
    left, top, zoom = do("Zoom in", "+")
    assert zoom == pytest.approx(1.96, abs=0.01)
    if has_keys:
        assert do("", "ArrowRight")[0] < left
        assert do("", "ArrowDown")[1] < top
    assert do("Zoom out", "-")[2] == pytest.approx(1.4, abs=0.01)
    assert do("Whole map", "0") == (0, 0, 1)


def test_the_map_cannot_be_lost(page):
    page.locator("svg.world").focus()
    for _ in range(60):
        page.keyboard.press("ArrowRight")
    shown = page.evaluate(
        """() => {
          const map = document.querySelector('svg.world').getBoundingClientRect();
          return [...document.querySelectorAll('svg.world circle')].filter(e => {
            const at = e.getBoundingClientRect();
            return at.left > map.left && at.right < map.right
              && at.top > map.top && at.bottom < map.bottom;
          }).length;
        }"""
    )
    assert shown > 5


def test_from_dot_to_dot_by_arrows_and_enter_chooses(page):
    stop = page.locator('svg.world a[tabindex="0"]')
    assert stop.count() == 1
    stop.focus()
    x_of = "document.activeElement.querySelector('circle').cx.baseVal.value"
    x = page.evaluate(x_of)
    page.keyboard.press("ArrowLeft")
    assert page.evaluate(x_of) < x
    page.keyboard.press("ArrowRight")
    assert stop.count() == 1
    chosen = page.evaluate("document.activeElement.querySelector('text').textContent")
    assert page.locator(".links + g path").count() >= 1  # its links are shown
    page.keyboard.press("Enter")
    page.wait_for_url("**entity=**")
    assert page.locator("h1").inner_text() == f"Map: {chosen}"


def test_pointing_at_a_dot_shows_its_links_and_leaving_hides_them(page):
    assert page.locator(".links + g path").count() == 0
    dot_of(page, "flour").hover()
    kinds = page.locator(".links + g path").evaluate_all(
        "paths => paths.map(path => path.getAttribute('class'))"
    )
    assert set(kinds) == {"combines", "makes", "made-of"}
    page.mouse.move(5, 5)
    until(page, "!document.querySelector('.links + g path')")
