// SPDX-FileCopyrightText: 2026 cassandra_ros authors
// SPDX-License-Identifier: BSD-3-Clause
// @ts-check
/**
 * The plot of a statement: for each pixel the minimum and the maximum, computed by the server.
 * One panel for each unit, all over the same time range, or over one column (`over` in the address).
 * With a second statement (`with`) one panel has the axes of two units. Zooming in requests the plot of the
 * smaller time range.
 */

import { get, isAbort } from "./api.js";
import { lookAt } from "./ask_rows.js";
import { XY } from "./ask_xy.js";
import { make } from "./page.js";
import * as state from "./state.js";
import { length, shown, ticks } from "./times.js";

/** Debian's libjs-dygraphs, where it is installed. */
const SCRIPT = "/dygraphs/dygraph.min.js";
const STYLE = "/dygraphs/dygraph.min.css";
const COLOURS = ["#2f7fe6", "#e0702f", "#1d9a80", "#b558c4", "#b8920a", "#d8453f", "#6b8bb0", "#6a9a2f"];
const MOST_PIXELS = 4000;
/** Maximum number of repeated requests after answers without new data. */
const MOST_IDLE = 3;
const FEW_POINTS = 60;
const LEAST_NS = 1000n;
const SECOND = 1_000_000_000n;
/** What dygraphs draws as an interruption of a line; it connects the points beside null. */
const BROKEN = [NaN, NaN, NaN];

/** @typedef {{start: bigint | null, end: bigint | null}} Window */

export class Plot {
  /** @param {(window: Window) => void} move Shows another time range. */
  constructor(move) {
    this._place = /** @type {HTMLElement} */ (document.getElementById("ask-plot"));
    this._panels = /** @type {HTMLElement} */ (document.getElementById("plot-panels"));
    this._told = /** @type {HTMLElement} */ (document.getElementById("plot-told"));
    this._moment = /** @type {HTMLElement} */ (document.getElementById("plot-moment"));
    this._move = move;
    /** @type {any[]} The Dygraph of each panel. */
    this._graphs = [];
    /** @type {HTMLElement[]} The legend above each panel. */
    this._legends = [];
    /** @type {any} */
    this._found = null;
    /** @type {bigint[]} */
    this._times = [];
    this._base = 0n;
    this._window = "";
    /** @type {{start: bigint, end: bigint}} Visible time range. */
    this._sight = { start: 0n, end: 1n };
    /** @type {Set<number>} Indexes of hidden columns. */
    this._hidden = new Set();
    this._wheel = 0;
    this._over = /** @type {HTMLSelectElement} */ (document.getElementById("plot-over"));
    this._over.addEventListener("change", () => state.write({ over: this._over.value || null }, { push: true }));
    state.onChange(() => this._found && this._draw(true));
    window.addEventListener("resize", () => this._found && this._xPlace() >= 0 && this._draw(true));
    this._addKeys();
  }

  /** @param {Window} window */
  shows(window) {
    return this._window === String([window.start, window.end]);
  }

  clear() {
    this._place.hidden = true;
    this._window = "";
    for (const graph of this._graphs) graph.destroy();
    this._graphs = [];
    this._moment.replaceChildren();
    this._legends = [];
    this._panels.replaceChildren();
  }

  /**
   * Load the plot of a time range and draw it, more complete with each answer.
   * @param {Record<string, any>} parameters
   * @param {string} also A second statement, whose numbers are drawn, too; "" = none.
   * @param {Window} window
   * @param {AbortSignal} signal
   * @param {boolean} other Whether the statement differs from the one before.
   */
  async load(parameters, also, window, signal, other) {
    this._window = String([window.start, window.end]);
    if (other) this._hidden.clear();
    const ready = dygraphs();
    const pixels = Math.min(MOST_PIXELS, Math.round(this._width() * devicePixelRatio));
    // With more buckets than the viewer caches, answers may never become complete: stop here.
    let [share, edges, idle] = [-1, Infinity, 0];
    for (let first = true; idle < MOST_IDLE; first = false) {
      const one = await get("/api/plot", { ...parameters, ...window, pixels }, { signal });
      const range = { start: window.start ?? one.start, end: window.end ?? one.end };
      const second = also ? await get("/api/plot", { ...parameters, q: also, ...range, pixels }, { signal }).catch(reasonOf) : "";
      const found = joined(typeof second === "string" ? [one] : [one, second], typeof second === "string" ? second : "");
      const present = await ready;
      if (signal.aborted) return;
      this._show(found, window, first && other, present);
      if (found.complete) return;
      idle = found.share > share || found.edges < edges ? 0 : idle + 1;
      share = Math.max(share, found.share);
      edges = found.edges;
    }
  }

  _width() {
    return this._panels.clientWidth || document.body.clientWidth - 80;
  }

  /**
   * @param {any} found
   * @param {Window} window
   * @param {boolean} anew
   * @param {boolean} present Whether dygraphs is installed.
   */
  _show(found, window, anew, present) {
    if (found.columns.length === 0) return this.clear();
    this._place.hidden = false;
    this._place.dataset.complete = String(found.complete);
    this._place.dataset.points = String(found.times.length);
    this._tell(found);
    this._found = found;
    this._times = found.times.map(BigInt);
    this._base = BigInt(found.start);
    this._sight = wide(window.start ?? BigInt(found.start), window.end ?? BigInt(found.end));
    if (!present) {
      this._panels.replaceChildren(make("p", { class: "note" },
        "Plots are drawn by dygraphs, which is not installed here: sudo apt install libjs-dygraphs"));
      return;
    }
    this._draw(anew);
    this._showLegend(null);
  }

  /** @param {any} found */
  _tell(found) {
    const names = found.left_out.map((/** @type {any} */ each) => each.name);
    const reasons = found.left_out.map((/** @type {any} */ each) => `${each.name} is ${each.reason}`);
    const left = names.length ? [`not drawn: ${names.join(", ")}`] : [];
    const nothing = found.times.length ? [] : ["nothing lies in this time"];
    this._told.textContent = [found.problem, found.how, ...nothing, ...left].filter(Boolean).join("; ");
    this._told.classList.toggle("loss", Boolean(found.problem));
    this._told.title = reasons.join("\n");
  }

  /**
   * Indexes of the columns of each axis of each panel. An axis has one unit; the panels of one statement have
   * one axis, those of two statements a left and a right one.
   * @returns {number[][][]}
   */
  _panelAxes() {
    const { columns, statements } = this._found;
    const x = this._xPlace();
    // Over another column only those that have values at its times.
    const places = [...columns.keys()].filter((place) => place !== x && (x < 0 || columns[place].statement === columns[x].statement));
    const unit = (/** @type {number} */ place) => columns[place].unit || columns[place].statement;
    const axes = [...new Set(places.map(unit))].map((each) => places.filter((place) => unit(place) === each));
    if (x >= 0 || statements < 2) return axes.map((axis) => [axis]);
    return axes.flatMap((axis, n) => (n % 2 ? [] : [axes.slice(n, n + 2)]));
  }

  /** Index of the column over which the others are drawn; -1 = over time. */
  _xPlace() {
    const over = state.read().others.over ?? "";
    return this._found?.columns.findIndex((/** @type {any} */ column) => column.name === over && this._isShared(column)) ?? -1;
  }

  /** @param {any} column Whether its statement has others, which can be drawn over it. */
  _isShared(column) {
    return this._found.columns.some((/** @type {any} */ other) => other !== column && other.statement === column.statement);
  }

  /** Fill the menu of columns over which the others can be drawn. */
  _offerColumns() {
    const names = this._found.columns.filter((/** @type {any} */ column) => this._isShared(column)).map((/** @type {any} */ column) => column.name);
    const options = names.map((/** @type {string} */ name) => make("option", { value: name }, name));
    this._over.replaceChildren(make("option", { value: "" }, "time"), ...options);
    this._over.disabled = !names.length;
    this._over.value = this._found.columns[this._xPlace()]?.name ?? "";
  }

  /** Draw the columns over one of them. */
  _drawXY() {
    const { columns } = this._found;
    for (const graph of this._graphs) graph.destroy();
    this._graphs = [];
    const groups = this._panelAxes().flat();
    const { breaks } = columns[this._xPlace()];
    this._legends = groups.map(() => make("ul", { class: "legend" }));
    const canvases = groups.map(() => /** @type {HTMLCanvasElement} */ (make("canvas", { class: "graph xy" })));
    this._panels.replaceChildren(...canvases.flatMap((canvas, n) => [this._legends[n], canvas]));
    for (const [n, places] of groups.entries()) {
      const shownPlaces = places.filter((place) => !this._hidden.has(place));
      const ys = shownPlaces.map((place) => ({ column: columns[place], colour: COLOURS[place % COLOURS.length] }));
      const panel = new XY(canvases[n], columns[this._xPlace()], ys, breaks);
      const at = (/** @type {MouseEvent} */ event) => panel.nearest(event.offsetX, event.offsetY);
      canvases[n].addEventListener("pointermove", (event) => this._showLegend(at(event)));
      canvases[n].addEventListener("pointerleave", () => this._showLegend(null));
      canvases[n].addEventListener("click", (event) => {
        const place = at(event);
        if (place !== null) this._mark(this._x(this._times[place]));
      });
    }
    this._showLegend(null);
  }

  /** @param {boolean} anew */
  _draw(anew) {
    this._offerColumns();
    if (this._xPlace() >= 0) return this._drawXY();
    const groups = this._panelAxes();
    if (!anew && this._graphs.length === groups.length) {
      for (const [n, axes] of groups.entries()) this._graphs[n].updateOptions(this._options(axes));
      return;
    }
    for (const graph of this._graphs) graph.destroy();
    this._legends = groups.map(() => make("ul", { class: "legend" }));
    const places = groups.map(() => make("div", { class: "graph" }));
    // All panels first: their height depends on their number.
    this._panels.replaceChildren(...places.flatMap((place, n) => [this._legends[n], place]));
    this._graphs = groups.map((group, n) => {
      const options = this._options(group);
      return new (/** @type {any} */ (window)).Dygraph(places[n], options.file, options);
    });
  }

  /** @param {number[][]} axes Indexes of the columns of each axis of a panel. */
  _options(axes) {
    const places = axes.flat();
    const [, right = []] = axes;
    const style = getComputedStyle(document.documentElement);
    const [line, muted] = ["--line", "--muted"].map((name) => style.getPropertyValue(name).trim());
    return {
      file: this._lines(places),
      // Numbers instead of names: texts from the store are never markup.
      labels: ["t", ...places.map(String)],
      colors: places.map((place) => COLOURS[place % COLOURS.length]),
      visibility: places.map((place) => !this._hidden.has(place)),
      customBars: true,
      fillAlpha: 0.5,
      strokeWidth: 1,
      drawPoints: this._times.length <= FEW_POINTS,
      drawGapEdgePoints: true,
      connectSeparatedPoints: true,
      series: Object.fromEntries(right.map((place) => [String(place), { axis: "y2" }])),
      pointSize: 2,
      legend: "never",
      dateWindow: [this._x(this._sight.start), this._x(this._sight.end)],
      gridLineColor: line,
      axisLineColor: muted,
      axisLabelWidth: 64,
      digitsAfterDecimal: 6,
      animatedZooms: false,
      axes: { x: { ticker: this._ticker.bind(this) }, ...(right.length && { y2: { independentTicks: true } }) },
      zoomCallback: (/** @type {number} */ low, /** @type {number} */ high) => this._zoomed(low, high),
      highlightCallback: (/** @type {any} */ event, /** @type {number} */ x) => this._point(x),
      unhighlightCallback: () => this._showLegend(null),
      clickCallback: (/** @type {any} */ event, /** @type {number} */ x) => this._mark(x),
      interactionModel: this._interactions(),
    };
  }

  /** @param {number[]} places */
  _lines(places) {
    const columns = places.map((place) => this._found.columns[place]);
    /** @type {any[]} */
    const lines = [];
    for (const [n, time] of this._times.entries()) {
      const x = this._x(time);
      lines.push([x, ...columns.map((column) => bar(column.low[n], column.high ? column.high[n] : column.low[n]))]);
      if (!columns.some((column) => column.breaks.has(n))) continue;
      lines.push([(x + this._x(this._times[n + 1])) / 2, ...columns.map((column) => (column.breaks.has(n) ? BROKEN : null))]);
    }
    // dygraphs needs at least one row.
    return lines.length ? lines : [[0, ...columns.map(() => null)]];
  }

  /**
   * Milliseconds after the first pixel: such a number is exact to the nanosecond.
   * @param {bigint} ns
   */
  _x(ns) {
    return Number(ns - this._base) / 1e6;
  }

  /** @param {number} x */
  _ns(x) {
    return this._base + BigInt(Math.round(x * 1e6));
  }

  /**
   * @param {number} low
   * @param {number} high
   * @param {number} width
   */
  _ticker(low, high, width) {
    const found = ticks(this._ns(low), this._ns(high), Math.max(2, width / 90));
    return found.ticks.map((tick) => ({ v: this._x(tick.ns), label: tick.text }));
  }

  /** @param {number} x */
  _nearest(x) {
    const at = this._ns(x);
    let [low, high] = [0, this._times.length - 1];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this._times[middle] < at) low = middle + 1;
      else high = middle;
    }
    const before = this._times[low - 1];
    return before !== undefined && at - before < this._times[low] - at ? low - 1 : low;
  }

  /** @param {number} x */
  _point(x) {
    this._showLegend(this._nearest(x));
  }

  /** @param {number | null} n Index of the selected point. */
  _showLegend(n) {
    for (const [panel, axes] of this._panelAxes().entries()) {
      const items = axes.flatMap((places, side) => {
        const told = [this._found.columns[places[0]].unit, axes.length > 1 ? ["← left", "right →"][side] : ""].filter(Boolean).join(", ");
        return [...places.map((place) => this._legendItem(place, n)), ...(told ? [make("li", { class: "unit" }, told)] : [])];
      });
      this._legends[panel]?.replaceChildren(...items);
    }
    if (n !== null) this._moment.textContent = this._at(n);
  }

  /**
   * @param {number} place
   * @param {number | null} n
   */
  _legendItem(place, n) {
    const column = this._found.columns[place];
    const colour = make("span", { class: "colour" });
    colour.style.background = COLOURS[place % COLOURS.length];
    const value = make("span", { class: "mono" }, n === null ? "" : range(column, n));
    const pressed = String(!this._hidden.has(place));
    const onclick = () => this._toggle(place);
    return make("li", {}, make(
      "button", { type: "button", "aria-pressed": pressed, title: "Show or hide", onclick },
      colour, column.name, " ", value,
    ));
  }

  /** @param {number} n */
  _at(n) {
    const rows = this._found.rows[n];
    const time = shown(this._times[n], BigInt(this._found.pixel));
    return rows === 1 ? time : `${time}${rows ? `, ${rows} messages` : ""} in ${length(BigInt(this._found.pixel))}`;
  }

  /** @param {number} x */
  _mark(x) {
    if (!this._times.length) return;
    const time = String(this._times[this._nearest(x)]);
    const link = make("a", { href: lookAt(time) }, `Look at ${shown(BigInt(time), 1_000_000n)}`);
    this._moment.replaceChildren(link);
  }

  /** @param {number} place */
  _toggle(place) {
    if (!this._hidden.delete(place)) this._hidden.add(place);
    this._draw(false);
    this._showLegend(null);
  }

  /**
   * @param {number} low
   * @param {number} high
   */
  _zoomed(low, high) {
    // A vertical drag alone does not change the time range.
    if (low === this._x(this._sight.start) && high === this._x(this._sight.end)) return;
    this._go(this._ns(low), this._ns(high));
  }

  /**
   * @param {bigint} start
   * @param {bigint} end
   */
  _go(start, end) {
    if (end - start < LEAST_NS) end = start + LEAST_NS;
    if (start < 0n) [start, end] = [0n, end - start];
    this._sight = { start, end };
    for (const graph of this._graphs) {
      graph.updateOptions({ dateWindow: [this._x(start), this._x(end)] });
    }
    this._move({ start, end });
  }

  _all() {
    this._move({ start: null, end: null });
  }

  /**
   * @param {number} factor Factor of the length.
   * @param {number} [at] Position in the time range that stays in place, 0 to 1.
   */
  _zoom(factor, at = 0.5) {
    const { start, end } = this._sight;
    const before = Number(end - start);
    const after = before * factor;
    const first = start + BigInt(Math.round((before - after) * at));
    this._go(first, first + BigInt(Math.round(after)));
  }

  /** @param {number} part Share of the length. */
  _pan(part) {
    const { start, end } = this._sight;
    const by = BigInt(Math.round(Number(end - start) * part));
    this._go(start + by, end + by);
  }

  _interactions() {
    const own = /** @type {any} */ (window).Dygraph.defaultInteractionModel;
    return {
      ...own,
      dblclick: () => this._all(),
      mousedown: (/** @type {any} */ event, /** @type {any} */ graph, /** @type {any} */ context) => {
        own.mousedown(event, graph, context);
        this._panels.focus({ preventScroll: true });
        if (!context.isPanning) return;
        const panned = () => setTimeout(() => {
          const [low, high] = graph.xAxisRange();
          this._zoomed(low, high);
        });
        document.addEventListener("mouseup", panned, { once: true });
      },
      wheel: (/** @type {WheelEvent} */ event, /** @type {any} */ graph) => {
        if (!event.ctrlKey && !event.shiftKey && !this._panels.contains(document.activeElement)) return;
        event.preventDefault();
        const [left, width] = [graph.getArea().x, graph.getArea().w];
        const at = Math.min(1, Math.max(0, (graph.eventToDomCoords(event)[0] - left) / width));
        cancelAnimationFrame(this._wheel);
        this._wheel = requestAnimationFrame(() => this._zoom(1.3 ** Math.sign(event.deltaY), at));
      },
    };
  }

  _addKeys() {
    /** @type {Record<string, () => void>} */
    const actions = {
      "plot-back": () => this._pan(-0.5),
      "plot-on": () => this._pan(0.5),
      "plot-out": () => this._zoom(2),
      "plot-in": () => this._zoom(0.5),
      "plot-all": () => this._all(),
    };
    for (const [id, action] of Object.entries(actions)) {
      document.getElementById(id)?.addEventListener("click", action);
    }
    /** @type {Record<string, string>} */
    const keys = {
      ArrowLeft: "plot-back", ArrowRight: "plot-on",
      "-": "plot-out", "+": "plot-in", "=": "plot-in", 0: "plot-all",
    };
    this._panels.addEventListener("keydown", (event) => {
      const action = actions[keys[event.key]];
      if (!action || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      action();
    });
  }
}

/**
 * Return a time range that is not empty: a single time becomes one second.
 * @param {bigint} start
 * @param {bigint} end
 */
function wide(start, end) {
  if (end - start >= LEAST_NS) return { start, end };
  const before = start < SECOND / 2n ? start : SECOND / 2n;
  return { start: start - before, end: end + SECOND / 2n };
}

/** @param {any} problem Error of the second statement, which is told beside it. @returns {string} */
function reasonOf(problem) {
  if (isAbort(problem)) throw problem;
  return problem.message.split("\n")[0];
}

/**
 * Put the plots of one or two statements over the same pixels together: at a time that only the other one has, a
 * column has no element.
 * @param {any[]} plots Answers of /api/plot.
 * @param {string} problem Why the second statement has no plot.
 */
function joined(plots, problem) {
  const times = [...new Set(plots.flatMap((plot) => plot.times))].sort((one, other) => (BigInt(one) < BigInt(other) ? -1 : 1));
  const places = new Map(times.map((time, place) => [time, place]));
  const rows = new Array(times.length).fill(0);
  const name = (/** @type {any} */ plot, /** @type {any} */ each) => ({ ...each, name: plots.length > 1 ? `${plot.topic} ${each.name}`.trim() : each.name });
  for (const plot of plots) plot.times.forEach((/** @type {string} */ time, /** @type {number} */ n) => (rows[places.get(time) ?? 0] += plot.rows[n]));
  const columns = plots.flatMap((plot, statement) => {
    const spread = (/** @type {any[]} */ values) => {
      const all = new Array(times.length);
      values.forEach((value, n) => (all[places.get(plot.times[n]) ?? 0] = value));
      return all;
    };
    const breaks = new Set(plot.breaks.map((/** @type {number} */ n) => places.get(plot.times[n])));
    return plot.columns.map((/** @type {any} */ column) => (
      { ...name(plot, column), statement, breaks, low: spread(column.low), high: column.high && spread(column.high) }));
  });
  return {
    ...plots[0], times, rows, columns, problem, statements: plots.length,
    left_out: plots.flatMap((plot) => plot.left_out.map((/** @type {any} */ each) => name(plot, each))),
    complete: plots.every((plot) => plot.complete),
    share: Math.min(...plots.map((plot) => plot.share)),
    edges: plots.reduce((sum, plot) => sum + plot.edges, 0),
    how: [...new Set(plots.map((plot) => plot.how))].filter(Boolean).join("; "),
  };
}

/**
 * @param {number | null | undefined} low null = not a number; undefined = there is no message.
 * @param {number | null} high
 */
function bar(low, high) {
  if (low === undefined) return null;
  // The line follows the maxima: a value in the middle was never measured.
  return low === null || high === null ? BROKEN : [low, high, high];
}

/**
 * @param {any} column
 * @param {number} n
 */
function range(column, n) {
  // Between its times a column has the value before.
  while (n > 0 && column.low[n] === undefined) n -= 1;
  const low = column.low[n] ?? null;
  const high = column.high ? column.high[n] : low;
  if (low === null) return "–";
  return low === high ? String(low) : `${low} … ${high}`;
}

/** @type {Promise<boolean> | null} */
let loaded = null;

/** Load dygraphs once; return whether it is installed. */
function dygraphs() {
  loaded ??= new Promise((resolve) => {
    document.head.append(make("link", { rel: "stylesheet", href: STYLE }));
    document.head.append(make("script", {
      src: SCRIPT,
      onload: () => resolve(true),
      onerror: () => resolve(false),
    }));
  });
  return loaded;
}
