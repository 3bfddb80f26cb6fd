// SPDX-FileCopyrightText: 2026 cassandra_ros authors
// SPDX-License-Identifier: BSD-3-Clause
// @ts-check
/** Page Look: stored messages of a time range in the Studio. The address has time range, time, panels. */

import { get } from "./api.js";
import * as page from "./page.js";
import * as state from "./state.js";

/** Parameters that select the Studio's messages: it is loaded again if one of them changes. */
const CONTENT = /** @type {const} */ (["start", "end", "topics", "nodes", "runs"]);
const INSTALL = "rosrun cassandra_ros viewer --install-studio";

/** @type {HTMLIFrameElement | null} */
let frame = null;
let shown = "";
/** The last selection, which will be shown soon. */
let chosen = contentOf();

function contentOf() {
  const now = state.read();
  return JSON.stringify(CONTENT.map((name) => now[name]), (_, value) =>
    typeof value === "bigint" ? String(value) : value);
}

function open() {
  const content = contentOf();
  if (frame && content === shown) return;
  shown = chosen = content;
  const made = page.make("iframe", { class: "grow", id: "studio", title: "Studio", src: state.link("/studio.html"),
    allow: "fullscreen" });
  if (frame) frame.replaceWith(made);
  else document.getElementById("look")?.replaceChildren(made);
  frame = made;
}

/** @param {MessageEvent} event */
function told(event) {
  if (!frame || event.source !== frame.contentWindow || event.origin !== location.origin) return;
  const { time, layout, error, note, ready, range } = event.data;
  if (range !== undefined) addMenus(range).catch(page.showError);
  if (error !== undefined) {
    page.showError(new Error(error));
    if (!menus.childElementCount) addMenus(state.read()).catch(page.showError);
  }
  if (note !== undefined) page.showNote(note);
  if (time !== undefined) later({ time });
  if (layout !== undefined) later({ layout: layout || null });
  if (ready) {
    frame.dataset.ready = "true";
    frame.focus();
  }
}

/** @type {import("./api.js").Parameters} */
let changes = {};
let waiting = 0;

/**
 * Change the address at most twice a second: browsers refuse more.
 * @param {import("./api.js").Parameters} more
 */
function later(more) {
  Object.assign(changes, more);
  waiting ||= window.setTimeout(() => {
    waiting = 0;
    state.write(changes);
    changes = {};
  }, 500);
}

function explain() {
  document.getElementById("look")?.replaceChildren(
    page.make("div", { class: "note", id: "no-studio" },
      page.make("h1", {}, "The Studio is not installed yet"),
      page.make("p", {}, "Look shows messages in Foxglove Studio (MPL-2.0), which the viewer fetches from npm's "
        + "registry once: 37 MB. In a shell on the viewer's machine:"),
      page.make("pre", {}, INSTALL),
      page.make("p", {}, "You need not stop the viewer; reload this page afterwards. Without the Studio you can ",
        page.make("a", { href: state.link("/ask.html") }, "ask"),
        page.make("span", { id: "look-files" }, ", or save this time range as ",
          page.make("a", { href: state.fileLink("bag") }, "a bag"), " or ",
          page.make("a", { href: state.fileLink("mcap") }, "MCAP"),
          " for rqt_bag, Foxglove or Lichtblick"), "."),
    ),
  );
  page.ifSeveralStores(() => document.getElementById("look-files")?.remove());
}

/** A delay, so that selecting several entries of a menu reloads the Studio once. */
const CHOOSING_MS = 700;
let choosing = 0;

function openLater() {
  // Playing changes the time in the address: that is no new selection.
  const content = contentOf();
  if (content === chosen) return;
  chosen = content;
  window.clearTimeout(choosing);
  choosing = window.setTimeout(open, CHOOSING_MS);
}

const menus = page.make("div", { class: "row" });

/**
 * Offer the topics, robots and runs that have messages in a time range, and the topics under names.
 * @param {{start: bigint | null, end: bigint | null}} range null = open.
 */
async function addMenus({ start, end }) {
  /** @type {{lanes: any[], runs: any[]}} */
  const { lanes, runs } = await get("/api/timeline", { start, end, pixels: 1 });
  const there = lanes.filter((lane) => lane.first !== null || lane.key === "manual");
  const types = new Map(there.map((lane) => [lane.topic, lane.types.join(", ")]));
  page.addSelection(menus, {
    topics: [...types].sort().map(([value, of]) => ({ value, text: `${value} (${of})` })),
    runs: runs.map((each) => ({ value: String(each.id), text: each.run })),
    nodes: [...new Set(there.map((lane) => lane.node))].filter(Boolean).map((value) => ({ value })),
  });
}

page.start("Look");
window.addEventListener("message", told);
document.querySelector("#head nav")?.after(menus);
get("/api/studio").then(({ installed }) => {
  if (!installed) {
    explain();
    state.onChange(explain);
    addMenus(state.read()).catch(page.showError);
  } else {
    open();
    state.onChange(openLater);
  }
}, page.showError);
