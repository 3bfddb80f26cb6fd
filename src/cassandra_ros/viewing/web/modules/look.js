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
  const { time, layout, error, note, ready } = event.data;
  if (error !== undefined) page.showError(new Error(error));
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

async function addMenus() {
  const place = page.make("div", { class: "row" });
  document.querySelector("#head nav")?.after(place);
  const [{ topics }, { runs, left_off: moreRuns }] = await Promise.all([
    get("/api/topics", { counts: "0" }),
    get("/api/runs", { counts: "0" }),
  ]);
  const nodes = [...new Set(runs.map((/** @type {any} */ run) => run.node).filter(Boolean))].sort();
  page.addSelection(place, {
    topics: topics.map((/** @type {any} */ each) => ({ value: each.topic, text: `${each.topic} (${each.types.join(", ")})` })),
    runs: runs.map((/** @type {any} */ each) => ({ value: String(each.id), text: each.run })),
    moreRuns,
    nodes: nodes.map((value) => ({ value })),
  });
}

page.start("Look");
window.addEventListener("message", told);
addMenus().catch(page.showError);
get("/api/studio").then(({ installed }) => {
  if (!installed) {
    explain();
    state.onChange(explain);
  } else {
    open();
    state.onChange(openLater);
  }
}, page.showError);
