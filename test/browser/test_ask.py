# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Ask: a statement is typed, its rows and plot appear, and a row opens the viewer at its moment."""

from __future__ import annotations

import pytest
from browser.looking import near, pixels
from browser.studio import Studio
from selenium.webdriver import ActionChains
from viewers import running_viewer

BOX = "#ask-q"
CONTROL_ENTER = "\ue009\ue007"
FIRST_FIX = 1368021980238582676
STATEMENT = "select KEY, altitude from /fix"
ANSWERED = (
    "return ['done', 'failed'].includes(document.body.dataset.state) && document.body.dataset.state"
)


def write(window, text):
    """Type into the box of the statement, which is empty."""
    window.wait_for(f"return document.activeElement === document.querySelector('{BOX}')")
    window.driver.switch_to.active_element.send_keys(text)


def text_of(window, selector):
    return window.run("return document.querySelector(arguments[0])?.textContent", selector)


def test_a_statement_is_answered_by_rows_a_plot_and_its_plan(page):
    window = page("/ask.html")
    write(window, STATEMENT)
    # What was offered meanwhile is not taken by it.
    window.driver.switch_to.active_element.send_keys(CONTROL_ENTER)
    assert window.wait_for(ANSWERED) == "done"
    rows = window.run(
        "return [...document.querySelectorAll('#ask-rows tbody tr')].map("
        "row => [row.dataset.time, ...[...row.cells].slice(1).map(cell => cell.textContent)])"
    )
    assert len(rows) == 95
    assert rows[0] == [str(FIRST_FIX), "2013-05-08T14:06:20.238582676Z", "273.2"]
    curve = pixels(window.picture("#plot-panels"))
    assert (~near(curve, (255, 255, 255))).sum() > 200
    window.run("document.getElementById('ask-plan').open = true")
    plan = window.wait_for("return document.querySelector('#ask-plan pre').textContent")
    assert plan
    # The address alone says it all.
    address = window.driver.current_url
    window.driver.get("about:blank")
    window.driver.get(address)
    assert window.wait_for(ANSWERED) == "done"
    assert window.run("return document.querySelector(arguments[0]).value", BOX) == STATEMENT


@pytest.mark.usefixtures("studio")
def test_a_row_opens_the_viewer_at_its_moment(page):
    window = page("/ask.html", q=f"{STATEMENT} where latitude > 43.40990")
    assert window.wait_for(ANSWERED) == "done"
    row = window.driver.find_elements("css selector", "#ask-rows tbody tr")[2]
    moment = row.get_attribute("data-time")
    row.find_elements("css selector", "td")[2].click()
    window.wait_for("return location.pathname === '/look.html'")
    assert Studio(window).time_ns == int(moment)


def test_what_is_wrong_is_told_with_the_spot(page):
    window = page("/ask.html")
    write(window, "select altitud from /fix" + CONTROL_ENTER)
    assert window.wait_for(ANSWERED) == "failed"
    told = text_of(window, "#ask-error").splitlines()
    assert "did you mean altitude" in told[0]
    assert told[-1].strip() == "^"
    assert told[-2][told[-1].index("^") :].startswith("altitud")
    spot = "const b = document.querySelector(arguments[0]); "
    spot += "return b.value.slice(b.selectionStart, b.selectionEnd)"
    assert window.run(spot, BOX) == "altitud"
    # The browser itself notes each answer that is an error.
    assert all("status of 400" in error for error in window.errors())


def test_topics_and_fields_are_completed(page):
    window = page("/ask.html")
    write(window, "select altitude from /fi")
    window.wait_for(
        "return document.querySelector('#ask-offers li')?.textContent.startsWith('/fix')"
    )
    window.driver.switch_to.active_element.send_keys("\ue004")
    written = "return document.querySelector(arguments[0]).value"
    assert window.run(written, BOX) == "select altitude from /fix"
    window.driver.switch_to.active_element.send_keys(" where lat")
    window.wait_for(
        "return document.querySelector('#ask-offers li')?.textContent.startsWith('latitude')"
    )


def test_a_plot_that_never_is_complete_is_not_asked_for_without_end(page):
    """As of more buckets than the viewer remembers; the page is done, and shows what it has."""
    window = page("/ask.html")
    window.run(
        "const ask = window.fetch; window.plots = 0;"
        "window.fetch = async (...asked) => {"
        "  const answer = await ask(...asked);"
        "  if (!String(asked[0]).includes('/api/plot')) return answer;"
        "  window.plots += 1;"
        "  const found = {...await answer.json(), complete: false};"
        "  return new Response(JSON.stringify(found),"
        "    {headers: {'Content-Type': 'application/json'}});"
        "};"
    )
    write(window, STATEMENT + CONTROL_ENTER)
    assert window.wait_for(ANSWERED) == "done"
    assert window.run("return window.plots") == 4


def test_columns_are_drawn_over_another_one_of_them(page):
    window = page("/ask.html", q="select latitude, longitude, altitude from /fix")
    assert window.wait_for(ANSWERED) == "done"
    over = "return [...document.querySelectorAll('#plot-over option')].map((o) => o.text)"
    assert window.run(over) == ["time", "latitude", "longitude", "altitude"]
    graphs = "document.querySelectorAll('#plot-panels div.graph').length"
    assert window.run(f"return {graphs}") == 3  # a panel each
    window.run(
        "const s = document.querySelector('#plot-over'); s.value = 'longitude';"
        "s.dispatchEvent(new Event('change'))"
    )
    curves = "document.querySelectorAll('#plot-panels canvas.xy').length"
    assert window.wait_for(f"return {curves} === 2 && {graphs} === 0")
    picture = pixels(window.picture("#plot-panels canvas.xy"))
    assert (~near(picture, (255, 255, 255))).sum() > 200
    # The address holds it, and a click leads to the moment.
    address = window.driver.current_url
    assert "over=longitude" in address
    window.driver.get("about:blank")
    window.driver.get(address)
    assert window.wait_for(ANSWERED) == "done"
    window.driver.find_element("css selector", "#plot-panels canvas.xy").click()
    link = window.wait_for("return document.querySelector('#plot-moment a')?.href")
    assert "/look.html" in link
    # Back to time: what draws over time draws again.
    window.run(
        "const s = document.querySelector('#plot-over'); s.value = '';"
        "s.dispatchEvent(new Event('change'))"
    )
    window.wait_for(f"return {graphs} === 3 && {curves} === 0")


GRAPHS = "document.querySelectorAll('#plot-panels div.graph').length"


def with_second(window, text):
    """Type what else is drawn, in place of what stands there; wait until it is drawn."""
    field = window.driver.find_element("css selector", "#plot-with")
    field.clear()
    field.send_keys(text + "\ue007")
    # The page begins to work in the step in which it writes the address.
    written = "return new URLSearchParams(location.search).get('with') === arguments[0]"
    window.wait_for(written, text)
    assert window.wait_for(ANSWERED) == "done"


def test_two_topics_are_drawn_in_one_picture_with_an_axis_for_each_unit(page):
    second = "select linear_acceleration.z from /imu/data"
    window = page("/ask.html", q=STATEMENT, **{"with": second})
    assert window.wait_for(ANSWERED) == "done"
    assert window.run(f"return {GRAPHS}") == 1
    legend = window.run(
        "return [...document.querySelectorAll('#plot-panels .legend li')].map((e) => e.innerText)"
    )
    assert [text.strip() for text in legend] == [
        "/fix altitude",
        "m, ← left",
        "/imu/data linear_acceleration.z",
        "m/s², right →",
    ]
    labels = "return document.querySelectorAll('#plot-panels .dygraph-axis-label-y2').length"
    assert window.run(labels) > 1
    curves = pixels(window.picture("#plot-panels"))
    for colour in ((0x2F, 0x7F, 0xE6), (0xE0, 0x70, 0x2F)):
        assert near(curves, colour).sum() > 100, colour
    # A value of the other topic is that before the pointer's time.
    window.run("document.querySelector('#plot-panels').scrollIntoView()")
    graph = window.driver.find_element("css selector", "#plot-panels div.graph")
    ActionChains(window.driver).move_to_element(graph).perform()
    values = "[...document.querySelectorAll('#plot-panels .legend .mono')].map((e) => e.innerText)"
    shown = window.wait_for(f"const v = {values}; return v.every(Boolean) && v")
    assert 270 < float(shown[0].split(" … ")[0]) < 280
    # Both are zoomed, and stay in the address.
    window.run("document.getElementById('plot-in').click()")
    window.wait_for("return location.search.includes('start=')")
    assert window.wait_for(ANSWERED) == "done"
    assert window.run(f"return {GRAPHS}") == 1
    assert "with=select" in window.driver.current_url
    # Over another column there are only those of its own statement.
    place = "select latitude, longitude from /fix"
    window = page("/ask.html", q=place, over="/fix longitude", **{"with": second})
    assert window.wait_for(ANSWERED) == "done"
    over = "return [...document.querySelectorAll('#plot-over option')].map((o) => o.text)"
    assert window.run(over) == ["time", "/fix latitude", "/fix longitude"]
    names = "[...document.querySelectorAll('#plot-panels .legend button')].map((e) => e.innerText)"
    assert [text.strip() for text in window.run(f"return {names}")] == ["/fix latitude"]


def test_a_whole_topic_is_drawn_beside_a_statement(page):
    window = page("/ask.html", q=STATEMENT)
    assert window.wait_for(ANSWERED) == "done"
    offered = "return [...document.querySelectorAll('#plot-topics option')].map((o) => o.value)"
    assert "/imu/data" in window.run(offered)
    with_second(window, "/imu/data")
    assert window.run(f"return {GRAPHS}") > 1
    assert "/imu/data angular_velocity.x" in text_of(window, "#plot-panels")
    # One that is wrong is told, and the first one stays.
    with_second(window, "select nothing from /imu/data")
    assert "nothing" in text_of(window, "#plot-told")
    assert window.run(f"return {GRAPHS}") == 1
    assert all("status of 400" in error for error in window.errors())


def test_the_topics_stay_in_reach_beside_an_answer(page, stored):
    window = page("/ask.html", q=STATEMENT)
    assert window.wait_for(ANSWERED) == "done"
    topics = "[...document.querySelectorAll('#ask-topics button')].map((b) => b.textContent)"
    assert window.wait_for(f"return {topics}.length && {topics}") == sorted(stored[1])
    window.driver.find_element("css selector", "#ask-topics summary").click()
    window.driver.find_element("xpath", "//button[text()='/encoder']").click()
    window.wait_for("return location.search.includes('/encoder')")
    assert window.wait_for(ANSWERED) == "done"


def test_sql_is_asked_over_several_topics(page):
    window = page("/ask.html")
    window.run(
        "const s = document.querySelector('#ask-language'); s.value = 'sql';"
        "s.dispatchEvent(new Event('change'))"
    )
    statement = (
        "SELECT f.KEY, f.altitude, i.linear_acceleration.z FROM fix f "
        'ASOF JOIN "/imu/data" i ON f.KEY >= i.KEY ORDER BY f.KEY'
    )
    write(window, statement[: statement.index("fix") + 2])
    window.wait_for(
        "return document.querySelector('#ask-offers li')?.textContent.startsWith('fix')"
    )
    window.driver.switch_to.active_element.send_keys(statement[statement.index("fix") + 2 :])
    window.driver.switch_to.active_element.send_keys(CONTROL_ENTER)
    assert window.wait_for(ANSWERED) == "done"
    rows = window.run(
        "return [...document.querySelectorAll('#ask-rows tbody tr')].map("
        "row => [row.dataset.time, ...[...row.cells].slice(1).map(cell => cell.textContent)])"
    )
    assert rows[0][:3] == [str(FIRST_FIX), "2013-05-08T14:06:20.238582676Z", "273.2"]
    curve = pixels(window.picture("#plot-panels"))
    assert (~near(curve, (255, 255, 255))).sum() > 200
    window.run("document.getElementById('ask-plan').open = true")
    plan = window.wait_for("return document.querySelector('#ask-plan pre').textContent")
    assert plan
    # The address alone says it all, and a row leads to its moment.
    address = window.driver.current_url
    window.driver.get("about:blank")
    window.driver.get(address)
    assert window.wait_for(ANSWERED) == "done"
    assert window.run("return document.querySelector('#ask-language').value") == "sql"
    link = "return document.querySelector('#ask-rows tbody a').href"
    assert f"time={FIRST_FIX}" in window.run(link)


def test_more_rows_of_sql_are_shown(page):
    counted = "return document.querySelectorAll('#ask-rows tbody tr').length"
    offered = "return !document.querySelector('#rows-more').hidden"
    click = "document.querySelector('#rows-more').click()"
    window = page("/ask.html", q="SELECT range FROM range(2500)", language="sql")
    assert window.wait_for(ANSWERED) == "done"
    assert window.run(counted) == 1000 and window.run(offered)
    window.run(click)
    window.wait_for(f"{counted} === 2500")
    assert not window.run(offered)
    assert text_of(window, "#rows-told") == "2500 rows"
    window = page("/ask.html", q="SELECT range FROM range(10001)", language="sql")
    assert window.wait_for(ANSWERED) == "done"
    window.run(click)
    window.wait_for(f"{counted} === 10000")
    assert not window.run(offered)
    assert "LIMIT" in text_of(window, "#rows-told")


def test_every_topic_is_offered(window, fresh):
    with fresh() as store:
        for n in range(262):
            store.addTopic(f"/t{n}")  # made by the first message
        with running_viewer(store) as viewer:
            window.errors()
            window.driver.get(f"{viewer.url}/ask.html")
            buttons = "document.querySelectorAll('#ask-topics button').length"
            assert window.wait_for(f"return {buttons}") == 262
            assert text_of(window, "#ask-topics summary") == "Topics: 262"
            write(window, "select * from /t")
            offered = "return document.querySelector('#ask-offers .more')?.textContent"
            assert "62 more" in window.wait_for(offered)
            window.driver.get("about:blank")
    assert not window.errors()
