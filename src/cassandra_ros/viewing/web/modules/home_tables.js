// SPDX-FileCopyrightText: 2026 cassandra_ros authors
// SPDX-License-Identifier: BSD-3-Clause
// @ts-check
/** The tables below the timeline: topics; recordings and imports; events. */

import { make } from "./page.js";
import * as state from "./state.js";
import { LAST, length, shown } from "./times.js";

const SECOND = 1_000_000_000n;

/**
 * @typedef {object} Column
 * @property {string} name
 * @property {(row: any) => string} text
 * @property {(row: any) => any} [value] Sort key; default: the text.
 * @property {boolean} [number] Whether it is aligned right and sorted from the largest.
 * @property {(row: any) => Node} [cell]
 */

/**
 * Show the topics.
 * @param {HTMLElement} place
 * @param {any[]} lanes Lanes of /api/timeline over all time.
 * @returns {(lanes: any[]) => void} Updates the table.
 */
export function showTopics(place, lanes) {
  const robots = new Set(lanes.map((lane) => lane.node));
  /** @type {Column[]} */
  const columns = [
    { name: "topic", text: (lane) => lane.topic, cell: (lane) => ask(lane.topic, lane.topic) },
    { name: "robot", text: (lane) => lane.node || "–" },
    { name: "type", text: (lane) => lane.types.join(", ") },
    { name: "format", text: (lane) => lane.formats.join(", ") },
    { name: "messages", text: (lane) => about(lane) + lane.messages.toLocaleString("en"), value: (lane) => lane.messages, number: true },
    { name: "size", text: (lane) => about(lane) + bytes(lane.bytes), value: (lane) => lane.bytes, number: true },
    { name: "rate", text: (lane) => rate(lane.rate_hz), value: (lane) => lane.rate_hz ?? 0, number: true },
    { name: "from", text: (lane) => time(lane.first), value: (lane) => BigInt(lane.first ?? 0) },
    { name: "to", text: (lane) => time(lane.last), value: (lane) => BigInt(lane.last ?? 0) },
    { name: "", text: () => "", cell: (lane) => make("a", { href: state.link("/look.html", { topics: [lane.topic] }) }, "Look") },
  ];
  return showTable(place, columns.filter((column) => column.name !== "robot" || robots.size > 1), lanes);
}

/**
 * Show recordings and imports.
 * @param {HTMLElement} place
 * @param {any[]} runs Runs of /api/runs.
 * @param {(run: any) => void} show Shows a run in the timeline.
 * @param {number} more Number of older runs that are not among them.
 */
export function showRuns(place, runs, show, more) {
  if (!runs.length) {
    place.replaceChildren(make("p", { class: "note" }, "No recording or import is stored."));
    return;
  }
  /** @type {Column[]} */
  const columns = [
    { name: "run", text: (run) => run.run, cell: (run) => make("button", { class: "plain", title: "Show it in the timeline", onclick: () => show(run) }, run.run) },
    { name: "robot", text: (run) => run.node || "–" },
    { name: "kind", text: (run) => run.kind },
    { name: "state", text: (run) => run.state },
    { name: "began", text: (run) => time(run.started), value: (run) => BigInt(run.started ?? 0) },
    { name: "took", text: (run) => took(run), value: (run) => BigInt(run.ended ?? 0) - BigInt(run.started ?? 0), number: true },
    { name: "messages", text: (run) => run.messages.toLocaleString("en"), value: (run) => run.messages, number: true },
    { name: "lost", text: (run) => (run.lost ? run.lost.toLocaleString("en") : "–"), value: (run) => run.lost, number: true },
    { name: "labels", text: (run) => Object.entries(run.labels).map(([name, text]) => (text ? `${name}=${text}` : name)).join(", ") },
    { name: "source", text: (run) => run.source },
  ];
  const robots = runs.some((run) => run.node);
  showTable(place, columns.filter((column) => column.name !== "robot" || robots), runs);
  const hint = `These are the newest ${runs.length.toLocaleString("en")} runs; cassandra_bag runs lists ${more.toLocaleString("en")} older ones, too.`;
  if (more) place.append(make("p", { class: "note" }, hint));
}

/**
 * Show events.
 * @param {HTMLElement} place
 * @param {any[]} events Events of /api/events.
 * @param {(event: any) => void} show Shows an event in the timeline.
 */
export function showEvents(place, events, show) {
  if (!events.length) {
    place.replaceChildren(make("p", { class: "note" }, "There is no such event."));
    return;
  }
  const texts = (/** @type {any} */ named) => Object.entries(named).map(([name, value]) => `${name}=${typeof value === "string" ? value : JSON.stringify(value)}`).join(", ");
  /** @type {Column[]} */
  const columns = [
    { name: "event", text: (event) => event.name, cell: (event) => make("button", { class: "plain", title: "Show it in the timeline", onclick: () => show(event) }, event.name) },
    { name: "robot", text: (event) => event.node || "all" },
    { name: "from", text: (event) => time(event.start), value: (event) => BigInt(event.start) },
    { name: "to", text: (event) => (event.end === null ? "lasts" : time(event.end)), value: (event) => BigInt(event.end ?? LAST) },
    { name: "took", text: (event) => (event.end === null ? "–" : length(BigInt(event.end) - BigInt(event.start))), value: (event) => BigInt(event.end ?? LAST) - BigInt(event.start), number: true },
    { name: "labels", text: (event) => texts(event.labels) },
    { name: "values", text: (event) => texts(event.values) },
    { name: "", text: () => "", cell: (event) => make("a", { href: lookAt(event) }, "Look") },
  ];
  showTable(place, columns, events);
}

/** @param {any} event @returns {string} Address of Look at the time range of an event. */
function lookAt(event) {
  const start = BigInt(event.start);
  const nodes = event.node ? [event.node] : null;
  return state.link("/look.html", { start, end: event.end === null ? null : BigInt(event.end), time: start, nodes, selection: null });
}

/** @param {HTMLElement} place @param {Column[]} columns @param {any[]} rows */
function showTable(place, columns, rows) {
  const body = make("tbody");
  let order = (/** @type {any[]} */ given) => given;
  const fill = () => body.replaceChildren(...order(rows).map((row) => rowOf(columns, row)));
  const heads = columns.map((column) => {
    const head = make("th", { scope: "col", class: column.number ? "number" : "" });
    if (!column.name) return head;
    const button = make("button", {}, column.name);
    button.addEventListener("click", () => {
      const down = head.getAttribute("aria-sort") === (column.number ? "descending" : "ascending");
      const up = column.number ? down : !down;
      for (const each of heads) each.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", up ? "ascending" : "descending");
      order = (given) => sorted(given, column.value ?? column.text, up);
      fill();
    });
    head.append(button);
    return head;
  });
  fill();
  place.replaceChildren(make("table", { class: "data" }, make("thead", {}, make("tr", {}, ...heads)), body));
  return (/** @type {any[]} */ given) => {
    rows = given;
    fill();
  };
}

/** @param {Column[]} columns @param {any} row */
function rowOf(columns, row) {
  return make("tr", {}, ...columns.map((column) =>
    make("td", { class: column.number ? "number" : "" }, column.cell ? column.cell(row) : column.text(row))));
}

/** @param {any[]} rows @param {(row: any) => any} value @param {boolean} up */
function sorted(rows, value, up) {
  const way = up ? 1 : -1;
  return [...rows].sort((one, other) => {
    const [a, b] = [value(one), value(other)];
    return a < b ? -way : a > b ? way : 0;
  });
}

/** @param {string} topic @returns {string} Its name as a statement takes it. */
export function quoted(topic) {
  return /^\/?[A-Za-z~_][A-Za-z0-9_/~]*$/.test(topic) ? topic : `"${topic.replaceAll('"', '""')}"`;
}

/** @param {string} topic @param {string} text */
function ask(topic, text) {
  const q = `select * from ${quoted(topic)} limit 100`;
  return make("a", { href: state.link("/ask.html", { q, topics: null }), title: `Ask: ${q}` }, text);
}

/** @param {any} lane */
function about(lane) {
  return lane.exact ? "" : "≈ ";
}

/** @param {number | null} hz */
function rate(hz) {
  if (hz === null || hz === undefined) return "–";
  return hz >= 0.1 ? `${Number(hz.toPrecision(3)).toLocaleString("en")} Hz` : `every ${length(BigInt(Math.round(1e9 / hz)))}`;
}

/** @param {number} count */
function bytes(count) {
  const units = ["B", "KB", "MB", "GB", "TB"];
  let power = 0;
  while (count >= 1000 && power < units.length - 1) {
    count /= 1000;
    power++;
  }
  return `${power ? Number(count.toPrecision(3)) : count} ${units[power]}`;
}

/** @param {string | null} ns */
function time(ns) {
  return ns === null ? "–" : shown(BigInt(ns), SECOND);
}

/** @param {any} run */
function took(run) {
  return run.started === null || run.ended === null ? "–" : length(BigInt(run.ended) - BigInt(run.started));
}
