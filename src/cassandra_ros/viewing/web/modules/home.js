// SPDX-FileCopyrightText: 2026 cassandra_ros authors
// SPDX-License-Identifier: BSD-3-Clause
// @ts-check
/** Page Home: stored topics over time; a selected time range opens in Look or Ask, or as a file. */

import * as api from "./api.js";
import { quoted, showEvents, showRuns, showTopics } from "./home_tables.js";
import * as page from "./page.js";
import * as state from "./state.js";
import { Timeline } from "./timeline.js";
import { keyOf } from "./timeline_data.js";
import { LAST, iso, length, shown } from "./times.js";

const SETTLED_MS = 120;
const DETAIL_MS = 250;
const AGAIN_MS = 5000;
const QUIET_MS = 30000;
const MOST_CELLS = 4000;
/** Maximum number of lanes that are all requested; above it only the visible ones are. */
const MANY_LANES = 60;
const MOST_RUNS = 1000;
/** Maximum number of events that are drawn, and of those that are listed. */
const MOST_FLAGS = 1000;
const MOST_LISTED = 200;

const { make } = page;

page.start("Home");

const selection = make("div", { class: "row", id: "selection" });
const periodsPlace = make("nav", { id: "periods", "aria-label": "Times with messages", hidden: true });
const summary = make("span", { class: "muted", id: "summary", role: "status" });
const chosen = make("span", { class: "mono", id: "chosen" });
const links = make("div", { class: "row", id: "links" });
const canvas = make("canvas", { class: "timeline", tabindex: "0", role: "application", id: "timeline" });
const tip = make("div", { class: "tip", hidden: true });
const box = make("div", { class: "timeline-box" }, canvas, tip);
const tables = make("section", { class: "panel tables", id: "tables" });
const panel = make("section", { class: "panel timeline-panel" },
  make("header", {}, selection, zoomButtons(), summary, make("div", { class: "row push" }, chosen, links)),
  periodsPlace,
  box,
  make("p", { class: "keys muted" }, "Wheel: zoom · drag: select · Shift and drag, or drag the axis: move · keys ",
    ...["+", "−", "←", "→", "Home", "Enter", "Esc", "E"].flatMap((key) => [make("kbd", {}, key), " "])),
);
const empty = make("section", { class: "panel note grow", id: "empty", hidden: true });
document.getElementById("home")?.replaceChildren(panel, empty, tables);

const timeline = new Timeline(canvas, tip);
page.takeKeys(canvas);
/** The timeline, for tests of the page. */
Object.assign(canvas, { timeline });

/** @type {any} Last answer for all time. */
let whole = null;
let following = true;
/** Whether there are more events than are drawn; then those of the visible time range are requested. */
let manyEvents = false;
/** Whether there are more marks of runs and losses than are shown at once. */
let manyMarks = false;
/** Which of them the visible time range still has too many of to be drawn. */
let undrawn = { events: false, marks: false };
let updateEvents = () => {};
/** Whether the viewer shows several stores, of which it sends no files. */
let severalStores = false;
/** @typedef {import("./timeline.js").Span & {messages: number}} Period */
/** @type {Period[]} Time ranges with messages, separated by long pauses. */
let periods = [];
/** @type {Period | null | undefined} The period that is shown; null = all of them, undefined = no period is known yet. */
let period;
let updateTopics = (/** @type {any[]} */ lanes) => {};
/** @type {number | undefined} */
let waiting;
let loading = new AbortController();
let asking = new AbortController();
/** @type {number | undefined} */
let later;

/**
 * Request all topics, and show the time range of the address.
 * @param {{again?: boolean}} how again: it is shown already, and further messages may have come.
 */
async function load({ again: known = false } = {}) {
  canvas.dataset.state = "busy";
  loading.abort();
  loading = new AbortController();
  const { signal } = loading;
  const choice = chosenParameters();
  const [answer, marks, events] = await Promise.all([
    api.get("/api/timeline", { ...choice, pixels: cellsOf(1) }, { signal }),
    api.get("/api/marks", choice, { signal }),
    askEvents({}, signal),
  ]);
  const before = keysOf(whole);
  whole = answer;
  timeline.picture.take(await ofPeriod(answer, choice, known, signal), { all: true, whole: true });
  takeMarks(marks.marks);
  timeline.picture.takeEvents(events.events);
  manyEvents = events.more;
  manyMarks = marks.left_off > 0;
  undrawn = { events: manyEvents, marks: manyMarks };
  const nothing = !timeline.picture.lanes.length;
  panel.hidden = tables.hidden = nothing;
  empty.hidden = !nothing;
  if (!known) showWindow();
  else if (following) timeline.show(timeline.whole);
  timeline.update();
  box.style.height = `${timeline.wanted}px`;
  if (nothing) await explain();
  if (known && keysOf(whole) !== before) await loadTables();
  else if (known) updateTopics((await askAll()).lanes);
  tell();
  ask();
  again();
}

/**
 * Return the answer for the period that is shown, without robots that have no messages in it.
 * @param {any} answer Answer for all time.
 * @param {import("./api.js").Parameters} choice
 * @param {boolean} known Whether a period is shown already.
 * @param {AbortSignal} signal
 */
async function ofPeriod(answer, choice, known, signal) {
  periods = answer.periods.map((/** @type {any[]} */ [start, end, messages]) => ({ start: BigInt(start), end: BigInt(end), messages }));
  period = periodOf(known);
  showPeriods();
  let found = answer;
  if (periods.length > 1 && period) {
    const { start, end } = period;
    found = await api.get("/api/timeline", { ...choice, start, end, pixels: cellsOf(1) }, { signal });
    found = { ...found, first: String(start), last: String(end) };
  }
  const robots = new Set(found.lanes.filter((/** @type {any} */ lane) => lane.first !== null).map((/** @type {any} */ lane) => lane.node));
  // A part of the time also has lanes of robots whose messages were deleted.
  const there = new Set(answer.lanes.map((/** @type {any} */ lane) => keyOf(lane.topic, lane.node)));
  const lanes = found.lanes.filter((/** @type {any} */ lane) => there.has(keyOf(lane.topic, lane.node)) && (!robots.size || robots.has(lane.node)));
  return { ...found, lanes };
}

/**
 * Return the period to show: that of the address, or what has become of the shown one; without a time
 * the one with most messages. null = all of them, because the time range of the address has several.
 * @param {boolean} known Whether a period is shown already.
 */
function periodOf(known) {
  if (known && period === null) return null;
  const { start, end, time } = state.read();
  const [low, high] = known && period ? [period.start, period.end] : [start ?? time ?? end, end ?? time ?? start];
  if (low === null || high === null) return usualPeriod();
  const inside = periods.filter((each) => each.start <= high && each.end >= low);
  if (inside.length > 1) return null;
  const away = (/** @type {Period} */ each) => (low < each.start ? each.start - low : low - each.end);
  return inside[0] ?? [...periods].sort((one, other) => (away(one) < away(other) ? -1 : 1))[0];
}

/** @returns {Period | undefined} The period with most messages, the last one of equals. */
function usualPeriod() {
  const most = Math.max(...periods.map((each) => each.messages));
  return periods.filter((each) => each.messages === most).at(-1);
}

/** Offer the periods if there are several: the ones before and after on their sides, all in a menu. */
function showPeriods() {
  periodsPlace.hidden = periods.length < 2;
  if (periodsPlace.hidden) return;
  const at = period ? periods.indexOf(period) : -1;
  const button = (/** @type {number} */ n, /** @type {string} */ before, /** @type {string} */ after) => (
    make("button", { type: "button", onclick: () => showPeriod(periods[n]) }, before, told(periods[n]), after));
  const menu = make("select", { "aria-label": "Time with messages" },
    ...periods.map((each, n) => make("option", { value: String(n), selected: n === at }, told(each))),
    make("option", { value: "-1", selected: at < 0 }, `all ${periods.length} periods`));
  menu.addEventListener("change", () => showPeriod(periods[Number(menu.value)] ?? null));
  periodsPlace.replaceChildren(
    at > 0 ? button(at - 1, "◀ ", "") : make("span"), menu,
    at >= 0 && at < periods.length - 1 ? button(at + 1, "", " ▶") : make("span"));
}

/** @param {Period} each */
function told({ start, end, messages }) {
  const days = [...new Set([start, end].map((ns) => iso(ns).slice(0, 10)))].join(" to ");
  return `${days}: ${plural(messages, "message")}`;
}

/** @param {Period | null} wanted null = all of them. */
function showPeriod(wanted) {
  const { start } = wanted ?? periods[0];
  const { end } = wanted ?? periods[periods.length - 1];
  const usual = wanted === usualPeriod();
  clearTimeout(writing);
  state.write({ start: usual ? null : start, end: usual ? null : end, time: null, selection: null }, { push: true });
  load().catch(failed);
}

/** @param {any[]} marks Only those in the period make rows of lost topics. */
function takeMarks(marks) {
  const { start, end } = (periods.length > 1 && period) || { start: 0n, end: LAST };
  timeline.picture.takeMarks(marks.filter((mark) => BigInt(mark.start) <= end && BigInt(mark.end) >= start));
}

/** Request the visible time range when the user has stopped changing it. */
function ask() {
  if (!whole) return;
  stop();
  if (whole.first === null) return settled();
  canvas.dataset.state = "busy";
  later = window.setTimeout(() => askWindow(false).catch(failed), SETTLED_MS);
}

/** @param {boolean} detail */
async function askWindow(detail) {
  const { signal } = asking;
  const { start, end } = timeline.view;
  const room = detail ? 0n : (end - start) / 2n;
  const all = timeline.whole;
  const from = start - room > all.start ? start - room : all.start;
  const to = end + room < all.end ? end + room : all.end;
  if (from > to) return settled();
  const parts = Number(to - from + 1n) / Number(end - start + 1n);
  const many = timeline.picture.lanes.length > MANY_LANES;
  const names = [...new Set(timeline.seen.map((lane) => lane.topic))];
  const choice = chosenParameters();
  const topics = many && names.length ? names : choice.topics;
  const robots = [...new Set(timeline.seen.map((lane) => lane.node))];
  const nodes = many && robots.length && robots.every(Boolean) ? robots : choice.nodes;
  const asked = { ...choice, topics, nodes, start: from, end: to, pixels: cellsOf(parts), detail };
  const [answer, events, marks] = await Promise.all([
    api.get("/api/timeline", asked, { signal }),
    manyEvents ? askEvents({ start: from, end: to }, signal) : null,
    manyMarks ? api.get("/api/marks", { ...choice, start: from, end: to }, { signal }) : null,
  ]);
  if (marks) takeMarks(marks.marks);
  if (events) timeline.picture.takeEvents(events.events);
  undrawn = { events: events?.more ?? false, marks: marks?.left_off > 0 };
  tell();
  const { runs: known } = timeline.picture;
  timeline.picture.take(answer, { topics, nodes });
  timeline.picture.runs = known;
  timeline.update();
  // Other rows may be visible now, of which less is known.
  if (many && timeline.seen.some((lane) => !names.includes(lane.topic))) return ask();
  canvas.setAttribute("aria-label", timeline.describe());
  const coarse = answer.lanes.some((/** @type {any} */ lane) => lane.even.length || lane.unknown.length || !lane.exact);
  if (detail || !coarse) return settled();
  later = window.setTimeout(() => askWindow(true).catch(failed), DETAIL_MS);
}

/**
 * Request the events to be drawn.
 * @param {import("./api.js").Parameters} span
 * @param {AbortSignal} signal
 */
function askEvents(span, signal) {
  const { nodes, runs: names } = state.read();
  return api.get("/api/events", { nodes, runs: names, limit: MOST_FLAGS, ...span }, { signal });
}

function stop() {
  clearTimeout(later);
  asking.abort();
  asking = new AbortController();
}

function settled() {
  canvas.dataset.state = "ready";
}

/** @param {unknown} error */
function failed(error) {
  if (!api.isAbort(error)) settled();
  page.showError(error);
}

/** Request again lanes that are being written, and an empty store; others less often. */
function again() {
  clearTimeout(waiting);
  const quiet = !timeline.picture.writing && timeline.picture.lanes.length > 0;
  waiting = window.setTimeout(() => {
    if (document.hidden || timeline.drag) again();
    else load({ again: true }).catch(failed).finally(again);
  }, quiet ? QUIET_MS : AGAIN_MS);
}

/** @param {any} answer */
function keysOf(answer) {
  return JSON.stringify((answer?.lanes ?? []).map((/** @type {any} */ lane) => [lane.topic, lane.node]));
}

function chosenParameters() {
  const { topics, nodes, runs: names } = state.read();
  return { topics, nodes, runs: names };
}

function isFiltered() {
  return Object.values(chosenParameters()).some((each) => each.length);
}

/** @param {number} windows Width in visible time ranges. */
function cellsOf(windows) {
  const plot = Math.max(200, timeline.size.width - timeline.size.names);
  return Math.min(MOST_CELLS, Math.ceil(plot * windows));
}

/** Show the time range of the address, or all time. */
function showWindow() {
  const { start, end, time, others } = state.read();
  following = start === null && end === null;
  const all = timeline.whole;
  timeline.show({ start: start ?? all.start, end: end ?? all.end });
  timeline.moment = time;
  timeline.selection = selectionOf(others.selection);
}

/** @param {string | undefined} text @returns {import("./timeline.js").Span | null} */
function selectionOf(text) {
  const ends = /^(\d+),(\d+)$/.exec(text ?? "");
  return ends ? { start: BigInt(ends[1]), end: BigInt(ends[2]) } : null;
}

let writing = 0;

/** Put the visible time range into the address with a delay: browsers refuse frequent changes. */
function note() {
  clearTimeout(writing);
  writing = window.setTimeout(() => {
    const { view, selection: span, moment } = timeline;
    const window_ = following ? { start: null, end: null } : view;
    state.write({ ...window_, selection: span ? `${span.start},${span.end}` : null, time: moment });
    timeline.redraw();
  }, 200);
  tell();
}

timeline.addEventListener("view", () => {
  const all = timeline.whole;
  following = timeline.view.start <= all.start && timeline.view.end >= all.end && period === usualPeriod();
  if (whole?.first) note();
  ask();
});
timeline.addEventListener("resize", ask);
timeline.addEventListener("scroll", () => timeline.picture.lanes.length > MANY_LANES && ask());
timeline.addEventListener("select", note);
timeline.addEventListener("moment", note);

timeline.addEventListener("mark", () => markSelection().catch(failed));

/** Ask for the name of the selected time range, and make it an event. */
async function markSelection() {
  const { selection: span } = timeline;
  if (!span) return;
  const { allow_writes: allowed, stores } = await page.keyspaceAnswer();
  if (stores.length) throw new api.ApiError("InvalidOption", page.ONE_STORE, 400);
  if (!allowed) {
    throw new api.ApiError("AccessDenied", "This viewer only reads. Start it with --allow-writes to make events here.", 403);
  }
  const { nodes } = chosenParameters();
  const node = nodes.length === 1 ? nodes[0] : timeline.lane?.node ?? "";
  const name = make("input", { type: "text", id: "event-name", required: true, maxlength: "256", "aria-label": "Name of the event" });
  const robot = make("span", { class: "muted" }, node ? ` of ${node}` : " of all robots");
  const form = make("form", { class: "row", id: "event-form" }, "Event", name, robot,
    make("button", { class: "main" }, "Add"), make("button", { type: "button", onclick: () => close() }, "Cancel"));
  const close = () => {
    form.remove();
    canvas.focus();
  };
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    api.send("/api/events/add", { name: name.value, start: span.start, end: span.end, node }).then(() => {
      close();
      updateEvents();
      return load({ again: true });
    }).catch(failed);
  });
  form.addEventListener("keydown", (event) => event.key === "Escape" && close());
  document.getElementById("event-form")?.remove();
  panel.querySelector("header")?.append(form);
  name.focus();
}

let choice = JSON.stringify(chosenParameters());
state.onChange(() => {
  const now = JSON.stringify(chosenParameters());
  if (now === choice) return;
  choice = now;
  page.clearErrors();
  load().catch(failed);
});
window.addEventListener("popstate", () => {
  if (periods.length > 1) return void load().catch(failed);
  showWindow();
  ask();
});

function zoomButtons() {
  const button = (/** @type {string} */ text, /** @type {string} */ label, /** @type {() => void} */ act) =>
    make("button", { title: label, "aria-label": label, onclick: act }, text);
  return make("div", { class: "row tight" },
    button("−", "Zoom out (key −)", () => timeline.zoom(2)),
    button("+", "Zoom in (key +)", () => timeline.zoom(0.5)),
    button("All", "Show all time (key Home)", () => timeline.show(timeline.whole)),
  );
}

/** Show the number of messages, and the links of the selected time range. */
function tell() {
  const { picture, selection: span, view, moment } = timeline;
  const { start, end } = span ?? filled(view);
  const messages = sum("messages");
  const topics = new Set(picture.lanes.map((lane) => lane.topic)).size;
  summary.textContent = `${plural(topics, "topic")} · ${messages.toLocaleString("en")} messages` +
    (picture.writing ? " · recording" : "") +
    Object.entries(undrawn).map(([what, is]) => (is ? ` · only the first ${what} are drawn: zoom in` : "")).join("");
  chosen.textContent = `${shown(start, (end - start) / 1000n)} · ${length(end - start + 1n)}`;
  chosen.title = span ? "Selected time range" : "Visible time range";
  const window_ = { start, end };
  const inside = moment !== null && start <= moment && moment <= end ? moment : start;
  const lane = timeline.lane ?? timeline.lanes[0];
  const bounds = lane && ["manual", "hash"].includes(lane.foundBy) ? "" : ` where KEY >= ${start} and KEY <= ${end}`;
  const q = lane && `select * from ${quoted(lane.topic)}${bounds} limit 1000`;
  const files = [
    ["bag", "Download this time range as a bag"],
    ["mcap", "Download this time range as an MCAP file"],
  ];
  const link = (/** @type {string} */ text, /** @type {string} */ href, /** @type {string} */ about, main = false) =>
    make("a", { class: main ? "button main" : "button", href, title: about }, text);
  links.replaceChildren(
    link("Look", state.link("/look.html", { ...window_, time: inside, selection: null }), "Show the messages of this time range", true),
    link("Ask", state.link("/ask.html", { ...window_, q, selection: null }), `Ask: ${q}`),
    ...(severalStores ? [] : files.map(([ending, about]) =>
      link(`.${ending}`, state.fileLink(/** @type {"bag" | "mcap"} */ (ending), window_), about))),
  );
}

/** @param {import("./timeline.js").Span} span @returns {import("./timeline.js").Span} Without the margin around all time. */
function filled({ start, end }) {
  const { first, last } = timeline.picture;
  if (first === null || last === null || end < first || last < start) return { start, end };
  return { start: start < first ? first : start, end: end > last ? last : end };
}

/** @param {"messages" | "bytes"} name */
function sum(name) {
  return (whole?.lanes ?? []).reduce((/** @type {number} */ all, /** @type {any} */ lane) => all + lane[name], 0);
}

/** @param {number} count @param {string} name */
function plural(count, name) {
  return `${count.toLocaleString("en")} ${name}${count === 1 ? "" : "s"}`;
}

/** Show how to fill an empty store. */
async function explain() {
  const { keyspace, text, stores } = await api.get("/api/keyspace");
  const filtered = isFiltered();
  if (stores.length && !filtered) {
    empty.replaceChildren(make("h1", {}, `Nothing is stored in ${stores.join(", ")} yet`));
    return;
  }
  empty.replaceChildren(
    make("h1", {}, filtered ? "No message of the selection is stored" : `Nothing is stored in keyspace ${keyspace} yet`),
    make("p", {}, text || "Topics that you record or import appear here without reloading the page."),
    make("pre", {}, `cassandra_bag import FILE.bag --keyspace ${keyspace}\nrosrun cassandra_ros recorder -a --keyspace ${keyspace}`),
  );
  if (filtered) {
    empty.append(make("p", {}, make("button", { onclick: () => state.write({ topics: null, nodes: null, runs: null }) }, "Show all")));
  }
}

/** Request the number of messages of all topics, also of those imported long after their recording. */
function askAll() {
  return api.get("/api/timeline", { pixels: 1, start: 0n, end: LAST });
}

/** Fill menus and tables with everything stored, independent of the selection. */
async function loadTables() {
  const [all, listed] = await Promise.all([
    askAll(),
    api.get("/api/runs", { limit: MOST_RUNS }),
  ]);
  const distinct = (/** @type {string} */ name, lanes = all.lanes) => [...new Set(lanes.map((/** @type {any} */ lane) => lane[name]))].filter(Boolean);
  page.addSelection(selection, {
    runs: listed.runs.map((/** @type {any} */ run) => ({ value: String(run.id), text: run.run })),
    moreRuns: listed.left_off,
    nodes: distinct("node", all.lanes.filter((/** @type {any} */ lane) => lane.first !== null)).map((value) => ({ value })),
    topics: distinct("topic").map((value) => ({ value })),
  });
  const spans = new Map(all.runs.map((/** @type {any} */ run) => [run.id, run]));
  const show = (/** @type {any} */ run) => {
    const span = spans.get(run.id);
    if (span) timeline.show({ start: BigInt(span.first), end: BigInt(span.last) });
  };
  const topics = make("div", { class: "scroll" });
  const runTable = make("div", { class: "scroll", hidden: true });
  updateTopics = showTopics(topics, all.lanes);
  showRuns(runTable, listed.runs, show, listed.left_off);
  const eventSheet = eventList();
  const counts = new Map([["Topics", distinct("topic").length], ["Runs", listed.runs.length + listed.left_off]]);
  const tabs = [["Topics", topics], ["Runs", runTable], ["Events", eventSheet]].map(([name, sheet]) => {
    const tab = make("button", { role: "tab", class: "tab" }, [name, counts.get(String(name)) ?? ""].join(" ").trim());
    tab.addEventListener("click", () => choose(sheet));
    return { tab, sheet };
  });
  const choose = (/** @type {any} */ wanted) => {
    for (const { tab, sheet } of tabs) {
      /** @type {HTMLElement} */ (sheet).hidden = sheet !== wanted;
      tab.setAttribute("aria-selected", String(sheet === wanted));
    }
  };
  choose(topics);
  tables.replaceChildren(make("header", { role: "tablist" }, ...tabs.map(({ tab }) => tab)), topics, runTable, eventSheet);
}

/** Make the list of events with its search. */
function eventList() {
  const search = make("input", { type: "search", id: "event-search", placeholder: "Search events", "aria-label": "Search events" });
  const list = make("div", { id: "events" });
  const more = make("p", { class: "note", hidden: true }, `These are the first ${MOST_LISTED}: search for more letters.`);
  const show = (/** @type {any} */ event) => {
    const span = { start: BigInt(event.start), end: event.end === null ? timeline.whole.end : BigInt(event.end) };
    timeline.show(span);
    timeline.select(span);
  };
  let searching = new AbortController();
  updateEvents = () => {
    searching.abort();
    searching = new AbortController();
    const { signal } = searching;
    const { nodes, runs: names } = chosenParameters();
    api.get("/api/events", { text: search.value, nodes, runs: names, limit: MOST_LISTED }, { signal }).then((answer) => {
      showEvents(list, answer.events, show);
      more.hidden = !answer.more;
    }).catch(failed);
  };
  search.addEventListener("input", updateEvents);
  updateEvents();
  return make("div", { class: "scroll", hidden: true, id: "event-sheet" }, make("div", { class: "row" }, search), list, more);
}

page.ifSeveralStores(() => {
  severalStores = true;
  if (whole) tell();
});
// Also if the selection has no messages: the user can change it in the menus.
loadTables().catch(failed);
load().catch(failed);
