"""The page in a browser: it draws, zooms, shows values and changes its colours, and asks for nothing else."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from dcp_tables.report.chapter import chapter
from dcp_tables.report.page import render
from dcp_tables.report.recorded import gather

from ..browser import Browser
from .flights import CAPTURES

pytestmark = [pytest.mark.tool("chromium"), pytest.mark.part("tools")]
SHOW_ALL = "document.querySelectorAll('[data-plot]').forEach((each) => each.scrollIntoView())"
ALL_SHOWN = "document.querySelectorAll('[data-plot]').length === document.querySelectorAll('[data-shown]').length"
#: All texts of the page and of the shadow trees of Bokeh's elements.
TOOLTIPS = (
    "(function texts(node) { return [...node.querySelectorAll('*')].map((each) => "
    "(each.matches('.bk-Tooltip') ? (each.shadowRoot ?? each).textContent : '') "
    "+ (each.shadowRoot ? texts(each.shadowRoot) : '')).join(' '); })(document)"
)
MODEL = "Bokeh.documents.map((each) => each.roots()[0]).find((each) => each.name.endsWith('{}'))"


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("page") / "page.html"
    path.write_text(render([chapter(gather(str(CAPTURES / "a_bus3.mcap"), "cpp-2.0", None), 1)]))
    return path


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with Browser(tmp_path_factory.mktemp("profile")) as one:
        yield one


def show(browser: Browser, page: Path, *, width: int = 1280, dark: bool = False, touch: bool = False) -> None:
    browser.look(width, 900, dark=dark, touch=touch)
    browser.open(page)
    browser.run(
        "(async () => { for (const each of document.querySelectorAll('[data-plot]')) "
        "{ each.scrollIntoView(); await new Promise((done) => setTimeout(done, 50)); } scrollTo(0, 0); })()"
    )
    browser.wait(ALL_SHOWN)


def test_all_plots_are_drawn_without_errors_and_without_network(browser, page):
    show(browser, page)
    assert browser.complaints == []
    assert [each for each in browser.requests if not each.startswith(("data:", "blob:"))] == [page.resolve().as_uri()]
    drawn = browser.run("Bokeh.documents.length")
    assert drawn == browser.run("document.querySelectorAll('figure').length") == 10
    # Something is on the canvas of each plot, not only its frame.
    blank = browser.run(
        "(() => { const canvases = (node) => [...node.querySelectorAll('*')].flatMap((each) =>"
        " each.tagName === 'CANVAS' ? [each] : each.shadowRoot ? canvases(each.shadowRoot) : []);"
        " return [...document.querySelectorAll('[data-plot]')].filter((place) => canvases(place).every((each) => {"
        " const octets = each.getContext('2d').getImageData(0, 0, each.width, each.height).data, colours = new Set();"
        " for (let at = 0; at < octets.length; at += 4) colours.add(octets.slice(at, at + 3).join());"
        " return colours.size < 9; })).map((place) => place.id); })()"
    )
    assert blank == []


def test_plots_over_time_zoom_together_and_others_do_not(browser, page):
    show(browser, page)
    plan = browser.run(f"{MODEL.format('plan')}.x_range.start")
    browser.run(f"{MODEL.format('seqno')}.x_range.setv({{start: 5000, end: 9000}})")
    for name in ("holding", "height", "load", "age"):
        assert browser.run(f"[{MODEL.format(name)}.x_range.start, {MODEL.format(name)}.x_range.end]") == [5000, 9000]
    assert browser.run(f"{MODEL.format('plan')}.x_range.start") == plan


def test_a_drag_zooms_and_the_pointer_shows_values(browser, page):
    show(browser, page)
    browser.run("document.getElementById('p-01-seqno').scrollIntoView({block: 'center'})")
    box = browser.run(
        "(() => { const view = [...Bokeh.index.roots].find((each) => each.model.name === '01-seqno');"
        " const area = view.canvas_view.el.getBoundingClientRect(), frame = view.frame.bbox;"
        " return [area.left + frame.left, area.top + frame.top, frame.width, frame.height]; })()"
    )
    left, top, width, height = box

    def mouse(kind: str, x: float, y: float, **options: object) -> None:
        browser.call("Input.dispatchMouseEvent", type=kind, x=left + x * width, y=top + y * height, **options)

    span = f"({MODEL.format('seqno')}.x_range.end - {MODEL.format('seqno')}.x_range.start)"
    before = browser.run(span)
    mouse("mousePressed", 0.25, 0.5, button="left", clickCount=1)
    for step in range(1, 6):
        mouse("mouseMoved", 0.25 + 0.1 * step, 0.5, button="left", buttons=1)
    mouse("mouseReleased", 0.75, 0.5, button="left", clickCount=1)
    browser.wait(f"Math.abs({span} / {before} - 0.5) < 0.02")
    # Where a value is drawn, the pointer shows it.
    at = browser.run(
        "(() => { const view = [...Bokeh.index.roots].find((each) => each.model.name === '01-seqno');"
        " const drawn = view.model.renderers[0].data_source.data, middle = view.frame.x_scale;"
        " const { start, end } = view.model.x_range, row = [...drawn.x].findIndex((x) => x > (start + end) / 2);"
        " const frame = view.frame.bbox, y = view.frame.y_scale.compute(drawn.y[row]);"
        " return [(middle.compute(drawn.x[row]) - frame.left) / frame.width, (y - frame.top) / frame.height,"
        " drawn.frame[row]]; })()"
    )
    mouse("mouseMoved", at[0], at[1] + 0.01)
    mouse("mouseMoved", at[0], at[1])
    browser.wait(f"/frame:?\\s*{at[2]:,}/.test({TOOLTIPS}) && /variable 1/.test({TOOLTIPS})")


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_colours_follow_the_scheme_and_the_button(browser, page, dark):
    show(browser, page, dark=dark)

    def colours() -> list[str]:
        found: list[str] = browser.run(
            f"(() => {{ const one = {MODEL.format('seqno')};"
            " return [one.background_fill_color, one.left[0].major_label_text_color,"
            " one.renderers[0].glyph.line_color.value ?? one.renderers[0].glyph.line_color]; })()"
        )
        return found

    schemes = [["#ffffff", "#1c1f23", "#1f6cae"], ["#1c2024", "#e3e6e9", "#62aee8"]]
    assert colours() == schemes[dark]
    browser.run("document.querySelector('.theme').click()")
    assert colours() == schemes[not dark]
    assert browser.run("getComputedStyle(document.body).color") == ["rgb(227, 230, 233)", "rgb(28, 31, 35)"][dark]


def test_the_page_on_a_small_screen(browser, page):
    """Nothing is wider than the screen, labels stay 12 px, a finger scrolls the page, wide tables say that they do."""
    show(browser, page, width=390, touch=True)
    assert browser.run("document.documentElement.scrollWidth") == 390
    assert browser.run(f"{MODEL.format('seqno')}.left[0].major_label_text_font_size") == "12px"
    wider = browser.run("[...Bokeh.index.roots].filter((view) => view.bbox.width > 390).map((view) => view.model.name)")
    assert wider == []
    scrolling = browser.run(
        "[...document.querySelectorAll('.wide')].map((each) => [each.scrollWidth > each.clientWidth + 1,"
        " getComputedStyle(each, '::before').content !== 'none'])"
    )
    assert all(wide == hinted for wide, hinted in scrolling)
    assert any(wide for wide, _ in scrolling)
    browser.run("document.getElementById('p-01-holding').scrollIntoView({block: 'center'})")
    place = browser.run(
        "(() => { const box = document.getElementById('p-01-holding').getBoundingClientRect();"
        " return [box.left + box.width / 2, box.top + box.height / 2]; })()"
    )
    before = browser.run("scrollY")
    browser.call("Input.dispatchTouchEvent", type="touchStart", touchPoints=[{"x": place[0], "y": place[1]}])
    for step in range(10):
        point = {"x": place[0], "y": place[1] - 20 * step}
        browser.call("Input.dispatchTouchEvent", type="touchMove", touchPoints=[point])
    browser.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
    browser.wait(f"scrollY > {before} + 100")
