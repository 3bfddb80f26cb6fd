// SPDX-FileCopyrightText: 2026 cassandra_ros authors
// SPDX-License-Identifier: BSD-3-Clause
// @ts-check
/**
 * Columns of a plot over another column: for each pixel of time the rectangle that contains its
 * messages, and a line through the centres in the order of time.
 */

const MARGIN = { left: 64, right: 16, top: 10, bottom: 40 };
const FEW_POINTS = 60;
const DEGREES = ["°E", "°N"];

/**
 * A column of an answer of /api/plot.
 * @typedef {{name: string, unit: string, low: (number | null)[], high: (number | null)[] | null}} Column
 */

/** @param {Column} column @param {number} n @returns {[number, number] | null} */
function ends(column, n) {
  const low = column.low[n] ?? null;
  const high = column.high ? column.high[n] ?? null : low;
  return low === null || high === null ? null : [low, high];
}

/** @param {[number, number]} range */
const middle = ([low, high]) => low + (high - low) / 2;

/** One panel. */
export class XY {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {Column} x
   * @param {{column: Column, colour: string}[]} ys Columns that are shown.
   * @param {Set<number>} breaks Indexes of points after which no message came for long.
   */
  constructor(canvas, x, ys, breaks) {
    this.canvas = canvas;
    this.x = x;
    this.ys = ys;
    this.breaks = breaks;
    this.bounds = this.boundsOf();
    this.draw();
  }

  /** Minimum and maximum of both axes, with a margin. */
  boundsOf() {
    const bounds = { left: Infinity, right: -Infinity, low: Infinity, high: -Infinity };
    for (const { column } of this.ys) {
      for (const n of column.low.keys()) {
        const [x, y] = [ends(this.x, n), ends(column, n)];
        if (!x || !y) continue;
        bounds.left = Math.min(bounds.left, x[0]);
        bounds.right = Math.max(bounds.right, x[1]);
        bounds.low = Math.min(bounds.low, y[0]);
        bounds.high = Math.max(bounds.high, y[1]);
      }
    }
    if (bounds.left > bounds.right) return { left: 0, right: 1, low: 0, high: 1 };
    const [across, up] = [bounds.right - bounds.left, bounds.high - bounds.low].map((size, n) => (
      size || Math.abs(n ? bounds.high : bounds.left) || 1) * 0.05);
    const wider = { left: bounds.left - across, right: bounds.right + across, low: bounds.low - up, high: bounds.high + up };
    return this.compared(wider);
  }

  /**
   * Widen the bounds so that a metre has the same length on both axes.
   * @param {{left: number, right: number, low: number, high: number}} bounds
   */
  compared(bounds) {
    const aspect = this.aspect(bounds);
    if (!aspect) return bounds;
    const { width, height } = this.area();
    const [across, up] = [bounds.right - bounds.left, (bounds.high - bounds.low) * aspect];
    const scale = Math.max(across / width, up / height);
    const [x, y] = [(scale * width - across) / 2, (scale * height - up) / 2 / aspect];
    return { left: bounds.left - x, right: bounds.right + x, low: bounds.low - y, high: bounds.high + y };
  }

  /**
   * Length of a unit along y relative to one along x; 0 = the units cannot be compared.
   * @param {{left: number, right: number, low: number, high: number}} bounds
   */
  aspect(bounds) {
    const [x, y] = [this.x.unit, this.ys[0]?.column.unit ?? ""];
    if (x && x === y) return 1;
    if (x === y || ![x, y].every((unit) => DEGREES.includes(unit))) return 0;
    const latitude = middle(x === "°N" ? [bounds.left, bounds.right] : [bounds.low, bounds.high]);
    const degree = Math.max(0.01, Math.cos((latitude * Math.PI) / 180));
    return x === "°E" ? 1 / degree : degree;
  }

  area() {
    return {
      width: Math.max(1, this.canvas.clientWidth - MARGIN.left - MARGIN.right),
      height: Math.max(1, this.canvas.clientHeight - MARGIN.top - MARGIN.bottom),
    };
  }

  /** @param {number} x @param {number} y @returns {[number, number]} */
  at(x, y) {
    const [{ width, height }, { left, right, low, high }] = [this.area(), this.bounds];
    return [
      MARGIN.left + ((x - left) / (right - left)) * width,
      MARGIN.top + ((high - y) / (high - low)) * height,
    ];
  }

  draw() {
    const dots = window.devicePixelRatio || 1;
    this.canvas.width = Math.round(this.canvas.clientWidth * dots);
    this.canvas.height = Math.round(this.canvas.clientHeight * dots);
    const context = /** @type {CanvasRenderingContext2D} */ (this.canvas.getContext("2d"));
    context.scale(dots, dots);
    this.drawAxes(context);
    for (const { column, colour } of this.ys) this.drawColumn(context, column, colour);
  }

  /** @param {CanvasRenderingContext2D} context */
  drawAxes(context) {
    const style = getComputedStyle(document.documentElement);
    const [line, muted] = ["--line", "--muted"].map((name) => style.getPropertyValue(name).trim());
    const [{ width, height }, { left, right, low, high }] = [this.area(), this.bounds];
    context.strokeStyle = line;
    context.fillStyle = muted;
    context.font = "12px sans-serif";
    context.lineWidth = 1;
    context.textAlign = "center";
    for (const { value, text } of ticks(left, right, width / 90)) {
      const [x] = this.at(value, low);
      stroke(context, [[x, MARGIN.top], [x, MARGIN.top + height]]);
      context.fillText(text, x, MARGIN.top + height + 16);
    }
    context.fillText(this.x.unit ? `${this.x.name} [${this.x.unit}]` : this.x.name, MARGIN.left + width / 2, MARGIN.top + height + 34);
    context.textAlign = "right";
    for (const { value, text } of ticks(low, high, height / 50)) {
      const [, y] = this.at(left, value);
      stroke(context, [[MARGIN.left, y], [MARGIN.left + width, y]]);
      context.fillText(text, MARGIN.left - 6, y + 4);
    }
  }

  /**
   * @param {CanvasRenderingContext2D} context
   * @param {Column} column
   * @param {string} colour
   */
  drawColumn(context, column, colour) {
    /** @type {[number, number][]} */
    let way = [];
    const few = column.low.length <= FEW_POINTS;
    context.strokeStyle = context.fillStyle = colour;
    for (const n of column.low.keys()) {
      const [x, y] = [ends(this.x, n), ends(column, n)];
      if (x && y) {
        const [from, to] = [this.at(x[0], y[1]), this.at(x[1], y[0])];
        context.globalAlpha = 0.3;
        context.fillRect(from[0], from[1], to[0] - from[0], to[1] - from[1]);
        context.globalAlpha = 1;
        const point = this.at(middle(x), middle(y));
        if (few) context.fillRect(point[0] - 1.5, point[1] - 1.5, 3, 3);
        way.push(point);
      }
      if (!x || !y || this.breaks.has(n)) {
        stroke(context, way);
        way = [];
      }
    }
    stroke(context, way);
  }

  /**
   * Return the index of the point nearest to a position on the canvas; null = no point is near.
   * @param {number} left Pixels.
   * @param {number} top Pixels.
   */
  nearest(left, top) {
    let best = { distance: Infinity, n: /** @type {number | null} */ (null) };
    for (const { column } of this.ys) {
      for (const n of column.low.keys()) {
        const [x, y] = [ends(this.x, n), ends(column, n)];
        if (!x || !y) continue;
        const point = this.at(middle(x), middle(y));
        const distance = Math.hypot(point[0] - left, point[1] - top);
        if (distance < best.distance) best = { distance, n };
      }
    }
    return best.n;
  }
}

/** @param {CanvasRenderingContext2D} context @param {[number, number][]} way */
function stroke(context, way) {
  context.beginPath();
  for (const [x, y] of way) context.lineTo(x, y);
  context.stroke();
}

/**
 * Return round numbers between two numbers, about as many as given.
 * @param {number} low
 * @param {number} high
 * @param {number} most
 */
function ticks(low, high, most) {
  const least = (high - low) / Math.max(2, most);
  const power = 10 ** Math.floor(Math.log10(least));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((each) => each >= least) ?? 10 * power;
  const digits = Math.min(20, Math.max(0, -Math.floor(Math.log10(step) + 1e-9)));
  const found = [];
  for (let n = Math.ceil(low / step); n * step <= high && found.length < 100; n += 1) {
    found.push({ value: n * step, text: Math.abs(n * step) < 1e6 ? (n * step).toFixed(digits) : (n * step).toPrecision(7) });
  }
  return found;
}
