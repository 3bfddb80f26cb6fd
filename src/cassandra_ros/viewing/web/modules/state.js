// SPDX-FileCopyrightText: 2026 cassandra_ros authors
// SPDX-License-Identifier: BSD-3-Clause
// @ts-check
/**
 * The state of a page is completely in its address: a sent address shows the same.
 * `start`, `end` and `time` are times, `topics`, `nodes` and `runs` lists; the rest are texts.
 */

import { keyspace, url } from "./api.js";
import { parse } from "./times.js";

const TIMES = ["start", "end", "time"];
const LISTS = ["topics", "nodes", "runs"];
const CHANGED = "cassandra-state";

/**
 * @typedef {object} State
 * @property {bigint | null} start First time, included.
 * @property {bigint | null} end Last time, included.
 * @property {bigint | null} time Selected time.
 * @property {string[]} topics Empty = all.
 * @property {string[]} nodes nodeIDs of robots; empty = all.
 * @property {string[]} runs Empty = all.
 * @property {string} q The statement.
 * @property {string} layout
 * @property {Record<string, string>} others Parameters of a single page.
 * @property {string[]} problems Errors in the address, for the user.
 */

/**
 * Read the state of an address.
 * @param {string} [search] With its question mark.
 * @returns {State}
 */
export function read(search = location.search) {
  /** @type {State} */
  const state = {
    start: null, end: null, time: null, topics: [], nodes: [], runs: [],
    q: "", layout: "", others: {}, problems: [],
  };
  for (const [name, text] of new URLSearchParams(search)) take(state, name, text);
  if (state.start !== null && state.end !== null && state.start > state.end) {
    state.problems.push("The address has a start after its end: both are ignored.");
    state.start = state.end = null;
  }
  return state;
}

/**
 * @param {any} state
 * @param {string} name
 * @param {string} text
 */
function take(state, name, text) {
  if (TIMES.includes(name)) {
    try {
      state[name] = text ? parse(text) : null;
    } catch (error) {
      if (!(error instanceof RangeError)) throw error;
      state.problems.push(`${name} of the address is left out: ${error.message}`);
    }
  } else if (LISTS.includes(name)) {
    state[name].push(...text.split(",").filter(Boolean));
  } else if (["q", "layout"].includes(name)) {
    state[name] = text;
  } else if (name !== "token") {
    state.others[name] = text;
  }
}

/**
 * Change the state, which is the address of this page, without reloading the page.
 * @param {import("./api.js").Parameters} changes New values; null removes a parameter.
 * @param {{push?: boolean}} options push: whether the browser's back button undoes it.
 */
export function write(changes, { push = false } = {}) {
  const address = link(location.pathname, changes);
  if (address === location.pathname + location.search) return;
  if (push) history.pushState(null, "", address);
  else history.replaceState(null, "", address);
  window.dispatchEvent(new Event(CHANGED));
}

/**
 * Return the address of a page with this page's state and changes.
 * @param {string} page Path, as /look.html.
 * @param {import("./api.js").Parameters} [changes] New values; null removes a parameter.
 */
export function link(page, changes = {}) {
  const { problems, others, ...own } = read();
  return url(page, { ...own, ...others, ...changes });
}

/**
 * Return the address of a file with the messages of this page's time range, topics, robots and runs.
 * @param {"bag" | "mcap"} ending
 * @param {import("./api.js").Parameters} [changes]
 */
export function fileLink(ending, changes = {}) {
  const { start, end, topics, nodes, runs } = read();
  return url(`/window.${ending}`, { start, end, topics, nodes, runs, keyspace: keyspace(), ...changes });
}

/**
 * Call a listener when the state has changed, by `write` or by the back button.
 * @param {(state: State) => void} listener
 */
export function onChange(listener) {
  for (const event of [CHANGED, "popstate"]) window.addEventListener(event, () => listener(read()));
}
