// SPDX-FileCopyrightText: 2026 cassandra_ros authors
// SPDX-License-Identifier: BSD-3-Clause
// @ts-check
/** Page Ask: a statement, its plot, its rows and its plan. The address has the statement and the time range. */

import { get, isAbort } from "./api.js";
import { Box } from "./ask_box.js";
import { Plot } from "./ask_plot.js";
import { Rows } from "./ask_rows.js";
import * as page from "./page.js";
import * as state from "./state.js";

const form = /** @type {HTMLFormElement} */ (document.getElementById("ask-form"));
const language = /** @type {HTMLSelectElement} */ (document.getElementById("ask-language"));
const cancel = /** @type {HTMLButtonElement} */ (document.getElementById("ask-cancel"));
const told = /** @type {HTMLElement} */ (document.getElementById("ask-told"));
const error = /** @type {HTMLElement} */ (document.getElementById("ask-error"));
const topicList = /** @type {HTMLDetailsElement} */ (document.getElementById("ask-topics"));
const second = /** @type {HTMLInputElement} */ (document.getElementById("plot-with"));
const plan = /** @type {HTMLDetailsElement} */ (document.getElementById("ask-plan"));

const TURN_MS = 800;
const MOST_TOPICS = 10_000;
/** @type {Record<string, string>} What the empty box shows, by language. */
const SAMPLES = {
  "": "SELECT altitude FROM /fix WHERE latitude > 43.4",
  sql: 'SELECT i.KEY, i.linear_acceleration.z, f.altitude FROM "/imu/data" i ASOF JOIN fix f ON i.KEY >= f.KEY',
};

page.start("Ask");
const box = new Box(ask, () => language.value);
const plot = new Plot(moveTo);
const rows = new Rows((problem, signal) => fail(problem, signal));

let asking = new AbortController();
let asked = "";
let working = 0;
let moved = -Infinity;

/** Run the statement in the box; a new statement over all time. */
function ask() {
  const statement = box.text.trim();
  const same = statement === state.read().q.trim() && language.value === languageOf(state.read());
  const window = same ? {} : { start: null, end: null };
  state.write({ q: statement || null, language: language.value || null, ...window }, { push: true });
  show(true);
}

/**
 * Show the statement and the time range of the address.
 * @param {boolean} [again] Also if the address has not changed.
 */
function show(again = false) {
  const now = state.read();
  const parameters = { q: now.q, nodes: now.nodes, runs: now.runs, language: languageOf(now) };
  const also = statementOf(now.others.with ?? "");
  const key = JSON.stringify([parameters, also]);
  const window = { start: now.start, end: now.end };
  second.value = now.others.with ?? "";
  if (!now.q) return showNothing();
  if (!again && key === asked && plot.shows(window) && rows.shows(window)) return;
  const other = again || key !== asked;
  if (other) {
    box.text = now.q;
    setLanguage(parameters.language);
    topicList.open = false;
  }
  asked = key;
  asking.abort();
  asking = new AbortController();
  error.hidden = true;
  const { signal } = asking;
  plan.hidden = false;
  if (other) clearPlan();
  work(signal, other, rows.load(parameters, window, signal), plot.load(parameters, also, window, signal, other));
}

/**
 * Wait for requests and show that they are running; show the first error.
 * @param {AbortSignal} signal
 * @param {boolean} other Whether the statement differs from the one before.
 * @param {...Promise<void>} all
 */
function work(signal, other, ...all) {
  working = all.length;
  cancel.disabled = false;
  document.body.dataset.state = "working";
  told.textContent = "working …";
  for (const each of all) {
    each.catch((problem) => fail(problem, signal, other)).finally(() => {
      if (signal.aborted) return;
      working -= 1;
      if (working === 0) rest(error.hidden ? "done" : "failed");
    });
  }
}

/** @param {"done" | "failed" | "cancelled"} how */
function rest(how) {
  cancel.disabled = true;
  document.body.dataset.state = how;
  told.textContent = how === "cancelled" ? "cancelled" : "";
}

/**
 * @param {unknown} problem
 * @param {AbortSignal} [signal]
 * @param {boolean} [other] Whether the shown results are of another statement.
 */
function fail(problem, signal, other = false) {
  if (isAbort(problem) || signal?.aborted) return;
  if (other) {
    plot.clear();
    rows.clear();
    plan.hidden = true;
  }
  const text = problem instanceof Error ? problem.message : String(problem);
  if (!error.hidden && error.textContent === text) return;
  // The reason may be long: its lines are wrapped, those of the statement and the caret are not.
  const spot = text.split("\n").slice(-2).join("\n");
  const isShown = text.endsWith("^");
  error.replaceChildren(
    isShown ? text.slice(0, -spot.length) : text,
    page.make("span", { class: "spot" }, isShown ? spot : ""),
  );
  error.hidden = false;
  const place = /** @type {any} */ (problem).position;
  if (typeof place === "number") box.point(place);
}

/** Show the topics, without an answer. */
function showNothing() {
  asking.abort();
  asking = new AbortController();
  rest("done");
  asked = "";
  plot.clear();
  rows.clear();
  plan.hidden = true;
  topicList.open = true;
}

const BEGIN = "SELECT * FROM ";

let listed = "";

/**
 * List all topics, as a statement of a language names them.
 * @param {string} name
 */
async function listTopics(name) {
  listed = name;
  const answer = await get("/api/complete", { q: BEGIN, language: name, limit: MOST_TOPICS });
  if (name !== listed) return;
  /** @type {string[]} */
  const topics = answer.offers.filter((/** @type {any} */ offer) => offer.kind === "topic").map((/** @type {any} */ offer) => offer.text);
  topicList.hidden = !topics.length;
  if (!topics.length) told.textContent = "There is no topic in this keyspace yet.";
  topicList.querySelector("summary")?.replaceChildren(`Topics: ${topics.length.toLocaleString("en")}`);
  topicList.querySelector(".content")?.replaceChildren(...topics.map((topic) =>
    page.make("button", { type: "button", onclick: () => choose(BEGIN + topic) }, topic)));
  document.getElementById("plot-topics")?.replaceChildren(...topics.map((topic) => page.make("option", { value: topic })));
}

/** @param {string} text A statement, or a topic. */
function statementOf(text) {
  return !text.trim() || /^\s*(select|with)\s/i.test(text) ? text.trim() : BEGIN + text.trim();
}

/**
 * Return the language of the statement in the address: "" = CQL, or "sql".
 * @param {import("./state.js").State} from
 */
function languageOf(from) {
  return from.others.language === "sql" ? "sql" : "";
}

/** @param {string} name */
function setLanguage(name) {
  if (topicList.hidden || name !== listed) listTopics(name).catch(fail);
  language.value = name;
  box.sample = SAMPLES[name];
}

/** @param {string} statement */
function choose(statement) {
  box.text = statement;
  ask();
}

/**
 * Show another time range; null = all time.
 * @param {{start: bigint | null, end: bigint | null}} window
 */
function moveTo(window) {
  // One step of the back button undoes several turns of the wheel.
  state.write(window, { push: performance.now() - moved > TURN_MS });
  moved = performance.now();
  show();
}

function clearPlan() {
  plan.querySelector("pre")?.replaceChildren();
  if (plan.open) loadPlan();
}

async function loadPlan() {
  const place = plan.querySelector("pre");
  const now = state.read();
  const { q, nodes, runs } = now;
  if (!place || place.textContent || !q) return;
  place.textContent = "the statement is run to its end …";
  try {
    const found = await get(
      "/api/explain",
      { q, nodes, runs, language: languageOf(now) },
      { signal: asking.signal },
    );
    place.textContent = found.text;
  } catch (problem) {
    place.textContent = "";
    fail(problem);
  }
}

form.addEventListener("submit", (event) => {
  event.preventDefault();
  ask();
});
language.addEventListener("change", () => {
  setLanguage(language.value);
  box.focus();
});
cancel.addEventListener("click", () => {
  asking.abort();
  rest("cancelled");
});
plan.addEventListener("toggle", () => {
  if (plan.open) loadPlan();
});
second.addEventListener("change", () => {
  state.write({ with: second.value.trim() || null }, { push: true });
  show();
});
window.addEventListener("popstate", () => show());
page.ifSeveralStores(() => {
  for (const option of language.options) option.disabled = option.value === "sql";
  language.title = page.ONE_STORE;
  plan.replaceChildren(page.make("summary", { title: page.ONE_STORE }, "Plan: not over several stores"));
});
box.text = state.read().q;
setLanguage(languageOf(state.read()));
show(true);
if (!state.read().q) box.focus();
