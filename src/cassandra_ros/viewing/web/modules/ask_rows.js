// SPDX-FileCopyrightText: 2026 cassandra_ros authors
// SPDX-License-Identifier: BSD-3-Clause
// @ts-check
/** The rows of a statement, page by page; each row has a link to its time. */

import { get } from "./api.js";
import { make } from "./page.js";
import * as state from "./state.js";
import { iso, length } from "./times.js";

const CUT = 60;
/** Numbers of rows of a statement in SQL: of the first answer, and of the one that More asks for. */
const SQL_ROWS = 1000;
const MOST_SQL_ROWS = 10000;
const NUMBERS = /^(u?int|float|sum)/;

export class Rows {
  /** @param {(problem: unknown, signal: AbortSignal) => void} fail Shows the error of a further page. */
  constructor(fail) {
    this._place = /** @type {HTMLElement} */ (document.getElementById("ask-rows"));
    this._told = /** @type {HTMLElement} */ (document.getElementById("rows-told"));
    this._more = /** @type {HTMLButtonElement} */ (document.getElementById("rows-more"));
    this._head = /** @type {HTMLElement} */ (this._place.querySelector("thead"));
    this._body = /** @type {HTMLElement} */ (this._place.querySelector("tbody"));
    this._fail = fail;
    /** @type {Record<string, any>} */
    this._parameters = {};
    this._window = "";
    this._after = "";
    this._signal = new AbortController().signal;
    this._more.addEventListener("click", () => this._next());
    this._body.addEventListener("click", (event) => this._open(event));
  }

  /** @param {{start: bigint | null, end: bigint | null}} window */
  shows(window) {
    return this._window === String([window.start, window.end]);
  }

  clear() {
    this._place.hidden = true;
    this._body.replaceChildren();
    this._window = "";
  }

  /**
   * Load the first page of the rows of a time range.
   * @param {Record<string, any>} parameters
   * @param {{start: bigint | null, end: bigint | null}} window
   * @param {AbortSignal} signal
   */
  async load(parameters, window, signal) {
    this._parameters = { ...parameters, ...window, cut: CUT };
    this._window = String([window.start, window.end]);
    this._signal = signal;
    await this._first(signal, parameters.language === "sql" ? SQL_ROWS : null);
  }

  /**
   * Show the first page in place of all rows.
   * @param {AbortSignal} signal
   * @param {number | null} limit Maximum number of its rows; null = the server's.
   */
  async _first(signal, limit) {
    const page = await get("/api/query", { ...this._parameters, limit }, { signal });
    if (signal !== this._signal) return;
    const headings = page.columns.map((/** @type {string} */ name, /** @type {number} */ n) =>
      make("th", { class: NUMBERS.test(page.kinds[n]) ? "number" : "", title: page.kinds[n] }, name));
    this._head.replaceChildren(make("tr", {}, make("th", {}, ""), ...headings));
    this._body.replaceChildren();
    this._place.hidden = false;
    this._add(page);
    if (page.more && limit === SQL_ROWS && page.rows.length === limit) this._offerAgain();
  }

  /** Offer More for a statement in SQL, although there is no further page. */
  _offerAgain() {
    this._more.hidden = false;
    this._told.textContent = `the first ${SQL_ROWS} rows; More runs the statement again, for up to ${MOST_SQL_ROWS}`;
  }

  async _next() {
    this._more.disabled = true;
    // A cancelled request is not the present one; another statement cancels it, too.
    if (this._signal.aborted) this._signal = new AbortController().signal;
    const signal = this._signal;
    try {
      if (this._parameters.language === "sql") {
        // Rows of SQL have no order to go on from: the statement runs again, for more of them.
        await this._first(signal, MOST_SQL_ROWS);
        return;
      }
      const parameters = { ...this._parameters, after: this._after };
      const page = await get("/api/query", parameters, { signal });
      if (signal === this._signal) this._add(page);
    } catch (problem) {
      this._fail(problem, signal);
    } finally {
      this._more.disabled = false;
    }
  }

  /** @param {any} page */
  _add(page) {
    const lines = page.rows.map((/** @type {any[]} */ row, /** @type {number} */ n) => {
      const time = page.times[n];
      const line = make("tr", { "data-time": time ?? false });
      const title = "Show this time in Look";
      line.append(make("td", {}, ...(time ? [make("a", { href: lookAt(time), title }, "look")] : [])));
      for (const [place, value] of row.entries()) line.append(cell(value, page.kinds[place]));
      return line;
    });
    this._body.append(...lines);
    this._after = page.after;
    this._more.hidden = page.after === "";
    const count = this._body.childElementCount;
    const rows = count === 1 ? "1 row" : `${count} rows`;
    const first = page.after ? "" : "; WHERE, GROUP BY or LIMIT select others";
    const text = page.more ? `the first ${rows}${first}` : count ? rows : "no row matches";
    this._told.textContent = [text, ...page.hints].join("; ");
    this._place.dataset.rows = String(count);
  }

  /** @param {MouseEvent} event */
  _open(event) {
    const target = event.target instanceof Element ? event.target : null;
    const line = target?.closest("tr");
    // Marking text, or clicking the link itself, does not select the row.
    if (!line?.dataset.time || target?.closest("a") || String(getSelection())) return;
    if (event.ctrlKey || event.metaKey) window.open(lookAt(line.dataset.time), "_blank");
    else location.assign(lookAt(line.dataset.time));
  }
}

/** @param {string} time Time in an answer, ns. */
export function lookAt(time) {
  return state.link("/look.html", { time: BigInt(time) });
}

/**
 * @param {any} value
 * @param {string} kind
 */
function cell(value, kind) {
  const text = shown(value, kind);
  const number = NUMBERS.test(kind) && !kind.endsWith("[]");
  const names = value === null ? "missing" : number ? "number" : "";
  return make("td", { class: names, title: text.length > 40 ? text : false }, text);
}

/**
 * @param {any} value
 * @param {string} kind
 * @returns {string}
 */
function shown(value, kind) {
  if (value === null) return "–";
  if (typeof value === "object" && "of" in value) {
    return `${shown(value.first, kind)} … ${value.of} ${Array.isArray(value.first) ? "elements" : "in all"}`;
  }
  if (Array.isArray(value)) {
    const inner = kind.replace(/\[\]$/, "");
    return `[${value.map((each) => shown(each, inner)).join(", ")}]`;
  }
  if (kind === "time" && typeof value === "string") return iso(BigInt(value));
  // An interval of DuckDB with months has no length: it comes as its text.
  if (kind === "duration" && /^-?\d+$/.test(String(value))) return length(BigInt(/** @type {string} */ (value)));
  return String(value);
}
