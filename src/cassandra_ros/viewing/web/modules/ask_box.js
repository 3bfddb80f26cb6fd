// SPDX-FileCopyrightText: 2026 cassandra_ros authors
// SPDX-License-Identifier: BSD-3-Clause
// @ts-check
/** The box of the statement. The server completes it: it has the grammar and the names. */

import { get } from "./api.js";
import { make, showError } from "./page.js";

const PAUSE_MS = 120;

/** @typedef {{text: string, kind: string, note: string}} Offer */

export class Box {
  /**
   * @param {() => void} run Called on Ctrl+Enter.
   * @param {() => string} language Returns the language of the statement: "" = CQL, or "sql".
   */
  constructor(run, language) {
    this._area = /** @type {HTMLTextAreaElement} */ (document.getElementById("ask-q"));
    this._list = /** @type {HTMLElement} */ (document.getElementById("ask-offers"));
    this._run = run;
    this._language = language;
    /** @type {Offer[]} */
    this._offers = [];
    this._start = 0;
    this._chosen = -1;
    this._timer = 0;
    this._asking = new AbortController();
    this._area.addEventListener("input", () => this._typed());
    this._area.addEventListener("keydown", (event) => this._key(event));
    this._area.addEventListener("blur", () => this._close());
    // Pressing the mouse on an offer must not move the focus before the click.
    this._list.addEventListener("pointerdown", (event) => event.preventDefault());
  }

  get text() {
    return this._area.value;
  }

  set text(text) {
    this._area.value = text;
    this._close();
  }

  /** @param {string} text Statement that the empty box shows. */
  set sample(text) {
    this._area.placeholder = text;
  }

  focus() {
    this._area.focus();
  }

  /**
   * Put the cursor at the position of an error.
   * @param {number} place Position in characters, as the server counts them.
   */
  point(place) {
    const at = [...this._area.value].slice(0, place).join("").length;
    this._area.focus();
    this._area.setSelectionRange(at, at + (/^[\w./]+/.exec(this._area.value.slice(at))?.[0].length ?? 1));
  }

  _typed() {
    clearTimeout(this._timer);
    this._timer = setTimeout(() => this._complete(false), PAUSE_MS);
  }

  /** @param {boolean} asked Whether the user requested it; otherwise only inside a word. */
  async _complete(asked) {
    const before = this._area.value.slice(0, this._area.selectionStart);
    if (!asked && !/[\w/.]$/.test(before)) return this._close();
    this._asking.abort();
    this._asking = new AbortController();
    const at = [...before].length;
    try {
      const parameters = { q: this._area.value, at, language: this._language() };
      const found = await get("/api/complete", parameters, { signal: this._asking.signal });
      this._start = [...this._area.value].slice(0, found.start).join("").length;
      this._show(found.offers, found.more);
    } catch (error) {
      showError(error);
    }
  }

  /**
   * @param {Offer[]} offers
   * @param {number} [more] Number of further ones.
   */
  _show(offers, more = 0) {
    this._offers = offers;
    this._list.replaceChildren(...offers.map((offer, n) => make(
      "li",
      { role: "option", id: `ask-offer-${n}`, onclick: () => this._take(n) },
      offer.text,
      make("span", { class: "note" }, offer.note || offer.kind),
    )));
    const hint = `… and ${more.toLocaleString("en")} more: write more letters`;
    if (more) this._list.append(make("li", { class: "more", role: "presentation" }, hint));
    this._list.hidden = offers.length === 0;
    this._choose(-1);
  }

  _close() {
    clearTimeout(this._timer);
    this._asking.abort();
    this._show([]);
  }

  /** @param {number} n */
  _choose(n) {
    this._list.children[this._chosen]?.removeAttribute("aria-selected");
    this._chosen = n;
    const item = this._list.children[n];
    item?.setAttribute("aria-selected", "true");
    item?.scrollIntoView({ block: "nearest" });
    if (item) this._area.setAttribute("aria-activedescendant", item.id);
    else this._area.removeAttribute("aria-activedescendant");
  }

  /** @param {number} n */
  _take(n) {
    const { text, kind } = this._offers[n];
    const space = kind === "keyword" && !text.endsWith("(") ? " " : "";
    this._area.setRangeText(text + space, this._start, this._area.selectionStart, "end");
    this._close();
    this._area.focus();
    if (space) this._complete(true);
  }

  /** @param {KeyboardEvent} event */
  _key(event) {
    const { key } = event;
    const count = this._offers.length;
    if (key === "Enter" && (event.ctrlKey || event.metaKey)) {
      this._close();
      this._run();
    } else if (key === " " && event.ctrlKey) {
      this._complete(true);
    } else if (count && (key === "ArrowDown" || key === "ArrowUp")) {
      const step = key === "ArrowDown" ? 1 : -1;
      this._choose((Math.max(this._chosen, step > 0 ? -1 : 0) + step + count) % count);
    } else if (count && (key === "Tab" || (key === "Enter" && this._chosen >= 0)) && !event.shiftKey) {
      this._take(Math.max(0, this._chosen));
    } else if (count && key === "Escape") {
      this._close();
    } else {
      return;
    }
    event.preventDefault();
  }
}
