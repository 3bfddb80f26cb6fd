// SPDX-FileCopyrightText: 2026 cassandra_ros authors
// SPDX-License-Identifier: BSD-3-Clause
// @ts-check
/**
 * A canvas that shows stored messages over time: a row for each topic, a heading with the runs for each
 * robot, and all time in a strip above. It draws a Picture and sends events for the user's actions.
 */

import { iso, length, shown, ticks } from "./times.js";
import { Picture } from "./timeline_data.js";

const STRIP = 34;
const AXIS = 26;
const TOP = STRIP + AXIS;
const ROW = 22;
const BAR = 14;
const NAMES_LEAST = 150;
const NAMES_MOST = 320;
const NAMES_PART = 0.3;
/** Minimum length of the visible time range, ns. */
const SHORTEST = 1000n;
const WHEEL_ZOOM = 1.0016;
const CLICK_PX = 4;
/** Maximum number of events, marks or losses that are described at a place. */
const MOST_TOLD = 4;
const MOST_TEXTS = 5000;

/**
 * @typedef {object} Span
 * @property {bigint} start Included.
 * @property {bigint} end Included.
 */

/**
 * @typedef {{kind: "robot", node: string, y: number}
 *   | {kind: "lane", lane: import("./timeline_data.js").Lane, busy: boolean, y: number}} Line
 * busy: whether it has something in the visible time range.
 */

/**
 * @typedef {object} Drag
 * @property {string} kind
 * @property {number} x Where it began, pixels.
 * @property {number} y
 * @property {boolean} moved Whether the pointer has left the place of a click.
 * @property {Span} view Visible time range at the begin.
 * @property {number} scrolled Pixels that the rows were scrolled at the begin.
 */

/**
 * Events: `view` when the visible time range changed, `resize`, `scroll` when other rows are visible,
 * `select` when the selection changed, `moment` when a time was clicked, `mark` when the selection is to
 * become an event.
 */
export class Timeline extends EventTarget {
  /**
   * @param {HTMLCanvasElement} canvas Canvas in a box that has its size; it gets the keyboard.
   * @param {HTMLElement} tip Element for the description of the place below the pointer.
   */
  constructor(canvas, tip) {
    super();
    this.canvas = canvas;
    this.tip = tip;
    this.picture = new Picture();
    /** @type {Span} Visible time range. */
    this.view = { start: 0n, end: 1n };
    /** @type {Span | null} */
    this.selection = null;
    /** @type {bigint | null} */
    this.moment = null;
    /** @type {import("./timeline_data.js").Lane | null} Lane of the last click or selection. */
    this.lane = null;
    this.scrolled = 0;
    /** @type {Line[]} */
    this.lines = [];
    this.size = { width: 0, height: 0, names: 0 };
    /** @type {{x: number, y: number} | null} */
    this.pointer = null;
    /** @type {Drag | null} The present drag. */
    this.drag = null;
    this.asked = 0;
    /** @type {Map<string, string>} Shortened texts. */
    this.shortened = new Map();
    this.colours = coloursOf(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      this.colours = coloursOf(canvas);
      this.redraw();
    });
    new ResizeObserver(() => this.resize()).observe(/** @type {Element} */ (canvas.parentElement));
    this.listen();
  }

  /** Lay out the picture again and draw it: what has nothing in the visible time range below the others. */
  update() {
    this.lines = [];
    let y = 0;
    let node = null;
    const { start, end } = this.view;
    const busy = new Set(this.picture.lanes.filter((lane) => lane.isIn(start, end)));
    const idle = this.picture.lanes.filter((lane) => !busy.has(lane));
    for (const lane of [...busy, ...idle]) {
      if (lane.node !== node) {
        node = lane.node;
        this.lines.push({ kind: "robot", node, y });
        y += ROW;
      }
      this.lines.push({ kind: "lane", lane, busy: busy.has(lane), y });
      y += ROW;
    }
    this.layOut();
    this.scrollTo(this.scrolled);
    this.redraw();
  }

  /** @returns {import("./timeline_data.js").Lane[]} Lanes of all rows, in order. */
  get lanes() {
    return this.lines.flatMap((line) => (line.kind === "lane" ? [line.lane] : []));
  }

  /** @returns {import("./timeline_data.js").Lane[]} Lanes of the visible rows. */
  get seen() {
    return this.lines.flatMap((line) => (line.kind === "lane" && this.isSeen(line) ? [line.lane] : []));
  }

  /** @returns {Span} All time with a margin; for an empty store one hour. */
  get whole() {
    const { first, last } = this.picture;
    if (first === null || last === null) return { start: 0n, end: 3_600_000_000_000n };
    const room = (last - first) / 50n + 1_000_000n;
    return { start: first > room ? first - room : 0n, end: last + room };
  }

  /**
   * Show a time range.
   * @param {Span} span
   */
  show({ start, end }) {
    const { start: low, end: high } = this.whole;
    const most = (high - low) * 2n;
    let long = end - start + 1n;
    if (long < SHORTEST) long = SHORTEST;
    if (long > most) long = most;
    let from = start + (end - start + 1n - long) / 2n;
    // At least a part of the stored messages stays visible.
    if (from > high - long / 8n) from = high - long / 8n;
    if (from + long < low + long / 8n) from = low + long / 8n - long;
    if (from < 0n) from = 0n;
    if (from === this.view.start && from + long - 1n === this.view.end) return;
    this.view = { start: from, end: from + long - 1n };
    this.redraw();
    this.tell("view");
  }

  /**
   * Zoom in (below 1) or out about a time.
   * @param {number} factor
   * @param {bigint} [about]
   */
  zoom(factor, about = (this.view.start + this.view.end) / 2n) {
    const { start, end } = this.view;
    const before = scaled(about - start, factor);
    this.show({ start: about - before, end: about - before + scaled(end - start + 1n, factor) - 1n });
  }

  /** @param {number} part Share of the visible time range, to later times. */
  pan(part) {
    const by = scaled(this.view.end - this.view.start + 1n, part);
    this.show({ start: this.view.start + by, end: this.view.end + by });
  }

  /** @param {Span | null} span */
  select(span) {
    this.selection = span;
    this.redraw();
    this.tell("select");
  }

  /** @param {bigint} ns @returns {number} */
  xOf(ns) {
    const { start, end } = this.view;
    const { names, width } = this.size;
    return names + (Number(ns - start) / Number(end - start + 1n)) * (width - names);
  }

  /** @param {number} x @returns {bigint} */
  timeAt(x) {
    return timeIn(this.view, (x - this.size.names) / (this.size.width - this.size.names));
  }

  resize() {
    const box = /** @type {HTMLElement} */ (this.canvas.parentElement);
    if (!box.clientWidth) return; // the box is hidden
    const ratio = devicePixelRatio || 1;
    this.size.width = box.clientWidth;
    this.size.height = box.clientHeight;
    this.canvas.width = Math.round(this.size.width * ratio);
    this.canvas.height = Math.round(this.size.height * ratio);
    this.canvas.style.width = `${this.size.width}px`;
    this.canvas.style.height = `${this.size.height}px`;
    this.layOut();
    this.scrollTo(this.scrolled);
    this.draw();
    this.tell("resize");
  }

  /** @returns {number} Height with all rows, pixels. */
  get wanted() {
    return TOP + this.lines.length * ROW + 10;
  }

  layOut() {
    this.shortened.clear();
    const pen = this.pen();
    pen.font = this.colours.font;
    const widest = this.lines.reduce((most, line) => {
      const text = line.kind === "lane" ? line.lane.topic : line.node;
      return Math.max(most, pen.measureText(text).width);
    }, NAMES_LEAST);
    const most = Math.min(NAMES_MOST, Math.max(NAMES_LEAST, this.size.width * NAMES_PART));
    this.size.names = Math.round(Math.min(widest + 34, most));
  }

  get scrollMost() {
    return Math.max(0, this.wanted - this.size.height);
  }

  /** @param {number} y */
  scrollTo(y) {
    const to = Math.max(0, Math.min(this.scrollMost, y));
    if (to === this.scrolled) return;
    this.scrolled = to;
    this.redraw();
    this.tell("scroll");
  }

  /** @param {Line} line */
  isSeen(line) {
    const y = line.y - this.scrolled;
    return y > -ROW && y < this.size.height - TOP;
  }

  /** @param {number} y @returns {Line | undefined} */
  lineAt(y) {
    return y < TOP ? undefined : this.lines[Math.floor((y - TOP + this.scrolled) / ROW)];
  }

  /** @param {string} name */
  tell(name) {
    this.dispatchEvent(new Event(name));
  }

  listen() {
    const on = (/** @type {string} */ name, /** @type {(event: any) => void} */ react) =>
      this.canvas.addEventListener(name, react, { passive: false });
    on("wheel", (event) => this.onWheel(event));
    on("pointerdown", (event) => this.onDown(event));
    on("pointermove", (event) => this.onMove(event));
    on("pointerup", (event) => this.onUp(event));
    on("pointercancel", () => (this.drag = null));
    on("pointerleave", () => {
      this.pointer = null;
      this.redraw();
    });
    on("dblclick", (event) => {
      if (event.offsetX > this.size.names && event.offsetY > STRIP) {
        if (this.selection) this.show(this.selection);
        else this.zoom(0.25, this.timeAt(event.offsetX));
      }
    });
    on("keydown", (event) => this.onKey(event));
  }

  /** @param {WheelEvent} event */
  onWheel(event) {
    event.preventDefault();
    const unit = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 32 : 1;
    const [dx, dy] = [event.deltaX * unit, event.deltaY * unit];
    const plot = this.size.width - this.size.names;
    if (event.offsetX < this.size.names) this.scrollTo(this.scrolled + dy);
    else if (event.shiftKey || Math.abs(dx) > Math.abs(dy)) this.pan((dx || dy) / plot);
    else this.zoom(WHEEL_ZOOM ** dy, this.timeAt(event.offsetX));
  }

  /** @param {PointerEvent} event */
  onDown(event) {
    if (event.button > 1) return;
    event.preventDefault();
    this.canvas.focus({ preventScroll: true });
    this.canvas.setPointerCapture(event.pointerId);
    const { offsetX: x, offsetY: y } = event;
    let kind = "select";
    if (y < STRIP) kind = "strip";
    else if (x < this.size.names) kind = "scroll";
    else if (y < TOP || event.shiftKey || event.button === 1 || event.pointerType === "touch") kind = "pan";
    const line = this.lineAt(y);
    if (kind === "select" && line?.kind === "lane") this.lane = line.lane;
    this.drag = { kind, x, y, moved: false, view: this.view, scrolled: this.scrolled };
    if (kind === "strip") this.centre(x);
  }

  /** @param {PointerEvent} event */
  onMove(event) {
    const { offsetX: x, offsetY: y } = event;
    this.pointer = { x, y };
    const drag = this.drag;
    if (!drag) {
      this.canvas.style.cursor = y < TOP ? "grab" : x < this.size.names ? "default" : "crosshair";
      this.redraw();
      return;
    }
    drag.moved ||= Math.abs(x - drag.x) + Math.abs(y - drag.y) > CLICK_PX;
    if (!drag.moved) return;
    const plot = this.size.width - this.size.names;
    if (drag.kind === "strip") this.centre(x);
    else if (drag.kind === "scroll") this.scrollTo(drag.scrolled + drag.y - y);
    else if (drag.kind === "pan") {
      const { start, end } = drag.view;
      const by = scaled(end - start + 1n, (drag.x - x) / plot);
      this.show({ start: start + by, end: end + by });
    } else {
      const edge = (/** @type {number} */ at) => this.timeAt(Math.max(this.size.names, Math.min(at, this.size.width)));
      const [one, other] = [edge(drag.x), edge(x)];
      this.select(one < other ? { start: one, end: other } : { start: other, end: one });
    }
    this.redraw();
  }

  /** @param {PointerEvent} event */
  onUp(event) {
    const drag = this.drag;
    this.drag = null;
    if (!drag || drag.moved || drag.kind === "strip") return;
    const line = this.lineAt(drag.y);
    if (drag.kind === "select") {
      const ns = this.timeAt(event.offsetX);
      if (this.selection) this.select(null);
      this.moment = ns;
      const run = line?.kind === "robot" ? this.runAt(line.node, ns) : undefined;
      if (run) this.select({ start: run.first, end: run.last });
      this.tell("moment");
      this.redraw();
    }
  }

  /** @param {number} x Position in the strip of all time that becomes the middle of the view. */
  centre(x) {
    const { names, width } = this.size;
    const at = timeIn(this.whole, (x - names) / (width - names));
    const half = (this.view.end - this.view.start) / 2n;
    this.show({ start: at - half, end: at + half });
  }

  /** @param {KeyboardEvent} event */
  onKey(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    /** @type {Record<string, () => void>} */
    const keys = {
      ArrowLeft: () => this.pan(event.shiftKey ? -0.5 : -0.1),
      ArrowRight: () => this.pan(event.shiftKey ? 0.5 : 0.1),
      ArrowUp: () => this.scrollTo(this.scrolled - ROW),
      ArrowDown: () => this.scrollTo(this.scrolled + ROW),
      PageUp: () => this.scrollTo(this.scrolled - this.size.height + TOP),
      PageDown: () => this.scrollTo(this.scrolled + this.size.height - TOP),
      "+": () => this.zoom(0.5, this.moment ?? undefined),
      "=": () => this.zoom(0.5, this.moment ?? undefined),
      "-": () => this.zoom(2, this.moment ?? undefined),
      Home: () => this.show(this.whole),
      0: () => this.show(this.whole),
      Enter: () => this.selection && this.show(this.selection),
      "[": () => this.select({ start: this.view.start, end: this.moment ?? this.view.end }),
      "]": () => this.select({ start: this.moment ?? this.view.start, end: this.view.end }),
      Escape: () => this.select(null),
      e: () => this.selection && this.tell("mark"),
      E: () => this.selection && this.tell("mark"),
    };
    const act = keys[event.key];
    if (!act) return;
    event.preventDefault();
    act();
  }

  pen() {
    return /** @type {CanvasRenderingContext2D} */ (this.canvas.getContext("2d"));
  }

  /** Draw with the next frame. */
  redraw() {
    if (this.asked) return;
    this.asked = requestAnimationFrame(() => this.draw());
  }

  draw() {
    cancelAnimationFrame(this.asked);
    this.asked = 0;
    const pen = this.pen();
    const { width, height, names } = this.size;
    const ratio = devicePixelRatio || 1;
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    pen.font = this.colours.font;
    pen.textBaseline = "middle";
    const axis = ticks(this.view.start, this.view.end, (width - names) / 76);
    this.drawGrid(pen, axis.ticks);
    pen.save();
    pen.beginPath();
    pen.rect(0, TOP, width, height - TOP);
    pen.clip();
    for (const line of this.lines.filter((each) => this.isSeen(each))) {
      const y = TOP + line.y - this.scrolled;
      if (line.kind === "robot") this.drawRobot(pen, line.node, y);
      else this.drawLane(pen, line.lane, line.busy, y);
    }
    this.drawScrollbar(pen);
    this.drawSpan(pen);
    pen.restore();
    this.drawAxis(pen, axis);
    this.drawFlags(pen);
    this.drawStrip(pen);
    this.drawPointer(pen);
  }

  /** @param {CanvasRenderingContext2D} pen @param {import("./times.js").Tick[]} found */
  drawGrid(pen, found) {
    for (const tick of found) {
      pen.fillStyle = tick.major ? this.colours.line : this.colours.raised;
      pen.fillRect(Math.round(this.xOf(tick.ns)), TOP, 1, this.size.height - TOP);
    }
  }

  /** @param {CanvasRenderingContext2D} pen @param {ReturnType<typeof ticks>} axis */
  drawAxis(pen, axis) {
    const { names, width } = this.size;
    pen.fillStyle = this.colours.surface;
    pen.fillRect(0, STRIP, width, AXIS);
    pen.fillStyle = this.colours.line;
    pen.fillRect(0, TOP - 1, width, 1);
    pen.textAlign = "left";
    for (const tick of axis.ticks) {
      const x = Math.round(this.xOf(tick.ns));
      if (x < names || x > width - 24) continue;
      pen.fillStyle = this.colours.line;
      pen.fillRect(x, TOP - 7, 1, 7);
      pen.fillStyle = tick.major ? this.colours.text : this.colours.muted;
      pen.fillText(tick.text, x + 4, STRIP + AXIS / 2 - 1);
    }
    pen.fillStyle = this.colours.muted;
    const long = length(this.view.end - this.view.start + 1n);
    this.fitted(pen, `${shown(this.view.start, axis.step >= 60_000_000_000n ? 86_400_000_000_000n : 60_000_000_000n)} · ${long}`, 10, STRIP + AXIS / 2 - 1, names - 14);
  }

  /** @param {CanvasRenderingContext2D} pen Draws the events: a flag at the start, a line to the end. */
  drawFlags(pen) {
    const { names, width } = this.size;
    pen.fillStyle = this.colours.accent;
    for (const event of this.picture.events) {
      const x = Math.round(this.xOf(event.start));
      const end = event.end === null ? width : Math.min(width, this.xOf(event.end));
      if (end < names || x > width) continue;
      pen.fillRect(Math.max(names, x), TOP - 3, Math.max(1, end - Math.max(names, x)), 2);
      if (x < names) continue;
      pen.fillRect(x, STRIP + 2, 1, AXIS - 4);
      pen.beginPath();
      pen.moveTo(x, STRIP + 2);
      pen.lineTo(x + 8, STRIP + 5);
      pen.lineTo(x, STRIP + 9);
      pen.fill();
    }
  }

  /** @param {CanvasRenderingContext2D} pen All time, with the visible time range. */
  drawStrip(pen) {
    const { names, width } = this.size;
    const { whole } = this;
    const plot = width - names;
    const lane = this.picture.whole;
    pen.fillStyle = this.colours.ground;
    pen.fillRect(0, 0, width, STRIP);
    const xOf = (/** @type {bigint} */ ns) => names + (Number(ns - whole.start) / Number(whole.end - whole.start)) * plot;
    pen.fillStyle = this.colours.soft;
    if (lane.scale && lane.most) {
      for (let cell = 0; cell < lane.counts.length; cell++) {
        if (!lane.counts[cell]) continue;
        const x = xOf(lane.scale.start + BigInt(cell) * lane.scale.step);
        const high = Math.max(3, (lane.counts[cell] / lane.most) * (STRIP - 12));
        const wide = (Number(lane.scale.step) / Number(whole.end - whole.start)) * plot;
        pen.fillRect(x, STRIP - 5 - high, Math.max(1, wide), high);
      }
    }
    const [from, to] = [xOf(this.view.start), xOf(this.view.end)].map((x) => Math.max(names, Math.min(width, x)));
    const wide = Math.max(3, to - from);
    pen.fillStyle = this.colours.accent;
    pen.globalAlpha = 0.14;
    pen.fillRect(from, 2, wide, STRIP - 4);
    pen.globalAlpha = 1;
    pen.strokeStyle = this.colours.accent;
    pen.strokeRect(from + 0.5, 2.5, Math.max(2, wide - 1), STRIP - 5);
    pen.fillStyle = this.colours.muted;
    pen.textAlign = "left";
    const { first, last } = this.picture;
    this.fitted(pen, first === null || last === null ? "nothing stored" : `all: ${length(last - first)}`, 10, STRIP / 2, names - 14);
    pen.fillStyle = this.colours.line;
    pen.fillRect(0, STRIP - 1, width, 1);
  }

  /** @param {CanvasRenderingContext2D} pen @param {string} node @param {number} y */
  drawRobot(pen, node, y) {
    const { names, width } = this.size;
    pen.fillStyle = this.colours.raised;
    pen.fillRect(0, y, width, ROW);
    let last = names;
    for (const run of this.picture.runs.filter((each) => each.node === node)) {
      const [from, to] = [Math.max(names, this.xOf(run.first)), Math.min(width, this.xOf(run.last))];
      if (to < names || from > width) continue;
      const wide = Math.max(2, to - from);
      pen.fillStyle = this.colours.runSoft;
      pen.fillRect(from, y + 4, wide, BAR);
      pen.fillStyle = this.colours.run;
      pen.fillRect(from, y + 4, Math.min(2, wide), BAR);
      if (from >= last && wide > 30) {
        pen.fillStyle = this.colours.text;
        pen.textAlign = "left";
        this.fitted(pen, run.run, from + 7, y + ROW / 2, wide - 12);
      }
      last = Math.max(last, from + wide);
    }
    pen.fillStyle = this.colours.mark;
    for (const mark of this.picture.marks.filter((each) => each.kind !== "loss" && each.node === node)) {
      const x = Math.round(this.xOf(mark.start));
      if (x < names || x > width) continue;
      const way = mark.kind === "end" ? -6 : 6; // towards the recording
      pen.beginPath();
      pen.moveTo(x, y + 1);
      pen.lineTo(x + way, y + 5);
      pen.lineTo(x, y + 9);
      pen.fill();
      pen.fillRect(x, y + 1, 1, ROW - 3);
    }
    this.drawName(pen, node || "runs", y, true);
  }

  /** @param {CanvasRenderingContext2D} pen @param {import("./timeline_data.js").Lane} lane @param {boolean} busy @param {number} y */
  drawLane(pen, lane, busy, y) {
    const base = y + (ROW + BAR) / 2;
    const { names, width } = this.size;
    pen.fillStyle = this.colours.line;
    for (const [low, high] of lane.gaps) {
      const [from, to] = [Math.max(names, this.xOf(low)), Math.min(width, this.xOf(high))];
      if (to > from) pen.fillRect(from, Math.round(base - BAR / 2), to - from, 1);
    }
    if (lane.scale) this.drawCells(pen, lane, lane.scale, base);
    pen.fillStyle = this.colours.loss;
    for (const loss of lane.losses) {
      const [from, to] = [Math.max(names, this.xOf(loss.start)), Math.min(width, this.xOf(loss.end))];
      if (to >= names && from <= width) pen.fillRect(from - 1, base - 3, Math.max(3, to - from), 5);
    }
    this.drawName(pen, lane.topic, y, false, busy ? this.colours.text : this.colours.muted);
    if (lane.writing) {
      pen.fillStyle = this.colours.loss;
      pen.beginPath();
      pen.arc(names - 10, y + ROW / 2, 3, 0, 7);
      pen.fill();
    }
  }

  /**
   * @param {CanvasRenderingContext2D} pen
   * @param {import("./timeline_data.js").Lane} lane
   * @param {import("./timeline_data.js").Scale} scale
   * @param {number} base
   */
  drawCells(pen, lane, scale, base) {
    const { names, width } = this.size;
    const ratio = devicePixelRatio || 1;
    const perCell = this.xOf(this.view.start + scale.step) - names;
    const origin = this.xOf(scale.start);
    const first = Math.max(0, Math.floor((names - origin) / perCell));
    const last = Math.min(scale.cells - 1, Math.ceil((width - origin) / perCell));
    pen.fillStyle = this.colours.soft;
    for (const [from, to] of lane.unknown) {
      if (to >= first && from <= last) pen.fillRect(origin + from * perCell, base - BAR / 2 - 1, (to - from + 1) * perCell, 3);
    }
    const even = evenOf(lane.even, first, last);
    for (let cell = first; cell <= last; ) {
      const count = lane.counts[cell];
      let next = cell + 1;
      while (next <= last && lane.counts[next] === count && even[next - first] === even[cell - first]) next++;
      if (count) {
        // By the square root: otherwise one burst would make all other bars tiny.
        const high = Math.max(3, Math.round(Math.sqrt(count / lane.most) * BAR));
        // On whole pixels: otherwise a narrow bar would be pale.
        const [from, to] = [origin + cell * perCell, origin + next * perCell].map((x) => Math.round(Math.max(names, Math.min(width, x)) * ratio) / ratio);
        pen.fillStyle = even[cell - first] ? this.colours.soft : this.colours.data;
        pen.fillRect(from, base - high, Math.max(1, to - from), high);
      }
      cell = next;
    }
  }

  /** @param {CanvasRenderingContext2D} pen @param {string} text @param {number} y @param {boolean} heading @param {string} colour */
  drawName(pen, text, y, heading, colour = this.colours.muted) {
    const { names } = this.size;
    pen.fillStyle = heading ? this.colours.raised : this.colours.surface;
    pen.fillRect(0, y, names - 1, ROW);
    pen.fillStyle = colour;
    pen.textAlign = "left";
    this.fitted(pen, text, heading ? 10 : 14, y + ROW / 2, names - (heading ? 18 : 32));
  }

  /** @param {CanvasRenderingContext2D} pen Draws the selection and the clicked time. */
  drawSpan(pen) {
    const { names, width, height } = this.size;
    if (this.selection) {
      const from = Math.max(names, this.xOf(this.selection.start));
      const to = Math.min(width, this.xOf(this.selection.end));
      if (to >= names && from <= width) {
        pen.fillStyle = this.colours.accent;
        pen.globalAlpha = 0.13;
        pen.fillRect(from, TOP, Math.max(1, to - from), height);
        pen.globalAlpha = 1;
        pen.fillRect(from, TOP, 1, height);
        pen.fillRect(to, TOP, 1, height);
      }
    }
    const x = this.moment === null ? -1 : Math.round(this.xOf(this.moment));
    if (x >= names && x <= width) {
      pen.fillStyle = this.colours.mark;
      pen.fillRect(x, TOP, 1, height);
    }
  }

  /** @param {CanvasRenderingContext2D} pen */
  drawScrollbar(pen) {
    const high = this.size.height - TOP;
    const all = this.scrollMost + high;
    if (all <= high) return;
    pen.fillStyle = this.colours.muted;
    pen.globalAlpha = 0.5;
    const size = Math.max(24, (high * high) / all);
    pen.fillRect(this.size.width - 5, TOP + (this.scrolled / this.scrollMost) * (high - size), 4, size);
    pen.globalAlpha = 1;
  }

  /** @param {CanvasRenderingContext2D} pen */
  drawPointer(pen) {
    const at = this.pointer;
    if (!at || at.y < STRIP || (at.y < TOP && !this.eventsAt(this.timeAt(at.x)).length) || this.drag?.kind === "pan" || (at.x < this.size.names && !this.lineAt(at.y))) {
      this.tip.hidden = true;
      return;
    }
    if (at.x >= this.size.names) {
      pen.fillStyle = this.colours.muted;
      pen.fillRect(Math.round(at.x), STRIP, 1, this.size.height);
    }
    const lines = this.tellOf(at);
    this.tip.replaceChildren(...lines.map((text) => Object.assign(document.createElement("div"), { textContent: text })));
    this.tip.hidden = false;
    const left = at.x + 16 + this.tip.offsetWidth > this.size.width ? at.x - 12 - this.tip.offsetWidth : at.x + 16;
    const top = Math.min(at.y + 14, this.size.height - this.tip.offsetHeight - 4);
    this.tip.style.transform = `translate(${Math.max(0, left)}px, ${Math.max(0, top)}px)`;
  }

  /** @param {{x: number, y: number}} at @returns {string[]} Description of the place below the pointer. */
  tellOf({ x, y }) {
    const ns = this.timeAt(x);
    const line = this.lineAt(y);
    if (x < this.size.names) {
      return line?.kind === "lane" ? [line.lane.types.join(", "), line.lane.topic] : ["robot", line?.node || "unnamed"];
    }
    const found = [shown(ns, (this.view.end - this.view.start) / BigInt(Math.max(1, this.size.width)))];
    found.push(...firstOf(this.eventsAt(ns).map((event) => `event ${event.name}${event.node ? ` of ${event.node}` : ""}`)));
    if (line?.kind === "robot") {
      const run = this.runAt(line.node, ns);
      found.push(...firstOf(this.marksAt(line.node, ns).map((mark) => (
        `${mark.run} ${mark.kind === "end" ? "ended" : "began"}${mark.text ? `: ${mark.text}` : ""}`))));
      if (run) found.push(run.run, `${run.messages.toLocaleString("en")} messages, ${length(run.last - run.first)}`);
    } else if (line) {
      found.push(line.lane.topic, ...this.tellOfLane(line.lane, ns));
    }
    return found;
  }

  /** @param {import("./timeline_data.js").Lane} lane @param {bigint} ns @returns {string[]} */
  tellOfLane(lane, ns) {
    const found = [];
    const count = lane.countAt(ns);
    const about = lane.isEven(ns) || !lane.exact ? "about " : "";
    if (count && lane.scale) {
      found.push(`${about}${count.toLocaleString("en")} ${count === 1 ? "message" : "messages"} in ${length(lane.scale.step)}`);
    }
    const gap = count ? undefined : lane.gaps.find(([low, high]) => low <= ns && ns <= high);
    if (gap) found.push(`no message for ${length(gap[1] - gap[0])}`);
    const reach = scaled(this.view.end - this.view.start, CLICK_PX / this.size.width);
    const losses = lane.losses.filter((each) => each.start - reach <= ns && ns <= each.end + reach);
    found.push(...firstOf(losses.map((loss) => `lost ${loss.count ?? "some"}: ${loss.text}`)));
    return found;
  }

  /** @param {bigint} ns @returns {any[]} Events at, or near, a time. */
  eventsAt(ns) {
    const reach = scaled(this.view.end - this.view.start, CLICK_PX / this.size.width);
    return this.picture.events
      .filter((event) => event.start - reach <= ns && (event.end === null || ns <= event.end + reach));
  }

  /** @param {string} node @param {bigint} ns @returns {any[]} Starts and ends of recordings near a time. */
  marksAt(node, ns) {
    const reach = scaled(this.view.end - this.view.start, CLICK_PX / this.size.width);
    return this.picture.marks
      .filter((mark) => mark.kind !== "loss" && mark.node === node && mark.start - reach <= ns && ns <= mark.start + reach);
  }

  /** @param {string} node @param {bigint} ns @returns {import("./timeline_data.js").Run | undefined} */
  runAt(node, ns) {
    const reach = scaled(this.view.end - this.view.start, CLICK_PX / this.size.width);
    const near = this.picture.runs.filter((run) => run.node === node && run.first - reach <= ns && ns <= run.last + reach);
    return near.sort((one, other) => Number(one.last - one.first - (other.last - other.first)))[0];
  }

  /**
   * Write a text into a width, without its middle if it is too long.
   * @param {CanvasRenderingContext2D} pen
   * @param {string} text
   * @param {number} x
   * @param {number} y
   * @param {number} room
   */
  fitted(pen, text, x, y, room) {
    const key = `${Math.round(room)} ${text}`;
    let shorter = this.shortened.get(key);
    if (shorter === undefined) {
      shorter = text;
      for (let kept = text.length - 1; kept > 2 && pen.measureText(shorter).width > room; kept--) {
        const head = Math.floor(kept / 3);
        shorter = `${text.slice(0, head)}…${text.slice(text.length - (kept - head))}`;
      }
      if (pen.measureText(shorter).width > room) shorter = "";
      if (this.shortened.size > MOST_TEXTS) this.shortened.clear();
      this.shortened.set(key, shorter);
    }
    pen.fillText(shorter, x, y);
  }

  /** @returns {string} Description for screen readers. */
  describe() {
    const { picture, view } = this;
    const robots = new Set(picture.lanes.map((lane) => lane.node)).size;
    return `Timeline from ${iso(view.start)} to ${iso(view.end)}: ${picture.lanes.length} topics of ${robots} robots, ${picture.runs.length} runs`;
  }
}

/** @param {bigint} ns @param {number} factor */
function scaled(ns, factor) {
  return BigInt(Math.round(Number(ns) * factor));
}

/** @param {Span} span @param {number} part From 0 to 1. */
function timeIn({ start, end }, part) {
  return start + scaled(end - start + 1n, Math.max(0, Math.min(1, part)));
}

/** @param {[number, number][]} ranges @param {number} first @param {number} last */
function evenOf(ranges, first, last) {
  const found = new Uint8Array(Math.max(0, last - first + 1));
  for (const [from, to] of ranges) found.fill(1, Math.max(0, from - first), Math.max(0, to - first + 1));
  return found;
}

/** @param {Element} element */
function coloursOf(element) {
  const style = getComputedStyle(element);
  const of = (/** @type {string} */ name) => style.getPropertyValue(`--${name}`).trim();
  return {
    font: "12px system-ui, 'Noto Sans', 'DejaVu Sans', sans-serif",
    ground: of("ground"), surface: of("surface"), raised: of("raised"), line: of("line"),
    text: of("text"), muted: of("muted"), accent: of("accent"), data: of("data"),
    soft: of("data-soft"), run: of("run"), runSoft: of("run-soft"), loss: of("loss"), mark: of("mark"),
  };
}

/** @param {string[]} texts @returns {string[]} The first ones, and how many more there are. */
function firstOf(texts) {
  if (texts.length <= MOST_TOLD) return texts;
  return [...texts.slice(0, MOST_TOLD), `… and ${texts.length - MOST_TOLD} more`];
}
