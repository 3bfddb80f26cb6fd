// SPDX-FileCopyrightText: 2026 cassandra_ros authors
// SPDX-License-Identifier: BSD-3-Clause
// @ts-check
/**
 * The lasso of the map: it lists when robots were inside. The address has its corners as `lasso`, in
 * metres: x,y;x,y;… On the Earth they are degrees: longitude,latitude;…
 */

import { get, isAbort } from "./api.js";
import { colour } from "./map_view.js";
import * as page from "./page.js";
import * as state from "./state.js";
import * as times from "./times.js";

const MOST_STAYS = 200;
const STEP_PIXELS = 5;
const LEAST_CORNERS = 3;
const MOST_CORNERS = 300;
const CIRCLE_CORNERS = 36;

/** @typedef {import("./map_view.js").Point} Point */
/**
 * @typedef {object} Stay
 * @property {string} node
 * @property {bigint} start
 * @property {bigint} end
 */
/**
 * @typedef {object} Places Functions of the map.
 * @property {() => {node: string, frame: string, times: bigint[], x: number[], y: number[]}[]} tracks
 * @property {() => string} frame
 * @property {() => string} robot Topic of the robot's poses; "" = tf, or found by the viewer.
 * @property {() => Point} unit Metres of the plane for x and y of the frame.
 */

export class Lasso {
  /**
   * @param {import("./map_view.js").MapView} view
   * @param {Places} places
   * @param {HTMLElement} tools Element for its buttons.
   * @param {HTMLElement} panel Element for its results.
   */
  constructor(view, places, tools, panel) {
    this.view = view;
    this.places = places;
    this.panel = panel;
    /** @type {Point[]} */
    this.corners = [];
    /** @type {Stay[]} */
    this.stays = [];
    this.asked = "";
    /** @type {AbortController | null} */
    this.going = null;
    this.button = page.make("button", {
      type: "button", id: "map-lasso", "aria-pressed": "false", title: "Draw around a place (L)",
      onclick: () => this.toggle(),
    }, "Lasso");
    const here = page.make("button", {
      type: "button", id: "map-here", title: "When robots were around the middle (N)",
      onclick: () => this.aroundMiddle(),
    }, "Near the middle");
    tools.append(this.button, here);
    view.layers.push((context) => this.draw(context));
    view.canvas.addEventListener("keydown", (event) => this.key(event));
    state.onChange(() => this.refresh());
  }

  get active() { return this.view.tool !== null; }

  toggle() {
    this.view.tool = this.active ? null : this.tool();
    this.button.setAttribute("aria-pressed", String(this.active));
    this.view.canvas.classList.toggle("lasso", this.active);
  }

  /** @returns {import("./map_view.js").Tool} */
  tool() {
    return {
      down: (at) => {
        this.corners = [at];
        this.stays = [];
      },
      move: (at) => this.add(at),
      up: () => {
        this.toggle();
        this.write(this.corners);
      },
    };
  }

  /** @param {Point} at */
  add(at) {
    const last = this.corners.at(-1);
    if (last && Math.hypot(at.x - last.x, at.y - last.y) * this.view.scale < STEP_PIXELS) return;
    this.corners.push(at);
    this.view.draw();
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === "l") this.toggle();
    else if (event.key === "n") this.aroundMiddle();
    else if (event.key === "Escape" && this.active) this.toggle();
    else if (event.key === "Escape") this.close();
    else return;
    event.preventDefault();
  }

  /** Use a circle around the middle, half as wide as the view; it needs no pointer. */
  aroundMiddle() {
    const { centre, scale, width, height } = this.view;
    const radius = Math.min(width, height) / scale / 4;
    this.write([...Array(CIRCLE_CORNERS).keys()].map((n) => {
      const angle = (2 * Math.PI * n) / CIRCLE_CORNERS;
      return { x: centre.x + radius * Math.cos(angle), y: centre.y + radius * Math.sin(angle) };
    }));
  }

  close() {
    state.write({ lasso: null }, { push: true });
  }

  /**
   * Put a lasso into the address, unless it encloses no area.
   * @param {Point[]} corners
   */
  write(corners) {
    const every = Math.max(1, Math.ceil(corners.length / MOST_CORNERS));
    const kept = corners.filter((_, n) => n % every === 0);
    const unit = this.places.unit();
    const digits = Math.max(0, Math.ceil(Math.log10(this.view.scale * unit.y)) + 1);
    const text = kept.map((at) => `${(at.x / unit.x).toFixed(digits)},${(at.y / unit.y).toFixed(digits)}`).join(";");
    state.write({ lasso: kept.length < LEAST_CORNERS ? null : text }, { push: true });
    this.refresh();
  }

  /** Request the stays in the lasso of the address if it differs from the last request. */
  refresh() {
    const { others, start, end, nodes, runs } = state.read();
    const polygon = others.lasso ?? "";
    const [frame, robot] = [this.places.frame(), this.places.robot()];
    const wanted = { polygon, frame, robot, start, end, nodes, runs, limit: String(MOST_STAYS) };
    const text = JSON.stringify(wanted, (_, value) => (typeof value === "bigint" ? String(value) : value));
    if (text === this.asked) return;
    this.asked = text;
    this.going?.abort();
    const unit = this.places.unit();
    this.corners = polygon.split(";").filter(Boolean).map((pair) => {
      const [x, y] = pair.split(",").map(Number);
      return { x: x * unit.x, y: y * unit.y };
    });
    this.stays = [];
    this.view.draw();
    delete this.view.canvas.dataset.stays;
    this.panel.replaceChildren();
    if (polygon) this.ask(wanted);
  }

  /** @param {import("./api.js").Parameters} wanted */
  ask(wanted) {
    this.going = new AbortController();
    this.show(page.make("p", { class: "muted" }, "Searching for the times when robots were there …"));
    get("/api/near", wanted, { signal: this.going.signal }).then(
      (answer) => {
        this.stays = answer.stays.map((/** @type {any} */ stay) => (
          { node: stay.node, start: BigInt(stay.start), end: BigInt(stay.end) }));
        this.show(this.listing(answer.more));
        this.view.canvas.dataset.stays = String(this.stays.length);
        this.view.draw();
      },
      (error) => {
        if (isAbort(error)) return;
        this.panel.replaceChildren();
        page.showError(error);
      },
    );
  }

  /** @param {HTMLElement} content */
  show(content) {
    const close = page.make("button", { type: "button", "aria-label": "Close", onclick: () => this.close() }, "×");
    const title = page.make("div", { class: "row" }, page.make("strong", {}, "In the lasso"), close);
    this.panel.replaceChildren(page.make("div", { class: "panel" }, title, content));
  }

  /** @param {boolean} more */
  listing(more) {
    if (!this.stays.length) return page.make("p", { class: "muted" }, "No robot was there, according to the stored poses.");
    const items = this.stays.map(({ node, start, end }) => {
      const text = `${node ? `${node} ` : ""}${times.shown(start)}, ${times.length(end - start)}`;
      const look = page.make("a", { href: state.link("/look.html", { time: start, lasso: null }) }, "Look");
      const home = page.make("a", { href: state.link("/", { start, end, lasso: null }) }, "Home");
      const bag = page.make("a", { href: state.fileLink("bag", { start, end }) }, "Bag");
      return page.make("li", {}, text, " ", look, " ", home, " ", bag);
    });
    const list = page.make("ul", {}, ...items);
    if (more) list.append(page.make("li", { class: "muted" }, `… and more: choose a shorter time (${MOST_STAYS} are shown)`));
    return list;
  }

  /** @param {CanvasRenderingContext2D} context */
  draw(context) {
    this.drawStays(context);
    if (this.corners.length < 2) return;
    context.beginPath();
    for (const [n, corner] of this.corners.entries()) {
      const at = this.view.toScreen(corner.x, corner.y);
      if (n) context.lineTo(at.x, at.y);
      else context.moveTo(at.x, at.y);
    }
    context.closePath();
    context.fillStyle = context.strokeStyle = colour("--accent");
    context.globalAlpha = 0.12;
    context.fill();
    context.globalAlpha = 1;
    context.setLineDash([6, 4]);
    context.lineWidth = 1.5;
    context.stroke();
  }

  /** @param {CanvasRenderingContext2D} context */
  drawStays(context) {
    context.save();
    context.lineWidth = 5;
    context.strokeStyle = colour("--mark");
    context.lineCap = "round";
    for (const track of this.places.tracks()) {
      const stays = this.stays.filter((stay) => stay.node === track.node);
      let last = -2;
      context.beginPath();
      track.times.forEach((time, n) => {
        if (!stays.some((stay) => stay.start <= time && time <= stay.end)) return;
        const at = this.view.toScreen(track.x[n], track.y[n]);
        if (n === last + 1) context.lineTo(at.x, at.y);
        else context.moveTo(at.x, at.y);
        last = n;
      });
      context.stroke();
    }
    context.restore();
  }
}
