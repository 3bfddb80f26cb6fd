// SPDX-FileCopyrightText: 2026 cassandra_ros authors
// SPDX-License-Identifier: BSD-3-Clause
// @ts-check
/** Parts of all pages: the bar at the head, the banner of errors, the menus of topics, robots, runs. */

import { MISSING, get, isAbort, keyspace as keyspaceAsked, url } from "./api.js";
import * as state from "./state.js";

const PAGES = [
  { name: "Home", path: "/" },
  { name: "Ask", path: "/ask.html" },
  { name: "Look", path: "/look.html" },
  { name: "Map", path: "/map.html", ofOneStore: true },
];

/** Why something is not offered by a viewer of several stores. */
export const ONE_STORE = "One store answers this, and this viewer shows several as one: start a viewer of that store, "
  + "with --store-host in place of --store.";

/** @type {Promise<any> | null} */
let told = null;

/** Return the answer of /api/keyspace, requested once: `stores` has several stores that are shown as one. */
export function keyspaceAnswer() {
  told ??= get("/api/keyspace");
  return told;
}

/**
 * Call a function if the viewer shows several stores.
 * @param {() => void} act
 */
export function ifSeveralStores(act) {
  keyspaceAnswer().then(({ stores }) => stores.length && act(), () => {});
}

/**
 * Make an element. Texts are inserted as text, never as markup.
 * @template {keyof HTMLElementTagNameMap} K
 * @param {K} tag
 * @param {Record<string, string | boolean | ((event: any) => void)>} [attributes] Those like `onclick`
 *   are listeners; false leaves an attribute out.
 * @param {...(Node | string)} children
 * @returns {HTMLElementTagNameMap[K]}
 */
export function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") element.addEventListener(name.slice(2), value);
    else if (value !== false) element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children);
  return element;
}

/**
 * Fill the bar at the head (`<header id="head">`) and show the errors of the address.
 * @param {string} name Name of this page in the bar.
 */
export function start(name) {
  const links = PAGES.map((page) => {
    const link = make("a", { href: state.link(page.path) }, page.name);
    if (page.name === name) link.setAttribute("aria-current", "page");
    return link;
  });
  const keyspace = make("span", { class: "keyspace", id: "keyspace" });
  document.getElementById("head")?.replaceChildren(
    make("a", { class: "brand", href: url("/", { keyspace: keyspaceAsked() }) }, "cassandra_ros"),
    make("nav", { "aria-label": "Pages" }, ...links),
    keyspace,
  );
  window.addEventListener(MISSING, (event) => showMissing(/** @type {CustomEvent} */ (event).detail));
  state.onChange(() => {
    for (const [index, link] of links.entries()) {
      if (!link.hasAttribute("aria-disabled")) link.href = state.link(PAGES[index].path);
    }
  });
  window.addEventListener("unhandledrejection", (event) => {
    showError(event.reason);
    // An error that is shown to the user is not also reported on the console.
    if (event.reason instanceof Error && "status" in event.reason) event.preventDefault();
  });
  for (const problem of state.read().problems) showError(new Error(problem));
  keyspaceAnswer().then((answer) => keyspace.replaceChildren(...shownPlace(answer)), showError);
  const { nodes, start: first, end, time } = state.read();
  if (nodes.length || first || end || time) {
    get("/api/notes", { nodes, start: first, end, time }).then(({ notes }) => notes.forEach(showNote), showError);
  }
  ifSeveralStores(() => {
    for (const [index, page] of PAGES.entries()) if (page.ofOneStore) disable(links[index]);
    if (PAGES.some((page) => page.ofOneStore && page.name === name)) {
      document.querySelector("main")?.replaceChildren(make("p", { class: "panel note", id: "one-store" }, ONE_STORE));
    }
  });
}

/**
 * Return what the bar shows of the keyspace, or of the stores.
 * @param {any} answer Answer of /api/keyspace.
 * @returns {(Node | string)[]}
 */
function shownPlace(answer) {
  return answer.stores.length ? [`stores ${answer.stores.join(", ")}`] : ["keyspace ", chooser(answer)];
}

/**
 * Show that a link is not offered by a viewer of several stores.
 * @param {HTMLAnchorElement} link
 */
function disable(link) {
  link.removeAttribute("href");
  link.setAttribute("aria-disabled", "true");
  link.title = ONE_STORE;
}

/**
 * Show until the page is loaded again that a store did not answer.
 * @param {{store: string, reason: string}} missing
 */
function showMissing({ store, reason }) {
  const id = `missing-${store}`;
  if (document.getElementById(id)) return;
  const text = `Store ${store} did not answer; what only it has is left out here. Load the page again to ask it again. (${reason})`;
  document.getElementById("head")?.after(make("p", { class: "missing", id, role: "alert" }, text));
}

/**
 * Show a note below the bar until it is closed; equal notes only once.
 * @param {string} text
 */
export function showNote(text) {
  if ([...document.querySelectorAll("p.told")].some((each) => each.firstChild?.textContent === text)) return;
  const note = make("p", { class: "told", role: "status" }, make("span", {}, text));
  note.append(make("button", { "aria-label": "Close", onclick: () => note.remove() }, "×"));
  document.getElementById("head")?.after(note);
}

/**
 * Make the menu of keyspaces. Another keyspace opens this page without time range, topics, robots and
 * runs, which belong to the keyspace.
 * @param {{keyspace: string, keyspaces: {keyspace: string, topics: number}[]}} answer Answer of /api/keyspace.
 */
function chooser(answer) {
  const topics = new Map(answer.keyspaces.map((each) => [each.keyspace, each.topics]));
  if (!topics.has(answer.keyspace)) topics.set(answer.keyspace, 0);
  if (topics.size === 1) return answer.keyspace;
  const options = [...topics.keys()].sort().map((name) => (
    make("option", { value: name, title: `${topics.get(name)} topics` }, name)));
  const select = /** @type {HTMLSelectElement} */ (make("select", { "aria-label": "Keyspace" }, ...options));
  select.value = answer.keyspace;
  select.addEventListener("change", () => location.assign(url(location.pathname, { keyspace: select.value })));
  return select;
}

/**
 * Show an error until it is closed; equal errors only once. An aborted request is no error.
 * @param {unknown} error
 */
export function showError(error) {
  if (isAbort(error)) return;
  const text = error instanceof Error ? error.message : String(error);
  let banner = document.getElementById("banner");
  if (!banner) {
    banner = make("div", { id: "banner", role: "alert" });
    document.getElementById("head")?.after(banner);
  }
  if ([...banner.children].some((each) => each.firstChild?.textContent === text)) return;
  const line = make("div", { class: "problem" }, make("pre", {}, text));
  line.append(make("button", { "aria-label": "Close", onclick: () => line.remove() }, "×"));
  banner.append(line);
}

/** Remove all shown errors, as before another attempt. */
export function clearErrors() {
  document.getElementById("banner")?.replaceChildren();
}

/**
 * @typedef {object} Choice
 * @property {string} value Value in the state.
 * @property {string} [text] Shown text; default: the value.
 */

/**
 * Add menus to select topics, robots and runs; the state has the selected ones.
 * @param {HTMLElement} place
 * @param {{topics?: Choice[], nodes?: Choice[], runs?: Choice[], moreRuns?: number}} choices Entries, and the number of
 *   older runs that are not among them. A menu
 *   that is left out, or has fewer than two robots, is not shown.
 */
export function addSelection(place, choices) {
  const { nodes } = choices;
  const menus = [
    choices.runs && menu("runs", "Runs", choices.runs, choices.moreRuns),
    nodes && nodes.length > 1 && menu("nodes", "Robots", nodes),
    choices.topics && menu("topics", "Topics", choices.topics),
  ];
  place.replaceChildren(...menus.flatMap((each) => each || []));
}

/**
 * Send keys to an element if no element has the focus, as on a newly loaded page.
 * @param {HTMLElement} element
 */
export function takeKeys(element) {
  document.addEventListener("keydown", (event) => {
    if (event.target !== document.body) return;
    if (!element.dispatchEvent(new KeyboardEvent("keydown", event))) event.preventDefault();
  });
}

/**
 * @param {"topics" | "nodes" | "runs"} name
 * @param {string} title
 * @param {Choice[]} choices
 * @param {number} [more] Number of entries that are left out.
 */
function menu(name, title, choices, more = 0) {
  // What the address names can be left out again, although it has nothing to offer here.
  const others = state.read()[name].filter((value) => !choices.some((each) => each.value === value));
  choices = [...choices, ...others.map((value) => ({ value }))];
  const summary = make("summary");
  const list = make("ul");
  const boxes = choices.map((choice) => {
    const box = make("input", { type: "checkbox", value: choice.value });
    box.addEventListener("change", () => {
      state.write({ [name]: boxes.filter((each) => each.checked).map((each) => each.value) });
    });
    list.append(make("li", {}, make("label", {}, box, choice.text ?? choice.value)));
    return box;
  });
  const update = () => {
    const chosen = new Set(state.read()[name]);
    for (const box of boxes) box.checked = chosen.has(box.value);
    summary.textContent = chosen.size ? `${title}: ${chosen.size} of ${boxes.length}` : `${title}: all`;
  };
  update();
  state.onChange(update);
  const all = make("button", { onclick: () => state.write({ [name]: null }) }, "All");
  const tools = make("div", { class: "tools" }, filterOf(list, `Filter ${title.toLowerCase()}`), all);
  return make("details", { class: "menu", id: `menu-${name}`, onkeydown: closeOnEscape }, summary,
    make("div", { class: "sheet" }, tools, list, ...(more ? [make("p", { class: "muted more" }, `… and ${more.toLocaleString("en")} older`)] : [])));
}

/**
 * @param {HTMLElement} list
 * @param {string} label
 */
function filterOf(list, label) {
  const filter = make("input", { type: "search", placeholder: label, "aria-label": label });
  filter.addEventListener("input", () => {
    const words = filter.value.toLowerCase().split(/\s+/);
    for (const item of list.querySelectorAll("li")) {
      const text = item.textContent?.toLowerCase() ?? "";
      item.hidden = !words.every((word) => text.includes(word));
    }
  });
  return filter;
}

/** @param {KeyboardEvent} event */
function closeOnEscape(event) {
  const details = /** @type {HTMLDetailsElement} */ (event.currentTarget);
  if (event.key !== "Escape" || !details.open) return;
  details.open = false;
  details.querySelector("summary")?.focus();
  event.stopPropagation();
}

document.addEventListener("pointerdown", (event) => {
  for (const details of document.querySelectorAll("details.menu[open]")) {
    if (event.target instanceof Node && !details.contains(event.target)) details.removeAttribute("open");
  }
});
